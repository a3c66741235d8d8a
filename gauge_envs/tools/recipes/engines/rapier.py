"""Contact settings of Rapier: coefficients of colliders, and integration parameters."""

import math
from typing import Any, ClassVar

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, NonNegative

MARGIN = 0.5
"""Target depth, as a share of the allowed depth: a plate on four points sinks by 1.66 times g / (2 pi f)^2."""

DEFAULT_FREQUENCY_HZ = 60.0
"""Rapier's natural frequency of a contact with a fixed collider [Hz]."""


class RapierSettings(ContactSettings):
    """Coefficients of both colliders, and parameters of the world. The second collider is fixed or driven.

    Attributes:
        friction: Coefficient of friction.
        restitution: Coefficient of restitution.
    """

    engine = "rapier"
    is_soft = True
    restitution_range = (0.0, 1.2)
    natives: ClassVar = {
        "num_solver_iterations": "solver_iterations",
        "natural_frequency": "static_contact_frequency_hz",
        "damping_ratio": "static_contact_damping_ratio",
        "allowed_linear_error": "allowed_linear_error_m",
    }
    limits: ClassVar = {
        "penetration_m": "Rapier's contact is a spring with a natural frequency, and the solver limits its stiffness",
        "restitution": "Rapier rebounds from the speed of approach in a substep",
    }

    friction: NonNegative = 0.5
    restitution: NonNegative = 0.0
    num_solver_iterations: int = 4
    natural_frequency: float = DEFAULT_FREQUENCY_HZ
    damping_ratio: float = 10.0
    allowed_linear_error: float = 0.005

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return the requested restitution, and the contact frequency for the depth: (2 pi f)^2 = g / depth."""
        contact = {"restitution": aim.rebound or 0.0}
        depth_m = aim.depth_m(MARGIN)
        if depth_m is not None:
            frequency_hz = math.sqrt(GRAVITY_M_PER_S2 / depth_m) / (2.0 * math.pi)
            if aim.stiffness_n_per_m is None:
                frequency_hz = max(frequency_hz, DEFAULT_FREQUENCY_HZ)
            contact |= {"natural_frequency": frequency_hz, "allowed_linear_error": 0.0}
        if aim.damping_n_s_per_m is not None:
            contact["damping_ratio"] = max(aim.damping_ratio, 1e-3)
        return contact

    def backend_settings(self, mass_kg: float) -> dict[str, Any]:
        """Return the settings of a world without sleeping bodies."""
        return {**super().backend_settings(mass_kg), "sleep": False}

    def snippet(self) -> str:
        """Return Python for a world and its colliders."""
        return f"""\
import rapier3d as rapier

def set_parameters(world):
    parameters = world.integration_parameters
    parameters.dt = {self.timestep_s:.9g}
    parameters.num_solver_iterations = {self.num_solver_iterations}
    parameters.static_contact_softness = rapier.SpringCoefficients({self.natural_frequency:g}, {self.damping_ratio:g})
    parameters.normalized_allowed_linear_error = {self.allowed_linear_error:g}

def with_contact(collider):  # both colliders; their bodies with .can_sleep(False)
    return collider.friction({self.friction:g}).restitution({self.restitution:g})
"""
