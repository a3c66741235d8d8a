"""Measure how well a body, or what is attached to it, follows a driver."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.checks.conformance.laws import PLACE_TOLERANCE_M
from gauge_envs.checks.conformance.model import Measurement
from gauge_envs.checks.rollout import Rollout
from gauge_envs.scene import Pose

__all__ = [
    "attachment_error",
    "driver_error",
    "driver_poses",
]


def driver_poses(rollout: Rollout) -> list[Pose]:
    """Return the pose that the scene's only driver prescribes at each sample."""
    (driver,) = rollout.scene.drivers
    start = rollout.scene.body(driver.body).pose
    return [driver.pose(start, float(time_s)) for time_s in rollout.times_s]


def driver_error(rollout: Rollout, points_m: NDArray[np.float64]) -> Measurement:
    """Measure the largest distance [mm] of points from where the scene's only driver would carry them.

    Args:
        rollout: The rollout.
        points_m: World positions of the points [m], shape [sample_count, point_count, 3].
    """
    (driver,) = rollout.scene.drivers
    places = rollout.scene.body(driver.body).pose.to_body(points_m[0])
    prescribed = np.array([pose.to_world(places) for pose in driver_poses(rollout)])

    def largest_mm(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
        return 1e3 * float(np.linalg.norm(first - second, axis=2).max())

    error = largest_mm(points_m, prescribed)
    shifted = {
        "it comes one interval (1/180 s) late": largest_mm(points_m[1:], prescribed[:-1]),
        "it comes one interval (1/180 s) early": largest_mm(points_m[:-1], prescribed[1:]),
    }
    hint = next((text for text, left in shifted.items() if left < 0.2 * error), "")
    return Measurement(measured=error, expected=0.0, hint=hint)


def attachment_error(rollout: Rollout, name: str) -> Measurement:
    """Measure the largest distance [mm] of a hanging body's upper nodes from their places on the driven body."""
    nodes = rollout.nodes_m[name]
    attached = nodes[0, :, 2] > nodes[0, :, 2].max() - PLACE_TOLERANCE_M
    return driver_error(rollout, nodes[:, attached])
