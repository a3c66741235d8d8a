"""Engine-neutral vocabulary: what a scene is made of, in SI units and the motion-capture world frame (z up).

A `Scene` is all that a backend sees. It knows shapes, masses, contact constants, joints and how driven bodies move,
and never which experiment it came from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.scene.bodies import (
    Attachment,
    Contact,
    ContactMode,
    Deformable,
    Hinge,
    Markers,
    Motion,
    RigidBody,
    Tether,
)
from gauge_envs.scene.geometry import Plane

if TYPE_CHECKING:
    from gauge_envs.scene.drivers import Driver

__all__ = [
    "GRAVITY_M_PER_S2",
    "Scene",
]

GRAVITY_M_PER_S2 = 9.80665
"""Standard gravity [m/s^2], the value that the paper uses (its dynamic-error equation)."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything that a backend needs to build and drive one experiment.

    Attributes:
        bodies: Rigid bodies in a fixed order.
        deformables: Cloth, soft bodies, ropes and rods.
        joints: Hinges and tethers to the world.
        attachments: Attached regions of deformable bodies.
        contacts: Pairs that collide.
        drivers: Prescribed motions of the kinematic bodies.
        markers: Markers on deformable bodies, if any.
        duration_s: How long the experiment lasts; bounds on speed and distance derive from it.
        gravity_m_per_s2: Downward acceleration.
    """

    bodies: tuple[RigidBody, ...]
    duration_s: float
    deformables: tuple[Deformable, ...] = ()
    joints: tuple[Hinge | Tether, ...] = ()
    attachments: tuple[Attachment, ...] = ()
    contacts: tuple[Contact, ...] = ()
    drivers: tuple[Driver, ...] = ()
    markers: Markers | None = None
    gravity_m_per_s2: float = GRAVITY_M_PER_S2
    _by_name: dict[str, RigidBody] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_by_name", {body.name: body for body in self.bodies})

    def body(self, name: str) -> RigidBody:
        """Rigid body of that name; KeyError where there is none."""
        return self._by_name[name]

    @property
    def dynamic_bodies(self) -> tuple[RigidBody, ...]:
        """Bodies that move under forces, in scene order."""
        return tuple(body for body in self.bodies if body.motion is Motion.DYNAMIC)

    @cached_property
    def has_impact_chain(self) -> bool:
        """Whether more than two dynamic bodies collide with each other, so that impacts travel through them."""
        dynamic = {body.name for body in self.dynamic_bodies}
        return any(
            contact.mode is ContactMode.IMPACT and len(dynamic & set(contact.first) & set(contact.second)) > 2
            for contact in self.contacts
        )

    def colliding_pairs(self, contact: Contact) -> Iterator[tuple[str, str]]:
        """Distinct pairs of bodies of a contact that can meet: at least one moves under forces or is deformable."""
        moving = {body.name for body in self.dynamic_bodies} | {body.name for body in self.deformables}
        seen = set()
        for first, second in product(contact.first, contact.second):
            pair = frozenset((first, second))
            if first != second and pair & moving and pair not in seen:
                seen.add(pair)
                yield first, second

    @cached_property
    def floor_height_m(self) -> float:
        """Lowest height that a body can fall to: the highest plane, or where free fall leads without one."""
        planes = [body.pose.position_m[2] for body in self.bodies if isinstance(body.shape, Plane)]
        if planes:
            return max(planes)
        lowest = min((b.pose.position_m[2] for b in self.bodies), default=0.0)
        return lowest - 0.5 * self.gravity_m_per_s2 * self.duration_s**2

    @cached_property
    def speed_limit_m_per_s(self) -> float:
        """Speed that no dynamic body can reach: three times free fall from the highest point plus twice the drivers'.

        A perfectly elastic hit by a driven body of infinite mass leaves a light body with twice its speed. The
        factor three leaves room for a light body struck by heavy falling ones.
        """
        highest = max((float(b.pose.to_world(b.shape.corners_m)[:, 2].max()) for b in self.bodies), default=0.0)
        drop = max(highest - self.floor_height_m, 0.1)
        driven = max((driver.speed_limit_m_per_s(self.body(driver.body)) for driver in self.drivers), default=0.0)
        return 3.0 * float(np.sqrt(2.0 * self.gravity_m_per_s2 * drop)) + 2.0 * driven

    @cached_property
    def distance_limit_m(self) -> float:
        """Distance from the world origin [m] that no body's origin can reach within the duration."""
        reach = max((float(np.linalg.norm(b.pose.position_m)) for b in self.bodies), default=0.0)
        return reach + 1.0 + self.speed_limit_m_per_s * self.duration_s

    @cached_property
    def kinetic_energy_limit_j(self) -> float:
        """Kinetic energy [J] that the dynamic bodies cannot hold together.

        All potential energy above the floor, plus what elastic hits by the drivers can give, plus a quarter.
        """
        driven = max((driver.speed_limit_m_per_s(self.body(driver.body)) for driver in self.drivers), default=0.0)
        total = 0.0
        for body in self.dynamic_bodies:
            lowest = float(body.pose.to_world(body.shape.corners_m)[:, 2].min())
            total += body.mass_kg * self.gravity_m_per_s2 * max(lowest - self.floor_height_m, 0.02)
            # Twice the driver's speed is one elastic hit.
            total += 0.5 * body.mass_kg * (2.0 * driven) ** 2
        return 1.25 * total
