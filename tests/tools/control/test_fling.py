"""Fling: the law is that of the energy seen from the rod, and no motion of the rod beats it."""

import math

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends.shared.cloth_grid import ClothGrid
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.control.fling import FlingLimit
from gauge_envs.tools.control.limit import Ending
from gauge_envs.tools.control.play import play, play_paid

TRAINING = {"preset": "training"}
TRAINED_RATIO = 0.45
"""What a training must reach: 80 % of the law's policy."""
SPEED_LEFT, ROD_Y, ROD_SPEED = (
    FlingLimit.OBSERVED.index(name)
    for name in ("speed_left_m_per_s", "rod_y_m", "rod_velocity_y_m_per_s")
)


@pytest.fixture(scope="module")
def env():
    return FlingLimit("satin", settings=TRAINING)


def test_limits_of_the_rod_are_those_of_the_recorded_motion(env):
    """By differences of the motion of the experiment."""
    (motion,) = load_experiment("TextileFlinging-satin").scene.drivers[0].motions
    times_s = np.linspace(0.0, 1.35, 20_001)
    places_m = np.array([motion.value(time) for time in times_s])
    rates = np.gradient(places_m, times_s)
    changes = np.abs(np.diff(rates)).sum()
    rise_m = changes**2 / (2.0 * GRAVITY_M_PER_S2)
    assert env.limit.value == pytest.approx(rise_m, rel=1e-3)
    assert env.limit.sigma / env.limit.value == pytest.approx(2.0 * 0.05 / 0.67)
    # The recording has 0.67 +- 0.05 m/s, half of the sum.
    assert abs(0.5 * changes - 0.67) < 0.05
    observation, _ = env.reset(seed=0)
    assert observation[SPEED_LEFT] == pytest.approx(changes, rel=1e-3)
    observation, *_ = env.step([1.0])
    largest = np.abs(np.gradient(rates, times_s)).max()
    assert observation[ROD_SPEED] == pytest.approx(largest / 30.0, rel=1e-3)


def areas_of(env):
    """Return the share of the cloth's mass at each node of the engine's mesh."""
    (cloth,) = env.experiment.scene.deformables
    grid = ClothGrid(cloth, env.simulation.settings["cell_m"])
    assert np.allclose(grid.rest_m, env.rest_nodes_m[cloth.name])
    return grid.vertex_areas_m2() / grid.vertex_areas_m2().sum()


def energies(env, policy):
    """Return sqrt(2 E / M) of the nodes, seen from the rod, and the sum of all changes of the rod's speed [m/s].

    Both are at the middle between two samples, at the frames of an episode.
    """
    areas, (rest_m,) = areas_of(env), env.rest_nodes_m.values()
    seen, squares, spent = [], [], []
    read = env._seen_m

    def look():
        (nodes_m,) = env.nodes_m().values()
        seen.append(nodes_m - [0.0, env._stage.offset[0], 0.0])
        return read()

    env._seen_m = look
    budget = env.reset(seed=0)[0][SPEED_LEFT]
    while not env.is_over:
        observation, *_ = env.step([policy(env.time_s)])
        velocities = (seen[-1] - seen[-2]) / SAMPLE_INTERVAL_S
        height_m = areas @ (0.5 * (seen[-1] + seen[-2]) - rest_m)[:, 2]
        kinetic = areas @ (velocities**2).sum(axis=1)
        squares.append(kinetic + 2.0 * GRAVITY_M_PER_S2 * height_m)
        spent.append(budget - observation[SPEED_LEFT])
    del env._seen_m
    return np.sqrt(np.maximum(squares, 0.0)), np.array(spent)


def stretch_speed(env):
    """Return sqrt(2 e) [m/s]: e is the energy per mass of the start over rest, as the cloth is not stretched yet."""
    env.reset(seed=0)
    for _ in range(60):
        observation, *_ = env.step(np.zeros(1))
    # Half of what gravity gives while the cloth sinks, as in any linear spring.
    return math.sqrt(-GRAVITY_M_PER_S2 * observation[1])


def test_the_cloths_speed_grows_by_no_more_than_the_rods(env):
    """Pushes of random length, in the simulation of the training."""
    stretch, nearest = stretch_speed(env), 0.0
    for seed in range(2):
        ends_s = np.cumsum(np.random.default_rng(seed).uniform(0.05, 0.4, 40))

        def pushes(time_s, ends_s=ends_s):
            return (-1.0) ** int(np.searchsorted(ends_s, time_s))

        speeds, spent = energies(env, pushes)
        assert spent[-1] > 0.5
        assert (speeds <= spent + stretch + 1e-3).all()
        nearest = max(nearest, float((speeds / spent).max()))
    # The law is near: three quarters of a first push are in the cloth.
    assert nearest > 0.7


def test_the_laws_policy_reaches_more_than_half(env):
    paid, report = play_paid(env, lambda _: env.law_action(1.0))
    assert report.ending is Ending.REACHED
    assert TRAINED_RATIO / 0.8 - 0.01 < report.ratio < 0.6
    assert paid == pytest.approx(report.ratio, abs=1e-9)


def test_speed_that_is_not_counted_is_seen(env):
    """A planted fault: the rod gets its speed back until the last push."""

    def refilled(_):
        if env.time_s < 2.0:
            env._stage.speed_changes_left[-1] = env._speed_m_per_s
        return env.law_action(1.5)

    assert play_paid(env, refilled)[0] > 1.0


def test_a_spent_rod_moves_on_and_an_end_of_the_stroke_loses(env):
    def spending(_):
        return np.array(
            [1.0 if env.time_s < 0.3 else -1.0 if env.time_s < 0.9 else 0.3]
        )

    play(env, spending)
    # 0.49 m/s forward and 0.91 m/s back are all of it.
    observed = env.trajectory()
    assert observed[-1, SPEED_LEFT] == 0.0
    turned = 2.0 * observed[9, ROD_SPEED] - observed[0, SPEED_LEFT]
    assert observed[-3:, ROD_SPEED] == pytest.approx(turned)
    assert play(env, lambda _: np.ones(1)).ending is Ending.LOST
    assert env.report().reached == 0.0
    assert play(env, lambda _: np.zeros(1)).ending is Ending.MISSED
