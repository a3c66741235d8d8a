"""Distances of a simulated trajectory from the mean real one: RMSE, DTW, time offset (paper, section on metrics).

A trajectory is a float array of shape [frame_count, coordinate_count] in its observable's unit (mm, rad or mm^2).
NaN is a value that was not measured. Only the real mean may have NaN.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.errors import ShapeError
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, frame_times_s

MAX_TIME_OFFSET_S = 10 / 30
"""Largest time shift of the alignment in either direction [s]. Recorded bodies are released within 9 frames."""

FRAME_TOLERANCE_S = 1e-4
"""Largest time between a 30 Hz frame and the sample that stands for it [s]."""

OFFSET_STEP_S = 1 / 360
"""Step of the grid of time shifts [s]; the search refines the best one."""

OFFSET_TOLERANCE_S = 1e-9
"""Tolerance of a refined time shift [s]."""

MIN_OVERLAP = 0.6
"""Smallest share of the known frames that a time shift compares, as for real trials."""

ROUNDING_S = 1e-9
"""Rounding error of a time [s]."""

TIE = 1e-12
"""Relative difference of two path costs, or of two RMSE, that count as equal; a sum in another order changes less."""


def trajectory_rmse(simulated: ArrayLike, real_mean: ArrayLike) -> float:
    """Return the root-mean-square distance of a simulated from the mean real trajectory (paper, E_RMSE).

    E_RMSE = sqrt((1/T) sum_t |g(t) - r(t)|^2), with the Euclidean norm over measured coordinates.

    Args:
        simulated: g(t), shape [frame_count, coordinate_count].
        real_mean: Mean over real trials at the same frames, same shape and unit; NaN where nothing was measured.

    Raises:
        ShapeError: A simulated value is not finite, or nothing was measured.
    """
    first, second = _trajectories(simulated, real_mean)
    return float(rms_deviation(first - second))


def rms_deviation(deviation: FloatArray) -> FloatArray:
    """Return the root mean square over frames with a known value of a deviation, shape [..., T, C]; NaN is unknown."""
    is_unknown = np.isnan(deviation)
    counts = (~is_unknown.all(axis=-1)).sum(axis=-1)
    squares = np.square(deviation)
    squares[is_unknown] = 0.0
    return np.asarray(np.sqrt(squares.sum(axis=(-2, -1)) / counts))


def trajectory_dtw(simulated: ArrayLike, real_mean: ArrayLike) -> float:
    """Return the mean distance along the optimal dynamic time warping path (paper, E_DTW).

    The path has steps (1, 0), (0, 1) and (1, 1) and the smallest sum of distances. Ties take the diagonal.

    Args:
        simulated: g(t), shape [frame_count, coordinate_count].
        real_mean: Mean over real trials, shape [real_frame_count, coordinate_count]; NaN where nothing was measured.
            Frames without a measured value do not count.

    Raises:
        ShapeError: A simulated value is not finite, or nothing was measured.
    """
    first, second = _trajectories(simulated, real_mean)
    local = _frame_distances(first, second[np.isfinite(second).any(axis=1)])
    total = _path_costs(local)
    row, column = local.shape
    distances = []
    while row and column:
        distances.append(local[row - 1, column - 1])
        up, left = total[row + column - 1, row - 1 : row + 1]
        if total[row + column - 2, row - 1] <= min(up, left) * (1.0 + TIE):
            row, column = row - 1, column - 1
        elif up <= left:
            row -= 1
        else:
            column -= 1
    return float(np.mean(distances[::-1]))


def _frame_distances(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the Euclidean distances of all pairs of frames over measured coordinates, shape [T1, T2]."""
    is_measured = np.isfinite(second)
    means = np.where(is_measured, second, 0.0)
    deviations = ((frame - means) * is_measured for frame in first)
    return np.sqrt([np.einsum("ij,ij->i", rows, rows) for rows in deviations])


