"""Scores of repeats: their mean and scatter, and bootstrap draws that are paired between configurations.

A draw has a mean and a baseline that the real trials could have had as well. All configurations of an experiment share
these draws, so the errors of the reference cancel in a difference. Draws of two experiments are independent.

The solution of a scene has an error e of which its uncertainty u alone is known, as the root mean square. Of two
deviations a and b from it, |a + e|^2 - |b + e|^2 = |a|^2 - |b|^2 + 2 e (a - b): the component of e along a - b decides
which one is closer, and its standard deviation is at most u. So a pair is drawn with the whole u along a - b. That is
the case in which the two are told apart least.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import SAMPLES_PER_FRAME
from gauge_envs.scoring.dependence import LEVEL, widening
from gauge_envs.scoring.deviation import band_deviations
from gauge_envs.scoring.error_sources import DRAW_COUNT, SEED
from gauge_envs.scoring.numerics import student_quantile
from gauge_envs.scoring.verification import (
    compared_points,
    frame_deviation,
    solution_uncertainty,
    verification_band,
)

DRAWN_REPEATS = 20
"""Largest number of repeats whose scores are drawn. The errors of a reference move each repeat nearly alike."""

GROUPED_REPEATS = 200
"""Largest number of values of which a mean is drawn; of more repeats, means of as many groups."""


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
        half = spread.std / math.sqrt(spread.count)
        half *= student_quantile(spread.count - 1, 0.5 * (1.0 + LEVEL))
    below, above = (
        math.hypot(spread.mean - low, half),
        math.hypot(high - spread.mean, half),
    )
    return max(spread.mean - below, 0.0), spread.mean + above


@dataclass(frozen=True, eq=False)
class ScoreDraws:
    """Scores of the repeats of a configuration in one experiment over their scale, with draws.

    Attributes:
        seeds: Seed of each repeat.
        raw: E_RMSE of the paper over that of real trials, or the distance from the solution over its scale (see
            `Verification.scale`), shape [repeat_count].
        primary: The score that reports show first, aligned if the experiment starts with a release, same shape.
        draws: Draws of it for the first repeats, at most `DRAWN_REPEATS`, shape [drawn_count, draw_count].
        influences: Effect of each real trial on them, shape [drawn_count, trial_count]; no columns without trials.
        deviations: Deviation of each repeat from the solution over the scale, as a vector whose norm is `primary`,
            shape [repeat_count, entry_count]; None for scores over real trials.
        errors: Length of the error of the solution in each draw, over the scale, shape [draw_count]; None as above.
    """

    seeds: tuple[int | None, ...]
    raw: FloatArray
    primary: FloatArray
    draws: FloatArray
    influences: FloatArray
    deviations: FloatArray | None = None
    errors: FloatArray | None = None

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
    if band.kind.is_solution:
        return _solution_draws(results, experiment, band)
    raw, primary = np.empty(len(results)), np.empty(len(results))
    draws = np.empty((min(len(results), DRAWN_REPEATS), DRAW_COUNT))
    influences = []
    # The random numbers of a source depend on its name alone. Another order makes those of experiments independent.
    order = _random(experiment).permutation(DRAW_COUNT)
    for index, result in enumerate(results):
        found = result.score.validation
        if result.trajectory is None or found is None or found.rmse_normalized is None:
            return None
        if index >= len(draws):
            raw[index] = found.rmse_normalized
            primary[index] = result.score.primary_normalized
            continue
        times_s, values = result.trajectory.arrays(later=True)
        deviations = band_deviations(experiment, band, times_s=times_s, values=values)
        first = deviations.first
        if (baseline := first.baseline) is None:
            return None
        raw[index] = deviations.raw.normalized or 0.0
        primary[index] = first.rmse / baseline
        draws[index] = first.errors.draws(first.values)[order] / baseline
        influences.append(first.errors.influences(first.values) / baseline)
    return ScoreDraws(
        seeds=tuple(result.seed for result in results),
        raw=raw,
        primary=primary,
        draws=draws,
        influences=np.array(influences),
    )


def _random(experiment: Experiment) -> np.random.Generator:
    return np.random.default_rng([SEED, *experiment.name.encode()])


def _solution_draws(
    results: Sequence[Result], experiment: Experiment, band: Band
) -> ScoreDraws | None:
    """Return the draws of distances from a solution; None if a repeat has no trajectory, or no marker to compare."""
    compared, uncertainty = verification_band(band), solution_uncertainty(band)
    assert compared is not None
    scale = uncertainty or 1.0
    frame_count = int(np.isfinite(compared.mean).any(axis=1).sum())
    rows = []
    for result in results:
        recorded = result.trajectory
        if recorded is None:
            return None
        frames = recorded.arrays()[1][::SAMPLES_PER_FRAME]
        deviation = frame_deviation(band, frames=frames, markers_m=recorded.markers_m())
        if deviation is None:
            return None
        rows.append(np.nan_to_num(deviation).ravel())
    # A norm is then the root mean square over frames and markers, over the scale.
    size = scale * math.sqrt(frame_count * compared_points(compared))
    deviations = np.array(rows) / size
    distances = np.linalg.norm(deviations, axis=1)
    # Over u, the error of a solution has the standard deviation 1. An exact solution has none.
    standard = 1.0 if uncertainty else 0.0
    errors = standard * _random(experiment).standard_normal(DRAW_COUNT)
    return ScoreDraws(
        seeds=tuple(result.seed for result in results),
        raw=distances,
        primary=distances,
        draws=np.maximum(distances[:DRAWN_REPEATS, None] + errors, 0.0),
        influences=np.zeros((min(len(results), DRAWN_REPEATS), 0)),
        deviations=deviations,
        errors=errors,
    )


def _along_difference(
    first: ScoreDraws,
    chosen: Sequence[int],
    second: ScoreDraws,
    others: Sequence[int],
) -> tuple[ScoreDraws, ScoreDraws]:
    """Return distances from a solution whose error lies along the difference of the two; others as they are."""
    if first.deviations is None or second.deviations is None:
        return first, second
    apart = first.deviations[list(chosen)].mean(axis=0)
    apart = apart - second.deviations[list(others)].mean(axis=0)
    direction = apart / max(length_of(apart), 1e-300)
    moved = []
    for one, deviations in ((first, first.deviations), (second, second.deviations)):
        assert one.errors is not None
        drawn = len(one.draws)
        along = 2.0 * np.outer(deviations[:drawn] @ direction, one.errors)
        squares = np.square(one.primary[:drawn, None]) + along + np.square(one.errors)
        moved.append(replace(one, draws=np.sqrt(np.maximum(squares, 0.0))))
    return moved[0], moved[1]


def paired_scores(
    first: ScoreDraws, second: ScoreDraws
) -> tuple[tuple[float, FloatArray], tuple[float, FloatArray]]:
    """Return the mean primary score of two configurations, each with its draws of shape [draw_count].

    Repeats are paired by seed: those of a seed that only one of the two has are left out. Without a common seed, all
    repeats of each count. Where the trials that decide between the two depend on each other, draws are wider by as much
    as that takes: no difference is refused.
    """
    chosen, others = _common_repeats(first, second)
    first, second = _along_difference(first, chosen, second, others)
    wider = widening(_influence(first, chosen) - _influence(second, others))
    return _mean(first, chosen, wider=wider), _mean(second, others, wider=wider)


def _common_repeats(
    first: ScoreDraws, second: ScoreDraws
) -> tuple[Sequence[int], Sequence[int]]:
    places = {seed: place for place, seed in enumerate(second.seeds)}
    common = [place for place, seed in enumerate(first.seeds) if seed in places]
    if not common:
        return range(len(first.seeds)), range(len(second.seeds))
    return common, [places[first.seeds[place]] for place in common]


def _drawn(scores: ScoreDraws, chosen: Sequence[int]) -> list[int]:
    """Return the places of chosen repeats that are drawn; those of all that are, if none is chosen."""
    count = len(scores.draws)
    return [place for place in chosen if place < count] or [*range(count)]


def _influence(scores: ScoreDraws, chosen: Sequence[int]) -> FloatArray:
    return np.asarray(scores.influences[_drawn(scores, chosen)].mean(axis=0))


def _mean(
    scores: ScoreDraws, chosen: Sequence[int], *, wider: float
) -> tuple[float, FloatArray]:
    """Return the mean over repeats and its draws, which also scatter as the mean of so few repeats does."""
    values = scores.primary[list(chosen)]
    mean = float(values.mean())
    drawn = _drawn(scores, chosen)
    draw_count = scores.draws.shape[1]
    if len(drawn) == len(values):
        weights = _repeat_weights(len(values), draw_count)
        spread = np.einsum("kn,nk->k", weights, scores.draws[drawn])
        if wider != 1.0:
            spread = wider * spread + (1.0 - wider) * (weights @ values)
        return mean, spread
    of_reference = (scores.draws[drawn] - scores.primary[drawn, None]).mean(axis=0)
    groups = np.array_split(values, min(len(values), GROUPED_REPEATS))
    means = np.array([group.mean() for group in groups])
    scatter = _repeat_weights(len(means), draw_count) @ (means - means.mean())
    return mean, mean + scatter + wider * of_reference


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
    weights = random.standard_normal((draw_count, count))
    weights -= weights.mean(axis=1, keepdims=True)
    # The sum of across times values has the variance of the sum of squares about their mean, (count - 1) s^2.
    scale = np.sqrt(random.chisquare(count - 1, draw_count) * count)
    weights /= scale[:, None]
    weights += 1.0 / count
    return weights
