"""Reader of the shape and the mass of a USD body from its colliders."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from gauge_envs.scene.bodies import Motion
from gauge_envs.scene.geometry import (
    Box,
    ConvexUnion,
    Cylinder,
    FloatArray,
    Plane,
    Shape,
    Sphere,
)
from gauge_envs.scene.meshes import mass_properties
from gauge_envs.tools.usd.source import Frame, Source, StoredValue, single

OFF_CENTRE_M = 1e-9
"""Largest distance of a collider's centre from its body's origin if it counts as centred [m]."""

CONCAVE = 1e-3
"""Largest relative difference between the volumes of a convex mesh and its hull."""

LENGTHS_M = (1e-9, 1e9)
"""Smallest and largest extent of a solid [m]; other volumes are lost in rounding."""

OVERLAP_M = 1e-5
"""Largest penetration of two pieces of one body [m]; mass would count twice in a larger overlap."""

UNEVEN = 0.01
"""Largest relative difference of a given inertia from that of uniform density, and of a given centre of mass relative
to the radius of gyration."""

TO_Z = {
    "X": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "Z": np.eye(3),
}
"""Rotations from z to an axis."""

HULLS = ("convexHull",)
EXACT = ("none", "meshSimplification", "convexDecomposition")
"""Approximations that keep the mesh's own shape; only a convex mesh is exact with them."""


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Shape of a body, in a shape frame that is fixed in the prim's frame.

    Attributes:
        shape: Shape in the shape frame.
        offset_m: Origin of the shape frame in the unscaled frame of the prim [m], shape [3].
        rotation: Rotation of the shape frame in the frame of the prim, shape [3, 3].
    """

    shape: Shape
    offset_m: FloatArray
    rotation: FloatArray

    @property
    def is_moved(self) -> bool:
        """Whether the shape frame differs from the frame of the prim."""
        return bool(self.offset_m.any()) or not np.array_equal(self.rotation, np.eye(3))


def solid_of(
    source: Source,
    body: Usd.Prim,
    frame: Frame,
    colliders: Sequence[Usd.Prim],
    motion: Motion,
) -> Solid:
    """Return the shape of a body.

    The body frame moves to the centre and axis of a single sphere, cylinder or plane. It does not move to boxes and
    meshes; several of them become one solid of convex pieces.

    Args:
        source: The stage.
        body: Prim of the body.
        frame: Frame of the body at the start.
        colliders: Prims of its geometry.
        motion: Motion of the body.
    """
    solid = _solid(source, body, frame, colliders, motion)
    spans = np.ptp(solid.shape.corners_m, axis=0)
    if not isinstance(solid.shape, Plane) and not (
        LENGTHS_M[0] <= spans.min() <= spans.max() <= LENGTHS_M[1]
    ):
        raise source.fault(
            body,
            f"is {spans.tolist()} m large: {LENGTHS_M[0]:g} to {LENGTHS_M[1]:g} m are expected",
        )
    return solid


def _solid(
    source: Source,
    body: Usd.Prim,
    frame: Frame,
    colliders: Sequence[Usd.Prim],
    motion: Motion,
) -> Solid:
    placed = [_placed(source, body, frame, collider) for collider in colliders]
    if len(placed) == 1 and colliders[0].GetTypeName() != "Mesh":
        return _lone(source, colliders[0], *placed[0], motion)
    pieces = []
    for collider, (matrix, offset) in zip(colliders, placed, strict=True):
        kind = collider.GetTypeName()
        if kind not in ("Cube", "Mesh"):
            raise source.fault(
                collider,
                f"is a {kind} among other colliders of a body: boxes and meshes are expected",
            )
        pieces.append(_vertices(source, collider, matrix, offset))
    if motion is Motion.DYNAMIC:
        _check_apart(source, colliders, pieces)
    shape = ConvexUnion(
        pieces_m=tuple(
            tuple((x, y, z) for x, y, z in piece.tolist()) for piece in pieces
        )
    )
    return Solid(shape=shape, offset_m=np.zeros(3), rotation=np.eye(3))


def _placed(
    source: Source, body: Usd.Prim, frame: Frame, collider: Usd.Prim
) -> tuple[FloatArray, FloatArray]:
    """Return the linear map [3, 3] and the offset [m] from a collider's space to its body's unscaled frame."""
    matrix = source.below(body, collider)
    linear = frame.scale[:, None] * matrix[:3, :3]
    source.decomposed(collider, linear)
    return linear, frame.scale * matrix[:3, 3]


def _lone(
    source: Source,
    prim: Usd.Prim,
    matrix: FloatArray,
    offset: FloatArray,
    motion: Motion,
) -> Solid:
    """Return the shape of a body with a single primitive."""
    kind = str(prim.GetTypeName())
    rotation, scale = source.decomposed(prim, matrix)
    scale = np.abs(scale)
    is_centred = bool(np.abs(offset).max() < OFF_CENTRE_M)
    here = np.zeros(3) if is_centred else offset
    if kind == "Cube":
        if is_centred and np.abs(rotation - np.eye(3)).max() < OFF_CENTRE_M:
            x, y, z = (
                _positive(source, UsdGeom.Cube(prim).GetSizeAttr()) * scale
            ).tolist()
            return Solid(shape=Box(size_m=(x, y, z)), offset_m=here, rotation=np.eye(3))
        corners = _vertices(source, prim, matrix, offset)
        piece = tuple((x, y, z) for x, y, z in corners.tolist())
        return Solid(
            shape=ConvexUnion(pieces_m=(piece,)),
            offset_m=np.zeros(3),
            rotation=np.eye(3),
        )
    if kind == "Sphere":
        radius = _positive(source, UsdGeom.Sphere(prim).GetRadiusAttr()) * _even(
            source, prim, scale
        )
        return Solid(shape=Sphere(radius_m=radius), offset_m=here, rotation=np.eye(3))
    if kind not in ("Cylinder", "Plane"):
        known = "Cube, Sphere, Cylinder, Plane and Mesh are expected"
        raise source.fault(
            prim,
            f"is a collider of type {kind or 'none'}, which a scene does not have: {known}",
        )
    geometry = UsdGeom.Cylinder(prim) if kind == "Cylinder" else UsdGeom.Plane(prim)
    axis = source.text(geometry.GetAxisAttr(), tuple(TO_Z)) or "Z"
    along = "XYZ".index(axis)
    rotation = rotation @ TO_Z[axis]
    # A rotation about its own axis does not change a cylinder or a plane.
    if abs(rotation[2, 2] - 1.0) < 1e-15:
        rotation = np.eye(3)
    if kind == "Plane":
        if motion is not Motion.FIXED:
            raise source.fault(prim, f"is a plane of a {motion} body: planes are fixed")
        return Solid(shape=Plane(), offset_m=here, rotation=rotation)
    radius = _positive(source, geometry.GetRadiusAttr()) * _even(
        source, prim, np.delete(scale, along)
    )
    length = _positive(source, geometry.GetHeightAttr()) * float(scale[along])
    return Solid(
        shape=Cylinder(radius_m=radius, length_m=length),
        offset_m=here,
        rotation=rotation,
    )


def _positive(source: Source, attribute: Usd.Attribute) -> float:
    value = source.number(attribute)
    if value is None or value <= 0.0:
        raise source.fault(attribute, f"is {value}: a positive number is expected")
    return value


def _even(source: Source, prim: Usd.Prim, scale: FloatArray) -> float:
    if np.ptp(scale) > 1e-6 * scale.max():
        raise source.fault(
            prim,
            f"is a {prim.GetTypeName()} with an uneven scale {scale.tolist()}: scale it evenly, or use a mesh",
        )
    return float(scale[0])


def _vertices(
    source: Source, prim: Usd.Prim, matrix: FloatArray, offset: FloatArray
) -> FloatArray:
    """Return the vertices of a convex piece in its body's frame [m], shape [vertex_count, 3]."""
    if prim.GetTypeName() == "Cube":
        edge = _positive(source, UsdGeom.Cube(prim).GetSizeAttr())
        return Box(size_m=(edge, edge, edge)).corners_m @ matrix.T + offset
    mesh, gauge = UsdGeom.Mesh(prim), prim.GetAttribute("gauge:points_m")
    reading = source.reading(
        mesh.GetPointsAttr(), (-1, 3), lambda points: points @ matrix.T + offset
    )
    points = source.counted(gauge, [reading], (-1, 3), rounded=single)
    if points is None:
        raise source.fault(prim, "is a mesh without points")
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise source.fault(
            prim, "is flat or has fewer than four vertices: it encloses no volume"
        ) from None
    approximation = (
        source.text(UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr()) or "none"
    )
    if approximation not in HULLS:
        if approximation not in EXACT:
            raise source.fault(
                prim,
                f"approximation {approximation!r} is not one of {', '.join((*HULLS, *EXACT))}",
            )
        filled = _filled(
            source,
            mesh,
            np.asarray(mesh.GetPointsAttr().Get(), dtype=np.float64) @ matrix.T
            + offset,
        )
        if abs(filled - hull.volume) > CONCAVE * hull.volume:
            raise source.fault(
                prim,
                f"is not convex (it fills {filled / hull.volume:.3g} of its hull) and its approximation is "
                f"{approximation!r}: split it into convex pieces, or set convexHull",
            )
    return (
        points
        if source.numbers(gauge, (-1, 3)) is not None
        else points[np.sort(hull.vertices)]
    )


