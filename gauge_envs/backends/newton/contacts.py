"""Contacts of a scene in Newton's terms: constants belong to bodies there, not to pairs. Needs no engine.

Of the two bodies of a pair, one whose contacts all have the same constants carries them, and goes before the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp
from gauge_envs.scene import Contact, ContactMode, Motion, Scene

__all__ = [
    "FRICTION_AS_NORMAL",
    "ShapeConstants",
    "carried_constants",
    "pair_constants",
    "undoable_contacts",
]

FRICTION_AS_NORMAL = -1.0
"""A friction gain that is neither positive nor zero leaves friction the contact's own time constant. Newton's default
gives light bodies one that is far below the step, and they hop."""


@dataclass(frozen=True)
class ShapeConstants:
    """What a shape carries for its contacts, in MuJoCo's terms."""

    friction: float
    solref: tuple[float, float]
    solimp: tuple[float, float, float]
    friction_gain_n_s_per_m: float


def _constants(contact: Contact, mass_kg: float, settings: SettingsMuJoCoWarp) -> ShapeConstants:
    """Constants of a contact.

    Args:
        contact: The contact.
        mass_kg: Mass that the two bodies have against each other, m1 m2 / (m1 + m2).
        settings: Settings of the solver.
    """
    if contact.mode is ContactMode.SUSTAINED:
        return ShapeConstants(
            contact.friction, settings.sustained_solref, settings.sustained_solimp, FRICTION_AS_NORMAL
        )
    # One step turns the normal speed into -e times itself, as in the MuJoCo backend. Friction must stop the tangential
    # speed instead: a damping of 1/h, which Newton makes of a gain times the bodies' inverse mass.
    step, width = settings.timestep_s, settings.impact_solimp[1]
    solref = (-settings.impact_stiffness / step**2, -(1.0 + contact.restitution) / step)
    share = (1.0 - width) / settings.impratio + width
    gain = width / step * mass_kg / share if settings.cone == "elliptic" else FRICTION_AS_NORMAL
    return ShapeConstants(contact.friction, solref, settings.impact_solimp, gain)


def _reduced_mass_kg(scene: Scene, first: str, second: str) -> float:
    inverse = [1.0 / scene.body(name).mass_kg for name in (first, second) if scene.body(name).motion is Motion.DYNAMIC]
    return 1.0 / sum(inverse)


def pair_constants(scene: Scene, settings: SettingsMuJoCoWarp) -> dict[frozenset[str], ShapeConstants]:
    """Constants of each pair of bodies that collide."""
    return {
        frozenset(pair): _constants(contact, _reduced_mass_kg(scene, *pair), settings)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }


def carried_constants(pairs: dict[frozenset[str], ShapeConstants]) -> dict[str, ShapeConstants]:
    """Constants of the bodies that have the same in all their contacts; those carry them, with priority."""
    found: dict[str, set[ShapeConstants]] = {}
    for pair, constants in pairs.items():
        for name in pair:
            found.setdefault(name, set()).add(constants)
    return {name: next(iter(every)) for name, every in found.items() if len(every) == 1}


def undoable_contacts(scene: Scene, settings: SettingsMuJoCoWarp) -> Iterator[str]:
    """What of a scene's contacts Newton cannot do, a sentence each: its constants belong to shapes, not to pairs."""
    pairs = pair_constants(scene, settings)
    carried = carried_constants(pairs)
    mixed = sorted({name for pair in pairs if not pair & set(carried) for name in pair})
    if mixed:
        shown = ", ".join(mixed[:4]) + (f" and {len(mixed) - 4} more" if len(mixed) > 4 else "")
        yield (
            f"contacts among {shown} differ in friction, restitution or mode from pair to pair: Newton's contact "
            "constants belong to a body, not to a pair"
        )
