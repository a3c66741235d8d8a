"""Quantiles, a root and a minimum without SciPy, whose import takes longer than to score a slide."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from gauge_envs.scene.geometry import FloatArray

GRID_POINTS = 9
"""Points of each grid of `bounded_minimum`; the next grid covers the two intervals about its least value."""


def rising_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the root of a rising function between two arguments to its last bit, by bisection."""
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        if function(middle) < 0.0:
            low = middle
        else:
            high = middle


def normal_probability(value: float) -> float:
    """Return the probability that a standard normal variable is below a value."""
    return 0.5 * math.erfc(-value / math.sqrt(2.0))


@cache
def share_interval(successes: float, count: float, level: float) -> tuple[float, float]:
    """Return the exact interval of the share of successes in all trials (Clopper and Pearson 1934).

    Args:
        successes: Number of successes; parts of one where trials depend on each other.
        count: Number of trials.
        level: Coverage of the interval.
    """
    low, high = 0.0, 1.0
    tail = 0.5 * (1.0 - level)
    if successes > 0.0:
        low = _beta_quantile(tail, successes, count - successes + 1.0)
    if successes < count:
        high = _beta_quantile(1.0 - tail, successes + 1.0, count - successes)
    return low, high


@cache
def student_quantile(freedom: float, probability: float) -> float:
    """Return the value below which a Student variable is with a probability of more than 0.5."""
    share = _beta_quantile(2.0 * probability - 1.0, 0.5, 0.5 * freedom)
    return math.sqrt(freedom * share / (1.0 - share))


def _beta_quantile(probability: float, first: float, second: float) -> float:
    return rising_root(
        lambda value: _beta_probability(value, first, second) - probability, 0.0, 1.0
    )


def _beta_probability(value: float, first: float, second: float) -> float:
    """Return the probability that a beta variable is below a value, by a continued fraction (DLMF 8.17.22)."""
    both = first + second
    if value * (both + 2.0) > first + 1.0:
        return 1.0 - _beta_probability(1.0 - value, second, first)
    tail = 0.0
    for order in range(int(20.0 + 3.0 * math.sqrt(both)), 0, -1):
        half, place = order // 2, first + order
        factor = (
            -(first + half) * (both + half) if order % 2 else half * (second - half)
        )
        tail = factor * value / ((place - 1.0) * place * (1.0 + tail))
    logarithm = math.lgamma(both) - math.lgamma(first) - math.lgamma(second)
    logarithm += first * math.log(value) + second * math.log1p(-value)
    return math.exp(logarithm) / (first * (1.0 + tail))


def interpolated(
    queries_s: FloatArray,
    times_s: FloatArray,
    values: FloatArray,
    *,
    after: float | None = None,
) -> FloatArray:
    """Return values that are linear between samples and constant before them, shape [..., C].

    Args:
        queries_s: Times [s], any shape.
        times_s: Times of the samples [s], strictly ascending, shape [sample_count].
        values: Samples, shape [sample_count, C].
        after: Value after the last sample; None is that of the last sample.
    """
    columns = [np.interp(queries_s, times_s, one, right=after) for one in values.T]
    return np.stack(columns, axis=-1)


def tall_product(tall: FloatArray, other: FloatArray) -> FloatArray:
    """Return the product of many rows, shape [row_count, k], and shape [k] or [k, C], by parts.

    They are so small that OpenBLAS starts no threads, whose waiting takes more CPU time than the product.
    """
    limit = 8_000 if other.ndim == 1 else 200_000
    parts = np.array_split(tall, 1 + len(tall) * other.size // limit)
    return np.concatenate([part @ other for part in parts])


def bounded_minimum(
    function: Callable[[FloatArray], FloatArray],
    low: float,
    high: float,
    tolerance: float,
) -> tuple[float, float]:
    """Return the argument and the value of the minimum of a function with a single one between bounds.

    Args:
        function: Values at arguments, shape [count] each.
        low: Least argument.
        high: Largest argument.
        tolerance: Largest error of the argument.
    """
    while True:
        arguments = np.linspace(low, high, GRID_POINTS)
        values = function(arguments)
        best = int(values.argmin())
        step = float(arguments[1] - arguments[0])
        if (GRID_POINTS - 1) * step <= tolerance:
            return float(arguments[0] + best * step), float(values.min())
        low = float(arguments[0] + max(best - 1, 0) * step)
        high = float(arguments[0] + min(best + 1, GRID_POINTS - 1) * step)
