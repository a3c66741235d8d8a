"""Common parts of the writer and the reader of USD layers: names, records of written values, velocities, hinges."""

import hashlib
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Usd
from scipy.spatial.transform import Rotation

from gauge_envs.scene import (
    Cloth,
    Deformable,
    Pose,
    Rod,
    Rope,
    Shape,
    SoftBody,
    Vector,
    mass_properties,
)
from gauge_envs.scene.geometry import FloatArray

WRITTEN = "written"
"""Custom data key of a `gauge:` attribute with the written value of its standard counterpart: a number, a vector, a
token, or the digest of an array."""

FOLLOWS = "follows"
"""Custom data key of a derived attribute with the names of the `gauge:` attributes to edit instead."""

TEXT = "text"
"""Custom data key of `gauge:driver` with the digest of its written motions."""

KINDS: dict[type[Deformable], str] = {
    Cloth: "cloth",
    SoftBody: "soft_body",
    Rope: "rope",
    Rod: "rod",
}
"""Values of `gauge:kind`."""

OMNI_MATERIAL = {
    "thickness_m": "surfaceThickness",
    "young_modulus_pa": "youngsModulus",
    "poisson_ratio": "poissonsRatio",
}
"""Attributes of Omniverse's deformable material, by the constants of a body that they hold in single precision."""

VELOCITIES = ("linear_velocity_m_per_s", "angular_velocity_rad_per_s")
"""Fields of a rigid body for its start velocities, and names of the doubles."""

ARMS = ("torsion_m", "rolling_m")
"""Fields of a contact that UsdPhysics lacks, written if they are not zero."""

AIR_KINDS = {"wind_m_per_s": "double3"}
"""Type in USD of the fields of the air that are not doubles."""

MARKER_INDICES = {"faces": (-1, 3), "lines": (-1, 2), "corner": (-1,), "edge": (-1,)}
"""Shape of each kind of marker indices; -1 stands for any length."""

DIGEST_DECIMALS = 9
"""Number of decimals in digests, so that the last digit of a sine, which differs between machines, has no effect."""


def as_array(value: Any) -> FloatArray:
    """Return a value of USD as numbers; a quaternion is w, x, y, z.

    Raises:
        TypeError, ValueError: The value is not numeric.
    """
    if isinstance(value, Gf.Quatd | Gf.Quatf | Gf.Quath):
        value = (value.GetReal(), *value.GetImaginary())
    return np.array(value, dtype=np.float64)


# --- records of written values ---------------------------------------------------------------------------------------


def digest(values: ArrayLike) -> str:
    """Return a short hash of numbers and their shape, rounded to nine decimals (m, rad, ...)."""
    # Adding zero turns -0.0 into 0.0.
    rounded = np.round(np.asarray(values, dtype=np.float64), DIGEST_DECIMALS) + 0.0
    return _hash(repr(rounded.shape).encode() + rounded.astype("<f8").tobytes())


def motions_digest(text: str) -> str:
    """Return a short hash of JSON, whose numbers are rounded as in `digest`."""
    rounded = json.loads(
        text, parse_float=lambda number: round(float(number), DIGEST_DECIMALS)
    )
    return _hash(json.dumps(rounded).encode())


def samples_digest(times_s: ArrayLike, poses: FloatArray) -> str:
    """Return a short hash of poses at times; both quaternions of a rotation have the same hash.

    Args:
        times_s: Shape [sample_count].
        poses: Position [m] and quaternion w, x, y, z, shape [sample_count, 7].
    """
    rotations = Rotation.from_quat(poses[:, 3:], scalar_first=True)
    matrices = rotations.as_matrix().reshape(-1, 9)
    return digest(np.column_stack([times_s, poses[:, :3], matrices]))


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def record_follower(attribute: Usd.Attribute, source: str) -> None:
    """Record that an attribute is computed from other attributes, so that the reader detects an edit.

    Args:
        attribute: The attribute, with its value.
        source: Names of the attributes that it is computed from.
    """
    value = attribute.Get()
    attribute.SetCustomDataByKey(
        WRITTEN, value if isinstance(value, float) else digest(value)
    )
    attribute.SetCustomDataByKey(FOLLOWS, source)


# --- velocities ------------------------------------------------------------------------------------------------------


def body_velocities(pose: Pose, shape: Shape, velocities: FloatArray) -> FloatArray:
    """Return the velocities of UsdPhysics for the velocities of a scene.

    UsdPhysics gives the velocities of a rigid body "in the same space as the node's xform" (schema of
    `PhysicsRigidBodyAPI`), which its overview calls local space. Units are distance/second and degrees/second. It does
    not define the point of the body. Newton's importer uses the axes of the body frame and the velocity of the centre
    of mass, and so does this package. The `gauge:` doubles refer to the body origin in the world frame.

    Args:
        pose: Pose of the body.
        shape: Its shape, of uniform density.
        velocities: Velocity of the body origin [m/s] and angular velocity [rad/s] in the world frame, shape [2, 3].

    Returns:
        Velocity of the centre of mass [m/s] and angular velocity [deg/s] in the body frame, shape [2, 3].
    """
    centre_m, _ = mass_properties(shape, 1.0)
    linear, angular = pose.rotation.apply(velocities, inverse=True)
    return np.array([linear + np.cross(angular, centre_m), np.degrees(angular)])


# --- hinges ----------------------------------------------------------------------------------------------------------


def hinge_frame(axis: Vector) -> Gf.Quatf:
    """Return the orientation whose x axis is a hinge's world axis."""
    return Gf.Quatf(Gf.Rotation(Gf.Vec3d(1.0, 0.0, 0.0), Gf.Vec3d(*axis)).GetQuat())


def hinge_axis(quaternion: FloatArray, letter: str = "X") -> FloatArray:
    """Return the direction of an axis of an orientation w, x, y, z, shape [3]."""
    axes = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return axes[:, "XYZ".index(letter)]
