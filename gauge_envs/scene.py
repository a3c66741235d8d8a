"""Engine-neutral vocabulary: what a scene is made of, in SI units and the motion-capture world frame (z up).

A `Scene` is all that a backend sees. It knows shapes, masses, contact constants, joints and how driven bodies move,
and never which experiment it came from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from gauge_envs.driver import Driver

__all__ = [
    "GRAVITY_M_PER_S2",
    "Attachment",
    "Box",
    "Cloth",
    "Contact",
    "ContactMode",
    "ConvexUnion",
    "Cylinder",
    "Hinge",
    "Markers",
    "Motion",
    "Plane",
    "Pose",
    "Region",
    "RigidBody",
    "Rod",
    "Rope",
    "Scene",
    "Shape",
    "SoftBody",
    "Sphere",
    "Tether",
]

GRAVITY_M_PER_S2 = 9.80665
"""Standard gravity [m/s^2], the value that the paper uses (its dynamic-error equation)."""

Vector = tuple[float, float, float]


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
class Pose:
    """Position [m] and orientation (unit quaternion w, x, y, z) of a body frame in the world."""

    position_m: Vector
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @classmethod
    def from_euler_deg(cls, position_m: Vector, euler_deg: Vector) -> Pose:
        """Pose from rotations about the fixed x, then y, then z axis [deg], the convention of the metadata."""
        w, x, y, z = Rotation.from_euler("xyz", euler_deg, degrees=True).as_quat(scalar_first=True).tolist()
        return cls(position_m=position_m, quaternion=(w, x, y, z))

    @cached_property
    def rotation(self) -> Rotation:
        """Orientation as a SciPy rotation, body to world."""
        return Rotation.from_quat(self.quaternion, scalar_first=True)

    def to_world(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Body-frame points [m], shape [..., 3], in world coordinates."""
        return self.rotation.apply(points_m) + np.asarray(self.position_m)

    def to_body(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """World points [m], shape [..., 3], in body coordinates."""
        return self.rotation.apply(np.asarray(points_m) - np.asarray(self.position_m), inverse=True)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Box centred on the body origin; edge lengths [m] along body x, y, z."""

    size_m: Vector

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return float(np.prod(self.size_m))

    @property
    def corners_m(self) -> NDArray[np.float64]:
        """Corners in the body frame [m], shape [8, 3]."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return 0.5 * signs * np.asarray(self.size_m)


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """Sphere centred on the body origin."""

    radius_m: float

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return 4.0 / 3.0 * np.pi * self.radius_m**3

    @property
    def corners_m(self) -> NDArray[np.float64]:
        """Corners of the bounding box in the body frame [m], shape [8, 3]."""
        return Box(size_m=(2 * self.radius_m,) * 3).corners_m


@dataclass(frozen=True, kw_only=True)
class Cylinder:
    """Solid cylinder centred on the body origin, axis along body z."""

    radius_m: float
    length_m: float

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return np.pi * self.radius_m**2 * self.length_m

    @property
    def corners_m(self) -> NDArray[np.float64]:
        """Corners of the bounding box in the body frame [m], shape [8, 3]."""
        return Box(size_m=(2 * self.radius_m, 2 * self.radius_m, self.length_m)).corners_m


@dataclass(frozen=True, kw_only=True)
class Plane:
    """Half-space below the body's x-y plane; body z is the outward normal."""

    @property
    def volume_m3(self) -> float:
        """Not a solid: zero."""
        return 0.0

    @property
    def corners_m(self) -> NDArray[np.float64]:
        """The body origin, shape [1, 3]."""
        return np.zeros((1, 3))


@dataclass(frozen=True, kw_only=True)
class ConvexUnion:
    """Solid made of convex pieces that touch but do not overlap: exact for every polyhedron, concave ones included.

    Attributes:
        pieces_m: Vertices of each piece in the body frame [m].
    """

    pieces_m: tuple[tuple[Vector, ...], ...]

    @cached_property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return float(sum(ConvexHull(np.asarray(piece)).volume for piece in self.pieces_m))

    @property
    def corners_m(self) -> NDArray[np.float64]:
        """All vertices in the body frame [m], shape [vertex_count, 3]."""
        return np.concatenate([np.asarray(piece) for piece in self.pieces_m])


Shape = Box | Sphere | Cylinder | Plane | ConvexUnion


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
    """Motion-capture markers glued to deformable bodies, in the published order.

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


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything that a backend needs to build and drive one experiment.

    Attributes:
        bodies: Rigid bodies in a fixed order.
        deformables: Cloth, soft bodies, ropes and rods.
        joints: Hinges and tethers to the world.
        attachments: Glued regions of deformable bodies.
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

    @classmethod
    def from_usd(
        cls,
        path: str | Path,
        *,
        duration_s: float | None = None,
        friction: Literal["dynamic", "static"] | None = None,
        mode: ContactMode | Mapping[tuple[str, str], ContactMode] = ContactMode.SUSTAINED,
        contacts: Sequence[Contact] = (),
    ) -> Scene:
        """Read a scene from a USD file, of `to_usd` or of plain UsdPhysics.

        What `to_usd` wrote comes back exactly. Where a number was edited in such a file, in the `gauge:` double or in
        the standard attribute beside it, the edited one counts. What the keywords say matters for files of others:

        Args:
            path: File of any kind that USD reads.
            duration_s: How long the experiment lasts, where the file has neither `gauge:duration_s` nor time codes of
                start and end; it counts in place of these time codes.
            friction: Which coefficient of a material counts where static and dynamic friction differ.
            mode: What contacts do that have no `gauge:mode`: one for all, or one a pair of names, sustained for others.
            contacts: Contacts that count in place of what the file says of their pairs.

        Raises:
            AssetError: The file cannot be read, lacks something, or has what a scene has not; names file and prim.
        """
        from gauge_envs.usd.reader import read_usd

        return read_usd(path, duration_s=duration_s, friction=friction, mode=mode, contacts=contacts).scene

    def to_usd(self, path: str | Path) -> None:
        """Write the scene as one USD layer, from which `from_usd` reads it back exactly.

        Args:
            path: File to write; the suffix chooses text (`.usda`) or binary (`.usdc`, `.usd`).

        Raises:
            ParameterError: The suffix is none of USD's, or a body is named or driven twice.
            ResultFileError: The file cannot be written.
        """
        from gauge_envs.usd.writer import write_usd

        write_usd(self, Path(path))

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
