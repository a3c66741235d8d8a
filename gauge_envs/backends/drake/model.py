"""Conversion of a scene to a Drake diagram: a multibody plant, its scene graph, and the collision geometry."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np
import pydrake.geometry as geometry
from numpy.typing import NDArray
from pydrake.geometry import CollisionFilterDeclaration, GeometryId, GeometrySet, HydroelasticContactRepresentation
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
)
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, RotationalInertia, SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from gauge_envs.backends.drake.contacts import ContactConstants, contact_constants
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.backends.shared.rigid import hinges_by_body
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    BodyHinge,
    Box,
    Contact,
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
)
from gauge_envs.scene.hinged import other_end, start_rate_rad_per_s
from gauge_envs.scene.meshes import body_mass_properties

APPROXIMATIONS = {"tamsi": "kTamsi", "sap": "kSap", "similar": "kSimilar", "lagged": "kLagged"}
SURFACES = {
    "polygon": HydroelasticContactRepresentation.kPolygon,
    "triangle": HydroelasticContactRepresentation.kTriangle,
}

CYLINDER_SIDES = 96
"""Number of sides of the hydroelastic mesh of a cylinder; its radius is exact within 0.06 %."""

CORNER_RADIUS_M = 1e-6
"""Radius of the spheres at corners [m]; it is a height error."""

POINTS_PER_FACE = 5
"""Contact points of a face in point contact, which share its stiffness: four corners and one of the whole shape."""

UNMOVED_KG = 1e9
"""Mass that gives fixed and driven bodies a stiffness beside which that of a dynamic body counts alone [kg]."""


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

    driven_mass_kg = settings.driven_mass_ratio * sum(body.mass_kg for body in scene.dynamic_bodies)
    bodies = {}
    for body in scene.bodies:
        if body.motion is Motion.DYNAMIC:
            centre, moments = body_mass_properties(body)
            inertia = SpatialInertia.MakeFromCentralInertia(body.mass_kg, centre, _rotational_inertia(moments))
            bodies[body.name] = plant.AddRigidBody(body.name, free, inertia)
        elif body.motion is Motion.KINEMATIC:
            reach_m = np.linalg.norm(body.shape.corners_m, axis=1).max()
            inertia = SpatialInertia.SolidSphereWithMass(driven_mass_kg or 1.0, float(np.sqrt(2.5) * reach_m))
            bodies[body.name] = plant.AddRigidBody(body.name, driven, inertia)
    hinges = hinges_by_body(scene)
    for name, hinge in hinges.items():
        _add_hinge(plant, scene, bodies, name, hinge)
    geometries = _add_geometries(plant, scene, bodies, settings)
    plant.Finalize()
    _filter(scene_graph, scene, geometries)
    diagram = builder.Build()
    return Model(diagram=diagram, plant=plant, bodies=bodies, start=_start(plant, scene, bodies, hinges))


def _approximation(name: str) -> DiscreteContactApproximation:
    known = {key: value for key, value in APPROXIMATIONS.items() if hasattr(DiscreteContactApproximation, value)}
    if name not in known:
        raise ParameterError(
            f"Drake setting 'approximation' is {name!r}, which Drake {version('drake')} does not have: "
            f"choose one of {', '.join(known)}, or install Drake 1.51"
        )
    return getattr(DiscreteContactApproximation, known[name])


def _add_hinge(plant: Any, scene: Scene, bodies: dict[str, Any], name: str, hinge: Hinge | BodyHinge) -> None:
    """Add a frictionless hinge of a body, about the z axes of two frames at its anchor."""
    anchor = RigidTransform(RotationMatrix.MakeFromOneVector(np.asarray(hinge.axis), 2), np.asarray(hinge.anchor_m))
    parent = other_end(hinge, name) if isinstance(hinge, BodyHinge) else None
    frames = []
    for one in (parent, name):
        place = anchor if one is None else rigid_transform(scene.body(one).pose).inverse() @ anchor
        holder = plant.world_body() if one is None else bodies[one]
        frames.append(plant.AddFrame(FixedOffsetFrame(f"{name}/{one or ''}", holder.body_frame(), place)))
    plant.AddJoint(
        RevoluteJoint(name=name, frame_on_parent=frames[0], frame_on_child=frames[1], axis=[0, 0, 1], damping=0.0)
    )


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


# --- collision geometry -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Part:
    """One Drake shape of a body.

    Attributes:
        pose: Pose in the body frame.
        shape: Drake's shape.
        is_curved: Whether the shape touches others in one point; such shapes collide by point contact.
    """

    pose: RigidTransform
    shape: geometry.Shape
    is_curved: bool = False


def collision_parts(shape: Shape) -> list[Part]:
    """Return a shape as Drake's shapes; a concave solid becomes one part for each convex piece."""
    here = RigidTransform()
    if isinstance(shape, Box):
        return [Part(pose=here, shape=geometry.Box(*shape.size_m))]
    if isinstance(shape, Sphere):
        return [Part(pose=here, shape=geometry.Sphere(shape.radius_m), is_curved=True)]
    if isinstance(shape, Cylinder):
        return [Part(pose=here, shape=geometry.Cylinder(shape.radius_m, shape.length_m))]
    if isinstance(shape, Plane):
        return [Part(pose=here, shape=geometry.HalfSpace())]
    assert isinstance(shape, ConvexUnion), "compounds are declined by unsupported_features"
    parts = []
    for number, piece in enumerate(shape.pieces_m):
        points = np.asarray(piece)
        parts.append(Part(pose=here, shape=geometry.Convex(points=points.T, label=f"piece-{number}")))
    return parts


