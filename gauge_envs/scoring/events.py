"""Events of a swing (paper, LSD, MTE, PD, EL): longest rest, momentum transfer, period, energy loss.

Each function takes evenly sampled coordinates and no reference. It returns NaN for an event that does not happen. The
paper does not define two estimators; `scoring/README.md` defines them.
"""

import math

import numpy as np
from numpy.polynomial import Polynomial

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.scene import Hinge
from gauge_envs.scene.geometry import FloatArray, IntArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.estimators import passes_s

MAX_REST_RANGE_MM = 0.5
"""Largest height minus smallest height of one rest [mm] (paper, LSD)."""

MAX_REST_SPEED_MM_PER_S = 5.0
"""Largest speed of one rest [mm/s] (paper, LSD)."""

LEAVE_HEIGHT_MM = 1.0
"""Height above rest at which a swing begins and ends [mm], more than the noise of a recording."""

# Frames on each side of a turning point that locate it. The polynomial through them has twice that degree. At 30 Hz and
# a period of 1.2 s, 2 frames give an error of 3e-6 in energy. 4 frames would include the impact of a cradle.
_APEX_NEIGHBOURS = 3


def event_values(experiment: Experiment, frames: FloatArray) -> dict[str, float]:
    """Return the events of the first recorded body that an experiment asks for: `lsd`, `mte`, `pd`, `el`.

    Args:
        experiment: The experiment.
        frames: Positions of the recorded bodies at the frames [mm], shape [frame_count, D].

    Returns:
        Values by metric; NaN for an event that does not happen, empty for experiments without events.
    """
    wanted = [metric for metric in experiment.score.metrics if metric in EVENT_METRICS]
    if not wanted:
        return {}
    scene, body = experiment.scene, experiment.recorded[0]
    hinge = next(j for j in scene.joints if isinstance(j, Hinge) and j.body == body)
    arm_m = length_of(np.subtract(scene.body(body).pose.position_m, hinge.anchor_m))
    rest_mm = 1e3 * (hinge.anchor_m[2] - arm_m)
    highest_m = max(scene.body(joint.body).pose.position_m[2] for joint in scene.joints)
    drop_mm = 1e3 * highest_m - rest_mm
    heights_mm = frames[:, 2]
    # The published period uses only the first frames.
    baseline = experiment.baselines.get("pd")
    count = len(frames) if baseline is None else baseline.frames
    signal_mm = frames[:count, "xyz".index(experiment.score.period_axis or "x")]
    functions = {
        "lsd": lambda: longest_stationary_duration(heights_mm),
        "mte": lambda: momentum_transfer_efficiency(
            heights_mm, drop_height_mm=drop_mm, rest_height_mm=rest_mm
        ),
        "pd": lambda: oscillation_period(signal_mm),
        "el": lambda: energy_loss(heights_mm, rest_height_mm=rest_mm),
    }
    return {metric: functions[metric]() for metric in wanted}


def longest_stationary_duration(height_mm: FloatArray) -> float:
    """Return the longest rest of a cradle's ball between two impulses (paper, equation and thresholds of LSD).

    A rest is a run of frames whose height changes at most at the speed limit. Its duration counts the frames of its
    longest part within the height range. A rest at the first frame is the hold before the first impact, and a rest at
    the last frame is cut. Neither counts.

    The paper does not define the speed of its condition. Here it is the speed of the height from frame to frame.

    Args:
        height_mm: Height of the ball at every frame, shape [frame_count], mm.

    Returns:
        Number of frames of the longest rest over the frame rate, s; 0 if the ball never rests between impulses.
    """
    is_slow = np.abs(np.diff(height_mm)) * FRAME_RATE_HZ <= MAX_REST_SPEED_MM_PER_S
    edges = np.diff(np.concatenate(([False], is_slow, [False])).astype(int))
    # Step k joins frames k and k + 1.
    rests = [
        _longest_window(height_mm[first : last + 1], MAX_REST_RANGE_MM)
        for first, last in np.flatnonzero(edges).reshape(-1, 2)
        if first > 0 and last < len(height_mm) - 1
    ]
    longest = max(rests, default=0)
    return longest / FRAME_RATE_HZ if longest >= 2 else 0.0


def swing_times(
    times_s: FloatArray, height_mm: FloatArray, *, rest_height_mm: float
) -> dict[str, FloatArray]:
    """Return when a cradle's last ball leaves the row and returns to it.

    Args:
        times_s: Time of every sample, ascending, shape [sample_count], s.
        height_mm: Height of the last ball, shape [sample_count], mm. The first sample is at rest.
        rest_height_mm: Height of the last ball at rest, mm.

    Returns:
        `leaves_s`, the time at which each swing begins; `returns_s`, the time at which it ends; and `rests_s`, the time
        between a swing and the next. `returns_s` has one entry less if the trajectory ends during a swing.
    """
    over_mm = height_mm - (rest_height_mm + LEAVE_HEIGHT_MM)
    leaves, returns = passes_s(times_s, over_mm)
    # A trajectory that starts above rest begins within a swing, which does not count.
    returns = returns[returns > leaves[0]] if leaves.size else returns[:0]
    rests = leaves[1:] - returns[: len(leaves) - 1]
    return {"leaves_s": leaves, "returns_s": returns, "rests_s": rests}


