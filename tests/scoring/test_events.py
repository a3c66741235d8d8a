from __future__ import annotations

import math

import numpy as np
import pytest
from swings import swung_rad

from gauge_envs.errors import ShapeError
from gauge_envs.scoring.events import (
    energy_loss,
    longest_stationary_duration,
    momentum_transfer_efficiency,
    oscillation_period,
    swing_times,
)

GRAVITY = 9.81
LENGTH_M = 0.27


def swing(start_deg, frame_count, *, rate_hz=30, **damping):
    """Angle of a pendulum let go at rest, rad."""
    times_s = np.arange(frame_count) / rate_hz
    start_rad = math.radians(start_deg)
    return swung_rad(times_s, start_rad, square_rate=GRAVITY / LENGTH_M, **damping)


@pytest.fixture(scope="module")
def undamped_rad():
    return swing(-88.2, 920)


def height_mm(angle_rad, length_m=LENGTH_M):
    return 1e3 * length_m * (1 - np.cos(angle_rad))


# Energy loss


@pytest.mark.parametrize("first", [0, 1, 5, 11, 18])
def test_energy_loss_is_zero_from_any_phase_of_an_exact_pendulum(undamped_rad, first):
    assert (
        abs(
            energy_loss(
                height_mm(undamped_rad[first : first + 900]), rest_height_mm=0.0
            )
        )
        < 2e-6
    )


def test_energy_loss_is_measured_from_the_height_at_rest(undamped_rad):
    """Ten frames of hold before the release change nothing, nor does the origin of the heights."""
    heights = 40.0 + height_mm(undamped_rad[:600])
    held = np.concatenate((np.full(10, heights[0]), heights))
    assert abs(energy_loss(held, rest_height_mm=40.0)) < 2e-6


def test_energy_loss_of_a_damped_pendulum_is_that_of_its_peaks():
    angle_rad = swing(-60.0, 300, damping_per_s=0.05)
    dense = height_mm(swing(-60.0, 9900, damping_per_s=0.05, rate_hz=1000))
    is_peak = (dense[1:-1] > dense[:-2]) & (dense[1:-1] > dense[2:])
    expected = 1 - dense[1:-1][is_peak][-1] / dense[0]
    assert energy_loss(height_mm(angle_rad), rest_height_mm=0.0) == pytest.approx(
        expected, abs=1e-5
    )
    assert expected > 0.5


def test_energy_loss_of_a_growing_swing_is_negative():
    angle_rad = swing(-30.0, 200, damping_per_s=-0.02)
    assert energy_loss(height_mm(angle_rad), rest_height_mm=0.0) < -0.1


def test_a_fast_start_is_no_turning_point(undamped_rad):
    """Started on its way down, the pendulum first turns on the other side, at full height."""
    heights = height_mm(undamped_rad[4:400])
    assert heights[0] < 0.8 * heights.max()
    assert abs(energy_loss(heights, rest_height_mm=0.0)) < 2e-6


def test_energy_loss_without_two_turning_points_is_nan():
    assert math.isnan(energy_loss(np.linspace(100.0, 0.0, 20), rest_height_mm=0.0))


# Period


def test_period_of_a_sine_is_found_between_the_bins():
    times_s = np.arange(300) / 30
    for phase in (0.0, 0.7, 2.0):
        signal = 25.0 + 7.0 * np.sin(2 * np.pi * times_s / 1.14 + phase)
        assert oscillation_period(signal) == pytest.approx(1.14, rel=1e-4)


def test_period_of_a_large_swing_is_that_of_the_elliptic_integral(undamped_rad):
    from scipy.special import ellipk

    exact_s = (
        4
        * math.sqrt(LENGTH_M / GRAVITY)
        * ellipk(math.sin(math.radians(88.2) / 2) ** 2)
    )
    horizontal = LENGTH_M * np.sin(undamped_rad)
    assert oscillation_period(horizontal[:300]) == pytest.approx(exact_s, rel=1e-3)
    assert oscillation_period(height_mm(undamped_rad)[:300]) == pytest.approx(
        exact_s / 2, rel=1e-3
    )


def test_period_scales_with_the_frame_rate_and_takes_one_coordinate():
    signal = np.sin(np.arange(200) * 0.3)
    assert oscillation_period(signal, frame_rate_hz=60.0) == pytest.approx(
        oscillation_period(signal) / 2
    )
    assert math.isnan(oscillation_period(np.full(50, 3.0)))
    with pytest.raises(ShapeError, match="one coordinate"):
        oscillation_period(np.column_stack((signal, signal)))


# Rest between impulses


def impulses(*rests, moving=8):
    """Heights with the given numbers of frames at rest, a swing of 50 mm between each two."""
    hop = 50 * np.sin(np.pi * np.arange(1, moving + 1) / (moving + 1))
    parts = [part for rest in rests for part in (np.zeros(rest), hop)][:-1]
    return np.concatenate(parts)


def test_stationary_duration_is_the_longest_rest_between_impulses():
    """The hold of 40 frames at the start and the cut rest of 30 at the end do not count."""
    assert longest_stationary_duration(impulses(40, 9, 12, 7, 30)) == pytest.approx(
        12 / 30
    )
    assert longest_stationary_duration(
        impulses(40, 9, 12, 7, 30), frame_rate_hz=60.0
    ) == pytest.approx(12 / 60)


