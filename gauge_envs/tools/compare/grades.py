"""Configurations compared within one grade of reference: means over experiments, pairs, and ranks.

Nothing is averaged across grades, because they answer different questions: `trials` compares with the mean of real
trials, `recording` with one of them, and `law` with a closed form. Withheld bands are a group of their own.

Draws are paired between configurations (`analysis.draws`). The interval of a difference in one experiment is between
percentiles of its draws. A distance plus an error is longer on average, which adds up in a mean over experiments. The
interval of a mean over several experiments therefore holds both the percentiles and the bias-corrected percentiles
(Efron 1981). Over one experiment the mean is the score and has its interval, which also holds the truth of a score that
is below its errors: in 98 % of simulated realities, where that of the draws does so in 88 %. Two configurations are
distinguishable if the 95 % interval of their difference excludes zero. Each pair has its own 95 %: nothing is corrected
for the number of pairs.

Over the experiments of a grade, the difference is the mean difference of the normalized scores, with the experiments
taken as given. A mean difference of logarithms would weight them equally. But the logarithm of a score that is below
its errors is not determined, and its interval misses the truth in simulated realities. That of the difference holds it
in at least 91 % (`tests/tools/compare/test_pairs.py`). The same limits the interval of the geometric mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from gauge_envs.evaluation.uncertainty import LEVEL
from gauge_envs.references.bands import BandGrade
from gauge_envs.tools.compare.draws import ScoreDraws, paired_scores

FloatArray = NDArray[np.float64]
Interval = tuple[float, float]

TAILS: Interval = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
"""Percentiles at the ends of an interval."""

ROUNDING = 1e-5
"""Difference of normalized scores that counts as zero: rounding to single precision at 1 m is 0.1 um, of 10 mm."""


@dataclass(frozen=True, kw_only=True)
class Mean:
    """A mean over experiments.

    Attributes:
        value: The mean.
        interval_95: Its 95 % interval.
    """

    value: float
    interval_95: Interval


@dataclass(frozen=True, kw_only=True)
class GradeScore:
    """One configuration over the experiments of a grade that all configurations have scored.

    Attributes:
        configuration: Index of the configuration.
        rank: 1 + number of configurations with a distinguishably lower mean; None without common experiments. Equal
            configurations share a rank.
        mean: Mean of the primary score; None without common experiments.
        interquartile_mean: Interquartile mean of the primary score.
        geometric_mean: Geometric mean of the primary score. Its interval is too high if a score is below its errors.
        geometric_mean_raw: Geometric mean of the raw normalized RMSE, as the paper defines it.
    """

    configuration: int
    rank: int | None = None
    mean: Mean | None = None
    interquartile_mean: Mean | None = None
    geometric_mean: Mean | None = None
    geometric_mean_raw: Mean | None = None


@dataclass(frozen=True, kw_only=True)
class ExperimentDifference:
    """Difference of two configurations in one experiment.

    Attributes:
        id: Gymnasium id.
        difference: Primary normalized score of the first minus that of the second; negative if the first is closer.
        difference_95: Its 95 % interval.
        distinguishable: Whether the interval excludes zero.
    """

    id: str
    difference: float
    difference_95: Interval
    distinguishable: bool


@dataclass(frozen=True, kw_only=True)
class PairComparison:
    """Two configurations over the experiments of one grade that both have scored.

    Attributes:
        first: Index of the first configuration.
        second: Index of the second configuration.
        difference: Mean over experiments of the primary score of the first minus that of the second.
        difference_95: Its 95 % interval.
        distinguishable: Whether the interval excludes zero.
        probability_of_improvement: Probability that the first is closer to reality, mean over experiments and draws; a
            tie counts half.
        experiments: Difference in each experiment.
    """

    first: int
    second: int
    difference: float
    difference_95: Interval
    distinguishable: bool
    probability_of_improvement: float
    experiments: tuple[ExperimentDifference, ...]

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the experiments."""
        return tuple(one.id for one in self.experiments)


