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
"""Largest error of a pair's value, over the value or over 1 where it is smaller."""


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
        found = {
            name: limit(value for pair, value in pairs.items() if name in pair)
            for name in names
        }
    elif rule is Combination.MEAN:
        found = values_of_sums(
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
        # A body of which all pairs have the value 0 has the value 0.
        found = dict.fromkeys(names, 0.0)
        for name, logarithm in values_of_sums(active, sums, lowest=-np.inf).items():
            found[name] = float(np.exp(logarithm))
    _check(pairs, found, rule)
    return found


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
    least = np.linalg.lstsq(rows, targets, rcond=None)[0]
    if least.min() < lowest:
        from scipy.optimize import lsq_linear

        least = lsq_linear(
            rows, targets, bounds=(lowest, np.inf), method="bvls", tol=1e-14
        ).x
    return dict(zip(names, least.tolist(), strict=True))


def _combined(one: float, other: float, rule: Combination) -> float:
    if rule in (Combination.MAX, Combination.MIN):
        return max(one, other) if rule is Combination.MAX else min(one, other)
    if rule is Combination.MEAN:
        return 0.5 * (one + other)
    return one * other if rule is Combination.PRODUCT else float(np.sqrt(one * other))


def _check(
    pairs: Mapping[Pair, float], found: Mapping[str, float], rule: Combination
) -> None:
    errors = {}
    for (one, other), value in pairs.items():
        errors[one, other] = abs(
            _combined(found[one], found[other], rule) - value
        ) / max(value, 1.0)
    if not errors:
        return
    worst = max(errors, key=lambda pair: errors[pair])
    if errors[worst] > RELATIVE_ERROR:
        one, other = worst
        got = _combined(found[one], found[other], rule)
        raise UnsupportedSceneError(
            f"pair {one!r} and {other!r} has the value {pairs[worst]:.6g}, but no values of bodies give that of every "
            f"pair by the engine's rule {rule.value!r} (the closest give {got:.6g}). Decline the scene, or set the "
            "value of each pair in the engine"
        )
