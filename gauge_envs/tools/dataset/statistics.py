"""Mean, scatter and distances of the trials of one variant."""

import math

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.metrics import (
    MAX_TIME_OFFSET_S,
    interpolated,
    trajectory_dtw,
)

SHIFT_STEP_S = 1.0 / 120.0
"""Step of the grid of time shifts [s]; the best one is refined."""

REFINEMENTS, REFINED_POINTS = 8, 9
"""Number of finer grids about the best shift, and their points: the last step is 1.3e-7 s."""

MIN_OVERLAP = 0.6
"""Smallest share of frames that a shifted trial must have in common with the mean of the others."""


def mean_and_sigma(trials: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and sample standard deviation (n - 1) over trials, shape [T, C] each.

    Args:
        trials: The trials, shape [N, T, C]; NaN is a missing sample.

    Returns:
        The mean is NaN without a sample, the standard deviation with samples of fewer than two, or half, of the trials.
    """
    is_seen = np.isfinite(trials)
    counts = is_seen.sum(axis=0)
    total = np.where(is_seen, trials, 0.0).sum(axis=0)
    mean = total / np.where(counts > 0, counts, np.nan)
    squares = np.where(is_seen, np.square(trials - mean), 0.0).sum(axis=0)
    is_often = (counts > 1) & (2 * counts >= len(trials))
    return mean, np.sqrt(squares / np.where(is_often, counts - 1, np.nan))


def distances_to_mean(
    trials: FloatArray, mean: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return E_RMSE and E_DTW of each trial to the mean of all, shape [N] each; the paper's baseline is their mean.

    DTW leaves out frames whose mean is not known in all coordinates; it is NaN where no frame is left.
    """
    whole = mean[np.isfinite(mean).all(axis=1)]
    rmse = [rms_over_frames(trial - mean) for trial in trials]
    dtw = [trajectory_dtw(whole, trial) if len(whole) else math.nan for trial in trials]
    return np.array(rmse), np.array(dtw)


def distances_to_others(trials: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the RMSE of each trial to the mean of the others, raw and after a time shift, shape [N] each.

    A trial is nearer to a mean of N that it is part of, by the factor (N - 1) / N. The shift is the constant one with
    the least RMSE. A trial with too few frames for a distance has infinity.
    """
    pairs = [
        _raw_and_aligned(trial, mean_and_sigma(np.delete(trials, index, axis=0))[0])
        for index, trial in enumerate(trials)
    ]
    raw, aligned = np.array(pairs).T
    return raw, aligned


def _raw_and_aligned(trial: FloatArray, mean: FloatArray) -> tuple[float, float]:
    """Return the RMSE of a trial to a mean, raw and after the best time shift."""
    is_whole = np.isfinite(trial).all(axis=1)
    if not is_whole.any():
        return math.inf, math.inf
    frames_s = np.arange(len(mean)) / FRAME_RATE_HZ
    times_s = frames_s[is_whole]
    is_known = np.isfinite(mean).any(axis=1)
    min_count = max(MIN_OVERLAP * is_known.sum(), 1.0)

    def shifted_rmse(shifts_s: FloatArray) -> FloatArray:
        queries_s = frames_s - shifts_s[:, None]
        # A body rests before its release, so earlier times have the first sample. Later ones are unknown.
        is_usable = is_known & (queries_s <= times_s[-1] + 1e-9)
        apart = interpolated(queries_s, times_s, trial[is_whole]) - mean
        squares = np.nansum(np.square(apart), axis=2, where=is_usable[:, :, None])
        counts = is_usable.sum(axis=1)
        rmse = np.sqrt(squares.sum(axis=1) / np.maximum(counts, 1))
        return np.where(counts >= min_count, rmse, math.inf)

    step_count = round(MAX_TIME_OFFSET_S / SHIFT_STEP_S)
    grid_s = SHIFT_STEP_S * np.arange(-step_count, step_count + 1, dtype=np.float64)
    coarse = shifted_rmse(grid_s)
    raw, best = float(coarse[step_count]), int(coarse.argmin())
    low_s, high_s = grid_s[best] - SHIFT_STEP_S, grid_s[best] + SHIFT_STEP_S
    least = float(coarse[best])
    for _ in range(REFINEMENTS):
        # The next grid covers the two intervals about the least value of this one.
        grid_s = np.linspace(low_s, high_s, REFINED_POINTS)
        refined = shifted_rmse(grid_s)
        best = int(refined.argmin())
        least = min(least, float(refined[best]))
        low_s, high_s = grid_s[max(best - 1, 0)], grid_s[min(best + 1, len(grid_s) - 1)]
    return raw, least


def rms_over_frames(deviation: FloatArray) -> float:
    """Return the root mean square over frames with a value; NaN without any."""
    count = np.isfinite(deviation).any(axis=1).sum()
    return math.sqrt(np.nansum(np.square(deviation)) / count) if count else math.nan
