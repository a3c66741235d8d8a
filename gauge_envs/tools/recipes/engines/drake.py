"""Contact settings of Drake: point contact with stiffness and dissipation of geometries."""

import math
from typing import Any, ClassVar

from pydantic import Field

from gauge_envs.backends.shared.spring_damper import damping_ratio_of
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, NonNegative

MAX_RATE = 0.5
"""Largest natural frequency times the step of a rebounding contact; above, rebounds depend strongly on the phase."""

MAX_IMPACT_S = 0.1
"""Longest impact [s]: pi divided by the natural frequency. At 2 m/s, a body then sinks in by 63 mm."""

RIGID_RATE = 1.0
"""Natural frequency times the step of a contact without rebound, as in sustained contacts of the backend."""

MAX_RELAXATION_STEPS = 100.0
"""Largest relaxation time [steps]."""

MIN_RESTITUTION = 1e-3
"""Restitution of a contact without rebound."""

MARGIN = 0.8
"""Target depth, as a share of the allowed depth."""


class DrakeSettings(ContactSettings):
    """Contact properties of a body on much stiffer ground. The contact approximation is SAP.

    Attributes:
        friction: Static and dynamic coefficient of friction.
        point_contact_stiffness: Total stiffness of all contact points of the body [N/m].
        relaxation_time: Relaxation time of the pair [s].
    """

    engine = "drake"
    is_soft = True
    preset = "point"
    limits: ClassVar = {
        "restitution": "Drake has no coefficient of restitution: a rebound is a spring, and implicit steps dissipate "
        "more for stiffer springs",
        "penetration_m": "Drake's contact is a spring: its depth at rest is weight / stiffness, and a rebound needs a "
        "soft spring",
        "friction": "On a soft contact, the plate does not settle within the slide",
    }

    friction: NonNegative = 0.0
    point_contact_stiffness: float = Field(default=1e6, gt=0.0)
    relaxation_time: NonNegative = 0.1

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return the hardest contact that rebounds enough in Drake's implicit steps, with the remaining dissipation.

        An impact is half a period of a spring. Implicit Euler steps multiply an oscillation by 1 / sqrt(1 + r^2), where
        r is the natural frequency times the step. Source: Hairer and Wanner, Solving Ordinary Differential Equations
        II, IV.3. An impact then leaves exp(-pi r / 2) of the speed. The damping ratio is half the relaxation time times
        the natural frequency.
        """
        rate, ratio = 0.0, 1.0
        depth_m = aim.depth_m(MARGIN)
        if depth_m is not None:
            rate = aim.timestep_s * math.sqrt(GRAVITY_M_PER_S2 / depth_m)
        is_stiff = aim.stiffness_n_per_m is not None
        if aim.rebound is None:
            if not is_stiff:
                rate, ratio = max(RIGID_RATE, rate), 0.5
        else:
            restitution = max(aim.rebound, MIN_RESTITUTION)
            if not is_stiff:
                rebound_rate = min(-2.0 * math.log(restitution) / math.pi, MAX_RATE)
                rate = max(rate, rebound_rate, math.pi * aim.timestep_s / MAX_IMPACT_S)
            left = restitution * math.exp(0.5 * math.pi * rate)
            ratio = damping_ratio_of(left)
        relaxation_steps = min(2.0 * ratio / rate, MAX_RELAXATION_STEPS)
        return {
            "point_contact_stiffness": aim.mass_kg * (rate / aim.timestep_s) ** 2,
            "relaxation_time": relaxation_steps * aim.timestep_s,
        }

    def backend_settings(self, mass_kg: float) -> dict[str, Any]:
        """Return point contact with SAP, with the rate of the stiffness and the mass."""
        frequency_per_s = math.sqrt(self.point_contact_stiffness / mass_kg)
        return {
            **super().backend_settings(mass_kg),
            "approximation": "sap",
            "sustained_rate": self.timestep_s * frequency_per_s,
            "sustained_relaxation_steps": self.relaxation_time / self.timestep_s,
        }

    def snippet(self) -> str:
        """Return Python for the plant and its geometries."""
        return f"""\
from pydrake.geometry import AddContactMaterial, ProximityProperties
from pydrake.multibody.plant import ContactModel, CoulombFriction, DiscreteContactApproximation

TIME_STEP = {self.timestep_s:.9g}  # AddMultibodyPlantSceneGraph(builder, TIME_STEP)

def properties(point_count=1, is_ground=False):
    # A pair of geometries has one contact point in Drake: put spheres at the corners of a box.
    friction = CoulombFriction({self.friction:g}, {self.friction:g})
    stiffness = 1e20 if is_ground else {self.point_contact_stiffness:g} / point_count
    contact = ProximityProperties()
    AddContactMaterial(contact, point_stiffness=stiffness, friction=friction)
    relaxation = 0.0 if is_ground else {self.relaxation_time:g}  # the times of a pair add up
    contact.AddProperty("material", "relaxation_time", relaxation)
    return contact

def set_contact(plant):
    plant.set_contact_model(ContactModel.kPoint)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
"""
