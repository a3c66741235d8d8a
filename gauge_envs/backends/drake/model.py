"""Conversion of a scene to a Drake diagram: a multibody plant and its scene graph."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import CollisionFilterDeclaration, GeometryId, GeometrySet, HydroelasticContactRepresentation
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, ContactModel, DiscreteContactApproximation
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, RotationalInertia, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from gauge_envs.backends.drake.contacts import ContactConstants, contact_constants
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.backends.drake.shapes import collision_parts, corner_parts, proximity_properties
from gauge_envs.errors import ParameterError
from gauge_envs.scene import BodyHinge, Contact, Hinge, Motion, Pose, RigidBody, Scene
from gauge_envs.scene.hinged import other_end, parent_hinges, start_rate_rad_per_s
from gauge_envs.scene.meshes import body_mass_properties

APPROXIMATIONS = {"tamsi": "kTamsi", "sap": "kSap", "similar": "kSimilar", "lagged": "kLagged"}
SURFACES = {
    "polygon": HydroelasticContactRepresentation.kPolygon,
    "triangle": HydroelasticContactRepresentation.kTriangle,
}


@dataclass(frozen=True, kw_only=True)
class Model:
    """A scene in Drake.

    Attributes:
        diagram: The diagram of plant and scene graph.
        plant: The multibody plant.
        bodies: Drake's body of each dynamic or driven body, by name.
        start: Discrete state at the start: positions, then velocities.
    """

    diagram: Any
    plant: Any
    bodies: dict[str, Any]
    start: NDArray[np.float64]


def rigid_transform(pose: Pose) -> RigidTransform:
    """Return a pose as Drake's transform."""
    return RigidTransform(RotationMatrix(pose.rotation.as_matrix()), np.asarray(pose.position_m))