def _path_costs(local: FloatArray) -> FloatArray:
    """Return the smallest summed cost of a path to each cell, shape [T1 + T2 + 1, T1 + 1].

    The cells of an anti-diagonal depend only on the two anti-diagonals before it. So each is one vector operation, and
    the cell (i, j), counted from 1, is in row i + j and column i of the result.
    """
    row_count, column_count = local.shape
    total = np.full((row_count + column_count + 1, row_count + 1), np.inf)
    total[0, 0] = 0.0
    for row, costs in enumerate(local, start=1):
        total[row + 1 : row + 1 + column_count, row] = costs
    for before, last, cells in zip(total, total[1:], total[2:], strict=False):
        cells[1:] += np.minimum(np.minimum(last[:-1], last[1:]), before[:-1])
    return total


def time_offset(
    times_s: ArrayLike,
    simulated: ArrayLike,
    real_mean: ArrayLike,
    *,
    earliest_s: float = -MAX_TIME_OFFSET_S,
) -> tuple[float, float]:
    """Return the constant time shift of the simulation that minimises its RMSE, and the RMSE after the shift.

    A real object is released some frames after the recording starts, and a simulated one at time 0. After a shift by s,
    frame k shows the simulated state at time k / 30 Hz - s, see `shifted_frames`. The RMSE compares the frames that
    both motions have, at least 60 % of the known ones. The distances of real trials follow the same rule.

    Args:
        times_s: Sample times of the simulation, strictly ascending, time 0 is frame 0, shape [sample_count], s.
        simulated: g(t) at these times, shape [sample_count, coordinate_count].
        real_mean: Mean over real trials at the 30 Hz frames, shape [frame_count, coordinate_count].
        earliest_s: Smallest shift [s].

    Returns:
        The offset [s] and the RMSE after the shift. The offset is positive if the real object is released later than
        the simulated one. Of equally good shifts it is the smallest, so an object at rest has 0.

    Raises:
        ShapeError: The times are not strictly ascending, or nothing was measured.
    """
    values, real = _trajectories(simulated, real_mean)
    times = np.asarray(times_s, dtype=np.float64)
    if not (np.diff(times) > 0).all():
        raise ShapeError("times_s: strictly ascending times are needed")
    known = np.flatnonzero(np.isfinite(real).any(axis=1))
    needed = known[math.ceil(MIN_OVERLAP * len(known)) - 1]
    earliest_s = max(earliest_s, needed / FRAME_RATE_HZ - float(times[-1]))

    def shifted_rmse(offset_s: FloatArray) -> FloatArray:
        shifted = shifted_frames(times, values, offset_s, frame_count=len(real))
        return rms_deviation(shifted - real)

    return best_offset(shifted_rmse, earliest_s)


def best_offset(
    shifted_rmse: Callable[[FloatArray], FloatArray],
    earliest_s: float = -MAX_TIME_OFFSET_S,
) -> tuple[float, float]:
    """Return the time shift with the smallest RMSE, from a grid and a search next to its best shift, and the RMSE."""
    from scipy.optimize import minimize_scalar

    step_count = round(MAX_TIME_OFFSET_S / OFFSET_STEP_S)
    grid_s = OFFSET_STEP_S * np.arange(-step_count, step_count + 1, dtype=np.float64)
    grid_s = np.append(grid_s[grid_s > earliest_s], earliest_s)
    # Of equal minima, the first is the smallest shift.
    grid_s = grid_s[np.argsort(np.abs(grid_s))]
    grid_rmse = shifted_rmse(grid_s)
    best = int(np.argmax(grid_rmse <= grid_rmse.min() * (1.0 + TIE)))
    offset_s, rmse = float(grid_s[best]), float(grid_rmse[best])
    # Samples and frames are on the grid, so the RMSE is smooth on each side of its best shift.
    for side_s in (-OFFSET_STEP_S, OFFSET_STEP_S):
        ends_s = np.sort([grid_s[best], grid_s[best] + side_s])
        minimum = minimize_scalar(
            shifted_rmse,
            bounds=np.clip(ends_s, earliest_s, MAX_TIME_OFFSET_S),
            options={"xatol": OFFSET_TOLERANCE_S},
        )
        if minimum.fun < rmse * (1.0 - TIE):
            offset_s, rmse = float(minimum.x), float(minimum.fun)
    return offset_s, rmse


