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
from numpy.typing import NDArray
from scipy.stats import t as student

from gauge_envs.evaluation.deviation import band_deviations
from gauge_envs.evaluation.uncertainty import LEVEL, SEED, widening
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.runs.result import Outcome, Result

FloatArray = NDArray[np.float64]


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


def repeats_interval(values: Sequence[float], intervals: Sequence[tuple[float, float]]) -> tuple[float, float]:
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
        half = float(student.ppf(0.5 * (1.0 + LEVEL), spread.count - 1)) * spread.std / math.sqrt(spread.count)
    below, above = math.hypot(spread.mean - low, half), math.hypot(high - spread.mean, half)
    return max(spread.mean - below, 0.0), spread.mean + above


@dataclass(frozen=True, eq=False)
class ScoreDraws:
    """Normalized RMSE of the repeats of a configuration in one experiment, with its draws.

    Attributes:
        seeds: Seed of each repeat.
        raw: E_RMSE of the paper, normalized, shape [repeat_count].
        raw_draws: Its draws, shape [repeat_count, draw_count].
        raw_influences: Effect of each real trial on it, shape [repeat_count, trial_count]; no columns without trials.
        primary: The score that reports show first, aligned if the experiment starts with a release, same shape.
        primary_draws: Its draws.
        primary_influences: Effect of each real trial on it.
    """

    seeds: tuple[int | None, ...]
    raw: FloatArray
    raw_draws: FloatArray
    raw_influences: FloatArray
    primary: FloatArray
    primary_draws: FloatArray
    primary_influences: FloatArray

    def mean(self, *, raw: bool = False) -> tuple[float, FloatArray]:
        """Return the mean over the repeats, and its draws of shape [draw_count].

        Args:
            raw: Whether to take the raw score instead of the primary one.
        """
        every = range(len(self.seeds))
        return _mean(self, every, raw=raw, wider=widening(_influence(self, every, raw=raw)))


def score_draws(results: Sequence[Result], experiment: Experiment, band: Band) -> ScoreDraws | None:
    """Return the draws of the repeats of one configuration in one experiment.

    Returns:
        The draws; None if a repeat has no score, because a mean without failures would be too good.
    """
    if any(result.outcome is not Outcome.FINISHED for result in results):
        return None
    raw: list[tuple[float, FloatArray, FloatArray]] = []
    primary: list[tuple[float, FloatArray, FloatArray]] = []
    for result in results:
        if result.trajectory is None or result.score.rmse_normalized is None:
            return None
        times_s, values = result.trajectory.arrays(later=True)
        deviations = band_deviations(experiment, band, times_s=times_s, values=values)
        for deviation, drawn in ((deviations.raw, raw), (deviations.first, primary)):
            if (baseline := deviation.baseline) is None:
                return None
            draws = deviation.errors.draws(deviation.values)
            influences = deviation.errors.influences(deviation.values)
            drawn.append((deviation.rmse / baseline, draws / baseline, influences / baseline))
    # The random numbers of a source depend on its name alone. Another order makes those of experiments independent.
    draw_count = len(raw[0][1])
    order = np.random.default_rng([SEED, *experiment.name.encode()]).permutation(draw_count)
    return ScoreDraws(
        seeds=tuple(result.seed for result in results),
        raw=np.array([score for score, _, _ in raw]),
        raw_draws=np.array([draws[order] for _, draws, _ in raw]),
        raw_influences=np.array([influences for _, _, influences in raw]),
        primary=np.array([score for score, _, _ in primary]),
        primary_draws=np.array([draws[order] for _, draws, _ in primary]),
        primary_influences=np.array([influences for _, _, influences in primary]),
    )


def paired_scores(first: ScoreDraws, second: ScoreDraws) -> tuple[tuple[float, FloatArray], tuple[float, FloatArray]]:
    """Return the mean primary score of two configurations, each with its draws of shape [draw_count].

    Repeats are paired by seed: those of a seed that only one of the two has are left out. Without a common seed, all
    repeats of each count. Where the trials that decide between the two depend on each other, draws are wider by as much
    as that takes: no difference is refused.
    """
    chosen, others = _common_repeats(first, second)
    wider = widening(_influence(first, chosen, raw=False) - _influence(second, others, raw=False))
    return _mean(first, chosen, raw=False, wider=wider), _mean(second, others, raw=False, wider=wider)


def _common_repeats(first: ScoreDraws, second: ScoreDraws) -> tuple[Sequence[int], Sequence[int]]:
    common = [seed for seed in first.seeds if seed in second.seeds]
    if not common:
        return range(len(first.seeds)), range(len(second.seeds))
    return [first.seeds.index(seed) for seed in common], [second.seeds.index(seed) for seed in common]


def _influence(scores: ScoreDraws, chosen: Sequence[int], *, raw: bool) -> FloatArray:
    influences = scores.raw_influences if raw else scores.primary_influences
    return np.asarray(influences[list(chosen)].mean(axis=0))


def _mean(scores: ScoreDraws, chosen: Sequence[int], *, raw: bool, wider: float) -> tuple[float, FloatArray]:
    """Return the mean over repeats and its draws, which also scatter as the mean of so few repeats does."""
    index = list(chosen)
    values, draws = (scores.raw, scores.raw_draws) if raw else (scores.primary, scores.primary_draws)
    values, draws = values[index], draws[index]
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
