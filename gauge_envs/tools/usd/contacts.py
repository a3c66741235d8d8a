"""Reader of contacts: the colliding bodies of a USD stage and their contact constants."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any, Literal

from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.scene import Contact, ContactMode
from gauge_envs.tools.usd.layer import ARMS, names_digest
from gauge_envs.tools.usd.source import Source

Pair = frozenset[str]

COMBINATIONS = ("average", "min", "multiply", "max")
"""Combine modes of PhysX in increasing priority; the mode with higher priority counts if two materials differ."""

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


@dataclass(frozen=True, kw_only=True)
class Collider:
    """A body with the prims of its geometry, which are none for ropes and rods: UsdPhysics does not support them.

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


@dataclass(frozen=True, kw_only=True)
class ContactOptions:
    """Properties of contacts that a USD file does not define; see `from_usd`."""

    friction: Literal["dynamic", "static"] | None
    mode: ContactMode | Mapping[tuple[str, str], ContactMode]
    contacts: Sequence[Contact]

    def mode_of(self, pair: Pair) -> ContactMode:
        """Return the contact mode of a pair of bodies."""
        if isinstance(self.mode, ContactMode):
            return self.mode
        modes = {frozenset(names): mode for names, mode in self.mode.items()}
        return modes.get(pair, ContactMode.SUSTAINED)


def read_contacts(
    source: Source,
    physics: Usd.Prim,
    bodies: Sequence[Collider],
    options: ContactOptions,
) -> tuple[Contact, ...]:
    """Return the contacts of a stage with the given PhysicsScene prim.

    `gauge:first` and `gauge:second` define the pairs, unless the pairs of UsdPhysics were edited: then those count. A
    file without `gauge:first` has the pairs of UsdPhysics: all enabled colliders except filtered pairs.
    """
    prims = [prim for prim in source.prims() if prim.HasRelationship("gauge:first")]
    contacts = [_exact_contact(source, prim, bodies) for prim in prims]
    _check_bindings(source, prims, contacts, bodies)
    colliding = _colliding_pairs(source, bodies)
    moving = {body.name for body in bodies if body.moves}
    solid = {body.name for body in bodies if body.shapes}
    exact = {
        pair
        for contact in contacts
        for pair in _pairs(contact)
        if pair & moving and pair <= solid
    }
    replaced = {pair for contact in options.contacts for pair in _pairs(contact)}
    written = source.text(physics.GetAttribute("gauge:colliding_pairs"))
    if prims and names_digest(colliding) == written:
        colliding = exact
    removed = (exact - colliding) | replaced
    kept = [part for contact in contacts for part in _without(contact, removed)]
    added = _material_contacts(source, bodies, colliding - exact - replaced, options)
    return (*kept, *added, *options.contacts)


def _pairs(contact: Contact) -> set[Pair]:
    return {frozenset((a, b)) for a in contact.first for b in contact.second if a != b}


# --- contacts that this package wrote --------------------------------------------------------------------------------


def _exact_contact(
    source: Source, prim: Usd.Prim, bodies: Sequence[Collider]
) -> Contact:
    names = {body.prim.GetPath(): body.name for body in bodies}
    values: dict[str, Any] = {
        side: source.targets(prim, f"gauge:{side}", names)
        for side in ("first", "second")
    }
    for name, attributes in COEFFICIENT_ATTRIBUTES.items():
        stored = [
            source.stored(source.stage.GetAttributeAtPath(f"{path}.{attribute}"))
            for path in _materials(prim, "gauge:materials")
            for attribute in attributes
        ]
        value = source.edited(prim.GetAttribute(f"gauge:{name}"), stored)
        values[name] = _coefficient(
            source, prim, name, None if value is None else float(value)
        )
    for name in ARMS:
        arm_m = source.number(prim.GetAttribute(f"gauge:{name}"))
        values[name] = _coefficient(source, prim, name, arm_m or 0.0)
    mode = source.text(prim.GetAttribute("gauge:mode"), tuple(ContactMode))
    if mode is None:
        raise source.fault(prim, f"gauge:mode is missing: {' or '.join(ContactMode)}")
    return Contact(mode=ContactMode(mode), **values)


def _materials(prim: Usd.Prim, name: str) -> list[Sdf.Path]:
    """Return the paths of the materials of a contact."""
    relationship = prim.GetRelationship(name)
    return relationship.GetTargets() if relationship else []


