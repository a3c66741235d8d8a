"""Start velocities of bodies in USD layers.

UsdPhysics states the velocities of a rigid body "in the same space as the node's xform", in distance/second and
degrees/second (schema of `PhysicsRigidBodyAPI`), which its overview calls local space. It does not state the point of
the body. Newton's importer takes the axes of the body's own frame and the velocity of the centre of mass, and so does
this package. The `gauge:` doubles beside them are those of the scene: of the body origin, in the world frame.
"""

import numpy as np
from pxr import Gf, Sdf, Usd, UsdPhysics

from gauge_envs.scene.bodies import RigidBody
from gauge_envs.scene.geometry import FloatArray, Pose, Shape
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.tools.usd.layer import WRITTEN, digest, record_written
from gauge_envs.tools.usd.source import Frame, Source, single

NAMES = ("linear_velocity_m_per_s", "angular_velocity_rad_per_s")
"""Fields of `RigidBody`, and names of the doubles."""

SAME_SINGLE = 1e-6
"""Largest difference of velocities that count as equal, relative to the largest number: that of single precision."""


def write_velocities(rigid: UsdPhysics.RigidBodyAPI, body: RigidBody) -> None:
    """Write the start velocities of a body that does not start at rest."""
    exact = np.array([getattr(body, name) for name in NAMES])
    linear, angular = _body_velocities(body.pose, body.shape, exact).tolist()
    rigid.CreateVelocityAttr(Gf.Vec3f(*linear))
    rigid.CreateAngularVelocityAttr(Gf.Vec3f(*angular))
    written = digest(
        [rigid.GetVelocityAttr().Get(), rigid.GetAngularVelocityAttr().Get()]
    )
    for name in NAMES:
        attribute = rigid.GetPrim().CreateAttribute(
            f"gauge:{name}", Sdf.ValueTypeNames.Double3, custom=True
        )
        attribute.Set(Gf.Vec3d(*getattr(body, name)))
        record_written(attribute, written)


def read_velocities(
    source: Source, prim: Usd.Prim, frame: Frame, pose: Pose, shape: Shape
) -> FloatArray:
    """Return the start velocities of a dynamic body.

    The edited ones of doubles and standard attributes count, as for other numbers.

    Args:
        source: The stage.
        prim: Prim of the body.
        frame: Frame of the prim at the start.
        pose: Pose of the body in the scene, whose frame may differ from that of the prim.
        shape: Shape of the body.

    Returns:
        Velocity of the body origin [m/s] and angular velocity [rad/s] in the world frame, shape [2, 3].
    """
    api = UsdPhysics.RigidBodyAPI(prim)
    readings = [
        source.reading(
            api.GetVelocityAttr(), (3,), lambda values: values * source.metres
        ),
        source.reading(api.GetAngularVelocityAttr(), (3,)),
    ]
    doubles = [prim.GetAttribute(f"gauge:{name}") for name in NAMES]
    stored = [source.numbers(attribute, (3,)) for attribute in doubles]
    has_doubles, has_standard = (
        any(one is not None for one in stored),
        any(one is not None for one in readings),
    )
    exact = np.array([np.zeros(3) if one is None else one for one in stored])
    if not has_standard:
        return exact
    standard = np.array([np.zeros(3) if one is None else one.value for one in readings])
    world = _world_velocities(frame.pose, pose, shape, standard)
    if not has_doubles:
        return world
    raw = np.array([np.zeros(3) if one is None else one.raw for one in readings])
    written = next(
        attribute.GetCustomDataByKey(WRITTEN) for attribute in doubles if attribute
    )
    rounded = single(_body_velocities(pose, shape, exact))
    if (
        digest(raw) == written
        or np.abs(rounded - raw).max() <= SAME_SINGLE * np.abs(raw).max()
    ):
        return exact
    if digest(rounded) == written:
        return world
    raise source.fault(
        prim,
        f"its gauge: velocities give physics:velocity {rounded[0].tolist()} m/s and physics:angularVelocity "
        f"{rounded[1].tolist()} deg/s, but these are {raw[0].tolist()} and {raw[1].tolist()}: make them agree, or "
        "delete the first",
    )


def _body_velocities(pose: Pose, shape: Shape, velocities: FloatArray) -> FloatArray:
    """Return the velocities of UsdPhysics for those of a scene.

    Args:
        pose: Pose of the body.
        shape: Its shape, of uniform density.
        velocities: Velocity of the body origin [m/s] and angular velocity [rad/s] in the world frame, shape [2, 3].

    Returns:
        Velocity of the centre of mass [m/s] and angular velocity [deg/s] in the body frame, shape [2, 3].
    """
    linear, angular = pose.rotation.apply(velocities, inverse=True)
    return np.array(
        [
            linear + np.cross(angular, mass_properties(shape, 1.0)[0]),
            np.degrees(angular),
        ]
    )


def _world_velocities(
    prim: Pose, pose: Pose, shape: Shape, velocities: FloatArray
) -> FloatArray:
    """Return velocities of a scene: the inverse of `_body_velocities`, for axes of the prim's own pose."""
    linear, angular = prim.rotation.apply([velocities[0], np.radians(velocities[1])])
    return np.array(
        [
            linear
            - np.cross(angular, pose.rotation.apply(mass_properties(shape, 1.0)[0])),
            angular,
        ]
    )