def _filled(source: Source, mesh: UsdGeom.Mesh, points: FloatArray) -> float:
    """Return the volume inside the faces of a mesh [m^3]."""
    counts, indices = (
        mesh.GetFaceVertexCountsAttr().Get(),
        mesh.GetFaceVertexIndicesAttr().Get(),
    )
    if (
        not counts
        or not indices
        or sum(counts) != len(indices)
        or not 0 <= min(indices) <= max(indices) < len(points)
    ):
        raise source.fault(
            mesh.GetPrim(),
            "its faces do not match its points: correct counts and indices",
        )
    volume, first = 0.0, 0
    for count in counts:
        face = points[np.asarray(indices[first : first + count])]
        fans = np.cross(face[1:-1], face[2:]) @ face[0]
        volume += float(fans.sum()) / 6.0
        first += count
    return abs(volume)


def _check_apart(
    source: Source, prims: Sequence[Usd.Prim], pieces: Sequence[FloatArray]
) -> None:
    """Check that no two pieces overlap."""
    planes = [ConvexHull(piece).equations for piece in pieces]
    for one, other in combinations(range(len(pieces)), 2):
        low = np.maximum(pieces[one].min(axis=0), pieces[other].min(axis=0))
        high = np.minimum(pieces[one].max(axis=0), pieces[other].max(axis=0))
        if (high - low < OVERLAP_M).any():
            continue
        walls = np.concatenate([planes[one], planes[other]])
        # The largest ball inside both: normal . x + radius <= -offset for each wall.
        rows = np.column_stack([walls[:, :3], np.ones(len(walls))])
        deepest = linprog(
            [0.0, 0.0, 0.0, -1.0],
            A_ub=rows,
            b_ub=-walls[:, 3],
            bounds=[(None, None)] * 4,
        )
        if deepest.success and -2.0 * deepest.fun > OVERLAP_M:
            raise source.fault(
                prims[one],
                f"overlaps {prims[other].GetPath()} by {-2e3 * deepest.fun:.3g} mm, so mass would count twice: "
                "separate the pieces of a dynamic body",
            )


