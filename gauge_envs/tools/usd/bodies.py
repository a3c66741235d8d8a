"""Reader of rigid bodies of a USD stage: motion, shape, mass and start."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdPhysics
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

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
)
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, length_of, vector
from gauge_envs.tools.usd.driven import read_driven
from gauge_envs.tools.usd.layer import WRITTEN
from gauge_envs.tools.usd.source import Frame, Source, StoredValue
from gauge_envs.tools.usd.velocities import read_velocities

SAME_FRAME = 1e-9
"""Largest distance [m] and difference of rotation matrices at which a collider's frame is that of its body."""

MAX_CONCAVITY = 1e-3
"""Largest relative difference between the volumes of a convex mesh and its hull."""

UNIFORM_RELATIVE = 0.01
"""Largest relative difference of a given inertia from that of uniform density, and of a given centre of mass relative
to the radius of gyration."""

IDENTITY = Pose(position_m=(0.0, 0.0, 0.0))

TO_Z = {
    "X": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "Z": np.eye(3),
}
"""Rotations from z to an axis."""

APPROXIMATIONS = ("convexHull", "none", "meshSimplification", "convexDecomposition")
"""Approximations of meshes; all but the first keep the mesh's own shape, which must be convex."""


@dataclass(frozen=True, kw_only=True)
class Solid:
    """A shape, and the pose of its frame in the unscaled frame of the body's prim."""

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
    welded: Collection[Sdf.Path],
) -> tuple[RigidBody, Driver | None, int | None]:
    """Return a body with its driver, and the driver's index in the scene if the file has it.

    Args:
        source: The stage.
        prim: Prim of the body.
        colliders: Prims of its geometry.
        name: Name of the body in the scene.
        welded: Paths of the bodies that joints fix to the world.
    """
    motion = _motion(source, prim, is_welded=prim.GetPath() in welded)
    frame = source.frame(prim, Usd.TimeCode(source.start))
    solids = [_solid(source, prim, frame, collider) for collider in colliders]
    solid = _joined(source, colliders, solids)
    if isinstance(solid.shape, Plane) and motion is not Motion.FIXED:
        raise source.fault(
            colliders[0], f"is a plane of a {motion} body: planes are fixed"
        )

    def pose_at(time: Usd.TimeCode) -> Pose:
        return solid.moved(source.frame(prim, time).pose)

    driver, index = None, None
    if motion is Motion.KINEMATIC:
        pose, driver, index = read_driven(source, prim, name, pose_at)
    else:
        pose = pose_at(Usd.TimeCode(source.start))
        if motion is Motion.FIXED and len(source.sample_codes(prim)) > 1:
            raise source.fault(
                prim,
                "is a collider that moves without a rigid body: make it a kinematic body",
            )
    body = RigidBody(
        name=name,
        shape=solid.shape,
        motion=motion,
        pose=pose,
        mass_kg=_mass_kg(source, prim, colliders, solids, motion),
        inertia_kg_m2=source.number(prim.GetAttribute("gauge:inertia_kg_m2")),
    )
    if motion is Motion.DYNAMIC:
        _check_mass_distribution(source, prim, body, solid.pose, frame.scale)
        linear, angular = read_velocities(source, prim, frame.pose, pose, solid.shape)
        body = replace(
            body,
            linear_velocity_m_per_s=vector(linear),
            angular_velocity_rad_per_s=vector(angular),
        )
    return body, driver, index


def _motion(source: Source, prim: Usd.Prim, *, is_welded: bool) -> Motion:
    """Return the motion of `gauge:motion` or of UsdPhysics, the edited one."""
    standard = Motion.FIXED
    if source.is_rigid(prim) and not is_welded:
        is_driven = UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr().Get()
        standard = Motion.KINEMATIC if is_driven else Motion.DYNAMIC
    attribute = prim.GetAttribute("gauge:motion")
    exact = source.text(attribute, tuple(Motion))
    written = attribute.GetCustomDataByKey(WRITTEN) if attribute else None
    if exact in (None, standard, written):
        return standard
    if standard != written:
        raise source.fault(
            attribute,
            f"is {exact}, but UsdPhysics makes the body {standard}: make them agree",
        )
    return Motion(exact)


# --- shapes ----------------------------------------------------------------------------------------------------------


def _joined(
    source: Source, colliders: Sequence[Usd.Prim], solids: Sequence[Solid]
) -> Solid:
    """Return the shape of a body.

    A single sphere, cylinder or plane defines the body frame. Boxes elsewhere, meshes, and several colliders become
    convex pieces in the frame of the prim.
    """
    first = solids[0]
    is_polyhedron = [isinstance(solid.shape, Box | ConvexUnion) for solid in solids]
    if len(solids) == 1 and (not is_polyhedron[0] or first.pose == IDENTITY):
        return first
    if not all(is_polyhedron):
        collider = colliders[is_polyhedron.index(False)]
        raise source.fault(
            collider,
            f"is a {collider.GetTypeName()} among other colliders of a body: boxes and meshes are expected",
        )
    pieces = [solid.pose.to_world(solid.shape.corners_m) for solid in solids]
    return Solid(shape=_polyhedron(pieces))


