"""Conversion of a scene to a Drake diagram: a multibody plant, its scene graph, and the collision geometry."""

from collections import defaultdict
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import pydrake.geometry as geometry
from numpy.typing import ArrayLike
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    RevoluteJoint,
    RotationalInertia,
    SpatialInertia,
)
from pydrake.systems.framework import DiagramBuilder
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from gauge_envs.backends.drake.contacts import ContactConstantsDrake, contact_constants
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
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
from gauge_envs.scene.meshes import body_mass_properties

CYLINDER_SIDES = 96
"""Number of sides of the hydroelastic mesh of a cylinder; its radius is exact within 0.06 %."""

CORNER_RADIUS_M = 1e-6
"""Radius of the spheres at corners [m]; it is a height error."""

POINTS_PER_FACE = 5
"""Contact points of a face in point contact, which share its stiffness: four corners and one of the shape."""

UNMOVED_KG = 1e9
"""Mass of fixed and driven bodies [kg]; in series with its stiffness, only the dynamic body's stiffness counts."""


@dataclass(frozen=True, kw_only=True)
class ModelDrake:
    """A scene in Drake.

    Attributes:
        diagram: The diagram of plant and scene graph.
        plant: The multibody plant.
        bodies: Drake's body of each dynamic or driven body, by name.
        names: Name of the body of each geometry.
    """

    diagram: Any
    plant: Any
    bodies: dict[str, Any]
    names: dict[GeometryId, str]


def rigid_transform(pose: Pose) -> RigidTransform:
    """Return a pose as Drake's transform."""
    return RigidTransform(RotationMatrix(pose.matrix), pose.position_m)


def build_model(scene: Scene, settings: SettingsDrake) -> ModelDrake:
    """Build a diagram with a discrete plant."""
    # Unlike `AddMultibodyPlantSceneGraph` of pydrake 1.51, this frees the plant with the diagram.
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlant(_config(settings), builder)
    gravity = [0.0, 0.0, -scene.gravity_m_per_s2]
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    bodies = _add_bodies(plant, scene, settings)
    for hinge in scene.hinges.values():
        _add_hinge(plant, scene.body(hinge.body), bodies[hinge.body], hinge)
    groups = _add_geometries(plant, scene, bodies, settings)
    plant.Finalize()
    names = {
        geometry_id: name
        for _, geometries in groups
        for name, ids in geometries.items()
        for geometry_id in ids
    }
    allowed = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(list(names)))
    for contacts, geometries in groups:
        for contact in contacts:
            for pair in scene.colliding_pairs(contact):
                allowed.AllowBetween(*(GeometrySet(geometries[name]) for name in pair))
    scene_graph.collision_filter_manager().Apply(allowed)
    return ModelDrake(diagram=builder.Build(), plant=plant, bodies=bodies, names=names)


def _config(settings: SettingsDrake) -> MultibodyPlantConfig:
    """Return the settings of the plant, in Drake's names."""
    name = settings.approximation
    if not hasattr(DiscreteContactApproximation, f"k{name.title()}"):
        raise ParameterError(
            f"Drake setting 'approximation' is {name!r}, which Drake {version('drake')} does not have: choose sap, "
            "similar, lagged, or install Drake 1.51"
        )
    is_point = settings.contact_model == "point"
    return MultibodyPlantConfig(
        time_step=settings.timestep_s,
        use_sampled_output_ports=False,
        contact_model="point" if is_point else "hydroelastic_with_fallback",
        discrete_contact_approximation=name,
        contact_surface_representation=settings.surface,
        stiction_tolerance=settings.stiction_speed_m_per_s,
        sap_near_rigid_threshold=settings.near_rigid_threshold,
    )


def _add_bodies(plant: Any, scene: Scene, settings: SettingsDrake) -> dict[str, Any]:
    """Add the bodies that move, and return them by name. Driven bodies are heavy and have no weight."""
    free, driven = plant.AddModelInstance("free"), plant.AddModelInstance("driven")
    plant.set_gravity_enabled(driven, False)
    dynamic_mass_kg = sum(body.mass_kg for body in scene.dynamic_bodies)
    driven_mass_kg = settings.driven_mass_ratio * dynamic_mass_kg or 1.0
    bodies = {}
    for body in scene.bodies:
        if body.motion is Motion.DYNAMIC:
            bodies[body.name] = plant.AddRigidBody(body.name, free, _inertia(body))
        elif body.motion is Motion.KINEMATIC:
            corner_m = np.linalg.norm(body.shape.corners_m, axis=1).max()
            radius_m = float(np.sqrt(2.5) * corner_m)
            inertia = SpatialInertia.SolidSphereWithMass(driven_mass_kg, radius_m)
            bodies[body.name] = plant.AddRigidBody(body.name, driven, inertia)
    return bodies


def _inertia(body: RigidBody) -> SpatialInertia:
    centre_m, tensor = body_mass_properties(body)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor
    moments = RotationalInertia(xx, yy, zz, xy, xz, yz)
    return SpatialInertia.MakeFromCentralInertia(body.mass_kg, centre_m, moments)


