"""Meshes of solids and cloth (polyhedra, prisms, regular grids, tetrahedra), and mass properties of solids."""

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gauge_envs.scene.bodies import Cloth, Deformable, Region, RigidBody, Rope, SoftBody
from gauge_envs.scene.geometry import (
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    FloatArray,
    IntArray,
    PartShape,
    Shape,
    Sphere,
)

GRID_SPACING_M = 0.02
"""Edge length of the cells of exported cloth and soft bodies [m]; no physical constant depends on it."""

COPLANAR = 1e-7
"""Largest difference of unit normals and offsets [m] between hull facets of one face."""

TOUCHING_M = 1e-6
"""Largest distance between vertices of two attached bodies that count as one point [m]."""

PRISM_SIDES = 96
"""Number of sides of the prism that replaces a cylinder; its radius is exact within 0.06 %."""


def prism(cylinder: Cylinder) -> ConvexUnion:
    """Return a prism that replaces a cylinder, in the same frame, for engines that collide polyhedra better."""
    angles = 2.0 * np.pi * np.arange(PRISM_SIDES) / PRISM_SIDES
    x, y = cylinder.radius_m * np.cos(angles), cylinder.radius_m * np.sin(angles)
    z = 0.5 * cylinder.length_m
    rings = [
        np.column_stack([x, y, np.full(PRISM_SIDES, height)]) for height in (-z, z)
    ]
    return ConvexUnion(pieces_m=(tuple(map(tuple, np.concatenate(rings).tolist())),))


def hull_faces(points_m: FloatArray) -> list[tuple[int, ...]]:
    """Return the faces of a convex polyhedron as polygons, counter-clockwise seen from outside.

    Faces and their first vertices are in the order of indices, so the result depends only on the solid.

    Args:
        points_m: Vertices [m], shape [vertex_count, 3].
    """
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points_m)
    groups: list[tuple[FloatArray, set[int]]] = []
    for equation, simplex in zip(hull.equations, hull.simplices, strict=True):
        for known, members in groups:
            if np.abs(equation - known).max() < COPLANAR:
                members.update(simplex.tolist())
                break
        else:
            groups.append((equation, set(simplex.tolist())))
    faces = []
    for equation, members in groups:
        indices = np.array(sorted(members))
        arms = points_m[indices] - points_m[indices].mean(axis=0)
        normal = equation[:3]
        angles = np.arctan2(np.cross(arms[0], arms) @ normal, arms @ arms[0])
        faces.append(
            tuple(
                indices[
                    np.argsort(np.where(angles < -1e-9, angles + 2 * np.pi, angles))
                ].tolist()
            )
        )
    return sorted(faces)


def hull_triangles(points_m: FloatArray) -> FloatArray:
    """Return the faces of a convex polyhedron as triangles, counter-clockwise seen from outside.

    Args:
        points_m: Vertices [m], shape [vertex_count, 3].

    Returns:
        Corners of each triangle [m], shape [triangle_count, 3, 3].
    """
    fans = [
        (first, second, third)
        for first, *rest in hull_faces(points_m)
        for second, third in pairwise(rest)
    ]
    return points_m[np.array(fans)]


def grid(size_m: tuple[float, float, float]) -> tuple[FloatArray, tuple[int, int, int]]:
    """Return the nodes of a grid about the origin [m], shape [node_count, 3], and their count along each axis."""
    counts = [
        max(round(edge / GRID_SPACING_M), 1) + 1 if edge else 1 for edge in size_m
    ]
    axes = [
        np.linspace(-0.5 * edge, 0.5 * edge, count) if edge else np.zeros(1)
        for edge, count in zip(size_m, counts, strict=True)
    ]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return nodes, (counts[0], counts[1], counts[2])


def tetrahedra(shape: tuple[int, int, int]) -> IntArray:
    """Return six tetrahedra per grid cell about the same diagonal, so that the faces of neighbouring cells match."""
    numbers = np.arange(np.prod(shape)).reshape(shape)
    cells = sliding_window_view(numbers, (2, 2, 2))
    # Each path of three edges from the low to the high corner is a tetrahedron. Every second path is left-handed.
    corners = []
    for axes in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (2, 1, 0), (0, 2, 1)):
        edges = np.eye(3, dtype=int)[list(axes)]
        path = np.cumsum([(0, 0, 0), *edges], axis=0)
        if np.linalg.det(edges) < 0.0:
            path[[1, 2]] = path[[2, 1]]
        corners.append(cells[(..., *path.T)])
    return np.stack(corners, axis=-2).reshape(-1, 4)


def nodes_in(nodes_m: FloatArray, region: Region) -> IntArray:
    """Return the indices of the nodes in an end region of their body; nodes at the end always belong to it."""
    along = nodes_m[:, "xyz".index(region.axis)]
    depth = along - along.min() if region.side == "low" else along.max() - along
    return np.flatnonzero(depth <= region.depth_m + TOUCHING_M)


