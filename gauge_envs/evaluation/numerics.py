"""Quantiles, a root and a minimum without SciPy, whose import takes longer than to simulate and score a slide."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from gauge_envs.scene.geometry import FloatArray

FRACTION_TERMS = 500
"""Most terms of the continued fraction of the incomplete beta function."""

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


def _beta_fraction(a: float, b: float, x: float) -> float:
    """Return the continued fraction of the incomplete beta function (DLMF 8.17.22), by Lentz's method."""
    tiny = 1e-300
    value = ratio = 1.0
    inverse = 0.0
    for term in range(FRACTION_TERMS):
        half = term // 2
        if term == 0:
            factor = 1.0
        elif term % 2:
            factor = -(a + half) * (a + b + half) * x
            factor /= (a + 2 * half) * (a + 2 * half + 1.0)
        else:
            factor = half * (b - half) * x / ((a + 2 * half - 1.0) * (a + 2 * half))
        inverse = 1.0 / ((1.0 + factor * inverse) or tiny)
        ratio = (1.0 + factor / ratio) or tiny
        value *= inverse * ratio
        if abs(inverse * ratio - 1.0) < 1e-15:
            break
    return value - 1.0


def beta_probability(a: float, b: float, x: float) -> float:
    """Return the regularized incomplete beta function, the probability that a beta variable is below x in 0 to 1."""
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - beta_probability(b, a, 1.0 - x)
    if x <= 0.0:
        return 0.0
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    log_front += a * math.log(x) + b * math.log1p(-x)
    return math.exp(log_front) * _beta_fraction(a, b, x) / a


@lru_cache(maxsize=256)
def beta_quantile(a: float, b: float, probability: float) -> float:
    """Return the value below which a beta variable is with a probability."""
    return rising_root(lambda x: beta_probability(a, b, x) - probability, 0.0, 1.0)


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
        low = beta_quantile(successes, count - successes + 1.0, tail)
    if successes < count:
        high = beta_quantile(successes + 1.0, count - successes, 1.0 - tail)
    return low, high


def student_quantile(freedom: float, probability: float) -> float:
    """Return the value below which a Student variable is with a probability of at least 1/2.

    Args:
        freedom: Degrees of freedom.
        probability: The probability.
    """
    share = beta_quantile(0.5, 0.5 * freedom, 2.0 * probability - 1.0)
    return math.sqrt(freedom * share / (1.0 - share))


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
        best = int(np.argmin(values))
        if high - low <= tolerance:
            return float(arguments[best]), float(values[best])
        low = float(arguments[max(best - 1, 0)])
        high = float(arguments[min(best + 1, GRID_POINTS - 1)])
