"""Poses and quaternions turn as SciPy's rotations, which the scene does not import."""

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene.geometry import (
    Pose,
    quaternion_products,
    quaternion_vectors,
    rotation_matrices,
    vector_quaternions,
)


def test_a_pose_turns_as_a_rotation_of_scipy():
    random = np.random.default_rng(0)
    for angles_deg in random.uniform(-200.0, 200.0, (20, 3)):
        pose = Pose.from_euler_deg((0.1, 0.2, 0.3), tuple(angles_deg))
        rotation = Rotation.from_euler("xyz", angles_deg, degrees=True)
        # Sums and products of numbers of at most 1, in the same order.
        close = {"rtol": 0.0, "atol": 1e-15}
        np.testing.assert_allclose(
            pose.quaternion, rotation.as_quat(scalar_first=True), **close
        )
        np.testing.assert_allclose(pose.matrix, rotation.as_matrix(), **close)
        points_m = random.uniform(-1.0, 1.0, (5, 3))
        there_m = rotation.apply(points_m) + pose.position_m
        np.testing.assert_allclose(pose.to_world(points_m), there_m, **close)
        back_m = rotation.apply(points_m - np.array(pose.position_m), inverse=True)
        np.testing.assert_allclose(pose.to_body(points_m), back_m, **close)
        one_m = points_m[0]
        np.testing.assert_allclose(pose.to_world(one_m), there_m[0], **close)


def test_quaternions_of_many_rotations_are_those_of_scipy():
    random = np.random.default_rng(0)
    sizes_rad = np.array([0.0, 5e-4, 1e-2, 1.0, 1.7])[:, None]
    vectors_rad = sizes_rad * random.uniform(-1.0, 1.0, (5, 3))
    other = Rotation.from_quat([0.3, -0.8, 0.4, -0.2])
    rotations = Rotation.from_rotvec(vectors_rad)
    quaternions = vector_quaternions(vectors_rad)
    matrices = rotation_matrices(quaternions)
    product = quaternion_products(quaternions, other.as_quat(scalar_first=True))
    close = {"rtol": 0.0, "atol": 1e-15}
    np.testing.assert_allclose(matrices, rotations.as_matrix(), **close)
    np.testing.assert_allclose(quaternion_vectors(quaternions), vectors_rad, atol=1e-14)
    np.testing.assert_allclose(
        quaternion_vectors(product), (rotations * other).as_rotvec(), atol=1e-14
    )
