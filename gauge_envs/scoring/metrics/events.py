"""Metrics of a swing (paper, LSD, MTE, PD, EL): longest rest, momentum transfer, period, energy loss.

Each function takes evenly sampled coordinates and no reference. It returns NaN for an event that does not happen, and
raises ShapeError for wrong input. The paper leaves two estimators open. `longest_stationary_duration` and
`spectral_peak_period` also compute the alternatives, so that a report can state what the choice does.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from gauge_envs.errors import ShapeError
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.scoring.numerics import bounded_minimum

# Frames on each side of a turning point that locate it; the polynomial through them has twice that degree. At 30 Hz
# and a period of 1.2 s, a reach of 2 has an error of 3e-6 in energy, and a reach of 4 includes the impact of a cradle.
_APEX_REACH = 3


def longest_stationary_duration(
    height_mm: ArrayLike,
    *,
    path_mm: ArrayLike | None = None,
    central: bool = False,
    frame_rate_hz: float = 30.0,
    height_range_mm: float = 0.5,
    speed_limit_mm_s: float = 5.0,
) -> float:
    """Return the longest rest of a cradle's ball between two impulses (paper, equation and thresholds of LSD).

    A rest is a run of at least two frames whose speed is within the limit. Its duration counts the frames of its
    longest part within the height range. A rest that includes the first frame is the hold before the first impact, and
    one that includes the last frame is cut; neither counts, and `dropped_rests` returns both.

    The paper's condition names a speed and does not define it. By default it is that of the height, from one frame to
    the next. A fast ball at its lowest point differs from a ball at rest by the frames before and after.

    Args:
        height_mm: Height of the ball at every frame, shape [frame_count], mm.
        path_mm: Coordinates whose speed is limited in place of that of the height, shape [frame_count, C], mm.
        central: Take the speed at each frame by central differences, in place of that between consecutive frames.
        frame_rate_hz: Frame rate, Hz.
        height_range_mm: Largest height minus smallest height of one rest, mm.
        speed_limit_mm_s: Largest speed of one rest, mm/s.

    Returns:
        Number of frames of the longest rest over the frame rate, s; 0 if the ball never rests between impulses.
    """
    heights = _samples("height_mm", height_mm, least=2)
    path = heights[:, None] if path_mm is None else _path(path_mm, len(heights))
    speeds = _speeds(path, frame_rate_hz, central=central)
    rests = _rests(speeds <= speed_limit_mm_s, central=central)
    inner = [
        heights[rest] for rest in rests if rest.start > 0 and rest.stop < len(heights)
    ]
    frame_count = max(
        (_longest_window(rest, height_range_mm) for rest in inner), default=0
    )
    return frame_count / frame_rate_hz if frame_count >= 2 else 0.0


def dropped_rests(
    height_mm: ArrayLike,
    *,
    frame_rate_hz: float = 30.0,
    height_range_mm: float = 0.5,
    speed_limit_mm_s: float = 5.0,
) -> tuple[float, float]:
    """Return the rests at the first and at the last frame, which `longest_stationary_duration` does not count.

    Args:
        height_mm: Height of the ball at every frame, shape [frame_count], mm.
        frame_rate_hz: Frame rate, Hz.
        height_range_mm: Largest height minus smallest height of one rest, mm.
        speed_limit_mm_s: Largest speed of the height in one rest, mm/s.

    Returns:
        Durations of both, s; 0 where the trajectory does not start or end with a rest. A ball that never moves has one
        rest, which is both.
    """
    heights = _samples("height_mm", height_mm, least=2)
    speeds = _speeds(heights[:, None], frame_rate_hz, central=False)
    rests = _rests(speeds <= speed_limit_mm_s, central=False)

    def duration_s(rest: slice) -> float:
        return _longest_window(heights[rest], height_range_mm) / frame_rate_hz

    first = next((duration_s(rest) for rest in rests if rest.start == 0), 0.0)
    last = next((duration_s(rest) for rest in rests if rest.stop == len(heights)), 0.0)
    return first, last


@dataclass(frozen=True, kw_only=True)
class SwingTimes:
    """Times of the swings of a cradle's last ball.

    Attributes:
        leaves_s: Time at which each swing begins, s.
        returns_s: Time at which each swing ends, s; one less than `leaves_s` if the trajectory ends during a swing.
        rests_s: Time between the end of a swing and the start of the next, s.
    """

    leaves_s: tuple[float, ...]
    returns_s: tuple[float, ...]
    rests_s: tuple[float, ...]


def swing_times(
    times_s: ArrayLike,
    height_mm: ArrayLike,
    *,
    rest_height_mm: float,
    leave_height_mm: float = 1.0,
) -> SwingTimes:
    """Return when a cradle's last ball leaves the row and returns to it.

    Args:
        times_s: Time of every sample, ascending, shape [sample_count], s.
        height_mm: Height of the last ball, shape [sample_count], mm. The first sample is at rest.
        rest_height_mm: Height of the last ball at rest, mm.
        leave_height_mm: Rise above rest that separates a swing from a rest, mm.
    """
    heights = _samples("height_mm", height_mm, least=2) - (
        rest_height_mm + leave_height_mm
    )
    times = _samples("times_s", times_s, least=2)
    if len(times) != len(heights):
        raise ShapeError(
            f"times_s has {len(times)} entries, height_mm has {len(heights)}"
        )
    before = np.flatnonzero((heights[:-1] > 0) != (heights[1:] > 0))
    share = heights[before] / (heights[before] - heights[before + 1])
    crossings = times[before] + share * (times[before + 1] - times[before])
    rising = heights[before + 1] > 0
    leaves, returns = crossings[rising], crossings[~rising]
    # A trajectory that starts above rest ends a swing that it does not begin.
    returns = returns[returns > leaves[0]] if leaves.size else returns[:0]
    rests = leaves[1:] - returns[: len(leaves) - 1]
    return SwingTimes(
        leaves_s=tuple(leaves.tolist()),
        returns_s=tuple(returns.tolist()),
        rests_s=tuple(rests.tolist()),
    )


def momentum_transfer_efficiency(
    height_mm_out: ArrayLike,
    *,
    drop_height_mm: float,
    rest_height_mm: float,
    leave_height_mm: float = 1.0,
) -> float:
    """Return the momentum of the outgoing ball over that of the incoming ball at the first impact (paper, MTE).

    Args:
        height_mm_out: Height of the last ball at every frame, shape [frame_count], mm.
        drop_height_mm: Height of the first ball at its release above its height at rest, mm.
        rest_height_mm: Height of the last ball at rest, mm.
        leave_height_mm: Rise above rest that begins the outgoing swing, larger than the noise of a recording, mm.

    Returns:
        sqrt(rise / drop) as a ratio; the paper's Table 5 prints percent. The rise is that of the first maximum after
        the ball leaves rest, located between frames. NaN if the ball never leaves rest, or never turns.
    """
    height_mm_out = _samples("height_mm_out", height_mm_out, least=2)
    if not drop_height_mm > 0:
        raise ShapeError(
            f"drop_height_mm is {drop_height_mm}; the first ball starts above its rest"
        )
    left = np.flatnonzero(height_mm_out > rest_height_mm + leave_height_mm)
    apexes = _turning_points(height_mm_out)
    apexes = apexes[apexes >= left[0]] if left.size else left
    if not apexes.size:
        return math.nan
    return math.sqrt(
        (_apex_height(height_mm_out, apexes[0]) - rest_height_mm) / drop_height_mm
    )


def oscillation_period(signal: ArrayLike, *, frame_rate_hz: float = 30.0) -> float:
    """Return the period of the dominant Fourier component (paper, PD).

    The maximum of the Hann-windowed spectrum is located between the bins. A bin of 300 frames is 0.1 Hz wide, which is
    coarser than the scatter of real trials.

    Args:
        signal: One coordinate that swings once per period, shape [frame_count], any unit. For a pendulum it is the
            horizontal coordinate, as the height swings twice per period.
        frame_rate_hz: Frame rate, Hz.

    Returns:
        Period, s; NaN for a constant signal.
    """
    signal = _samples("signal", signal, least=4)
    if np.ptp(signal) <= 1e-12 * np.abs(signal).max():
        return math.nan
    window = np.hanning(len(signal) + 2)[1:-1]
    windowed = window * (signal - np.average(signal, weights=window))
    padded_count = 8 * len(signal)
    peak = int(np.argmax(np.abs(np.fft.rfft(windowed, padded_count))))
    phase = -2j * np.pi * np.arange(len(signal))

    def negative_power(cycles_per_frame: FloatArray) -> FloatArray:
        waves = np.exp(phase * cycles_per_frame[:, None])
        return np.asarray(-np.abs(waves @ windowed))

    low, high = (peak - 1) / padded_count, min((peak + 1) / padded_count, 0.5)
    found, _ = bounded_minimum(negative_power, low, high, 1e-10)
    return 1 / (float(found) * frame_rate_hz)


def spectral_peak_period(signal: ArrayLike, *, frame_rate_hz: float = 30.0) -> float:
    """Return the period of the strongest bin of the plain Fourier spectrum: no window, nothing between the bins.

    The period is the duration of the signal over a whole number. For 300 frames at 30 Hz and a period near 1.1 s, the
    only values are 1.00, 1.11, 1.25 and 1.43 s.

    Args:
        signal: One coordinate that swings once per period, shape [frame_count], any unit.
        frame_rate_hz: Frame rate, Hz.

    Returns:
        Period, s; NaN for a constant signal.
    """
    signal = _samples("signal", signal, least=4)
    if np.ptp(signal) <= 1e-12 * np.abs(signal).max():
        return math.nan
    spectrum = np.abs(np.fft.rfft(signal - signal.mean()))
    return len(signal) / (frame_rate_hz * (1 + int(np.argmax(spectrum[1:]))))


def energy_loss(height_mm: ArrayLike, *, rest_height_mm: float) -> float:
    """Return the share of energy that a pendulum loses between its first and last turning point (paper, EL).

    At a turning point all energy is potential, so heights are enough. A trajectory that starts from rest has its first
    turning point at frame 0. Other turning points are located between frames, which needs three frames on both sides.
    The ideal value is 0, and a gain of energy is negative. The paper's remark that 1 is best contradicts its formula.

    Args:
        height_mm: Height of the pendulum's ball at every frame, shape [frame_count], mm.
        rest_height_mm: Height of the ball at its lowest point, mm.

    Returns:
        (E_start - E_end) / E_start; NaN for fewer than two turning points.
    """
    height_mm = _samples("height_mm", height_mm, least=3)
    turning_points = _turning_points(height_mm)
    # From rest the drop grows as t^2, fourfold after twice the time. It grows less if the ball falls already.
    first_drop, second_drop = height_mm[0] - height_mm[1:3]
    if first_drop >= 0 and 3.0 * first_drop <= second_drop <= 4.5 * first_drop:
        start_mm, remaining = float(height_mm[0]), turning_points
    elif turning_points.size:
        start_mm, remaining = (
            _apex_height(height_mm, turning_points[0]),
            turning_points[1:],
        )
    else:
        return math.nan
    if not remaining.size:
        return math.nan
    if start_mm <= rest_height_mm:
        raise ShapeError(
            f"height_mm turns at {start_mm:.3f} mm, not above rest_height_mm {rest_height_mm:.3f}"
        )
    return (start_mm - _apex_height(height_mm, remaining[-1])) / (
        start_mm - rest_height_mm
    )


def _samples(name: str, values: ArrayLike, *, least: int) -> FloatArray:
    samples = np.asarray(values, dtype=np.float64)
    if samples.ndim != 1 or len(samples) < least:
        raise ShapeError(
            f"{name} has shape {samples.shape}; one coordinate of at least {least} frames is needed"
        )
    if not np.isfinite(samples).all():
        frame = np.flatnonzero(~np.isfinite(samples))[0]
        raise ShapeError(
            f"{name} is {samples[frame]} at frame {frame}; a finite number is needed"
        )
    return samples


def _path(path_mm: ArrayLike, frame_count: int) -> FloatArray:
    path = np.asarray(path_mm, dtype=np.float64)
    if path.ndim != 2 or len(path) != frame_count:
        raise ShapeError(
            f"path_mm has shape {path.shape}; [{frame_count}, C] is needed, as height_mm has its frames"
        )
    if not np.isfinite(path).all():
        raise ShapeError("path_mm holds a value that is not finite")
    return path


def _speeds(path: FloatArray, frame_rate_hz: float, *, central: bool) -> FloatArray:
    """Return the speed at each frame, shape [frame_count], or between frames, shape [frame_count - 1]."""
    velocities = np.gradient(path, axis=0) if central else np.diff(path, axis=0)
    return np.linalg.norm(velocities, axis=1) * frame_rate_hz


def _rests(slow: BoolArray, *, central: bool) -> list[slice]:
    """Return the frames of each run of slow frames, or of slow steps: step k joins frames k and k + 1."""
    edges = np.flatnonzero(
        np.diff(np.concatenate(([False], slow, [False])).astype(int))
    ).reshape(-1, 2)
    return [
        slice(int(first), int(stop) + (0 if central else 1)) for first, stop in edges
    ]


def _longest_window(heights: FloatArray, height_range: float) -> int:
    """Return the largest number of consecutive samples within the range."""
    longest = start = 0
    for stop in range(1, len(heights) + 1):
        while np.ptp(heights[start:stop]) > height_range:
            start += 1
        longest = max(longest, stop - start)
    return longest


def _turning_points(heights: FloatArray) -> IntArray:
    """Return the frames of the local maxima that have enough neighbours to be located between frames."""
    inner = heights[1:-1]
    maxima = np.flatnonzero((inner > heights[:-2]) & (inner >= heights[2:])) + 1
    return maxima[(maxima >= _APEX_REACH) & (maxima < len(heights) - _APEX_REACH)]


def _apex_height(heights: FloatArray, frame: int) -> float:
    """Return the height of the turning point next to a frame, from the polynomial through its neighbours."""
    offsets = np.arange(-_APEX_REACH, _APEX_REACH + 1)
    around = heights[frame + offsets]
    polynomial = Polynomial.fit(offsets, around - heights[frame], 2 * _APEX_REACH)
    _, least = bounded_minimum(lambda offset: -polynomial(offset), -1.0, 1.0, 1e-9)
    return float(heights[frame] - least)
