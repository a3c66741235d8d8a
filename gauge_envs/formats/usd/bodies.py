"""Reader of rigid bodies of a USD stage: motion, shape, mass and start."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation
from trimesh import Trimesh
from trimesh.geometry import triangulate_quads

from gauge_envs.formats.usd.driven import read_driven
from gauge_envs.formats.usd.layer import VELOCITIES, WRITTEN
from gauge_envs.formats.usd.source import Source, StoredValue, is_written
from gauge_envs.scene import (
    Box,
    ConvexUnion,
    Cylinder,
    Motion,
    Plane,
    Pose,
    RigidBody,
    Shape,
    Sphere,
    body_mass_properties,
    mass_properties,
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, length_of, pose_distance, vector

SAME_FRAME = 1e-9
"""Largest distance [m] and angle [rad] at which a collider's frame counts as the frame of its body."""

MAX_CONCAVITY = 1e-3
"""Largest relative difference between the volumes of a convex mesh and its hull."""

UNIFORM_RELATIVE = 0.01
"""Largest relative difference of a given inertia from the inertia of uniform density, and of a given centre of mass
relative to the radius of gyration."""

DEFAULT_DENSITY_KG_PER_M3 = 1000.0
"""Density of a collider without mass and density in UsdPhysics."""

UNSUPPORTED = (
    "physics:startsAsleep",
    "physxRigidBody:disableGravity",
    "physxRigidBody:linearDamping",
    "physxRigidBody:angularDamping",
    "physxCollision:torsionalPatchRadius",
    "newton:torsionalFriction",
    "newton:rollingFriction",
    "mjc:torsionalfriction",
    "mjc:rollingfriction",
)
"""Attributes of a dynamic body, its colliders or their materials that a scene lacks."""

SCHEMA_DEFAULTS = {"physxRigidBody:angularDamping": float(np.float32(0.05))}
"""Values that PhysX has without the attribute too; scenes without it are read."""

IDENTITY = Pose(position_m=(0.0, 0.0, 0.0))

APPROXIMATIONS = ("convexHull", "none", "meshSimplification", "convexDecomposition")
"""Approximations of meshes; all except the first keep the shape of the mesh, which must be convex."""


class Solid(NamedTuple):
    """A shape with its collider, and the pose of its frame in the unscaled frame of the body's prim."""

    prim: Usd.Prim
    shape: Shape
    pose: Pose = IDENTITY

    def moved(self, prim: Pose) -> Pose:
        """Return the pose of the shape frame for a pose of the prim."""
        if self.pose == IDENTITY:
            return prim
        position_m = vector(prim.to_world(np.asarray(self.pose.position_m)))
        return Pose.from_rotation(position_m, prim.rotation * self.pose.rotation)


def read_body(
    source: Source,
    prim: Usd.Prim,
    colliders: Sequence[Usd.Prim],
    name: str,
) -> tuple[RigidBody, Driver | None, float]:
    """Return a body, its driver, and the driver's index in the scene, infinite if the file has none.

    Args:
        source: The stage.
        prim: Prim of the body.
        colliders: Prims of its geometry.
        name: Name of the body in the scene.
    """
    motion = _motion(source, prim)
    prim_pose, scale = source.frame(prim, Usd.TimeCode(source.start))
    solids = [_solid(source, prim, scale, collider) for collider in colliders]
    solid = _joined(source, solids)
    if isinstance(solid.shape, Plane) and motion is not Motion.FIXED:
        raise source.fault(
            solid.prim, f"is a plane of a {motion} body: planes are fixed"
        )
    pose, driver, index = solid.moved(prim_pose), None, np.inf
    if motion is Motion.KINEMATIC:
        pose, driver, index = read_driven(
            source, prim, name, lambda time: solid.moved(source.frame(prim, time)[0])
        )
    elif motion is Motion.FIXED and len(source.sample_codes(prim)) > 1:
        raise source.fault(
            prim,
            "is a collider that moves without a rigid body: make it a kinematic body",
        )
    velocities = np.zeros((2, 3))
    if motion is Motion.DYNAMIC:
        velocities = _velocities(source, prim, prim_pose, pose, solid.shape)
    body = RigidBody(
        name=name,
        shape=solid.shape,
        motion=motion,
        pose=pose,
        mass_kg=_mass_kg(source, prim, solids, motion),
        linear_velocity_m_per_s=vector(velocities[0]),
        angular_velocity_rad_per_s=vector(velocities[1]),
        inertia_kg_m2=source.number(prim.GetAttribute("gauge:inertia_kg_m2")),
    )
    if motion is Motion.DYNAMIC:
        _check_effects(source, prim, colliders)
        _check_mass_distribution(source, prim, body, solid.pose, scale)
    return body, driver, index