def _check_bindings(
    source: Source,
    prims: Sequence[Usd.Prim],
    contacts: Sequence[Contact],
    bodies: Sequence[Collider],
) -> None:
    """Check that no body of a contact is bound to a material that belongs to none of its contacts."""
    for body in bodies:
        known = {
            path
            for prim, contact in zip(prims, contacts, strict=True)
            if body.name in (*contact.first, *contact.second)
            for kind in ("gauge:materials", "gauge:derived_materials")
            for path in _materials(prim, kind)
        }
        for material in map(source.material, body.shapes):
            if known and material and material.GetPath() not in known:
                raise source.fault(
                    body.prim,
                    f"is bound to {material.GetPath()}, which is the material of none of its contacts: edit the "
                    "material of the contact instead, or add this material to gauge:materials",
                )


def _coefficient(
    source: Source, prim: Usd.Prim, name: str, value: float | None
) -> float:
    highest = 1.0 if name == "restitution" else float("inf")
    if value is None or not 0.0 <= value <= highest:
        expected = "0 to 1" if name == "restitution" else "0 or more"
        raise source.fault(prim, f"{name} is {value}: {expected} is expected")
    return value


def _without(contact: Contact, removed: set[Pair]) -> list[Contact]:
    """Return a contact without some of its pairs, as few contacts as possible."""
    left = _pairs(contact) - removed
    if left == _pairs(contact):
        return [contact]
    if set(contact.first) == set(contact.second):
        groups = _groups(contact.first, left, {*contact.first})
        return [replace(contact, first=group, second=group) for group in groups]
    parts = []
    for first in contact.first:
        second = tuple(
            name for name in contact.second if frozenset((first, name)) in left
        )
        left -= {frozenset((first, name)) for name in second}
        if second:
            parts.append(replace(contact, first=(first,), second=second))
    return parts


def _groups(
    names: Sequence[str], pairs: set[Pair], moving: set[str]
) -> Iterator[tuple[str, ...]]:
    """Yield groups of bodies that cover each pair once and contain no other pair with a moving body.

    One contact of many bodies tells an engine that impacts travel through them.
    """
    left = set(pairs)
    while left:
        group = set(min(left, key=lambda pair: sorted(map(names.index, pair))))
        for name in names:
            others = {frozenset((name, member)) for member in group - {name}}
            if all(pair in left or not pair & moving for pair in others):
                group.add(name)
        left -= {frozenset(pair) for pair in combinations(group, 2)}
        yield tuple(sorted(group, key=names.index))


# --- contacts of UsdPhysics ------------------------------------------------------------------------------------------


def _colliding_pairs(source: Source, bodies: Sequence[Collider]) -> set[Pair]:
    """Return the pairs of bodies that UsdPhysics lets collide; a filter of a part of a body counts for the body."""
    solid = [body for body in bodies if any(map(is_enabled, body.shapes))]
    groups = _collision_groups(source, solid)
    table = UsdPhysics.CollisionGroup.ComputeCollisionGroupTable(source.stage)
    pairs = {
        frozenset((first.name, second.name))
        for first, second in combinations(solid, 2)
        if (first.moves or second.moves)
        and all(
            table.IsCollisionEnabled(*both)
            for both in product(groups[first.name], groups[second.name])
        )
    }
    for paths in _filtered_paths(source):
        sides = [[body.name for body in solid if _has(body, path)] for path in paths]
        pairs -= {frozenset(pair) for pair in product(*sides)}
    return pairs


def is_enabled(shape: Usd.Prim) -> bool:
    """Return whether a collider is enabled."""
    attribute = UsdPhysics.CollisionAPI(shape).GetCollisionEnabledAttr()
    return not attribute or attribute.Get() is not False


def _has(body: Collider, path: Sdf.Path) -> bool:
    """Return whether a body is at or below a path, or has a collider there."""
    shapes = [shape.GetPath() for shape in body.shapes]
    return body.prim.GetPath().HasPrefix(path) or path in shapes


