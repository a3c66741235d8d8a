"""Events of a swing (paper, LSD, MTE, PD, EL) against made motions of known rest, rise, period and loss."""

import math

import numpy as np
import pytest
from scipy.special import ellipk
from swings import swung_rad

from gauge_envs import load_experiment, reference_band
from gauge_envs.scoring.estimators import mean_period_s
from gauge_envs.scoring.events import (
    energy_loss,
    event_values,
    longest_stationary_duration,
    momentum_transfer_efficiency,
    oscillation_period,
    swing_times,
)

GRAVITY = 9.81
LENGTH_M = 0.27


def swing(start_deg, frame_count, *, rate_hz=30, **damping):
    """Angle of a pendulum let go at rest [rad]."""
    times_s = np.arange(frame_count) / rate_hz
    start_rad = math.radians(start_deg)
    return swung_rad(times_s, start_rad, square_rate=GRAVITY / LENGTH_M, **damping)


@pytest.fixture(scope="module")
def undamped_rad():
    return swing(-88.2, 920)


def height_mm(angle_rad, length_m=LENGTH_M):
    return 1e3 * length_m * (1 - np.cos(angle_rad))


# --- energy loss -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", [0, 1, 5, 11])
def test_an_exact_pendulum_loses_nothing_from_any_phase(undamped_rad, first):
    """The origin of heights does not matter, nor does a hold before the release."""
    heights = 40.0 + height_mm(undamped_rad[first : first + 600])
    if first == 0:
        heights = np.concatenate((np.full(10, heights[0]), heights))
    # 48 frames have two turning points.
    for count in (48, 600):
        assert abs(energy_loss(heights[:count], rest_height_mm=40.0)) < 2e-6


@pytest.mark.parametrize("damping_per_s", [0.05, -0.02])
def test_energy_loss_is_that_of_the_first_and_last_peak(damping_per_s):
    heights = height_mm(swing(-60.0, 300, damping_per_s=damping_per_s))
    dense = height_mm(swing(-60.0, 9900, damping_per_s=damping_per_s, rate_hz=1000))
    is_peak = (dense[1:-1] > dense[:-2]) & (dense[1:-1] > dense[2:])
    expected = 1 - dense[1:-1][is_peak][-1] / dense[0]
    assert energy_loss(heights, rest_height_mm=0.0) == pytest.approx(expected, abs=1e-5)
    assert math.isnan(energy_loss(heights[:20], rest_height_mm=0.0))


# --- period ----------------------------------------------------------------------------------------------------------


def test_a_period_is_found_between_the_bins_of_the_spectrum(undamped_rad):
    times_s = np.arange(300) / 30
    for phase in (0.0, 0.7, 2.0):
        signal = 25.0 + 7.0 * np.sin(2 * np.pi * times_s / 1.14 + phase)
        assert oscillation_period(signal) == pytest.approx(1.14, rel=1e-4)
    modulus = math.sin(math.radians(88.2) / 2) ** 2
    exact_s = 4 * math.sqrt(LENGTH_M / GRAVITY) * ellipk(modulus)
    period_s = oscillation_period(np.sin(undamped_rad[:300]))
    assert period_s == pytest.approx(exact_s, rel=1e-3)
    assert math.isnan(oscillation_period(np.full(50, 3.0)))


# --- rest and momentum of a cradle -----------------------------------------------------------------------------------


def impulses(*rests, moving=8):
    """Heights with the given numbers of frames at rest, and a swing of 50 mm between each two."""
    hop = 50 * np.sin(np.pi * np.arange(1, moving + 1) / (moving + 1))
    parts = [part for rest in rests for part in (np.zeros(rest), hop)][:-1]
    return np.concatenate(parts)


def steps(speed_mm_per_s):
    """Heights of five frames that differ by one speed, up and down."""
    rest = np.arange(5) % 2 * speed_mm_per_s / 30
    return np.concatenate(([60.0], rest, [60.0]))


DRIFT = np.concatenate(([60.0, 30.0], np.arange(20) * 4 / 30, [-30.0, -60.0]))


