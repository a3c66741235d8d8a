"""Fling: the law follows from the energy relative to the rod, and no motion of the rod beats it."""

import numpy as np
import pytest
from control_episodes import make, play

from gauge_envs import load_experiment
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.env import play_paid
from gauge_envs.tools.control.fling import FlingLimit
from gauge_envs.tools.control.task import Ending

TRAINING = {"preset": "training"}
SPEED_LEFT, ROD_SPEED = (
    FlingLimit.OBSERVED.index(name)
    for name in ("speed_left_m_per_s", "rod_velocity_y_m_per_s")
)


@pytest.fixture(scope="module")
def env():
    return make("Fling-Limit-satin", settings=TRAINING)


def test_limits_of_the_rod_are_those_of_the_recorded_motion(env):
    """By differences of the motion of the experiment."""
    (motion,) = load_experiment("TextileFlinging-satin").scene.drivers[0].motions
    times_s = np.linspace(0.0, 1.35, 20_001)
    places_m = np.array([motion.value(time) for time in times_s])
    rates = np.gradient(places_m, times_s)
    changes = np.abs(np.diff(rates)).sum()
    rise_m = changes**2 / (2.0 * GRAVITY_M_PER_S2)
    assert env.task.limit().value == pytest.approx(rise_m, rel=1e-3)
    assert env.task.limit().sigma / env.task.limit().value == pytest.approx(
        2.0 * 0.05 / 0.67
    )
    # The recording has 0.67 +- 0.05 m/s, half of the sum.
    assert abs(0.5 * changes - 0.67) < 0.05
    observation, _ = env.reset(seed=0)
    assert observation[SPEED_LEFT] == pytest.approx(changes, rel=1e-3)
    observation, *_ = env.step([1.0])
    largest = np.abs(np.gradient(rates, times_s)).max()
    assert observation[ROD_SPEED] == pytest.approx(largest / 30.0, rel=1e-3)


def test_the_laws_policy_reaches_more_than_half(env):
    paid, report = play_paid(env, lambda _: env.law_action(1.0))
    assert report.ending is Ending.REACHED
    assert 0.55 < report.ratio < 0.6
    assert paid == pytest.approx(report.ratio, abs=1e-9)


def test_a_spent_rod_moves_on_and_an_end_of_the_stroke_loses(env):
    def spending(_):
        phase = np.searchsorted([0.3, 0.9], env.rollout.times_s[0], side="right")
        return np.array([[1.0, -1.0, 0.3][phase]])

    play(env, spending)
    # 0.49 m/s forward and 0.91 m/s back are all of it.
    observed = env.trajectory()
    assert observed[-1, SPEED_LEFT] == 0.0
    turned = 2.0 * observed[9, ROD_SPEED] - observed[0, SPEED_LEFT]
    assert observed[-3:, ROD_SPEED] == pytest.approx(turned)
    assert play(env, lambda _: np.ones(1)).ending is Ending.LOST
    assert env.task.report().reached == 0.0
    assert play(env, lambda _: np.zeros(1)).ending is Ending.MISSED