def _polyhedron(pieces_m: Sequence[FloatArray]) -> ConvexUnion:
    return ConvexUnion(pieces_m=tuple(tuple(map(vector, piece)) for piece in pieces_m))


def _solid(source: Source, body: Usd.Prim, frame: Frame, prim: Usd.Prim) -> Solid:
    """Return the shape of a collider in the unscaled frame of its body."""
    cache = UsdGeom.XformCache(source.start)
    relative, is_reset = cache.ComputeRelativeTransform(prim, body)
    is_animated = UsdGeom.Xformable(prim).TransformMightBeTimeVarying()
    if prim != body and (is_reset or is_animated):
        raise source.fault(prim, f"does not move with its body {body.GetPath()}")
    matrix = np.array(relative).T
    linear = frame.scale[:, None] * matrix[:3, :3]
    offset_m = frame.scale * matrix[:3, 3]
    rotation, scale = source.decomposed(prim, linear)
    scale = np.abs(scale)
    kind = str(prim.GetTypeName())
    if kind == "Mesh":
        return Solid(shape=_polyhedron([_vertices(source, prim, linear, offset_m)]))
    shape: Shape
    if kind == "Cube":
        edge_m = _positive(source, UsdGeom.Cube(prim).GetSizeAttr()) * scale
        shape = Box(size_m=vector(edge_m))
    elif kind == "Sphere":
        rotation = np.eye(3)
        shape = Sphere(radius_m=_radius_m(source, UsdGeom.Sphere(prim), scale))
    elif kind in ("Cylinder", "Plane"):
        geometry = UsdGeom.Cylinder(prim) or UsdGeom.Plane(prim)
        axis = source.text(geometry.GetAxisAttr(), tuple(TO_Z)) or "Z"
        rotation = rotation @ TO_Z[axis]
        # A rotation about its own axis does not change a cylinder or a plane.
        if abs(rotation[2, 2] - 1.0) < 1e-15:
            rotation = np.eye(3)
        shape = Plane()
        if kind == "Cylinder":
            along = "XYZ".index(axis)
            length_m = _positive(source, geometry.GetHeightAttr()) * float(scale[along])
            radius_m = _radius_m(source, geometry, np.delete(scale, along))
            shape = Cylinder(radius_m=radius_m, length_m=length_m)
    else:
        raise source.fault(
            prim,
            f"is a collider of type {kind or 'none'}: Cube, Sphere, Cylinder, Plane and Mesh are expected",
        )
    if np.abs(offset_m).max() < SAME_FRAME:
        offset_m = np.zeros(3)
    if np.abs(rotation - np.eye(3)).max() < SAME_FRAME:
        rotation = np.eye(3)
    turn = Rotation.from_matrix(rotation)
    return Solid(shape=shape, pose=Pose.from_rotation(vector(offset_m), turn))


def _positive(source: Source, attribute: Usd.Attribute) -> float:
    value = source.number(attribute)
    if value is None or value <= 0.0:
        raise source.fault(attribute, f"is {value}: a positive number is expected")
    return value


def _radius_m(
    source: Source, geometry: UsdGeom.Sphere | UsdGeom.Cylinder, scale: FloatArray
) -> float:
    """Return the radius of a round collider with scales across it [m per unit]."""
    if np.ptp(scale) > 1e-6 * scale.max():
        raise source.fault(
            geometry.GetPrim(),
            f"is a {geometry.GetPrim().GetTypeName()} with an uneven scale {scale.tolist()}: scale it evenly, or use a "
            "mesh",
        )
    return _positive(source, geometry.GetRadiusAttr()) * float(scale[0])


def _vertices(
    source: Source, prim: Usd.Prim, matrix: FloatArray, offset_m: FloatArray
) -> FloatArray:
    """Return the vertices of a convex mesh in its body's frame [m], shape [vertex_count, 3]."""
    mesh, exact = UsdGeom.Mesh(prim), prim.GetAttribute("gauge:points_m")
    stored = source.stored(
        mesh.GetPointsAttr(), (-1, 3), lambda points: points @ matrix.T + offset_m
    )
    points = source.edited(exact, [stored], (-1, 3))
    try:
        hull = ConvexHull(np.empty((0, 3)) if points is None else points)
    except (QhullError, ValueError):
        raise source.fault(
            prim, "is flat or has fewer than four vertices: it encloses no volume"
        ) from None
    assert points is not None
    api = UsdPhysics.MeshCollisionAPI(prim)
    approximation = source.text(api.GetApproximationAttr(), APPROXIMATIONS) or "none"
    if approximation != APPROXIMATIONS[0]:
        filled = _volume(source, mesh, points) / hull.volume
        if abs(filled - 1.0) > MAX_CONCAVITY:
            raise source.fault(
                prim,
                f"is not convex (it fills {filled:.3g} of its hull) and its approximation is {approximation!r}: split "
                "it into convex pieces, or set convexHull",
            )
    return points if exact else points[np.sort(hull.vertices)]


