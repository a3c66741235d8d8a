"""Poses and shapes in SI units. The `kind` of a shape is its name in files."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, MinLen
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Vector = tuple[float, float, float]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

# Bounds of numbers. Pydantic checks them when it reads a file; a constructor called by code does not.
Positive = Annotated[float, Gt(0.0)]
NonNegative = Annotated[float, Ge(0.0)]


def vector(values: ArrayLike) -> Vector:
    """Return an array of three numbers as a tuple."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return x, y, z


def length_of(values: ArrayLike) -> float:
    """Return the Euclidean length of a vector, or the root of the sum of squares of all entries of an array."""
    return float(np.linalg.norm(values))


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Position [m] and orientation (unit quaternion w, x, y, z) of a body frame in the world."""

    position_m: Vector
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    @classmethod
    def from_euler_deg(cls, position_m: Vector, euler_deg: Vector) -> Pose:
        """Return the pose of rotations about the fixed x, then y, then z axis [deg], as in the metadata of trials."""
        quaternion = np.array([1.0, 0.0, 0.0, 0.0])
        for axis, angle_deg in enumerate(euler_deg):
            half_rad = 0.5 * math.radians(angle_deg)
            rotation = np.array([math.cos(half_rad), 0.0, 0.0, 0.0])
            rotation[1 + axis] = math.sin(half_rad)
            quaternion = quaternion_products(rotation, quaternion)
        w, x, y, z = quaternion.tolist()
        return cls(position_m=position_m, quaternion=(w, x, y, z))

    @classmethod
    def from_rotation(cls, position_m: Vector, rotation: Rotation) -> Pose:
        """Return the pose with a position [m] and a SciPy rotation, body to world."""
        w, x, y, z = rotation.as_quat(scalar_first=True).tolist()
        return cls(position_m=position_m, quaternion=(w, x, y, z))

    @classmethod
    def of_state(cls, state: FloatArray) -> Pose:
        """Return the pose at the head of a state: position [m] and quaternion w, x, y, z, shape [7] or more."""
        x, y, z, qw, qx, qy, qz = state[:7].tolist()
        return cls(position_m=(x, y, z), quaternion=(qw, qx, qy, qz))

    @cached_property
    def rotation(self) -> Rotation:
        """Orientation as a SciPy rotation, body to world."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternion, scalar_first=True)

    @cached_property
    def matrix(self) -> FloatArray:
        """Rotation matrix, body to world, shape [3, 3]."""
        return rotation_matrices(unit_quaternions(np.array(self.quaternion)))

    def relative_to(self, other: Pose) -> Pose:
        """Return this pose in the frame of another one."""
        rotation = other.rotation.inv() * self.rotation
        return Pose.from_rotation(vector(other.to_body(self.position_m)), rotation)

    def to_world(self, points_m: ArrayLike) -> FloatArray:
        """Return body-frame points [m], shape [..., 3], in world coordinates."""
        return np.asarray(points_m) @ self.matrix.T + np.asarray(self.position_m)

    def to_body(self, points_m: ArrayLike) -> FloatArray:
        """Return world points [m], shape [..., 3], in body coordinates."""
        return (np.asarray(points_m) - np.asarray(self.position_m)) @ self.matrix


# SciPy's `Rotation` has the same terms in the same order, but its import takes as long as making an environment.


def _components(quaternions: FloatArray) -> Any:
    """Return w, x, y, z: of one quaternion as floats, which are faster than NumPy scalars; of many as arrays."""
    return quaternions.tolist() if quaternions.ndim == 1 else quaternions.T


