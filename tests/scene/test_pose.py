"""Poses turn points as SciPy's rotations do, which they do not import."""

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene.geometry import Pose


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
