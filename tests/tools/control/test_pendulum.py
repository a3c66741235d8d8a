"""Pendulum: the reward is bounded by the work of the law."""

import numpy as np
import pytest
from control_episodes import by_law, make

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.task import Ending


def test_pendulum_returns_at_most_one():
    env = make("Pendulum-Limit-metal")
    assert env.task.limits[0] == pytest.approx(1.0 / (0.3175 * GRAVITY_M_PER_S2))
    for fraction in (0.9, 0.98):
        # At the target x = 1, and the work is 1 / fraction.
        paid, report = by_law(env, fraction)
        assert paid == pytest.approx(2.0 - 1.0 / fraction, abs=2e-3)
        assert report.ratio == pytest.approx(fraction, abs=5e-3)
    paid, report = by_law(env, 1.02)
    assert report.ending is Ending.MISSED
    assert report.reached == 0.0
    assert paid == pytest.approx(1.0 / 1.02, abs=2e-3)


def test_pendulum_braking_is_not_paid_back():
    env = make("Pendulum-Limit-metal")
    env.reset()
    spent = env.step(np.ones(1))[0][3]
    observation = env.step(np.array([-0.5]))[0]
    # It still swings forward.
    assert observation[1] > 0.0
    assert observation[3] == spent > 0.0
