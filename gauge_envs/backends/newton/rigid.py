"""Rigid bodies of a scene in a Newton model, and rigid scenes on Newton's MuJoCo solver (MuJoCo Warp).

Contacts come from Newton's collision pipeline. The collision detection of MuJoCo Warp is used on request only
(`mujoco_contacts`): its normals are inaccurate in single precision. In 400 poses of a cube on a leaning board with
mujoco_warp 4.0.0, some normals are off by more than a degree, a few by 90 degrees. The share is up to 0.8 % of contacts
1 to 10 um deep, up to 1.2 % at 0.1 to 1 um, and 1 to 6 % at 0.01 to 0.1 um. A cube with a friction of 0.1 then slides
down 30 degrees with 3.80 instead of 4.05 m/s^2. Newton's normals are accurate to 0.02 degrees, and the cube has 4.055
m/s^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any, Literal

import newton
import numpy as np
import trimesh
import warp as wp
from newton.solvers import mujoco
from numpy.typing import ArrayLike, NDArray

from gauge_envs.backends.newton.contacts import (
    DEFAULT_SOLIMP,
    FRICTION_AS_NORMAL,
    ShapeConstants,
    carried_constants,
    pair_constants,
)
from gauge_envs.backends.newton.settings import SettingsMuJoCoWarp
from gauge_envs.backends.newton.stepper import warp_transform
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Hinge,
    Motion,
    Plane,
    RigidBody,
    Scene,
    Sphere,
    Tether,
)
from gauge_envs.scene.bodies import friction_dimension
from gauge_envs.scene.meshes import body_mass_properties, prism

WORLD = -1
"""Newton's body index of the world."""

Solids = Literal["exact", "prisms", "meshes"]
"""Shapes of the model: the scene's; prisms for cylinders that do not move freely; convex meshes for all solids."""

_Solid = Box | Sphere | Cylinder | Plane | ConvexUnion | Capsule | Ellipsoid

SPHERE_SUBDIVISIONS = 3
"""Subdivisions of the icosahedron that is the mesh of a sphere: 642 vertices on the sphere."""

SOLIMP_SHAPE = (0.5, 2.0)
"""Midpoint and power of the impedance curve, MuJoCo's defaults; they have no effect on a constant impedance."""

SOLREF_AS_GIVEN = 1
"""Newton's code for a `solref` that is given, and not computed from stiffness and damping."""

NO_FRICTION = 2e-5
"""Friction of frictionless shapes and of shapes without constants, just above MuJoCo Warp's smallest value."""

CONTACT_GAP_M = 0.002
"""Distance at which Newton detects a contact [m], more than the displacement of any body in one step."""


STRING_TIME_CONSTANT_S = 1e-3
"""Shortest time constant of the limit of a string [s], as in the MuJoCo backend."""

Layer = dict[str, list[int]]
"""Shapes of two bodies that touch with the same constants, by name of the body."""


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
    solids: Solids = "exact",
) -> RigidIndex:
    """Add the rigid bodies of a scene at rest; hinges become revolute joints and driven bodies kinematic bodies.

    Args:
        builder: Model builder.
        scene: The scene.
        config: Contact constants of every shape; its density must be 0, since this function sets the masses.
        solids: Shapes of the model. Boxes rest better on prisms. A prism does not roll like a cylinder: each of its
            edges takes speed, so a dynamic cylinder is never a prism. Particles collide with cylinders three times
            faster than with prisms.
    """
    index = RigidIndex()
    for body in scene.bodies:
        name = body.name
        if body.motion is Motion.FIXED:
            place = WORLD
        elif name in scene.hinges:
            place = _add_hinged(builder, body, scene.hinges[name])
        else:
            place = builder.add_body(
                is_kinematic=body.motion is Motion.KINEMATIC, **_link_arguments(body)
            )
        index.bodies[name] = place
        index.shapes[name] = _add_shapes(builder, body, place, config, solids)
    return index


def _link_arguments(body: RigidBody) -> dict[str, Any]:
    """Return the arguments of an added body, whose mass does not come from its shapes."""
    centre, inertia = body_mass_properties(body)
    return {
        "xform": warp_transform(body.pose),
        "mass": body.mass_kg,
        "com": wp.vec3(*centre),
        "inertia": wp.mat33(inertia),
        "lock_inertia": True,
        "label": body.name,
    }


