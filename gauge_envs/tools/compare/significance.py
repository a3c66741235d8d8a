"""Two-sided p-values of differences from paired draws, for one pair, one pair over experiments, and many pairs."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtr, stdtrit

from gauge_envs.evaluation.dependence import LEVEL
from gauge_envs.scene.geometry import FloatArray

NEGLIGIBLE = 0.01
"""Difference of scores over their scale up to which two configurations count as equal: the last digit that tables show,
a hundredth of the distance of a typical trial, of u of a solution, or of the unit of an exact one. Configurations share
the errors of the reference, so without this limit it would tell apart steps and solvers that differ by micrometres."""


def p_value(
    first: tuple[float, FloatArray], second: tuple[float, FloatArray], *, degrees: int
) -> float:
    """Return the two-sided p-value of the hypothesis that two scores differ by at most `NEGLIGIBLE`.

    It is below 0.05 where 97.5 % of the draws differ by more, with the sign of the observed difference. The tail cannot
    be counted: of 4000 draws, the smallest share on both sides is 0.0005, and the first of 153 pairs needs 0.0003. So
    Student's t continues it. It fits because the difference of two squared distances is linear in the mean of the
    trials. It is taken over the sum of the squares, in which the baseline cancels.

    Args:
        first: Score and its draws, shape [draw_count].
        second: The same of the other configuration, with paired draws.
        degrees: Degrees of freedom: number of real trials minus 1.
    """
    (one, one_draws), (other, other_draws) = first, second
    if abs(one - other) <= NEGLIGIBLE:
        return 1.0
    sign = 1.0 if one > other else -1.0
    limit = 0.5 * sign * NEGLIGIBLE
    observed = _contrast(one - limit, other + limit)
    draws = _contrast(one_draws - limit, other_draws + limit)
    half = sign * float(observed) - float(
        np.quantile(sign * draws, 0.5 * (1.0 - LEVEL))
    )
    if half <= 0.0:
        return 0.0
    scale = float(stdtrit(degrees, 0.5 * (1.0 + LEVEL)))
    return 2.0 * float(stdtr(degrees, -abs(float(observed)) * scale / half))


def _contrast(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Return the difference of two squared scores over their sum; the square of a draw keeps its sign."""
    one, other = (np.asarray(scores) * np.abs(scores) for scores in (first, second))
    return np.asarray((one - other) / np.maximum(np.abs(one) + np.abs(other), 1e-300))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number (Holm 1979).

    Of the pairs whose corrected value is below 0.05, none is truly equal in at least 95 % of realities, for any
    dependence between the pairs.
    """
    count, corrected, largest = len(p_values), [1.0] * len(p_values), 0.0
    for place, index in enumerate(sorted(range(count), key=p_values.__getitem__)):
        largest = max(largest, min((count - place) * p_values[index], 1.0))
        corrected[index] = largest
    return corrected


def majority_p_value(differences: Sequence[float], p_values: Sequence[float]) -> float:
    """Return the p-value of one configuration being closer in more than half of the experiments.

    Of n one-sided p-values, r = n // 2 + 1 have to be small: n - r + 1 times the r-th smallest is the p-value of fewer
    than r true improvements (Benjamini and Heller 2008). It is doubled, because either of the two may be the closer
    one. The size of a difference has no weight, so that no experiment can decide alone.

    Args:
        differences: Difference in each experiment; its sign says which configuration is closer.
        p_values: Two-sided p-value of each.
    """
    needed = len(p_values) // 2 + 1
    smallest = 1.0
    for sign in (1.0, -1.0):
        one_sided = sorted(
            0.5 * p if math.copysign(1.0, difference) == sign else 1.0 - 0.5 * p
            for difference, p in zip(differences, p_values, strict=True)
        )
        smallest = min(
            smallest, 2.0 * (len(one_sided) - needed + 1) * one_sided[needed - 1]
        )
    return smallest
