"""Rapier's collider coefficients and integration parameters."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import Field

from gauge_envs.backends.rapier.settings import PRESETS
from gauge_envs.backends.shared.spring_damper import damping_ratio_of
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, stated_by

MARGIN = 0.5
"""Share of the allowed depth that settings aim at: a plate on four points sinks by 1.66 times g / (2 pi f)^2."""


@stated_by(PRESETS["out_of_box"])
class RapierSettings(ContactSettings):
    """Coefficients of both colliders, and parameters of the world. Contacts are with a fixed or driven collider.

    Attributes:
        friction: Coefficient of friction.
        restitution: Coefficient of restitution.
    """

    engine: ClassVar[str] = "rapier"
    is_soft: ClassVar[bool] = True
    aims: ClassVar[tuple[float, float]] = (0.0, 1.2)
    limits: ClassVar[dict[str, str]] = {
        "penetration_m": "Rapier's contact is a spring of a natural frequency, and its solver caps how hard it is",
        "restitution": "Rapier rebounds from the speed of approach in a substep",
    }
    template: ClassVar[str] = """\
import rapier3d as rapier

def set_parameters(world):
    parameters = world.integration_parameters
    parameters.dt = {timestep_s}
    parameters.num_solver_iterations = {num_solver_iterations}
    parameters.static_contact_softness = rapier.SpringCoefficients({natural_frequency}, {damping_ratio})
    parameters.normalized_allowed_linear_error = {allowed_linear_error}

def with_contact(collider):  # both colliders; their bodies with .can_sleep(False)
    return collider.friction({friction}).restitution({restitution})
"""

    friction: float = Field(default=0.5, ge=0.0)
    restitution: float = Field(default=0.0, ge=0.0)
    num_solver_iterations: int
    natural_frequency: float
    damping_ratio: float
    allowed_linear_error: float

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the coefficients themselves, and a frequency of the contact for the depth."""
        given: dict[str, Any] = {}
        if (depth_m := aim.aimed_depth_m(MARGIN)) is not None:
            frequency = math.sqrt(GRAVITY_M_PER_S2 / depth_m) / (2.0 * math.pi)
            given["natural_frequency"] = (
                frequency if aim.stiffness_n_per_m is not None else max(frequency, 60.0)
            )
            given["allowed_linear_error"] = 0.0
            if aim.damping_n_s_per_m is not None and aim.rebound is not None:
                given["damping_ratio"] = max(damping_ratio_of(aim.rebound), 1e-3)
        return cls.of(
            timestep_s=aim.timestep_s,
            friction=aim.friction,
            restitution=aim.rebound or 0.0,
            **given,
        )

    def further(self, mass_kg: float) -> Mapping[str, Any]:
        """Return that bodies do not sleep."""
        return {"sleep": False}
