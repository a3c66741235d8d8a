"""Three successive rotations that a driver's sampled poses determine."""

from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs.scene import Pose
from gauge_envs.scene.driver_fit import sampled_motions
from gauge_envs.scene.drivers import Driver

TIMES_S = (0.0, 0.5, 1.0, 1.5, 2.0)
ANGLES_DEG = {"first": 70.0, "second": 10.0, "third": -80.0}
"""Largest angles; only the right order keeps its second angle small."""


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
def test_each_order_of_three_rotations_is_recovered(order):
    start = Pose(position_m=(0.1, -0.2, 0.4))
    letters = "".join("xyz"[axis] for axis in order)
    share = np.divide(TIMES_S, TIMES_S[-1])
    angles_deg = np.outer(share, list(ANGLES_DEG.values()))
    poses = [
        Pose.from_rotation(start.position_m, rotation)
        for rotation in Rotation.from_euler(letters, angles_deg, degrees=True)
    ]
    motions = sampled_motions(start, TIMES_S, poses)
    assert [motion.kind for motion in motions] == ["rotate"] * 3
    assert np.array([motion.axis for motion in motions]) == pytest.approx(
        np.eye(3)[list(order)]
    )
    driver = Driver(body="plate", motions=motions, provenance="")
    for time_s, pose in zip(TIMES_S, poses, strict=True):
        fitted = driver.pose(start, time_s)
        assert (fitted.rotation * pose.rotation.inv()).magnitude() < 1e-9
