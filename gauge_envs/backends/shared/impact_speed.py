"""Typical speed of a scene's impacts, for engines whose restitution depends on it. Needs no engine."""

from __future__ import annotations

import numpy as np

from gauge_envs.scene import RigidBody, Scene

SLOWEST_IMPACT_M_PER_S = 0.01
"""Smallest impact speed that a scene gives."""


def impact_speed_m_per_s(scene: Scene) -> float:
    """Return the speed at which a scene's impacts have its restitution, at least 0.01 m/s.

    It is the largest of the speeds after a fall from the start to the floor, and of the drivers' speeds.
    """
    falls = [_fall_speed_m_per_s(scene, body) for body in scene.dynamic_bodies]
    driven = [driver.speed_limit_m_per_s(scene.body(driver.body)) for driver in scene.drivers]
    return max([*falls, *driven, SLOWEST_IMPACT_M_PER_S])


def _fall_speed_m_per_s(scene: Scene, body: RigidBody) -> float:
    lowest = float(body.pose.to_world(body.shape.corners_m)[:, 2].min())
    fall_m = max(lowest - scene.floor_height_m, 0.0)
    speed = float(np.linalg.norm(body.linear_velocity_m_per_s))
    return float(np.sqrt(speed**2 + 2.0 * scene.gravity_m_per_s2 * fall_m))