def _add_hinged(builder: newton.ModelBuilder, body: RigidBody, hinge: Hinge) -> int:
    """Add a body on a hinge as an articulation, and return its index."""
    place = builder.add_link(**_link_arguments(body))
    anchor = wp.transform(wp.vec3(*hinge.anchor_m), wp.quat_identity())
    joint = builder.add_joint_revolute(
        WORLD,
        place,
        parent_xform=anchor,
        child_xform=wp.transform_inverse(warp_transform(body.pose)) * anchor,
        axis=wp.vec3(*hinge.axis),
        label=body.name,
    )
    builder.add_articulation([joint], label=body.name)
    return place


def _add_shapes(
    builder: newton.ModelBuilder,
    body: RigidBody,
    index: int,
    config: newton.ModelBuilder.ShapeConfig,
    solids: Solids,
) -> list[int]:
    """Add the shapes of a body, whose index is given, and return their indices."""
    frame = wp.transform_identity()
    if body.motion is Motion.FIXED:
        frame = warp_transform(body.pose)
    parts: list[tuple[wp.transform, _Solid]]
    if isinstance(body.shape, Compound):
        parts = [(frame * warp_transform(p.pose), p.shape) for p in body.shape.parts]
    else:
        parts = [(frame, body.shape)]
    rolls = body.motion is Motion.DYNAMIC
    added: list[int] = []
    for place, shape in parts:
        given = {"body": index, "xform": place, "cfg": config, "label": body.name}
        pieces = _pieces_m(shape, solids, rolls=rolls)
        for piece in pieces:
            mesh = _hull(np.asarray(piece))
            added.append(builder.add_shape_convex_hull(mesh=mesh, **given))
        if not pieces:
            added.append(_add_primitive(builder, shape, given))
    return added


def _add_primitive(
    builder: newton.ModelBuilder, shape: _Solid, given: dict[str, Any]
) -> int:
    """Add a shape that Newton has, with given arguments, and return its index."""
    if isinstance(shape, Plane):
        return builder.add_shape_plane(width=0.0, length=0.0, **given)
    if isinstance(shape, Box):
        x, y, z = (0.5 * edge for edge in shape.size_m)
        return builder.add_shape_box(hx=x, hy=y, hz=z, **given)
    if isinstance(shape, Sphere):
        return builder.add_shape_sphere(radius=shape.radius_m, **given)
    if isinstance(shape, Ellipsoid):
        x, y, z = shape.radii_m
        return builder.add_shape_ellipsoid(rx=x, ry=y, rz=z, **given)
    assert isinstance(shape, Cylinder | Capsule)
    size = {"radius": shape.radius_m, "half_height": 0.5 * shape.length_m}
    if isinstance(shape, Cylinder):
        return builder.add_shape_cylinder(**size, **given)
    return builder.add_shape_capsule(**size, **given)


def _pieces_m(shape: _Solid, solids: Solids, *, rolls: bool) -> Sequence[ArrayLike]:
    """Return the vertices of the convex pieces of a solid [m], each [vertex_count, 3]; none for a primitive shape."""
    if isinstance(shape, ConvexUnion):
        return shape.pieces_m
    is_mesh = solids == "meshes"
    if isinstance(shape, Cylinder) and (is_mesh or (solids == "prisms" and not rolls)):
        return prism(shape).pieces_m
    if is_mesh and isinstance(shape, Box):
        return [shape.corners_m]
    if is_mesh and isinstance(shape, Sphere):
        ball = trimesh.creation.icosphere(
            subdivisions=SPHERE_SUBDIVISIONS, radius=shape.radius_m
        )
        return [ball.vertices]
    return []


def _hull(points_m: NDArray[np.float64]) -> newton.Mesh:
    hull = trimesh.convex.convex_hull(points_m)
    return newton.Mesh(hull.vertices, hull.faces.ravel(), compute_inertia=False)


def keep_apart(
    builder: newton.ModelBuilder,
    scene: Scene,
    index: RigidIndex,
    layers: Mapping[frozenset[str], Layer] | None = None,
) -> None:
    """Exclude collisions between all shapes that have no contact in the scene.

    Args:
        builder: Model builder.
        scene: The scene.
        index: Indices of its bodies and shapes.
        layers: Copies of shapes that replace the first shapes of these bodies in collisions, by pair of bodies.
    """
    layers = layers or {}
    meeting: set[frozenset[int]] = set()
    for contact in scene.contacts:
        for first, second in scene.colliding_pairs(contact):
            shapes = layers.get(frozenset((first, second)), index.shapes)
            meeting |= {
                frozenset(pair)
                for pair in product(shapes.get(first, ()), shapes.get(second, ()))
            }
    every = {
        shape
        for layer in (index.shapes, *layers.values())
        for shapes in layer.values()
        for shape in shapes
    }
    for pair in combinations(sorted(every), 2):
        if frozenset(pair) not in meeting:
            builder.add_shape_collision_filter_pair(*pair)


