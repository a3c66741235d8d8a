"""Contact constants with which an impact in Drake's discrete time has a given coefficient of restitution.

Drake has no coefficient of restitution. A contact is a spring with a dissipation, integrated by an implicit scheme that
dissipates too. The functions here repeat that scheme for one contact normal and solve for the constants.

Times are in steps and lengths in step times impact speed. The spring then has one constant, the rate a: the natural
frequency of the mass on the spring times the step.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

__all__ = ["ImpactLaw", "impact_constants", "rebound"]

ImpactLaw = Literal["relaxation", "hunt_crossley"]
"""`relaxation`: linear spring and damper of the SAP approximation. `hunt_crossley`: damping in proportion to depth."""

PHASES: NDArray[np.float64] = (np.arange(12, dtype=np.float64) + 0.5) / 12.0
"""Depth at the first step that detects the contact, over the displacement of a step; the start decides it."""

LARGEST_DISSIPATION = 1e6
"""Largest relaxation time [steps] or dissipation times impact speed; it stands for no rebound at all."""


STEPS = 30.0
"""Steps times the rate after which a contact counts as lasting; without dissipation it takes pi."""


def rebound(law: ImpactLaw, rate: float, dissipation: float) -> NDArray[np.float64]:
    """Return the ratio of outgoing to incoming speed for each phase of the first step, shape [phase_count].

    Args:
        law: Law of dissipation.
        rate: Natural frequency of the contact times the step.
        dissipation: Relaxation time in steps, or Hunt-Crossley dissipation times the incoming speed.
    """
    depth, speed = PHASES.copy(), np.full(len(PHASES), -1.0)
    stiffness = rate**2
    leaving = np.zeros_like(depth, dtype=bool)
    for _ in range(int(STEPS / rate)):
        if law == "relaxation":
            after = (speed + stiffness * depth) / (1.0 + stiffness * (1.0 + dissipation))
            after = np.maximum(after, speed)
        else:
            after = _hunt_crossley(depth, speed, stiffness, dissipation)
        speed = np.where(leaving, speed, after)
        depth = np.where(leaving, depth, depth - speed)
        leaving |= depth <= 0.0
        if leaving.all():
            break
    return np.where(leaving, np.maximum(speed, 0.0), 0.0)


def _hunt_crossley(
    depth: NDArray[np.float64], speed: NDArray[np.float64], stiffness: float, dissipation: float
) -> NDArray[np.float64]:
    """Return the speed v that solves v = v0 + (k x - k v)(1 - d v) where both factors are positive, else v0."""
    quadratic = -stiffness * dissipation
    linear = 1.0 + stiffness * (1.0 + dissipation * depth)
    constant = -(speed + stiffness * depth)
    # The smaller root of d k v^2 - (1 + k + d k x) v + v0 + k x makes both factors positive.
    after = -2.0 * constant / (linear + np.sqrt(np.maximum(linear**2 - 4.0 * quadratic * constant, 0.0)))
    return np.where((depth > after) & (dissipation * after < 1.0), np.maximum(after, speed), speed)


@lru_cache(maxsize=256)
def impact_constants(law: ImpactLaw, restitution: float, rate: float) -> tuple[float, float]:
    """Return the rate and the dissipation with which a contact has a coefficient of restitution.

    The rate is that given, unless the scheme alone dissipates more: then it is reduced until a contact without
    dissipation has the restitution.

    Args:
        law: Law of dissipation.
        restitution: Coefficient of restitution, 0 to 1.
        rate: Highest rate.

    Returns:
        Rate, and relaxation time in steps or Hunt-Crossley dissipation times the incoming speed.
    """

    def excess(rate: float, dissipation: float) -> float:
        return float(rebound(law, rate, dissipation).mean()) - restitution

    if excess(rate, 0.0) < 0.0:
        reachable = min(restitution, 0.999)
        slow = brentq(lambda r: float(rebound(law, r, 0.0).mean()) - reachable, 1e-4, rate, xtol=1e-9)
        return float(slow), 0.0
    if excess(rate, LARGEST_DISSIPATION) > 0.0:
        return rate, LARGEST_DISSIPATION
    largest = 1.0
    while excess(rate, largest) > 0.0:
        largest *= 4.0
    return rate, float(brentq(lambda d: excess(rate, d), 0.0, largest, xtol=1e-9))
