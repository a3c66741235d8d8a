"""Contact constants in Drake's terms: stiffness and dissipation of each body in each contact."""

from __future__ import annotations

from dataclasses import dataclass

from gauge_envs.backends.drake.impacts import ImpactLaw, impact_constants
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.backends.shared.impact_speed import impact_speed_m_per_s
from gauge_envs.scene import Contact, ContactMode, Scene


@dataclass(frozen=True, kw_only=True)
class ContactConstants:
    """Constants of one contact of the scene. All bodies in it have them, so that every pair has them.

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


def contact_constants(scene: Scene, contact: Contact, settings: SettingsDrake) -> ContactConstants:
    """Return the constants of a contact of the scene.

    Impacts against bodies that are not dynamic are taken as vertical: gravity reduces their rebound, and the
    dissipation is reduced to make up for it.
    """
    step_s = settings.timestep_s
    if contact.mode is ContactMode.SUSTAINED:
        return ContactConstants(
            friction=contact.friction,
            frequency_rad_per_s=settings.sustained_rate / step_s,
            relaxation_s=settings.sustained_relaxation_steps * step_s,
            dissipation_s_per_m=settings.sustained_dissipation_s_per_m,
        )
    speed = settings.impact_speed_m_per_s or impact_speed_m_per_s(scene)
    dynamic = {body.name for body in scene.dynamic_bodies}
    has_support = not dynamic.issuperset({*contact.first, *contact.second})
    weight = scene.gravity_m_per_s2 * step_s / speed if has_support else 0.0
    law: ImpactLaw = "relaxation" if settings.approximation == "sap" else "hunt_crossley"
    rate, dissipation = impact_constants(law, contact.restitution, settings.impact_rate, weight)
    return ContactConstants(
        friction=contact.friction,
        frequency_rad_per_s=rate / step_s,
        relaxation_s=dissipation * step_s,
        dissipation_s_per_m=dissipation / speed,
    )
