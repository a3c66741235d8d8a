"""Ranks of configurations in each experiment, and over the experiments of one grade of reference.

Nothing is compared across grades, because they answer different questions: `trials` and `recording` compare with real
motion, and `law` and `model` with the solution of the scene. Withheld bands are a group of their own, and so are
configurations with the same constants: a rank among engines of which some have better constants ranks the constants.

Ranks are by paired bootstrap: all configurations of an experiment have the same draws of the reference (`draws`). In a
draw, a configuration ranks behind those that are closer by more than `NEGLIGIBLE`; others tie. Its rank is the mean
over the draws, where a tie counts half. The 95 % interval reaches from its best rank among ties to its worst. The mean
rank over a grade counts each experiment the same, draw by draw: in a mean of scores, the experiment with the largest
scores decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import ndtr, ndtri

from gauge_envs.references.kind import Kind
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.dependence import LEVEL
from gauge_envs.tools.compare.draws import ScoreDraws, paired_scores

Interval = tuple[float, float]

TAILS: Interval = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
"""Percentiles at the ends of an interval."""

NEGLIGIBLE = 0.01
"""Difference of scores over their scale up to which two configurations tie: the last digit that tables show."""

PUBLISHED = "calibrated"
"""Constants of configurations with the parameters that the benchmark publishes."""


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
        mean_rank: Mean over the experiments of the rank in each; None without common experiments.
        mean: Mean of the primary score. The experiment with the largest scores decides it, so it is no order. None
            where scores have different units, as of exact solutions beside others.
    """

    configuration: int
    mean_rank: Mean | None = None
    mean: Mean | None = None


@dataclass(frozen=True, kw_only=True)
class ExperimentRanks:
    """Ranks of configurations in one experiment.

    Attributes:
        id: Gymnasium id.
        ranks: Rank of each configuration with a score.
    """

    id: str
    ranks: Mapping[int, Mean]


@dataclass(frozen=True, kw_only=True)
class GradeComparison:
    """Configurations with the same constants over the experiments of one grade.

    Attributes:
        grade: Grade of the references.
        withheld: Whether their bands are withheld by default.
        constants: Name of the constants.
        ids: Experiments that all configurations have scored.
        scores: One entry for each configuration with a score of this grade.
        experiments: Ranks in each experiment with a score.
    """

    grade: str
    withheld: bool
    constants: str
    ids: tuple[str, ...]
    scores: tuple[GradeScore, ...]
    experiments: tuple[ExperimentRanks, ...]

    @property
    def ranked(self) -> list[GradeScore]:
        """The scores, lowest mean rank first."""
        return sorted(
            self.scores, key=lambda one: one.mean_rank.value if one.mean_rank else 0.0
        )

    @property
    def is_verified(self) -> bool:
        """Whether its references are solutions of the scenes, and not reality."""
        return Kind(self.grade).is_solution

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
        scale_unit: Unit of the scores over their scale.
    """

    id: str
    draws: tuple[ScoreDraws | None, ...]
    intervals: tuple[Interval | None, ...] = ()
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
    constants: Sequence[str],
) -> tuple[GradeComparison, ...]:
    """Return a comparison for each set of constants, the published ones first.

    Args:
        grade: The grade.
        withheld: Whether the bands are withheld by default.
        experiments: Experiments of that grade, with the same configurations in the same order.
        constants: Name of the constants of each configuration.
    """
    present = [
        index
        for index in range(len(constants))
        if any(one.draws[index] is not None for one in experiments)
    ]
    compared = []
    for name in sorted({constants[index] for index in present}, key=_order):
        members = [index for index in present if constants[index] == name]
        graded = [one.among(members) for one in experiments]
        compared.append(_compared(grade, withheld, name, graded, members))
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
    scored = [
        one for one in experiments if any(draws is not None for draws in one.draws)
    ]
    common = [
        one for one in scored if all(one.draws[index] is not None for index in members)
    ]
    drawn = {one.id: _drawn_ranks(one) for one in scored}
    scores = []
    for index in members:
        score = GradeScore(configuration=index)
        if common:
            ranks = [drawn[one.id][index] for one in common]
            score = GradeScore(
                configuration=index,
                mean_rank=_rank(
                    np.mean([best for best, _ in ranks], axis=0),
                    np.mean([worst for _, worst in ranks], axis=0),
                ),
                mean=_mean_score(common, index)
                if len({one.scale_unit for one in common}) == 1
                else None,
            )
        scores.append(score)
    return GradeComparison(
        grade=grade,
        withheld=withheld,
        constants=constants,
        ids=tuple(one.id for one in common),
        scores=tuple(scores),
        experiments=tuple(
            ExperimentRanks(
                id=name,
                ranks={
                    index: _rank(best, worst) for index, (best, worst) in ranks.items()
                },
            )
            for name, ranks in drawn.items()
        ),
    )


def _drawn_ranks(
    experiment: GradedExperiment,
) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Return the best and the worst rank of each scored configuration in each draw, shape [draw_count] each."""
    scored = {
        index: draws
        for index, draws in enumerate(experiment.draws)
        if draws is not None
    }
    ranks = {
        index: (np.ones(draws.draws.shape[1]), np.ones(draws.draws.shape[1]))
        for index, draws in scored.items()
    }
    for (first, ours), (second, theirs) in combinations(scored.items(), 2):
        (_, drawn), (_, other_drawn) = paired_scores(ours, theirs)
        apart = drawn - other_drawn
        for index, difference in ((first, apart), (second, -apart)):
            best, worst = ranks[index]
            best += difference > NEGLIGIBLE
            worst += difference >= -NEGLIGIBLE
    return ranks


def _rank(best: FloatArray, worst: FloatArray) -> Mean:
    """Return a rank from the best and the worst one in each draw."""
    return Mean(
        value=float(0.5 * (best + worst).mean()),
        interval_95=(
            float(np.quantile(best, TAILS[0], method="lower")),
            float(np.quantile(worst, TAILS[1], method="higher")),
        ),
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