@dataclass(frozen=True, kw_only=True)
class GradeComparison:
    """All configurations over the experiments of one grade.

    Attributes:
        grade: Grade of the references.
        withheld: Whether their bands are withheld by default.
        ids: Experiments that all configurations have scored.
        scores: One entry for each configuration with a score of this grade.
        published: Geometric mean over `ids` of the published raw scores, by engine; empty for other grades than
            `trials`, because the paper scored against the mean of real trials.
        pairs: Each two configurations with a common scored experiment.
    """

    grade: str
    withheld: bool
    ids: tuple[str, ...]
    scores: tuple[GradeScore, ...]
    published: Mapping[str, float]
    pairs: tuple[PairComparison, ...]

    @property
    def ranked(self) -> list[GradeScore]:
        """The scores, lowest rank first."""
        return sorted(self.scores, key=lambda one: (one.rank or 0, one.mean.value if one.mean else 0.0))

    @property
    def name(self) -> str:
        """Grade, and whether its bands are withheld."""
        return grade_name(self.grade, withheld=self.withheld)


def grade_name(grade: str, *, withheld: bool) -> str:
    """Return a grade, and whether its bands are withheld by default."""
    return f"{grade}, withheld" if withheld else grade


@dataclass(frozen=True, kw_only=True)
class GradedExperiment:
    """Scores of one experiment.

    Attributes:
        id: Gymnasium id.
        draws: Scores of each configuration; None for one that has none.
        published: Published raw score over the baseline, by engine.
        intervals: 95 % interval of the primary score of each configuration, or None; empty where none is known.
        raw_intervals: The same for the raw normalized RMSE.
    """

    id: str
    draws: tuple[ScoreDraws | None, ...]
    published: Mapping[str, float | None]
    intervals: tuple[Interval | None, ...] = ()
    raw_intervals: tuple[Interval | None, ...] = ()

    def own_intervals(self, configuration: int) -> tuple[Interval | None, Interval | None]:
        """Return the intervals of the primary and of the raw score of a configuration."""
        known = (self.intervals, self.raw_intervals)
        primary, raw = (one[configuration] if one else None for one in known)
        return primary, raw


def compare_grade(grade: str, *, withheld: bool, experiments: Sequence[GradedExperiment]) -> GradeComparison:
    """Return the comparison of configurations over experiments of one grade.

    Args:
        grade: The grade.
        withheld: Whether the bands are withheld by default.
        experiments: Experiments of that grade, with the same configurations in the same order.
    """
    configurations = range(max((len(one.draws) for one in experiments), default=0))
    present = [index for index in configurations if any(one.draws[index] is not None for one in experiments)]
    common = [one for one in experiments if present and all(one.draws[index] is not None for index in present)]
    pairs = [compare_pair(experiments, pair) for pair in combinations(present, 2)]
    ids = tuple(one.id for one in common)
    # A rank needs the same experiments for all; a pair may have more in common.
    ranked = [
        pair if pair is None or pair.ids == ids else compare_pair(common, (pair.first, pair.second)) for pair in pairs
    ]
    worse = [
        (pair.second if pair.difference < 0.0 else pair.first)
        for pair in ranked
        if pair is not None and pair.distinguishable
    ]
    return GradeComparison(
        grade=grade,
        withheld=withheld,
        ids=ids,
        scores=tuple(_grade_score(index, common, 1 + worse.count(index)) for index in present),
        published=_published(common) if grade == BandGrade.TRIALS.value and not withheld else {},
        pairs=tuple(pair for pair in pairs if pair is not None),
    )


def _grade_score(index: int, common: Sequence[GradedExperiment], rank: int) -> GradeScore:
    scores = [known for one in common if (known := one.draws[index]) is not None]
    if not scores:
        return GradeScore(configuration=index)
    values, draws = _stacked(scores, raw=False)
    raw, raw_draws = _stacked(scores, raw=True)
    own, raw_own = common[0].own_intervals(index) if len(common) == 1 else (None, None)
    return GradeScore(
        configuration=index,
        rank=rank,
        mean=_mean(values.mean(axis=0), draws.mean(axis=0), own),
        interquartile_mean=_mean(interquartile_mean(values), interquartile_mean(draws), own),
        geometric_mean=_mean(geometric_mean(values), geometric_mean(draws), own),
        geometric_mean_raw=_mean(geometric_mean(raw), geometric_mean(raw_draws), raw_own),
    )


def _stacked(scores: Sequence[ScoreDraws], *, raw: bool) -> tuple[FloatArray, FloatArray]:
    """Return scores of shape [experiment_count], and draws of shape [experiment_count, draw_count]."""
    means = [one.mean(raw=raw) for one in scores]
    # The scatter of few repeats may take a draw below zero, where no score is.
    return np.array([value for value, _ in means]), np.maximum([draws for _, draws in means], 0.0)


