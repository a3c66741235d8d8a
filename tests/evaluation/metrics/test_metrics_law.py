from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.metrics import (
    coefficient_of_determination,
    dynamic_error,
    fitted_acceleration,
    quadratic_form_improvement,
)

TIMES_S = np.arange(20) / 30


@given(acceleration=st.floats(-20, 20), start=st.floats(-5, 5))
def test_acceleration_of_a_parabola_is_its_own(acceleration, start):
    fitted = fitted_acceleration(TIMES_S, start + 0.5 * acceleration * TIMES_S**2)
    assert fitted == pytest.approx(acceleration, abs=1e-9)


def test_quadratic_form_improvement_is_zero_for_a_parabola():
    assert quadratic_form_improvement(TIMES_S, 0.3 + 1.3 * TIMES_S**2) == 0.0


def test_quadratic_form_improvement_is_the_nested_f_statistic():
    rng = np.random.default_rng(0)
    displacement = 1.3 * TIMES_S**2 + 0.4 * TIMES_S**4 + rng.normal(scale=0.01, size=20)
    squares = TIMES_S**2
    sse = [np.sum((displacement - np.polyval(np.polyfit(squares, displacement, n), squares)) ** 2) for n in (1, 2)]
    assert quadratic_form_improvement(TIMES_S, displacement) == pytest.approx((sse[0] - sse[1]) / sse[1] * 17)


def test_quadratic_form_improvement_tells_a_jerk_from_noise():
    rng = np.random.default_rng(1)
    noise = rng.normal(scale=1e-3, size=20)
    assert quadratic_form_improvement(TIMES_S, 1.3 * TIMES_S**2 + noise) < 10
    assert quadratic_form_improvement(TIMES_S, 1.3 * TIMES_S**3 + noise) > 100


@pytest.mark.parametrize("decay_per_s", [0.0, 0.3, 3.0, -0.2])
def test_r2_of_a_damped_oscillation_is_one(decay_per_s):
    times_s = 2.0 + np.arange(150) / 30
    angle = 0.2 + np.exp(-decay_per_s * times_s) * np.cos(5.5 * times_s + 0.4)
    assert coefficient_of_determination(times_s, angle) == pytest.approx(1.0, abs=1e-8)


def test_r2_falls_to_the_share_that_noise_leaves():
    rng = np.random.default_rng(2)
    times_s = np.arange(3000) / 30
    angle = math.sqrt(2) * np.cos(5.5 * times_s) + rng.normal(size=3000)
    assert coefficient_of_determination(times_s, angle) == pytest.approx(0.5, abs=0.03)


def test_r2_of_a_constant_angle_is_nan():
    assert math.isnan(coefficient_of_determination(TIMES_S, np.full(20, 0.3)))


def circle(radius_m, speed_rad_s, times_s):
    return radius_m * np.column_stack((np.cos(speed_rad_s * times_s), np.sin(speed_rad_s * times_s)))


def test_dynamic_error_is_the_force_beyond_friction():
    """On a circle at constant rate all accelerations agree: r w^2, less what three samples at 1 kHz miss of it."""
    times_s = np.arange(500) / 1000
    positions = circle(0.074, 8.0, times_s)
    missing = dynamic_error(times_s, positions, mass_kg=0.1, friction=0.3)
    assert missing == pytest.approx(0.1 * (0.074 * 64 - 0.3 * 9.80665), rel=1e-4)
    assert dynamic_error(times_s, positions, mass_kg=0.1, friction=0.5) == 0.0


def test_dynamic_error_is_exact_for_uneven_times():
    times_s = np.array([0.0, 0.1, 0.15, 0.4, 0.45, 0.7])
    positions = np.column_stack((1.5 * times_s**2, -2.0 * times_s**2))
    assert dynamic_error(times_s, positions, mass_kg=2.0, friction=0.1, gravity=10.0) == pytest.approx(2 * (5 - 1))


@pytest.mark.parametrize(
    "call",
    [
        lambda: fitted_acceleration([0.0, 0.0], [1.0, 2.0]),
        lambda: fitted_acceleration([0.0, 1.0], [1.0]),
        lambda: quadratic_form_improvement([0.0, 1.0, 2.0], [0.0, 1.0, 2.0]),
        lambda: quadratic_form_improvement(TIMES_S, np.full(20, np.nan)),
        lambda: coefficient_of_determination([0.0, 1.0, 2.0, 3.0, 5.0, 6.0], [0.0, 1.0, 0.0, 1.0, 0.0, 1.0]),
        lambda: dynamic_error([0.0, 2.0, 1.0], np.zeros((3, 2)), mass_kg=1.0, friction=0.1),
        lambda: dynamic_error(TIMES_S, np.zeros(20), mass_kg=1.0, friction=0.1),
    ],
)
def test_laws_refuse_series_they_cannot_fit(call):
    with pytest.raises(ShapeError):
        call()
