"""Rigid and deformable bodies, joints, contacts and markers of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from gauge_envs.scene.geometry import Box, Pose, Shape, Vector

__all__ = [
    "Attachment",
    "Cloth",
    "Contact",
    "ContactMode",
    "Hinge",
    "Markers",
    "Motion",
    "Region",
    "RigidBody",
    "Rod",
    "Rope",
    "SoftBody",
    "Tether",
]


class Motion(StrEnum):
    """How a rigid body moves."""

    DYNAMIC = "dynamic"
    """Moves under forces."""
    FIXED = "fixed"
    """Never moves."""
    KINEMATIC = "kinematic"
    """Follows its driver whatever touches it, and carries what rests on it."""


class ContactMode(StrEnum):
    """What a contact mostly does; an engine without a native restitution coefficient may need to know."""

    SUSTAINED = "sustained"
    """Rests, slides or rolls; restitution plays no role."""
    IMPACT = "impact"
    """Collides and rebounds with the pair's restitution."""


@dataclass(frozen=True, kw_only=True)
class RigidBody:
    """Rigid body of uniform density.

    Attributes:
        name: Unique in the scene.
        shape: Geometry in the body frame.
        motion: Dynamic, fixed or kinematic.
        pose: World pose at the start.
        mass_kg: Mass; 0 for a plane.
    """

    name: str
    shape: Shape
    motion: Motion
    pose: Pose
    mass_kg: float


@dataclass(frozen=True, kw_only=True)
class Cloth:
    """Rectangular sheet in the x-y plane of its frame, warp along x, weft along y.

    Attributes:
        size_m: Edge lengths along x and y [m].
        areal_density_kg_per_m2: Mass per area.
        thickness_m: Physical thickness.
        stretch_stiffness_n_per_m: K_s, tangent stiffness per width of a uniaxial test with free transverse edges.
        shear_stiffness_n_per_m: K_sh, engineering shear stiffness per width.
        bend_stiffness_n_m_per_rad: K_theta, torque per angle of a discrete bending hinge.
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


@dataclass(frozen=True, kw_only=True)
class SoftBody:
    """Volumetric elastic solid, isotropic, of uniform density."""

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
    """Joins a body to the world: it turns about a world axis through a world point, without friction."""

    body: str
    anchor_m: Vector
    axis: Vector


@dataclass(frozen=True, kw_only=True)
class Tether:
    """Inextensible massless string from a world point to a body's origin; it only pulls."""

    body: str
    anchor_m: Vector
    length_m: float


@dataclass(frozen=True, kw_only=True)
class Region:
    """End of a body: all material within `depth_m` of its low or high side along a body axis."""

    axis: Literal["x", "y", "z"]
    side: Literal["low", "high"]
    depth_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Attachment:
    """Glues a region of a deformable body to another body, fixed, moving or deformable."""

    deformable: str
    region: Region
    to: str


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Constants of every contact between two groups of bodies; pairs in no contact pass through each other.

    Attributes:
        first: Names of the bodies on one side.
        second: Names on the other side; may be the same group.
        friction: Coulomb coefficient of the pair.
        restitution: Ratio of outgoing to incoming normal speed of the pair.
        mode: What the contact mostly does.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    friction: float
    restitution: float
    mode: ContactMode = ContactMode.SUSTAINED


@dataclass(frozen=True, kw_only=True)
class Markers:
    """Motion-capture markers attached to deformable bodies, in the published order.

    Attributes:
        bodies: Names of the bodies that carry markers.
        positions_m: World positions at rest [m].
        faces: Triangles of marker indices.
        lines: Pairs of neighbouring marker indices along measured lines.
        corner: Indices of markers at corners of the sheet.
        edge: Indices of markers on straight edges.
    """

    bodies: tuple[str, ...]
    positions_m: tuple[Vector, ...]
    faces: tuple[tuple[int, int, int], ...] = ()
    lines: tuple[tuple[int, int], ...] = ()
    corner: tuple[int, ...] = ()
    edge: tuple[int, ...] = ()


Deformable = Cloth | SoftBody | Rope | Rod
