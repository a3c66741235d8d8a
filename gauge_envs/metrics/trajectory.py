"""How far a simulated trajectory is from the mean real one: RMSE, DTW, release offset, z-scores.

A trajectory is a float array of shape [frame_count, coordinate_count] in its observable's unit (mm, rad or mm^2).
NaN says "not measured" and is allowed in the real mean only; elsewhere a value that is not finite is an error.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial.distance import cdist

from gauge_envs.errors import ShapeError

__all__ = [
    "band_coverage",
    "dtw_path",
    "mean_abs_z",
    "release_offset",
    "signed_error",
    "trajectory_dtw",
    "trajectory_rmse",
    "z_scores",
]

FloatArray = NDArray[np.float64]

_OFFSET_GRID_S = 1e-3


def trajectory_rmse(simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False) -> float:
    """Root-mean-square distance between a simulated and the mean real trajectory (paper, equation of E_RMSE).

    The distance of one frame is Euclidean over the coordinates measured in it; frames with none are left out.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials at the same frames, same shape and unit; NaN where nothing was measured.
        allow_missing: Accept NaN in the first argument too, as a real trial has; baselines need it.

    Returns:
        RMSE in the observable's unit.

    Raises:
        ShapeError: The two differ in shape, hold a value that is not finite where that is not allowed, or share no
            measured entry.
    """
    return _rms_of_frames(_difference(simulated, real_mean, allow_missing=allow_missing))


def trajectory_dtw(simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False) -> float:
    """Mean distance along the optimal dynamic time warping path (paper, equation of E_DTW).

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, shape [real_frame_count, coordinate_count]; NaN where nothing was measured.
        allow_missing: Accept NaN in the first argument too, as a real trial has.

    Returns:
        Sum of the Euclidean distances on the path over its number of cells, in the observable's unit.

    Raises:
        ShapeError: As for `dtw_path`.
    """
    cost, path = dtw_path(simulated, real_mean, allow_missing=allow_missing)
    return cost / len(path)


def dtw_path(
    simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False
) -> tuple[float, NDArray[np.intp]]:
    """Optimal monotonic alignment of two trajectories, steps (1, 0), (0, 1) and (1, 1); ties prefer the diagonal.

    Frames with nothing measured take no part in the alignment, and so never appear in the path.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, shape [real_frame_count, coordinate_count]; NaN where nothing was measured.
        allow_missing: Accept NaN in the first argument too, as a real trial has.

    Returns:
        The summed Euclidean distance along the path, in the observable's unit, and the path: frame indices (simulated,
        real) from first to last cell, shape [cell_count, 2].

    Raises:
        ShapeError: The two differ in coordinates, hold a value that is not finite where that is not allowed, or no
            path joins frames that share a measured coordinate.
    """
    simulated = _trajectory("simulated", simulated, allow_missing=allow_missing)
    real_mean = _trajectory("real_mean", real_mean, allow_missing=True)
    if simulated.shape[1] != real_mean.shape[1]:
        raise ShapeError(f"simulated has {simulated.shape[1]} coordinates, real_mean {real_mean.shape[1]}")
    rows, columns = (np.flatnonzero(np.isfinite(frames).any(axis=1)) for frames in (simulated, real_mean))
    local = _local_cost(simulated[rows], real_mean[columns])
    cells = _optimal_cells(local)
    cost = float(local[cells[:, 0], cells[:, 1]].sum())
    if not math.isfinite(cost):
        raise ShapeError("simulated and real_mean: no alignment exists, some frames share no measured coordinate")
    return cost, np.column_stack((rows[cells[:, 0]], columns[cells[:, 1]]))


def release_offset(
    times_s: ArrayLike,
    simulated: ArrayLike,
    real_mean: ArrayLike,
    *,
    frame_rate_hz: float = 30.0,
    max_offset_s: float = 10 / 30,
) -> tuple[float, float]:
    """Constant time shift of the simulation that minimises its RMSE, and the RMSE that is left after it.

    Recorded objects are let go some frames after the recording starts, simulated ones at time zero. Shifted by s, the
    simulation shows at frame k its state of time k / frame_rate - s: linear between samples, held at its first value
    before it starts and at its last after it ends. Not in the paper; reported beside E_RMSE, never instead.

    Args:
        times_s: Sample times of the simulation, strictly ascending, time 0 is frame 0, shape [sample_count], s.
        simulated: Simulated trajectory at these times, shape [sample_count, coordinate_count]; denser than the frames
            (180 Hz, say) makes the offset finer.
        real_mean: Mean over real trials at the frames, shape [frame_count, coordinate_count]; NaN: not measured.
        frame_rate_hz: Frame rate of the real mean, Hz.
        max_offset_s: Largest shift tried to either side, s.

    Returns:
        The offset in s, positive when the real object is released later than the simulated one, and the aligned RMSE
        in the observable's unit. Among equal shifts the smallest wins, so an object at rest has offset 0.

    Raises:
        ShapeError: Times and simulation disagree, fewer than two samples, times not ascending, coordinates differ, a
            simulated value is not finite, or nothing was measured.
    """
    simulated = _trajectory("simulated", simulated)
    real_mean = _trajectory("real_mean", real_mean, allow_missing=True)
    times_s = np.asarray(times_s, dtype=np.float64)
    if times_s.shape != simulated.shape[:1] or len(times_s) < 2 or not (np.diff(times_s) > 0).all():
        raise ShapeError(
            f"times_s has shape {times_s.shape} for {len(simulated)} simulated samples: "
            "one strictly ascending time for each of at least two samples is needed"
        )
    if simulated.shape[1] != real_mean.shape[1]:
        raise ShapeError(f"simulated has {simulated.shape[1]} coordinates, real_mean {real_mean.shape[1]}")
    frame_times_s = np.arange(len(real_mean)) / frame_rate_hz

    def shifted_rmse(offset_s: float) -> float:
        return _rms_of_frames(_resample(times_s, simulated, frame_times_s - offset_s) - real_mean)

    steps = math.ceil(max_offset_s / _OFFSET_GRID_S)
    grid_s = np.linspace(-max_offset_s, max_offset_s, 2 * steps + 1)
    grid_s = grid_s[np.argsort(np.abs(grid_s), kind="stable")]  # argmin takes the first, hence smallest, of equals
    grid_rmse = [shifted_rmse(offset_s) for offset_s in grid_s]
    best = int(np.argmin(grid_rmse))
    bounds = np.clip(grid_s[best] + np.array([-_OFFSET_GRID_S, _OFFSET_GRID_S]), -max_offset_s, max_offset_s)
    refined = minimize_scalar(shifted_rmse, bounds=bounds, method="bounded", options={"xatol": 1e-7})
    if refined.fun < grid_rmse[best]:
        return float(refined.x), float(refined.fun)
    return float(grid_s[best]), grid_rmse[best]


def z_scores(simulated: ArrayLike, real_mean: ArrayLike, sigma: ArrayLike) -> FloatArray:
    """Deviation of a simulated trajectory from the real mean in units of the real scatter.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, same shape and unit; NaN where nothing was measured.
        sigma: Standard deviation over real trials, a shape that broadcasts to the same, same unit.

    Returns:
        (simulated - real_mean) / sigma, shape [frame_count, coordinate_count]; NaN where nothing was measured or
        sigma is 0 or NaN, so that no scale exists.

    Raises:
        ShapeError: Shapes do not agree, a simulated value is not finite, or a sigma is negative.
    """
    difference = _difference(simulated, real_mean)
    sigma = np.asarray(sigma, dtype=np.float64)
    if (sigma < 0).any():
        raise ShapeError("sigma: a standard deviation is never negative")
    try:
        sigma = np.broadcast_to(sigma, difference.shape)
    except ValueError:
        raise ShapeError(f"sigma has shape {sigma.shape}, which does not fit {difference.shape}") from None
    return difference / np.where(sigma > 0, sigma, np.nan)


def mean_abs_z(z: ArrayLike) -> float:
    """Mean |z| over the entries that have one; NaN where none has.

    Args:
        z: Deviations in units of sigma, from `z_scores`, any shape.

    Returns:
        Mean absolute deviation in units of sigma; 0.8 is what one more normally distributed real trial would score.
    """
    measured = _measured(z)
    return float(np.abs(measured).mean()) if measured.size else math.nan


def band_coverage(z: ArrayLike, k: float) -> float:
    """Share of the entries inside the band of +-k sigma; NaN where no entry has a z.

    Args:
        z: Deviations in units of sigma, from `z_scores`, any shape.
        k: Half width of the band in units of sigma.

    Returns:
        Share in [0, 1] of measured entries with |z| <= k.
    """
    measured = _measured(z)
    return float((np.abs(measured) <= k).mean()) if measured.size else math.nan


def signed_error(simulated: ArrayLike, real_mean: ArrayLike) -> FloatArray:
    """Mean over frames of simulated minus real, for each coordinate: which way the simulation is off.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, same shape and unit; NaN where nothing was measured.

    Returns:
        Signed errors, shape [coordinate_count], in the observable's unit; NaN for a coordinate never measured.

    Raises:
        ShapeError: The two differ in shape, or a simulated value is not finite.
    """
    difference = _difference(simulated, real_mean)
    frame_count = np.isfinite(difference).sum(axis=0)
    return np.nansum(difference, axis=0) / np.where(frame_count > 0, frame_count, np.nan)


def _trajectory(name: str, values: ArrayLike, *, allow_missing: bool = False) -> FloatArray:
    """The values as a checked float array of shape [frame_count, coordinate_count], neither of them 0."""
    trajectory = np.asarray(values, dtype=np.float64)
    if trajectory.ndim != 2 or trajectory.size == 0:
        raise ShapeError(f"{name} has shape {trajectory.shape}; [frame_count, coordinate_count] is needed, none 0")
    wrong = np.isinf(trajectory) if allow_missing else ~np.isfinite(trajectory)
    if wrong.any():
        frame, coordinate = np.argwhere(wrong)[0]
        value = trajectory[frame, coordinate]
        raise ShapeError(f"{name} is {value} at frame {frame}, coordinate {coordinate}; a finite number is needed")
    return trajectory


def _difference(simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False) -> FloatArray:
    simulated = _trajectory("simulated", simulated, allow_missing=allow_missing)
    real_mean = _trajectory("real_mean", real_mean, allow_missing=True)
    if simulated.shape != real_mean.shape:
        raise ShapeError(f"simulated has shape {simulated.shape}, real_mean {real_mean.shape}")
    return simulated - real_mean


def _measured(z: ArrayLike) -> FloatArray:
    z = np.asarray(z, dtype=np.float64)
    return z[~np.isnan(z)]


def _rms_of_frames(difference: FloatArray) -> float:
    frame_count = np.count_nonzero(~np.isnan(difference).all(axis=1))
    if frame_count == 0:
        raise ShapeError("simulated and real_mean share no measured entry")
    return math.sqrt(np.nansum(np.square(difference)) / frame_count)


def _resample(times_s: FloatArray, trajectory: FloatArray, query_s: FloatArray) -> FloatArray:
    """Linear interpolation of all coordinates at once, held at both ends; exact where neighbours are equal."""
    left = np.clip(np.searchsorted(times_s, query_s, side="right") - 1, 0, len(times_s) - 2)
    weight = np.clip((query_s - times_s[left]) / (times_s[left + 1] - times_s[left]), 0.0, 1.0)
    return trajectory[left] + weight[:, None] * (trajectory[left + 1] - trajectory[left])


def _local_cost(first: FloatArray, second: FloatArray) -> FloatArray:
    """Euclidean distances of all pairs of frames over the coordinates measured in both; inf where there are none."""
    if not (np.isnan(first).any() or np.isnan(second).any()):
        return cdist(first, second)
    # Frames with the same markers missing form a block that cdist handles exactly; blocks are few, frames many.
    cost = np.full((len(first), len(second)), np.inf)
    patterns, block_of = np.unique(np.isfinite(first), axis=0, return_inverse=True)
    others, other_block_of = np.unique(np.isfinite(second), axis=0, return_inverse=True)
    for block, pattern in enumerate(patterns):
        rows = np.flatnonzero(block_of == block)
        for other_block, other in enumerate(others):
            columns = np.flatnonzero(other_block_of == other_block)
            shared = pattern & other
            if shared.any():
                cost[np.ix_(rows, columns)] = cdist(first[np.ix_(rows, shared)], second[np.ix_(columns, shared)])
    return cost


def _optimal_cells(local: FloatArray) -> NDArray[np.intp]:
    """Cells of the path with the least summed local cost, from (0, 0) to the last, shape [cell_count, 2]."""
    row_count, column_count = local.shape
    if local.size == 0:
        raise ShapeError("simulated and real_mean share no measured entry")
    # Cells of one anti-diagonal i + j = d depend on the two before it only, so each is a single vector operation.
    # total[d + 2, i + 1] is the least cost of reaching (i, d - i); the borders of inf spare all special cases.
    flat = local.ravel()
    total = np.full((row_count + column_count + 1, row_count + 1), np.inf)
    total[0, 0] = 0.0
    for d in range(row_count + column_count - 1):
        low, high = max(0, d - column_count + 1), min(d, row_count - 1) + 1
        # (i, d - i) lies at flat index i * column_count + d - i: one stride for the whole anti-diagonal.
        step = max(column_count - 1, 1)
        start = low * (column_count - 1) + d
        costs = flat[start : start + (high - low - 1) * step + 1 : step]
        here = total[d + 2, low + 1 : high + 1]
        np.minimum(total[d + 1, low : high], total[d + 1, low + 1 : high + 1], out=here)
        np.minimum(here, total[d, low:high], out=here)
        here += costs
    cells = []
    i, j = row_count - 1, column_count - 1
    while True:
        cells.append((i, j))
        if i == j == 0:
            return np.array(cells[::-1], dtype=np.intp)
        d = i + j
        diagonal, up, left = total[d, i], total[d + 1, i], total[d + 1, i + 1]
        if diagonal <= up and diagonal <= left and i > 0 and j > 0:
            i, j = i - 1, j - 1
        elif i > 0 and (j == 0 or up <= left):
            i -= 1
        else:
            j -= 1