def _check_effects(
    source: Source, body: Usd.Prim, colliders: Sequence[Usd.Prim]
) -> None:
    """Check that no attribute in `UNSUPPORTED` has an effect in other tools."""
    materials = filter(None, map(source.material, colliders))
    for prim in (body, *colliders, *materials):
        for name in UNSUPPORTED:
            attribute = prim.GetAttribute(name)
            value = attribute.Get()
            if value and value != SCHEMA_DEFAULTS.get(name):
                raise source.fault(
                    attribute, f"is {value:g}, which scenes lack: remove it"
                )


def _motion(source: Source, prim: Usd.Prim) -> Motion:
    """Return the motion in UsdPhysics; `gauge:motion` must not contradict it."""
    standard = Motion.FIXED
    if source.is_rigid(prim):
        is_driven = UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr().Get()
        standard = Motion.KINEMATIC if is_driven else Motion.DYNAMIC
    attribute = prim.GetAttribute("gauge:motion")
    exact = source.text(attribute)
    if exact not in (None, standard, attribute.GetCustomDataByKey(WRITTEN)):
        raise source.fault(
            attribute,
            f"is {exact}, but UsdPhysics makes the body {standard}: edit physics:kinematicEnabled or the rigid body",
        )
    return standard


def _velocities(
    source: Source, prim: Usd.Prim, axes: Pose, pose: Pose, shape: Shape
) -> FloatArray:
    """Return the initial velocities of a dynamic body: the doubles, or the standard attributes if they were edited.

    Args:
        source: The stage.
        prim: Prim of the body.
        axes: Pose of the prim; UsdPhysics gives velocities along its axes, see `body_velocities`.
        pose: Pose of the body, which may differ from the pose of the prim.
        shape: Shape of the body.

    Returns:
        Velocity of the body origin [m/s] and angular velocity [rad/s] in the world frame, shape [2, 3].

    """
    api = UsdPhysics.RigidBodyAPI(prim)
    attributes = [api.GetVelocityAttr(), api.GetAngularVelocityAttr()]
    standard = np.array([source.numbers(attribute, (3,)) for attribute in attributes])
    centre_m_per_s, spin_rad_per_s = axes.rotation.apply(
        [source.metres * standard[0], np.radians(standard[1])]
    )
    arm_m = pose.rotation.apply(mass_properties(shape, 1.0)[0])
    world = np.array([centre_m_per_s - np.cross(spin_rad_per_s, arm_m), spin_rad_per_s])
    doubles = [prim.GetAttribute(f"gauge:{name}") for name in VELOCITIES]
    written = doubles[0].GetCustomDataByKey(WRITTEN)
    if written is None:
        return world
    exact = np.array([source.numbers(double, (3,)) for double in doubles])
    # Edited standard attributes replace the doubles.
    return exact if is_written(standard, written) else world


# --- shapes ----------------------------------------------------------------------------------------------------------


def _joined(source: Source, solids: Sequence[Solid]) -> Solid:
    """Return the shape of a body.

    A single sphere, cylinder or plane defines the body frame. Boxes elsewhere, meshes, and several colliders become
    convex pieces in the frame of the prim.
    """
    is_polyhedron = [isinstance(solid.shape, Box | ConvexUnion) for solid in solids]
    if len(solids) == 1 and (not is_polyhedron[0] or solids[0].pose == IDENTITY):
        return solids[0]
    if not all(is_polyhedron):
        collider = solids[is_polyhedron.index(False)].prim
        raise source.fault(
            collider,
            f"is a {collider.GetTypeName()} among other colliders of a body: boxes and meshes are expected",
        )
    pieces_m = [solid.pose.to_world(solid.shape.corners_m) for solid in solids]
    return Solid(solids[0].prim, _polyhedron(pieces_m))


def _polyhedron(pieces_m: Sequence[FloatArray]) -> ConvexUnion:
    return ConvexUnion(pieces_m=tuple(tuple(map(vector, piece)) for piece in pieces_m))