@pytest.mark.parametrize(
    ("heights", "frames"),
    [
        # The hold at the start and the cut rest at the end do not count.
        (impulses(40, 9, 12, 7, 30), 12),
        # One frame on a turning point is no period.
        (impulses(20, 1, 1, 20, moving=9), 0),
        # 4 mm/s is slow enough, but after 4 frames the ball has left the range of 0.5 mm.
        (DRIFT, 4),
        (steps(4.9), 5),
        (steps(5.1), 0),
    ],
)
def test_the_longest_rest_between_impulses_is_slow_and_within_the_range(
    heights, frames
):
    assert longest_stationary_duration(heights) == pytest.approx(frames / 30)


def test_swings_begin_and_end_between_samples():
    """The ball rises and falls at 60 mm/s from 1.0 s on; the threshold is 1 mm above rest."""
    times_s = np.arange(0, 4, 1 / 30)
    triangle = np.clip(30 - 60 * np.abs(np.mod(times_s - 1.0, 1.5) - 0.5), 0, None)
    heights = 50.0 + np.where(times_s < 1.0, 0.0, triangle)
    seen = swing_times(times_s, heights, rest_height_mm=50.0)
    assert seen["leaves_s"] == pytest.approx([1 + 1 / 60, 2.5 + 1 / 60], abs=1e-9)
    assert seen["returns_s"] == pytest.approx([2 - 1 / 60, 3.5 - 1 / 60], abs=1e-9)
    assert seen["rests_s"] == pytest.approx([0.5 + 2 / 60], abs=1e-9)
    # A swing that is cut at the end, or is under way at the start, has one end.
    cut = swing_times(times_s[40:90], heights[40:90], rest_height_mm=50.0)
    assert [len(times) for times in cut.values()] == [1, 0, 0]


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.7])
def test_momentum_transfer_finds_the_first_apex_between_frames(phase):
    """A ball at rest is kicked to 81 % of the drop wherever the frames fall; later swings do not count."""
    swing = np.cos(np.pi * (np.arange(60) - phase - 17) / 30)
    heights = 55.0 + 81.0 * np.clip(swing, 0, None)
    heights[40:43] += [30.0, 90.0, 30.0]
    heights[0] += 0.3  # Noise at rest, below the rise that begins a swing.
    drop = {"drop_height_mm": 100.0, "rest_height_mm": 55.0}
    ratio = momentum_transfer_efficiency(heights, **drop)
    assert ratio == pytest.approx(0.9, abs=1e-6)
    for never in (55.0 + np.arange(50) % 2 * 0.1, np.arange(50.0)):
        assert math.isnan(momentum_transfer_efficiency(never, **drop))


# --- scenes ----------------------------------------------------------------------------------------------------------


def test_events_of_a_scene_count_from_its_hinges():
    """An exact pendulum loses nothing; a ball of a cradle at 81 % of the drop has 90 % of the momentum."""
    pendulum = load_experiment("Pendulum-metal")
    band = reference_band(pendulum)
    path = band.mean[band.known]
    events = event_values(pendulum, path)
    swing_mm = path[:, 0] - 1e3 * pendulum.scene.joints[0].anchor_m[0]
    period_s = mean_period_s(np.arange(len(path)) / 30, swing_mm)
    assert events["pd"] == pytest.approx(period_s, rel=0.01)
    assert events["el"] == pytest.approx(0.0, abs=1e-5)
    assert event_values(load_experiment("SlopeSlider-2-wood"), path) == {}
    cradle = load_experiment("NewtonsCradle-metal")
    heights = [body.pose.position_m[2] for body in cradle.scene.dynamic_bodies]
    rest_mm, drop_mm = 1e3 * min(heights), 1e3 * np.ptp(heights)
    hop_mm = 0.81 * drop_mm * np.sin(np.pi * np.arange(13) / 12)
    path = rest_mm + np.concatenate([np.zeros(9), hop_mm, np.zeros(9)])
    events = event_values(cradle, np.tile(path[:, None], 3))
    assert events["mte"] == pytest.approx(0.9, rel=1e-3)
