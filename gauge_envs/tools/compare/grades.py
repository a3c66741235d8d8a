"""Configurations compared in each experiment, and over the experiments of one grade of reference: pairs and ranks.

Nothing is compared across grades, because they answer different questions: `trials` and `recording` compare with real
motion, and `law` and `model` with the solution of the scene. Withheld bands are a group of their own, and so are
configurations with the same constants: a rank among engines of which some have better constants ranks the constants.

Draws are paired between configurations (`draws`). A pair has a p-value in each experiment (`significance`), corrected
for the number of pairs in that experiment by Holm. Below 0.05 the two are distinguishable.
A difference of at most `NEGLIGIBLE` counts as none.

Over the experiments of a grade, each experiment counts the same, because in a mean of scores the one with the largest
decides. A configuration is distinguishably closer than another if it is so in more than half of the experiments, again
corrected by Holm. The mean rank puts configurations in order. Its interval is not resampled: a resampled rank is too
certain where configurations are nearly equal, and 2 to 6 experiments are too few to resample. It follows from the pairs
instead: a configuration ranks behind those that are distinguishably closer, and before those that are distinguishably
further (Mogstad, Romano, Shaikh and Wilhelm 2024). For a mean over n experiments, the pairs count at 0.05 / n.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import ndtr, ndtri

from gauge_envs.evaluation.dependence import LEVEL
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.sensitivities import input_uncertainties
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.compare.draws import ScoreDraws, paired_scores
from gauge_envs.tools.compare.significance import (
    NEGLIGIBLE,
    holm,
    majority_p_value,
    p_value,
)

Interval = tuple[float, float]

TAILS: Interval = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
"""Percentiles at the ends of an interval."""

ERROR_RATE = 1.0 - LEVEL
"""Probability of a wrong verdict among all pairs of a family."""

PUBLISHED = "calibrated"
"""Constants of configurations with the parameters that the benchmark publishes."""

DIFFERENT = "different constants"
"""Constants of pairs that do not share them."""


@dataclass(frozen=True, kw_only=True)
class Mean:
    """A mean with its 95 % interval."""

    value: float
    interval_95: Interval


@dataclass(frozen=True, kw_only=True)
class GradeScore:
    """One configuration over the experiments of a grade that all configurations have scored.

    Attributes:
        configuration: Index of the configuration.
        rank: 1 + number of configurations that are distinguishably closer; None without common experiments. Equal
            configurations share a rank.
        mean_rank: Mean over the experiments of the rank in each; None without common experiments.
        mean: Mean of the primary score. The experiment with the largest scores decides it, so it is no order. None
            where scores have different units, as of exact solutions beside others.
    """

    configuration: int
    rank: int | None = None
    mean_rank: Mean | None = None
    mean: Mean | None = None


@dataclass(frozen=True, kw_only=True)
class ExperimentRanks:
    """Ranks of configurations in one experiment.

    Attributes:
        id: Gymnasium id.
        ranks: Rank of each configuration with a score: 1 + sum of the probabilities that another is closer. The
            interval reaches from 1 + number of configurations that are distinguishably closer to the number of all
            minus those that are distinguishably further.
        pair_count: Number of pairs.
        distinguishable_count: Number of those that are distinguishable.
    """

    id: str
    ranks: Mapping[int, Mean]
    pair_count: int
    distinguishable_count: int


@dataclass(frozen=True, kw_only=True)
class ExperimentDifference:
    """Difference of two configurations in one experiment.

    Attributes:
        id: Gymnasium id.
        difference: Primary score over its scale, that of the first minus that of the second; negative if the first is
            closer.
        difference_95: Its 95 % interval, of this pair alone.
        probability_of_improvement: Probability that the first is closer; a tie counts half.
        p: Two-sided p-value of this pair alone.
        p_holm: The same, corrected for all pairs of the experiment.
    """

    id: str
    difference: float
    difference_95: Interval
    probability_of_improvement: float
    p: float
    p_holm: float

    @property
    def distinguishable(self) -> bool:
        """Whether the corrected p-value is below 0.05."""
        return self.p_holm < ERROR_RATE


@dataclass(frozen=True, kw_only=True)
class PairComparison:
    """Two configurations over the experiments of one grade that both have scored.

    Attributes:
        first: Index of the first configuration.
        second: Index of the second configuration.
        probability_of_improvement: Probability that the first is closer to the reference, mean over experiments and
            draws; a tie counts half.
        p: Two-sided p-value of one being closer in more than half of the experiments, of this pair alone.
        p_holm: The same, corrected for all pairs of the grade.
        experiments: Difference in each experiment.
    """

    first: int
    second: int
    probability_of_improvement: float
    p: float
    p_holm: float
    experiments: tuple[ExperimentDifference, ...]

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the experiments."""
        return tuple(one.id for one in self.experiments)

    @property
    def distinguishable(self) -> bool:
        """Whether the corrected p-value is below 0.05."""
        return self.p_holm < ERROR_RATE

    @property
    def closer(self) -> int:
        """The configuration that is closer in more experiments; the first if both are in as many."""
        return (
            self.first
            if sum(np.sign(one.difference) for one in self.experiments) <= 0.0
            else self.second
        )

    @property
    def further(self) -> int:
        """The other configuration."""
        return self.second if self.closer == self.first else self.first

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of experiments in which the first, and in which the second is distinguishably closer."""
        signs = [
            one.difference < 0.0 for one in self.experiments if one.distinguishable
        ]
        return sum(signs), len(signs) - sum(signs)


@dataclass(frozen=True, kw_only=True)
class GradeComparison:
    """Configurations with the same constants over the experiments of one grade.

    Attributes:
        grade: Grade of the references.
        withheld: Whether their bands are withheld by default.
        constants: Name of the constants; `DIFFERENT` for pairs that do not share them, which have no ranks.
        ids: Experiments that all configurations have scored.
        scores: One entry for each configuration with a score of this grade.
        experiments: Ranks in each experiment with a score.
        pairs: Each two configurations with a common scored experiment.
        common_pairs: The same over `ids` alone, on which ranks depend.
    """

    grade: str
    withheld: bool
    constants: str
    ids: tuple[str, ...] = ()
    scores: tuple[GradeScore, ...] = ()
    experiments: tuple[ExperimentRanks, ...] = ()
    pairs: tuple[PairComparison, ...]
    common_pairs: tuple[PairComparison, ...] = ()

    @property
    def ranked(self) -> list[GradeScore]:
        """The scores, lowest mean rank first."""
        return sorted(
            self.scores, key=lambda one: one.mean_rank.value if one.mean_rank else 0.0
        )

    @property
    def is_verified(self) -> bool:
        """Whether its references are solutions of the scenes, and not reality."""
        return BandGrade(self.grade).is_solution

    @property
    def name(self) -> str:
        """Grade, whether its bands are withheld, and constants that are not the published ones."""
        name = grade_name(self.grade, withheld=self.withheld)
        return name if self.constants == PUBLISHED else f"{name}, {self.constants}"


def grade_name(grade: str, *, withheld: bool) -> str:
    """Return a grade, and whether its bands are withheld by default."""
    return f"{grade}, withheld" if withheld else grade


@dataclass(frozen=True, kw_only=True)
class GradedExperiment:
    """Scores of one experiment.

    Attributes:
        id: Gymnasium id.
        draws: Scores of each configuration; None for one that has none.
        intervals: 95 % interval of the primary score of each configuration, or None; empty where none is known.
        trial_count: Number of real trials that the reference is the mean of; None takes the number that the benchmark
            states.
        scale_unit: Unit of the scores over their scale.
    """

    id: str
    draws: tuple[ScoreDraws | None, ...]
    intervals: tuple[Interval | None, ...] = ()
    trial_count: int | None = None
    scale_unit: str = "1"

    def among(self, configurations: Sequence[int]) -> GradedExperiment:
        """Return the experiment with the scores of these configurations alone."""
        kept = tuple(
            one if index in configurations else None
            for index, one in enumerate(self.draws)
        )
        return replace(self, draws=kept)


def compare_grade(
    grade: str,
    *,
    withheld: bool,
    experiments: Sequence[GradedExperiment],
    constants: Sequence[str] | None = None,
) -> tuple[GradeComparison, ...]:
    """Return a comparison for each set of constants, and one of the pairs that do not share them.

    Args:
        grade: The grade.
        withheld: Whether the bands are withheld by default.
        experiments: Experiments of that grade, with the same configurations in the same order.
        constants: Name of the constants of each configuration; None if all have the published ones.
    """
    count = max((len(one.draws) for one in experiments), default=0)
    names = list(constants or [PUBLISHED] * count)
    present = [
        index
        for index in range(count)
        if any(one.draws[index] is not None for one in experiments)
    ]
    compared = []
    for name in sorted({names[index] for index in present}, key=_order):
        members = [index for index in present if names[index] == name]
        graded = [one.among(members) for one in experiments]
        compared.append(_compared(grade, withheld, name, graded, members))
    across = [
        pair for pair in combinations(present, 2) if names[pair[0]] != names[pair[1]]
    ]
    pairs = compare_pairs(experiments, across)
    if pairs:
        compared.append(
            GradeComparison(
                grade=grade, withheld=withheld, constants=DIFFERENT, pairs=pairs
            )
        )
    return tuple(compared)


def _order(constants: str) -> tuple[bool, str]:
    return constants != PUBLISHED, constants


def _compared(
    grade: str,
    withheld: bool,
    constants: str,
    experiments: Sequence[GradedExperiment],
    members: Sequence[int],
) -> GradeComparison:
    """Return the comparison of configurations with the same constants."""
    every_pair = list(combinations(members, 2))
    common = [
        one
        for one in experiments
        if all(one.draws[index] is not None for index in members)
    ]
    ids = tuple(one.id for one in common)
    pairs = compare_pairs(experiments, every_pair)
    # A rank over a grade needs the same experiments for all; a pair may have more in common.
    is_same = all(pair.ids == ids for pair in pairs)
    common_pairs = pairs if is_same else compare_pairs(common, every_pair)
    further = [pair.further for pair in common_pairs if pair.distinguishable]
    # Over n experiments, the pairs of each count at 0.05 / n.
    error_rate = ERROR_RATE / max(len(ids), 1)
    ranks = [_experiment_ranks(one, common_pairs, error_rate).ranks for one in common]
    scores = []
    for index in members:
        score = GradeScore(configuration=index)
        if common:
            score = GradeScore(
                configuration=index,
                rank=1 + further.count(index),
                mean_rank=_mean_rank([one[index] for one in ranks]),
                mean=_mean_score(common, index)
                if len({one.scale_unit for one in common}) == 1
                else None,
            )
        scores.append(score)
    scored = [
        one for one in experiments if any(draws is not None for draws in one.draws)
    ]
    return GradeComparison(
        grade=grade,
        withheld=withheld,
        constants=constants,
        ids=ids,
        scores=tuple(scores),
        experiments=tuple(_experiment_ranks(one, pairs) for one in scored),
        pairs=pairs,
        common_pairs=common_pairs,
    )


# --- pairs -----------------------------------------------------------------------------------------------------------


def compare_pairs(
    experiments: Sequence[GradedExperiment], pairs: Sequence[tuple[int, int]]
) -> tuple[PairComparison, ...]:
    """Return the pairs with a common scored experiment; all pairs given are one family for the correction."""
    known = []
    for pair in pairs:
        compared = _compare_pair(experiments, pair)
        if compared is not None:
            known.append(compared)
    corrected: dict[tuple[int, str], float] = {}
    for experiment in experiments:
        places = [place for place, one in enumerate(known) if experiment.id in one.ids]
        p_values = [
            one.p
            for pair in known
            for one in pair.experiments
            if one.id == experiment.id
        ]
        for place, p_holm in zip(places, holm(p_values), strict=True):
            corrected[place, experiment.id] = p_holm
    over_grade = holm([pair.p for pair in known])
    corrected_pairs = []
    for place, one in enumerate(known):
        differences = tuple(
            replace(each, p_holm=corrected[place, each.id]) for each in one.experiments
        )
        corrected_pairs.append(
            replace(one, p_holm=over_grade[place], experiments=differences)
        )
    return tuple(corrected_pairs)


def _compare_pair(
    experiments: Sequence[GradedExperiment], pair: tuple[int, int]
) -> PairComparison | None:
    """Return two configurations by paired bootstrap, not corrected; None without a common scored experiment."""
    differences = []
    for one in experiments:
        first, second = one.draws[pair[0]], one.draws[pair[1]]
        if first is None or second is None:
            continue
        (value, draws), (other, other_draws) = paired_scores(first, second)
        p = p_value(
            (value, draws), (other, other_draws), degrees=_degrees(one, first, second)
        )
        apart = draws - other_draws
        differences.append(
            ExperimentDifference(
                id=one.id,
                difference=value - other,
                difference_95=_interval(value - other, apart),
                probability_of_improvement=0.5
                * float(np.mean(apart < -NEGLIGIBLE) + np.mean(apart <= NEGLIGIBLE)),
                p=p,
                p_holm=p,
            )
        )
    if not differences:
        return None
    p = majority_p_value(
        [one.difference for one in differences], [one.p for one in differences]
    )
    return PairComparison(
        first=pair[0],
        second=pair[1],
        probability_of_improvement=float(
            np.mean([one.probability_of_improvement for one in differences])
        ),
        p=p,
        p_holm=p,
        experiments=tuple(differences),
    )


def _degrees(experiment: GradedExperiment, *draws: ScoreDraws) -> int:
    """Return the degrees of freedom of a difference: the least of the trials and of repeats that scatter."""
    trials = experiment.trial_count or input_uncertainties().trials.count
    repeats = [len(one.seeds) for one in draws if np.ptp(one.primary) > 0.0]
    return max(min([trials, *repeats]) - 1, 1)


def _interval(value: float, draws: FloatArray) -> Interval:
    """Return the percentiles of draws, widened to hold the observed value."""
    low, high = np.quantile(draws, TAILS)
    return min(float(low), value), max(float(high), value)


# --- ranks and means -------------------------------------------------------------------------------------------------


def _experiment_ranks(
    experiment: GradedExperiment,
    pairs: Sequence[PairComparison],
    error_rate: float = ERROR_RATE,
) -> ExperimentRanks:
    members = [
        index for index, draws in enumerate(experiment.draws) if draws is not None
    ]
    known = [
        (pair, one)
        for pair in pairs
        for one in pair.experiments
        if one.id == experiment.id
    ]
    value = dict.fromkeys(members, 1.0)
    low = dict.fromkeys(members, 1)
    high = dict.fromkeys(members, len(members))
    for pair, one in known:
        value[pair.first] += 1.0 - one.probability_of_improvement
        value[pair.second] += one.probability_of_improvement
        if one.p_holm < error_rate:
            is_first_closer = one.difference < 0.0
            low[pair.second if is_first_closer else pair.first] += 1
            high[pair.first if is_first_closer else pair.second] -= 1
    return ExperimentRanks(
        id=experiment.id,
        ranks={
            index: Mean(
                value=one, interval_95=(min(low[index], one), max(high[index], one))
            )
            for index, one in value.items()
        },
        pair_count=len(known),
        distinguishable_count=sum(one.distinguishable for _, one in known),
    )


def _mean_rank(ranks: Sequence[Mean]) -> Mean:
    low, high = np.mean([one.interval_95 for one in ranks], axis=0)
    return Mean(
        value=float(np.mean([one.value for one in ranks])),
        interval_95=(float(low), float(high)),
    )


def _mean_score(common: Sequence[GradedExperiment], index: int) -> Mean:
    scores = [known.mean() for one in common if (known := one.draws[index]) is not None]
    # The scatter of few repeats may take a draw below zero, where no score is.
    draws = np.maximum([drawn for _, drawn in scores], 0.0).mean(axis=0)
    value = float(np.mean([score for score, _ in scores]))
    interval = (
        common[0].intervals[index] if len(common) == 1 and common[0].intervals else None
    )
    return Mean(value=value, interval_95=interval or _mean_interval(value, draws))


def _mean_interval(value: float, draws: FloatArray) -> Interval:
    """Return the smallest interval that holds the percentiles of draws, and their bias-corrected percentiles.

    A distance plus an error is longer on average, which adds up in a mean. The correction (Efron 1981) moves the median
    of the draws to the observed value. It is too large where scores are far below their errors, and the plain
    percentiles are then the better ones.
    """
    below = float(np.mean(draws < value) + 0.5 * np.mean(draws == value))
    shift = 2.0 * ndtri(np.clip(below, 1.0 / len(draws), 1.0 - 1.0 / len(draws)))
    corrected = ndtr(shift + ndtri(TAILS))
    low, high = np.quantile(
        draws, [min(TAILS[0], corrected[0]), max(TAILS[1], corrected[1])]
    )
    return min(float(low), value), max(float(high), value)
