"""Rigid and deformable bodies, joints, contacts and markers of a scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Literal

from gauge_envs.errors import ParameterError
from gauge_envs.scene.geometry import Box, NonNegative, Pose, Shape, Vector
from gauge_envs.scene.motors import Motor
from gauge_envs.scene.servo_friction import ServoFriction


class Motion(StrEnum):
    """How a rigid body moves."""

    DYNAMIC = "dynamic"
    """Moves under forces."""
    FIXED = "fixed"
    """Never moves."""
    KINEMATIC = "kinematic"
    """Follows its driver, unaffected by contacts, and carries the bodies that rest on it."""


class ContactMode(StrEnum):
    """Typical behaviour of a contact, for engines without a native coefficient of restitution."""

    SUSTAINED = "sustained"
    """The bodies rest, slide or roll on each other; restitution has no effect."""
    IMPACT = "impact"
    """The bodies collide and rebound with the restitution of the pair."""


InertiaTensor = tuple[float, float, float, float, float, float]
"""Entries Ixx, Iyy, Izz, Ixy, Ixz, Iyz of a symmetric tensor."""


@dataclass(frozen=True, kw_only=True)
class RigidBody:
    """Rigid body of uniform density, unless it states its moment of inertia.

    Attributes:
        name: Unique name in the scene.
        shape: Geometry in the body frame.
        motion: Dynamic, fixed or kinematic.
        pose: World pose at the start.
        mass_kg: Mass [kg]; 0 for a plane.
        linear_velocity_m_per_s: Velocity of the body origin at the start [m/s], in the world frame. Only dynamic bodies
            have one.
        angular_velocity_rad_per_s: Angular velocity at the start [rad/s], in the world frame.
        inertia_kg_m2: Inertia about the centre of mass [kg m^2]: one moment about every axis, as that of a hollow cube,
            or the tensor in the axes of the body: Ixx, Iyy, Izz, Ixy, Ixz, Iyz. None is that of uniform density.
    """

    name: str
    shape: Shape
    motion: Motion
    pose: Pose
    mass_kg: float
    linear_velocity_m_per_s: Vector = (0.0, 0.0, 0.0)
    angular_velocity_rad_per_s: Vector = (0.0, 0.0, 0.0)
    inertia_kg_m2: float | InertiaTensor | None = None

    @property
    def starts_at_rest(self) -> bool:
        """Whether both start velocities are zero."""
        return not any(
            (*self.linear_velocity_m_per_s, *self.angular_velocity_rad_per_s)
        )

    @cached_property
    def heights_m(self) -> tuple[float, float]:
        """Least and largest height of its corners at the start [m]."""
        heights_m = self.pose.to_world(self.shape.corners_m)[:, 2].tolist()
        return min(heights_m), max(heights_m)


@dataclass(frozen=True, kw_only=True)
class Cloth:
    """Rectangular cloth in the x-y plane of its frame, warp along x, weft along y.

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
class JointDynamics:
    """Friction of a joint and inertia of its drive; a joint without any turns freely.

    Attributes:
        dry_friction_n_m: Coulomb torque [N m]: opposes the rotation, and holds the joint against less than it.
        viscous_friction_n_m_s_per_rad: Torque per rate that opposes the rotation [N m s/rad].
        armature_kg_m2: Inertia of a rotor, times its gear ratio squared, which turns with the joint [kg m^2].
        backlash_rad: Play between the rotor, which needs an armature, and what it turns [rad]. It starts in its middle
            and ends in two stops of any restitution. Friction and motor act on the rotor; a servo measures its angle.
        quadratic_friction_n_m_s2_per_rad2: Torque per squared rate, as of air, that opposes it [N m s^2/rad^2].
        servo: What the dry friction of a servo's joint gains with load and loses with its rate.
    """

    dry_friction_n_m: NonNegative = 0.0
    viscous_friction_n_m_s_per_rad: NonNegative = 0.0
    armature_kg_m2: NonNegative = 0.0
    # Hashes and prints of joints without play stay.
    backlash_rad: NonNegative = field(default=0.0, repr=False)
    quadratic_friction_n_m_s2_per_rad2: NonNegative = field(default=0.0, repr=False)
    servo: ServoFriction | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.backlash_rad and not self.armature_kg_m2:
            raise ParameterError(
                "a joint with backlash_rad needs armature_kg_m2: state the inertia of its rotor"
            )


@dataclass(frozen=True, kw_only=True)
class Hinge:
    """Joint with which a body rotates about a world axis through a world point.

    Attributes:
        body: Name of a dynamic body.
        anchor_m: World position of a point of the axis [m].
        axis: World direction of the axis, a unit vector. A positive angle rotates the body about it.
        dynamics: Friction and inertia of the joint.
        motor: Motor of the joint, if any.
        limits_rad: Smallest and largest angle from the start, where the joint stops [rad]; None for none.
    """

    body: str
    anchor_m: Vector
    axis: Vector
    # Hashes of scenes whose joints have none stay.
    dynamics: JointDynamics = field(default=JointDynamics(), repr=False)
    motor: Motor | None = field(default=None, repr=False)
    limits_rad: tuple[float, float] | None = field(default=None, repr=False)


@dataclass(frozen=True, kw_only=True)
class BodyHinge:
    """Joint with which two dynamic bodies rotate about a common axis, relative to each other.

    The two bodies do not collide with each other. One body of those that hinges join may have a `Hinge` to the world.

    Attributes:
        first: Name of a dynamic body.
        second: Name of the other one. A positive angle of the hinge rotates it about the axis, relative to the first.
        anchor_m: World position of a point of the axis at the start [m]; it is fixed in both bodies.
        axis: World direction of the axis at the start, a unit vector; it is fixed in both bodies.
        dynamics: Friction and inertia of the joint.
        motor: Motor of the joint, if any.
    """

    first: str
    second: str
    anchor_m: Vector
    axis: Vector
    dynamics: JointDynamics = field(default=JointDynamics(), repr=False)
    motor: Motor | None = field(default=None, repr=False)


@dataclass(frozen=True, kw_only=True)
class Tether:
    """Inextensible massless string from a world point to a body's origin, which only pulls."""

    body: str
    anchor_m: Vector
    length_m: float


@dataclass(frozen=True, kw_only=True)
class Slider:
    """Joint with which a body moves along a world axis, without rotation and friction.

    Attributes:
        body: Name of a dynamic body.
        axis: World direction of the axis, a unit vector.
        limits_m: Smallest and largest displacement from the start, where the joint stops [m]; None for none.
    """

    body: str
    axis: Vector
    limits_m: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class BallJoint:
    """Joint with which a body rotates freely about a world point, without friction.

    Attributes:
        body: Name of a dynamic body.
        anchor_m: The point [m].
    """

    body: str
    anchor_m: Vector


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
    # Hashes of scenes whose contacts have none stay.
    torsion_m: NonNegative = field(default=0.0, repr=False)
    rolling_m: NonNegative = field(default=0.0, repr=False)


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
