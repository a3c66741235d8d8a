"""Impacts for engines without a restitution: that of a spring and a damper, and the speed at which a scene has it."""

import math

import numpy as np

from gauge_envs.scene import Scene

LARGEST_DAMPING_RATIO = 1e3
"""Damping ratio that stands for no rebound; the spring and damper then gives a restitution of 2.5e-7."""

SLOWEST_IMPACT_M_PER_S = 0.01
"""Smallest impact speed that a scene gives."""


def spring_damper_restitution(damping_ratio: float) -> float:
    """Return the restitution of a mass that meets a linear spring and damper which can push and not pull.

    The contact ends when the force is zero, before the spring is at its length. With the damping ratio z this is
    e = exp(-2 z arccos(z) / sqrt(1 - z^2)), and arcosh and sqrt(z^2 - 1) above 1. Gravity during the impact is left
    out.

    Source: Schwager and Poeschel, Granular Matter 9 (2007) 465, with the angles combined.
    """
    z = damping_ratio
    if abs(z - 1.0) < 1e-9:
        return math.exp(-2.0)
    if z < 1.0:
        return math.exp(-2.0 * z * math.acos(z) / math.sqrt(1.0 - z * z))
    return math.exp(-2.0 * z * math.acosh(z) / math.sqrt(z * z - 1.0))


def damping_ratio_of(restitution: float) -> float:
    """Return the damping ratio with which `spring_damper_restitution` is a value; `LARGEST_DAMPING_RATIO` for 0."""
    if restitution >= 1.0:
        return 0.0
    if restitution <= spring_damper_restitution(LARGEST_DAMPING_RATIO):
        return LARGEST_DAMPING_RATIO
    # Most scenes need no root, and the import takes a tenth of a second.
    from scipy.optimize import brentq

    return float(
        brentq(
            lambda z: spring_damper_restitution(z) - restitution,
            0.0,
            LARGEST_DAMPING_RATIO,
            xtol=1e-12,
        )
    )


def impact_speed_m_per_s(scene: Scene) -> float:
    """Return the speed at which a scene's impacts have its restitution, at least 0.01 m/s.

    It is the largest of the speeds after a fall from the start to the floor, and of the drivers' speeds.
    """
    falls = []
    for body in scene.dynamic_bodies:
        lowest = body.heights_m[0]
        fall_m = max(lowest - scene.floor_height_m, 0.0)
        speed = float(np.linalg.norm(body.linear_velocity_m_per_s))
        falls.append(float(np.sqrt(speed**2 + 2.0 * scene.gravity_m_per_s2 * fall_m)))
    driven = [
        driver.speed_limit_m_per_s(scene.body(driver.body)) for driver in scene.drivers
    ]
    return max([*falls, *driven, SLOWEST_IMPACT_M_PER_S])