# --- MuJoCo solver ----------------------------------------------------------------------------------------------------


def shape_config() -> newton.ModelBuilder.ShapeConfig:
    """Return the constants of a shape before `add_contacts`; its density is zero because masses are given."""
    return newton.ModelBuilder.ShapeConfig(
        density=0.0,
        gap=CONTACT_GAP_M,
        mu=NO_FRICTION,
        mu_torsional=0.0,
        mu_rolling=0.0,
        kf=FRICTION_AS_NORMAL,
    )


def add_contacts(
    builder: newton.ModelBuilder,
    scene: Scene,
    index: RigidIndex,
    settings: SettingsMuJoCoWarp,
    solids: Solids,
) -> None:
    """Write the contact constants of shapes, and exclude all collisions without a contact in the scene.

    If neither body of a pair carries its constants, both get copies of their shapes, which collide with each other
    alone.
    """
    pairs = pair_constants(scene, settings)
    carried = carried_constants(pairs)
    shapes = [(constants, index.shapes[name]) for name, constants in carried.items()]
    copies: dict[tuple[str, ShapeConstants], list[int]] = {}
    layers: dict[frozenset[str], Layer] = {}
    for pair, constants in pairs.items():
        for name in () if pair & set(carried) else sorted(pair):
            if (name, constants) not in copies:
                body, place = scene.body(name), index.bodies[name]
                copies[name, constants] = _add_shapes(
                    builder, body, place, shape_config(), solids
                )
                shapes.append((constants, copies[name, constants]))
            layers.setdefault(pair, {})[name] = copies[name, constants]
    keeps_material = settings.newton_material and settings.contact_solref is None
    for constants, carriers in shapes:
        for shape in carriers:
            _carry(builder, shape, constants, newton_material=keeps_material)
    keep_apart(builder, scene, index, layers)
    for (name, _), added in copies.items():
        index.shapes[name] += added


def add_strings(
    builder: newton.ModelBuilder,
    scene: Scene,
    index: RigidIndex,
    settings: SettingsMuJoCoWarp,
) -> None:
    """Add each string as a spatial tendon of limited length, as stiff as a step allows."""
    for joint in scene.joints:
        if isinstance(joint, Tether):
            anchor = builder.add_site(
                WORLD, xform=wp.transform(wp.vec3(*joint.anchor_m), wp.quat_identity())
            )
            mujoco.add_tendon_spatial(
                builder,
                [
                    mujoco.TendonWrapSite(anchor),
                    mujoco.TendonWrapSite(builder.add_site(index.bodies[joint.body])),
                ],
                limited=True,
                limit_range=(0.0, joint.length_m),
                solref_limit=(
                    max(2.0 * settings.timestep_s, STRING_TIME_CONSTANT_S),
                    1.0,
                ),
                solimp_limit=(0.9999, 0.9999, *DEFAULT_SOLIMP[2:]),
            )


def _carry(
    builder: newton.ModelBuilder,
    shape: int,
    constants: ShapeConstants,
    *,
    newton_material: bool,
) -> None:
    builder.shape_material_mu[shape] = max(constants.friction, NO_FRICTION)
    builder.shape_material_mu_torsional[shape] = constants.torsion_m
    builder.shape_material_mu_rolling[shape] = constants.rolling_m
    dimension = friction_dimension(constants.torsion_m, constants.rolling_m)
    attributes: dict[str, Any] = {
        "condim": dimension if constants.friction > 0.0 else 1,
        "geom_priority": 1,
    }
    if newton_material:
        builder.shape_material_kf[shape] = newton.ModelBuilder.ShapeConfig().kf
    else:
        builder.shape_material_kf[shape] = constants.friction_gain_n_s_per_m
        attributes |= {
            "solref": wp.vec2(*constants.solref),
            "solref_mode": SOLREF_AS_GIVEN,
            "geom_solimp": wp.types.vector(5, wp.float32)(
                *(*constants.solimp, *SOLIMP_SHAPE)[:5]
            ),
        }
    for key, value in attributes.items():
        attribute = builder.custom_attributes[f"mujoco:{key}"]
        attribute.values = (attribute.values or {}) | {shape: value}
