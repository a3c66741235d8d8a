"""How well a body, or what is glued to it, follows a driver."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gauge_envs.checks.conformance.kit import Measurement
from gauge_envs.checks.conformance.laws import PLACE_TOLERANCE_M
from gauge_envs.checks.rollout import Course

__all__ = [
    "following_reading",
    "pinned_reading",
]


def following_reading(course: Course, points_m: Callable[[int], NDArray[np.float64]]) -> Measurement:
    """Largest distance [mm] of points from where the scene's only driver would carry them.

    Args:
        course: What happened.
        points_m: World positions of the points at a sample [m], shape [point_count, 3].
    """
    (motion,) = course.scene.drivers
    count = len(course.times_s)
    places = course.scene.body(motion.body).pose.to_body(points_m(0))
    asked = np.array([course.driven_pose(motion, sample).to_world(places) for sample in range(count)])
    actual = np.array([points_m(sample) for sample in range(count)])

    def worst_mm(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
        return 1e3 * float(np.linalg.norm(first - second, axis=2).max())

    miss = worst_mm(actual, asked)
    shifted = {
        "it comes one interval (1/180 s) late": worst_mm(actual[1:], asked[:-1]),
        "it comes one interval (1/180 s) early": worst_mm(actual[:-1], asked[1:]),
    }
    hint = next((text for text, left in shifted.items() if left < 0.2 * miss), "")
    return Measurement(measured=miss, expected=0.0, hint=hint)


def pinned_reading(course: Course, name: str) -> Measurement:
    """Largest distance [mm] of a node of a hanging body's upper end from its place on the body that drives it."""
    nodes = course.nodes_m[name]
    held = nodes[0, :, 2] > nodes[0, :, 2].max() - PLACE_TOLERANCE_M
    return following_reading(course, lambda sample: nodes[sample, held])