# --- mass ------------------------------------------------------------------------------------------------------------


def mass_kg(
    source: Source,
    body: Usd.Prim,
    colliders: Sequence[Usd.Prim],
    solid: Solid,
    frame: Frame,
    motion: Motion,
) -> float:
    """Return the given mass of a body, or density times volume [kg]; 0 for fixed and driven bodies without both."""
    api = UsdPhysics.MassAPI(body)
    given = _authored(source, api.GetMassAttr(), source.kilograms)
    value = source.counted(body.GetAttribute("gauge:mass_kg"), [given])
    mass = (
        float(value)
        if value is not None
        else _from_density(source, body, colliders, solid.shape)
    )
    if mass is None and motion is not Motion.DYNAMIC:
        mass = 0.0
    if mass is None or (motion is Motion.DYNAMIC and mass <= 0.0) or mass < 0.0:
        raise source.fault(
            body,
            "a dynamic body needs a mass: physics:mass or physics:density, of the body or its material"
            if mass is None
            else f"its mass is {mass} kg: a positive number is expected",
        )
    if motion is Motion.DYNAMIC:
        _check_uniform(source, api, solid, frame, mass)
    return mass


def _authored(
    source: Source, attribute: Usd.Attribute, unit: float
) -> StoredValue | None:
    """Read a mass or density; return None if it is 0, which means undefined in UsdPhysics."""
    reading = source.reading(attribute, (), lambda value: value * unit)
    return None if reading is None or float(reading.raw) == 0.0 else reading


