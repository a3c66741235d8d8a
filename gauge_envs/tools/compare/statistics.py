"""Statistics of repeats: mean, standard deviation, intervals, and differences between two configurations.

All configurations of an experiment share the error e of its reference. Of two deviations a and b from the reference,

    |a - e|^2 - |b - e|^2 = |a|^2 - |b|^2 - 2 e (a - b),

which is linear in e and has no bias. Divided by the sum of both distances, it is their difference. Observed distances
are too large: their squares hold the square of e. The time shift has the smallest distance, so errors along the
velocity have no effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scoring.interval import (
    COVERAGE_FACTOR,
    errors_of_mean,
    mean_half_width,
    order_widening,
    shared_errors,
    skewed_t,
)
from gauge_envs.scoring.score import Interval

SMALLEST = 1e-300
"""Smallest divisor: 0 / SMALLEST is 0."""


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
    def of(cls, values: Iterable[float | None]) -> ScoreSpread | None:
        """Return the spread of the values that are not None; None without values."""
        known = [value for value in values if value is not None]
        if not known:
            return None
        std = None
        if len(known) > 1:
            std = float(np.std(known, ddof=1))
        return cls(mean=float(np.mean(known)), std=std, count=len(known))


@dataclass(frozen=True, eq=False, kw_only=True)
class Deviations:
    """Deviations of repeats from a reference and the error of the reference, divided by the scale of scores.

    Attributes:
        seeds: Seed of each repeat.
        vectors: Deviations, shape [repeat_count, entry_count]. Their norms are the primary scores.
        trials: Contribution of each real trial to the error of the mean, (trial - mean) / sqrt(N (N - 1)), shape
            [trial_count, entry_count]. It has no rows without single trials.
        shared: Standard uncertainty common to all trials, shape [coordinate_count, entry_count].
        uncertainty: Standard uncertainty of a reference without single trials.
    """

    seeds: tuple[int | None, ...]
    vectors: FloatArray
    trials: FloatArray
    shared: FloatArray
    uncertainty: float

    @property
    def scores(self) -> FloatArray:
        """Primary score of each repeat, shape [repeat_count]."""
        return np.asarray(np.linalg.norm(self.vectors, axis=1))

    @property
    def error_square(self) -> float:
        """Mean square of the error that the mean of real trials adds to each score."""
        return float(np.square(self.trials).sum() + np.square(self.shared).sum())

    @property
    def true_scores(self) -> FloatArray:
        """Scores without the error of the mean of real trials, shape [repeat_count]."""
        squares = np.square(self.scores) - self.error_square
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    @classmethod
    def of(
        cls,
        band: Band,
        deviations: Iterable[FloatArray],
        seeds: Sequence[int | None],
        *,
        scale: float,
        is_aligned: bool,
    ) -> Deviations:
        """Return the deviations of repeats.

        Args:
            band: Reference of the score.
            deviations: Deviation of each repeat in the compared coordinates, shape [frame_count, C]; used one by one.
            seeds: Seed of each repeat.
            scale: Distance with a score of 1, in the unit of the band.
            is_aligned: Whether the score ignores a time shift.
        """
        compared = band.compared
        known = np.isfinite(compared.mean)
        size = scale * math.sqrt(int(compared.known.sum()) * compared.marker_count)
        trials = shared = np.zeros((0, int(known.sum())))
        if band.trials is not None and len(band.trials) > 1:
            trials = errors_of_mean(band.trials)
            if is_aligned:
                trials = without_shift(trials, band.mean)
            trials = trials[:, known] / size
            if band.uncertainty is not None:
                shared = shared_errors(band.uncertainty)[:, known] / size
        vectors = np.empty((len(seeds), int(known.sum())))
        for vector, deviation in zip(vectors, deviations, strict=True):
            vector[:] = _scaled(deviation, compared) / scale
        return cls(
            seeds=tuple(seeds),
            vectors=vectors,
            trials=trials,
            shared=shared,
            uncertainty=band.standard_uncertainty / scale,
        )

    def half_widths(self, direction: FloatArray) -> tuple[float, float]:
        """Return the 95 % interval of a true component, below and above the observed one.

        Without single trials, the direction of the error is unknown, so all of it counts along the vector.

        Args:
            direction: Vector that the deviations are multiplied with, shape [entry_count].
        """
        if not len(self.trials):
            half = COVERAGE_FACTOR * self.uncertainty * length_of(direction)
            return half, half
        series = self.trials @ direction
        of_trials = length_of(series) * order_widening(series)
        error = math.hypot(of_trials, length_of(self.shared @ direction))
        # A mean that is larger by the error of the trials makes the component smaller.
        above, below = skewed_t(series)
        return below * error, above * error


def _scaled(deviation: FloatArray, band: Band) -> FloatArray:
    """Return the known entries of a deviation, scaled so that their norm is the distance, shape [entry_count].

    An aligned motion may end some frames before the band. The distance does not compare these, and their entries are 0.
    """
    is_compared = band.known & np.isfinite(deviation).any(axis=1)
    number_count = max(int(is_compared.sum()) * band.marker_count, 1)
    entries = np.nan_to_num(deviation[np.isfinite(band.mean)])
    return entries / math.sqrt(number_count)


def without_shift(errors: FloatArray, mean: FloatArray) -> FloatArray:
    """Return errors of shape [N, T, C] without the part along the velocity of the mean motion."""
    velocity = np.nan_to_num(np.gradient(mean, axis=0))
    direction = velocity / max(length_of(velocity), SMALLEST)
    shifts = np.einsum("ntc,tc->n", errors, direction)
    return errors - shifts[:, None, None] * direction


def repeats_interval(
    values: Sequence[float], intervals: Sequence[Interval]
) -> Interval:
    """Return the 95 % interval of the mean of normalized scores over repeats.

    The repeats share the reference, so the interval of their mean is the mean of their intervals. The scatter of
    repeats adds in quadrature on each side.

    Args:
        values: Score of each repeat, at least one.
        intervals: 95 % interval of each score.
    """
    mean, half = float(np.mean(values)), mean_half_width(values)
    low, high = np.mean(intervals, axis=0)
    below, above = math.hypot(mean - low, half), math.hypot(high - mean, half)
    return max(mean - below, 0.0), mean + above


def difference_interval(first: Deviations, second: Deviations) -> Interval:
    """Return the 95 % interval of the first mean score minus the second mean score.

    Repeats are paired by seed; repeats without a partner are left out. Without a common seed, all pairs count.
    """
    places = {seed: place for place, seed in enumerate(second.seeds)}
    pairs = [
        (place, places[seed])
        for place, seed in enumerate(first.seeds)
        if seed in places
    ]
    is_paired = bool(pairs)
    if not is_paired:
        pairs = [*product(range(len(first.seeds)), range(len(second.seeds)))]
    rows, columns = np.transpose(pairs)
    scores, other_scores = first.scores[rows], second.scores[columns]
    sums = first.true_scores[rows] + second.true_scores[columns]
    sums = np.maximum(sums, max(math.sqrt(first.error_square), SMALLEST))
    differences = (np.square(scores) - np.square(other_scores)) / sums
    if is_paired:
        half_of_repeats = mean_half_width(differences)
    else:
        halves = mean_half_width(first.scores), mean_half_width(second.scores)
        half_of_repeats = math.hypot(*halves)
    apart = first.vectors[rows] - second.vectors[columns]
    direction = (2.0 / sums) @ apart / len(pairs)
    below, above = first.half_widths(direction)
    difference = float(differences.mean())
    low = difference - math.hypot(half_of_repeats, below)
    return low, difference + math.hypot(half_of_repeats, above)
