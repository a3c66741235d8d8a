"""Rank configurations in each experiment, and over the experiments of one kind of reference.

Kinds of reference answer different questions, so scores are compared only within a kind. Only configurations with the
same constants are ranked together: otherwise better constants would rank above better engines.

A configuration ranks behind another when the 95 % interval of their difference excludes differences of at most
`NEGLIGIBLE`. Configurations whose difference is not resolved share an interval of ranks, from the best to the worst
possible one. The value of a rank is the middle of its interval. All experiments of a kind have the same weight.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gauge_envs.references.kind import Kind
from gauge_envs.scoring.score import Interval
from gauge_envs.tools.compare.statistics import Deviations, difference_interval

NEGLIGIBLE = 0.01
"""Largest difference of normalized scores of two tied configurations: the last digit in tables."""

PUBLISHED = "published"
"""Constants of configurations with the parameters that the benchmark publishes."""


@dataclass(frozen=True, kw_only=True)
class Mean:
    """A mean with its interval.

    Attributes:
        value: Mean.
        interval_95: 95 % interval.
    """

    value: float
    interval_95: Interval


@dataclass(frozen=True, kw_only=True)
class KindComparison:
    """Ranks of configurations with the same constants in the experiments of one kind of reference.

    Attributes:
        kind: Kind of the references.
        constants: Name of the constants.
        ids: Experiments in which all configurations have a score.
        mean_ranks: Mean rank of each configuration with a score of this kind, by index, over `ids`; None without ids.
        ranks: Ranks in each experiment with a score, by id and index of the configuration.
    """

    kind: Kind
    constants: str
    ids: tuple[str, ...]
    mean_ranks: Mapping[int, Mean | None]
    ranks: Mapping[str, Mapping[int, Mean]]

    @property
    def name(self) -> str:
        """Kind, with the constants unless they are the published ones."""
        if self.constants == PUBLISHED:
            return self.kind.value
        return f"{self.kind}, {self.constants}"


def compare_kind(
    kind: Kind, ranks: Mapping[str, Mapping[int, Mean]], constants: Sequence[str]
) -> tuple[KindComparison, ...]:
    """Return the ranks for each set of constants, the published constants first.

    Args:
        kind: Kind of the references.
        ranks: Ranks in each experiment of this kind, by id and index of the configuration.
        constants: Name of the constants of each configuration.
    """
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(constants):
        if any(index in places for places in ranks.values()):
            groups.setdefault(name, []).append(index)
    names = sorted(groups, key=lambda name: (name != PUBLISHED, name))
    return tuple(_compared(kind, name, ranks, groups[name]) for name in names)


def _compared(
    kind: Kind,
    constants: str,
    all_ranks: Mapping[str, Mapping[int, Mean]],
    members: Sequence[int],
) -> KindComparison:
    """Return the ranks of configurations with the same constants."""
    ranks = {
        name: {index: places[index] for index in members if index in places}
        for name, places in all_ranks.items()
    }
    common = [name for name, places in ranks.items() if len(places) == len(members)]
    return KindComparison(
        kind=kind,
        constants=constants,
        ids=tuple(common),
        mean_ranks={
            index: _mean_rank([ranks[name][index] for name in common])
            for index in members
        },
        ranks={name: places for name, places in ranks.items() if places},
    )


def rank_deviations(
    deviations: Mapping[int, Deviations], constants: Sequence[str]
) -> dict[int, Mean]:
    """Return the rank of each configuration in an experiment among those with the same constants.

    Args:
        deviations: Deviations of the configurations with a score, by index.
        constants: Name of the constants of each configuration.
    """
    counts = Counter(constants[index] for index in deviations)
    best = dict.fromkeys(deviations, 1)
    worst = {index: counts[constants[index]] for index in deviations}
    for first, second in combinations(deviations, 2):
        if constants[first] != constants[second]:
            continue
        low, high = difference_interval(deviations[first], deviations[second])
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
        for index in deviations
    }


def _mean_rank(ranks: Sequence[Mean]) -> Mean | None:
    """Return the mean of ranks and of their best and worst values; None without ranks."""
    if not ranks:
        return None
    best, worst = np.mean([rank.interval_95 for rank in ranks], axis=0)
    value = float(np.mean([rank.value for rank in ranks]))
    return Mean(value=value, interval_95=(float(best), float(worst)))
