"""A Rapier world of a scene: bodies, colliders and joints."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import rapier3d as rapier
from scipy.spatial.transform import Rotation

from gauge_envs.backends.rapier.contacts import ColliderLayer, collider_layers
from gauge_envs.backends.rapier.settings import SettingsRapier
from gauge_envs.backends.shared.rigid import hinge_frame
from gauge_envs.errors import BackendError
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Cylinder,
    Hinge,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Scene,
    Shape,
    Sphere,
    Tether,
)
from gauge_envs.scene.geometry import FloatArray, Vector, vector
from gauge_envs.scene.meshes import body_mass_properties

MASS_UNIT_KG = 1e-3
"""Mass of a mass unit in Rapier [kg]. Rapier adds the inertias of a body and its colliders. The principal axes of the
sum are wrong for moments near 1e-5, as light bodies have in kg m^2, so masses are in grams."""

UP_TO_Y = Rotation.from_euler("x", 90, degrees=True)
"""Rotation from the axis y of Rapier's cylinders to the axis z of a scene's cylinders."""


class PlacedBody(NamedTuple):
    """A body that moves.

    Attributes:
        handle: Rapier's handle of it.
        centre_m: Centre of mass in the body frame [m].
    """

    handle: rapier.RigidBodyHandle
    centre_m: Vector


def build_world(
    scene: Scene, settings: SettingsRapier
) -> tuple[rapier.PhysicsWorld, dict[str, PlacedBody]]:
    """Return a world with the bodies of a scene at rest, and its moving bodies by name."""
    world = rapier.PhysicsWorld(gravity=(0.0, 0.0, -scene.gravity_m_per_s2))
    _set_parameters(world.integration_parameters, settings)
    layers = collider_layers(scene)
    moving: dict[str, PlacedBody] = {}
    for body in scene.bodies:
        builder, centre_m = _body_builder(body, settings)
        colliders = [
            collider
            for layer in layers[body.name]
            for collider in _colliders(body.shape, layer)
        ]
        handle = world.add_body(builder, colliders)
        if body.motion is not Motion.FIXED:
            moving[body.name] = PlacedBody(handle, centre_m)
    for joint in scene.joints:
        handle = moving[joint.body].handle
        if isinstance(joint, Hinge):
            _add_hinge(world, joint, scene.body(joint.body), handle, settings)
        else:
            _add_string(world, joint, handle)
    return world, moving


def _set_parameters(parameters: Any, settings: SettingsRapier) -> None:
    """Set the parameters of a world, in Rapier's names."""
    friction_model = getattr(rapier.FrictionModel, settings.friction_model.upper())
    values = {
        "dt": settings.timestep_s,
        "length_unit": 1.0,
        "num_solver_iterations": settings.solver_iterations,
        "num_internal_pgs_iterations": settings.pgs_iterations,
        "num_internal_stabilization_iterations": settings.stabilization_iterations,
        "friction_model": friction_model,
        "contact_softness": rapier.SpringCoefficients(
            settings.contact_frequency_hz, settings.contact_damping_ratio
        ),
        "static_contact_softness": rapier.SpringCoefficients(
            settings.static_contact_frequency_hz, settings.static_contact_damping_ratio
        ),
        "normalized_allowed_linear_error": settings.allowed_linear_error_m,
        "normalized_max_corrective_velocity": settings.max_corrective_velocity_m_per_s,
        "normalized_prediction_distance": settings.prediction_distance_m,
        "contact_clustering": settings.contact_clustering,
        "contact_recycling": settings.contact_recycling,
        "normalized_contact_recycle_distance": settings.recycle_distance_m,
        "warmstart_coefficient": settings.warmstart_coefficient,
        "warmstart_joints": settings.warmstart_joints,
        "friction_in_bias_pass": settings.friction_in_bias_pass,
        "normalized_max_linear_velocity": settings.max_linear_velocity_m_per_s,
    }
    for name, value in values.items():
        setattr(parameters, name, value)


def _body_builder(
    body: RigidBody, settings: SettingsRapier
) -> tuple[rapier.RigidBodyBuilder, Vector]:
    """Return the builder of a body without colliders, and its centre of mass in the body frame [m]."""
    place, origin = isometry(body.pose), (0.0, 0.0, 0.0)
    if body.motion is Motion.FIXED:
        return rapier.RigidBody.fixed().position(place), origin
    if body.motion is Motion.KINEMATIC:
        return rapier.RigidBody.kinematic_velocity_based().position(place), origin
    centre_m, inertia = body_mass_properties(body)
    builder = (
        rapier.RigidBody.dynamic()
        .position(place)
        .additional_mass_properties(_rapier_mass(body.mass_kg, centre_m, inertia))
        .gyroscopic_forces(True)
        .can_sleep(settings.sleep)
        .ccd_enabled(settings.ccd)
    )
    return builder, vector(centre_m)


