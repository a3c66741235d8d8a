"""Contact constants of bodies from those of pairs. Bullet multiplies the values of the two bodies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import ContactMode, Scene

__all__ = ["frictions", "impact_bodies", "products", "restitutions"]

Pair = tuple[str, str]

SMALLEST_VALUE = 1e-6
"""Largest product that stands for a value of 0. A ball then rebounds with a millionth of its speed."""

RELATIVE_ERROR = 1e-6
"""Largest error of a product, over the value of the pair."""


def frictions(scene: Scene) -> dict[str, float]:
    """Return a coefficient of friction of each colliding body, whose products are those of the pairs.

    Raises:
        UnsupportedSceneError: No values have these products.
    """
    return products(
        {pair: contact.friction for contact in scene.contacts for pair in scene.colliding_pairs(contact)}, "friction"
    )


def restitutions(scene: Scene) -> dict[str, float]:
    """Return a coefficient of restitution of each colliding body, whose products are those of the pairs.

    The value of a sustained pair is 0.

    Raises:
        UnsupportedSceneError: No values have these products.
    """
    values = {
        pair: contact.restitution if contact.mode is ContactMode.IMPACT else 0.0
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }
    return products(values, "restitution")


def products(pairs: Mapping[Pair, float], noun: str) -> dict[str, float]:
    """Return a value of each body, not negative, whose products are the values of pairs.

    A product of at most `SMALLEST_VALUE` stands for 0: two bricks that do not rebound from each other may rebound
    from a ball. The logarithms of the values solve a linear program; of all solutions it takes one whose largest
    logarithm is smallest in size.

    Args:
        pairs: Value of each pair, not negative.
        noun: What the values are, for messages.

    Raises:
        UnsupportedSceneError: No values have these products. The message names a pair.
    """
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    positive = {pair: value for pair, value in pairs.items() if value > 0.0}
    active = list(dict.fromkeys(name for pair in positive for name in pair))
    # A body of which all pairs have the value 0 has the value 0, and so satisfies them.
    zero = [pair for pair, value in pairs.items() if value == 0.0 and set(pair) <= set(active)]
    found = dict.fromkeys(names, 0.0)
    if not active:
        return found
    # The last unknown bounds the size of all logarithms.
    count = len(active)
    equal = _sums(positive, active)
    smaller = _sums(zero, active)
    one, size = sparse.identity(count), -np.ones((count, 1))
    bounds = sparse.bmat([[one, size], [-one, size]])
    result = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=sparse.vstack([smaller, bounds]),
        b_ub=np.concatenate([np.full(len(zero), np.log(SMALLEST_VALUE)), np.zeros(2 * count)]),
        A_eq=equal,
        b_eq=np.log(list(positive.values())),
        bounds=(None, None),
        method="highs",
    )
    if result.x is None:
        first, second = next(iter(positive))
        raise UnsupportedSceneError(
            f"pair {first!r} and {second!r} has the {noun} {positive[first, second]:.6g}: Bullet multiplies the values "
            "of two bodies, and no values of bodies have the products of this scene"
        )
    return found | dict(zip(active, np.exp(result.x[:count]).tolist(), strict=True))


def _sums(pairs: Mapping[Pair, float] | list[Pair], names: list[str]) -> sparse.csr_array:
    """Return a row for each pair that adds its two values, with a last column of zeros.

    The shape is [pair_count, name_count + 1].
    """
    column = {name: index for index, name in enumerate(names)}
    columns = [column[name] for pair in pairs for name in pair]
    rows = np.repeat(np.arange(len(pairs)), 2)
    return sparse.csr_array((np.ones(len(columns)), (rows, columns)), shape=(len(pairs), len(names) + 1))


def impact_bodies(scene: Scene) -> set[str]:
    """Return bodies such that every pair that rebounds has one of them, and few other pairs do.

    Bullet decides for each body, not for each pair, whether contacts act before bodies touch.
    """
    sustained: set[str] = set()
    impacts: list[Pair] = []
    for contact in scene.contacts:
        pairs = list(scene.colliding_pairs(contact))
        if contact.mode is ContactMode.IMPACT:
            impacts += pairs
        else:
            sustained.update(name for pair in pairs for name in pair)
    found = {name for pair in impacts for name in pair if name not in sustained}
    for first, second in impacts:
        if not {first, second} & found:
            found.add(first)
    return found
