"""Arguments and calls that no environment can use are refused, in words that a person has approved."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from approval import refused_calls
from gymnasium.vector import SyncVectorEnv
from together import Together

import gauge_envs
from gauge_envs import GaugeEnv
from gauge_envs.backends import registry
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.envs.dm_env import load
from gauge_envs.envs.vector import GaugeVectorEnv, ScoreEpisodes
from gauge_envs.errors import ActionError, BackendError, GaugeError, ParameterError
from gauge_envs.runs.request import RunRequest

SLIDE = "SlopeSlider-2-wood"
MAKE = (gymnasium.make, gymnasium.make_vec)

ARGUMENTS = [
    {"backend": None},
    {"backend": ["mujoco"]},
    {"backend": "mujocoo"},
    {"parameters": {3: 1}},
    {"parameters": "fitted"},
    {"parameters": {"cubes.friction": 0.3}},
    {"parameters": {"cube.frict": 0.3}},
    {"settings": {3: 1}},
    {"settings": [1]},
    {"settings": "fast"},
    {"asset": 3},
    {"marker_proxy": "nearest"},
    # What would change nothing.
    {"marker_proxy": "node"},
    {"jitter": {"position_m": 0.0, "angle_rad": 0.0, "velocity_m_per_s": 1e-15}},
    {"parameters": {"air.density_kg_per_m3": 1.2, "air.normal_coefficient": 1.0}},
    {"parameters": {"cube.euler_deg": (0.0, 0.0)}},
]


def worlds(count=2, name=SLIDE, **arguments):
    return gymnasium.make_vec(f"GAUGE/{name}", num_envs=count, **arguments).unwrapped


def closed(env):
    env.reset(seed=0)
    env.close()
    env.close()
    return env


@pytest.mark.parametrize("make", MAKE)
def test_arguments_are_refused_alike_by_make_and_make_vec(make, approved):
    calls = {
        str(arguments): partial(make, f"GAUGE/{SLIDE}", **arguments)
        for arguments in ARGUMENTS
    }
    approved("envs/arguments", refused_calls(GaugeError, calls))


def test_calls_are_refused(approved):
    ended = GaugeEnv("SlopeContact-wood")
    ended.reset(seed=0)
    for _ in range(9):
        ended.step(0)
    coarse = {"settings": {"cell_m": 1 / 300}}
    rendering = {"render_mode": "rgb_array"}
    push = "Turntable-Limit-wood"
    limit = gymnasium.make(f"GAUGE/{push}", **rendering).unwrapped
    closed(limit)
    vector = closed(worlds(**rendering))
    single = closed(GaugeEnv(SLIDE, **rendering))
    calls = {
        "unknown id": lambda: GaugeEnv("SlopeSlider-2-wod"),
        "unknown id of dm_env": lambda: load("SlopeSlider-2-wod"),
        "parameter set of dm_env": lambda: load(SLIDE, parameters="fitted"),
        "reset option of dm_env": lambda: load(SLIDE, options={"x": 1}).reset(),
        "variant 3": lambda: GaugeEnv(3),
        "no variant": lambda: GaugeEnv(None),
        "unknown render mode": lambda: GaugeEnv(SLIDE, render_mode="ansi"),
        "another experiment": lambda: gymnasium.make(
            f"GAUGE/{SLIDE}", variant="SlopeSlider-3-metal"
        ),
        "another task": lambda: gymnasium.make(
            f"GAUGE/{push}", task="Throw-Limit-rubber"
        ),
        "window of worlds": lambda: GaugeVectorEnv(SLIDE, render_mode="human"),
        "fine cloth": lambda: GaugeEnv("Funnel-satin", **coarse),
        "reset option": lambda: GaugeEnv(SLIDE).reset(options={"jitterr": True}),
        "reset option of no mapping": lambda: GaugeEnv(SLIDE).reset(options="jitter"),
        "worlds' empty list of options": lambda: worlds().reset(options=[]),
        "jitter of no rigid body": lambda: GaugeEnv("CantileverBeam-soft").reset(
            options={"jitter": True}
        ),
        "step before reset": lambda: GaugeEnv(SLIDE).step(0),
        "trajectory before reset": lambda: GaugeEnv(SLIDE).trajectory(),
        "step after the end": lambda: ended.step(0),
        "step after close": lambda: single.step(0),
        "reset after close": single.reset,
        "render after close": single.render,
        "control step after close": lambda: limit.step([0.0]),
        "control reset after close": limit.reset,
        "control render after close": limit.render,
        "worlds' step after close": lambda: vector.step([0, 0]),
        "worlds' reset after close": vector.reset,
        "worlds' render after close": vector.render,
        "worlds' step before reset": lambda: worlds().step([0, 0]),
        "worlds' render before reset": lambda: worlds(**rendering).render(),
        "3 seeds": lambda: worlds().reset(seed=[1, 2, 3]),
        "seed x": lambda: worlds().reset(seed="x"),
        "seed 1.5": lambda: worlds().reset(seed=1.5),
        "seeds [0]": lambda: worlds().reset(seed=[0]),
        "worlds' option": lambda: worlds().reset(options={"jitterr": True}),
        "constants of one": lambda: worlds(world_parameters=[{}]),
        "constants as a pair": lambda: worlds(
            1, world_parameters=[("cube.friction", 1)]
        ),
        "constant unknown": lambda: worlds(1, world_parameters=[{"cube.slip": 1.0}]),
        "scores of no reference": lambda: worlds(
            name="RopeWinding-rubber"
        ).score_arrays(),
        "arrays of sub-environments": lambda: ScoreEpisodes(
            SyncVectorEnv([lambda: GaugeEnv(SLIDE)]), arrays=True
        ),
        "arrays of no reference": lambda: worlds(
            name="RopeWinding-rubber", score_arrays=True
        ),
        "no device": lambda: Together([]).on_device(),
    }
    approved("envs/calls", refused_calls(GaugeError, calls))


@pytest.mark.usefixtures("rigid_only")
def test_an_id_that_no_engine_builds_says_so_at_make(approved):
    names = ("Funnel-satin", "FoamTwisting-soft", "RopeWinding-rubber")
    calls = {
        f"{make.__name__} {name}": partial(make, f"GAUGE/{name}")
        for name in names
        for make in MAKE
    }
    approved("envs/unsupported", refused_calls(GaugeError, calls))


def test_numbers_of_worlds_and_requests_are_refused(approved):
    counts = ("x", 0, -1, 2.5, None, True, 10**9)
    requests = (
        {"seed": "x"},
        {"seed": -1},
        {"repeats": 1.5},
        {"repeats": 0},
        {"jitter": 1},
        {"backend": None},
    )
    calls = {f"num_envs {count!r}": partial(worlds, count) for count in counts}
    calls |= {str(values): partial(RunRequest, SLIDE, **values) for values in requests}
    approved("envs/requests", refused_calls(ParameterError, calls))


@pytest.mark.parametrize(
    ("overrides", "place"),
    [
        ({"cube.friction": -0.3}, "friction"),
        ({"cube.mass_kg": 0.0}, "mass_kg"),
        ({"cube.position_m": (0.0, 0.0)}, "position_m"),
        ({"cube.restitution": float("nan")}, "restitution"),
    ],
)
def test_impossible_overrides_are_named(overrides, place):
    with pytest.raises(ParameterError, match=place):
        gymnasium.make(f"GAUGE/{SLIDE}", parameters=overrides)


@pytest.mark.parametrize(
    "arguments",
    [
        {"backend": None},
        {"settings": {"impratio": float("inf")}},
    ],
)
def test_wrong_arguments_of_a_control_task(arguments):
    with pytest.raises(ParameterError):
        gymnasium.make("GAUGE/Turntable-Limit-wood", **arguments)


NOTHING_DRIVEN = [1, -1, "0", None, 0.5, np.zeros(2), np.nan]
DRIVEN = [[np.nan], [1.5], np.zeros(2), 0.0, "left", None, [np.inf]]
TWO_WORLDS = [0, np.zeros(3, dtype=int), [0, 1], [0.5, 0.0], [0, "up"], None]
TWO_DRIVEN = [[[1.5], [1.5]], [[np.nan], [0.0]], np.zeros((2, 2)), [[0.0], ["x"]]]


@pytest.mark.parametrize("is_at_once", [False, True])
def test_wrong_actions(is_at_once, request):
    if is_at_once:
        request.getfixturevalue("together")
    turntable = "Turntable-1-wood"
    cases = (
        (gymnasium.make(f"GAUGE/{SLIDE}").unwrapped, NOTHING_DRIVEN),
        (gymnasium.make(f"GAUGE/{turntable}").unwrapped, DRIVEN),
        (worlds(), TWO_WORLDS),
        (worlds(name=turntable), TWO_DRIVEN),
        (load(turntable), [np.array([2.0])]),
    )
    for env, actions in cases:
        env.reset()
        for action in actions:
            with pytest.raises(ActionError):
                env.step(action)
    # A wrong action changes nothing.
    assert cases[1][0].step(np.zeros(1))[4]["frame"] == 1
    assert cases[2][0].step([0, 0])[4]["frame"].tolist() == [1, 1]


def test_a_damaged_task_file_is_named(tmp_path):
    path = tmp_path / "broken.toml"
    path.write_text("family = ")
    with pytest.raises(gauge_envs.GaugeError, match=r"broken\.toml"):
        gauge_envs.load_task(path)


def changed(place, value):
    def change(states):
        states[place] = value
        return states

    return change


TWICE = "quaternion .* for 'cube', whose norm is 2, expected 1"
BROKEN = [
    ("body_states", lambda states: states.tolist(), "a list, expected an array"),
    ("body_states", lambda states: states[:, :12], r"shape \[1, 12\].*\[1, 13\]"),
    ("body_states", lambda states: states[:0], r"shape \[0, 13\]"),
    ("body_states", lambda states: states[0], r"shape \[13\]"),
    ("body_states", lambda states: states + 2j, r"complex128 values, as .*\+2j"),
    ("body_states", lambda states: states.astype(int), "int64 values, as 0"),
    ("body_states", lambda states: states.astype(object), "object values"),
    ("body_states", changed((0, slice(3, 7)), 1.0), TWICE),
    ("body_states", changed((0, 2), np.nan), "nan in column 2 for 'cube' at the start"),
    ("body_states", changed((0, 4), np.inf), "inf in column 4 for 'cube' at the start"),
    ("body_states", lambda states: {}["x"], "raised an error: KeyError: 'x'"),
    ("fault", lambda found: 7, "returned 7, expected a text or None"),
]
"""A method of an engine, how its result is changed, and what is said."""


@pytest.fixture
def foreign(monkeypatch):
    """MuJoCo counts as an engine of another package."""
    monkeypatch.setattr(registry, "is_bundled", lambda name: False)
    registry.backend.cache_clear()
    yield
    registry.backend.cache_clear()


@pytest.mark.usefixtures("foreign")
@pytest.mark.parametrize(("method", "change", "words"), BROKEN)
def test_a_broken_engine_is_named_with_its_first_wrong_value(
    method, change, words, monkeypatch
):
    right = getattr(SimulationMuJoCo, method)
    wrong = lambda *arguments: change(right(*arguments))  # noqa: E731
    monkeypatch.setattr(SimulationMuJoCo, method, wrong)
    env = gymnasium.make(f"GAUGE/{SLIDE}")

    def first_step():
        env.reset()
        env.step(0)

    with pytest.raises(BackendError, match=f"backend 'mujoco': {method} .*{words}"):
        first_step()


@pytest.mark.usefixtures("foreign")
def test_a_setting_that_no_result_can_record_is_named(monkeypatch):
    build = BackendMuJoCo.build

    def built(*arguments):
        simulation = build(*arguments)
        simulation.settings = {**simulation.settings, "cones": {1, 2}}
        return simulation

    monkeypatch.setattr(BackendMuJoCo, "build", built)
    with pytest.raises(
        BackendError, match="backend 'mujoco': setting 'cones' is a set"
    ):
        gymnasium.make(f"GAUGE/{SLIDE}")


@pytest.mark.usefixtures("foreign")
def test_a_quaternion_that_is_not_finite_after_a_step_ends_the_episode(monkeypatch):
    right = SimulationMuJoCo.body_states
    places = []

    def wrong(*arguments):
        states = right(*arguments)
        for place in places:
            states[place] = np.inf
        return states

    monkeypatch.setattr(SimulationMuJoCo, "body_states", wrong)
    env = gymnasium.make(f"GAUGE/{SLIDE}")
    env.reset()
    places.append((0, 4))
    assert env.step(0)[4]["diverged"] == "the state is not finite"


@pytest.mark.usefixtures("foreign")
def test_a_sound_engine_of_another_package_runs_as_ours():
    env = gymnasium.make(f"GAUGE/{SLIDE}").unwrapped
    env.reset()
    ours = BackendMuJoCo().build(env.experiment.scene)
    names = [body.name for body in env.experiment.scene.dynamic_bodies]
    assert np.array_equal(env.simulation.body_states(names), ours.body_states(names))
    assert worlds().reset()
