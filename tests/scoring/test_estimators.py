"""Estimators against closed forms: parabolas, slides, pendulums of known period, bounces of known restitution."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ellipj

from gauge_envs.scoring.estimates import is_uniformly_accelerated, rebound
from gauge_envs.scoring.estimators import (
    acceleration_error_m_per_s2,
    acceleration_m_per_s2,
    first_bounce,
    hann_mean,
    mean_period_s,
    pendulum_period_s,
    slide_friction,
    steady_speed_m_per_s,
)

G = 9.81

intervals_s = st.sampled_from((0.001, 1.0 / 180.0, 0.01, 1.0 / 60.0))


# --- along a line ----------------------------------------------------------------------------------------------------


@given(st.floats(-2.0, 2.0), st.floats(-1.0, 1.0), st.floats(-20.0, 20.0), intervals_s)
def test_a_parabola_has_its_acceleration_and_a_line_its_speed(
    start, speed, acceleration, interval_s
):
    times_s = interval_s * np.arange(60)
    line_m = start + speed * times_s
    path_m = line_m + 0.5 * acceleration * times_s**2
    estimate = acceleration_m_per_s2(times_s, path_m)
    assert estimate == pytest.approx(acceleration, abs=1e-6)
    assert steady_speed_m_per_s(times_s, line_m) == pytest.approx(speed, abs=1e-9)


def test_the_error_of_an_acceleration_is_its_scatter():
    """Over many noisy parabolas, the standard deviation of the fits is the mean of their estimated errors."""
    rng, times_s = np.random.default_rng(0), np.linspace(0.0, 1.0, 8)
    noisy = [0.5 * 2.6 * times_s**2 + rng.normal(0.0, 1e-3, 8) for _ in range(2000)]
    scatter = np.std([acceleration_m_per_s2(times_s, path) for path in noisy])
    squares = [acceleration_error_m_per_s2(times_s, path) ** 2 for path in noisy]
    assert math.sqrt(np.mean(squares)) == pytest.approx(scatter, rel=0.05)


@pytest.mark.parametrize("lift", [0.0, 0.2])
def test_a_slide_has_its_friction_also_where_it_hops(lift):
    """The mean normal force is m (g cos + b), and friction is mu times that."""
    slope, friction = math.radians(30.0), 0.3
    down = G * math.sin(slope) - friction * (G * math.cos(slope) + lift)
    estimate = slide_friction(down, slope, gravity_m_per_s2=G, lift_m_per_s2=lift)
    assert estimate == pytest.approx(friction)


def test_a_uniform_acceleration_may_start_late_and_misfits_by_at_most_4_percent():
    times_s = np.arange(100) / 100
    late = np.maximum(times_s - 0.3, 0.0)[:, None] ** 2
    assert is_uniformly_accelerated(times_s, 7.0 + late * [300.0, -400.0])
    assert not is_uniformly_accelerated(times_s, np.ones((100, 2)))
    wobble = np.sin(40.0 * times_s)[:, None] * math.sqrt(2.0 * np.mean(late**2))
    for misfit, expected in ((0.037, True), (0.043, False)):
        moved = late + misfit * wobble
        assert is_uniformly_accelerated(times_s, moved) is expected


# --- oscillations ----------------------------------------------------------------------------------------------------


@given(st.floats(0.05, 2.5), st.floats(0.1, 1.0), intervals_s)
def test_a_pendulum_has_the_period_of_the_elliptic_integral(
    amplitude, length, interval
):
    """sin(phi / 2) = k sn(w t, k^2), with k = sin(amplitude / 2)."""
    gyration = 0.3 * length
    rate = math.sqrt(G * length / (length**2 + gyration**2))
    modulus = math.sin(0.5 * amplitude)
    period_s = pendulum_period_s(
        length_m=length,
        gyration_m=gyration,
        amplitude_rad=amplitude,
        gravity_m_per_s2=G,
    )
    times_s = np.arange(0.0, 6.0 * period_s, interval)
    phases = rate * (times_s - 0.123 * period_s)
    angles = 2.0 * np.arcsin(modulus * ellipj(phases, modulus**2)[0])
    # The error of linear interpolation is at most (w dt)^2 / 8, and far less near 0.
    assert mean_period_s(times_s, angles) == pytest.approx(period_s, rel=1e-3)
    assert math.isnan(mean_period_s(times_s[:3], np.array([-1.0, 1.0, 2.0])))


@pytest.mark.parametrize("periods", [2.0, 4.3])
def test_a_hann_mean_is_the_centre_of_an_oscillation(periods):
    angles = 2.0 * np.pi * periods * (np.arange(400) + 0.5) / 400
    values = np.stack([5.0 + np.sin(angles), np.cos(angles)], axis=1)
    assert hann_mean(values) == pytest.approx([5.0, 0.0], abs=0.01)


# --- bounces ---------------------------------------------------------------------------------------------------------


def restitution_of(times_s, heights_m, **known):
    bounce = first_bounce(times_s, heights_m, gravity_m_per_s2=G, **known)
    return bounce.restitution


def bounce_heights(
    times_s,
    drop_m,
    restitution,
    contact_s=0.0,
):
    """Return heights over the floor of a ball dropped at time 0, which sinks in each contact by a half sine."""
    speed = math.sqrt(2.0 * G * drop_m)
    heights = drop_m - 0.5 * G * np.maximum(times_s, 0.0) ** 2
    hit_s = speed / G
    for _ in range(3):
        since_s = times_s - hit_s
        depth = speed * contact_s / math.pi
        inside = (since_s >= 0.0) & (since_s < contact_s)
        heights[inside] = -depth * np.sin(np.pi * since_s[inside] / contact_s)
        speed *= restitution
        flight_s = since_s[since_s >= contact_s] - contact_s
        heights[since_s >= contact_s] = speed * flight_s - 0.5 * G * flight_s**2
        hit_s += contact_s + 2.0 * speed / G
    return np.where(times_s < hit_s, heights, 0.0)


@given(st.floats(0.15, 1.0), st.floats(0.1, 1.0), intervals_s)
def test_a_bounce_sampled_off_the_contact_has_its_restitution(e, drop_m, interval_s):
    fall_s = math.sqrt(2.0 * drop_m / G)
    times_s = np.arange(0.0, fall_s * (1.0 + 1.5 * e), interval_s)
    heights = bounce_heights(times_s, drop_m, e)
    if 1.5 * e * fall_s < 6.0 * interval_s:
        return  # Fewer samples than a flight has.
    for released_m in (drop_m, None):
        restitution = restitution_of(times_s, heights, released_m=released_m)
        assert restitution == pytest.approx(e, abs=1e-9)
    for contact_m in (0.0, None):
        bounce = first_bounce(times_s, heights, gravity_m_per_s2=G, contact_m=contact_m)
        assert bounce.restitution == pytest.approx(e, abs=1e-9)
        assert bounce.misfit < 1e-9


@given(st.floats(0.3, 0.9), st.floats(2e-3, 2e-2))
def test_a_contact_that_lasts_and_a_hold_do_not_change_a_restitution(e, contact_s):
    times_s = np.arange(0.0, 0.1 + 0.286 * (1.0 + e), 1.0 / 180.0)
    heights = bounce_heights(times_s - 0.1, 0.4, e, contact_s)
    assert restitution_of(times_s, heights) == pytest.approx(e, abs=1e-9)


def test_only_the_flight_up_to_the_second_bounce_counts():
    times_s = np.arange(0.0, 1.2, 1.0 / 30.0)
    heights = bounce_heights(times_s, 0.4, 0.7)
    bounce = first_bounce(times_s, heights, gravity_m_per_s2=G)
    assert bounce.restitution == pytest.approx(0.7, abs=1e-9)
    # A parabola with another gravity does not fit.
    wrong = first_bounce(times_s, heights, gravity_m_per_s2=2.0 * G)
    assert wrong.misfit > 0.05


def test_a_bounce_higher_than_the_drop_is_read_before_its_top():
    """Twice the speed: the top is 0.61 s after the release, and samples end at 0.5 s."""
    times_s = 0.002 * np.arange(250)
    heights = bounce_heights(times_s, 0.2, 2.0)
    assert restitution_of(times_s, heights) == pytest.approx(2.0, abs=1e-9)


def test_a_hop_without_a_flight_has_the_height_of_its_highest_sample():
    times_s = 0.01 * np.arange(7)
    hop = np.array([0.2, 0.15, 0.05, 0.0, 0.002, 0.0, 0.0])
    assert restitution_of(times_s, hop, released_m=0.2) == pytest.approx(0.1)
    # An engine may leave a body at a constant height after its impact.
    stays = np.where(np.arange(7) > 3, 0.05, hop)
    assert restitution_of(times_s, stays, released_m=0.2) == pytest.approx(0.5)
    down = np.where(np.arange(7) > 3, 0.0, hop)
    assert restitution_of(times_s, down) == 0.0
    assert first_bounce(times_s, np.full(7, 0.2), gravity_m_per_s2=G) is None


@pytest.mark.parametrize("gravity_x", [0.0, -3.0])
@pytest.mark.parametrize(
    ("before_m_per_s", "after_m_per_s"), [(-2.0, 1.2), (-2.0, -1.2), (1.2, 2.4)]
)
def test_an_impact_is_where_a_velocity_reverses(
    before_m_per_s, after_m_per_s, gravity_x
):
    """A body between two flights over a floor; it is slowed in the second case, and kicked in the third."""
    gravity = np.array([gravity_x, -9.80665])
    times_s = np.arange(81) / 240.0
    since_s = times_s[:, None] - 40.3 / 240.0
    speeds = np.where(since_s < 0.0, before_m_per_s, after_m_per_s)
    metres = np.concatenate([0.7 * since_s, speeds * since_s], axis=1)
    metres += 0.5 * gravity * since_s**2
    restitution = rebound(times_s + 5.0, 1e3 * metres, gravity_m_per_s2=gravity)
    if before_m_per_s > 0.0 or after_m_per_s < 0.0:
        assert restitution is None
        return
    # Gravity acts between the samples whose velocities are compared.
    assert restitution == pytest.approx(0.6, rel=0.02)
    assert rebound(times_s[:4], 1e3 * metres[:4], gravity_m_per_s2=gravity) is None
    assert rebound(times_s, 1e3 * metres, gravity_m_per_s2=-gravity) is None
