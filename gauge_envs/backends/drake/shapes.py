"""Collision geometry: a scene's shapes as Drake's, with the properties of one contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pydrake.geometry as geometry
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from gauge_envs.backends.drake.contacts import ContactConstants
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.scene import Box, ConvexUnion, Cylinder, Motion, Plane, RigidBody, Shape, Sphere

CYLINDER_SIDES = 96
"""Number of sides of the hydroelastic mesh of a cylinder; its radius is exact within 0.06 %."""

CORNER_RADIUS_M = 1e-6
"""Radius of the spheres at corners [m]; it is a height error."""

POINTS_PER_FACE = 5
"""Contact points of a face in point contact, which share its stiffness: four corners and one of the whole shape."""

UNMOVED_KG = 1e9
"""Mass that gives fixed and driven bodies a stiffness beside which that of a dynamic body counts alone [kg]."""


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
        properties,
        dissipation=constants.dissipation_s_per_m,
        point_stiffness=stiffness,
        friction=friction,
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
