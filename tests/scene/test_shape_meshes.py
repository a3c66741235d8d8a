"""Meshes of shapes for pictures: closed, of nearly the volume of the shape, and within its bounds."""

import numpy as np
import pytest

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
def test_a_mesh_has_volume_and_bounds_of_its_shape(name: str) -> None:
    shape = SHAPES[name]
    mesh = shape.mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(shape.volume_m3, rel=0.02)
    corners = shape.corners_m
    size = np.ptp(corners, axis=0)
    assert np.abs(mesh.bounds[0] - corners.min(axis=0)).max() < 0.02 * size.max()
    assert np.abs(mesh.bounds[1] - corners.max(axis=0)).max() < 0.02 * size.max()


def test_a_plane_is_drawn_below_itself() -> None:
    low, high = Plane().mesh().bounds
    assert high[2] == pytest.approx(0.0)
    assert low[2] < 0.0