def _rapier_mass(
    mass_kg: float, centre_m: FloatArray, inertia: FloatArray
) -> rapier.MassProperties:
    moments, axes = np.linalg.eigh(inertia / MASS_UNIT_KG)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    frame = tuple(Rotation.from_matrix(axes).as_quat())
    return rapier.MassProperties(
        tuple(centre_m), mass_kg / MASS_UNIT_KG, tuple(moments), frame
    )


def isometry(pose: Pose) -> rapier.Isometry3:
    """Return a pose in Rapier's type, whose quaternion is x, y, z, w."""
    w, x, y, z = pose.quaternion
    return rapier.Isometry3(tuple(pose.position_m), (x, y, z, w))


def _colliders(shape: Shape, layer: ColliderLayer) -> Iterator[rapier.ColliderBuilder]:
    """Yield the colliders of a shape for one contact. They have no mass, because the body has it."""
    groups = rapier.InteractionGroups(
        rapier.Group.from_bits(layer.memberships),
        rapier.Group.from_bits(layer.filter),
        rapier.InteractionTestMode.AND,
    )
    for builder in _shapes(shape):
        yield (
            builder.density(0.0)
            .friction(layer.friction)
            .restitution(layer.restitution)
            .friction_combine_rule(rapier.CoefficientCombineRule.AVERAGE)
            .restitution_combine_rule(rapier.CoefficientCombineRule.AVERAGE)
            .collision_groups(groups)
        )


def _shapes(shape: Shape) -> Iterator[rapier.ColliderBuilder]:
    """Yield the colliders of a shape; a union has one for each piece."""
    if isinstance(shape, Box):
        yield rapier.Collider.cuboid(*(0.5 * edge for edge in shape.size_m))
    elif isinstance(shape, Sphere):
        yield rapier.Collider.ball(shape.radius_m)
    elif isinstance(shape, Plane):
        yield rapier.Collider.halfspace((0.0, 0.0, 1.0))
    elif isinstance(shape, Cylinder):
        turned = tuple(UP_TO_Y.as_rotvec())
        yield rapier.Collider.cylinder(0.5 * shape.length_m, shape.radius_m).rotation(
            turned
        )
    elif isinstance(shape, ConvexUnion):
        for piece in shape.pieces_m:
            yield rapier.Collider.convex_hull(np.asarray(piece, dtype=np.float32))


def _add_string(
    world: rapier.PhysicsWorld, string: Tether, handle: rapier.RigidBodyHandle
) -> None:
    """Add a string from a new fixed body to the origin of a body."""
    builder = rapier.RigidBody.fixed().translation(string.anchor_m)
    anchor = world.add_body(builder)
    joint = rapier.RopeJointBuilder(string.length_m)
    joint = joint.local_anchor1((0, 0, 0)).local_anchor2((0, 0, 0))
    world.impulse_joints.insert(anchor, handle, joint.build())


def _add_hinge(
    world: rapier.PhysicsWorld,
    hinge: Hinge,
    body: RigidBody,
    handle: rapier.RigidBodyHandle,
    settings: SettingsRapier,
) -> None:
    """Add a hinge with a new fixed body, whose axis x is the axis of the hinge."""
    frame = hinge_frame(hinge)
    anchor = world.add_body(rapier.RigidBody.fixed().position(isometry(frame)))
    inverse = body.pose.rotation.inv()
    arm = inverse.apply(np.subtract(hinge.anchor_m, body.pose.position_m))
    in_body = rapier.Isometry3(tuple(arm), tuple((inverse * frame.rotation).as_quat()))
    revolute = rapier.GenericJointBuilder(rapier.JointAxesMask.LOCKED_REVOLUTE_AXES)
    at_anchor = revolute.local_frame1(rapier.Isometry3.identity())
    joint = at_anchor.local_frame2(in_body).build()
    if settings.hinge_joint == "impulse":
        world.impulse_joints.insert(anchor, handle, joint)
        return
    link = world.multibody_joints.insert(anchor, handle, joint)
    if link is None:
        raise BackendError(
            f"Rapier added no multibody joint for the hinge of {body.name!r}: use hinge_joint='impulse'"
        )
    chain = world.multibody_joints.multibody(link)
    chain.set_damping([settings.hinge_damping_n_m_s / MASS_UNIT_KG] * chain.ndofs)