def _solid(
    source: Source, body: Usd.Prim, body_scale: FloatArray, prim: Usd.Prim
) -> Solid:
    """Return the shape of a collider in the unscaled frame of its body."""
    cache = UsdGeom.XformCache(source.start)
    relative, is_reset = cache.ComputeRelativeTransform(prim, body)
    is_animated = UsdGeom.Xformable(prim).TransformMightBeTimeVarying()
    if prim != body and (is_reset or is_animated):
        raise source.fault(prim, f"does not move with its body {body.GetPath()}")
    matrix = np.array(relative).T
    linear = body_scale[:, None] * matrix[:3, :3]
    offset_m = body_scale * matrix[:3, 3]
    rotation, scale = source.decomposed(prim, linear)
    kind = prim.GetTypeName()
    shape: Shape
    if kind == "Mesh":
        vertices_m = _vertices(source, prim, linear, offset_m)
        return Solid(prim, _polyhedron([vertices_m]))
    if kind == "Cube":
        edge_m = UsdGeom.Cube(prim).GetSizeAttr().Get() * scale
        shape = Box(size_m=vector(edge_m))
    elif kind == "Sphere":
        rotation = np.eye(3)
        shape = Sphere(radius_m=_radius_m(source, UsdGeom.Sphere(prim), scale))
    elif kind in ("Cylinder", "Plane"):
        geometry = UsdGeom.Cylinder(prim) or UsdGeom.Plane(prim)
        axis = geometry.GetAxisAttr().Get()
        # The rotation from z to the axis permutes the coordinates.
        rotation = rotation @ np.roll(np.eye(3), "ZXY".index(axis), axis=0)
        shape = Plane()
        if kind == "Cylinder":
            along = "XYZ".index(axis)
            length_m = geometry.GetHeightAttr().Get() * float(scale[along])
            radius_m = _radius_m(source, geometry, np.delete(scale, along))
            shape = Cylinder(radius_m=radius_m, length_m=length_m)
    else:
        raise source.fault(
            prim,
            f"is a collider of type {kind or 'none'}: Cube, Sphere, Cylinder, Plane and Mesh are expected",
        )
    pose = Pose.from_rotation(vector(offset_m), Rotation.from_matrix(rotation))
    if pose_distance(pose, IDENTITY) < SAME_FRAME:
        pose = IDENTITY
    return Solid(prim, shape, pose)


def _radius_m(
    source: Source, geometry: UsdGeom.Sphere | UsdGeom.Cylinder, scale: FloatArray
) -> float:
    """Return the radius of a round collider with scales across it [m per unit]."""
    if np.ptp(scale) > 1e-6 * scale.max():
        prim = geometry.GetPrim()
        raise source.fault(
            prim,
            f"is a {prim.GetTypeName()} with an uneven scale {scale}: scale it evenly, or use a mesh",
        )
    return float(geometry.GetRadiusAttr().Get() * scale[0])


def _vertices(
    source: Source, prim: Usd.Prim, matrix: FloatArray, offset_m: FloatArray
) -> FloatArray:
    """Return the vertices of a convex mesh in its body's frame [m], shape [vertex_count, 3]."""
    mesh, exact = UsdGeom.Mesh(prim), prim.GetAttribute("gauge:points_m")
    stored = source.stored(
        mesh.GetPointsAttr(), (-1, 3), lambda points: points @ matrix.T + offset_m
    )
    try:
        hull = ConvexHull(source.edited(exact, [stored], (-1, 3)))
    except (QhullError, ValueError, IndexError):
        raise source.fault(
            prim, "is flat or has fewer than four vertices: it encloses no volume"
        ) from None
    points_m: FloatArray = hull.points
    attribute = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr()
    approximation = source.text(attribute, APPROXIMATIONS) or "none"
    if approximation != APPROXIMATIONS[0]:
        filled = _volume_m3(mesh, points_m) / hull.volume
        if abs(filled - 1.0) > MAX_CONCAVITY:
            raise source.fault(
                prim,
                f"is not convex (it fills {filled:.3g} of its hull) and its approximation is {approximation!r}: split "
                "it into convex pieces, or set convexHull",
            )
    return points_m if exact else points_m[np.sort(hull.vertices)]


