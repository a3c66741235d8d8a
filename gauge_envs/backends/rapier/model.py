"""A Rapier world of a scene: bodies, colliders and joints."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import rapier3d as rapier
from scipy.spatial.transform import Rotation

from gauge_envs.backends.rapier.contacts import (
    ColliderLayer,
    collider_layers,
    colliding_contacts,
)
from gauge_envs.backends.rapier.settings import SettingsRapier
from gauge_envs.backends.settings import put
from gauge_envs.backends.shared.joints import (
    PlayHinge,
    drive_of,
    has_terms,
    joint_rate_rad_per_s,
    linked_hinges,
)
from gauge_envs.backends.shared.rigid import centre_velocity, guide_frame, hinge_frame
from gauge_envs.errors import BackendError
from gauge_envs.scene import (
    BallJoint,
    BodyHinge,
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
    Slider,
    Sphere,
)
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.hinged import other_end
from gauge_envs.scene.meshes import body_mass_properties

MASS_UNIT_KG = 1e-3
"""Mass of a mass unit in Rapier [kg]. Rapier adds the inertias of a body and its colliders. The principal axes of the
sum are wrong for moments near 1e-5, as light bodies have in kg m^2, so masses are in grams."""

TURN = rapier.JointAxis.ANG_X
"""Axis of every hinge in its own frame."""

UP_TO_Y = Rotation.from_euler("x", 90, degrees=True)
"""Rotation that takes the axis y of Rapier's cylinders to the axis z of a scene's."""


Layout = dict[str, tuple[rapier.RigidBodyHandle, FloatArray]]
"""Rapier's handle of each dynamic or driven body of a scene, and its centre of mass in the body frame [m], by name."""


def build_world(
    scenes: Sequence[Scene], settings: SettingsRapier
) -> tuple[rapier.PhysicsWorld, list[Layout]]:
    """Return one world with all scenes at their starts, which do not meet each other, and the layout of each scene.

    Args:
        scenes: Scenes that differ only in their starts, with at most 16 contacts in all.
        settings: Numerical settings.
    """
    world = rapier.PhysicsWorld(gravity=(0.0, 0.0, -scenes[0].gravity_m_per_s2))
    _set_parameters(world.integration_parameters, settings)
    count = len(colliding_contacts(scenes[0]))
    return world, [
        _add_scene(world, scene, index * count, settings)
        for index, scene in enumerate(scenes)
    ]


def _add_scene(
    world: rapier.PhysicsWorld,
    scene: Scene,
    first_contact: int,
    settings: SettingsRapier,
) -> Layout:
    layers = collider_layers(scene, first_contact)
    layout: Layout = {}
    for body in scene.bodies:
        builder, centre_m = _body_builder(body, settings)
        colliders = [
            collider
            for layer in layers[body.name]
            for collider in _colliders(body.shape, layer)
        ]
        handle = world.add_body(builder, colliders)
        if body.motion is not Motion.FIXED:
            layout[body.name] = handle, centre_m
    _add_joints(world, scene, layout, settings)
    for guide in scene.guides:
        _add_guide(world, scene, guide, layout[guide.body][0])
    return layout


def _add_joints(
    world: rapier.PhysicsWorld, scene: Scene, layout: Layout, settings: SettingsRapier
) -> None:
    """Add the joints of a scene, multibodies from their roots on."""
    linked = linked_hinges(scene, settings.hinge_joint == "multibody")
    for joint in scene.joints:
        body = scene.body(joint.body)
        if isinstance(joint, Hinge):
            _add_hinge(
                world,
                joint,
                body,
                layout[body.name][0],
                settings,
                is_link=body.name in linked,
            )
        else:
            anchor = world.add_body(
                rapier.RigidBody.fixed().translation(joint.anchor_m)
            )
            string = (
                rapier.RopeJointBuilder(joint.length_m)
                .local_anchor1((0, 0, 0))
                .local_anchor2((0, 0, 0))
            )
            world.impulse_joints.insert(anchor, layout[body.name][0], string.build())
    for hinge in scene.body_hinges:
        if hinge not in linked.values():
            # As a constraint: a free multibody changes its momentum by 0.1 % in 0.5 s.
            revolute = _between(scene, hinge, hinge.first, hinge.second)
            world.impulse_joints.insert(
                layout[hinge.first][0], layout[hinge.second][0], revolute
            )
    for name, hanging in linked.items():
        if isinstance(hanging, BodyHinge):
            parent = other_end(hanging, name)
            revolute = _between(scene, hanging, parent, name)
            if isinstance(hanging, PlayHinge):
                revolute.set_limits(TURN, -hanging.stop_rad, hanging.stop_rad)
            world.multibody_joints.insert(layout[parent][0], layout[name][0], revolute)
    # Links that are added later need their damping and their start rate anew.
    for name, hanging in linked.items():
        if hanging is not None and (has_terms(hanging) or scene.body_hinges):
            _set_link(world, scene, name, hanging, layout, settings)


