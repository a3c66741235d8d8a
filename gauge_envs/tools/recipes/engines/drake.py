"""Drake's point contact: stiffness and dissipation of geometries."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field
from scipy.optimize import brentq

from gauge_envs.backends.drake.contacts import rebound
from gauge_envs.backends.shared.spring_damper import damping_ratio_of
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.probes import DROP_M

RATES = np.geomspace(0.5, 0.01, 60)
"""Natural frequency of a contact times the step, from hard to soft. Above 0.5 a rebound depends on its phase most."""

LONGEST_IMPACT_S = 0.1
"""Longest impact [s], pi over the natural frequency. At 2 m/s a body then sinks in by 63 mm."""

RIGID_RATE = 1.0
"""The same without rebound, as in the backend's sustained contacts."""

MOST_RELAXATION_STEPS = 100.0
"""Largest relaxation time [steps]."""

MARGIN = 0.8
"""Share of the allowed depth that settings aim at."""


class DrakeSettings(ContactSettings):
    """Contact properties of a body, on ground that is much stiffer. The contact approximation is SAP.

    Attributes:
        friction: Static and dynamic coefficient of friction.
        point_contact_stiffness: Stiffness of all contact points of the body together [N/m].
        relaxation_time: Relaxation time of the pair [s].
    """

    engine: ClassVar[str] = "drake"
    is_soft: ClassVar[bool] = True
    preset: ClassVar[str] = "point"
    limits: ClassVar[dict[str, str]] = {
        "restitution": "Drake has no coefficient of restitution: a rebound is a spring, and Drake's implicit steps "
        "dissipate the more, the stiffer the spring is for the step",
        "penetration_m": "Drake's contact is a spring: its depth at rest is the weight over the stiffness, and a "
        "rebound needs a soft spring",
        "friction": "on a contact that is soft for the step, the plate has not settled within the slide",
    }
    template: ClassVar[str] = """\
from pydrake.geometry import AddContactMaterial, ProximityProperties
from pydrake.multibody.plant import ContactModel, CoulombFriction, DiscreteContactApproximation

TIME_STEP = {timestep_s}  # AddMultibodyPlantSceneGraph(builder, TIME_STEP)

def properties(point_count=1, is_ground=False):
    # Drake gives a pair of geometries one contact point: put spheres at the corners of a box.
    friction = CoulombFriction({friction}, {friction})
    stiffness = 1e20 if is_ground else {point_contact_stiffness} / point_count
    found = ProximityProperties()
    AddContactMaterial(found, point_stiffness=stiffness, friction=friction)
    relaxation = 0.0 if is_ground else {relaxation_time}  # those of a pair add up
    found.AddProperty("material", "relaxation_time", relaxation)
    return found

def set_contact(plant):
    plant.set_contact_model(ContactModel.kPoint)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
"""

    friction: float = Field(default=0.0, ge=0.0)
    point_contact_stiffness: float = Field(default=1e6, gt=0.0)
    relaxation_time: float = Field(default=0.1, ge=0.0)

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the hardest contact that rebounds enough in Drake's implicit steps, with the dissipation left."""
        step = aim.timestep_s
        depth_m = aim.aimed_depth_m(MARGIN)
        hardness = (
            0.0 if depth_m is None else step * math.sqrt(GRAVITY_M_PER_S2 / depth_m)
        )
        if aim.rebound is None:
            rate, relaxation = max(RIGID_RATE, hardness), 1.0
            if aim.stiffness_n_per_m is not None:
                # Critically damped: the damping ratio is half the relaxation time times the natural frequency.
                rate, relaxation = hardness, 2.0 / hardness
        elif aim.damping_n_s_per_m is not None:
            rate, relaxation = hardness, 2.0 * damping_ratio_of(aim.rebound) / hardness
        else:
            weight = (
                GRAVITY_M_PER_S2 * step / math.sqrt(2.0 * GRAVITY_M_PER_S2 * DROP_M)
            )
            given = hardness if aim.stiffness_n_per_m is not None else None
            least = max(hardness, math.pi * step / LONGEST_IMPACT_S)
            rate, relaxation = _rebounding(
                aim.rebound, weight, least=least, given=given
            )
        return cls.of(
            timestep_s=step,
            friction=aim.friction,
            point_contact_stiffness=aim.mass_kg * (rate / step) ** 2,
            relaxation_time=relaxation * step,
        )

    def further(self, mass_kg: float) -> Mapping[str, Any]:
        """Return point contact with SAP; the stiffness is that of the mass."""
        return {
            "approximation": "sap",
            "sustained_rate": self.timestep_s
            * math.sqrt(self.point_contact_stiffness / mass_kg),
            "sustained_relaxation_steps": self.relaxation_time / self.timestep_s,
        }


def _rebounding(
    restitution: float, weight: float, *, least: float, given: float | None
) -> tuple[float, float]:
    """Return rate and relaxation time in steps for a restitution, from a repetition of Drake's scheme.

    Args:
        restitution: The restitution.
        weight: Speed that gravity adds in a step, over the incoming speed.
        least: Smallest rate, which the allowed depth and the longest impact state.
        given: Rate that a stiffness states; None for the hardest one that rebounds enough.
    """
    rates = (
        [given] if given is not None else [max(float(rate), least) for rate in RATES]
    )
    # At equal restitution the first one is the hardest.
    means = [float(rebound("relaxation", rate, 0.0, weight).mean()) for rate in rates]
    enough = [index for index, mean in enumerate(means) if mean >= restitution]
    if not enough:
        return rates[int(np.argmax(means))], 0.0
    rate = rates[enough[0]]

    def excess(relaxation: float) -> float:
        return (
            float(rebound("relaxation", rate, relaxation, weight).mean()) - restitution
        )

    if excess(MOST_RELAXATION_STEPS) > 0.0:
        return rate, MOST_RELAXATION_STEPS
    return rate, float(brentq(excess, 0.0, MOST_RELAXATION_STEPS, xtol=1e-6))
