"""Contact constants of pairs as constants of bodies, for engines that combine the constants of two bodies."""

from __future__ import annotations

from collections.abc import Mapping
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
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    if rule in (Combination.MAX, Combination.MIN):
        limit = min if rule is Combination.MAX else max
        values = {
            name: limit(value for pair, value in pairs.items() if name in pair)
            for name in names
        }
    elif rule is Combination.MEAN:
        values = values_of_sums(
            names, {pair: 2.0 * value for pair, value in pairs.items()}, lowest=0.0
        )
    else:
        # The logarithms of two values add up to that of their product.
        power = 2.0 if rule is Combination.GEOMETRIC else 1.0
        sums = {
            pair: power * float(np.log(value))
            for pair, value in pairs.items()
            if value > 0.0
        }
        active = [name for name in names if any(name in pair for pair in sums)]
        # A body whose pairs all have the value 0 has the value 0.
        values = dict.fromkeys(names, 0.0)
        for name, logarithm in values_of_sums(active, sums, lowest=-np.inf).items():
            values[name] = float(np.exp(logarithm))
    _check(pairs, values, rule)
    return values


def values_of_sums(
    names: list[str], sums: Mapping[Pair, float], *, lowest: float
) -> dict[str, float]:
    """Return values of bodies whose sums come closest to those of pairs, in the least-squares sense.

    Args:
        names: Names of the bodies.
        sums: Sum of the two values of each pair.
        lowest: Smallest value of a body.
    """
    if not sums:
        return {}
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


def _combined(first: float, second: float, rule: Combination) -> float:
    if rule in (Combination.MAX, Combination.MIN):
        return max(first, second) if rule is Combination.MAX else min(first, second)
    if rule is Combination.MEAN:
        return 0.5 * (first + second)
    return (
        first * second
        if rule is Combination.PRODUCT
        else float(np.sqrt(first * second))
    )


def _check(
    pairs: Mapping[Pair, float], values: Mapping[str, float], rule: Combination
) -> None:
    errors = {}
    for (first, second), value in pairs.items():
        errors[first, second] = abs(
            _combined(values[first], values[second], rule) - value
        ) / max(value, 1.0)
    if not errors:
        return
    worst = max(errors, key=lambda pair: errors[pair])
    if errors[worst] > RELATIVE_ERROR:
        first, second = worst
        closest = _combined(values[first], values[second], rule)
        raise UnsupportedSceneError(
            f"pair {first!r} and {second!r} has the value {pairs[worst]:.6g}, but no values of bodies give the value "
            f"of every pair by the engine's rule {rule.value!r} (the closest give {closest:.6g}). Return the scene as "
            "unsupported, or set the value of each pair in the engine"
        )
