"""Distance of a simulated trajectory from the mean real one: RMSE, DTW, release offset, z-scores.

A trajectory is a float array of shape [frame_count, coordinate_count] in its observable's unit (mm, rad or mm^2).
NaN is a value that was not measured. Only the real mean may hold it; elsewhere all values must be finite.
"""

import math

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import ArrayLike

from gauge_envs.errors import ShapeError
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scoring.numerics import bounded_minimum, interpolated

MAX_RELEASE_OFFSET_S = 10 / 30
"""Largest time shift of a release alignment in either direction [s]; recorded bodies are released within 9 frames."""

_OFFSET_GRID_S = 1 / 360
_OFFSET_CHUNK = 1_000_000  # numbers in one batch of shifts, 8 MB per array
# The order of a sum changes a total by less than this share. Paths whose costs differ by less are tied.
_TIE = 1e-12


def trajectory_rmse(
    simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False
) -> float:
    """Return the root-mean-square distance between a simulated and the mean real trajectory (paper, E_RMSE).

    The distance of one frame is Euclidean over its measured coordinates. Frames without any are left out.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials at the same frames, same shape and unit; NaN where nothing was measured.
        allow_missing: Accept NaN in the first argument too, for a real trial.

    Returns:
        RMSE in the observable's unit.
    """
    return _rms_of_frames(
        _difference(simulated, real_mean, allow_missing=allow_missing)
    )


def trajectory_dtw(
    simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False
) -> float:
    """Return the mean distance along the optimal dynamic time warping path (paper, E_DTW).

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, shape [real_frame_count, coordinate_count]; NaN where nothing was measured.
        allow_missing: Accept NaN in the first argument too, for a real trial.

    Returns:
        Sum of the Euclidean distances on the path over its number of cells, in the observable's unit.
    """
    cost, path = dtw_path(simulated, real_mean, allow_missing=allow_missing)
    return cost / len(path)


def dtw_path(
    simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False
) -> tuple[float, IntArray]:
    """Return the optimal monotonic alignment of two trajectories, with steps (1, 0), (0, 1) and (1, 1).

    Ties prefer the diagonal. Frames without a measured value are not in the path.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, shape [real_frame_count, coordinate_count]; NaN where nothing was measured.
        allow_missing: Accept NaN in the first argument too, for a real trial.

    Returns:
        The summed Euclidean distance along the path, in the observable's unit, and the path: frame indices (simulated,
        real) from first to last cell, shape [cell_count, 2].
    """
    simulated = _trajectory("simulated", simulated, allow_missing=allow_missing)
    real_mean = _trajectory("real_mean", real_mean, allow_missing=True)
    if simulated.shape[1] != real_mean.shape[1]:
        raise ShapeError(
            f"simulated has {simulated.shape[1]} coordinates, real_mean {real_mean.shape[1]}"
        )
    rows, columns = (
        np.flatnonzero(np.isfinite(frames).any(axis=1))
        for frames in (simulated, real_mean)
    )
    if not (rows.size and columns.size):
        raise ShapeError("simulated and real_mean share no measured entry")
    cells = _optimal_cells(_local_cost(simulated[rows], real_mean[columns]))
    path = np.column_stack((rows[cells[:, 0]], columns[cells[:, 1]]))
    difference = simulated[path[:, 0]] - real_mean[path[:, 1]]
    return float(np.sqrt(np.nansum(np.square(difference), axis=1)).sum()), path


