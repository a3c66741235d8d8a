"""Ranks of configurations in each experiment, and over the experiments of one kind of reference.

Nothing is compared across kinds, because they answer different questions. Configurations with the same constants are a
group of their own: a rank among engines of which some have better constants ranks the constants.

A configuration ranks behind those whose difference is resolved: its 95 % interval excludes differences of at most
`NEGLIGIBLE`. The interval of a rank reaches from the best to the worst rank among those that are not resolved, and its
value is the middle. The mean rank over a kind counts each experiment the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gauge_envs.references.kind import Kind
from gauge_envs.scoring.score import Interval
from gauge_envs.tools.compare.difference import Deviations, difference_interval

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
class KindScore:
    """One configuration over the experiments of a kind that all configurations have scored.

    Attributes:
        configuration: Index of the configuration.
        mean_rank: Mean over the experiments of the rank in each; None without common experiments.
        mean: Mean of the primary score. The experiment with the largest scores decides it, so it is no order.
    """

    configuration: int
    mean_rank: Mean | None = None
    mean: Mean | None = None


@dataclass(frozen=True, kw_only=True)
class ScoredExperiment:
    """Scores of one experiment.

    Attributes:
        id: Gymnasium id.
        deviations: Deviations of each configuration; None for one without a score.
        intervals: 95 % interval of the primary score of each configuration, or None.
    """

    id: str
    deviations: tuple[Deviations | None, ...]
    intervals: tuple[Interval | None, ...]

    def ranks(self, members: Sequence[int]) -> dict[int, Mean]:
        """Return the rank of each of these configurations that has a score."""
        scored = {
            index: one
            for index in members
            if (one := self.deviations[index]) is not None
        }
        best, worst = dict.fromkeys(scored, 1), dict.fromkeys(scored, len(scored))
        for (first, ours), (second, theirs) in combinations(scored.items(), 2):
            low, high = difference_interval(ours, theirs)
            if low > NEGLIGIBLE:
                best[first] += 1
                worst[second] -= 1
            elif high < -NEGLIGIBLE:
                best[second] += 1
                worst[first] -= 1
        return {
            index: Mean(
                value=0.5 * (best[index] + worst[index]),
                interval_95=(float(best[index]), float(worst[index])),
            )
            for index in scored
        }


@dataclass(frozen=True, kw_only=True)
class ExperimentRanks:
    """Rank of each configuration with a score in one experiment, which `id` names."""

    id: str
    ranks: Mapping[int, Mean]


@dataclass(frozen=True, kw_only=True)
class KindComparison:
    """Configurations with the same constants over the experiments of one kind of reference.

    Attributes:
        kind: Kind of the references.
        constants: Name of the constants.
        ids: Experiments that all configurations have scored.
        scores: One entry for each configuration with a score of this kind.
        experiments: Ranks in each experiment with a score.
    """

    kind: str
    constants: str
    ids: tuple[str, ...]
    scores: tuple[KindScore, ...]
    experiments: tuple[ExperimentRanks, ...]

    @property
    def ranked(self) -> list[KindScore]:
        """The scores, lowest mean rank first."""
        return sorted(
            self.scores, key=lambda one: one.mean_rank.value if one.mean_rank else 0.0
        )

    @property
    def is_solution(self) -> bool:
        """Whether its references are solutions of the scenes, and not reality."""
        return Kind(self.kind).is_solution

    @property
    def name(self) -> str:
        """Kind, and constants that are not the published ones."""
        return (
            self.kind
            if self.constants == PUBLISHED
            else f"{self.kind}, {self.constants}"
        )


def compare_kind(
    kind: str, experiments: Sequence[ScoredExperiment], constants: Sequence[str]
) -> tuple[KindComparison, ...]:
    """Return a comparison for each set of constants, the published ones first.

    Args:
        kind: Kind of the references.
        experiments: Experiments of that kind, with the same configurations in the same order.
        constants: Name of the constants of each configuration.
    """
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(constants):
        if any(one.deviations[index] is not None for one in experiments):
            groups.setdefault(name, []).append(index)
    return tuple(
        _compared(kind, name, experiments, groups[name])
        for name in sorted(groups, key=lambda name: (name != PUBLISHED, name))
    )


def _compared(
    kind: str,
    constants: str,
    experiments: Sequence[ScoredExperiment],
    members: Sequence[int],
) -> KindComparison:
    """Return the comparison of configurations with the same constants."""
    ranks = {one.id: one.ranks(members) for one in experiments}
    common = [one for one in experiments if len(ranks[one.id]) == len(members)]
    scores = [KindScore(configuration=index) for index in members]
    if common:
        scores = [
            KindScore(
                configuration=index,
                mean_rank=_mean_rank([ranks[one.id][index] for one in common]),
                mean=_mean_score(common, index),
            )
            for index in members
        ]
    return KindComparison(
        kind=kind,
        constants=constants,
        ids=tuple(one.id for one in common),
        scores=tuple(scores),
        experiments=tuple(
            ExperimentRanks(id=name, ranks=found)
            for name, found in ranks.items()
            if found
        ),
    )


def _mean_rank(ranks: Sequence[Mean]) -> Mean:
    best, worst = np.mean([one.interval_95 for one in ranks], axis=0)
    return Mean(
        value=float(np.mean([one.value for one in ranks])),
        interval_95=(float(best), float(worst)),
    )


def _mean_score(common: Sequence[ScoredExperiment], index: int) -> Mean:
    """Return the mean over experiments; their references are independent, so widths add in quadrature."""
    values, widths = [], []
    for one in common:
        deviations, interval = one.deviations[index], one.intervals[index]
        assert deviations is not None
        value = float(deviations.scores.mean())
        low, high = interval or (value, value)
        values.append(value)
        widths.append((value - low, high - value))
    mean = float(np.mean(values))
    below, above = np.linalg.norm(widths, axis=0) / len(values)
    return Mean(
        value=mean, interval_95=(max(mean - float(below), 0.0), mean + float(above))
    )
