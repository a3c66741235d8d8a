"""Compute mean, scatter and distances of the trials of one variant."""

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.metrics import trajectory_dtw
from gauge_envs.scoring.user_file.gate import best_shift, rms_over_frames
from gauge_envs.scoring.user_file.motion_checks import filled


def mean_and_sigma(trials: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and sample standard deviation (n - 1) over trials, shape [T, C] each.

    Args:
        trials: The trials, shape [N, T, C]; NaN for missing samples.

    Returns:
        Mean and standard deviation; NaN at a frame at which fewer than half of the trials have one of the coordinates,
        unless they never have it. The standard deviation of a single sample is NaN.
    """
    counts = np.isfinite(trials).sum(axis=0)
    is_often = 2 * counts >= max(len(trials), 1)
    is_often &= (is_often | ~is_often.any(axis=0)).all(axis=1)[:, None]
    mean = np.nansum(trials, axis=0) / np.where(is_often, counts, np.nan)
    squares = np.nansum(np.square(trials - mean), axis=0)
    return mean, np.sqrt(
        squares / np.where(is_often & (counts > 1), counts - 1, np.nan)
    )


def distances_to_mean(
    trials: FloatArray, mean: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return E_RMSE and E_DTW of each trial from the mean of all trials, shape [N] each.

    The mean of these distances is the baseline of the paper. DTW uses frames with a known mean, and lines over lost
    frames.
    """
    rmse = [rms_over_frames(trial - mean) for trial in trials]
    known = np.isfinite(mean).any(axis=0)
    whole = mean[np.isfinite(mean[:, known]).all(axis=1)][:, known]
    dtw = [trajectory_dtw(whole, filled(trial)[:, known]) for trial in trials]
    return np.array(rmse), np.array(dtw)


def leave_one_out_distances(trials: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the RMSE of each trial from the mean of the rest, raw and after a time shift, shape [N] each.

    The mean of all N trials would reduce the distance by the factor (N - 1) / N. The constant time shift minimizes the
    RMSE.
    """
    pairs = []
    for index, trial in enumerate(trials):
        mean, _ = mean_and_sigma(np.delete(trials, index, axis=0))
        aligned, _ = best_shift(filled(trial), mean)
        pairs.append((rms_over_frames(trial - mean), aligned))
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
