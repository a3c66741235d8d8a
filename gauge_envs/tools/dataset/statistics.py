"""Compute mean, scatter and baselines over trials, with one trial in memory at a time.

The distance of a trial to the mean needs the mean first, so there are two passes over all trials. Between the passes
the trials are plain numbers in a temporary file, which is read a hundred times faster than the trial files.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.metrics.trajectory import trajectory_dtw, trajectory_rmse

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TrialSpread:
    """Mean and sample standard deviation (n - 1) over trials of one number per trial.

    Attributes:
        mean: Mean over trials.
        std: Sample standard deviation; None for a single trial.
        count: Number of trials with a finite number.
    """

    mean: float
    std: float | None
    count: int

    @classmethod
    def of(cls, values: FloatArray) -> TrialSpread | None:
        """Return the spread of the finite values; None without any."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return None
        std = float(finite.std(ddof=1)) if finite.size > 1 else None
        return cls(mean=float(finite.mean()), std=std, count=int(finite.size))


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialStatistics:
    """Mean of the trials of one variant, their scatter, and the distance of each from the mean.

    Attributes:
        mean: Mean over the trials with a sample, shape [frame_count, coordinate_count]; NaN without a sample.
        sigma: Sample standard deviation (n - 1), same shape; NaN where fewer than half of the trials, or fewer than
            two, have a sample.
        counts: Number of trials with a sample, same shape.
        measured: Whether some coordinate of a frame has samples of at least half of the trials, shape [frame_count].
        rmse: E_RMSE of each trial to the mean, shape [trial_count].
        dtw: E_DTW of each trial to the mean, shape [trial_count]; NaN without an alignment.
    """

    mean: FloatArray
    sigma: FloatArray
    counts: NDArray[np.int64]
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


class TrialSpool:
    """Temporary file of the trials of one variant, as a context manager that frees it.

    Args:
        frame_count: Frames of each trial.
        coordinate_count: Coordinates of g(t).
    """

    def __init__(self, frame_count: int, coordinate_count: int) -> None:
        self.trial_count = 0
        self._shape = (frame_count, coordinate_count)
        self._mean = CoordinateMean(self._shape)
        self._file = tempfile.TemporaryFile(prefix="gauge-import-")  # noqa: SIM115  # closed on leaving this object

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def add(self, trajectory: FloatArray) -> None:
        """Add g(t) of one trial, shape [frame_count, coordinate_count]; NaN is a missing sample."""
        if trajectory.shape != self._shape:
            raise ShapeError(f"trial has shape {trajectory.shape}; {self._shape} is needed")
        self._mean.add(trajectory)
        self._file.seek(0, 2)
        self._file.write(np.ascontiguousarray(trajectory, dtype=np.float64).tobytes())
        self.trial_count += 1

    def trials(self) -> Iterator[FloatArray]:
        """Yield the trials, one after another."""
        size = 8 * self._shape[0] * self._shape[1]
        for number in range(self.trial_count):
            self._file.seek(number * size)
            yield np.frombuffer(self._file.read(size)).reshape(self._shape)

    def statistics(self) -> TrialStatistics:
        """Return the statistics of the trials that were added."""
        if not self.trial_count:
            raise ShapeError("no trial was added")
        mean, counts = self._mean.mean, self._mean.counts
        squares, rmse, dtw = np.zeros(self._shape), [], []
        for trial in self.trials():
            deviation = np.where(np.isnan(trial), 0.0, trial - mean)
            squares += np.square(deviation)
            rmse.append(trajectory_rmse(trial, mean, allow_missing=True))
            dtw.append(_dtw(trial, mean))
        often = (2 * counts >= self.trial_count) & (counts > 1)
        sigma = np.sqrt(np.divide(squares, counts - 1, out=np.full(self._shape, np.nan), where=often))
        return TrialStatistics(
            mean=mean,
            sigma=sigma,
            counts=counts,
            measured=np.asarray((2 * counts >= self.trial_count).any(axis=1)),
            rmse=np.array(rmse),
            dtw=np.array(dtw),
        )


def _dtw(trial: FloatArray, mean: FloatArray) -> float:
    try:
        return trajectory_dtw(trial, mean, allow_missing=True)
    except ShapeError:
        return float("nan")  # Frames that share no coordinate cannot be aligned. The spread counts the other trials.
