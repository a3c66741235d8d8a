"""Meshes of shapes for pictures: closed, of nearly the volume of the shape, and within its bounds."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Part,
    Plane,
    Pose,
    Sphere,
)
from gauge_envs.scene.meshes import hull_faces, prism

BOX = Box(size_m=(0.2, 0.1, 0.05))
PIECE = tuple(map(tuple, np.add(BOX.corners_m, [0.3, 0.0, 0.0]).tolist()))
SHAPES = {
    "box": BOX,
    "sphere": Sphere(radius_m=0.1),
    "cylinder": Cylinder(radius_m=0.05, length_m=0.3),
    "capsule": Capsule(radius_m=0.05, length_m=0.2),
    "ellipsoid": Ellipsoid(radii_m=(0.1, 0.2, 0.05)),
    "pieces": ConvexUnion(pieces_m=(PIECE, tuple(map(tuple, BOX.corners_m.tolist())))),
    "compound": Compound(
        parts=(
            Part(
                shape=Capsule(radius_m=0.05, length_m=0.2),
                pose=Pose(position_m=(0.0, 0.0, 0.5)),
            ),
            Part(
                shape=BOX, pose=Pose.from_euler_deg((0.2, 0.0, 0.0), (0.0, 90.0, 0.0))
            ),
        )
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_mesh_has_volume_and_bounds_of_its_shape(name):
    shape = SHAPES[name]
    mesh = shape.mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(shape.volume_m3, rel=0.02)
    corners = shape.corners_m
    size = np.ptp(corners, axis=0)
    assert np.abs(mesh.bounds[0] - corners.min(axis=0)).max() < 0.02 * size.max()
    assert np.abs(mesh.bounds[1] - corners.max(axis=0)).max() < 0.02 * size.max()


def test_a_plane_is_drawn_below_itself():
    low, high = Plane().mesh().bounds
    assert high[2] == pytest.approx(0.0)
    assert low[2] < 0.0


def test_faces_of_a_hull_are_whole_polygons_that_turn_outward():
    """A frustum of seven unequal sides: two faces of seven corners, and a trapezium between each pair of sides."""
    angles = np.array([0.3, 0.9, 2.0, 2.4, 3.9, 4.6, 5.9])
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(7)])
    points = np.random.default_rng(0).permutation(
        np.concatenate([ring, 0.5 * ring + [0.0, 0.0, 1.0]])
    )
    faces = hull_faces(points)
    assert sorted(map(len, faces)) == [4] * 7 + [7, 7]
    assert all(face[0] == min(face) for face in faces)
    area = 0.0
    for face in faces:
        corners = points[list(face)]
        fans = np.cross(corners[1:-1] - corners[0], corners[2:] - corners[0])
        normal = fans.sum(axis=0)
        assert (fans @ normal > 0.0).all()
        assert normal @ (corners[0] - points.mean(axis=0)) > 0.0
        area += 0.5 * np.linalg.norm(normal)
    assert area == pytest.approx(ConvexHull(points).area)


def test_a_prism_fills_its_cylinder_along_both_axes():
    cylinder = Cylinder(radius_m=0.05, length_m=0.3)
    points = np.array(prism(cylinder).pieces_m[0])
    assert np.ptp(points, axis=0) == pytest.approx([0.1, 0.1, 0.3], rel=1e-12)
    assert ConvexHull(points).volume == pytest.approx(cylinder.volume_m3, rel=1e-3)