def _set_parameters(parameters: Any, settings: SettingsRapier) -> None:
    parameters.contact_softness = rapier.SpringCoefficients(
        settings.contact_frequency_hz, settings.contact_damping_ratio
    )
    parameters.static_contact_softness = rapier.SpringCoefficients(
        settings.static_contact_frequency_hz, settings.static_contact_damping_ratio
    )
    put(
        "Rapier",
        parameters,
        dt=settings.timestep_s,
        length_unit=1.0,
        num_solver_iterations=settings.solver_iterations,
        num_internal_pgs_iterations=settings.pgs_iterations,
        num_internal_stabilization_iterations=settings.stabilization_iterations,
        friction_model=getattr(rapier.FrictionModel, settings.friction_model.upper()),
        normalized_allowed_linear_error=settings.allowed_linear_error_m,
        normalized_max_corrective_velocity=settings.max_corrective_velocity_m_per_s,
        normalized_prediction_distance=settings.prediction_distance_m,
        contact_clustering=settings.contact_clustering,
        contact_recycling=settings.contact_recycling,
        normalized_contact_recycle_distance=settings.recycle_distance_m,
        warmstart_coefficient=settings.warmstart_coefficient,
        warmstart_joints=settings.warmstart_joints,
        friction_in_bias_pass=settings.friction_in_bias_pass,
        normalized_max_linear_velocity=settings.max_linear_velocity_m_per_s,
    )


def _body_builder(
    body: RigidBody, settings: SettingsRapier
) -> tuple[rapier.RigidBodyBuilder, FloatArray]:
    """Return the builder of a body without colliders, and its centre of mass in the body frame [m]."""
    if body.motion is Motion.FIXED:
        return rapier.RigidBody.fixed().position(isometry(body.pose)), np.zeros(3)
    if body.motion is Motion.KINEMATIC:
        return rapier.RigidBody.kinematic_velocity_based().position(
            isometry(body.pose)
        ), np.zeros(3)
    centre_m, inertia = body_mass_properties(body)
    builder = (
        rapier.RigidBody.dynamic()
        .position(isometry(body.pose))
        .additional_mass_properties(_rapier_mass(body.mass_kg, centre_m, inertia))
        .linvel(tuple(centre_velocity(body, centre_m)))
        .angvel(body.angular_velocity_rad_per_s)
        .gyroscopic_forces(True)
        .can_sleep(settings.sleep)
        .ccd_enabled(settings.ccd)
    )
    return builder, centre_m


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


def link_of(
    world: rapier.PhysicsWorld, handle: rapier.RigidBodyHandle
) -> tuple[rapier.Multibody, int, int]:
    """Return the multibody of a body on a hinge, the number of its link, and the place of its freedom."""
    found = world.multibody_joints.rigid_body_link(handle)
    chain = world.multibody_joints.get_multibody(found.multibody)
    return chain, found.id, chain.get_link(found.id).assembly_id


