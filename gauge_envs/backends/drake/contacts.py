"""Contact constants in Drake's terms, fitted to a given coefficient of restitution of an impact.

Drake has no coefficient of restitution. A contact is a spring with a dissipation, integrated by an implicit scheme that
dissipates too. `rebound` repeats that scheme for one contact normal, and `impact_constants` solves for the constants.

Times are in steps and speeds in incoming speeds. The spring then has one constant, the rate: the natural frequency of
the mass on the spring times the step.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.backends.shared.spring_damper import impact_speed_m_per_s
from gauge_envs.scene import Contact, ContactMode, Scene
from gauge_envs.scene.geometry import BoolArray, FloatArray

ImpactLaw = Literal["relaxation", "hunt_crossley"]
"""`relaxation`: linear spring and damper of the SAP approximation. `hunt_crossley`: damping in proportion to depth."""

PHASES: FloatArray = (np.arange(12, dtype=np.float64) + 0.5) / 12.0
"""Depth at the first step that detects the contact, over the displacement of a step; it depends on the start."""

LARGEST_DISSIPATION = 1e6
"""Largest relaxation time [steps] or dissipation times incoming speed; it stands for no rebound."""

LOWEST_RATE = 2e-4
"""Lowest rate of an impact."""

STEPS = 30.0
"""Steps times the rate after which a contact counts as lasting; a contact without dissipation takes pi."""


@dataclass(frozen=True, kw_only=True)
class ContactConstantsDrake:
    """Constants of one contact of the scene, which all its bodies and therefore all its pairs have.

    Drake combines the stiffness of two bodies in series, k1 k2 / (k1 + k2). A stiffness of mass times frequency squared
    gives each pair the same frequency, since the reduced mass of a pair combines in the same way. Friction combines as
    2 f1 f2 / (f1 + f2), which is f for equal coefficients. Relaxation times add up. Dissipation combines to a weighted
    mean.

    Attributes:
        friction: Coulomb coefficient.
        frequency_rad_per_s: Natural frequency of a pair on its contact spring.
        relaxation_s: Relaxation time of the pair, for the SAP approximation.
        dissipation_s_per_m: Hunt-Crossley dissipation of the pair, for the other approximations.
    """

    friction: float
    frequency_rad_per_s: float
    relaxation_s: float
    dissipation_s_per_m: float


def contact_constants(
    scene: Scene, contact: Contact, settings: SettingsDrake
) -> ContactConstantsDrake:
    """Return the constants of a contact of the scene.

    Impacts against fixed and driven bodies are assumed to be vertical. Gravity reduces their rebound, so the
    dissipation is reduced to compensate.
    """
    step_s = settings.timestep_s
    rate = settings.sustained_rate
    relaxation_steps = settings.sustained_relaxation_steps
    dissipation = settings.sustained_dissipation_s_per_m
    if contact.mode is ContactMode.IMPACT:
        speed = settings.impact_speed_m_per_s or impact_speed_m_per_s(scene)
        dynamic = {body.name for body in scene.dynamic_bodies}
        has_support = not dynamic.issuperset({*contact.first, *contact.second})
        weight = scene.gravity_m_per_s2 * step_s / speed if has_support else 0.0
        is_linear = settings.approximation == "sap"
        law: ImpactLaw = "relaxation" if is_linear else "hunt_crossley"
        rate, relaxation_steps = impact_constants(
            law, contact.restitution, settings.impact_rate, weight
        )
        dissipation = relaxation_steps / speed
    return ContactConstantsDrake(
        friction=contact.friction,
        frequency_rad_per_s=rate / step_s,
        relaxation_s=relaxation_steps * step_s,
        dissipation_s_per_m=dissipation,
    )


def rebound(
    law: ImpactLaw, rate: float, dissipation: float, weight: float = 0.0
) -> FloatArray:
    """Return the ratio of outgoing to incoming speed at the surface for each phase, shape [phase_count].

    Args:
        law: Law of dissipation.
        rate: Natural frequency of the contact times the step.
        dissipation: Relaxation time in steps, or Hunt-Crossley dissipation times the incoming speed.
        weight: Speed that gravity adds towards the surface in a step, over the incoming speed.
    """
    depth, speed = PHASES.copy(), np.full(len(PHASES), -1.0)
    stiffness = rate**2
    leaving: BoolArray = np.zeros(len(PHASES), dtype=bool)
    for _ in range(int(STEPS / rate)):
        free = speed - weight
        if law == "relaxation":
            after = (free + stiffness * depth) / (1.0 + stiffness * (1.0 + dissipation))
            after = np.maximum(after, free)
        else:
            after = _hunt_crossley(depth, free, stiffness, dissipation)
        speed = np.where(leaving, speed, after)
        depth = np.where(leaving, depth, depth - speed)
        leaving |= depth <= 0.0
        if leaving.all():
            break
    return np.where(
        leaving, np.sqrt(speed**2 - 2.0 * weight * np.minimum(depth, 0.0)), 0.0
    )


def _hunt_crossley(
    depth: FloatArray,
    speed: FloatArray,
    stiffness: float,
    dissipation: float,
) -> FloatArray:
    """Return the speed v that solves v = v0 + k (x - v) (1 - d v) where both factors are positive, else v0."""
    linear = 1.0 + stiffness * (1.0 + dissipation * depth)
    constant = speed + stiffness * depth
    # Both factors are positive for the smaller root of k d v^2 - (1 + k + k d x) v + v0 + k x = 0.
    root = np.sqrt(
        np.maximum(linear**2 - 4.0 * stiffness * dissipation * constant, 0.0)
    )
    after = 2.0 * constant / (linear + root)
    return np.where(
        (depth > after) & (dissipation * after < 1.0), np.maximum(after, speed), speed
    )


@lru_cache(maxsize=256)
def impact_constants(
    law: ImpactLaw, restitution: float, rate: float, weight: float = 0.0
) -> tuple[float, float]:
    """Return the rate and the dissipation that give a contact a coefficient of restitution, in the mean over phases.

    The rate is the given rate, unless the scheme alone dissipates more. Then it is reduced until a contact without
    dissipation and gravity has the restitution, at most 0.999.

    Args:
        law: Law of dissipation.
        restitution: Coefficient of restitution, 0 to 1.
        rate: Highest rate.
        weight: Speed that gravity adds towards the surface in a step, over the incoming speed.

    Returns:
        Rate, and relaxation time in steps or Hunt-Crossley dissipation times the incoming speed.
    """

    def excess(dissipation: float) -> float:
        return float(rebound(law, rate, dissipation, weight).mean()) - restitution

    def missing(slower: float) -> float:
        return float(rebound(law, slower, 0.0).mean()) - min(restitution, 0.999)

    if excess(0.0) < 0.0:
        if missing(rate) < 0.0:
            rate = float(brentq(missing, LOWEST_RATE, rate, xtol=1e-9))
        return rate, 0.0
    largest = 1.0
    while excess(largest) > 0.0:
        largest *= 4.0
        if largest > LARGEST_DISSIPATION:
            return rate, LARGEST_DISSIPATION
    return rate, float(brentq(excess, 0.0, largest, xtol=1e-9))
