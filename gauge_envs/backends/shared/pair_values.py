"""Contact constants of pairs as constants of bodies, for engines that combine the constants of two bodies."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Literal

import numpy as np

from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray

Pair = tuple[str, str]

RELATIVE_ERROR = 1e-6
"""Largest error of a pair's value, relative to the value or to 1, whichever is larger."""


class Combination(StrEnum):
    """How an engine combines the values of two bodies into that of their pair."""

    PRODUCT = "product"
    """a b."""
    MAX = "max"
    """The larger of a and b."""
    MIN = "min"
    """The smaller of a and b."""
    MEAN = "mean"
    """(a + b) / 2."""
    GEOMETRIC = "geometric"
    """The square root of a b."""


LIMITS = {Combination.MAX: min, Combination.MIN: max}
"""Value of a body from those of its pairs."""

COMBINED: Mapping[Combination, Callable[[float, float], float]] = {
    Combination.PRODUCT: operator.mul,
    Combination.MAX: max,
    Combination.MIN: min,
    Combination.MEAN: lambda first, second: 0.5 * (first + second),
    Combination.GEOMETRIC: lambda first, second: math.sqrt(first * second),
}
"""Value of a pair from those of its bodies."""


def pair_values(
    scene: Scene, constant: Literal["friction", "restitution"]
) -> dict[Pair, float]:
    """Return a contact constant of each colliding pair of a scene."""
    return {
        pair: float(getattr(contact, constant))
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }


def body_values(
    pairs: Mapping[Pair, float], rule: Combination | str
) -> dict[str, float]:
    """Return a value of each body, not negative, from which an engine's rule gives the value of each pair.

    Several solutions may exist. The one with the smallest values, or with the largest for `MAX`, is returned.

    Args:
        pairs: Value of each pair, not negative.
        rule: The engine's rule.
    """
    rule = Combination(rule)
    # A body whose pairs all have the value 0 has the value 0.
    values = {name: 0.0 for pair in pairs for name in pair}
    if rule in LIMITS:
        for name in values:
            values[name] = LIMITS[rule](pairs[pair] for pair in pairs if name in pair)
    elif rule is Combination.MEAN:
        sums = {pair: 2.0 * value for pair, value in pairs.items()}
        values = values_of_sums(sums, lowest=0.0)
    else:
        # The logarithms of two values add up to that of their product.
        power = {Combination.PRODUCT: 1.0, Combination.GEOMETRIC: 2.0}[rule]
        sums = {
            pair: power * math.log(value)
            for pair, value in pairs.items()
            if value > 0.0
        }
        for name, logarithm in values_of_sums(sums, lowest=-math.inf).items():
            values[name] = math.exp(logarithm)
    _check(pairs, values, rule)
    return values


def values_of_sums(sums: Mapping[Pair, float], *, lowest: float) -> dict[str, float]:
    """Return values of bodies whose sums come closest to those of pairs, in the least-squares sense.

    Args:
        sums: Sum of the two values of each pair.
        lowest: Smallest value of a body.
    """
    if not sums:
        return {}
    names = list(dict.fromkeys(name for pair in sums for name in pair))
    rows: FloatArray = np.zeros((len(sums), len(names)))
    for row, pair in zip(rows, sums, strict=True):
        for name in pair:
            row[names.index(name)] += 1.0
    targets = np.array(list(sums.values()))
    solution = np.linalg.lstsq(rows, targets, rcond=None)[0]
    if solution.min() < lowest:
        from scipy.optimize import lsq_linear

        solution = lsq_linear(
            rows, targets, bounds=(lowest, np.inf), method="bvls", tol=1e-14
        ).x
    return dict(zip(names, solution.tolist(), strict=True))


def _check(
    pairs: Mapping[Pair, float], values: Mapping[str, float], rule: Combination
) -> None:
    """Raise an error for the pair with the largest error, if it is too large."""
    combine = COMBINED[rule]
    errors = {}
    for (first, second), value in pairs.items():
        difference = combine(values[first], values[second]) - value
        errors[first, second] = abs(difference) / max(value, 1.0)
    worst = max(errors, key=errors.__getitem__, default=None)
    if worst is None or errors[worst] <= RELATIVE_ERROR:
        return
    first, second = worst
    closest = combine(values[first], values[second])
    raise UnsupportedSceneError(
        f"pair {first!r} and {second!r} has the value {pairs[worst]:.6g}, but no values of bodies give the value "
        f"of every pair by the engine's rule {rule.value!r} (the closest give {closest:.6g}). Return the scene as "
        "unsupported, or set the value of each pair in the engine"
    )