def release_offset(
    times_s: ArrayLike,
    simulated: ArrayLike,
    real_mean: ArrayLike,
    *,
    frame_rate_hz: float = 30.0,
    max_offset_s: float = MAX_RELEASE_OFFSET_S,
) -> tuple[float, float]:
    """Return the constant time shift of the simulation that minimises its RMSE, and the RMSE after the shift.

    A real object is released some frames after the recording starts, a simulated one at time 0. Shifted by s, frame k
    shows the simulated state at time k / frame_rate - s. The state is linear between samples and constant before the
    first one, as before a release. Nothing is assumed after the last sample: a simulation that ends at the last frame
    is not shifted to earlier times, and one that runs on by `max_offset_s` has the whole range. This metric is not in
    the paper. It is reported beside E_RMSE and never replaces it.

    Args:
        times_s: Sample times of the simulation, strictly ascending, time 0 is frame 0, shape [sample_count], s.
        simulated: Simulated trajectory at these times, shape [sample_count, coordinate_count]; denser than the frames
            (180 Hz, say) makes the offset finer.
        real_mean: Mean over real trials at the frames, shape [frame_count, coordinate_count]; NaN where nothing was
            measured.
        frame_rate_hz: Frame rate of the real mean, Hz.
        max_offset_s: Largest shift in both directions, s. Towards earlier times it is at most as long as the simulation
            runs on after the last frame with a mean.

    Returns:
        The offset in s, positive if the real object is released later than the simulated one; and the RMSE after the
        shift in the observable's unit. Of equally good shifts the smallest is chosen, so an object at rest has 0.
    """
    simulated = _trajectory("simulated", simulated)
    real_mean = _trajectory("real_mean", real_mean, allow_missing=True)
    times_s = np.asarray(times_s, dtype=np.float64)
    sample_count, width = simulated.shape
    if (
        times_s.shape != (sample_count,)
        or len(times_s) < 2
        or not (np.diff(times_s) > 0).all()
    ):
        raise ShapeError(
            f"times_s has shape {times_s.shape} for {sample_count} simulated samples: "
            "one strictly ascending time for each of at least two samples is needed"
        )
    if width != real_mean.shape[1]:
        raise ShapeError(
            f"simulated has {width} coordinates, real_mean {real_mean.shape[1]}"
        )
    frame_times_s = np.arange(len(real_mean)) / frame_rate_hz

    # Sums over missing entries stay finite and count for nothing.
    measured = ~np.isnan(real_mean)
    wanted = np.where(measured, real_mean, 0.0)
    frame_count = np.count_nonzero(measured.any(axis=1))
    if frame_count == 0:
        raise ShapeError("simulated and real_mean share no measured entry")

    def shifted_rmse(offsets_s: FloatArray) -> FloatArray:
        shifted = interpolated(frame_times_s - offsets_s[:, None], times_s, simulated)
        shifted -= wanted
        shifted *= measured
        squares = np.einsum("ofc,ofc->o", shifted, shifted)
        return np.asarray(np.sqrt(squares / frame_count))

    steps = math.ceil(max_offset_s / _OFFSET_GRID_S)
    last_s = frame_times_s[np.flatnonzero(measured.any(axis=1))[-1]]
    least_s = -min(max(float(times_s[-1] - last_s), 0.0), max_offset_s)
    grid_s = np.linspace(-max_offset_s, max_offset_s, 2 * steps + 1)
    grid_s = np.sort(np.concatenate([[least_s, 0.0], grid_s[grid_s >= least_s]]))
    # argmin takes the first, hence smallest, of equals.
    grid_s = grid_s[np.argsort(np.abs(grid_s), kind="stable")]
    chunks = np.array_split(
        grid_s, math.ceil(real_mean.size * len(grid_s) / _OFFSET_CHUNK)
    )
    grid_rmse = np.concatenate([shifted_rmse(chunk) for chunk in chunks])
    best = int(grid_rmse.argmin())
    coarse_s, coarse = float(grid_s[best]), float(grid_rmse[best])
    refined_s, least = bounded_minimum(
        shifted_rmse,
        max(coarse_s - _OFFSET_GRID_S, least_s),
        min(coarse_s + _OFFSET_GRID_S, max_offset_s),
        1e-7,
    )
    if least < coarse:
        return float(refined_s), float(least)
    return coarse_s, coarse


def z_scores(
    simulated: ArrayLike, real_mean: ArrayLike, sigma: ArrayLike
) -> FloatArray:
    """Return the deviation of a simulated trajectory from the real mean in units of the real scatter.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, same shape and unit; NaN where nothing was measured.
        sigma: Standard deviation over real trials, same unit, a shape that broadcasts to the same.

    Returns:
        (simulated - real_mean) / sigma, shape [frame_count, coordinate_count]; NaN where nothing was measured, or
        where sigma is 0 or NaN.
    """
    difference = _difference(simulated, real_mean)
    sigma = np.asarray(sigma, dtype=np.float64)
    if (sigma < 0).any():
        raise ShapeError("sigma: a standard deviation is never negative")
    try:
        sigma = np.broadcast_to(sigma, difference.shape)
    except ValueError:
        raise ShapeError(
            f"sigma has shape {sigma.shape}, which does not fit {difference.shape}"
        ) from None
    return difference / np.where(sigma > 0, sigma, np.nan)


