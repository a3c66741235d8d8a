"""Restitution of a spring and damper, for engines without a restitution, and the impact speed of a scene."""

import math

import numpy as np

from gauge_envs.scene import Scene

LARGEST_DAMPING_RATIO = 1e3
"""Damping ratio that stands for no rebound; the spring and damper then gives a restitution of 2.5e-7."""

SLOWEST_IMPACT_M_PER_S = 0.01
"""Smallest impact speed that a scene gives."""


def spring_damper_restitution(damping_ratio: float) -> float:
    """Return the restitution of a mass that hits a linear spring and damper, which push and do not pull.

    The contact ends when the force is zero, before the spring reaches its free length. With the damping ratio z this is
    e = exp(-2 z arccos(z) / sqrt(1 - z^2)). Above 1, arcosh and sqrt(z^2 - 1) replace the functions of z. Gravity
    during the impact is neglected.

    Source: Schwager and Poeschel, Granular Matter 9 (2007) 465, with the angles combined.
    """
    z = damping_ratio
    if abs(z - 1.0) < 1e-9:
        return math.exp(-2.0)
    if z < 1.0:
        return math.exp(-2.0 * z * math.acos(z) / math.sqrt(1.0 - z * z))
    return math.exp(-2.0 * z * math.acosh(z) / math.sqrt(z * z - 1.0))


def damping_ratio_of(restitution: float) -> float:
    """Return the damping ratio z that gives a restitution e (see above), `LARGEST_DAMPING_RATIO` for 0."""
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
    """Return the impact speed [m/s] at which an engine matches a scene's restitution, at least 0.01 m/s.

    It is the largest speed of any fall from the start to the floor and of any prescribed motion.
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