def test_a_ball_that_only_swings_never_rests():
    """An odd number of frames in a swing puts one frame on each turning point: one frame is no period."""
    assert longest_stationary_duration(impulses(20, 1, 1, 20, moving=9)) == 0.0


def test_slow_drift_ends_a_rest_at_the_height_range():
    """4 mm/s is slow enough, but after 4 frames the ball has left the range of 0.5 mm."""
    drift = np.arange(20) * 4 / 30
    heights = np.concatenate(([60.0, 30.0], drift, [-30.0, -60.0]))
    assert longest_stationary_duration(heights) == pytest.approx(4 / 30)


def test_fast_jitter_within_the_height_range_is_no_rest():
    heights = np.concatenate(
        ([60.0, 30.0], 0.2 * (-1.0) ** np.arange(20), [30.0, 60.0])
    )
    assert longest_stationary_duration(heights) == 0.0


# Times of swings


def test_swings_begin_and_end_between_samples():
    """The ball rises and falls at 60 mm/s from 1.0 s on; the threshold is 1 mm above rest."""
    times_s = np.arange(0, 4, 1 / 30)
    triangle = np.clip(30 - 60 * np.abs(np.mod(times_s - 1.0, 1.5) - 0.5), 0, None)
    heights = 50.0 + np.where(times_s < 1.0, 0.0, triangle)
    seen = swing_times(times_s, heights, rest_height_mm=50.0)
    assert seen["leaves_s"] == pytest.approx([1 + 1 / 60, 2.5 + 1 / 60], abs=1e-9)
    assert seen["returns_s"] == pytest.approx([2 - 1 / 60, 3.5 - 1 / 60], abs=1e-9)
    assert seen["rests_s"] == pytest.approx([0.5 + 2 / 60], abs=1e-9)
    cut = swing_times(times_s[:90], heights[:90], rest_height_mm=50.0)
    assert [len(found) for found in cut.values()] == [2, 1, 1]


def test_a_swing_that_is_under_way_at_the_start_is_not_counted():
    times_s = np.arange(6) / 30
    seen = swing_times(times_s, [20.0, 0.0, 0.0, 20.0, 20.0, 0.0], rest_height_mm=0.0)
    assert [len(found) for found in seen.values()] == [1, 1, 0]
    still = swing_times(times_s, np.zeros(6), rest_height_mm=0.0)
    assert [len(found) for found in still.values()] == [0, 0, 0]


# Momentum transfer


@pytest.mark.parametrize("phase_s", [0.0, 0.01, 0.02, 0.03])
@pytest.mark.parametrize("top_deg", [35.0, 80.0])
def test_momentum_transfer_finds_the_apex_between_frames(top_deg, phase_s):
    """A ball at rest, kicked so that it reaches a known height wherever the frames fall; then it hits, and stops."""
    length_m = 0.138
    top_mm = height_mm(math.radians(top_deg), length_m)
    times_s = np.arange(60) / 30 - 0.3 - phase_s
    speed = math.sqrt(2 * GRAVITY * top_mm * 1e-3) / length_m
    angle_rad, swings = np.zeros(60), times_s > 0
    angle_rad[swings] = swung_rad(
        times_s[swings], 0.0, speed, square_rate=GRAVITY / length_m
    )
    landed = swings & (angle_rad < 0)
    angle_rad[np.argmax(landed) :] = 0.0
    heights = 55.0 + height_mm(angle_rad, length_m)
    ratio = momentum_transfer_efficiency(
        heights, drop_height_mm=top_mm / 0.81, rest_height_mm=55.0
    )
    assert ratio == pytest.approx(0.9, abs=2e-5)


def test_momentum_transfer_takes_the_first_swing_only():
    hop = np.sin(np.pi * np.arange(13) / 12)
    heights = np.concatenate(
        (np.zeros(10), 20 * hop, np.zeros(5), 80 * hop, np.zeros(5))
    )
    heights[4] = 0.3  # noise at rest, below the rise that begins a swing
    ratio = momentum_transfer_efficiency(
        heights, drop_height_mm=80.0, rest_height_mm=0.0
    )
    assert ratio == pytest.approx(0.5, rel=1e-6)


def test_momentum_transfer_of_a_ball_that_never_swings_is_nan():
    rng = np.random.default_rng(0)
    noise = rng.normal(scale=0.1, size=50)
    assert math.isnan(
        momentum_transfer_efficiency(noise, drop_height_mm=100.0, rest_height_mm=0.0)
    )
    assert math.isnan(
        momentum_transfer_efficiency(
            np.arange(50.0), drop_height_mm=100.0, rest_height_mm=0.0
        )
    )


@pytest.mark.parametrize(
    "heights", [np.zeros((5, 3)), np.array([0.0, np.nan, 0.0, 0.0]), np.zeros(1)]
)
def test_events_refuse_what_is_not_a_row_of_heights(heights):
    with pytest.raises(ShapeError):
        longest_stationary_duration(heights)
    with pytest.raises(ShapeError):
        momentum_transfer_efficiency(heights, drop_height_mm=1.0, rest_height_mm=0.0)
    with pytest.raises(ShapeError):
        oscillation_period(heights)
    with pytest.raises(ShapeError):
        energy_loss(heights, rest_height_mm=0.0)
