"""Contact constants of bodies from those of pairs. Bullet multiplies the values of the two bodies."""

from collections.abc import Iterator, Mapping
from functools import lru_cache

import numpy as np

from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Contact, ContactMode, Motion, Scene
from gauge_envs.scene.geometry import FloatArray

Pair = tuple[str, str]

SMALLEST_VALUE = 1e-6
"""Largest product that stands for a value of 0. A ball then rebounds with a millionth of its speed."""


Surfaces = dict[tuple[float, float], set[str]]
"""Bodies that touch a surface of a body, by its coefficients of friction and of restitution."""


def surfaces(scene: Scene) -> dict[str, Surfaces]:
    """Return the surfaces of each colliding body, whose products are the values of all pairs.

    A body that contacts move has one surface. Another body has a surface for each pair of values that it needs, and the
    engine has a copy of it for each surface.
    """
    unmoved = {body.name for body in scene.bodies if body.motion is not Motion.DYNAMIC}
    friction: dict[Pair, float] = {}
    restitution: dict[Pair, float] = {}
    for contact, pair in colliding_pairs(scene):
        friction[pair] = contact.friction
        # Restitution has no effect on a sustained pair.
        is_impact = contact.mode is ContactMode.IMPACT
        restitution[pair] = contact.restitution if is_impact else 0.0
    frictions = moved_values(friction, unmoved, "friction")
    restitutions = moved_values(restitution, unmoved, "restitution")
    surfaces_by_name: dict[str, Surfaces] = {}
    for pair in friction:
        for name, partner in (pair, pair[::-1]):
            if name in unmoved:
                own_friction = _quotient(friction[pair], frictions[partner])
                own_restitution = _quotient(restitution[pair], restitutions[partner])
            else:
                own_friction, own_restitution = frictions[name], restitutions[name]
            of_body = surfaces_by_name.setdefault(name, {})
            of_body.setdefault((own_friction, own_restitution), set()).add(partner)
    return surfaces_by_name


def _quotient(product: float, factor: float) -> float:
    """Return the second factor of a product, rounded, because equal factors differ in their last digits."""
    return float(f"{product / factor:.12g}") if factor else 0.0


def turning_shares(scene: Scene) -> dict[str, tuple[float, float]]:
    """Return torsional and rolling friction of each body's contacts over their friction [m].

    Bullet's value of a pair is the sum over both bodies of the body's value times the friction of the other body.
    """
    shares: dict[str, tuple[float, float]] = {}
    for contact, pair in colliding_pairs(scene):
        friction = contact.friction or 1.0
        for name in pair:
            share = (contact.torsion_m / friction, contact.rolling_m / friction)
            if shares.setdefault(name, share) != share:
                raise UnsupportedSceneError(
                    f"contacts of {name!r} differ in torsional or rolling friction over friction: Bullet has one "
                    "such ratio for each body"
                )
    return shares


def colliding_pairs(scene: Scene) -> Iterator[tuple[Contact, Pair]]:
    """Yield the colliding pairs of a scene."""
    for contact in scene.contacts:
        for pair in scene.colliding_pairs(contact):
            yield contact, pair


def moved_values(
    pairs: Mapping[Pair, float], unmoved: set[str], noun: str
) -> dict[str, float]:
    """Return a value of each body that contacts move, not negative, whose products are the values of pairs.

    A product of at most `SMALLEST_VALUE` stands for 0: two bricks that do not rebound from each other may rebound
    from a ball. A body whose pairs all have the value 0 has the value 0.

    Args:
        pairs: Value of each pair, not negative.
        unmoved: Other bodies, whose values follow from the values of their partners.
        noun: Name of the values, for messages.
    """
    names = {name for pair in pairs for name in pair} - unmoved
    positive = {name for pair, value in pairs.items() if value for name in pair}
    active = sorted(names & positive)
    rows = {name: row for row, name in enumerate(active)}
    solved = [
        (pair, value) for pair, value in pairs.items() if rows.keys() >= set(pair)
    ]
    values = dict.fromkeys(names, 0.0) | dict.fromkeys(active, 1.0)
    if not solved:
        return values
    logarithms = _logarithms(
        tuple((rows[first], rows[second]) for (first, second), _ in solved),
        tuple(value for _, value in solved),
        len(active),
    )
    if logarithms is None:
        (first, second), value = next(item for item in solved if item[1])
        raise UnsupportedSceneError(
            f"pair {first!r} and {second!r} has the {noun} {value:.6g}: Bullet multiplies the values of two bodies, "
            "and no values of bodies have the products of this scene"
        )
    return values | dict(zip(active, np.exp(logarithms).tolist(), strict=True))


@lru_cache(maxsize=256)
def _logarithms(
    pairs: tuple[tuple[int, int], ...], values: tuple[float, ...], count: int
) -> FloatArray | None:
    """Return the logarithms of values of bodies with these products, shape [count]; None if no values exist.

    They solve a linear program, which keeps the sum of their sizes small.

    Args:
        pairs: Two bodies of each pair.
        values: Product of each pair.
        count: Number of bodies.
    """
    # Few scenes need a solver, and the import takes a tenth of a second.
    from scipy import sparse
    from scipy.optimize import linprog

    places = np.repeat(np.arange(len(pairs)), 2), np.ravel(pairs)
    sums = sparse.csr_array((np.ones(2 * len(pairs)), places), (len(pairs), count))
    # A logarithm is the difference of two unknowns, which are not negative.
    matrix = sparse.hstack([sums, -sums], format="csr")
    products = np.array(values)
    is_zero = products == 0.0
    result = linprog(
        np.ones(2 * count),
        A_ub=matrix[is_zero],
        b_ub=np.full(np.count_nonzero(is_zero), np.log(SMALLEST_VALUE)),
        A_eq=matrix[~is_zero],
        b_eq=np.log(products[~is_zero]),
        method="highs",
    )
    return None if result.x is None else result.x[:count] - result.x[count:]


def impact_bodies(scene: Scene) -> set[str]:
    """Return bodies that cover every rebounding pair, and few other pairs.

    Bullet decides for each body, not for each pair, whether contacts act before bodies touch.
    """
    sustained: set[str] = set()
    impacts: list[Pair] = []
    for contact, pair in colliding_pairs(scene):
        if contact.mode is ContactMode.IMPACT:
            impacts.append(pair)
        else:
            sustained.update(pair)
    selected = {name for pair in impacts for name in pair} - sustained
    for first, second in impacts:
        if not {first, second} & selected:
            selected.add(first)
    return selected


def pushing_bodies(scene: Scene) -> set[str]:
    """Return fixed and driven bodies that touch, two or more together, one dynamic body without a rebound.

    Bullet bounds the two directions of friction between two rigid bodies separately. Across a slip, friction can then
    still resist another contact with up to mu N. So a cube on a board does not follow a pusher that slips along its
    face. Bullet's cone acts on contacts with a body in reduced coordinates. Penetrations of such a body are corrected
    by velocity, which adds to a rebound, so bodies with rebounds are left out.
    """
    motions = {body.name: body.motion for body in scene.bodies}
    touched: dict[str, set[str]] = {}
    rebounding: set[str] = set()
    for contact, pair in colliding_pairs(scene):
        if contact.mode is ContactMode.IMPACT:
            rebounding.update(pair)
            continue
        for name, partner in (pair, pair[::-1]):
            if motions.get(name) is Motion.DYNAMIC is not motions[partner]:
                touched.setdefault(name, set()).add(partner)
    return {
        partner
        for partners in touched.values()
        if len(partners) > 1
        for partner in partners
    } - rebounding
