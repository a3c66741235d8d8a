"""Extrapolate runs to zero step and cell, with an uncertainty: Richardson's limit, Roache's grid convergence index."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import brentq

from gauge_envs.scene.geometry import FloatArray, length_of

ORDERS = (0.5, 2.2)
"""Smallest and largest order that counts as observed. A larger one is two errors that cancel."""

LEAST_COSINE = 0.9
"""Least cosine between the changes of two refinements: they correct the same error."""

SAFETY, LONE_SAFETY = 1.25, 3.0
"""Factors of Roache's grid convergence index, with an observed order and without one."""

WINDOW = 11
"""Frames over which an uncertainty is averaged."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Extrapolated:
    """A quantity at zero step and cell.

    Attributes:
        correction: What is added to the values of the default settings, shape [T, C].
        uncertainty: Standard uncertainty that is left, shape [T, C].
        order: Observed order; None if it was not observed.
    """

    correction: FloatArray
    uncertainty: FloatArray
    order: float | None


def observed_order(
    runs: Sequence[FloatArray], factors: Sequence[float]
) -> float | None:
    """Return the order p at which three runs converge, coarse to fine; None if they do not.

    The error is C f^p for a refinement factor f. So the ratio of the two changes is (f1^p - f2^p) / (f2^p - f3^p). The
    changes must point the same way, and p must lie in `ORDERS`.
    """
    first, second = (runs[0] - runs[1]).ravel(), (runs[1] - runs[2]).ravel()
    sizes = length_of(first), length_of(second)
    if not all(sizes) or float(first @ second) < LEAST_COSINE * sizes[0] * sizes[1]:
        return None

    def excess(order: float) -> float:
        coarse, middle, fine = (factor**order for factor in factors)
        return (coarse - middle) / (middle - fine) - sizes[0] / sizes[1]

    if excess(ORDERS[0]) * excess(ORDERS[1]) > 0.0:
        return None
    return float(brentq(excess, *ORDERS))


def extrapolate(runs: Sequence[FloatArray], factors: Sequence[float]) -> Extrapolated:
    """Return a quantity at zero of a parameter, with the uncertainty of Roache's grid convergence index.

    With an observed order the value is extrapolated. Its 95 % uncertainty is 1.25 times the distance to the finest run,
    at most by order 1, because errors of several orders may look like one of a high order. Else the finest run stands,
    with 3 times what is left by order 1 after the change from the default settings.

    Args:
        runs: The quantity in each run, coarse to fine, each of shape [T, C]; one of them has the factor 1.
        factors: Parameter of each run over that of the default settings.
    """
    base, fine = runs[list(factors).index(1.0)], runs[-1]
    order = observed_order(runs[-3:], factors[-3:]) if len(runs) > 2 else None

    def left(power: float, other: int = -2) -> FloatArray:
        coarse, last = factors[other] ** power, factors[-1] ** power
        return (fine - runs[other]) * last / (coarse - last)

    if order is None:
        # Of close runs the difference is small by chance; the default one is the farthest that is not coarse.
        other = next(
            (place for place, factor in enumerate(factors[:-1]) if factor <= 1.0),
            len(factors) - 2,
        )
        spread = 0.5 * LONE_SAFETY * smoothed(left(1.0, other))
        return Extrapolated(correction=fine - base, uncertainty=spread, order=None)
    uncertainty = 0.5 * SAFETY * smoothed(left(min(order, 1.0)))
    return Extrapolated(
        correction=fine - base + left(order), uncertainty=uncertainty, order=order
    )


def smoothed(values: FloatArray) -> FloatArray:
    """Return the root mean square over `WINDOW` frames, so that a passage through zero is no certainty."""
    # The running sum of the filter may end a little below zero.
    return np.sqrt(
        np.maximum(
            uniform_filter1d(np.square(values), WINDOW, axis=0, mode="nearest"), 0.0
        )
    )


def combined(
    each: Sequence[tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weighted mean of solutions, its standard uncertainty, and the distance of the families from it.

    A weight is the inverse of the mean square of an engine's uncertainty plus that of the distance of the families, as
    in a meta-analysis with random effects. Engines share meshes and the map of constants, so their uncertainties do not
    shrink in the mean, and the largest distance of a family from it is added in quadrature.
    """
    values = np.array([value for value, _ in each])
    squares = np.array([np.square(uncertainty) for _, uncertainty in each])
    between = np.square(values - values.mean(axis=0)).max(axis=0).mean()
    weights = 1.0 / np.maximum(
        squares.mean(axis=(1, 2)) + between, np.finfo(float).tiny
    )
    weights /= weights.sum()
    mean = np.tensordot(weights, values, axes=1)
    apart = smoothed(np.abs(values - mean).max(axis=0))
    return (
        mean,
        np.sqrt(np.tensordot(weights, squares, axes=1) + np.square(apart)),
        apart,
    )


def anchored(
    each: Sequence[tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the first solution, its standard uncertainty, and its distance from the others, which only check it.

    What the uncertainty of another solution does not explain of the distance is added in quadrature.
    """
    (first, uncertainty), *others = each
    square = np.square(uncertainty)
    distance = np.zeros_like(first)
    for value, spread in others:
        apart = smoothed(value - first)
        distance = np.maximum(distance, apart)
        square = square + np.maximum(np.square(apart) - np.square(spread), 0.0)
    return first, np.sqrt(square), distance


LEAST_SPAN = 0.25
"""Share of an episode that a reference covers at least, and its part after a gap."""


def known_frames(
    uncertainty: FloatArray, limit: float
) -> tuple[int, tuple[int, int] | None]:
    """Return the end of the frames at which the uncertainty, as a norm over coordinates, is at most a limit, and a gap.

    They end where it first exceeds the limit. Where it stays below the limit from a later frame on, for a good part of
    the episode, the motion has settled, and they go on after a gap.
    """
    beyond = np.flatnonzero(np.linalg.norm(uncertainty, axis=1) > limit)
    if not len(beyond):
        return len(uncertainty), None
    first, after = int(beyond[0]), int(beyond[-1]) + 1
    if len(uncertainty) - after >= LEAST_SPAN * len(uncertainty):
        return len(uncertainty), (first, after)
    return first, None


def rms(values: FloatArray) -> float:
    """Return the root mean square over frames of a distance over coordinates."""
    return float(np.sqrt(np.mean(np.square(np.linalg.norm(values, axis=1)))))