def _add_hinge(plant: Any, body: RigidBody, added: Any, hinge: Hinge) -> None:
    """Add the hinge of a body (`added` in Drake) between frames at its anchor with the axes of the world."""
    anchor = RigidTransform(hinge.anchor_m)
    in_body = rigid_transform(body.pose).inverse() @ anchor
    world, name = plant.world_frame(), body.name
    parent = plant.AddFrame(FixedOffsetFrame(f"{name}/anchor", world, anchor))
    child = plant.AddFrame(FixedOffsetFrame(f"{name}/pin", added.body_frame(), in_body))
    plant.AddJoint(RevoluteJoint(name, parent, child, hinge.axis))


Groups = list[tuple[list[Contact], dict[str, list[GeometryId]]]]
"""Contacts with equal constants, and the geometries of each body in them by name, for each group."""


def _add_geometries(
    plant: Any, scene: Scene, bodies: dict[str, Any], settings: SettingsDrake
) -> Groups:
    """Add the shapes of all bodies, once for each group of contacts, so that every pair has its own constants."""
    contacts: dict[ContactConstantsDrake, list[Contact]] = defaultdict(list)
    for contact in scene.contacts:
        contacts[contact_constants(scene, contact, settings)].append(contact)
    groups: Groups = []
    for index, (constants, members) in enumerate(contacts.items()):
        sides = [
            name for contact in members for name in (*contact.first, *contact.second)
        ]
        geometries: dict[str, list[GeometryId]] = {}
        for name in dict.fromkeys(sides):
            body = scene.body(name)
            frame = bodies.get(name, plant.world_body())
            properties = _proximity_properties(body, constants, settings)
            geometries[name] = [
                plant.RegisterCollisionGeometry(
                    frame, place, shape, f"{name}/{index}/{number}", properties
                )
                for number, (place, shape) in enumerate(_parts(body, settings))
            ]
        groups.append((members, geometries))
    return groups


# --- collision geometry -----------------------------------------------------------------------------------------------


def _parts(
    body: RigidBody, settings: SettingsDrake
) -> list[tuple[RigidTransform, geometry.Shape]]:
    """Return the shapes of a body, and their places in it or, if it is fixed, in the world."""
    is_fixed = body.motion is Motion.FIXED
    place = rigid_transform(body.pose) if is_fixed else RigidTransform()
    parts = [(place, shape) for shape in _shapes(body.shape)]
    if is_fixed:
        return parts
    if settings.contact_model == "point" and isinstance(body.shape, Box | ConvexUnion):
        # Tiny spheres at the vertices are further contact points.
        for corner_m in np.unique(body.shape.corners_m, axis=0):
            sphere = geometry.Sphere(CORNER_RADIUS_M)
            parts.append((RigidTransform(corner_m), sphere))
    return parts


def _shapes(shape: Shape) -> list[geometry.Shape]:
    """Return a shape as Drake's shapes; a concave solid becomes one for each convex piece."""
    if isinstance(shape, Box):
        return [geometry.Box(*shape.size_m)]
    if isinstance(shape, Sphere):
        return [geometry.Sphere(shape.radius_m)]
    if isinstance(shape, Cylinder):
        return [geometry.Cylinder(shape.radius_m, shape.length_m)]
    if isinstance(shape, Plane):
        return [geometry.HalfSpace()]
    assert isinstance(shape, ConvexUnion)
    return [
        geometry.Convex(points=np.asarray(piece).T, label=f"piece-{number}")
        for number, piece in enumerate(shape.pieces_m)
    ]


def _proximity_properties(
    body: RigidBody, constants: ContactConstantsDrake, settings: SettingsDrake
) -> geometry.ProximityProperties:
    """Return the contact properties of a body in one contact of the scene."""
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
        properties,
        dissipation=constants.dissipation_s_per_m,
        point_stiffness=stiffness,
        friction=friction,
    )
    # Relaxation times of the two bodies of a pair add up.
    properties.AddProperty("material", "relaxation_time", 0.5 * constants.relaxation_s)
    # Spheres touch others in one point, so they collide by point contact.
    if settings.contact_model == "hydroelastic" and not isinstance(body.shape, Sphere):
        # Drake meshes boxes and convex solids exactly, so the edge length only counts for cylinders.
        edge_m = 1.0
        if isinstance(body.shape, Cylinder):
            edge_m = 2.0 * np.pi * body.shape.radius_m / CYLINDER_SIDES
        if body.motion is Motion.DYNAMIC:
            depth_m = inner_radius_m(body.shape)
            # The face of a slab of this depth has this stiffness.
            area_m2 = 0.5 * body.shape.volume_m3 / depth_m
            geometry.AddCompliantHydroelasticProperties(
                edge_m, stiffness * depth_m / area_m2, properties
            )
        else:
            geometry.AddRigidHydroelasticProperties(edge_m, properties)
    return properties


def inner_radius_m(shape: Shape) -> float:
    """Return the largest distance of a point inside a solid from its surface [m], the largest of a union's pieces."""
    if isinstance(shape, Box):
        return 0.5 * min(shape.size_m)
    if isinstance(shape, Cylinder):
        return min(shape.radius_m, 0.5 * shape.length_m)
    assert isinstance(shape, ConvexUnion)
    return max(_piece_inner_radius_m(piece) for piece in shape.pieces_m)


def _piece_inner_radius_m(points_m: ArrayLike) -> float:
    planes = ConvexHull(points_m).equations
    # The largest ball inside: its centre is further from each face than its radius.
    result = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([planes[:, :3], np.ones(len(planes))]),
        b_ub=-planes[:, 3],
        bounds=(None, None),
    )
    return float(result.x[3])