def mass_properties(
    shape: Shape | PartShape, mass_kg: float
) -> tuple[FloatArray, FloatArray]:
    """Return the centre of mass and the inertia of a uniform solid.

    Returns:
        Centre of mass in the body frame [m], shape [3], and inertia about it in the body's axes [kg m^2], shape [3, 3].
    """
    if isinstance(shape, Box):
        x, y, z = np.square(shape.size_m)
        return np.zeros(3), mass_kg / 12.0 * np.diag([y + z, x + z, x + y])
    if isinstance(shape, Sphere):
        return np.zeros(3), 0.4 * mass_kg * shape.radius_m**2 * np.eye(3)
    if isinstance(shape, Cylinder):
        across = (3.0 * shape.radius_m**2 + shape.length_m**2) / 12.0
        return np.zeros(3), mass_kg * np.diag([across, across, 0.5 * shape.radius_m**2])
    if isinstance(shape, ConvexUnion):
        corners_m = np.concatenate(
            [_tetrahedra(np.asarray(piece)) for piece in shape.pieces_m]
        )
        volumes_m3 = np.abs(np.linalg.det(corners_m[:, 1:] - corners_m[:, :1])) / 6.0
        masses_kg = mass_kg * volumes_m3 / volumes_m3.sum()
        # Engines treat a centre of mass at exactly 0 specially. Rounding removes the last bits of the sums.
        centre = np.round(masses_kg @ corners_m.mean(axis=1) / mass_kg, 12) + 0.0
        arms_m = corners_m - centre
        sums_m = arms_m.sum(axis=1)
        # Second moments of a uniform tetrahedron with corners r: m / 20 (sum of r r^T + s s^T), with s the sum of r.
        second = np.einsum("t,tci,tcj->ij", masses_kg / 20.0, arms_m, arms_m)
        second += np.einsum("t,ti,tj->ij", masses_kg / 20.0, sums_m, sums_m)
        return centre, np.trace(second) * np.eye(3) - second
    if isinstance(shape, Capsule):
        return np.zeros(3), _capsule_inertia(shape, mass_kg / shape.volume_m3)
    if isinstance(shape, Ellipsoid):
        x, y, z = np.square(shape.radii_m)
        return np.zeros(3), mass_kg / 5.0 * np.diag([y + z, x + z, x + y])
    if isinstance(shape, Compound):
        return _compound_properties(shape, mass_kg)
    return np.zeros(3), np.zeros((3, 3))


def _tetrahedra(points_m: FloatArray) -> FloatArray:
    """Return tetrahedra that fill the convex hull of points [m], corners of shape [tetrahedron_count, 4, 3]."""
    from scipy.spatial import ConvexHull

    faces_m = points_m[ConvexHull(points_m).simplices]
    inner = np.broadcast_to(points_m.mean(axis=0), (len(faces_m), 1, 3))
    return np.concatenate([inner, faces_m], axis=1)


def body_mass_properties(body: RigidBody) -> tuple[FloatArray, FloatArray]:
    """Return the centre of mass and the inertia of a rigid body; see `mass_properties`.

    If `inertia_kg_m2` is given, it is the inertia about the centre of the uniform solid.
    """
    centre, inertia = mass_properties(body.shape, body.mass_kg)
    moment_kg_m2 = body.inertia_kg_m2
    if moment_kg_m2 is None:
        return centre, inertia
    return centre, moment_kg_m2 * np.eye(3)


def _compound_properties(
    shape: Compound, mass_kg: float
) -> tuple[FloatArray, FloatArray]:
    masses_kg, places_m = [], []
    inertia = np.zeros((3, 3))
    for part in shape.parts:
        masses_kg.append(mass_kg * part.shape.volume_m3 / shape.volume_m3)
        place, own = mass_properties(part.shape, masses_kg[-1])
        places_m.append(part.pose.to_world(place))
        inertia += part.pose.matrix @ own @ part.pose.matrix.T
    centre = np.average(places_m, axis=0, weights=masses_kg)
    for mass, arm in zip(masses_kg, places_m - centre, strict=True):
        inertia += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return centre, inertia


def _capsule_inertia(shape: Capsule, density_kg_per_m3: float) -> FloatArray:
    radius, length = shape.radius_m, shape.length_m
    tube = density_kg_per_m3 * np.pi * radius**2 * length
    ball = density_kg_per_m3 * 4.0 / 3.0 * np.pi * radius**3
    along = 0.5 * tube * radius**2 + 0.4 * ball * radius**2
    # The centre of a hemisphere lies 3/8 of the radius beyond the end of the cylinder.
    across = tube * (3.0 * radius**2 + length**2) / 12.0
    across += ball * (0.4 * radius**2 + 0.25 * length**2 + 0.375 * radius * length)
    return np.diag([across, across, along])


def outline_m(body: Deformable) -> FloatArray:
    """Return the corners of a deformable body at the start [m], shape [8, 3]."""
    if isinstance(body, SoftBody):
        box = body.shape
    elif isinstance(body, Cloth):
        box = Box(size_m=(*body.size_m, 0.0))
    elif isinstance(body, Rope):
        box = Box(size_m=(body.length_m, 0.0, 0.0))
    else:
        box = Box(size_m=(0.0, 0.0, body.length_m))
    return body.pose.to_world(box.corners_m)
