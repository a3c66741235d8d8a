"""Sources of the error of a band, each as shapes over frames with random factors (`scoring.uncertainty`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.uncertainties import PUBLISHED_TRIALS
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.dependence import LEAST_TRIALS
from gauge_envs.scoring.numerics import tall_product

DRAW_COUNT = 4000
"""Number of random draws; it gives the ends of an interval to about 2 % of its width."""

SEED = 20_260_711
"""Seed of the draws. It is fixed, so that scores repeat and engines are compared on the same draws."""

LEAST_SCATTER = math.sqrt(0.5 * math.pi - 1.0)
"""Relative standard deviation of the distances of trials that scatter normally in one direction, 0.76."""

PRIOR_TRIALS = 10
"""Number of trials that this scatter counts as, where that of the trials is smaller."""

UNSEEN_EXCESS = 2.0
"""How much farther than the mean distance an outlier lies, in mean distances, that a sample did not show.

It is chosen on half of the simulated worlds (`studies/coverage`)."""


@dataclass(frozen=True, kw_only=True)
class ErrorSource:
    """A group of error shapes of one kind (`scoring.uncertainty`); `columns` selects them."""

    kind: str
    columns: slice


def random_numbers(name: str) -> np.random.Generator:
    """Return the random numbers of one contribution; the same name gives the same numbers on every engine."""
    return np.random.default_rng([SEED, *name.encode()])


@cache
def trial_weights(count: int) -> FloatArray:
    """Return weights of trials with the sum 0, shape [draw_count, trial_count].

    With them a weighted sum of `count` values is the standard error of their mean times a number of Student's t with
    count - 1 degrees of freedom. The weights depend on the number alone, so the mean and each baseline have the same.
    """
    if count < 2:
        return np.zeros((DRAW_COUNT, count))
    random = random_numbers("sampling")
    normal = random.standard_normal((DRAW_COUNT, count))
    scale = np.sqrt(random.chisquare(count - 1, DRAW_COUNT) * count)
    return np.asarray((normal - normal.mean(axis=1, keepdims=True)) / scale[:, None])


def relative_influence(distances: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return the relative effect of each trial on the mean distance of trials, shape [trial_count].

    A trial has two effects: by its own distance, and by the mean, which it moves towards itself and away from others.
    The second one matters if more trials lie on one side, as with an outlier. Few trials may scatter little by chance.
    So their variance has `PRIOR_TRIALS` further degrees of freedom with that of normal scatter in as many directions,
    if it is smaller.

    Args:
        distances: Distance of each trial, shape [trial_count].
        residuals: Trials minus their mean, any scale, shape [trial_count, entry_count].
    """
    count, mean = len(distances), float(distances.mean())
    std = float(distances.std(ddof=1)) if count >= LEAST_TRIALS else 0.0
    if std <= 0.0:
        return np.zeros(count)
    products = residuals @ residuals.T
    lengths = np.sqrt(np.diag(products))
    # A common number of directions: that of equally large variances with the same sum and the same sum of squares.
    directions = max(
        float(np.trace(products)) ** 2 / max(float(np.square(products).sum()), 1e-300),
        1.0,
    )
    least = max(LEAST_SCATTER / math.sqrt(directions) * mean / std, 1.0) ** 2
    deviations = (distances / mean - 1.0) * math.sqrt(
        (count - 1 + PRIOR_TRIALS * least) / (count - 1 + PRIOR_TRIALS)
    )
    units = products / np.maximum(lengths, 1e-150)
    return np.asarray(
        deviations - units.mean(axis=1) / max(float(lengths.mean()), 1e-150)
    )


def baseline_draws(influence: FloatArray) -> FloatArray:
    """Return draws of the logarithm of the measured over the true mean distance of trials, shape [draw_count].

    A sample may lack the outliers of its population, and then its mean distance is too small. With n trials the share
    that none of them shows has the law Beta(1, n) before a flat prior (Laplace).

    Args:
        influence: Relative effect of each trial on the mean distance, shape [trial_count].
    """
    count = len(influence)
    return np.asarray(
        tall_product(trial_weights(count), influence) - _unseen_outliers(count)
    )


