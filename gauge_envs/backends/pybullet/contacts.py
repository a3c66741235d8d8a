"""Contact constants of bodies from those of pairs. Bullet multiplies the values of the two bodies."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse

from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Contact, ContactMode, Motion, Scene
from gauge_envs.scene.geometry import FloatArray

Pair = tuple[str, str]

SMALLEST_VALUE = 1e-6
"""Largest product that stands for a value of 0. A ball then rebounds with a millionth of its speed."""


@dataclass(frozen=True)
class Surface:
    """Contact constants of a body towards some of the bodies with which it collides.

    Attributes:
        partners: Names of these bodies.
        friction: Coefficient of friction of the body.
        restitution: Coefficient of restitution of the body.
    """

    partners: frozenset[str]
    friction: float
    restitution: float


def surfaces(scene: Scene) -> dict[str, list[Surface]]:
    """Return the surfaces of each colliding body, whose products are the values of all pairs.

    A body has one surface if values of bodies have these products. If not, bodies that contacts do not move get several
    surfaces, each towards other bodies. The engine has a copy of the body for each surface.
    """
    pairs = list(_pairs(scene))
    friction = {pair: contact.friction for contact, pair in pairs}
    # Restitution has no effect on a sustained pair.
    restitution = {
        pair: contact.restitution if contact.mode is ContactMode.IMPACT else 0.0
        for contact, pair in pairs
    }
    partners: dict[str, set[str]] = {}
    for one, other in friction:
        partners.setdefault(one, set()).add(other)
        partners.setdefault(other, set()).add(one)
    try:
        frictions = products(friction, "friction")
        restitutions = products(restitution, "restitution")
    except UnsupportedSceneError:
        unmoved = {
            body.name for body in scene.bodies if body.motion is not Motion.DYNAMIC
        }
        return _with_copies(friction, restitution, partners, unmoved)
    return {
        name: [Surface(frozenset(others), frictions[name], restitutions[name])]
        for name, others in partners.items()
    }


def turning_shares(scene: Scene) -> dict[str, tuple[float, float]]:
    """Return torsional and rolling friction of each body's contacts over their friction [m].

    Bullet's value of a pair is that of each body times the friction of the other one, added.
    """
    shares: dict[str, tuple[float, float]] = {}
    for contact, pair in _pairs(scene):
        friction = contact.friction or 1.0
        for name in pair:
            share = (contact.torsion_m / friction, contact.rolling_m / friction)
            if shares.setdefault(name, share) != share:
                raise UnsupportedSceneError(
                    f"contacts of {name!r} differ in torsional or rolling friction over friction, of which Bullet has "
                    "one for each body"
                )
    return shares


def _with_copies(
    friction: Mapping[Pair, float],
    restitution: Mapping[Pair, float],
    partners: Mapping[str, set[str]],
    unmoved: set[str],
) -> dict[str, list[Surface]]:
    """Return surfaces with several ones for bodies that contacts do not move."""

    def solved(pairs: Mapping[Pair, float], noun: str) -> dict[str, float]:
        movable = {
            pair: value for pair, value in pairs.items() if not unmoved & set(pair)
        }
        # A pair with a partner of its own, of value 1, lets each body have any positive value.
        free = {
            (name, f"{name} alone"): 1.0 for name in partners if name not in unmoved
        }
        return products(movable | free, noun)

    frictions = solved(friction, "friction")
    restitutions = solved(restitution, "restitution")
    found: dict[str, list[Surface]] = {}
    for name, others in partners.items():
        if name not in unmoved:
            found[name] = [
                Surface(frozenset(others), frictions[name], restitutions[name])
            ]
    for name in sorted(unmoved & set(partners)):
        groups: dict[tuple[float, float], set[str]] = {}
        for other in sorted(partners[name]):
            pair = (name, other) if (name, other) in friction else (other, name)
            # Values of equal bodies differ in the last digits.
            own_friction = float(f"{friction[pair] / frictions[other]:.12g}")
            own_restitution = float(f"{restitution[pair] / restitutions[other]:.12g}")
            groups.setdefault((own_friction, own_restitution), set()).add(other)
        found[name] = [
            Surface(frozenset(others), *constants)
            for constants, others in groups.items()
        ]
    return found


def _pairs(scene: Scene) -> Iterator[tuple[Contact, Pair]]:
    """Yield the colliding pairs of a scene."""
    for contact in scene.contacts:
        for pair in scene.colliding_pairs(contact):
            yield contact, pair


def products(pairs: Mapping[Pair, float], noun: str) -> dict[str, float]:
    """Return a value of each body, not negative, whose products are the values of pairs.

    A product of at most `SMALLEST_VALUE` stands for 0: two bricks that do not rebound from each other may rebound
    from a ball. The logarithms of the values solve a linear program, which keeps them small.

    Args:
        pairs: Value of each pair, not negative.
        noun: What the values are, for messages.
    """
    names = list(dict.fromkeys(name for pair in pairs for name in pair))
    positive = {pair: value for pair, value in pairs.items() if value > 0.0}
    active = list(dict.fromkeys(name for pair in positive for name in pair))
    # A body of which all pairs have the value 0 has the value 0, and so satisfies them.
    zero = [
        pair
        for pair, value in pairs.items()
        if value == 0.0 and set(pair) <= set(active)
    ]
    found = dict.fromkeys(names, 0.0)
    if not active:
        return found
    column = {name: index for index, name in enumerate(active)}
    rows, zero_rows = (
        tuple((column[first], column[second]) for first, second in some)
        for some in (positive, zero)
    )
    logarithms = _logarithms(rows, tuple(positive.values()), zero_rows, len(active))
    if logarithms is None:
        first, second = next(iter(positive))
        raise UnsupportedSceneError(
            f"pair {first!r} and {second!r} has the {noun} {positive[first, second]:.6g}: Bullet multiplies the values "
            "of two bodies, and no values of bodies have the products of this scene"
        )
    return found | dict(zip(active, np.exp(logarithms).tolist(), strict=True))


Rows = tuple[tuple[int, int], ...]


@lru_cache(maxsize=256)
def _logarithms(
    pairs: Rows, values: tuple[float, ...], zero: Rows, count: int
) -> FloatArray | None:
    """Return the logarithms of the least values of bodies with these products, shape [count]; None if there are none.

    Args:
        pairs: Two bodies of each pair.
        values: Product of each pair, positive.
        zero: Pairs whose product stands for 0.
        count: Number of bodies.
    """
    # Each logarithm has a bound on its size as a second unknown, and the sum of the bounds is least.
    one = sparse.identity(count)
    # Few scenes need a solver, and the import takes a tenth of a second.
    from scipy.optimize import linprog

    result = linprog(
        np.repeat([0.0, 1.0], count),
        A_ub=sparse.vstack(
            [_sums(zero, count), sparse.bmat([[one, -one], [-one, -one]])]
        ),
        b_ub=np.concatenate(
            [np.full(len(zero), np.log(SMALLEST_VALUE)), np.zeros(2 * count)]
        ),
        A_eq=_sums(pairs, count),
        b_eq=np.log(values),
        bounds=(None, None),
        method="highs",
    )
    return None if result.x is None else result.x[:count]


def _sums(pairs: Rows, count: int) -> sparse.csr_array:
    """Return a row for each pair that adds its two values, beside columns of zeros, [pair_count, 2 count]."""
    rows = np.repeat(np.arange(len(pairs)), 2)
    columns = np.array(pairs, dtype=int).ravel()
    return sparse.csr_array(
        (np.ones(len(columns)), (rows, columns)), shape=(len(pairs), 2 * count)
    )


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


def pushing_bodies(scene: Scene) -> set[str]:
    """Return fixed and driven bodies of which two or more touch one dynamic body without a rebound.

    Bullet bounds the two directions of friction between two rigid bodies one by one. The direction across a slip then
    takes up to mu N of what another contact exerts, so a cube on a board does not follow a pusher that slips along its
    face. Bullet's cone acts on contacts with a body in reduced coordinates. Penetrations of such a body are corrected
    by velocity, which adds to a rebound, so bodies from which something rebounds are left out.
    """
    motions = {body.name: body.motion for body in scene.bodies}
    touched: dict[str, set[str]] = {}
    rebounding: set[str] = set()
    for contact, (first, second) in _pairs(scene):
        if contact.mode is ContactMode.IMPACT:
            rebounding.update((first, second))
            continue
        for name, other in ((first, second), (second, first)):
            if motions.get(name) is Motion.DYNAMIC is not motions[other]:
                touched.setdefault(name, set()).add(other)
    return {
        other for others in touched.values() if len(others) > 1 for other in others
    } - rebounding