def quaternion_products(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the rotations q followed by p, each w, x, y, z, shape [4] or [count, 4]."""
    pw, px, py, pz = _components(p)
    qw, qx, qy, qz = _components(q)
    w = pw * qw - px * qx - py * qy - pz * qz
    x = pw * qx + qw * px + (py * qz - pz * qy)
    y = pw * qy + qw * py + (pz * qx - px * qz)
    z = pw * qz + qw * pz + (px * qy - py * qx)
    return np.array([w, x, y, z]).T


def unit_quaternions(quaternions: FloatArray) -> FloatArray:
    """Return quaternions w, x, y, z over their lengths, shape [4] or [count, 4]."""
    w, x, y, z = _components(quaternions)
    return (quaternions.T / np.sqrt(x * x + y * y + z * z + w * w)).T


def vector_quaternions(vectors_rad: FloatArray) -> FloatArray:
    """Return the quaternions w, x, y, z of rotation vectors [rad], shape [count, 4]."""
    angles = np.linalg.norm(vectors_rad, axis=1, keepdims=True)
    # sin(angle / 2) / angle; NumPy's sinc is sin(pi x) / (pi x).
    scales = 0.5 * np.sinc(0.5 * angles / np.pi)
    return np.hstack([np.cos(0.5 * angles), scales * vectors_rad])


def quaternion_vectors(quaternions: FloatArray) -> FloatArray:
    """Return the rotation vectors [rad] of at most half a turn of unit quaternions w, x, y, z, shape [count, 3]."""
    shorter = np.where(quaternions[:, :1] < 0.0, -quaternions, quaternions)
    cosines, axes = shorter[:, 0], shorter[:, 1:]
    sines = np.sqrt((axes * axes).sum(axis=1))
    # Without a rotation, the axis is 0.
    scales = 2.0 * np.arctan2(sines, cosines) / np.maximum(sines, 1e-300)
    return np.asarray(scales[:, None] * axes)


def rotation_matrices(quaternions: FloatArray) -> FloatArray:
    """Return the matrices of unit quaternions w, x, y, z, shape [3, 3] or [count, 3, 3]."""
    w, x, y, z = _components(quaternions)
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    xw, yw, zw = x * w, y * w, z * w
    rows = [
        [xx - yy - zz + ww, 2 * (xy - zw), 2 * (xz + yw)],
        [2 * (xy + zw), yy - xx - zz + ww, 2 * (yz - xw)],
        [2 * (xz - yw), 2 * (yz + xw), zz - (xx + yy) + ww],
    ]
    matrices = np.array(rows)
    return matrices if matrices.ndim == 2 else matrices.transpose(2, 0, 1).copy()


CORNER_SIGNS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
"""Sides of a box on which its corners lie, shape [8, 3]."""


def _box_corners_m(*half_edges_m: float) -> FloatArray:
    """Return the corners of a box about the origin from half of its edges along x, y, z [m], shape [8, 3]."""
    return CORNER_SIGNS * np.array(half_edges_m)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Box centred on the body origin; edge lengths [m] along body x, y, z."""

    kind: Literal["box"] = field(default="box", repr=False)
    size_m: tuple[Positive, Positive, Positive]

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return float(np.prod(self.size_m))

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners in the body frame [m], shape [8, 3]."""
        return _box_corners_m(*(0.5 * edge for edge in self.size_m))


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """Sphere centred on the body origin."""

    kind: Literal["sphere"] = field(default="sphere", repr=False)
    radius_m: Positive

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return 4.0 / 3.0 * np.pi * self.radius_m**3

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners of the bounding box in the body frame [m], shape [8, 3]."""
        return _box_corners_m(self.radius_m, self.radius_m, self.radius_m)


@dataclass(frozen=True, kw_only=True)
class Cylinder:
    """Solid cylinder centred on the body origin, axis along body z."""

    kind: Literal["cylinder"] = field(default="cylinder", repr=False)
    radius_m: Positive
    length_m: Positive

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return np.pi * self.radius_m**2 * self.length_m

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners of the bounding box in the body frame [m], shape [8, 3]."""
        return _box_corners_m(self.radius_m, self.radius_m, 0.5 * self.length_m)


@dataclass(frozen=True, kw_only=True)
class Plane:
    """Half-space below the body's x-y plane; body z is the outward normal."""

    kind: Literal["plane"] = field(default="plane", repr=False)

    @property
    def volume_m3(self) -> float:
        """Zero, since a plane is not a solid."""
        return 0.0

    @cached_property
    def corners_m(self) -> FloatArray:
        """The body origin, shape [1, 3]."""
        return np.zeros((1, 3))


@dataclass(frozen=True, kw_only=True)
class ConvexUnion:
    """Solid of convex pieces that touch but do not overlap; it represents every polyhedron exactly.

    Attributes:
        kind: Name of the shape in files.
        pieces_m: Vertices of each piece in the body frame [m].
    """

    kind: Literal["convex_union"] = field(default="convex_union", repr=False)
    pieces_m: Annotated[tuple[tuple[Vector, ...], ...], MinLen(1)]

    @cached_property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        from scipy.spatial import ConvexHull

        return float(
            sum(ConvexHull(np.asarray(piece)).volume for piece in self.pieces_m)
        )

    @cached_property
    def corners_m(self) -> FloatArray:
        """All vertices in the body frame [m], shape [vertex_count, 3]."""
        return np.concatenate([np.asarray(piece) for piece in self.pieces_m])


@dataclass(frozen=True, kw_only=True)
class Capsule:
    """Cylinder with a hemisphere at each end, centred on the origin, axis along z; only a part of a `Compound`.

    Attributes:
        radius_m: Radius [m].
        length_m: Length of the cylinder, without the hemispheres [m].
    """

    radius_m: Positive
    length_m: Positive

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return np.pi * self.radius_m**2 * (self.length_m + 4.0 / 3.0 * self.radius_m)

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners of the bounding box in the frame of the capsule [m], shape [8, 3]."""
        half_length_m = 0.5 * self.length_m + self.radius_m
        return _box_corners_m(self.radius_m, self.radius_m, half_length_m)


@dataclass(frozen=True, kw_only=True)
class Ellipsoid:
    """Ellipsoid centred on the origin, half-axes [m] along x, y, z; only a part of a `Compound`."""

    radii_m: tuple[Positive, Positive, Positive]

    @property
    def volume_m3(self) -> float:
        """Volume [m^3]."""
        return 4.0 / 3.0 * np.pi * float(np.prod(self.radii_m))

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners of the bounding box in the frame of the ellipsoid [m], shape [8, 3]."""
        return _box_corners_m(*self.radii_m)


PartShape = Box | Sphere | Cylinder | Capsule | Ellipsoid | ConvexUnion


@dataclass(frozen=True, kw_only=True)
class Part:
    """One solid of a `Compound`, with its pose in the body frame."""

    shape: PartShape
    pose: Pose


@dataclass(frozen=True, kw_only=True)
class Compound:
    """Rigid assembly of solids that share one density; parts may be apart.

    It describes feet of robots: capsules and spheres in several places. No task file has this shape.
    """

    parts: tuple[Part, ...]

    @cached_property
    def volume_m3(self) -> float:
        """Volume of all parts [m^3]; overlaps count twice."""
        return float(sum(part.shape.volume_m3 for part in self.parts))

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners of all parts in the body frame [m], shape [corner_count, 3]."""
        return np.concatenate(
            [part.pose.to_world(part.shape.corners_m) for part in self.parts]
        )


Shape = Box | Sphere | Cylinder | Plane | ConvexUnion | Compound


def pose_distance(first: Pose, second: Pose) -> float:
    """Return the larger of the distance between the origins of two poses [m] and the angle between them [rad].

    The angle is twice the chord between quaternions, which is exact for small angles.
    """
    distance = np.linalg.norm(np.subtract(first.position_m, second.position_m))
    # Take the closer of the two quaternions of a rotation. An arc cosine would lose half the digits.
    chord = min(
        np.linalg.norm(np.subtract(first.quaternion, np.multiply(s, second.quaternion)))
        for s in (1.0, -1.0)
    )
    return float(max(distance, 2.0 * chord))
