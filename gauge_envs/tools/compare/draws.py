"""Scores of repeats: their mean and scatter, and bootstrap draws that are paired between configurations.

A draw has a mean and a baseline that the real trials could have had as well. All configurations of an experiment share
these draws, so the errors of the reference cancel in a difference. Draws of two experiments are independent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import t as student

from gauge_envs.evaluation.deviation import band_deviations
from gauge_envs.evaluation.uncertainty import LEVEL, SEED, widening
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scene.geometry import FloatArray


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


def repeats_interval(
    values: Sequence[float], intervals: Sequence[tuple[float, float]]
) -> tuple[float, float]:
    """Return the 95 % interval of the mean of normalized scores over repeats.

    Two things are random. The repeats share the sample of real trials and the uncertain inputs, so the mean of their
    intervals is that of their mean. Each repeat has a start of its own, so the mean of a few has a standard error,
    which Student's t makes an interval. The two are independent, and their widths add in quadrature on each side.

    Args:
        values: Score of each repeat, at least one.
        intervals: 95 % interval of each score.
    """
    spread = ScoreSpread.of(values)
    assert spread is not None
    low, high = np.mean(intervals, axis=0)
    half = 0.0
    if spread.std:
        half = (
            float(student.ppf(0.5 * (1.0 + LEVEL), spread.count - 1))
            * spread.std
            / math.sqrt(spread.count)
        )
    below, above = (
        math.hypot(spread.mean - low, half),
        math.hypot(high - spread.mean, half),
    )
    return max(spread.mean - below, 0.0), spread.mean + above


@dataclass(frozen=True, eq=False)
class ScoreDraws:
    """Normalized RMSE of the repeats of a configuration in one experiment, with its draws.

    Attributes:
        seeds: Seed of each repeat.
        raw: E_RMSE of the paper, normalized, shape [repeat_count].
        primary: The score that reports show first, aligned if the experiment starts with a release, same shape.
        draws: Draws of it, shape [repeat_count, draw_count].
        influences: Effect of each real trial on it, shape [repeat_count, trial_count]; no columns without trials.
    """

    seeds: tuple[int | None, ...]
    raw: FloatArray
    primary: FloatArray
    draws: FloatArray
    influences: FloatArray

    def mean(self) -> tuple[float, FloatArray]:
        """Return the mean of the primary score over the repeats, and its draws of shape [draw_count]."""
        every = range(len(self.seeds))
        return _mean(self, every, wider=widening(_influence(self, every)))


def score_draws(
    results: Sequence[Result], experiment: Experiment, band: Band
) -> ScoreDraws | None:
    """Return the draws of the repeats of one configuration in one experiment.

    Returns:
        The draws; None if a repeat has no score, because a mean without failures would be too good.
    """
    if any(result.outcome is not Outcome.FINISHED for result in results):
        return None
    raw: list[float] = []
    drawn: list[tuple[float, FloatArray, FloatArray]] = []
    for result in results:
        if result.trajectory is None or result.score.rmse_normalized is None:
            return None
        times_s, values = result.trajectory.arrays(later=True)
        deviations = band_deviations(experiment, band, times_s=times_s, values=values)
        first = deviations.first
        if (baseline := first.baseline) is None:
            return None
        draws, influences = (
            first.errors.draws(first.values),
            first.errors.influences(first.values),
        )
        raw.append(deviations.raw.normalized or 0.0)
        drawn.append((first.rmse / baseline, draws / baseline, influences / baseline))
    # The random numbers of a source depend on its name alone. Another order makes those of experiments independent.
    order = np.random.default_rng([SEED, *experiment.name.encode()]).permutation(
        len(drawn[0][1])
    )
    return ScoreDraws(
        seeds=tuple(result.seed for result in results),
        raw=np.array(raw),
        primary=np.array([score for score, _, _ in drawn]),
        draws=np.array([draws[order] for _, draws, _ in drawn]),
        influences=np.array([influences for _, _, influences in drawn]),
    )


def paired_scores(
    first: ScoreDraws, second: ScoreDraws
) -> tuple[tuple[float, FloatArray], tuple[float, FloatArray]]:
    """Return the mean primary score of two configurations, each with its draws of shape [draw_count].

    Repeats are paired by seed: those of a seed that only one of the two has are left out. Without a common seed, all
    repeats of each count. Where the trials that decide between the two depend on each other, draws are wider by as much
    as that takes: no difference is refused.
    """
    chosen, others = _common_repeats(first, second)
    wider = widening(_influence(first, chosen) - _influence(second, others))
    return _mean(first, chosen, wider=wider), _mean(second, others, wider=wider)


def _common_repeats(
    first: ScoreDraws, second: ScoreDraws
) -> tuple[Sequence[int], Sequence[int]]:
    common = [seed for seed in first.seeds if seed in second.seeds]
    if not common:
        return range(len(first.seeds)), range(len(second.seeds))
    return [first.seeds.index(seed) for seed in common], [
        second.seeds.index(seed) for seed in common
    ]


def _influence(scores: ScoreDraws, chosen: Sequence[int]) -> FloatArray:
    return np.asarray(scores.influences[list(chosen)].mean(axis=0))


def _mean(
    scores: ScoreDraws, chosen: Sequence[int], *, wider: float
) -> tuple[float, FloatArray]:
    """Return the mean over repeats and its draws, which also scatter as the mean of so few repeats does."""
    index = list(chosen)
    values, draws = scores.primary[index], scores.draws[index]
    draws = values[:, None] + wider * (draws - values[:, None])
    weights = _repeat_weights(len(index), draws.shape[1])
    return float(values.mean()), np.einsum("kn,nk->k", weights, draws)


@cache
def _repeat_weights(count: int, draw_count: int) -> FloatArray:
    """Return weights of repeats with the sum 1, shape [draw_count, count].

    With them a weighted mean of `count` values is their mean plus the standard error of the mean times a number of
    Student's t with count - 1 degrees of freedom. Repeats that are drawn with replacement scatter too little if they
    are few: the 95 % interval of three then holds the true mean in 75 %. The weights depend on the number alone, so
    that repeats of two configurations are paired.
    """
    if count == 1:
        return np.ones((draw_count, 1))
    random = np.random.default_rng([SEED, *b"repeats"])
    normal = random.standard_normal((draw_count, count))
    across = normal - normal.mean(axis=1, keepdims=True)
    # The sum of across times values has the variance of the sum of squares about their mean, (count - 1) s^2.
    scale = np.sqrt(random.chisquare(count - 1, draw_count) * count)
    return 1.0 / count + across / scale[:, None]
