"""Contacts in Newton, whose contact constants belong to shapes and particles and not to pairs. Needs no engine.

In a rigid scene, a body whose contacts all have the same constants carries them with priority over the other body of
each pair. If neither body does, both get a copy of their shapes with the constants of the pair. Cloth and soft bodies
consist of particles, which share one friction.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp
from gauge_envs.backends.shared.pair_values import values_of_sums
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, Contact, ContactMode, Rod, Rope, Scene, SoftBody

FRICTION_AS_NORMAL = -1.0
"""Negative friction gain, with which friction has the time constant of the contact. Newton's default gain gives light
bodies a time constant far below the time step, and they jump."""

DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's default impedance of contacts, which Newton's shapes have."""

DEFAULT_KF_N_S_PER_M = 1000.0
"""Newton's default friction gain of shapes."""

PARTICLES = ""
"""Placeholder name of all bodies made of particles, which share one friction in Newton; no body has this name."""

FRICTION_FLOOR = 1e-9
"""Replacement for zero friction, which has no logarithm."""


# --- rigid bodies ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ShapeConstants:
    """Contact constants of a shape, under MuJoCo's names."""

    friction: float
    solref: tuple[float, float]
    solimp: tuple[float, ...]
    friction_gain_n_s_per_m: float
    torsion_m: float
    rolling_m: float


def _constants(
    contact: Contact, mass_kg: float, settings: SettingsMuJoCoWarp
) -> ShapeConstants:
    """Return the constants of a contact.

    Args:
        contact: The contact.
        mass_kg: Reduced mass of the two bodies, m1 m2 / (m1 + m2).
        settings: Settings of the solver.
    """
    solref = settings.sustained_solref
    solimp: tuple[float, ...] = settings.sustained_solimp
    gain = FRICTION_AS_NORMAL
    if settings.contact_solref is not None:
        solref = settings.contact_solref
        solimp = settings.contact_solimp or DEFAULT_SOLIMP
        gain = DEFAULT_KF_N_S_PER_M
        if settings.contact_kf_n_s_per_m is not None:
            gain = settings.contact_kf_n_s_per_m
    elif contact.mode is ContactMode.IMPACT:
        # One step changes the normal velocity v to -e v, as in the MuJoCo backend. Friction must stop the tangential
        # motion instead. That needs a damping of 1/h, which Newton computes as a gain times the inverse mass.
        step = settings.timestep_s
        damping_per_s = -(1.0 + contact.restitution) / step
        solref = (-settings.impact_stiffness / step**2, damping_per_s)
        solimp = settings.impact_solimp
        if settings.cone == "elliptic":
            share = (1.0 - solimp[1]) / settings.impratio + solimp[1]
            gain = solimp[1] / step * mass_kg / share
    return ShapeConstants(
        contact.friction, solref, solimp, gain, contact.torsion_m, contact.rolling_m
    )


def pair_constants(
    scene: Scene, settings: SettingsMuJoCoWarp
) -> dict[frozenset[str], ShapeConstants]:
    """Return the constants of each colliding pair of bodies."""
    inverse_masses = {body.name: 1.0 / body.mass_kg for body in scene.dynamic_bodies}
    constants = {}
    for contact in scene.contacts:
        for pair in scene.colliding_pairs(contact):
            mass_kg = 1.0 / sum(inverse_masses.get(name, 0.0) for name in pair)
            constants[frozenset(pair)] = _constants(contact, mass_kg, settings)
    return constants


def carried_constants(
    pairs: dict[frozenset[str], ShapeConstants],
) -> dict[str, ShapeConstants]:
    """Return the constants of each body whose contacts all have the same; such a body carries them with priority."""
    by_name: dict[str, set[ShapeConstants]] = {}
    for pair, constants in pairs.items():
        for name in pair:
            by_name.setdefault(name, set()).add(constants)
    return {
        name: next(iter(every)) for name, every in by_name.items() if len(every) == 1
    }


# --- particles --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SurfaceContacts:
    """Collision partners of particles, and the friction coefficients of both sides.

    Newton's friction of a pair is the geometric mean of the coefficients of both sides.

    Attributes:
        friction: Coefficient of all particles.
        shape_friction: Coefficient of the shapes of each rigid body, by name, including rigid blocks of soft rows.
        touched: Rigid bodies that particles collide with.
        passed: For each touched body, the bodies made of particles that pass through it.
        itself: Whether surfaces made of particles collide with each other.
    """

    friction: float = 0.0
    shape_friction: dict[str, float] = field(default_factory=dict)
    touched: frozenset[str] = frozenset()
    passed: dict[str, frozenset[str]] = field(default_factory=dict)
    itself: bool = False


