"""Arguments and calls that no environment can use are refused, in words that a person has approved."""

from functools import partial

import gymnasium
import numpy as np
import pytest
from approval import refused_calls
from gymnasium.vector import SyncVectorEnv

import gauge_envs
from gauge_envs import GaugeEnv
from gauge_envs.backends import Simulation, backend
from gauge_envs.envs.dm_env import load
from gauge_envs.envs.rollout import Rollout
from gauge_envs.envs.vector import GaugeVectorEnv, ScoreEpisodes
from gauge_envs.errors import ActionError, BackendError, GaugeError, ParameterError
from gauge_envs.runs.request import RunRequest

SLIDE, TURNTABLE = "SlopeSlider-2-wood", "Turntable-1-wood"
MAKE = (gymnasium.make, gymnasium.make_vec)

ARGUMENTS = [
    {"backend": None},
    {"backend": ["mujoco"]},
    {"backend": "mujocoo"},
    {"parameters": {3: 1}},
    {"parameters": "fitted"},
    {"parameters": {"cubes.friction": 0.3}},
    {"parameters": {"cube.frict": 0.3}},
    {"parameters": {"cube.friction": -0.3}},
    {"parameters": {"cube.mass_kg": 0.0}},
    {"parameters": {"cube.position_m": (0.0, 0.0)}},
    {"parameters": {"cube.restitution": float("nan")}},
    {"settings": {3: 1}},
    {"settings": "fast"},
    {"asset": 3},
    {"marker_proxy": "nearest"},
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
    with pytest.raises(TypeError, match="unexpected keyword argument 'backnd'"):
        make(f"GAUGE/{SLIDE}", backnd="mujoco")


def test_calls_are_refused(approved):
    ended = GaugeEnv("SlopeContact-wood")
    ended.reset(seed=0)
    for _ in range(9):
        ended.step(0)
    rendering = {"render_mode": "rgb_array"}
    vector = closed(worlds(**rendering))
    single = closed(GaugeEnv(SLIDE, **rendering))
    calls = {
        "unknown id": lambda: GaugeEnv("SlopeSlider-2-wod"),
        "unknown id of dm_env": lambda: load("SlopeSlider-2-wod"),
        "parameter set of dm_env": lambda: load(SLIDE, parameters="fitted"),
        "reset option of dm_env": lambda: load(SLIDE, options={"x": 1}).reset(),
        "no variant": lambda: GaugeEnv(None),
        "unknown render mode": lambda: GaugeEnv(SLIDE, render_mode="ansi"),
        "window of worlds": lambda: GaugeVectorEnv(SLIDE, render_mode="human"),
        "fine cloth": lambda: GaugeEnv("Funnel-satin", settings={"cell_m": 1 / 300}),
        "reset option": lambda: GaugeEnv(SLIDE).reset(options={"jitterr": True}),
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
        "worlds' step after close": lambda: vector.step([0, 0]),
        "worlds' reset after close": vector.reset,
        "worlds' render after close": vector.render,
        "worlds' step before reset": lambda: worlds().step([0, 0]),
        "3 seeds": lambda: worlds().reset(seed=[1, 2, 3]),
        "constants of one": lambda: worlds(world_parameters=[{}]),
        "constant unknown": lambda: worlds(1, world_parameters=[{"cube.slip": 1.0}]),
        "steps of an episode": lambda: worlds(max_episode_steps=3),
        "scores of no reference": lambda: worlds(
            name="RopeWinding-rubber"
        ).score_arrays(),
        "arrays of sub-environments": lambda: ScoreEpisodes(
            SyncVectorEnv([lambda: GaugeEnv(SLIDE)]), arrays=True
        ),
        "arrays of no reference": lambda: worlds(
            name="RopeWinding-rubber", score_arrays=True
        ),
    }
    approved("envs/calls", refused_calls(GaugeError, calls))


@pytest.mark.usefixtures("rigid_only")
def test_an_id_that_no_engine_builds_says_so_at_make(approved):
    calls = {
        f"{make.__name__} {name}": partial(make, f"GAUGE/{name}")
        for name in ("Funnel-satin", "FoamTwisting-soft", "RopeWinding-rubber")
        for make in MAKE
    }
    approved("envs/unsupported", refused_calls(GaugeError, calls))


def test_numbers_of_worlds_and_requests_are_refused(approved):
    requests = (
        {"seed": "x"},
        {"seed": -1},
        {"repeats": 1.5},
        {"repeats": 0},
        {"jitter": 1},
        {"backend": None},
    )
    calls = {f"num_envs {count!r}": partial(worlds, count) for count in (0, 2.5)}
    calls |= {str(values): partial(RunRequest, SLIDE, **values) for values in requests}
    approved("envs/requests", refused_calls(ParameterError, calls))


NOTHING_DRIVEN = [1, -1, "0", None, 0.5, np.zeros(2), np.nan]
DRIVEN = [[np.nan], [1.5], np.zeros(2), 0.0, "left", None, [np.inf]]
TWO_WORLDS = [0, np.zeros(3, dtype=int), [0, 1], [0.5, 0.0], [0, "up"], None]
TWO_DRIVEN = [[[1.5], [1.5]], [[np.nan], [0.0]], np.zeros((2, 2)), [[0.0], ["x"]]]


def test_wrong_actions():
    cases = (
        (gymnasium.make(f"GAUGE/{SLIDE}").unwrapped, NOTHING_DRIVEN),
        (gymnasium.make(f"GAUGE/{TURNTABLE}").unwrapped, DRIVEN),
        (worlds(), TWO_WORLDS),
        (worlds(name=TURNTABLE), TWO_DRIVEN),
        (load(TURNTABLE), [np.array([2.0])]),
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


class Broken(Simulation):
    """MuJoCo with a fault of the states that it returns.

    Args:
        sound: The engine.
        fault: What it returns instead of an array of states.
    """

    def __init__(self, sound, fault):
        self.sound, self.fault, self.settings = sound, fault, sound.settings

    def reset(self, starts=None, seed=0):
        self.sound.reset(starts, seed)

    def advance(self, seconds):
        self.sound.advance(seconds)

    def body_states(self, names):
        return self.fault(self.sound.body_states(names))

    def close(self):
        self.sound.close()


def changed(place, value):
    def change(states):
        states[0, 0, place] = value
        return states

    return change


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (lambda states: states.tolist(), "a list of shape"),
        (lambda states: states[0], r"shape \(1, 13\).*shape \(1, 1, 13\)"),
        (lambda states: states[..., :12], r"shape \(1, 1, 12\)"),
        (lambda states: states.astype(int), "int64 numbers"),
        (changed(2, np.nan), "nan.* for 'cube' at the start"),
        (changed(slice(3, 7), 1.0), "for 'cube' .*unit quaternion"),
    ],
)
def test_an_engine_that_returns_wrong_states_at_the_start_is_named(fault, words):
    experiment = gauge_envs.load_experiment(SLIDE)
    sound = backend("mujoco").build(experiment.scene)
    with pytest.raises(BackendError, match=rf"Broken\.body_states returned .*{words}"):
        Rollout([experiment], Broken(sound, fault), bands=[None])
