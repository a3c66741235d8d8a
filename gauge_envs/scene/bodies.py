"""Rigid and deformable bodies, joints, contacts and markers of a scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Literal

from gauge_envs.scene.geometry import Box, NonNegative, Pose, Shape, Vector


class Motion(StrEnum):
    """How a rigid body moves."""

    DYNAMIC = "dynamic"
    """Moves under forces."""
    FIXED = "fixed"
    """Never moves."""
    KINEMATIC = "kinematic"
    """Follows its driver, is not affected by contacts, and carries the bodies that rest on it."""


class ContactMode(StrEnum):
    """Typical behaviour of a contact, for engines without a native coefficient of restitution."""

    SUSTAINED = "sustained"
    """The bodies rest, slide or roll on each other; restitution has no effect."""
    IMPACT = "impact"
    """The bodies collide and rebound with the restitution of the pair."""


@dataclass(frozen=True, kw_only=True)
class RigidBody:
    """Rigid body of uniform density, unless `inertia_kg_m2` is given.

    Attributes:
        name: Unique name in the scene.
        shape: Geometry in the body frame.
        motion: Dynamic, fixed or kinematic.
        pose: World pose at the start.
        mass_kg: Mass [kg]; 0 for a plane.
        linear_velocity_m_per_s: Velocity of the body origin at the start [m/s], in the world frame; only for dynamic
            bodies.
        angular_velocity_rad_per_s: Angular velocity at the start [rad/s], in the world frame.
        inertia_kg_m2: Moment of inertia about every axis through the centre of mass [kg m^2], for example of a hollow
            cube. None computes it from uniform density.
    """

    name: str
    shape: Shape
    motion: Motion
    pose: Pose
    mass_kg: float
    linear_velocity_m_per_s: Vector = (0.0, 0.0, 0.0)
    angular_velocity_rad_per_s: Vector = (0.0, 0.0, 0.0)
    inertia_kg_m2: float | None = None

    @property
    def starts_at_rest(self) -> bool:
        """Whether both start velocities are zero."""
        return not any(
            (*self.linear_velocity_m_per_s, *self.angular_velocity_rad_per_s)
        )

    @cached_property
    def heights_m(self) -> tuple[float, float]:
        """Smallest and largest height of its corners at the start [m]."""
        heights_m = self.pose.to_world(self.shape.corners_m)[:, 2].tolist()
        return min(heights_m), max(heights_m)


@dataclass(frozen=True, kw_only=True)
class Cloth:
    """Rectangular cloth in the x-y plane of its frame, with the weft perpendicular to the warp.

    Attributes:
        name: Unique name in the scene.
        pose: World pose at the start.
        size_m: Edge lengths along x and y [m].
        mass_kg: Mass [kg].
        areal_density_kg_per_m2: Mass per area [kg/m^2].
        thickness_m: Physical thickness [m].
        stretch_stiffness_n_per_m: K_s, tangent stiffness per width of a uniaxial test with free transverse edges [N/m].
        shear_stiffness_n_per_m: K_sh, engineering shear stiffness per width [N/m].
        bend_stiffness_n_m_per_rad: K_theta, torque per angle of a discrete bending hinge [N m/rad].
        warp_angle_rad: Angle from x to the warp, towards y [rad]; pi/4 is a bias cut.
    """

    name: str
    pose: Pose
    size_m: tuple[float, float]
    mass_kg: float
    areal_density_kg_per_m2: float
    thickness_m: float
    stretch_stiffness_n_per_m: float
    shear_stiffness_n_per_m: float
    bend_stiffness_n_m_per_rad: float
    warp_angle_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SoftBody:
    """Isotropic elastic box of uniform density, linear in the strains of its co-rotated frame."""

    name: str
    shape: Box
    pose: Pose
    mass_kg: float
    young_modulus_pa: float
    poisson_ratio: float


@dataclass(frozen=True, kw_only=True)
class Rope:
    """Inextensible, perfectly flexible line along x of its frame."""

    name: str
    pose: Pose
    length_m: float
    radius_m: float
    mass_kg: float
    young_modulus_pa: float


@dataclass(frozen=True, kw_only=True)
class Rod:
    """Elastic rod of circular section along z of its frame, resisting stretch, bending and twist."""

    name: str
    pose: Pose
    length_m: float
    radius_m: float
    mass_kg: float
    young_modulus_pa: float
    poisson_ratio: float


@dataclass(frozen=True, kw_only=True)
class Hinge:
    """Joint without friction with which a body rotates about a world axis through a world point.

    Attributes:
        body: Name of a dynamic body.
        anchor_m: World position of a point of the axis [m].
        axis: World direction of the axis, a unit vector. A positive angle rotates the body about it.
    """

    body: str
    anchor_m: Vector
    axis: Vector


@dataclass(frozen=True, kw_only=True)
class Tether:
    """Inextensible massless string from a world point to a body's origin, which only pulls."""

    body: str
    anchor_m: Vector
    length_m: float


@dataclass(frozen=True, kw_only=True)
class Region:
    """End region of a body: all material within `depth_m` of its low or high side along a body axis."""

    axis: Literal["x", "y", "z"]
    side: Literal["low", "high"]
    depth_m: NonNegative = 0.0


@dataclass(frozen=True, kw_only=True)
class Attachment:
    """Attachment of a region of a deformable body to a rigid or another deformable body."""

    deformable: str
    region: Region
    to: str


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Constants of the contacts between two groups of bodies. Pairs without a contact pass through each other.

    Attributes:
        first: Names of the bodies in the first group.
        second: Names of the bodies in the second group, which may equal the first.
        friction: Coulomb coefficient of each pair.
        restitution: Ratio of outgoing to incoming normal speed of each pair.
        mode: Typical behaviour of the contact.
        torsion_m: Largest torque of friction about the normal, over the normal force [m].
        rolling_m: Torque against rolling, over the normal force [m].
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    friction: float
    restitution: float
    mode: ContactMode = ContactMode.SUSTAINED
    # `repr=False` keeps the hashes of scenes whose contacts have neither.
    torsion_m: NonNegative = field(default=0.0, repr=False)
    rolling_m: NonNegative = field(default=0.0, repr=False)


def friction_dimension(torsion_m: float, rolling_m: float) -> int:
    """Return the dimension of a contact: 3 with sliding friction alone, 4 with torsional, 6 with rolling friction."""
    if rolling_m:
        return 6
    if torsion_m:
        return 4
    return 3


@dataclass(frozen=True, kw_only=True)
class Markers:
    """Motion-capture markers attached to deformable bodies, in the published order.

    Attributes:
        bodies: Names of the bodies that carry markers.
        positions_m: World positions at rest [m].
        faces: Triangles of marker indices.
        lines: Pairs of neighbouring marker indices along measured lines.
        corner: Indices of markers at corners of the cloth.
        edge: Indices of markers on straight edges.
    """

    bodies: tuple[str, ...]
    positions_m: tuple[Vector, ...]
    faces: tuple[tuple[int, int, int], ...] = ()
    lines: tuple[tuple[int, int], ...] = ()
    corner: tuple[int, ...] = ()
    edge: tuple[int, ...] = ()


Deformable = Cloth | SoftBody | Rope | Rod
