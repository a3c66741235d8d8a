"""Starts scatter as asked at `make` or `reset`, by the seeds of Gymnasium, and in the same way after an autoreset."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import SyncVectorEnv
from places import one_of_a_kind

from gauge_envs import GaugeEnv, Jitter, load_experiment
from gauge_envs.errors import ParameterError
from gauge_envs.references.single_shot import single_shots
from gauge_envs.scene.jitter import perturbed_states
from gauge_envs.scene.states import nominal_states
from gauge_envs.tools.control.tasks import control_tasks

SLIDE = "GAUGE/SlopeSlider-2-wood"
CONTROL = "GAUGE/Carry-Limit-wood"
TOSS = "CubeToss-acrylic"
CALIBRATED_MM = 1e3 * np.array(
    load_experiment(SLIDE).scene.body("cube").pose.position_m
)


def start_mm(env, **reset):
    observation, _ = env.reset(**reset)
    return observation["observable"]


def starts_of_episodes(envs, count, reset, read):
    """The start of every world in each of so many episodes, after one reset."""
    found = [read(envs.reset(**reset)[0])]
    action = np.zeros(envs.action_space.shape, envs.action_space.dtype)
    over = np.zeros(envs.num_envs, dtype=bool)
    latest = found[0].copy()
    begun = np.ones(envs.num_envs, dtype=int)
    while begun.min() < count:
        observations, _, terminations, truncations, _ = envs.step(action)
        latest[over] = read(observations)[over]
        begun[over] += 1
        if over.any():
            found.append(latest.copy())
        over = terminations | truncations
    return np.array(found)


def observable(observations):
    return observations["observable"]


@pytest.mark.parametrize(
    ("arguments", "options", "mode"),
    [
        ({}, {"jitter": True}, "vector_entry_point"),
        ({"jitter": "real"}, None, "sync"),
    ],
    ids=["reset", "make"],
)
def test_starts_scatter_before_and_after_autoreset(arguments, options, mode):
    envs = gym.make_vec(SLIDE, num_envs=3, vectorization_mode=mode, **arguments)
    reset = {"seed": 4, "options": options}
    found = starts_of_episodes(envs, 3, reset, observable)
    apart = np.linalg.norm(found - CALIBRATED_MM, axis=-1)
    assert found.shape == (3, 3, 3)
    assert (apart > 1e-3).all() and (apart < 6.0).all()
    # No two starts are alike, and the first ones are those of the seeds 4, 5 and 6.
    assert len(np.unique(found.reshape(-1, 3).round(6), axis=0)) == 9
    for seed, one in zip((4, 5, 6), found[0], strict=True):
        states = perturbed_states(load_experiment(SLIDE).scene, Jitter(), seed=seed)
        assert one == pytest.approx(1e3 * states[0, :3])
    again = starts_of_episodes(envs, 3, reset, observable)
    assert np.array_equal(again, found)
    # A reset with a seed and no options takes the option back, and not the argument.
    plain = observable(envs.reset(seed=4)[0])
    assert np.allclose(plain, CALIBRATED_MM, atol=1e-6) == (options is not None)


def test_worlds_start_as_single_environments_do():
    sync = SyncVectorEnv([lambda: gym.make(SLIDE, jitter="real")] * 2)
    worlds = gym.make_vec(SLIDE, num_envs=2, jitter="real")
    for one in (sync, worlds):
        one.action_space.seed(0)
    first, second = (
        starts_of_episodes(envs, 3, {"seed": 1}, observable) for envs in (sync, worlds)
    )
    assert np.array_equal(first, second)


@pytest.mark.parametrize(
    "name",
    [
        "SlopeSlider-2-wood",
        "BouncingBall-rubber",
        "Turntable-1-wood",
        "Pendulum-metal",
        "RotatingBall-rayon",
        pytest.param("WallBreaking-wood", marks=pytest.mark.slow),
        pytest.param("TableclothPulling-wood", marks=pytest.mark.slow),
        pytest.param("Funnel-rayon", marks=pytest.mark.slow),
    ],
)
def test_a_start_elsewhere_does_not_depend_on_episodes_before(name):
    scatter = Jitter(velocity_m_per_s=0.01, angular_velocity_rad_per_s=0.01)
    env, anew = GaugeEnv(name, jitter=scatter), GaugeEnv(name, jitter=scatter)
    env.reset(seed=5)
    env.step(env.action_space.sample())
    for one in (env, anew):
        one.reset(seed=6)
        action = np.full(one.action_space.shape, 0.3, one.action_space.dtype)
        for _ in range(4):
            one.step(action)
    first, second = env.trajectory(), anew.trajectory()
    np.testing.assert_allclose(first.samples, second.samples, rtol=0.0, atol=1e-9)
    # The engine starts where the sampler says.
    states = perturbed_states(env.experiment.scene, scatter, seed=6)
    rows = [body.name for body in env.experiment.scene.bodies]
    recorded = [rows.index(body) for body in env.experiment.recorded]
    np.testing.assert_allclose(first.bodies[0], states[recorded], atol=1e-9)
    assert np.abs(states - nominal_states(env.experiment.scene)).max() > 1e-5


def test_starts_stay_without_scatter():
    for envs in (
        gym.make_vec(SLIDE, num_envs=2),
        SyncVectorEnv([lambda: gym.make(SLIDE)] * 2),
    ):
        found = starts_of_episodes(envs, 2, {"seed": 3}, observable)
        assert np.allclose(found, CALIBRATED_MM, atol=1e-6)


def test_seeds_mean_what_gymnasium_says():
    env = gym.make(SLIDE, jitter="real")
    first, again = (
        [start_mm(env, seed=2), *(start_mm(env) for _ in range(3))] for _ in "12"
    )
    assert len(np.unique(np.round(first, 6), axis=0)) == 4
    assert np.array_equal(first, again)
    other = gym.make(SLIDE, jitter="real")
    assert not np.allclose(start_mm(other), start_mm(gym.make(SLIDE, jitter="real")))


def test_an_option_takes_the_argument_back_until_the_next_seed():
    env = gym.make(SLIDE, jitter={"position_m": 0.002, "angle_rad": 0.0})
    assert not np.allclose(start_mm(env, seed=0), CALIBRATED_MM, atol=1e-3)
    for reset in ({"options": {"jitter": False}}, {}):
        assert start_mm(env, **reset) == pytest.approx(CALIBRATED_MM)
        with pytest.raises(ParameterError, match="'reset_mask'"):
            env.reset(options={"reset_mask": [True]})
    assert not np.allclose(start_mm(env, seed=0), CALIBRATED_MM, atol=1e-3)
    assert not np.allclose(start_mm(env, options={}), CALIBRATED_MM, atol=1e-3)


def test_real_starts_of_single_shots_are_recorded_ones():
    shots = single_shots(TOSS)
    recorded = np.array(
        [1e3 * shots.shot(trial).positions_m[0] for trial in shots.trials()]
    )
    env = gym.make(f"GAUGE/{TOSS}", jitter="real")
    found = [start_mm(env, seed=0), *(start_mm(env) for _ in range(5))]
    nearest = np.linalg.norm(recorded[:, None] - found, axis=-1)
    assert nearest.min(axis=0) == pytest.approx(np.zeros(6), abs=1e-3)
    assert len(np.unique(nearest.argmin(axis=0))) > 3
    plain = gym.make(f"GAUGE/{TOSS}")
    assert np.array_equal(start_mm(plain, seed=0), start_mm(plain))


@pytest.mark.parametrize("task", one_of_a_kind(task.id for task in control_tasks()))
def test_control_tasks_scatter_by_seed_and_keep_their_law(task):
    if task.startswith("GAUGE/Fling"):
        with pytest.raises(ParameterError, match="jitter moves no body"):
            gym.make(task, jitter="real")
        return
    env = gym.make(task, jitter="real")
    calibrated = gym.make(task)
    calibrated.reset(seed=7)

    def bodies(one):
        world = one.unwrapped
        return world.simulation.body_states(world.moving)[0, :, :7]

    seen = []
    for reset in ({"seed": 7}, {}, {"seed": 7}):
        env.reset(**reset)
        seen.append(bodies(env))
    assert np.array_equal(seen[0], seen[2])
    assert not np.allclose(seen[0], seen[1], atol=1e-6)
    moved = np.abs(seen[0] - bodies(calibrated)).max()
    assert 1e-6 < moved < 0.02
    over = False
    while not over:
        action = env.unwrapped.law_action(0.95)
        observation, _, terminated, truncated, info = env.step(action)
        assert np.isfinite(observation).all()
        over = terminated or truncated
    assert info["limit"].ratio <= 1.02
    env.reset(seed=7, options={"jitter": False})
    assert np.array_equal(bodies(env), bodies(calibrated))


@pytest.mark.parametrize("task", ["Carry-Limit-wood", "Push-Limit-metal"])
def test_the_way_to_a_goal_is_that_from_the_scattered_start(task):
    env = gym.make(f"GAUGE/{task}", jitter=Jitter(position_m=0.004))
    for seed in range(3):
        env.reset(seed=seed)
        observation, *_ = env.step(np.zeros(2))
        distance_m = np.hypot(*observation[:2])
        assert distance_m == pytest.approx(env.unwrapped.DISTANCE_M, abs=1e-4)


def test_a_throw_is_limited_by_the_height_that_it_starts_from():
    env = gym.make("GAUGE/Throw-Limit-rubber", jitter="real")
    limits = []
    for seed in range(3):
        env.reset(seed=seed)
        limits.append(env.unwrapped.limit.value)
    assert 1e-4 < np.ptp(limits) < 0.01


@pytest.mark.parametrize(
    ("arguments", "options"), [({}, {"jitter": True}), ({"jitter": "real"}, None)]
)
def test_worlds_of_a_control_task_scatter_after_autoreset(arguments, options):
    task = "GAUGE/Throw-Limit-rubber"
    envs = gym.make_vec(task, num_envs=2, **arguments)
    reset = {"seed": 0, "options": options}
    found = starts_of_episodes(envs, 3, reset, np.array)
    starts = found.reshape(-1, found.shape[-1])
    assert len(np.unique(starts.round(9), axis=0)) == len(starts) >= 6


def test_an_environment_with_scatter_is_made_again_from_its_spec():
    for scatter in ("real", Jitter(position_m=0.003), {"angle_rad": 0.01}):
        env = gym.make(SLIDE, jitter=scatter)
        again = gym.make(EnvSpec.from_json(env.spec.to_json()))
        assert np.array_equal(start_mm(again, seed=3), start_mm(env, seed=3))


def test_scatter_that_cannot_be_is_refused(approved):
    cases = {
        "make: realistic": lambda: gym.make(SLIDE, jitter="realistic"),
        "make: 1 mm": lambda: gym.make(SLIDE, jitter=0.001),
        "make: a misspelled field": lambda: gym.make(SLIDE, jitter={"position": 0.001}),
        "make: below zero": lambda: gym.make(SLIDE, jitter={"position_m": -0.001}),
        "make: text": lambda: gym.make(SLIDE, jitter={"position_m": "1mm"}),
        "make: a clamped beam": lambda: gym.make(
            "GAUGE/CantileverBeam-soft", jitter="real"
        ),
        "make_vec: realistic": lambda: gym.make_vec(CONTROL, jitter="realistic"),
        "reset: 1": lambda: gym.make(SLIDE).reset(options={"jitter": 1}),
        "reset of a control task: trial": lambda: gym.make(CONTROL).reset(
            options={"trial": 1}
        ),
    }
    lines = []
    for case, call in cases.items():
        with pytest.raises(ParameterError) as caught:
            call()
        lines.append(f"{case}\n    {caught.value}")
    approved("envs/starts", "\n".join(lines))
