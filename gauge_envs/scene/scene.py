"""The engine-neutral scene, in SI units and the motion-capture world frame (z up).

A backend receives only a `Scene`: shapes, masses, contact constants, joints and prescribed motions. It does not receive
the name of the experiment.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from types import UnionType
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.scene.air import Air
from gauge_envs.scene.bodies import (
    Attachment,
    Cloth,
    Contact,
    ContactMode,
    Deformable,
    Hinge,
    Markers,
    Motion,
    RigidBody,
    Tether,
)
from gauge_envs.scene.contact_faces import (
    Normals,
    TouchingGroup,
    contact_normals,
    touching_groups,
)
from gauge_envs.scene.geometry import Plane

if TYPE_CHECKING:
    from gauge_envs.scene.drivers import Driver


GRAVITY_M_PER_S2 = 9.80665
"""Standard gravity [m/s^2], as in the paper (its equation of the dynamic error)."""

LEVEL = 0.9999
"""Smallest z of the unit normal of a level plane: a tilt of 0.8 degrees, more than any uncertainty of tilt."""

SAME_VELOCITY = 1e-5
"""Largest deviation of a start velocity from a rotation about a hinge [m/s, rad/s], relative to the largest number."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything that a backend needs to build and drive one experiment.

    Attributes:
        bodies: Rigid bodies in a fixed order.
        duration_s: Duration of the experiment [s]; bounds on speed and distance depend on it.
        deformables: Cloth, soft bodies, ropes and rods.
        joints: Hinges and tethers to the world.
        attachments: Attachments of deformable bodies.
        contacts: Groups of bodies that collide, and their contact constants.
        drivers: Prescribed motions of kinematic bodies.
        markers: Markers on deformable bodies, if any.
        gravity_m_per_s2: Downward acceleration [m/s^2].
        air: Air that acts on cloth, if any; it does not act on other bodies.

    Raises:
        ParameterError: A start velocity is not finite, or does not rotate a hinged body about its hinge. Or its body is
            not dynamic, or is attached to a deformable body.
        ParameterError: A body has two hinges.
        ParameterError: Two contacts list the same pair, or one has torsional or rolling friction without friction.
        ParameterError: There is air and no cloth.
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
    air: Air | None = None

    def __post_init__(self) -> None:
        for contact in self.contacts:
            if (contact.torsion_m or contact.rolling_m) and not contact.friction:
                raise ParameterError(
                    f"scene: {contact.first[0]!r} and {contact.second[0]!r} have torsional or rolling friction "
                    "without sliding friction, which engines need for both: give a friction above 0"
                )
        self._check_pairs()
        if self.air is not None and not self.has(Cloth):
            raise ParameterError(
                "the scene has air and no cloth. Air acts only on cloth: remove it"
            )
        hinged = [joint.body for joint in self.joints if isinstance(joint, Hinge)]
        for name in self.hinges:
            if hinged.count(name) > 1:
                raise ParameterError(
                    f"scene: {name!r} has {hinged.count(name)} hinges, so it cannot move: keep one, or make it "
                    "fixed"
                )
        for body in self.bodies:
            if not body.starts_at_rest:
                self._check_start_velocity(body)

    @cached_property
    def _by_name(self) -> dict[str, RigidBody]:
        """Rigid bodies by their names."""
        return {body.name: body for body in self.bodies}

    @cached_property
    def hinges(self) -> dict[str, Hinge]:
        """Hinges by the name of their body."""
        return {joint.body: joint for joint in self.joints if isinstance(joint, Hinge)}

    def _check_pairs(self) -> None:
        """Raise an error if two contacts list the same pair."""
        seen: set[frozenset[str]] = set()
        for contact in self.contacts:
            pairs = {frozenset(pair) for pair in self.colliding_pairs(contact)}
            if both := seen & pairs:
                first, second = sorted(both.pop())
                raise ParameterError(
                    f"scene: two contacts list the pair {first!r} and {second!r}. A pair has one friction, "
                    "restitution and mode: remove it from one of the contacts"
                )
            seen |= pairs

    def _check_start_velocity(self, body: RigidBody) -> None:
        linear, angular = (
            np.array(body.linear_velocity_m_per_s),
            np.array(body.angular_velocity_rad_per_s),
        )
        if not np.isfinite([linear, angular]).all():
            raise ParameterError(
                f"the start velocity of {body.name!r} is not finite: give finite numbers"
            )
        if body.motion is not Motion.DYNAMIC:
            raise ParameterError(
                f"{body.name!r} is {body.motion.value} and has a start velocity. Make the body dynamic, or remove the "
                "velocity; a driver gives the velocity of a kinematic body."
            )
        if any(attachment.to == body.name for attachment in self.attachments):
            raise ParameterError(
                f"{body.name!r} has a start velocity and is attached to a deformable body, which starts at rest. "
                "Remove the velocity or the attachment."
            )
        hinge = self.hinges.get(body.name)
        if hinge is None:
            return
        spin = np.asarray(hinge.axis) * (angular @ hinge.axis)
        arm_m = np.subtract(body.pose.position_m, hinge.anchor_m)
        expected = np.cross(spin, arm_m)
        error = np.abs([linear - expected, angular - spin]).max()
        if error > SAME_VELOCITY * np.abs([linear, angular]).max():
            raise ParameterError(
                f"the start velocity of {body.name!r} does not rotate the body about its hinge. Give an angular "
                f"velocity along the axis {hinge.axis}, and the linear velocity "
                f"{tuple((expected + 0.0).tolist())} m/s."
            )

    def body(self, name: str) -> RigidBody:
        """Return the rigid body of a name; raise KeyError if the scene has none."""
        return self._by_name[name]

    def has(self, kind: type | UnionType) -> bool:
        """Return whether a deformable body is of a kind, as `Cloth | SoftBody`."""
        return any(isinstance(body, kind) for body in self.deformables)

    @cached_property
    def dynamic_bodies(self) -> tuple[RigidBody, ...]:
        """Rigid bodies that move under forces, in scene order."""
        return tuple(body for body in self.bodies if body.motion is Motion.DYNAMIC)

    @cached_property
    def has_impact_chain(self) -> bool:
        """Whether more than two dynamic bodies collide with each other, so that impacts travel through them."""
        dynamic = {body.name for body in self.dynamic_bodies}
        return any(
            contact.mode is ContactMode.IMPACT
            and len(dynamic & set(contact.first) & set(contact.second)) > 2
            for contact in self.contacts
        )

    def colliding_pairs(self, contact: Contact) -> Iterator[tuple[str, str]]:
        """Yield the distinct pairs of a contact in which at least one body is dynamic or deformable."""
        seen: set[tuple[str, str]] = set()
        for pair in product(contact.first, contact.second):
            first, second = pair
            is_moving = first in self._moving or second in self._moving
            if first != second and is_moving and pair not in seen:
                seen.update((pair, (second, first)))
                yield pair

    @cached_property
    def _moving(self) -> frozenset[str]:
        """Names of the dynamic and the deformable bodies."""
        return frozenset(
            body.name for body in (*self.dynamic_bodies, *self.deformables)
        )

    @cached_property
    def contact_normals(self) -> Normals:
        """Normals of the faces at which colliding bodies touch at the start."""
        pairs = (
            pair for contact in self.contacts for pair in self.colliding_pairs(contact)
        )
        return contact_normals(self.bodies, pairs)

    @cached_property
    def free(self) -> frozenset[str]:
        """Names of the dynamic bodies without an attached deformable body."""
        attached = {attachment.to for attachment in self.attachments}
        return frozenset(body.name for body in self.dynamic_bodies) - attached

    @cached_property
    def free_cloths(self) -> frozenset[str]:
        """Names of the cloths that nothing clamps."""
        clamped = {attachment.deformable for attachment in self.attachments}
        cloths = (body.name for body in self.deformables if isinstance(body, Cloth))
        return frozenset(cloths) - clamped

    @cached_property
    def touching_groups(self) -> dict[str, TouchingGroup]:
        """Group of each free body without a joint, by name; bodies that touch one another are one group."""
        jointed = {joint.body for joint in self.joints}
        bodies = [
            body
            for body in self.bodies
            if body.name in self.free and body.name not in jointed
        ]
        return touching_groups(bodies, self.contact_normals)

    @cached_property
    def floor_height_m(self) -> float:
        """Lowest height that a body can reach [m]: the highest level plane, or else the end of free fall.

        A tilted plane does not stop a fall, because bodies slide down.
        """
        planes = [body.pose for body in self.bodies if isinstance(body.shape, Plane)]
        level = [pose.position_m[2] for pose in planes if pose.matrix[2, 2] > LEVEL]
        if level:
            return max(level)
        lowest = min((b.pose.position_m[2] for b in self.bodies), default=0.0)
        lowest -= self._start_speed_m_per_s * self.duration_s
        return lowest - 0.5 * self.gravity_m_per_s2 * self.duration_s**2

    @cached_property
    def speed_limit_m_per_s(self) -> float:
        """Upper bound on the speed of dynamic bodies [m/s].

        It is three times the speed after free fall from the highest point with the fastest start, plus twice the speed
        of driven bodies. A perfectly elastic hit by a driven body gives a light body twice that speed. The factor three
        covers light bodies hit by heavy falling bodies.
        """
        highest = max((body.heights_m[1] for body in self.bodies), default=0.0)
        drop = max(highest - self.floor_height_m, 0.1)
        fallen = math.sqrt(
            2.0 * self.gravity_m_per_s2 * drop + self._start_speed_m_per_s**2
        )
        return 3.0 * fallen + 2.0 * self._driven_speed_m_per_s

    @cached_property
    def _driven_speed_m_per_s(self) -> float:
        """Bound on the speed of a point of a driven body [m/s]."""
        return max(
            (
                driver.speed_limit_m_per_s(self.body(driver.body))
                for driver in self.drivers
            ),
            default=0.0,
        )

    @cached_property
    def _start_speed_m_per_s(self) -> float:
        """Highest start speed of a point of a dynamic body [m/s]."""
        return max(
            (_point_speed_m_per_s(body) for body in self.dynamic_bodies), default=0.0
        )


def _point_speed_m_per_s(body: RigidBody) -> float:
    radius_m = np.linalg.norm(body.shape.corners_m, axis=1).max()
    linear, angular = body.linear_velocity_m_per_s, body.angular_velocity_rad_per_s
    return float(np.linalg.norm(linear) + np.linalg.norm(angular) * radius_m)
