"""Reader of contacts: the colliding bodies of a USD stage and their contact constants."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, combinations_with_replacement, product
from typing import Any, NamedTuple

from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.formats.usd.layer import ARMS
from gauge_envs.formats.usd.source import Source
from gauge_envs.scene import Contact, ContactMode

Pair = frozenset[str]
Coefficient = tuple[float, str]
"""Friction or restitution of a material, and its combine mode."""

COMBINE_MODES: dict[str, Callable[[float, float], float]] = {
    "average": lambda first, second: 0.5 * (first + second),
    "min": min,
    "multiply": operator.mul,
    "max": max,
}
"""Combine modes of PhysX in increasing priority: the later mode applies if two materials differ."""

COEFFICIENT_ATTRIBUTES = {
    "friction": (
        "physics:staticFriction",
        "physics:dynamicFriction",
        "omniphysics:staticFriction",
        "omniphysics:dynamicFriction",
    ),
    "restitution": ("physics:restitution",),
}
"""Attributes of a material that hold each constant of a contact."""


class Collider(NamedTuple):
    """A body with the prims of its geometry; ropes and rods have none, because UsdPhysics does not support them.

    Attributes:
        name: Name of the body in the scene.
        prim: Prim of the body.
        shapes: Prims of its geometry.
        moves: Whether it is dynamic or deformable.
    """

    name: str
    prim: Usd.Prim
    shapes: Sequence[Usd.Prim]
    moves: bool


def read_contacts(
    source: Source,
    bodies: Sequence[Collider],
) -> tuple[Contact, ...]:
    """Return the contacts of a stage.

    Args:
        source: The stage.
        bodies: All bodies.

    `gauge:first` and `gauge:second` define the pairs of the bodies of this package's layers. UsdPhysics defines all
    other pairs: all enabled colliders except filtered pairs.

    Raises:
        AssetError: A constant is missing, or UsdPhysics filters a pair of `gauge:first` and `gauge:second`.
    """
    prims = [prim for prim in source.prims() if prim.HasRelationship("gauge:first")]
    names = {body.prim.GetPath(): body.name for body in bodies}
    contacts = source.read_each(prims, lambda prim: _exact_contact(source, prim, names))
    _check_bindings(source, prims, contacts, bodies)
    colliding = _colliding_pairs(source, bodies)
    moving = {body.name for body in bodies if body.moves}
    solid = {body.name for body in bodies if body.shapes}
    for prim, contact in zip(prims, contacts, strict=True):
        for pair in _pairs(contact) - colliding:
            if pair & moving and pair <= solid:
                raise source.fault(
                    prim,
                    f"{' and '.join(sorted(pair))} have a contact, but their colliders are filtered or disabled: edit "
                    "gauge:first and gauge:second",
                )
    known = {pair for contact in contacts for pair in _pairs(contact)}
    added = _material_contacts(source, bodies, colliding - known)
    return (*contacts, *added)


def _pairs(contact: Contact) -> set[Pair]:
    return {frozenset((a, b)) for a in contact.first for b in contact.second if a != b}


# --- contacts that this package wrote --------------------------------------------------------------------------------


def _exact_contact(
    source: Source, prim: Usd.Prim, names: Mapping[Sdf.Path, str]
) -> Contact:
    values: dict[str, Any] = {
        side: source.targets(prim, f"gauge:{side}", names)
        for side in ("first", "second")
    }
    paths = prim.GetRelationship("gauge:materials").GetTargets()
    materials = [*filter(None, map(source.stage.GetPrimAtPath, paths))]
    for name, attributes in COEFFICIENT_ATTRIBUTES.items():
        stored = [
            source.stored(material.GetAttribute(attribute))
            for material, attribute in product(materials, attributes)
        ]
        value = source.edited(prim.GetAttribute(f"gauge:{name}"), stored)
        values[name] = _coefficient(source, prim, name, value)
    for name in ARMS:
        arm_m = source.number(prim.GetAttribute(f"gauge:{name}"))
        values[name] = _coefficient(source, prim, name, arm_m or 0.0)
    mode = ContactMode(prim.GetAttribute("gauge:mode").Get())
    return Contact(mode=mode, **values)


def _check_bindings(
    source: Source,
    prims: Sequence[Usd.Prim],
    contacts: Sequence[Contact],
    bodies: Sequence[Collider],
) -> None:
    """Check that no body of a contact is bound to a material that belongs to none of its contacts."""
    for body in bodies:
        known: set[Sdf.Path] = set()
        for prim, contact in zip(prims, contacts, strict=True):
            if body.name in (*contact.first, *contact.second):
                known.update(prim.GetRelationship("gauge:materials").GetTargets())
                derived = prim.GetRelationship("gauge:derived_materials")
                known.update(derived.GetTargets())
        for material in map(source.material, body.shapes):
            if known and material and material.GetPath() not in known:
                raise source.fault(
                    body.prim,
                    f"is bound to {material.GetPath()}, which is the material of none of its contacts: edit the "
                    "material of the contact instead, or add this material to gauge:materials",
                )


def _coefficient(source: Source, prim: Usd.Prim, name: str, value: Any) -> float:
    highest = 1.0 if name == "restitution" else math.inf
    if value is None or not 0.0 <= value <= highest:
        raise source.fault(
            prim, f"{name} is {value}: a number from 0 to {highest:g} is expected"
        )
    return float(value)


# --- contacts of UsdPhysics ------------------------------------------------------------------------------------------


def _colliding_pairs(source: Source, bodies: Sequence[Collider]) -> set[Pair]:
    """Return the pairs of bodies that UsdPhysics lets collide; a filter of a part applies to the whole body."""
    solid = [body for body in bodies if any(map(is_enabled, body.shapes))]
    pairs = {
        frozenset((first.name, second.name))
        for first, second in combinations(solid, 2)
        if first.moves or second.moves
    }
    for paths in _filtered_paths(source):
        sides = [[body.name for body in solid if _has(body, path)] for path in paths]
        pairs -= {frozenset(pair) for pair in product(*sides)}
    return pairs


def is_enabled(shape: Usd.Prim) -> bool:
    """Return whether a collider is enabled."""
    api = UsdPhysics.CollisionAPI(shape)
    return api.GetCollisionEnabledAttr().Get() is not False


def _has(body: Collider, path: Sdf.Path) -> bool:
    """Return whether a body is at or below a path, or has a collider there."""
    shapes = [shape.GetPath() for shape in body.shapes]
    return body.prim.GetPath().HasPrefix(path) or path in shapes


def _filtered_paths(source: Source) -> Iterator[tuple[Sdf.Path, Sdf.Path]]:
    """Yield the filtered pairs of prims, of groups and of joints, whose bodies do not collide by default."""
    for prim in source.prims():
        filters = UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel()
        yield from product([prim.GetPath()], filters.GetTargets())
        joint = UsdPhysics.Joint(prim)
        if joint and not joint.GetCollisionEnabledAttr().Get():
            bodies = joint.GetBody0Rel(), joint.GetBody1Rel()
            yield from product(*(body.GetTargets() for body in bodies))
    table = UsdPhysics.CollisionGroup.ComputeCollisionGroupTable(source.stage)
    for pair in combinations_with_replacement(table.GetGroups(), 2):
        if not table.IsCollisionEnabled(*pair):
            yield from product(*(_members(source.stage, path) for path in pair))


def _members(stage: Usd.Stage, path: Sdf.Path) -> set[Sdf.Path]:
    """Return the paths of the prims in a collision group."""
    group = UsdPhysics.CollisionGroup.Get(stage, path)
    query = group.GetCollidersCollectionAPI().ComputeMembershipQuery()
    return Usd.CollectionAPI.ComputeIncludedPaths(query, stage)


def _material_contacts(
    source: Source,
    bodies: Sequence[Collider],
    pairs: set[Pair],
) -> Iterator[Contact]:
    """Yield a contact for each pair that only UsdPhysics defines."""
    touching = {name for pair in pairs for name in pair}
    constants = {
        body.name: _body_constants(source, body)
        for body in bodies
        if body.name in touching
    }
    for first, second in sorted(map(sorted, pairs)):
        friction, restitution = map(_combined, constants[first], constants[second])
        yield Contact(
            first=(first,),
            second=(second,),
            friction=friction,
            restitution=restitution,
        )


def _combined(first: Coefficient, second: Coefficient) -> float:
    """Return the coefficient of a pair of materials, as PhysX combines it."""
    mode = max(first[1], second[1], key=[*COMBINE_MODES].index)
    return COMBINE_MODES[mode](first[0], second[0])


def _body_constants(source: Source, body: Collider) -> list[Coefficient]:
    """Return friction and restitution of a body."""
    materials = {*map(source.material, body.shapes)} - {None}
    if len(materials) != 1:
        raise source.fault(
            body.prim,
            f"has {len(materials) or 'no'} physics material, so its friction is unknown: bind one",
        )
    (material,) = materials
    assert material is not None
    values = {
        name: float(stored.value)
        for name in ("dynamicFriction", "staticFriction", "restitution")
        if (stored := source.stored(material.GetAttribute(f"physics:{name}")))
    }
    restitution = values.pop("restitution", 0.0)
    if not values:
        raise source.fault(
            material,
            "has neither physics:dynamicFriction nor physics:staticFriction: set one",
        )
    if len({*values.values()}) == 2:
        raise source.fault(
            material,
            f"has different frictions, {values}, but a scene has one coefficient: make them equal",
        )
    friction = max(values.values())
    coefficients = []
    for name, value in (("friction", friction), ("restitution", restitution)):
        attribute = material.GetAttribute(f"physxMaterial:{name}CombineMode")
        mode = source.text(attribute, [*COMBINE_MODES]) or "average"
        coefficients.append((_coefficient(source, material, name, value), mode))
    return coefficients
