"""Compute mean, scatter and baselines over trials, with one trial in memory at a time.

The distance of a trial to the mean needs the mean first, so there are two passes over all trials. Between the passes
the trials are plain numbers in a temporary file, which is read a hundred times faster than the trial files.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.metrics.trajectory import trajectory_dtw, trajectory_rmse
from gauge_envs.scene.geometry import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialStatistics:
    """Mean of the trials of one variant, their scatter, and the distance of each from the mean.

    Attributes:
        mean: Mean over the trials with a sample, shape [frame_count, coordinate_count]; NaN without a sample.
        sigma: Sample standard deviation (n - 1), same shape; NaN where fewer than half of the trials, or fewer than
            two, have a sample.
        measured: Whether some coordinate of a frame has samples of at least half of the trials, shape [frame_count].
        rmse: E_RMSE of each trial to the mean, shape [trial_count].
        dtw: E_DTW of each trial to the mean, shape [trial_count]; NaN without an alignment.
    """

    mean: FloatArray
    sigma: FloatArray
    measured: NDArray[np.bool_]
    rmse: FloatArray
    dtw: FloatArray


class CoordinateMean:
    """Running mean over trials of an array with missing entries.

    Args:
        shape: Shape of the array.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._sum = np.zeros(shape)
        self.counts = np.zeros(shape, dtype=np.int64)

    def add(self, values: FloatArray) -> None:
        """Add one trial; NaN is a missing entry."""
        seen = ~np.isnan(values)
        self._sum[seen] += values[seen]
        self.counts += seen

    @property
    def mean(self) -> FloatArray:
        """Mean over the trials with an entry; NaN without one."""
        return np.divide(self._sum, self.counts, out=np.full(self._sum.shape, np.nan), where=self.counts > 0)

    def scatter(self, trials: TrialSpool | Sequence[FloatArray]) -> FloatArray:
        """Return the standard deviation (n - 1); NaN where fewer than two, or fewer than half, have an entry.

        Args:
            trials: The trials that were added.
        """
        mean, squares = self.mean, np.zeros(self._sum.shape)
        for trial in trials:
            squares += np.square(np.where(np.isnan(trial), 0.0, trial - mean))
        often = (2 * self.counts >= len(trials)) & (self.counts > 1)
        return np.sqrt(np.divide(squares, self.counts - 1, out=np.full(squares.shape, np.nan), where=often))


class TrialSpool(CoordinateMean):
    """Temporary file of the trials of one variant, which is freed by `close`.

    Args:
        shape: Frames of each trial, and coordinates of g(t).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        super().__init__(shape)
        self._shape = shape
        self._trial_count = 0
        self._file = tempfile.TemporaryFile(prefix="gauge-import-")  # noqa: SIM115  # `close` closes it.
        self.close = self._file.close

    def __len__(self) -> int:
        return self._trial_count

    def __iter__(self) -> Iterator[FloatArray]:
        size = 8 * self._shape[0] * self._shape[1]
        for number in range(self._trial_count):
            self._file.seek(number * size)
            yield np.frombuffer(self._file.read(size)).reshape(self._shape)

    def add(self, values: FloatArray) -> None:
        """Add g(t) of one trial, shape [frame_count, coordinate_count]; NaN is a missing sample."""
        super().add(values)
        self._file.seek(0, 2)
        self._file.write(np.ascontiguousarray(values, dtype=np.float64).tobytes())
        self._trial_count += 1

    def statistics(self) -> TrialStatistics:
        """Return the statistics of the trials that were added, one or more."""
        mean = self.mean
        distances = [(trajectory_rmse(trial, mean, allow_missing=True), _dtw(trial, mean)) for trial in self]
        rmse, dtw = np.array(distances).T
        return TrialStatistics(
            mean=mean,
            sigma=self.scatter(self),
            measured=np.asarray((2 * self.counts >= len(self)).any(axis=1)),
            rmse=rmse,
            dtw=dtw,
        )


def _dtw(trial: FloatArray, mean: FloatArray) -> float:
    try:
        return trajectory_dtw(trial, mean, allow_missing=True)
    except ShapeError:
        return float("nan")  # Frames that share no coordinate cannot be aligned. The spread counts the other trials.
