"""Compute mean, scatter and distances of the trials of one variant."""

import math

import numpy as np
from scipy.optimize import minimize_scalar

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.metrics import (
    MAX_TIME_OFFSET_S,
    interpolated,
    trajectory_dtw,
)

SHIFT_STEP_S = 1.0 / 120.0
"""Step of the grid of time shifts [s]."""

SHIFT_TOLERANCE_S = 1e-7
"""Largest error of the best time shift [s]."""

MIN_OVERLAP = 0.6
"""Smallest share of common frames of a shifted trial and the mean of the remaining trials."""


SHIFTS_S = np.arange(
    -MAX_TIME_OFFSET_S, MAX_TIME_OFFSET_S + 0.5 * SHIFT_STEP_S, SHIFT_STEP_S
)
"""Grid of time shifts, whose best shift is refined [s]."""


def mean_and_sigma(trials: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and sample standard deviation (n - 1) over trials, shape [T, C] each.

    Args:
        trials: The trials, shape [N, T, C]; NaN for missing samples.

    Returns:
        Mean, NaN without a sample; standard deviation, NaN with samples of fewer than two, or half, of the trials.
    """
    is_seen = np.isfinite(trials)
    counts = is_seen.sum(axis=0)
    mean = np.nansum(trials, axis=0) / np.where(counts > 0, counts, np.nan)
    squares = np.nansum(np.square(trials - mean), axis=0)
    is_often = (counts > 1) & (2 * counts >= len(trials))
    return mean, np.sqrt(squares / np.where(is_often, counts - 1, np.nan))


def distances_to_mean(
    trials: FloatArray, mean: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return E_RMSE and E_DTW of each trial from the mean of all trials, shape [N] each.

    The mean of these distances is the baseline of the paper. DTW uses frames with a known mean in all coordinates; it
    is NaN without such frames.
    """
    whole = mean[np.isfinite(mean).all(axis=1)]
    rmse = [rms_over_frames(trial - mean) for trial in trials]
    dtw = [trajectory_dtw(whole, trial) if len(whole) else math.nan for trial in trials]
    return np.array(rmse), np.array(dtw)


def leave_one_out_distances(trials: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the RMSE of each trial from the mean of the rest, raw and after a time shift, shape [N] each.

    The mean of all N trials would reduce the distance by the factor (N - 1) / N. The constant time shift minimizes the
    RMSE. The distance is infinite for a trial with too few frames.
    """
    pairs = []
    for index, trial in enumerate(trials):
        mean, _ = mean_and_sigma(np.delete(trials, index, axis=0))
        raw = _shifted_rmse(0.0, trial, mean)
        pairs.append((raw, _aligned_rmse(trial, mean)))
    raw_rmse, aligned_rmse = np.array(pairs).T
    return raw_rmse, aligned_rmse


def baselines_without(trials: FloatArray) -> FloatArray | None:
    """Return the mean aligned distance of trials, shape [N, T, C], without each of them, shape [N]; None below three.

    The distances depend on each other, because each is from the mean of the others. So only their jackknife gives the
    uncertainty of their mean.
    """
    count = len(trials)
    if count < 3:
        return None
    means = []
    for index in range(count):
        _, distances = leave_one_out_distances(np.delete(trials, index, axis=0))
        means.append(float(distances.mean()))
    return np.array(means)


def _aligned_rmse(trial: FloatArray, mean: FloatArray) -> float:
    """Return the minimum RMSE of a trial from a mean over constant time shifts."""
    rmse = [_shifted_rmse(shift_s, trial, mean) for shift_s in SHIFTS_S]
    best = int(np.argmin(rmse))
    near_s = SHIFTS_S[best] + SHIFT_STEP_S * np.array([-1.0, 1.0])
    finest = minimize_scalar(
        _shifted_rmse,
        args=(trial, mean),
        bounds=np.clip(near_s, -MAX_TIME_OFFSET_S, MAX_TIME_OFFSET_S),
        options={"xatol": SHIFT_TOLERANCE_S},
    )
    return min(rmse[best], float(finest.fun))


def _shifted_rmse(shift_s: float, trial: FloatArray, mean: FloatArray) -> float:
    """Return the RMSE of a trial, shifted in time, from a mean; infinity with too few common frames.

    A body rests before its release, so earlier times have the value of the first sample. Times after the last sample
    are unknown.

    Args:
        shift_s: Delay of the trial [s].
        trial: The trial, shape [T, C].
        mean: Mean of the remaining trials, shape [T, C].
    """
    is_whole = np.isfinite(trial).all(axis=1)
    is_known = np.isfinite(mean).any(axis=1)
    if not is_whole.any():
        return math.inf
    frames_s = np.arange(len(mean)) / FRAME_RATE_HZ
    last_s = frames_s[is_whole][-1]
    is_common = is_known & (frames_s - shift_s <= last_s + 1e-9)
    if is_common.sum() < max(MIN_OVERLAP * is_known.sum(), 1.0):
        return math.inf
    queries_s = frames_s[is_common] - shift_s
    shifted = interpolated(queries_s, frames_s[is_whole], trial[is_whole])
    return rms_over_frames(shifted - mean[is_common])


def rms_over_frames(deviation: FloatArray) -> float:
    """Return the root mean square over frames with a value; NaN without such frames."""
    count = np.isfinite(deviation).any(axis=1).sum()
    return math.sqrt(np.nansum(np.square(deviation)) / count) if count else math.nan
