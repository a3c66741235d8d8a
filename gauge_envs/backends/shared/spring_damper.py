"""Restitution of a penalty contact, for engines that have a spring and a damper in place of it. Needs no engine."""

from __future__ import annotations

import math

LARGEST_DAMPING_RATIO = 1e3
"""Damping ratio that stands for no rebound; the spring and damper then gives a restitution of 2.5e-7."""


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

    return float(brentq(lambda z: spring_damper_restitution(z) - restitution, 0.0, LARGEST_DAMPING_RATIO, xtol=1e-12))
