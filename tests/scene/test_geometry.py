"""Poses, shapes and mass properties against SciPy's rotations, MuJoCo's compiler, trimesh and closed forms."""

import numpy as np
import pytest
import trimesh
from rigid import scene_of, solid
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco.model import build_model
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Part,
    Pose,
    Region,
    Sphere,
    body_mass_properties,
    mass_properties,
)
from gauge_envs.scene.geometry import (
    pose_distance,
    quaternion_products,
    quaternion_vectors,
    rotation_matrices,
    vector_quaternions,
)
from gauge_envs.scene.meshes import (
    grid,
    hull_faces,
    hull_triangles,
    nodes_in,
    prism,
    tetrahedra,
)


def union_of(*pieces_m):
    return ConvexUnion(pieces_m=tuple(tuple(map(tuple, piece)) for piece in pieces_m))


BOX = Box(size_m=(0.2, 0.1, 0.05))
SOLIDS = {
    "box": BOX,
    "sphere": Sphere(radius_m=0.1),
    "cylinder": Cylinder(radius_m=0.05, length_m=0.3),
    "capsule": Capsule(radius_m=0.05, length_m=0.2),
    "ellipsoid": Ellipsoid(radii_m=(0.1, 0.2, 0.05)),
    "hull": union_of([(0.0, 0.0, 0.0), (0.06, 0, 0), (0, 0.05, 0), (0, 0, 0.04)]),
}
PLACE = Pose.from_euler_deg((0.1, 0.0, 0.02), (20.0, -40.0, 70.0))


def compound_of(shape):
    """A solid at an angle, with a ball next to it."""
    ball = Part(shape=Sphere(radius_m=0.03), pose=Pose(position_m=(-0.1, 0.05, 0.0)))
    return Compound(parts=(Part(shape=shape, pose=PLACE), ball))


# --- rotations -------------------------------------------------------------------------------------------------------


def test_the_box_around_a_capsule_holds_its_hemispheres():
    corners_m = SOLIDS["capsule"].corners_m
    assert corners_m.max(axis=0) == pytest.approx([0.05, 0.05, 0.15])
    assert corners_m.min(axis=0) == pytest.approx([-0.05, -0.05, -0.15])


def test_a_pose_rotates_as_scipy_does():
    random = np.random.default_rng(0)
    poses, close = [], {"rtol": 0.0, "atol": 2e-15}
    for angles_deg in random.uniform(-200.0, 200.0, (20, 3)):
        pose = Pose.from_euler_deg((0.1, 0.2, 0.3), tuple(angles_deg))
        rotation = Rotation.from_euler("xyz", angles_deg, degrees=True)
        np.testing.assert_allclose(pose.matrix, rotation.as_matrix(), **close)
        points_m = random.uniform(-1.0, 1.0, (5, 3))
        there_m = rotation.apply(points_m) + pose.position_m
        np.testing.assert_allclose(pose.to_world(points_m), there_m, **close)
        back_m = rotation.apply(points_m - np.array(pose.position_m), inverse=True)
        np.testing.assert_allclose(pose.to_body(points_m), back_m, **close)
        poses.append(pose)
    first, second = poses[:2]
    seen = first.relative_to(second).to_world(points_m)
    assert second.to_world(seen) == pytest.approx(first.to_world(points_m))
    turned = Pose.from_rotation((0.1, 0.2, 0.3), first.rotation)
    assert pose_distance(first, turned) == pytest.approx(0.0, abs=1e-9)
    more = Rotation.from_rotvec([0.0, 0.003, 0.004]) * first.rotation
    away = Pose.from_rotation((0.1, 0.2, 0.304), more)
    assert pose_distance(first, away) == pytest.approx(0.005, rel=1e-5)


def test_quaternions_of_many_rotations_are_those_of_scipy():
    random = np.random.default_rng(0)
    sizes_rad = np.array([0.0, 5e-4, 1e-2, 1.0, 1.7])[:, None]
    vectors_rad = sizes_rad * random.uniform(-1.0, 1.0, (5, 3))
    second = Rotation.from_quat([0.3, -0.8, 0.4, -0.2])
    rotations = Rotation.from_rotvec(vectors_rad)
    quaternions = vector_quaternions(vectors_rad)
    product = quaternion_products(quaternions, second.as_quat(scalar_first=True))
    close = {"rtol": 0.0, "atol": 1e-14}
    matrices = rotation_matrices(quaternions)
    np.testing.assert_allclose(matrices, rotations.as_matrix(), **close)
    np.testing.assert_allclose(quaternion_vectors(quaternions), vectors_rad, **close)
    turned = (rotations * second).as_rotvec()
    np.testing.assert_allclose(quaternion_vectors(product), turned, **close)


# --- mass ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SOLIDS)
def test_mass_properties_are_those_of_mujocos_compiler(kind):
    shape = compound_of(SOLIDS[kind])
    scene = scene_of(solid("body", shape, mass_kg=2.0))
    body = build_model(scene, settings_for(scene))[1].body("body")
    centre, inertia = mass_properties(shape, 2.0)
    np.testing.assert_allclose(centre, body.ipos, atol=1e-9)
    axes = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    expected = axes @ np.diag(body.inertia) @ axes.T
    np.testing.assert_allclose(inertia, expected, rtol=1e-6, atol=1e-9)