def corner_parts(shape: Shape) -> list[Part]:
    """Return tiny spheres at the vertices of a polyhedron, or nothing for other shapes."""
    if not isinstance(shape, Box | ConvexUnion):
        return []
    corners = np.unique(shape.corners_m, axis=0)
    return [Part(pose=RigidTransform(p), shape=geometry.Sphere(CORNER_RADIUS_M), is_curved=True) for p in corners]


def proximity_properties(
    body: RigidBody, part: Part, constants: ContactConstants, settings: SettingsDrake
) -> geometry.ProximityProperties:
    """Return the contact properties of one part of a body in one contact of the scene."""
    properties = geometry.ProximityProperties()
    friction = CoulombFriction(constants.friction, constants.friction)
    if settings.drake_material:
        geometry.AddContactMaterial(properties, friction=friction)
        return properties
    mass_kg = body.mass_kg if body.motion is Motion.DYNAMIC else UNMOVED_KG
    stiffness = mass_kg * constants.frequency_rad_per_s**2
    if settings.contact_model == "point" and isinstance(body.shape, Box | ConvexUnion):
        stiffness /= POINTS_PER_FACE
    geometry.AddContactMaterial(
        properties, dissipation=constants.dissipation_s_per_m, point_stiffness=stiffness, friction=friction
    )
    # Relaxation times of the two bodies of a pair add up.
    properties.AddProperty("material", "relaxation_time", 0.5 * constants.relaxation_s)
    if settings.contact_model == "hydroelastic" and not part.is_curved:
        # Drake meshes boxes and convex solids exactly, so the edge length only counts for cylinders.
        edge_m = 2.0 * np.pi * body.shape.radius_m / CYLINDER_SIDES if isinstance(body.shape, Cylinder) else 1.0
        if body.motion is Motion.DYNAMIC:
            depth_m = inner_radius_m(body.shape)
            # The face of a slab of this depth has this stiffness.
            area_m2 = 0.5 * body.shape.volume_m3 / depth_m
            geometry.AddCompliantHydroelasticProperties(edge_m, stiffness * depth_m / area_m2, properties)
        else:
            geometry.AddRigidHydroelasticProperties(edge_m, properties)
    return properties


def inner_radius_m(shape: Shape) -> float:
    """Return the largest distance of a point inside a solid from its surface [m], the largest of a union's pieces."""
    if isinstance(shape, Box):
        return 0.5 * min(shape.size_m)
    if isinstance(shape, Cylinder):
        return min(shape.radius_m, 0.5 * shape.length_m)
    if isinstance(shape, Sphere):
        return shape.radius_m
    if isinstance(shape, ConvexUnion):
        return max(_piece_inner_radius_m(np.asarray(piece)) for piece in shape.pieces_m)
    return float("inf")


def _piece_inner_radius_m(points_m: NDArray[np.float64]) -> float:
    planes = ConvexHull(points_m).equations
    # The largest ball inside: its centre is further from each face than its radius.
    found = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([planes[:, :3], np.ones(len(planes))]),
        b_ub=-planes[:, 3],
        bounds=[(None, None)] * 3 + [(0.0, None)],
    )
    return float(found.x[3])