def shifted_frames(
    times_s: FloatArray,
    values: FloatArray,
    offset_s: ArrayLike,
    *,
    frame_count: int,
) -> FloatArray:
    """Return the 30 Hz frames of a motion after a time shift, shape [..., frame_count, C].

    A body rests before its release, so earlier frames have the first sample. Frames after the last sample are NaN.

    Args:
        times_s: Times of the samples [s], strictly ascending, shape [sample_count].
        values: Samples, shape [sample_count, C].
        offset_s: Delays of the motion [s], any shape.
        frame_count: Number of frames.
    """
    delays_s = np.asarray(offset_s)[..., None]
    queries_s = frame_times_s(frame_count) - delays_s
    frames = interpolated(queries_s, times_s, values)
    frames[queries_s > times_s[-1] + ROUNDING_S] = np.nan
    return frames


def nearest_sample(times_s: FloatArray, queries_s: FloatArray) -> IntArray:
    """Return the index of the sample nearest to each of some times [s]."""
    return np.searchsorted(0.5 * (times_s[1:] + times_s[:-1]), queries_s)


def frame_index(
    times_s: FloatArray, frame_count: int, *, name: str = "trajectory"
) -> IntArray:
    """Return the index of the sample nearest to each 30 Hz frame, shape [frame_count].

    Raises:
        ShapeError: A frame has no sample within 0.1 ms (`FRAME_TOLERANCE_S`), before or after it.
    """
    frames_s = frame_times_s(frame_count)
    index = nearest_sample(times_s, frames_s)
    missing = np.abs(times_s[index] - frames_s) > FRAME_TOLERANCE_S
    if missing.any():
        frame = int(missing.argmax())
        raise ShapeError(
            f"{name} needs {frame_count} frames at 30 Hz: no sample at frame {frame} (t = {frames_s[frame]:.4f} s)"
        )
    return index


def interpolated(
    queries_s: FloatArray, times_s: FloatArray, values: FloatArray
) -> FloatArray:
    """Return values that are linear between samples and constant before and after them, shape [..., C].

    Args:
        queries_s: Times [s], any shape.
        times_s: Times of the samples [s], strictly ascending, shape [sample_count].
        values: Samples, shape [sample_count, C].
    """
    columns = [np.interp(queries_s, times_s, column) for column in values.T]
    return np.stack(columns, axis=-1)


def check_finite(name: str, values: FloatArray) -> None:
    """Raise ShapeError if a value of a trajectory, shape [frame_count, coordinate_count], is not finite."""
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        frame, coordinate = wrong[0]
        raise ShapeError(
            f"{name} is {values[frame, coordinate]} at frame {frame}, coordinate {coordinate}; "
            "a finite number is needed"
        )


def _trajectories(
    simulated: ArrayLike, real_mean: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return two trajectories of the same coordinates as arrays; only the real one may have unknown values.

    Raises:
        ShapeError: The widths differ, a simulated value is not finite, or nothing was measured.
    """
    first, second = np.asarray(simulated, float), np.asarray(real_mean, float)
    if first.ndim != 2 or first.shape[1:] != second.shape[1:]:
        raise ShapeError(
            f"simulated has shape {first.shape}, and real_mean {second.shape}; "
            "[frame_count, coordinate_count] is needed, with the same coordinates"
        )
    check_finite("simulated", first)
    if not np.isfinite(second).any():
        raise ShapeError("simulated and real_mean share no measured entry")
    return first, second