def mean_abs_z(z: ArrayLike) -> float:
    """Return the mean |z| over the measured entries; NaN if there are none.

    Args:
        z: Deviations in units of sigma, from `z_scores`, any shape.

    Returns:
        Mean absolute deviation in units of sigma; another normally distributed real trial scores 0.8.
    """
    measured = _measured(z)
    return float(np.abs(measured).mean()) if measured.size else math.nan


def band_coverage(z: ArrayLike, k: float) -> float:
    """Return the share of the measured entries within k sigma; NaN if there are none.

    Args:
        z: Deviations in units of sigma, from `z_scores`, any shape.
        k: Half width of the band in units of sigma.

    Returns:
        Share in [0, 1] of measured entries with |z| <= k.
    """
    measured = _measured(z)
    return float((np.abs(measured) <= k).mean()) if measured.size else math.nan


def signed_error(simulated: ArrayLike, real_mean: ArrayLike) -> FloatArray:
    """Return the mean over frames of simulated minus real, for each coordinate.

    Args:
        simulated: Generalized trajectory, shape [frame_count, coordinate_count], in the observable's unit.
        real_mean: Mean over real trials, same shape and unit; NaN where nothing was measured.

    Returns:
        Signed errors, shape [coordinate_count], in the observable's unit; NaN for a coordinate never measured.
    """
    difference = _difference(simulated, real_mean)
    frame_count = np.isfinite(difference).sum(axis=0)
    return np.nansum(difference, axis=0) / np.where(
        frame_count > 0, frame_count, np.nan
    )


def _trajectory(
    name: str, values: ArrayLike, *, allow_missing: bool = False
) -> FloatArray:
    """Return the values as a checked float array of shape [frame_count, coordinate_count], both above 0."""
    trajectory = np.asarray(values, dtype=np.float64)
    if trajectory.ndim != 2 or trajectory.size == 0:
        raise ShapeError(
            f"{name} has shape {trajectory.shape}; [frame_count, coordinate_count] is needed, none 0"
        )
    wrong = np.isinf(trajectory) if allow_missing else ~np.isfinite(trajectory)
    if wrong.any():
        frame, coordinate = np.argwhere(wrong)[0]
        value = trajectory[frame, coordinate]
        raise ShapeError(
            f"{name} is {value} at frame {frame}, coordinate {coordinate}; a finite number is needed"
        )
    return trajectory


def _difference(
    simulated: ArrayLike, real_mean: ArrayLike, *, allow_missing: bool = False
) -> FloatArray:
    simulated = _trajectory("simulated", simulated, allow_missing=allow_missing)
    real_mean = _trajectory("real_mean", real_mean, allow_missing=True)
    if simulated.shape != real_mean.shape:
        raise ShapeError(
            f"simulated has shape {simulated.shape}, real_mean {real_mean.shape}"
        )
    return simulated - real_mean


def _measured(z: ArrayLike) -> FloatArray:
    z = np.asarray(z, dtype=np.float64)
    return z[~np.isnan(z)]


def _rms_of_frames(difference: FloatArray) -> float:
    frame_count = np.count_nonzero(~np.isnan(difference).all(axis=1))
    if frame_count == 0:
        raise ShapeError("simulated and real_mean share no measured entry")
    return math.sqrt(np.nansum(np.square(difference)) / frame_count)


