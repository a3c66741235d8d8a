"""Contacts of a rigid scene in Newton, whose contact constants belong to shapes and not to pairs. Needs no engine.

A body whose contacts all have the same constants carries them with priority over the other body of each pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp
from gauge_envs.scene import Contact, ContactMode, Motion, Scene

FRICTION_AS_NORMAL = -1.0
"""Negative friction gain, with which friction has the time constant of the contact. Newton's default gain gives light
bodies a time constant far below the time step, and they hop."""

DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's default impedance of contacts, which Newton's shapes have."""

DEFAULT_KF_N_S_PER_M = 1000.0
"""Newton's default friction gain of shapes."""


@dataclass(frozen=True)
class ShapeConstants:
    """Contact constants of a shape, under MuJoCo's names."""

    friction: float
    solref: tuple[float, float]
    solimp: tuple[float, ...]
    friction_gain_n_s_per_m: float


def _constants(contact: Contact, mass_kg: float, settings: SettingsMuJoCoWarp) -> ShapeConstants:
    """Return the constants of a contact.

    Args:
        contact: The contact.
        mass_kg: Reduced mass of the two bodies, m1 m2 / (m1 + m2).
        settings: Settings of the solver.
    """
    if settings.contact_solref is not None:
        gain = settings.contact_kf_n_s_per_m
        return ShapeConstants(
            contact.friction,
            settings.contact_solref,
            settings.contact_solimp or DEFAULT_SOLIMP,
            DEFAULT_KF_N_S_PER_M if gain is None else gain,
        )
    if contact.mode is ContactMode.SUSTAINED:
        return ShapeConstants(
            contact.friction, settings.sustained_solref, settings.sustained_solimp, FRICTION_AS_NORMAL
        )
    # One step changes the normal velocity v to -e v, as in the MuJoCo backend. Friction must stop the tangential motion
    # instead. That needs a damping of 1/h, which Newton computes as a gain times the inverse mass of the bodies.
    step, width = settings.timestep_s, settings.impact_solimp[1]
    solref = (-settings.impact_stiffness / step**2, -(1.0 + contact.restitution) / step)
    share = (1.0 - width) / settings.impratio + width
    gain = width / step * mass_kg / share if settings.cone == "elliptic" else FRICTION_AS_NORMAL
    return ShapeConstants(contact.friction, solref, settings.impact_solimp, gain)


def _reduced_mass_kg(scene: Scene, first: str, second: str) -> float:
    inverse = [1.0 / scene.body(name).mass_kg for name in (first, second) if scene.body(name).motion is Motion.DYNAMIC]
    return 1.0 / sum(inverse)


def pair_constants(scene: Scene, settings: SettingsMuJoCoWarp) -> dict[frozenset[str], ShapeConstants]:
    """Return the constants of each colliding pair of bodies."""
    return {
        frozenset(pair): _constants(contact, _reduced_mass_kg(scene, *pair), settings)
        for contact in scene.contacts
        for pair in scene.colliding_pairs(contact)
    }


def carried_constants(pairs: dict[frozenset[str], ShapeConstants]) -> dict[str, ShapeConstants]:
    """Return the constants of each body whose contacts all have the same; such a body carries them with priority."""
    found: dict[str, set[ShapeConstants]] = {}
    for pair, constants in pairs.items():
        for name in pair:
            found.setdefault(name, set()).add(constants)
    return {name: next(iter(every)) for name, every in found.items() if len(every) == 1}


def unsupported_contacts(scene: Scene, settings: SettingsMuJoCoWarp) -> Iterator[str]:
    """Yield one sentence for each group of contacts whose constants Newton's shapes cannot carry."""
    pairs = pair_constants(scene, settings)
    carried = carried_constants(pairs)
    mixed = sorted({name for pair in pairs if not pair & set(carried) for name in pair})
    if mixed:
        shown = ", ".join(mixed[:4]) + (f" and {len(mixed) - 4} more" if len(mixed) > 4 else "")
        yield (
            f"contacts among {shown} differ in friction, restitution or mode from pair to pair: Newton's contact "
            "constants belong to a body, not to a pair"
        )
