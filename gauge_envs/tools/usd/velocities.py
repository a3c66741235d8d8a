"""Start velocities of bodies in USD layers.

UsdPhysics states the velocities of a rigid body "in the same space as the node's xform", in distance/second and
degrees/second (schema of `PhysicsRigidBodyAPI`), which its overview calls local space. It does not state the point of
the body. Newton's importer takes the axes of the body's own frame and the velocity of the centre of mass, and so does
this package. The `gauge:` doubles are those of the scene: of the body origin, in the world frame.
"""

import numpy as np
from pxr import Usd, UsdPhysics

from gauge_envs.scene import Pose, Shape, mass_properties
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.usd.layer import VELOCITIES
from gauge_envs.tools.usd.source import Source, StoredValue, single


def body_velocities(pose: Pose, shape: Shape, velocities: FloatArray) -> FloatArray:
    """Return the velocities of UsdPhysics for those of a scene.

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


def read_velocities(
    source: Source, prim: Usd.Prim, axes: Pose, pose: Pose, shape: Shape
) -> list[FloatArray]:
    """Return the start velocities of a dynamic body: of doubles and standard attributes, the edited ones.

    Args:
        source: The stage.
        prim: Prim of the body.
        axes: Pose of the prim at the start.
        pose: Pose of the body in the scene, which may differ from that of the prim.
        shape: Shape of the body.

    Returns:
        Velocity of the body origin [m/s] and angular velocity [rad/s] in the world frame.

    Raises:
        AssetError: Doubles and standard attributes were edited and differ.
    """
    rest = np.zeros(3)
    api = UsdPhysics.RigidBodyAPI(prim)
    attributes = [api.GetVelocityAttr(), api.GetAngularVelocityAttr()]
    doubles = [prim.GetAttribute(f"gauge:{name}") for name in VELOCITIES]
    vectors = [source.numbers(one, (3,)) for one in (*attributes, *doubles)]
    numbers = np.array([rest if values is None else values for values in vectors])
    standard, exact = numbers[:2] * [[source.metres], [1.0]], numbers[2:]
    spin = axes.rotation.apply(np.radians(standard[1]))
    arm_m = pose.rotation.apply(mass_properties(shape, 1.0)[0])
    world = [axes.rotation.apply(standard[0]) - np.cross(spin, arm_m), spin]
    velocities = []
    for double, attribute, value in zip(doubles, attributes, world, strict=True):
        stored = StoredValue(attribute.GetPath(), standard, value)
        is_stated = any(one.HasAuthoredValue() for one in attributes)
        velocity = source.edited(
            double,
            [stored if is_stated else None],
            (3,),
            rounded=lambda _: single(body_velocities(pose, shape, exact)),
        )
        velocities.append(rest if velocity is None else velocity)
    return velocities
