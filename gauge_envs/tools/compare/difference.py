"""Scores of repeats: their mean and scatter, and the interval of a difference between two configurations.

All configurations of an experiment share the error e of its reference. Of two deviations a and b from it,
|a - e|^2 - |b - e|^2 = |a|^2 - |b|^2 - 2 e (a - b), which is linear in e and has no bias. Over the sum of the distances
|a| and |b| it is the observed difference |a| - |b| and its error, at most 2 |e|. A time shift with the least distance
changes nothing of first order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scoring.score import COVERAGE_FACTOR, Interval


@dataclass(frozen=True, kw_only=True)
class ScoreSpread:
    """Mean and scatter of repeats.

    Attributes:
        mean: Mean.
        std: Sample standard deviation (n - 1); None for a single value.
        count: Number of values.
    """

    mean: float
    std: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> ScoreSpread | None:
        """Return the spread of values, or None if there are none."""
        if not values:
            return None
        std = float(np.std(values, ddof=1)) if len(values) > 1 else None
        return cls(mean=float(np.mean(values)), std=std, count=len(values))


@dataclass(frozen=True, eq=False, kw_only=True)
class Deviations:
    """Deviations of the repeats of a configuration from a reference, and the error of the reference, over its scale.

    Attributes:
        seeds: Seed of each repeat.
        vectors: Deviations, whose norms are the primary scores, shape [repeat_count, entry_count].
        trials: Part of each real trial in the error of their mean, shape [trial_count, entry_count]: it minus the mean,
            over sqrt(N (N - 1)). No rows without single trials.
        shared: Standard uncertainty that all trials share, a row for each coordinate.
        uncertainty: Standard uncertainty of the reference, where it has no single trials.
    """

    seeds: tuple[int | None, ...]
    vectors: FloatArray
    trials: FloatArray
    shared: FloatArray
    uncertainty: float

    @property
    def scores(self) -> FloatArray:
        """Primary score of each repeat."""
        return np.asarray(np.linalg.norm(self.vectors, axis=1))

    @classmethod
    def of(
        cls,
        band: Band,
        deviations: Sequence[FloatArray],
        seeds: Sequence[int | None],
        *,
        scale: float,
    ) -> Deviations:
        """Return the deviations of repeats.

        Args:
            band: Reference of the score.
            deviations: Deviation of each repeat in the compared coordinates, shape [frame_count, C].
            seeds: Seed of each.
            scale: Distance of a score of 1.
        """
        compared = band.compared
        known = np.isfinite(compared.mean)
        size = scale * math.sqrt(int(compared.known.sum()) * compared.marker_count)
        rows = np.zeros((0, int(known.sum())))
        trials = shared = rows
        if band.trials is not None and len(band.trials) > 1:
            seen = np.isfinite(band.trials)
            count = np.maximum(seen.sum(axis=0), 1)
            residuals = band.trials - np.nansum(band.trials, axis=0) / count
            errors = residuals / np.sqrt(np.maximum(count * (count - 1), 1))
            trials = np.where(seen, errors, 0.0)[:, known] / size
            if band.uncertainty is not None:
                axes = np.eye(len(band.coordinates))[:, None]
                shared = np.nan_to_num(band.uncertainty) * axes
                shared = shared[:, known] / size
        return cls(
            seeds=tuple(seeds),
            vectors=np.array([one[known] for one in deviations]) / size,
            trials=trials,
            shared=shared,
            uncertainty=band.standard_uncertainty / scale,
        )

    def half_width(self, direction: FloatArray) -> float:
        """Return half the width of the 95 % interval of e times a vector, shape [entry_count].

        Of real trials it is that of Student's t for the mean of their components. Otherwise e may have any direction:
        the whole u is along the vector, the case in which two configurations are told apart least.
        """
        count = len(self.trials)
        if not count:
            return COVERAGE_FACTOR * self.uncertainty * length_of(direction)
        series = self.trials @ direction
        square = float(series @ series)
        # Consecutive trials that are alike count as fewer: AR(1), with the bias 1/N of its correlation.
        lag = float(series[1:] @ series[:-1]) / max(square, 1e-300) + 1.0 / count
        lag = min(max(lag, 0.0), 1.0 - 1.0 / count)
        of_trials = math.sqrt(square * (1.0 + lag) / (1.0 - lag))
        return student(count) * math.hypot(
            of_trials, length_of(self.shared @ direction)
        )


def student(count: int) -> float:
    """Return the half width of a 95 % interval of a mean of values over its standard error."""
    # The import takes longer than a comparison without repeats or trials.
    from scipy.special import stdtrit

    return float(stdtrit(count - 1, 0.975))


def mean_half_width(values: Sequence[float] | FloatArray) -> float:
    """Return half the width of the 95 % interval of a mean over repeats; 0 for a single one."""
    count = len(values)
    if count < 2:
        return 0.0
    return student(count) * float(np.std(values, ddof=1)) / math.sqrt(count)


def repeats_interval(
    values: Sequence[float], intervals: Sequence[Interval]
) -> Interval:
    """Return the 95 % interval of the mean of normalized scores over repeats.

    The repeats share the reference, so the mean of their intervals is that of their mean. Each has a start of its own,
    whose scatter adds in quadrature on each side.

    Args:
        values: Score of each repeat, at least one.
        intervals: 95 % interval of each score.
    """
    mean, half = float(np.mean(values)), mean_half_width(values)
    low, high = np.mean(intervals, axis=0)
    below, above = math.hypot(mean - low, half), math.hypot(high - mean, half)
    return max(mean - below, 0.0), mean + above


def difference_interval(first: Deviations, second: Deviations) -> Interval:
    """Return the 95 % interval of the mean score of the first configuration minus that of the second.

    It is of the difference of their squares over the sum of the observed scores, which has the sign of the true one.
    Repeats are paired by seed, and those of a seed that only one of the two has are left out. Without a common seed,
    each is paired with each.
    """
    places = {seed: place for place, seed in enumerate(second.seeds)}
    pairs = [
        (one, places[seed]) for one, seed in enumerate(first.seeds) if seed in places
    ]
    ours, theirs = first.scores, second.scores
    if pairs:
        half = mean_half_width([ours[one] - theirs[other] for one, other in pairs])
    else:
        pairs = [(i, j) for i in range(len(ours)) for j in range(len(theirs))]
        half = math.hypot(mean_half_width(ours), mean_half_width(theirs))
    difference = float(np.mean([ours[one] - theirs[other] for one, other in pairs]))
    direction = np.zeros(first.vectors.shape[1])
    for one, other in pairs:
        apart = first.vectors[one] - second.vectors[other]
        direction += 2.0 * apart / max(ours[one] + theirs[other], 1e-300)
    half = math.hypot(half, first.half_width(direction / len(pairs)))
    return difference - half, difference + half
