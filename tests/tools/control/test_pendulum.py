"""Pendulum: the reward is bounded by the work of the law, and applied torques act as in closed form."""

import math

import numpy as np
import pytest
from control_episodes import by_law, make
from scipy.integrate import solve_ivp

from gauge_envs.backends import backend
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.limit import Ending
from gauge_envs.tools.control.pendulum import PendulumLimit


def engines(name):
    if name == "newton":
        pytest.importorskip("newton")
    return backend(name)


both = pytest.mark.parametrize(
    "engine", ["mujoco", pytest.param("newton", marks=pytest.mark.slow)]
)


def test_pendulum_returns_at_most_one():
    env = make("Pendulum-Limit-metal")
    assert env.limit.value == pytest.approx(1.0 / (0.3175 * GRAVITY_M_PER_S2))
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


@both
def test_applied_torque_swings_the_pendulum(engine):
    scene = PendulumLimit("metal").experiment.scene
    ball, hinge, torque = scene.body("ball"), scene.joints[0], 0.2
    length = math.dist(ball.pose.position_m, hinge.anchor_m)
    inertia = ball.mass_kg * (length**2 + 0.4 * ball.shape.radius_m**2)
    weight = ball.mass_kg * GRAVITY_M_PER_S2 * length
    swing = solve_ivp(
        lambda _, y: [y[1], (torque - weight * math.sin(y[0])) / inertia],
        (0.0, 0.5),
        (0.0, 0.0),
        rtol=1e-9,
        atol=1e-12,
    ).y[:, -1]
    simulation = engines(engine).build(scene)
    simulation.reset(seed=0)
    wrench = [0.0, 0.0, 0.0, *(torque * np.asarray(hinge.axis))]
    simulation.apply_wrench("ball", np.array([wrench]))
    simulation.advance(0.5)
    state = simulation.body_states(["ball"])[0, 0]
    arm = state[:3] - hinge.anchor_m
    assert math.atan2(-arm[0], -arm[2]) == pytest.approx(swing[0], rel=1e-5)
    assert state[11] == pytest.approx(swing[1], rel=1e-4)
    # A reset ends it.
    simulation.reset(seed=0)
    simulation.advance(0.5)
    place_m = simulation.body_states(["ball"])[0, 0, :3]
    assert place_m == pytest.approx(ball.pose.position_m, abs=1e-7)