def surface_contacts(scene: Scene) -> SurfaceContacts:
    """Return the collision partners and the coefficients that give each pair of the scene its friction."""
    pairs = _pairs(scene)
    solved = _side_frictions(pairs)
    friction = solved.pop(PARTICLES, 0.0)
    soft, met = _soft_bodies(scene), _met(scene)
    touching = {name: met[name] for name in sorted(met.keys() - soft)}
    return SurfaceContacts(
        friction=friction,
        shape_friction=solved | dict.fromkeys(sorted(soft), friction),
        touched=frozenset(touching),
        passed={name: soft - by for name, by in touching.items() if by != soft},
        itself=(PARTICLES, PARTICLES) in pairs,
    )


def unsupported_surface_contacts(scene: Scene, *, per_body: bool) -> Iterator[str]:
    """Yield one sentence for each contact that VBD does not support.

    Args:
        scene: The scene.
        per_body: Whether each body made of particles may have its own rigid collision partners. This needs
            collisions of vertices only.
    """
    try:
        pairs = _pairs(scene)
    except UnsupportedSceneError as error:
        yield str(error)
        return
    sides = _side_frictions(pairs)
    for (first, second), friction in pairs.items():
        closest = float(np.sqrt(sides[first] * sides[second]))
        if not np.isclose(closest, friction, rtol=1e-3, atol=1e-6):
            yield (
                f"the friction of {first or 'deformable bodies'!r} on {second or 'deformable bodies'!r} is "
                f"{friction:g}: Newton takes the geometric mean of one coefficient per body, and no coefficients give "
                "every pair its friction"
            )
    yield from _partial_contacts(scene, per_body=per_body)


def _partial_contacts(scene: Scene, *, per_body: bool) -> Iterator[str]:
    """Yield one sentence for each contact that involves only some of the bodies made of particles.

    Newton lets all of their surfaces collide with each other, or none. The same holds for a shape if edges and faces
    collide.
    """
    soft, met = _soft_bodies(scene), _met(scene)
    among = {name: touching for name, touching in met.items() if name in soft}
    if among and (
        set(among) != soft or any(touching != soft for touching in among.values())
    ):
        yield f"of {', '.join(sorted(soft))}, some touch each other or themselves and some do not"
    for name, touching in met.items():
        if not per_body and name not in soft and touching != soft:
            yield f"{', '.join(sorted(soft - touching))} would touch {name} as well as {', '.join(sorted(touching))}"


def _soft_bodies(scene: Scene) -> frozenset[str]:
    return frozenset(
        body.name for body in scene.deformables if isinstance(body, Cloth | SoftBody)
    )


def _met(scene: Scene) -> dict[str, frozenset[str]]:
    """Return the bodies made of particles that touch each body, by name.

    A body does not touch the rigid body that it is attached to, since they would be in contact all along the seam.
    """
    soft = _soft_bodies(scene)
    seams = {(a.deformable, a.to) for a in scene.attachments if a.to not in soft}
    met: dict[str, frozenset[str]] = {}
    for contact in scene.contacts:
        for group, opposite in (
            (contact.first, contact.second),
            (contact.second, contact.first),
        ):
            for name in opposite:
                touching = {
                    body for body in group if body in soft and (body, name) not in seams
                }
                met[name] = met.get(name, frozenset()) | touching
    return {name: touching for name, touching in met.items() if touching}


def _pairs(scene: Scene) -> dict[tuple[str, str], float]:
    """Return the friction of each pair of bodies that VBD simulates; bodies made of particles count as one."""
    soft = _soft_bodies(scene)
    lines = {body.name for body in scene.deformables if isinstance(body, Rope | Rod)}
    moving = soft | lines | {body.name for body in scene.dynamic_bodies}
    frictions: dict[tuple[str, str], float] = {}
    for contact in scene.contacts:
        for first, second in product(contact.first, contact.second):
            is_rigid_alone = first == second and first not in soft | lines
            if is_rigid_alone or moving.isdisjoint((first, second)):
                continue
            low, high = sorted(
                PARTICLES if name in soft else name for name in (first, second)
            )
            known = frictions.setdefault((low, high), contact.friction)
            if known != contact.friction:
                raise UnsupportedSceneError(
                    f"{first!r} and {second!r} have two coefficients of friction: Newton takes one for all "
                    "deformable bodies"
                )
    return frictions


def _side_frictions(pairs: dict[tuple[str, str], float]) -> dict[str, float]:
    """Return the coefficient of each side, the least-squares solution of log a + log b = 2 log(pair friction)."""
    sums = 2.0 * np.log(np.maximum(list(pairs.values()), FRICTION_FLOOR))
    logs = values_of_sums(dict(zip(pairs, sums.tolist(), strict=True)), lowest=-np.inf)
    return {name: float(np.exp(value)) for name, value in logs.items()}