def _from_density(
    source: Source, body: Usd.Prim, colliders: Sequence[Usd.Prim], shape: Shape
) -> float | None:
    """Return the mass from collider masses or densities, in the precedence of UsdPhysics."""
    unit = source.kilograms / source.metres**3
    body_density = _authored(source, UsdPhysics.MassAPI(body).GetDensityAttr(), unit)
    if body_density is not None:
        return float(body_density.value) * shape.volume_m3
    apis = [UsdPhysics.MassAPI(collider) for collider in colliders if collider != body]
    masses = [_authored(source, api.GetMassAttr(), source.kilograms) for api in apis]
    if len(masses) == 1 and masses[0] is not None:
        return float(masses[0].value)
    if any(mass is not None for mass in masses):
        raise source.fault(
            body,
            "its colliders have their own masses: give the mass of the whole body, of uniform density",
        )
    densities = []
    for collider in colliders:
        density = _authored(source, UsdPhysics.MassAPI(collider).GetDensityAttr(), unit)
        material = source.material(collider)
        if density is None and material is not None:
            density = _authored(
                source, UsdPhysics.MaterialAPI(material).GetDensityAttr(), unit
            )
        if density is None:
            return None
        densities.append(float(density.value))
    if np.ptp(densities) > 1e-6 * max(densities):
        raise source.fault(
            body, f"its colliders have densities {densities}: one density is expected"
        )
    return densities[0] * shape.volume_m3


def inertia_kg_m2(source: Source, body: Usd.Prim) -> float | None:
    """Return the moment of inertia that a body states in `gauge:inertia_kg_m2` [kg m^2], or None."""
    attribute = body.GetAttribute("gauge:inertia_kg_m2")
    value = source.number(attribute) if attribute else None
    if value is not None and not value > 0.0:
        raise source.fault(
            attribute, f"is {value}: a positive moment of inertia is expected"
        )
    return value


def _check_uniform(
    source: Source, api: UsdPhysics.MassAPI, solid: Solid, frame: Frame, mass: float
) -> None:
    """Check that a given centre of mass and given moments of inertia are those of the body."""
    centre, inertia = mass_properties(solid.shape, mass)
    moment = inertia_kg_m2(source, api.GetPrim())
    inertia = inertia if moment is None else moment * np.eye(3)
    # UsdPhysics gives both in the prim's frame.
    centre, inertia = (
        solid.rotation @ centre + solid.offset_m,
        solid.rotation @ inertia @ solid.rotation.T,
    )
    radius = float(np.sqrt(np.trace(inertia) / 2.0 / mass))
    given = api.GetCenterOfMassAttr()
    # Minus infinity, the fallback of the schema, stands for the centre of the colliders.
    if (
        given
        and given.HasAuthoredValue()
        and np.isfinite(np.asarray(given.Get(), dtype=np.float64)).all()
    ):
        stated = source.numbers(given, (3,))
        if (
            stated is not None
            and np.linalg.norm(stated * frame.scale - centre) > UNEVEN * radius
        ):
            raise source.fault(
                given,
                f"is not the centre {centre.tolist()} m of its geometry: remove it or correct it",
            )
    moments = (
        source.numbers(api.GetDiagonalInertiaAttr(), (3,))
        if api.GetDiagonalInertiaAttr()
        else None
    )
    if moments is None or not moments.any():
        return
    axes = source.numbers(api.GetPrincipalAxesAttr(), (4,))
    rotation = (
        np.eye(3)
        if axes is None or not axes.any()
        else Rotation.from_quat(axes, scalar_first=True).as_matrix()
    )
    stated = (
        rotation @ np.diag(moments * source.kilograms * source.metres**2) @ rotation.T
    )
    if np.abs(stated - inertia).max() > UNEVEN * np.abs(inertia).max():
        known = ", ".join(f"{value:.6g}" for value in np.linalg.eigvalsh(inertia))
        origin = "uniform density" if moment is None else "gauge:inertia_kg_m2"
        raise source.fault(
            api.GetDiagonalInertiaAttr(),
            f"contradicts {origin}, whose moments are ({known}) kg m^2: remove it or correct it",
        )