def build_model(scene: Scene, settings: SettingsDrake) -> Model:
    """Build a diagram with a discrete plant, whose state is that of the scene's start."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, settings.timestep_s)
    plant.SetUseSampledOutputPorts(False)
    plant.set_contact_model(
        ContactModel.kPoint if settings.contact_model == "point" else ContactModel.kHydroelasticWithFallback
    )
    plant.set_discrete_contact_approximation(_approximation(settings.approximation))
    plant.set_contact_surface_representation(SURFACES[settings.surface])
    plant.set_stiction_tolerance(settings.stiction_speed_m_per_s)
    plant.set_sap_near_rigid_threshold(settings.near_rigid_threshold)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -scene.gravity_m_per_s2])
    free, driven = plant.AddModelInstance("free"), plant.AddModelInstance("driven")
    plant.set_gravity_enabled(driven, False)

    hinges = {joint.body: joint for joint in scene.joints if isinstance(joint, Hinge)}
    driven_mass_kg = settings.driven_mass_ratio * sum(body.mass_kg for body in scene.dynamic_bodies)
    bodies = {}
    for body in scene.bodies:
        if body.motion is not Motion.FIXED:
            instance = driven if body.motion is Motion.KINEMATIC else free
            bodies[body.name] = _add_body(plant, instance, body, hinges.get(body.name), driven_mass_kg or 1.0)
    hanging = parent_hinges(scene.body_hinges)
    for name, hinge in hanging.items():
        parent = other_end(hinge, name)
        anchor = _hinge_pose(hinge)
        frames = [
            _frame(plant, f"{name}/{one}", bodies[one], rigid_transform(scene.body(one).pose).inverse() @ anchor)
            for one in (parent, name)
        ]
        _add_revolute(plant, name, *frames)
    geometries = _add_geometries(plant, scene, bodies, settings)
    plant.Finalize()
    _filter(scene_graph, scene, geometries)
    diagram = builder.Build()
    return Model(diagram=diagram, plant=plant, bodies=bodies, start=_start(plant, scene, bodies, {**hinges, **hanging}))


def _approximation(name: str) -> DiscreteContactApproximation:
    known = {key: value for key, value in APPROXIMATIONS.items() if hasattr(DiscreteContactApproximation, value)}
    if name not in known:
        raise ParameterError(
            f"Drake setting 'approximation' is {name!r}, which Drake {version('drake')} does not have: "
            f"choose one of {', '.join(known)}, or install Drake 1.51"
        )
    return getattr(DiscreteContactApproximation, known[name])


def _add_body(plant: Any, instance: Any, body: RigidBody, hinge: Hinge | None, driven_mass_kg: float) -> Any:
    if body.motion is Motion.KINEMATIC:
        reach_m = np.linalg.norm(body.shape.corners_m, axis=1).max()
        inertia = SpatialInertia.SolidSphereWithMass(driven_mass_kg, float(np.sqrt(2.5) * reach_m))
        return plant.AddRigidBody(body.name, instance, inertia)
    centre, moments = body_mass_properties(body)
    inertia = SpatialInertia.MakeFromCentralInertia(body.mass_kg, centre, _rotational_inertia(moments))
    added = plant.AddRigidBody(body.name, instance, inertia)
    if hinge is not None:
        anchor = _hinge_pose(hinge)
        parent = _frame(plant, f"{body.name}/anchor", plant.world_body(), anchor)
        child = _frame(plant, f"{body.name}/hinge", added, rigid_transform(body.pose).inverse() @ anchor)
        _add_revolute(plant, body.name, parent, child)
    return added


def _hinge_pose(hinge: Hinge | BodyHinge) -> RigidTransform:
    """Return a frame in the world at the anchor of a hinge, whose z axis is that of the hinge."""
    return RigidTransform(RotationMatrix.MakeFromOneVector(np.asarray(hinge.axis), 2), np.asarray(hinge.anchor_m))


def _add_revolute(plant: Any, name: str, parent: Any, child: Any) -> None:
    """Add a frictionless hinge about the z axes of two frames."""
    plant.AddJoint(
        RevoluteJoint(name=name, frame_on_parent=parent, frame_on_child=child, axis=[0.0, 0.0, 1.0], damping=0.0)
    )


def _frame(plant: Any, name: str, body: Any, pose: RigidTransform) -> Any:
    return plant.AddFrame(FixedOffsetFrame(name, body.body_frame(), pose))


def _rotational_inertia(moments: NDArray[np.float64]) -> RotationalInertia:
    return RotationalInertia(
        Ixx=moments[0, 0], Iyy=moments[1, 1], Izz=moments[2, 2], Ixy=moments[0, 1], Ixz=moments[0, 2], Iyz=moments[1, 2]
    )


@dataclass(frozen=True)
class _Group:
    """Geometries of the contacts with equal constants, which share them.

    Attributes:
        contacts: The contacts.
        geometries: Geometries of each body in the contacts, by name.
    """

    contacts: list[Contact] = field(default_factory=list)
    geometries: dict[str, list[GeometryId]] = field(default_factory=dict)


def _add_geometries(plant: Any, scene: Scene, bodies: dict[str, Any], settings: SettingsDrake) -> list[_Group]:
    """Add the shapes of all bodies, once for each group of contacts, so that every pair has its own constants."""
    groups: dict[ContactConstants, _Group] = defaultdict(_Group)
    for contact in scene.contacts:
        groups[contact_constants(scene, contact, settings)].contacts.append(contact)
    for index, (constants, group) in enumerate(groups.items()):
        names = (name for contact in group.contacts for name in (*contact.first, *contact.second))
        for name in dict.fromkeys(names):
            body = scene.body(name)
            frame = bodies.get(name, plant.world_body())
            offset = rigid_transform(body.pose) if body.motion is Motion.FIXED else RigidTransform()
            parts = collision_parts(body.shape)
            if settings.contact_model == "point" and body.motion is not Motion.FIXED:
                parts += corner_parts(body.shape)
            group.geometries[name] = [
                plant.RegisterCollisionGeometry(
                    frame,
                    offset @ part.pose,
                    part.shape,
                    f"{name}/{index}/{number}",
                    proximity_properties(body, part, constants, settings),
                )
                for number, part in enumerate(parts)
            ]
    return list(groups.values())


def _filter(scene_graph: Any, scene: Scene, groups: list[_Group]) -> None:
    """Let the pairs of each contact collide and no others."""
    manager = scene_graph.collision_filter_manager()
    everything = [one for group in groups for ids in group.geometries.values() for one in ids]
    manager.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(everything)))
    for group in groups:
        partners: dict[str, list[GeometryId]] = defaultdict(list)
        for contact in group.contacts:
            for first, second in scene.colliding_pairs(contact):
                partners[first].extend(group.geometries[second])
        for first, others in partners.items():
            ours = GeometrySet(group.geometries[first])
            manager.Apply(CollisionFilterDeclaration().AllowBetween(ours, GeometrySet(others)))


def _start(
    plant: Any, scene: Scene, bodies: dict[str, Any], hinges: Mapping[str, Hinge | BodyHinge]
) -> NDArray[np.float64]:
    state = np.zeros(plant.num_multibody_states())
    offset = plant.num_positions()
    for body in scene.bodies:
        if body.motion is Motion.FIXED:
            continue
        if body.name in hinges:
            hinge = hinges[body.name]
            rate = float(np.dot(body.angular_velocity_rad_per_s, hinge.axis))
            if isinstance(hinge, BodyHinge):
                rate = start_rate_rad_per_s(hinge, body, scene.body(other_end(hinge, body.name)))
            state[offset + plant.GetJointByName(body.name).velocity_start()] = rate
            continue
        added = bodies[body.name]
        first = added.floating_positions_start()
        state[first : first + 7] = [*body.pose.quaternion, *body.pose.position_m]
        first = offset + added.floating_velocities_start_in_v()
        state[first : first + 6] = [*body.angular_velocity_rad_per_s, *body.linear_velocity_m_per_s]
    return state