def _volume_m3(mesh: UsdGeom.Mesh, points_m: FloatArray) -> float:
    """Return the volume inside the faces of a mesh [m^3]."""
    counts = mesh.GetFaceVertexCountsAttr().Get()
    indices = mesh.GetFaceVertexIndicesAttr().Get()
    faces = np.split(indices, np.cumsum(counts)[:-1])
    return abs(float(Trimesh(points_m, triangulate_quads(faces)).volume))


# --- mass ------------------------------------------------------------------------------------------------------------


def _mass_kg(
    source: Source, body: Usd.Prim, solids: Sequence[Solid], motion: Motion
) -> float:
    """Return the given mass of a body, or the sum over its colliders [kg]; fixed and driven bodies may have none."""
    given = _authored(source, UsdPhysics.MassAPI(body).GetMassAttr(), source.kilograms)
    value = source.edited(body.GetAttribute("gauge:mass_kg"), [given])
    is_dynamic = motion is Motion.DYNAMIC
    mass_kg = 0.0
    if value is not None:
        mass_kg = float(value)
    elif is_dynamic:
        mass_kg = _colliders_kg(source, body, solids)
    if is_dynamic and mass_kg <= 0.0:
        raise source.fault(
            body, f"its mass is {mass_kg} kg: a positive one is expected"
        )
    return mass_kg


def _colliders_kg(source: Source, body: Usd.Prim, solids: Sequence[Solid]) -> float:
    """Return the mass of colliders [kg] from their density.

    The density of a collider counts first; then those of its body and its material; then 1000 kg/m^3 (UsdPhysics, rigid
    body properties).
    """
    unit = source.kilograms / source.metres**3
    densities = []
    for solid in solids:
        collider, material = UsdPhysics.MassAPI(solid.prim), source.material(solid.prim)
        if _authored(source, collider.GetMassAttr(), 1.0) or not solid.shape.volume_m3:
            raise source.fault(
                solid.prim,
                "has a mass, or encloses no volume: give a size, and the mass to the body",
            )
        schemas = [collider, UsdPhysics.MassAPI(body)]
        if material is not None:
            schemas.append(UsdPhysics.MaterialAPI(material))
        given = (_authored(source, schema.GetDensityAttr(), unit) for schema in schemas)
        values = [float(density.value) for density in given if density is not None]
        densities.append(values[0] if values else DEFAULT_DENSITY_KG_PER_M3)
    if len(set(densities)) > 1:
        raise source.fault(
            body,
            f"has colliders of densities {densities} kg/m^3: give all the same physics:density",
        )
    return sum(solid.shape.volume_m3 for solid in solids) * densities[0]


def _authored(
    source: Source, attribute: Usd.Attribute, unit: float
) -> StoredValue | None:
    """Return a mass or density in SI units; 0 means undefined in UsdPhysics."""
    stored = source.stored(attribute, (), lambda value: value * unit)
    return stored if stored is not None and stored.raw else None


def _check_mass_distribution(
    source: Source, prim: Usd.Prim, body: RigidBody, solid: Pose, scale: FloatArray
) -> None:
    """Check that a given centre of mass and given principal moments of inertia agree with the body.

    Args:
        source: The stage.
        prim: Prim of the body.
        body: The body.
        solid: Pose of the body's frame in the prim's frame.
        scale: Scale of the prim [m per unit], shape [3].
    """
    api = UsdPhysics.MassAPI(prim)
    if not api:
        return
    centre_m, inertia = body_mass_properties(body)
    centre_m = solid.to_world(centre_m)
    moments = np.linalg.eigvalsh(inertia)
    gyration_radius_m = np.sqrt(moments.sum() / 2.0 / body.mass_kg)
    given_m = np.array(api.GetCenterOfMassAttr().Get()) * scale
    unit = source.kilograms * source.metres**2
    given = np.sort(api.GetDiagonalInertiaAttr().Get()) * unit
    # Minus infinity and zeros, the fallbacks of the schema, stand for the values of the colliders.
    if not np.isfinite(given_m).all():
        given_m = centre_m
    if not given.any():
        given = moments
    is_central = length_of(given_m - centre_m) <= UNIFORM_RELATIVE * gyration_radius_m
    if not (is_central and np.allclose(given, moments, UNIFORM_RELATIVE, atol=0.0)):
        raise source.fault(
            prim,
            f"its centre of mass {given_m} m or its moments {given} kg m^2 contradict those of its shape and mass, "
            f"{centre_m} m and {moments.round(6)} kg m^2: remove or correct them",
        )
