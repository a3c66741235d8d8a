"""Closed forms of recipes against integration, and the reading of drops and approaches against exact motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gauge_envs.backends.shared.spring_damper import damping_ratio_of, spring_damper_restitution
from gauge_envs.checks.recipes.closed_forms import friction_of_slide, mujoco_impedance
from gauge_envs.checks.recipes.probes import first_rebound
from gauge_envs.scene import GRAVITY_M_PER_S2 as G


@pytest.mark.parametrize("ratio", [0.05, 0.3, 0.9, 1.0, 2.0])
def test_the_restitution_of_a_spring_and_damper_is_that_of_its_motion(ratio: float) -> None:
    def force(time: float, state: list[float]) -> float:
        return state[0] + 2.0 * ratio * state[1]

    force.terminal, force.direction = True, -1.0  # type: ignore[attr-defined]
    found = solve_ivp(
        lambda time, state: [state[1], -state[0] - 2.0 * ratio * state[1]],
        (0.0, 50.0),
        [1e-12, 1.0],
        events=force,
        rtol=1e-10,
        atol=1e-13,
    )
    assert -found.y_events[0][0][1] == pytest.approx(spring_damper_restitution(ratio), abs=1e-6)


def test_the_damping_ratio_is_the_inverse_of_the_restitution() -> None:
    for restitution in (1.0, 0.9, 0.5, math.exp(-2.0), 0.01):
        assert spring_damper_restitution(damping_ratio_of(restitution)) == pytest.approx(restitution, abs=1e-9)


@pytest.mark.parametrize("restitution", [0.9, 0.6, 0.3])
@pytest.mark.parametrize("step_s", [0.001, 0.01])
def test_a_rebound_is_read_from_the_height_e_squared_h(restitution: float, step_s: float) -> None:
    speed = math.sqrt(2.0 * G * 0.2)
    times = step_s * np.arange(round(0.5 / step_s))
    after = times - speed / G
    rebound = restitution * speed * after - 0.5 * G * after**2
    heights = np.where(after < 0.0, 0.2 - 0.5 * G * times**2, np.maximum(rebound, 0.0))
    assert first_rebound(heights, step_s) == pytest.approx(restitution, abs=1e-6)


def test_a_ball_that_stays_down_has_no_rebound() -> None:
    assert first_rebound(np.array([0.2, 0.15, 0.05, 0.0, 0.0, 0.0]), 0.01) == 0.0


def test_the_friction_of_a_slide_is_that_of_coulomb() -> None:
    slope = math.radians(30.0)
    assert friction_of_slide(G * (math.sin(slope) - 0.4 * math.cos(slope)), slope) == pytest.approx(0.4)


def test_the_impedance_runs_from_d0_to_dwidth() -> None:
    solimp = (0.9, 0.95, 0.001, 0.5, 2.0)
    assert [mujoco_impedance(solimp, depth) for depth in (0.0, 5e-4, 1e-3, 1.0)] == pytest.approx(
        [0.9, 0.925, 0.95, 0.95]
    )