def momentum_transfer_efficiency(
    height_mm_out: FloatArray,
    *,
    drop_height_mm: float,
    rest_height_mm: float,
) -> float:
    """Return the momentum of the outgoing ball over that of the incoming ball at the first impact (paper, MTE).

    Args:
        height_mm_out: Height of the last ball at every frame, shape [frame_count], mm.
        drop_height_mm: Height of the first ball at its release above its height at rest, mm.
        rest_height_mm: Height of the last ball at rest, mm.

    Returns:
        sqrt(rise / drop) as a ratio; the paper's Table 5 prints percent. The rise is the height of the first maximum
        after the ball leaves rest, located between frames. NaN if the ball never leaves rest, or never turns.
    """
    left = np.flatnonzero(height_mm_out > rest_height_mm + LEAVE_HEIGHT_MM)
    apexes = _turning_points(height_mm_out)
    apexes = apexes[apexes >= left[0]] if left.size else left
    if not apexes.size:
        return math.nan
    rise_mm = _apex_height(height_mm_out, apexes[0]) - rest_height_mm
    return math.sqrt(rise_mm / drop_height_mm)


def oscillation_period(signal: FloatArray) -> float:
    """Return the period of the dominant Fourier component (paper, PD).

    The maximum of the Hann-windowed spectrum is located between the bins: a bin of 300 frames is 0.1 Hz wide, coarser
    than the scatter of real trials.

    Args:
        signal: Coordinate at the 30 Hz frames that swings once per period, shape [frame_count]: the horizontal one of a
            pendulum, as its height swings twice.

    Returns:
        Period, s; NaN for a constant signal.
    """
    if np.ptp(signal) <= 1e-12 * np.abs(signal).max():
        return math.nan
    window = np.hanning(len(signal) + 2)[1:-1]
    windowed = window * (signal - np.average(signal, weights=window))
    padded_count = 8 * len(signal)
    peak = int(np.argmax(np.abs(np.fft.rfft(windowed, padded_count))))
    phase = -2j * np.pi * np.arange(len(signal))

    def negative_power(cycles_per_frame: float) -> float:
        return -abs(np.exp(phase * cycles_per_frame) @ windowed)

    from scipy.optimize import minimize_scalar

    bounds = (peak - 1) / padded_count, min((peak + 1) / padded_count, 0.5)
    minimum = minimize_scalar(negative_power, bounds=bounds, options={"xatol": 1e-10})
    return 1.0 / (float(minimum.x) * FRAME_RATE_HZ)


def energy_loss(height_mm: FloatArray, *, rest_height_mm: float) -> float:
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
    turning_points = _turning_points(height_mm)
    # From rest the drop grows as t^2, fourfold after twice the time. It grows less if the ball falls already.
    first_drop, second_drop = height_mm[0] - height_mm[1:3]
    is_from_rest = 0.0 <= 3.0 * first_drop <= second_drop <= 4.5 * first_drop
    if len(turning_points) + is_from_rest < 2:
        return math.nan
    end_mm = _apex_height(height_mm, turning_points[-1])
    start_mm = float(height_mm[0])
    if not is_from_rest:
        start_mm = _apex_height(height_mm, turning_points[0])
    return (start_mm - end_mm) / (start_mm - rest_height_mm)


def _longest_window(heights: FloatArray, height_range: float) -> int:
    """Return the largest number of consecutive samples within the range."""
    longest = start = 0
    for stop in range(1, len(heights) + 1):
        while np.ptp(heights[start:stop]) > height_range:
            start += 1
        longest = max(longest, stop - start)
    return longest


def local_maxima(values: FloatArray) -> IntArray:
    """Return the samples above the previous one and not below the next one."""
    inner = values[1:-1]
    return 1 + np.flatnonzero((inner > values[:-2]) & (inner >= values[2:]))


def _turning_points(heights: FloatArray) -> IntArray:
    """Return the frames of local maxima with enough neighbours to locate the maximum between frames."""
    maxima, last = local_maxima(heights), len(heights) - 1 - _APEX_NEIGHBOURS
    return maxima[(maxima >= _APEX_NEIGHBOURS) & (maxima <= last)]


def _apex_height(heights: FloatArray, frame: int) -> float:
    """Return the height of the turning point next to a frame, from the polynomial through its neighbours."""
    offsets = np.arange(-_APEX_NEIGHBOURS, _APEX_NEIGHBOURS + 1)
    around = heights[frame + offsets]
    polynomial = Polynomial.fit(offsets, around - heights[frame], 2 * _APEX_NEIGHBOURS)
    turns = polynomial.deriv().roots()
    near = np.append(
        turns[(abs(turns.imag) < 1e-9) & (abs(turns.real) <= 1.0)].real, 0.0
    )
    return float(heights[frame] + polynomial(near).max())
