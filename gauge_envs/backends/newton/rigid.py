"""Conversion of rigid bodies of a scene to bodies and shapes of a Newton model."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations, product

import newton
import numpy as np
import trimesh
import warp as wp
from numpy.typing import NDArray

from gauge_envs.backends.newton.stepper import warp_transform
from gauge_envs.scene import Box, ConvexUnion, Cylinder, Hinge, Motion, RigidBody, Scene, Sphere
from gauge_envs.scene.meshes import mass_properties, prism

__all__ = ["RigidIndex", "add_bodies", "keep_apart"]

WORLD = -1
"""Newton's body index of the world."""


@dataclass(frozen=True, kw_only=True)
class RigidIndex:
    """Indices of the rigid bodies and shapes of one scene in a model.

    Attributes:
        bodies: Index of each body, by name; -1 for fixed bodies, whose shapes belong to the world.
        shapes: Indices of the shapes of each body, by name.
    """

    bodies: dict[str, int] = field(default_factory=dict)
    shapes: dict[str, list[int]] = field(default_factory=dict)


def add_bodies(
    builder: newton.ModelBuilder,
    scene: Scene,
    *,
    config: newton.ModelBuilder.ShapeConfig,
    has_prisms: bool = False,
) -> RigidIndex:
    """Add the rigid bodies of a scene; hinges become revolute joints and driven bodies kinematic bodies.

    Args:
        builder: Model builder.
        scene: The scene.
        config: Contact constants of every shape; its density must be 0, since this function sets the masses.
        has_prisms: Whether prisms replace cylinders. Boxes rest better on prisms; particles collide with cylinders
            three times faster.
    """
    hinges = {joint.body: joint for joint in scene.joints if isinstance(joint, Hinge)}
    index = RigidIndex()
    for body in scene.bodies:
        if body.motion is Motion.FIXED:
            place, frame = WORLD, warp_transform(body.pose)
        else:
            place, frame = _add_body(builder, body, hinges.get(body.name)), wp.transform_identity()
        index.bodies[body.name] = place
        index.shapes[body.name] = _add_shapes(builder, place, frame, body, config, has_prisms=has_prisms)
    return index


def _add_body(builder: newton.ModelBuilder, body: RigidBody, hinge: Hinge | None) -> int:
    centre, inertia = mass_properties(body.shape, body.mass_kg)
    given = {
        "xform": warp_transform(body.pose),
        "mass": body.mass_kg,
        "com": wp.vec3(*centre),
        "inertia": wp.mat33(inertia),
        "lock_inertia": True,
        "label": body.name,
    }
    if hinge is None:
        index = builder.add_body(is_kinematic=body.motion is Motion.KINEMATIC, **given)
        if not body.starts_at_rest:
            _set_velocity(builder, index, body, centre)
            builder.joint_qd[-6:] = list(builder.body_qd[index])
        return index
    link = builder.add_link(**given)
    anchor = wp.transform(wp.vec3(*hinge.anchor_m), wp.quat_identity())
    joint = builder.add_joint_revolute(
        WORLD,
        link,
        parent_xform=anchor,
        child_xform=wp.transform_inverse(warp_transform(body.pose)) * anchor,
        axis=wp.vec3(*hinge.axis),
        armature=0.0,
        friction=0.0,
        label=body.name,
    )
    builder.add_articulation([joint], label=body.name)
    if not body.starts_at_rest:
        _set_velocity(builder, link, body, centre)
        builder.joint_qd[-1] = float(np.dot(body.angular_velocity_rad_per_s, hinge.axis))
    return link


def _set_velocity(builder: newton.ModelBuilder, index: int, body: RigidBody, centre_m: NDArray[np.float64]) -> None:
    """Write the start velocity of a body; Newton's linear velocity is that of the centre of mass."""
    angular = np.array(body.angular_velocity_rad_per_s)
    linear = body.linear_velocity_m_per_s + np.cross(angular, body.pose.rotation.apply(centre_m))
    builder.body_qd[index] = wp.spatial_vector(*linear.tolist(), *angular.tolist())


def _add_shapes(
    builder: newton.ModelBuilder,
    place: int,
    frame: wp.transform,
    body: RigidBody,
    config: newton.ModelBuilder.ShapeConfig,
    *,
    has_prisms: bool,
) -> list[int]:
    given = {"body": place, "xform": frame, "cfg": config}
    shape = body.shape
    if isinstance(shape, Box):
        x, y, z = (0.5 * edge for edge in shape.size_m)
        return [builder.add_shape_box(hx=x, hy=y, hz=z, label=body.name, **given)]
    if isinstance(shape, Sphere):
        return [builder.add_shape_sphere(radius=shape.radius_m, label=body.name, **given)]
    if isinstance(shape, Cylinder) and not has_prisms:
        radius, half = shape.radius_m, 0.5 * shape.length_m
        return [builder.add_shape_cylinder(radius=radius, half_height=half, label=body.name, **given)]
    if isinstance(shape, Cylinder | ConvexUnion):
        solid = prism(shape) if isinstance(shape, Cylinder) else shape
        return [
            builder.add_shape_convex_hull(mesh=_hull(np.asarray(piece)), label=f"{body.name}/{number}", **given)
            for number, piece in enumerate(solid.pieces_m)
        ]
    return [builder.add_shape_plane(width=0.0, length=0.0, label=body.name, **given)]


def _hull(points_m: NDArray[np.float64]) -> newton.Mesh:
    hull = trimesh.convex.convex_hull(points_m)
    return newton.Mesh(hull.vertices, hull.faces.ravel(), compute_inertia=False)


def keep_apart(builder: newton.ModelBuilder, scene: Scene, index: RigidIndex) -> None:
    """Exclude collisions between all shapes that have no contact in the scene."""
    pairs = {frozenset(pair) for contact in scene.contacts for pair in scene.colliding_pairs(contact)}
    for body in scene.bodies:
        for one, other in combinations(index.shapes[body.name], 2):
            builder.add_shape_collision_filter_pair(one, other)
    for first, second in combinations(index.shapes, 2):
        if frozenset((first, second)) not in pairs:
            for one, other in product(index.shapes[first], index.shapes[second]):
                builder.add_shape_collision_filter_pair(one, other)
