"""Estimators against closed forms: parabolas, slides, bounces of known restitution, pendulums of known period."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy.special import ellipj, ellipk

from gauge_envs.scoring.estimates import rebound
from gauge_envs.scoring.estimators import (
    acceleration_error_m_per_s2,
    acceleration_m_per_s2,
    first_bounce,
    mean_period_s,
    slide_friction,
    speed_at_contact_m_per_s,
    steady_speed_m_per_s,
)

G = 9.81

intervals_s = st.sampled_from((0.001, 1.0 / 180.0, 0.01, 1.0 / 60.0))


# --- along a line ----------------------------------------------------------------------------------------------------


@given(st.floats(-2.0, 2.0), st.floats(-1.0, 1.0), st.floats(-20.0, 20.0), intervals_s)
def test_a_parabola_has_its_acceleration(
    start: float, speed: float, acceleration: float, interval_s: float
) -> None:
    times_s = interval_s * np.arange(60)
    path_m = start + speed * times_s + 0.5 * acceleration * times_s**2
    assert acceleration_m_per_s2(times_s, path_m) == pytest.approx(
        acceleration, abs=1e-6
    )


@pytest.mark.parametrize("step_s", [1.0 / 180.0, 0.01])
def test_a_semi_implicit_step_does_not_bias_an_acceleration(step_s: float) -> None:
    """The scheme falls by g h^2 n (n + 1) / 2, which is a parabola in n."""
    count = np.arange(40)
    assert acceleration_m_per_s2(
        step_s * count, 0.5 * G * step_s**2 * count * (count + 1)
    ) == pytest.approx(G)


def test_the_error_of_an_acceleration_is_its_scatter() -> None:
    """Over many noisy parabolas, the standard deviation of the fits is the mean of their stated errors."""
    rng, times_s = np.random.default_rng(0), np.linspace(0.0, 1.0, 30)
    noisy = [0.5 * 2.6 * times_s**2 + rng.normal(0.0, 1e-3, 30) for _ in range(400)]
    scatter = np.std([acceleration_m_per_s2(times_s, one) for one in noisy], ddof=1)
    stated = np.mean([acceleration_error_m_per_s2(times_s, one) for one in noisy])
    assert stated == pytest.approx(scatter, rel=0.1)


@given(st.floats(0.0, 0.5), st.floats(31.0, 60.0), st.floats(1.0, 20.0))
def test_a_slide_has_its_friction(
    friction: float, slope_deg: float, gravity: float
) -> None:
    slope, times_s = math.radians(slope_deg), np.linspace(0.0, 0.5, 91)
    acceleration = gravity * (math.sin(slope) - friction * math.cos(slope))
    found = acceleration_m_per_s2(times_s, 0.5 * acceleration * times_s**2)
    assert slide_friction(found, slope, gravity_m_per_s2=gravity) == pytest.approx(
        friction, abs=1e-9
    )


def test_a_body_that_hops_down_a_slope_has_the_friction_of_its_impacts() -> None:
    """Its mean force on the slope is m (g cos + b), of which friction is the share mu."""
    slope, friction, lift = math.radians(30.0), 0.3, 0.2
    down = G * math.sin(slope) - friction * (G * math.cos(slope) + lift)
    assert slide_friction(
        down, slope, gravity_m_per_s2=G, lift_m_per_s2=lift
    ) == pytest.approx(friction)


@given(st.floats(-1e-2, 1e-2), st.floats(-1.0, 1.0))
def test_creep_is_the_slope_of_the_path(speed: float, start: float) -> None:
    times_s = np.linspace(0.5, 1.0, 91)
    assert steady_speed_m_per_s(times_s, start + speed * times_s) == pytest.approx(
        speed, abs=1e-12
    )


# --- oscillations ----------------------------------------------------------------------------------------------------


@given(st.floats(0.05, 2.5), st.floats(0.1, 1.0), intervals_s)
def test_a_pendulum_has_the_period_of_the_elliptic_integral(
    amplitude: float, length: float, interval: float
) -> None:
    """sin(phi / 2) = k sn(w t, k^2), with k = sin(amplitude / 2), has the period 4 K(k^2) / w."""
    rate, modulus = math.sqrt(G / length), math.sin(0.5 * amplitude)
    period_s = 4.0 * float(ellipk(modulus**2)) / rate
    times_s = np.arange(0.0, 6.0 * period_s, interval)
    angles = 2.0 * np.arcsin(
        modulus * ellipj(rate * (times_s - 0.123 * period_s), modulus**2)[0]
    )
    # Between two samples a swing bends by (w dt)^2 / 8 at most; near 0, where it passes, by far less.
    assert mean_period_s(times_s, angles) == pytest.approx(period_s, rel=1e-3)


def test_a_body_that_passes_once_has_no_period() -> None:
    assert math.isnan(
        mean_period_s(np.linspace(0.0, 1.0, 11), np.linspace(-1.0, 1.0, 11))
    )


# --- bounces ---------------------------------------------------------------------------------------------------------


def restitution_of_bounce(
    times_s: NDArray[np.float64], heights_m: NDArray[np.float64], **known: float | None
) -> float:
    found = first_bounce(times_s, heights_m, gravity_m_per_s2=G, **known)
    assert found is not None
    return found.restitution


def bounce_heights(
    times_s: NDArray[np.float64], drop_m: float, restitution: float
) -> NDArray[np.float64]:
    """Return the heights over the floor of a ball dropped at time 0 that bounces at once, three times, then lies."""
    speed = math.sqrt(2.0 * G * drop_m)
    start_s, flight_s = -speed / G, 2.0 * speed / G
    heights = np.zeros(len(times_s))
    for _ in range(4):
        since = times_s - start_s
        seen = (since >= 0.0) & (since < flight_s)
        heights[seen] = speed * since[seen] - 0.5 * G * since[seen] ** 2
        start_s, speed = start_s + flight_s, restitution * speed
        flight_s = 2.0 * speed / G
    return heights


def test_a_body_that_stays_in_one_height_flies_no_parabola() -> None:
    """An engine may leave a body in a height to the last bit after its impact: it rose to there, and no farther."""
    times_s = np.arange(0.0, 1.0, 0.01)
    heights = bounce_heights(times_s, 0.5, 0.0)
    is_late = times_s > math.sqrt(2.0 * 0.5 / G) + 0.02
    heights[is_late] = 0.02
    found = restitution_of_bounce(times_s, heights, released_m=0.5)
    assert found == pytest.approx(math.sqrt(0.02 / 0.5))


@given(st.floats(0.15, 1.0), st.floats(0.1, 1.0), intervals_s)
def test_a_bounce_sampled_off_the_contact_has_its_restitution(
    e: float, drop_m: float, interval_s: float
) -> None:
    fall_s = math.sqrt(2.0 * drop_m / G)
    times_s = np.arange(0.0, fall_s * (1.0 + 1.5 * e), interval_s)
    heights = bounce_heights(times_s, drop_m, e)
    if 1.5 * e * fall_s < 6.0 * interval_s:
        return  # Fewer samples than a flight has.
    for released_m in (drop_m, None):
        found = restitution_of_bounce(times_s, heights, released_m=released_m)
        assert found == pytest.approx(e, abs=1e-9)
    met = first_bounce(times_s, heights, gravity_m_per_s2=G, contact_m=None)
    assert met is not None
    assert met.restitution == pytest.approx(e, abs=1e-9)
    assert met.time_s == pytest.approx(fall_s, abs=1e-9)


@given(st.floats(0.3, 0.9), st.floats(2e-3, 2e-2))
def test_a_contact_that_lasts_does_not_change_a_restitution(
    e: float, lasts_s: float
) -> None:
    """The ball sinks by a half sine and leaves with e times the speed, `lasts_s` later."""
    drop_m, interval_s = 0.4, 1.0 / 180.0
    speed, fall_s = math.sqrt(2.0 * G * drop_m), math.sqrt(2.0 * drop_m / G)
    times_s = np.arange(0.0, fall_s * (1.0 + e), interval_s)
    since = times_s - fall_s
    heights = drop_m - 0.5 * G * times_s**2
    inside, after = (since >= 0.0) & (since < lasts_s), since >= lasts_s
    heights[inside] = (
        -speed * lasts_s / math.pi * np.sin(math.pi * since[inside] / lasts_s)
    )
    heights[after] = (
        e * speed * (since[after] - lasts_s) - 0.5 * G * (since[after] - lasts_s) ** 2
    )
    assert restitution_of_bounce(times_s, heights) == pytest.approx(e, abs=1e-9)


def test_noise_averages_out_of_a_restitution() -> None:
    rng, times_s = np.random.default_rng(0), np.arange(0.0, 0.6, 1.0 / 180.0)
    heights = bounce_heights(times_s, 0.4, 0.6)
    found = [
        restitution_of_bounce(times_s, heights + rng.normal(0.0, 1e-4, len(times_s)))
        for _ in range(100)
    ]
    assert np.std(found) < 2e-4
    assert np.mean(found) == pytest.approx(0.6, abs=1e-4)


def test_only_the_flight_up_to_the_second_bounce_counts() -> None:
    times_s = np.arange(0.0, 1.2, 1.0 / 30.0)
    found = first_bounce(times_s, bounce_heights(times_s, 0.4, 0.7), gravity_m_per_s2=G)
    fall_s = math.sqrt(0.8 / G)
    assert found is not None
    assert found.restitution == pytest.approx(0.7, abs=1e-9)
    assert found.until_s == pytest.approx(fall_s * (1.0 + 2.0 * 0.7), abs=2.0 / 30.0)


def test_a_ball_held_before_its_release_has_the_restitution_of_its_flights() -> None:
    times_s = np.arange(0.0, 0.9, 1.0 / 180.0)
    heights = bounce_heights(np.maximum(times_s - 0.1, 0.0), 0.4, 0.6)
    assert restitution_of_bounce(times_s, heights) == pytest.approx(0.6, abs=1e-9)


def test_a_bounce_higher_than_the_drop_is_read_before_its_top() -> None:
    """Twice the speed: the top is 0.61 s after the release, and samples end at 0.5 s."""
    times_s = 0.002 * np.arange(250)
    found = restitution_of_bounce(
        times_s, bounce_heights(times_s, 0.2, 2.0), released_m=0.2
    )
    assert found == pytest.approx(2.0, abs=1e-9)


def test_a_hop_of_few_samples_has_the_height_of_its_highest() -> None:
    heights = np.array([0.2, 0.15, 0.05, 0.0, 0.002, 0.0, 0.0])
    found = restitution_of_bounce(0.01 * np.arange(7), heights, released_m=0.2)
    assert found == pytest.approx(0.1)


def test_a_ball_that_stays_down_has_no_restitution() -> None:
    times_s = np.arange(0.0, 0.5, 0.01)
    found = restitution_of_bounce(times_s, bounce_heights(times_s, 0.2, 0.0))
    assert found == 0.0


@pytest.mark.parametrize("gravity_x", [0.0, -3.0])
@pytest.mark.parametrize(
    ("before_m_per_s", "after_m_per_s"), [(-2.0, 1.2), (-2.0, -1.2), (1.2, 2.4)]
)
def test_an_impact_is_where_a_velocity_reverses(
    before_m_per_s: float, after_m_per_s: float, gravity_x: float
) -> None:
    """A body between two flights over a floor; it is slowed in the second case, and kicked in the third."""
    gravity = np.array([gravity_x, -9.80665])
    times_s = np.arange(81) / 240.0
    since_s = times_s[:, None] - 40.3 / 240.0
    speeds = np.where(since_s < 0.0, before_m_per_s, after_m_per_s)
    metres = np.concatenate([0.7 * since_s, speeds * since_s], axis=1)
    metres += 0.5 * gravity * since_s**2
    found = rebound(times_s, 1e3 * metres, gravity_m_per_s2=gravity)
    if before_m_per_s > 0.0 or after_m_per_s < 0.0:
        assert found is None
        return
    # Gravity acts between the samples whose velocities are compared.
    assert found == pytest.approx(0.6, rel=0.02)
    later = rebound(times_s + 5.0, 1e3 * metres, gravity_m_per_s2=gravity)
    assert later == pytest.approx(found)
    assert rebound(times_s[:4], 1e3 * metres[:4], gravity_m_per_s2=gravity) is None
    assert rebound(times_s, 1e3 * metres, gravity_m_per_s2=-gravity) is None


def test_a_body_that_does_not_fall_has_no_bounce() -> None:
    times_s = np.arange(0.0, 0.5, 0.01)
    assert first_bounce(times_s, np.full(50, 0.2), gravity_m_per_s2=G) is None


def test_a_flight_of_another_gravity_has_a_misfit() -> None:
    times_s = np.arange(0.0, 0.6, 1.0 / 180.0)
    heights = bounce_heights(times_s, 0.4, 0.6)
    right, wrong = (
        first_bounce(times_s, heights, gravity_m_per_s2=gravity)
        for gravity in (G, 2.0 * G)
    )
    assert right is not None
    assert wrong is not None
    assert right.misfit < 1e-9
    assert wrong.misfit > 0.05


def test_the_speed_at_the_contact_is_that_of_the_fall() -> None:
    assert speed_at_contact_m_per_s(0.2, G) == pytest.approx(math.sqrt(2.0 * G * 0.2))
    assert speed_at_contact_m_per_s(-1e-6, G) == 0.0
