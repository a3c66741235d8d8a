"""Reader of contacts: the colliding bodies of a USD stage and their contact constants."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any, Literal

from pxr import Sdf, Usd, UsdPhysics

from gauge_envs.scene.bodies import Contact, ContactMode
from gauge_envs.tools.usd.layer import ARMS, names_digest
from gauge_envs.tools.usd.source import Source, StoredValue

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

COMBINE_ATTRIBUTES = {
    "friction": "physxMaterial:frictionCombineMode",
    "restitution": "physxMaterial:restitutionCombineMode",
}


@dataclass(frozen=True, kw_only=True)
class Party:
    """A body with its colliders.

    Attributes:
        name: Name of the body in the scene.
        prim: Prim of the body.
        colliders: Prims of its geometry; empty for ropes and rods, which UsdPhysics does not support.
        moves: Whether it is dynamic or deformable.
    """

    name: str
    prim: Usd.Prim
    colliders: tuple[Usd.Prim, ...]
    moves: bool


@dataclass(frozen=True, kw_only=True)
class PairOptions:
    """Properties of contacts that a USD file does not define.

    Attributes:
        friction: The coefficient that counts if static and dynamic friction of a material differ; None raises an error.
        mode: Mode of contacts without `gauge:mode`: one for all, or one per pair of names and sustained for others.
        contacts: Contacts that replace those of the file for their pairs.
    """

    friction: Literal["dynamic", "static"] | None = None
    mode: ContactMode | Mapping[tuple[str, str], ContactMode] = ContactMode.SUSTAINED
    contacts: Sequence[Contact] = ()

    def mode_of(self, pair: Pair) -> ContactMode:
        """Return the contact mode of a pair of bodies."""
        if isinstance(self.mode, ContactMode):
            return self.mode
        return next(
            (mode for names, mode in self.mode.items() if frozenset(names) == pair),
            ContactMode.SUSTAINED,
        )


def contacts_of(
    source: Source, physics: Usd.Prim, parties: Sequence[Party], options: PairOptions
) -> tuple[Contact, ...]:
    """Return the contacts of a stage with the given PhysicsScene prim.

    `gauge:first` and `gauge:second` define the pairs. If the pairs of UsdPhysics were edited, the edits add or remove
    pairs. A file without `gauge:first` has the pairs of UsdPhysics: all enabled colliders except filtered pairs.
    """
    prims = [prim for prim in source.prims() if prim.HasRelationship("gauge:first")]
    kept = [_gauge_contact(source, prim, parties) for prim in prims]
    _check_bindings(source, prims, kept, parties)
    moving = {party.name for party in parties if party.moves}
    solid = {party.name for party in parties if party.colliders}
    listed = {
        pair
        for contact in kept
        for pair in _pairs(contact)
        if pair & moving and pair <= solid
    }
    allowed = _colliding(source, parties)
    given = {pair for contact in options.contacts for pair in _pairs(contact)}
    if prims and listed != allowed:
        written = source.text(physics.GetAttribute("gauge:colliding_pairs"))
        if names_digest(listed) == written:
            kept = [
                part for contact in kept for part in _without(contact, listed - allowed)
            ]
        elif names_digest(allowed) != written:
            one = min(listed ^ allowed, key=sorted)
            where = "collide" if one in allowed else "pass through each other"
            raise source.fault(
                prims[0].GetParent(),
                f"UsdPhysics lets {' and '.join(sorted(one))} {where}, but gauge:first and gauge:second do not, and "
                "both were edited: make them agree",
            )
        else:
            allowed = listed
    kept = [part for contact in kept for part in _without(contact, given)]
    return (
        *kept,
        *_from_materials(source, parties, allowed - listed - given, options),
        *options.contacts,
    )


# --- contacts that this package wrote --------------------------------------------------------------------------------


def _gauge_contact(source: Source, prim: Usd.Prim, parties: Sequence[Party]) -> Contact:
    names = {party.prim.GetPath(): party.name for party in parties}
    sides: dict[str, Any] = {}
    for side in ("first", "second"):
        relationship = prim.GetRelationship(f"gauge:{side}")
        targets = relationship.GetTargets() if relationship else []
        unknown = next((target for target in targets if target not in names), None)
        if unknown is not None or not relationship:
            raise source.fault(
                prim, f"gauge:{side} names {unknown or 'nothing'}: bodies are expected"
            )
        sides[side] = tuple(names[target] for target in targets)
    materials = _linked_materials(source, prim)
    values: dict[str, Any] = {}
    for name, attributes in COEFFICIENT_ATTRIBUTES.items():
        readings = [
            source.reading(material.GetAttribute(a))
            for material in materials
            for a in attributes
        ]
        value = source.counted(prim.GetAttribute(f"gauge:{name}"), readings)
        values[name] = _coefficient(
            source, prim, name, None if value is None else float(value)
        )
    for name in ARMS:
        arm = source.number(prim.GetAttribute(f"gauge:{name}"))
        values[name] = _coefficient(source, prim, name, arm or 0.0)
    mode = source.text(prim.GetAttribute("gauge:mode"), tuple(ContactMode))
    if mode is None:
        raise source.fault(prim, f"gauge:mode is missing: {' or '.join(ContactMode)}")
    return Contact(**sides, **values, mode=ContactMode(mode))


def _linked_materials(
    source: Source, prim: Usd.Prim, name: str = "gauge:materials"
) -> list[Usd.Prim]:
    """Return the materials with the constants of a contact, or those that are derived from contacts."""
    relationship = prim.GetRelationship(name)
    found = [
        source.stage.GetPrimAtPath(path)
        for path in (relationship.GetTargets() if relationship else [])
    ]
    return [material for material in found if material]


def _check_bindings(
    source: Source,
    prims: Sequence[Usd.Prim],
    kept: Sequence[Contact],
    parties: Sequence[Party],
) -> None:
    """Check that no body of a contact is bound to a material that belongs to none of its contacts."""
    kinds = ("gauge:materials", "gauge:derived_materials")
    linked = [
        {
            one.GetPath()
            for kind in kinds
            for one in _linked_materials(source, prim, kind)
        }
        for prim in prims
    ]
    for party in parties:
        known = [
            paths
            for paths, c in zip(linked, kept, strict=True)
            if party.name in (*c.first, *c.second)
        ]
        bound = {
            material.GetPath()
            for material in map(source.material, party.colliders)
            if material
        }
        strange = bound.difference(*known)
        if known and strange:
            raise source.fault(
                party.prim,
                f"is bound to {min(strange)}, which is the material of none of its contacts: edit the material of the "
                "contact instead, or add this material to gauge:materials",
            )


def _coefficient(
    source: Source, prim: Usd.Prim, name: str, value: float | None
) -> float:
    if value is None:
        raise source.fault(prim, f"has no {name}")
    if value < 0.0 or (name == "restitution" and value > 1.0):
        raise source.fault(
            prim,
            f"{name} is {value}: {'0 to 1' if name == 'restitution' else '0 or more'} is expected",
        )
    return value


def _pairs(contact: Contact) -> set[Pair]:
    return {frozenset((a, b)) for a in contact.first for b in contact.second if a != b}


def _without(contact: Contact, pairs: set[Pair]) -> list[Contact]:
    """Return a contact without some of its pairs, as few contacts as possible."""
    left = _pairs(contact) - pairs
    if left == _pairs(contact):
        return [contact]
    if set(contact.first) == set(contact.second):
        return [
            replace(contact, first=group, second=group)
            for group in _cliques(contact.first, left, {*contact.first})
        ]
    parts = []
    for first in contact.first:
        second = tuple(
            name for name in contact.second if frozenset((first, name)) in left
        )
        left -= {frozenset((first, name)) for name in second}
        if second:
            parts.append(replace(contact, first=(first,), second=second))
    return parts


# --- contacts of UsdPhysics ------------------------------------------------------------------------------------------


def _colliding(source: Source, parties: Sequence[Party]) -> set[Pair]:
    """Return the pairs of bodies that UsdPhysics lets collide."""
    solid = [party for party in parties if any(map(source.collides, party.colliders))]
    filtered = _filtered(source, solid) | _filtered_by_groups(source, solid)
    pairs = (
        frozenset((one.name, other.name))
        for one, other in combinations(solid, 2)
        if one.moves or other.moves
    )
    return {pair for pair in pairs if pair not in filtered}


def _filtered(source: Source, parties: Sequence[Party]) -> set[Pair]:
    filtered = set()
    for prim in source.prims():
        if not prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            continue
        ones = _named(source, prim, prim.GetPath(), parties)
        for target in (
            UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel().GetTargets()
        ):
            filtered |= {
                frozenset((one, other))
                for one in ones
                for other in _named(source, prim, target, parties)
            }
    for prim in source.prims():
        joint = UsdPhysics.Joint(prim)
        # Bodies of a joint pass through each other unless it says otherwise.
        if not joint or joint.GetCollisionEnabledAttr().Get():
            continue
        ends = (joint.GetBody0Rel(), joint.GetBody1Rel())
        first, second = (
            [
                name
                for target in end.GetTargets()
                for name in _named(source, prim, target, parties)
            ]
            for end in ends
        )
        filtered |= {frozenset(pair) for pair in product(first, second)}
    return filtered


def _named(
    source: Source, prim: Usd.Prim, path: Sdf.Path, parties: Iterable[Party]
) -> list[str]:
    """Return the bodies at or below a path, or whose only collider is at the path."""
    names = []
    for party in parties:
        if party.prim.GetPath().HasPrefix(path) or [
            one.GetPath() for one in party.colliders
        ] == [path]:
            names.append(party.name)
        elif any(one.GetPath() == path for one in party.colliders):
            raise source.fault(
                prim,
                f"filters {path}, which is only a part of {party.prim.GetPath()}: filter the whole body",
            )
    return names


def _filtered_by_groups(source: Source, parties: Sequence[Party]) -> set[Pair]:
    groups = [
        UsdPhysics.CollisionGroup(prim)
        for prim in source.prims()
        if prim.IsA(UsdPhysics.CollisionGroup)
    ]
    if not groups:
        return set()
    table = UsdPhysics.CollisionGroup.ComputeCollisionGroupTable(source.stage)
    members = {
        group.GetPath(): group.GetCollidersCollectionAPI().ComputeMembershipQuery()
        for group in groups
    }
    inside: dict[str, set[Sdf.Path]] = {}
    for party in parties:
        each = [
            {
                path
                for path, query in members.items()
                if query.IsPathIncluded(c.GetPath())
            }
            for c in party.colliders
        ]
        if any(one != each[0] for one in each):
            raise source.fault(
                party.prim,
                "its colliders are in different collision groups: put them in one group",
            )
        inside[party.name] = each[0]
    return {
        frozenset((one.name, other.name))
        for one, other in combinations(parties, 2)
        if any(
            not table.IsCollisionEnabled(a, b)
            for a in inside[one.name]
            for b in inside[other.name]
        )
    }


def _from_materials(
    source: Source, parties: Sequence[Party], pairs: set[Pair], options: PairOptions
) -> list[Contact]:
    """Return contacts for the pairs that only UsdPhysics defines; pairs with equal constants share a contact."""
    by_name = {party.name: party for party in parties}
    wanted = {name for pair in pairs for name in pair}
    constants = {
        name: _constants(source, by_name[name], options)
        for name in by_name
        if name in wanted
    }
    kinds: dict[tuple[float, float, ContactMode], set[Pair]] = {}
    for pair in sorted(pairs, key=sorted):
        one, other = (constants[name] for name in sorted(pair))
        friction, restitution = (
            _combined(one[key], other[key]) for key in ("friction", "restitution")
        )
        kinds.setdefault((friction, restitution, options.mode_of(pair)), set()).add(
            pair
        )
    moving = {party.name for party in parties if party.moves}
    names = [party.name for party in parties]
    return [
        Contact(
            first=group,
            second=group,
            friction=friction,
            restitution=restitution,
            mode=mode,
        )
        for (friction, restitution, mode), alike in kinds.items()
        for group in _cliques(names, alike, moving)
    ]


def _cliques(
    names: Sequence[str], pairs: set[Pair], moving: set[str]
) -> Iterator[tuple[str, ...]]:
    """Yield groups of bodies that cover each pair once and contain no other pair with a moving body."""
    left = set(pairs)
    while left:
        group = _clique(names, left, moving)
        left -= {frozenset(pair) for pair in combinations(group, 2)}
        yield group


def _clique(
    names: Sequence[str], pairs: set[Pair], moving: set[str]
) -> tuple[str, ...]:
    """Return bodies of which every two form one of the pairs or do not move, in the order of `names`."""
    group = sorted(
        min(pairs, key=lambda pair: sorted(map(names.index, pair))), key=names.index
    )
    for name in names:
        others = [frozenset((name, one)) for one in group if one != name]
        if name not in group and all(
            pair in pairs or not pair & moving for pair in others
        ):
            group.append(name)
    return tuple(sorted(group, key=names.index))


def _combined(one: tuple[float, str], other: tuple[float, str]) -> float:
    """Return the coefficient of a pair, combined as in PhysX; the default is the average."""
    how = max(one[1], other[1], key=COMBINATIONS.index)
    a, b = one[0], other[0]
    if a == b and how != "multiply":
        return a
    return {
        "average": 0.5 * (a + b),
        "min": min(a, b),
        "multiply": a * b,
        "max": max(a, b),
    }[how]


def _constants(
    source: Source, party: Party, options: PairOptions
) -> dict[str, tuple[float, str]]:
    """Return friction and restitution of a body, each with its combine mode."""
    materials = {
        material.GetPath(): material
        for material in map(source.material, party.colliders)
        if material
    }
    if not materials or any(source.material(prim) is None for prim in party.colliders):
        raise source.fault(
            party.prim, "has no physics material, so its friction is unknown: bind one"
        )
    found = [
        _material_constants(source, material, options)
        for material in materials.values()
    ]
    if any(one != found[0] for one in found):
        raise source.fault(
            party.prim,
            "its colliders have materials with different constants: use one per body",
        )
    return found[0]


def _material_constants(
    source: Source, prim: Usd.Prim, options: PairOptions
) -> dict[str, tuple[float, str]]:
    api = UsdPhysics.MaterialAPI(prim)
    readings = {
        "dynamic": source.reading(api.GetDynamicFrictionAttr()),
        "static": source.reading(api.GetStaticFrictionAttr()),
    }
    present: dict[str, StoredValue] = {
        name: reading for name, reading in readings.items() if reading is not None
    }
    if not present:
        raise source.fault(
            prim,
            "has neither physics:dynamicFriction nor physics:staticFriction: set one",
        )
    values = {name: float(reading.value) for name, reading in present.items()}
    if len(set(values.values())) == 2 and options.friction is None:
        raise source.fault(
            prim,
            f"static friction is {values['static']:.6g} and dynamic {values['dynamic']:.6g}, but a scene has one "
            'coefficient: make them equal, or choose friction="dynamic" or "static"',
        )
    friction = values.get(options.friction or "dynamic", next(iter(values.values())))
    restitution = source.reading(api.GetRestitutionAttr())
    constants = {
        "friction": friction,
        "restitution": 0.0 if restitution is None else float(restitution.value),
    }
    return {
        name: (
            _coefficient(source, prim, name, value),
            source.text(prim.GetAttribute(COMBINE_ATTRIBUTES[name]), COMBINATIONS)
            or "average",
        )
        for name, value in constants.items()
    }