def _volume(source: Source, mesh: UsdGeom.Mesh, points: FloatArray) -> float:
    """Return the volume inside the faces of a mesh, by the tetrahedra of the triangles with the origin."""
    counts = mesh.GetFaceVertexCountsAttr().Get() or []
    indices = mesh.GetFaceVertexIndicesAttr().Get() or []
    is_valid, reason = UsdGeom.Mesh.ValidateTopology(indices, counts, len(points))
    if not is_valid:
        raise source.fault(mesh.GetPrim(), f"its faces do not match: {reason}")
    triangles = [
        (face[0], *edge)
        for face in np.split(indices, np.cumsum(counts)[:-1])
        for edge in pairwise(face[1:])
    ]
    return abs(float(np.linalg.det(points[np.array(triangles)]).sum())) / 6.0


# --- mass ------------------------------------------------------------------------------------------------------------


def _mass_kg(
    source: Source,
    body: Usd.Prim,
    colliders: Sequence[Usd.Prim],
    solids: Sequence[Solid],
    motion: Motion,
) -> float:
    """Return the given mass of a body, or the sum over its colliders [kg]; fixed and driven bodies may have none."""
    given = _authored(source, UsdPhysics.MassAPI(body).GetMassAttr(), source.kilograms)
    value = source.edited(body.GetAttribute("gauge:mass_kg"), [given])
    if motion is not Motion.DYNAMIC:
        return 0.0 if value is None else float(value)
    if value is None:
        return _mass_of_colliders_kg(source, body, colliders, solids)
    if value <= 0.0:
        raise source.fault(body, f"its mass is {value} kg: a positive one is expected")
    return float(value)


def _mass_of_colliders_kg(
    source: Source,
    body: Usd.Prim,
    colliders: Sequence[Usd.Prim],
    solids: Sequence[Solid],
) -> float:
    """Return the sum of the masses of colliders [kg], given or from densities in the precedence of UsdPhysics."""
    unit = source.kilograms / source.metres**3
    masses_kg, densities = [], []
    for collider, solid in zip(colliders, solids, strict=True):
        volume_m3 = solid.shape.volume_m3
        api, material = UsdPhysics.MassAPI(collider), source.material(collider)
        holders = [api, UsdPhysics.MassAPI(body), UsdPhysics.MaterialAPI(material)]
        given = [
            _authored(source, api.GetMassAttr(), source.kilograms / volume_m3),
            *(_authored(source, one.GetDensityAttr(), unit) for one in holders if one),
        ]
        density = next((float(one.value) for one in given if one is not None), None)
        if density is None:
            raise source.fault(
                body,
                "a dynamic body needs a mass: physics:mass or physics:density, of the body or its material",
            )
        densities.append(density)
        masses_kg.append(density * volume_m3)
    if np.ptp(densities) > 1e-6 * max(densities):
        raise source.fault(
            body, f"its colliders have densities {densities}: one density is expected"
        )
    return sum(masses_kg)


def _authored(
    source: Source, attribute: Usd.Attribute, unit: float
) -> StoredValue | None:
    """Return a mass or density in SI units; 0 means undefined in UsdPhysics."""
    stored = source.stored(attribute, (), lambda value: value * unit)
    return stored if stored is not None and stored.raw else None


def _check_mass_distribution(
    source: Source, prim: Usd.Prim, body: RigidBody, solid: Pose, scale: FloatArray
) -> None:
    """Check that a given centre of mass and given principal moments of inertia are those of the body.

    Args:
        source: The stage.
        prim: Prim of the body.
        body: The body.
        solid: Pose of the body's frame in the prim's frame.
        scale: Scale of the prim [m per unit], shape [3].
    """
    api = UsdPhysics.MassAPI(prim)
    centre_m, inertia = body_mass_properties(body)
    expected_m = solid.to_world(centre_m)
    expected = np.linalg.eigvalsh(inertia)
    radius_m = np.sqrt(expected.sum() / 2.0 / body.mass_kg)
    centre, moments = api.GetCenterOfMassAttr(), api.GetDiagonalInertiaAttr()
    # Minus infinity, the fallback of the schema, stands for the centre of the colliders.
    if centre and np.isfinite(centre.Get()).all():
        apart_m = length_of(np.array(centre.Get()) * scale - expected_m)
        if apart_m > UNIFORM_RELATIVE * radius_m:
            raise source.fault(
                centre,
                f"is not the centre {expected_m.tolist()} m of its geometry: remove it or correct it",
            )
    stored = source.numbers(moments, (3,))
    # Zeros, the fallback of the schema, stand for the inertia of the colliders.
    if stored is None or not stored.any():
        return
    stated = np.sort(stored) * source.kilograms * source.metres**2
    if np.abs(stated - expected).max() > UNIFORM_RELATIVE * expected.max():
        origin = (
            "uniform density" if body.inertia_kg_m2 is None else "gauge:inertia_kg_m2"
        )
        raise source.fault(
            moments,
            f"contradicts {origin}, whose moments are {expected.round(6)} kg m^2: remove it or correct it",
        )