def _set_link(
    world: rapier.PhysicsWorld,
    scene: Scene,
    name: str,
    hinge: Hinge | BodyHinge,
    layout: Layout,
    settings: SettingsRapier,
) -> None:
    """Write the start rate of a link, its friction and its armature, and its drive."""
    chain, link, row = link_of(world, layout[name][0])
    terms = hinge.dynamics
    damping = settings.hinge_damping_n_m_s + terms.viscous_friction_n_m_s_per_rad
    for values, write, value in (
        (
            chain.generalized_velocity(),
            chain.set_generalized_velocity,
            joint_rate_rad_per_s(scene, name, hinge),
        ),
        (chain.damping(), chain.set_damping, damping / MASS_UNIT_KG),
        (chain.armature(), chain.set_armature, terms.armature_kg_m2 / MASS_UNIT_KG),
    ):
        changed = list(values)
        changed[row] = value
        write(changed)
    kp, kv, limit = (value / MASS_UNIT_KG for value in drive_of(hinge))
    if kp or kv:
        chain.set_link_motor_model(link, TURN, rapier.MotorModel.FORCE_BASED)
        chain.set_link_motor(link, TURN, 0.0, 0.0, kp, kv)
        if np.isfinite(limit):
            chain.set_link_motor_max_force(link, TURN, limit)


def _add_hinge(
    world: rapier.PhysicsWorld,
    hinge: Hinge,
    body: RigidBody,
    handle: rapier.RigidBodyHandle,
    settings: SettingsRapier,
    *,
    is_link: bool,
) -> None:
    """Add a hinge with a fixed body of its own, whose axis x is that of the hinge."""
    frame = hinge_frame(hinge)
    anchor = world.add_body(rapier.RigidBody.fixed().position(isometry(frame)))
    back = body.pose.rotation.inv()
    arm = back.apply(np.subtract(hinge.anchor_m, body.pose.position_m))
    joint = _revolute(
        rapier.Isometry3.identity(),
        rapier.Isometry3(tuple(arm), tuple((back * frame.rotation).as_quat())),
    )
    if hinge.limits_rad is not None:
        joint.set_limits(TURN, *hinge.limits_rad)
    if not is_link:
        world.impulse_joints.insert(anchor, handle, joint)
        return
    link = world.multibody_joints.insert(anchor, handle, joint)
    if link is None:
        raise BackendError(
            f"Rapier added no multibody joint for the hinge of {body.name!r}: use hinge_joint='impulse'"
        )
    chain = world.multibody_joints.multibody(link)
    chain.set_damping([settings.hinge_damping_n_m_s / MASS_UNIT_KG] * chain.ndofs)
    if not body.starts_at_rest:
        speeds = np.zeros(chain.ndofs)
        speeds[-1] = np.dot(body.angular_velocity_rad_per_s, hinge.axis)
        chain.set_generalized_velocity(speeds.tolist())


def _add_guide(
    world: rapier.PhysicsWorld,
    scene: Scene,
    guide: Slider | BallJoint,
    handle: rapier.RigidBodyHandle,
) -> None:
    """Add a slider or a ball joint with a fixed body of its own."""
    frame = guide_frame(scene, guide)
    in_body = isometry(frame.relative_to(scene.body(guide.body).pose))
    anchor = world.add_body(rapier.RigidBody.fixed().position(isometry(frame)))
    axes = rapier.JointAxesMask
    is_slider = isinstance(guide, Slider)
    locked = axes.LOCKED_PRISMATIC_AXES if is_slider else axes.LOCKED_SPHERICAL_AXES
    joint = _kept_together(locked, rapier.Isometry3.identity(), in_body)
    if isinstance(guide, Slider) and guide.limits_m is not None:
        joint.set_limits(rapier.JointAxis.LIN_X, *guide.limits_m)
    world.impulse_joints.insert(anchor, handle, joint)


def _between(scene: Scene, hinge: BodyHinge, first: str, second: str) -> Any:
    """Return the joint of a hinge between two bodies."""
    frame = hinge_frame(hinge)
    in_first = frame.relative_to(scene.body(first).pose)
    in_second = frame.relative_to(scene.body(second).pose)
    return _revolute(isometry(in_first), isometry(in_second))


def _revolute(first: rapier.Isometry3, second: rapier.Isometry3) -> Any:
    """Return a joint of two bodies that keeps two frames together, but for a rotation about x."""
    return _kept_together(rapier.JointAxesMask.LOCKED_REVOLUTE_AXES, first, second)


def _kept_together(
    locked: rapier.JointAxesMask, first: rapier.Isometry3, second: rapier.Isometry3
) -> Any:
    """Return a joint of two bodies that keeps two frames together along and about the locked axes."""
    joint = rapier.GenericJointBuilder(locked)
    return joint.local_frame1(first).local_frame2(second).build()