def _local_cost(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the distances of all pairs of frames over the coordinates measured in both; inf without any."""
    if not (np.isnan(first).any() or np.isnan(second).any()):
        return frame_distances(first, second)
    # Frames with the same missing markers form a block without gaps. There are far fewer blocks than frames.
    cost = np.full((len(first), len(second)), np.inf)
    patterns, block_of = np.unique(np.isfinite(first), axis=0, return_inverse=True)
    others, other_block_of = np.unique(np.isfinite(second), axis=0, return_inverse=True)
    for block, pattern in enumerate(patterns):
        rows = np.flatnonzero(
            block_of.ravel() == block
        )  # NumPy 2.0 alone gives the inverse a second axis
        for other_block, other in enumerate(others):
            columns = np.flatnonzero(other_block_of.ravel() == other_block)
            shared = pattern & other
            if shared.any():
                cost[np.ix_(rows, columns)] = frame_distances(
                    first[np.ix_(rows, shared)], second[np.ix_(columns, shared)]
                )
    return cost


def frame_distances(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the Euclidean distances of all pairs of rows, to 1e-13 of the largest, five times as fast as cdist.

    |a|^2 + |b|^2 - 2 ab is one matrix product. It loses digits for rows that nearly coincide; these are computed again.
    """
    centre = first.mean(axis=0)
    first, second = first - centre, second - centre
    first_squares, second_squares = (
        np.square(first).sum(axis=1),
        np.square(second).sum(axis=1),
    )
    squares = np.column_stack(
        (-2 * first, first_squares, np.ones(len(first)))
    ) @ np.vstack((second.T, np.ones(len(second)), second_squares))
    close = np.flatnonzero(
        squares <= 1e-6 * max(first_squares.max(), second_squares.max())
    )
    if close.size > squares.size // 8:
        from scipy.spatial.distance import cdist

        return cdist(first, second)
    i, j = np.unravel_index(close, squares.shape)
    squares[i, j] = np.square(first[i] - second[j]).sum(axis=1)
    return np.sqrt(squares, out=squares)


def _optimal_cells(local: FloatArray) -> IntArray:
    """Return the cells of the path with the least summed local cost, from (0, 0) to the last, shape [cell_count, 2].

    The cells of one anti-diagonal i + j = d depend on the two before it only, so each anti-diagonal is one vector
    operation. Most of the time is then Python's overhead per operation. Working from both ends at once, with the same
    operations, halves it: the two fronts meet in the middle.
    """
    row_count, column_count = local.shape
    depth = (row_count + column_count + 1) // 2
    # total[d + 2, end, i + 1] holds the local cost, then the least cost of a path from that end to cell (i, d - i).
    # If d - i is no column, the strided read runs into a neighbouring row. It is harmless: left of the matrix the
    # borders of inf keep the total at inf, and a cell right of the matrix is left of it as seen from the other end.
    total = np.full((depth + 2, 2, row_count + 1), np.inf)
    total[0, :, 0] = 0.0
    flat = local.ravel()
    for end, seen in enumerate((flat, flat[::-1])):
        stride = seen.strides[0]
        total[2:, end, 1:] = as_strided(
            seen, (depth, row_count), (stride, (column_count - 1) * stride)
        )
    both = total.reshape(depth + 2, -1)
    least = np.empty(both.shape[1] - 1)
    for up, left, diagonal, here in zip(
        both[1:-1, :-1], both[1:-1, 1:], both[:-2, :-1], both[2:, 1:], strict=True
    ):
        np.minimum(up, left, out=least)
        np.minimum(least, diagonal, out=least)
        here += least

    # Where the fronts meet, the path passes through a cell of the anti-diagonal, or steps diagonally over it.
    meeting = row_count + column_count - 1 - depth
    over = total[meeting + 1, 0, 1:-1] + total[depth, 1, -2:0:-1]
    through = total[meeting + 2, 0, 1:] + least[:row_count:-1]
    joined = np.concatenate((over, through))
    if not np.isfinite(joined.min()):
        raise ShapeError(
            "no alignment of the trajectories exists: some frames share no measured coordinate"
        )
    i = np.concatenate((np.arange(row_count - 1), np.arange(row_count)))
    is_over = np.arange(len(joined)) < len(over)
    j = meeting - is_over - i
    tied = joined <= joined.min() * (1 + _TIE)
    chosen = np.argmin(
        np.where(tied, np.abs(i * (column_count - 1) - j * (row_count - 1)), np.inf)
    )
    cell = np.array([i[chosen], j[chosen]])
    step = int(is_over[chosen])
    last = np.array([row_count - 1, column_count - 1])
    to_start = _walk(total[:, 0], *cell.tolist())
    to_end = _walk(total[:, 1], *(last - cell - step).tolist())
    return np.concatenate((to_start[::-1], (last - to_end)[1 - step :]))


def _walk(total: FloatArray, i: int, j: int) -> IntArray:
    """Return the cells of the cheapest path from (i, j) back to (0, 0), by the table of `_optimal_cells`."""
    cells = [(i, j)]
    table = (
        total.data
    )  # a memoryview gives Python floats, three times as fast here as numpy scalars
    while i or j:
        d = i + j
        up, left = table[d + 1, i], table[d + 1, i + 1]
        if table[d, i] <= (up if up <= left else left) * (1 + _TIE):
            i, j = i - 1, j - 1
        elif up <= left:
            i -= 1
        else:
            j -= 1
        cells.append((i, j))
    return np.array(cells, dtype=np.intp)