def _filtered_paths(source: Source) -> Iterator[tuple[Sdf.Path, Sdf.Path]]:
    """Yield the filtered pairs, and those of joints, whose bodies do not collide unless they say so."""
    for prim in source.prims():
        if filters := UsdPhysics.FilteredPairsAPI(prim):
            targets = filters.GetFilteredPairsRel().GetTargets()
            yield from product([prim.GetPath()], targets)
        joint = UsdPhysics.Joint(prim)
        if joint and not joint.GetCollisionEnabledAttr().Get():
            bodies = joint.GetBody0Rel(), joint.GetBody1Rel()
            yield from product(*(body.GetTargets() for body in bodies))


def _collision_groups(
    source: Source, bodies: Sequence[Collider]
) -> dict[str, list[Sdf.Path]]:
    """Return the paths of the collision groups of each body, by its name."""
    groups: dict[str, list[Sdf.Path]] = {body.name: [] for body in bodies}
    for prim in source.prims():
        if not prim.IsA(UsdPhysics.CollisionGroup):
            continue
        collection = UsdPhysics.CollisionGroup(prim).GetCollidersCollectionAPI()
        query = collection.ComputeMembershipQuery()
        for body in bodies:
            if any(query.IsPathIncluded(shape.GetPath()) for shape in body.shapes):
                groups[body.name].append(prim.GetPath())
    return groups


def _material_contacts(
    source: Source,
    bodies: Sequence[Collider],
    pairs: set[Pair],
    options: ContactOptions,
) -> Iterator[Contact]:
    """Yield contacts for the pairs that only UsdPhysics defines; pairs with equal constants share a contact."""
    by_name = {body.name: body for body in bodies}
    moving = {body.name for body in bodies if body.moves}
    constants = {
        name: _body_constants(source, by_name[name], options)
        for name in sorted({name for pair in pairs for name in pair})
    }
    kinds: dict[tuple[float, float, ContactMode], set[Pair]] = {}
    for pair in sorted(pairs, key=sorted):
        first, second = (constants[name] for name in pair)
        friction = _combined(first["friction"], second["friction"])
        restitution = _combined(first["restitution"], second["restitution"])
        kind = (friction, restitution, options.mode_of(pair))
        kinds.setdefault(kind, set()).add(pair)
    for (friction, restitution, mode), alike in kinds.items():
        for group in _groups([*by_name], alike, moving):
            yield Contact(
                first=group,
                second=group,
                friction=friction,
                restitution=restitution,
                mode=mode,
            )


def _combined(first: tuple[float, str], second: tuple[float, str]) -> float:
    """Return the coefficient of a pair, combined as in PhysX; the default is the average."""
    a, b = first[0], second[0]
    values = {
        "average": a if a == b else 0.5 * (a + b),
        "min": min(a, b),
        "multiply": a * b,
        "max": max(a, b),
    }
    return values[max(first[1], second[1], key=COMBINATIONS.index)]


def _body_constants(
    source: Source, body: Collider, options: ContactOptions
) -> dict[str, tuple[float, str]]:
    """Return friction and restitution of a body, each with its combine mode."""
    materials = {
        material.GetPath(): material
        for material in map(source.material, body.shapes)
        if material is not None
    }
    if len(materials) != 1:
        raise source.fault(
            body.prim,
            f"has {len(materials) or 'no'} physics material, so its friction is unknown: bind one",
        )
    (material,) = materials.values()
    api = UsdPhysics.MaterialAPI(material)
    stored = {
        "dynamic": source.stored(api.GetDynamicFrictionAttr()),
        "static": source.stored(api.GetStaticFrictionAttr()),
        "restitution": source.stored(api.GetRestitutionAttr()),
    }
    values = {kind: float(one.value) for kind, one in stored.items() if one is not None}
    restitution = values.pop("restitution", 0.0)
    if not values:
        raise source.fault(
            material,
            "has neither physics:dynamicFriction nor physics:staticFriction: set one",
        )
    if len(set(values.values())) == 2 and options.friction is None:
        raise source.fault(
            material,
            f"static friction is {values['static']:.6g} and dynamic {values['dynamic']:.6g}, but a scene has one "
            'coefficient: make them equal, or choose friction="dynamic" or "static"',
        )
    friction = values.get(options.friction or "dynamic", max(values.values()))
    constants = {}
    for name, value in (("friction", friction), ("restitution", restitution)):
        attribute = material.GetAttribute(f"physxMaterial:{name}CombineMode")
        combine_mode = source.text(attribute, COMBINATIONS) or COMBINATIONS[0]
        value = _coefficient(source, material, name, value)
        constants[name] = (value, combine_mode)
    return constants
