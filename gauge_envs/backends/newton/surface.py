"""Contacts of bodies that are made of particles, in Newton's terms. Needs no engine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Cloth, Scene, SoftBody

__all__ = ["SurfaceContacts", "surface_contacts", "undoable_surface_contacts"]

PARTICLES = ""
"""Stands for all bodies that are made of particles: Newton has one friction for all of them. No body has this name."""

FRICTION_FLOOR = 1e-9
"""Stands for zero, which has no logarithm."""


@dataclass(frozen=True, kw_only=True)
class SurfaceContacts:
    """What bodies made of particles touch, and the coefficients from which Newton makes each pair's friction.

    Newton's friction of a pair is the geometric mean of both sides.

    Attributes:
        friction: Coefficient of all particles.
        shape_friction: Coefficient of the shapes of each rigid body, by its name.
        touched: Rigid bodies that particles collide with.
        itself: Whether particles collide with each other's surface.
    """

    friction: float = 0.0
    shape_friction: dict[str, float] = field(default_factory=dict)
    touched: frozenset[str] = frozenset()
    itself: bool = False


def surface_contacts(scene: Scene) -> SurfaceContacts:
    """Coefficients of friction for a scene, such that each pair gets its own.

    Raises:
        UnsupportedSceneError: No coefficients give every pair its friction, or some of several bodies that are made of
            particles would touch what they pass through.
    """
    problems = list(undoable_surface_contacts(scene))
    if problems:
        raise UnsupportedSceneError("; ".join(problems))
    pairs = _pairs(scene)
    solved = _side_frictions(pairs)
    # A seam would be in contact all along, and what a body is glued to is part of it.
    seams = {a.to for a in scene.attachments}
    return SurfaceContacts(
        friction=solved.pop(PARTICLES, 0.0),
        shape_friction=solved,
        touched=frozenset({name for pair in pairs if PARTICLES in pair for name in pair} - seams - {PARTICLES}),
        itself=(PARTICLES, PARTICLES) in pairs,
    )


def undoable_surface_contacts(scene: Scene) -> Iterator[str]:
    """What of a scene's contacts Newton's VBD cannot do, a sentence each."""
    try:
        pairs = _pairs(scene)
    except UnsupportedSceneError as error:
        yield str(error)
        return
    sides = _side_frictions(pairs)
    for (first, second), friction in pairs.items():
        got = float(np.sqrt(sides[first] * sides[second]))
        if not np.isclose(got, friction, rtol=1e-3, atol=1e-6):
            yield (
                f"the friction of {first or 'what is deformable'!r} on {second or 'what is deformable'!r} is "
                f"{friction:g}: Newton takes the geometric mean of one coefficient a body, and no such coefficients "
                "give every pair its own"
            )
    yield from _partial_contacts(scene)


def _partial_contacts(scene: Scene) -> Iterator[str]:
    """Bodies made of particles touch a shape, or each other, all or not at all."""
    soft = frozenset(body.name for body in scene.deformables if isinstance(body, Cloth | SoftBody))
    met: dict[str, set[str]] = {}
    for contact in scene.contacts:
        for first, second in ((contact.first, contact.second), (contact.second, contact.first)):
            for name in set(first) & soft:
                for other in second:
                    met.setdefault(other, set()).add(name)
    among = {name: touching for name, touching in met.items() if name in soft}
    if among and (set(among) != soft or any(touching != soft for touching in among.values())):
        yield f"of {', '.join(sorted(soft))}, some touch each other or themselves and some do not"
    for name, touching in met.items():
        if name not in soft and touching != soft:
            yield f"{', '.join(sorted(soft - touching))} would touch {name} as well as {', '.join(sorted(touching))}"


def _pairs(scene: Scene) -> dict[tuple[str, str], float]:
    """Friction of each pair of bodies that VBD resolves, those made of particles as one."""
    soft = {body.name for body in scene.deformables if isinstance(body, Cloth | SoftBody)}
    moving = soft | {body.name for body in scene.dynamic_bodies}
    found: dict[tuple[str, str], float] = {}
    for contact in scene.contacts:
        for first in contact.first:
            for second in contact.second:
                if not {first, second} & moving or (first == second and first not in soft):
                    continue
                low, high = sorted(PARTICLES if name in soft else name for name in (first, second))
                if found.setdefault((low, high), contact.friction) != contact.friction:
                    raise UnsupportedSceneError(f"{first!r} and {second!r} have two coefficients of friction")
    return found


def _side_frictions(pairs: dict[tuple[str, str], float]) -> dict[str, float]:
    """Coefficient of each side, the least squares solution of log a + log b = 2 log(friction of the pair)."""
    names = sorted({name for pair in pairs for name in pair})
    matrix = np.zeros((len(pairs), len(names)))
    for row, pair in zip(matrix, pairs, strict=True):
        for name in pair:
            row[names.index(name)] += 1.0
    right = 2.0 * np.log(np.maximum(list(pairs.values()), FRICTION_FLOOR))
    logs = np.linalg.lstsq(matrix, right, rcond=None)[0] if pairs else ()
    return {name: float(np.exp(value)) for name, value in zip(names, logs, strict=True)}