def test_the_inertia_of_a_right_tetrahedron_is_the_closed_form():
    """Legs a, b, c: variances 3 a^2 / 80, covariances -a b / 80 about the centroid (a, b, c) / 4."""
    legs_m, corner_m = np.array([0.1, 0.2, 0.4]), np.array([0.3, -0.2, 0.5])
    points_m = corner_m + np.vstack([np.zeros(3), np.diag(legs_m)])
    centre_m, inertia = mass_properties(union_of(points_m), 2.0)
    covariance = -np.outer(legs_m, legs_m) / 80.0
    np.fill_diagonal(covariance, 3.0 * legs_m**2 / 80.0)
    expected = 2.0 * (np.trace(covariance) * np.eye(3) - covariance)
    assert centre_m == pytest.approx(corner_m + legs_m / 4.0, abs=1e-9)
    assert inertia == pytest.approx(expected, rel=1e-6)
    # A body may give its moment of inertia, for example a hollow cube.
    hollow = solid("body", union_of(points_m), mass_kg=2.0, inertia_kg_m2=0.7)
    centre_m, inertia = body_mass_properties(hollow)
    assert centre_m == pytest.approx(corner_m + legs_m / 4.0, abs=1e-9)
    np.testing.assert_array_equal(inertia, 0.7 * np.eye(3))


def test_the_centre_of_a_symmetric_mesh_is_0_in_any_order_of_its_points():
    """Engines treat a centre at exactly 0 specially, and the last bits of a sum would miss it."""
    mesh = load_experiment("NonsmoothContact-1-wood").scene.body("pyramid").shape
    expected = mass_properties(mesh, 0.2)[1]
    for seed in range(5):
        points_m = np.random.default_rng(seed).permutation(mesh.pieces_m[0])
        centre, inertia = mass_properties(union_of(points_m), 0.2)
        assert not np.any(centre)
        np.testing.assert_allclose(inertia, expected, rtol=1e-12, atol=1e-18)


# --- meshes ----------------------------------------------------------------------------------------------------------


MESHES = {
    "box": trimesh.creation.box(extents=(0.2, 0.1, 0.05)),
    "sphere": trimesh.creation.icosphere(radius=0.1),
    "cylinder": trimesh.creation.cylinder(radius=0.05, height=0.3),
    "capsule": trimesh.creation.capsule(radius=0.05, height=0.2),
    "ellipsoid": trimesh.creation.icosphere().apply_scale((0.1, 0.2, 0.05)),
    "hull": trimesh.convex.convex_hull(SOLIDS["hull"].corners_m),
}


@pytest.mark.parametrize("kind", SOLIDS)
def test_a_shape_has_the_volume_and_the_bounds_of_its_mesh(kind):
    shape, mesh = SOLIDS[kind], MESHES[kind]
    assert shape.volume_m3 == pytest.approx(mesh.volume, rel=0.02)
    corners = shape.corners_m
    bounds = [corners.min(axis=0), corners.max(axis=0)]
    assert mesh.bounds == pytest.approx(np.array(bounds), abs=0.02 * np.ptp(corners))
    ball = SOLIDS["sphere"].volume_m3 * 0.3**3
    assert compound_of(shape).volume_m3 == pytest.approx(shape.volume_m3 + ball)


def test_a_prism_replaces_a_cylinder_and_has_whole_polygons_that_turn_outward():
    cylinder = SOLIDS["cylinder"]
    points = np.random.default_rng(0).permutation(prism(cylinder).pieces_m[0])
    assert np.ptp(points, axis=0) == pytest.approx([0.1, 0.1, 0.3], rel=1e-12)
    assert ConvexHull(points).volume == pytest.approx(cylinder.volume_m3, rel=1e-3)
    faces = hull_faces(points)
    assert sorted(map(len, faces)) == [4] * 96 + [96, 96]
    assert all(face[0] == min(face) for face in faces)
    first, second, third = hull_triangles(points).transpose(1, 0, 2)
    normals = np.cross(second - first, third - first)
    assert (first * normals).sum(axis=1).min() > 0.0
    area = 0.5 * np.linalg.norm(normals, axis=1).sum()
    assert area == pytest.approx(ConvexHull(points).area)


def test_tetrahedra_of_a_grid_fill_its_box_once_and_are_right_handed():
    nodes, counts = grid(BOX.size_m)
    # Cells are 20 mm; an edge of 2.5 cells has two.
    assert counts == (11, 6, 3)
    assert grid((0.2, 0.1, 0.0))[1] == (11, 6, 1)
    corners = nodes[tetrahedra(counts)]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    assert volumes == pytest.approx(np.full(10 * 5 * 2 * 6, BOX.volume_m3 / 600))
    for side, depth_m, x_m in (("low", 0.0, (-0.1, -0.1)), ("high", 0.04, (0.06, 0.1))):
        inside = nodes[nodes_in(nodes, Region(axis="x", side=side, depth_m=depth_m))]
        assert (inside[:, 0].min(), inside[:, 0].max()) == pytest.approx(x_m)