def _mean(value: ArrayLike, draws: ArrayLike, own: Interval | None) -> Mean:
    """Return a mean with the interval of the one score that it is, or with that of its draws."""
    observed = float(np.asarray(value))
    return Mean(value=observed, interval_95=own or _mean_interval(observed, np.asarray(draws)))


def _interval(value: float, draws: FloatArray) -> Interval:
    """Return the percentiles of draws, widened to hold the observed value."""
    low, high = np.quantile(draws, TAILS)
    return min(float(low), value), max(float(high), value)


def _mean_interval(value: float, draws: FloatArray) -> Interval:
    """Return the smallest interval that holds the percentiles of draws, and their bias-corrected percentiles.

    The correction moves the median of the draws to the observed value. It is too large where scores are far below their
    errors, and the plain percentiles are then the better ones.
    """
    below = float(np.mean(draws < value) + 0.5 * np.mean(draws == value))
    shift = 2.0 * norm.ppf(np.clip(below, 1.0 / len(draws), 1.0 - 1.0 / len(draws)))
    corrected = norm.cdf(shift + norm.ppf(TAILS))
    low, high = np.quantile(draws, [min(TAILS[0], corrected[0]), max(TAILS[1], corrected[1])])
    return min(float(low), value), max(float(high), value)


def _published(common: Sequence[GradedExperiment]) -> dict[str, float]:
    """Return the geometric mean of published scores, for engines that have all of them."""
    engines = dict.fromkeys(engine for one in common for engine in one.published)
    scores = {engine: [one.published.get(engine) for one in common] for engine in engines}
    return {
        engine: float(geometric_mean(np.array(values, dtype=np.float64)))
        for engine, values in scores.items()
        if None not in values
    }


def compare_pair(experiments: Sequence[GradedExperiment], pair: tuple[int, int]) -> PairComparison | None:
    """Return the comparison of two configurations by paired bootstrap; None without a common scored experiment."""
    differences, difference_draws, improved = [], [], []
    for one in experiments:
        first, second = one.draws[pair[0]], one.draws[pair[1]]
        if first is None or second is None:
            continue
        (value, draws), (other, other_draws) = paired_scores(first, second)
        interval = _interval(value - other, draws - other_draws)
        differences.append(
            ExperimentDifference(
                id=one.id,
                difference=value - other,
                difference_95=interval,
                distinguishable=_excludes_zero(interval),
            )
        )
        improved.append(np.mean(draws < other_draws) + 0.5 * np.mean(draws == other_draws))
        difference_draws.append(draws - other_draws)
    if not differences:
        return None
    mean = float(np.mean([one.difference for one in differences]))
    # The sign of one difference has no bias to correct; a mean of several has.
    only = differences[0].difference_95 if len(differences) == 1 else None
    interval_95 = only or _mean_interval(mean, np.mean(difference_draws, axis=0))
    return PairComparison(
        first=pair[0],
        second=pair[1],
        difference=mean,
        difference_95=interval_95,
        distinguishable=_excludes_zero(interval_95),
        probability_of_improvement=float(np.mean(improved)),
        experiments=tuple(differences),
    )


def _excludes_zero(interval: Interval) -> bool:
    return interval[0] > ROUNDING or interval[1] < -ROUNDING


def geometric_mean(scores: ArrayLike) -> FloatArray:
    """Return the geometric mean over the first axis; a score of 0 makes it 0.

    Args:
        scores: Scores of at least 0, shape [experiment_count, ...].
    """
    values = np.asarray(scores, dtype=np.float64)
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(np.log(values).mean(axis=0)))


def interquartile_mean(scores: ArrayLike) -> FloatArray:
    """Return the mean of the middle half of the scores, over the first axis.

    Sorted score i of n stands for the quantiles from i / n to (i + 1) / n. The part of these between 0.25 and 0.75 is
    its weight, so that the mean is defined for every n.

    Args:
        scores: Scores, shape [experiment_count, ...].
    """
    values = np.sort(np.asarray(scores, dtype=np.float64), axis=0)
    count = len(values)
    edges = np.clip(np.arange(count + 1) / count, 0.25, 0.75)
    return np.asarray(np.tensordot(2.0 * np.diff(edges), values, axes=1))