@cache
def _unseen_outliers(count: int) -> FloatArray:
    """Return what outliers that none of `count` trials shows add to that logarithm, shape [draw_count]."""
    unseen = random_numbers("unseen").beta(1.0, count, DRAW_COUNT)
    return np.asarray(np.log1p(UNSEEN_EXCESS * unseen))


@dataclass
class ErrorShapes:
    """Error shapes under construction.

    Attributes:
        shapes: Shapes of each source, each shape [count, entry_count].
        factors: Their random factors, each shape [draw_count, count].
        sources: The sources.
    """

    shapes: list[FloatArray]
    factors: list[FloatArray]
    sources: list[ErrorSource]

    def add(self, kind: str, shapes: Sequence[FloatArray], factors: FloatArray) -> None:
        """Add the shapes of one source; what no trial shows counts as no error."""
        start = sum(len(one) for one in self.shapes)
        kept = np.array([np.nan_to_num(shape) for shape in shapes])
        self.shapes.append(kept.reshape(len(kept), -1))
        self.factors.append(factors)
        columns = slice(start, start + len(kept))
        self.sources.append(ErrorSource(kind=kind, columns=columns))


def add_trials(band: Band, trials: FloatArray, shapes: ErrorShapes) -> FloatArray:
    """Add the errors of the mean of trials, in two parts: its shift in time, and the rest.

    Returns:
        Relative effect of each trial on the baseline, shape [trial_count].
    """
    count = len(trials)
    residuals = np.nan_to_num(trials - band.mean).reshape(count, -1)
    velocity = np.nan_to_num(
        np.gradient(np.nan_to_num(band.mean), axis=0) * np.isfinite(band.mean)
    ).ravel()
    size = float(velocity @ velocity)
    shift = (
        np.outer(residuals @ velocity, velocity) / size
        if size > 0.0
        else np.zeros_like(residuals)
    )
    weights = trial_weights(count)
    # The mean is subtracted, so an error of the mean enters with the other sign.
    shapes.add("release", list(-shift), weights)
    shapes.add("sampling", list(shift - residuals), weights)
    return relative_influence(np.linalg.norm(residuals, axis=1), residuals)


def add_spread(
    band: Band, baseline_spread: float | None, shapes: ErrorShapes
) -> FloatArray:
    """Add the error of a mean without single trials, and return that of the baseline in each draw."""
    scored_trials = band.trial_count or PUBLISHED_TRIALS
    trials = 1 if band.grade is BandGrade.RECORDING else scored_trials
    std_of_mean = band.sigma / math.sqrt(trials)
    columns = list(np.eye(band.mean.shape[1])[:, None] * std_of_mean)
    shapes.add(
        "sampling",
        columns,
        random_numbers("sampling").standard_normal((DRAW_COUNT, len(columns))),
    )
    if baseline_spread is None:
        return np.zeros(DRAW_COUNT)
    normal = random_numbers("baseline").standard_normal(DRAW_COUNT)
    ratio = np.maximum(1.0 + baseline_spread / math.sqrt(scored_trials) * normal, 0.1)
    return np.asarray(np.log(ratio))


def add_measurement(band: Band, shapes: ErrorShapes) -> None:
    """Add the stated uncertainty of a measured mean, that of extrapolated frames apart."""
    if band.uncertainty is None:
        return
    for kind, frames in (
        ("measurement", band.measured),
        ("extrapolation", ~band.measured),
    ):
        spread = np.where(
            frames[:, None] & np.isfinite(band.uncertainty), band.uncertainty, 0.0
        )
        if spread.any():
            columns = [unit * spread for unit in np.eye(spread.shape[1])]
            factors = random_numbers(kind).standard_normal((DRAW_COUNT, len(columns)))
            shapes.add(kind, columns, factors)
