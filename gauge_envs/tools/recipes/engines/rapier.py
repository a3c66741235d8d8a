"""Rapier's collider coefficients and integration parameters."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Self

from pydantic import Field

from gauge_envs.backends.shared.spring_damper import damping_ratio_of
from gauge_envs.scene import GRAVITY_M_PER_S2, ContactMode
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.probes import Build

MARGIN = 0.5
"""Share of the allowed depth that settings aim at: a plate on four points sinks by 1.66 times g / (2 pi f)^2."""


class RapierSettings(ContactSettings):
    """Coefficients of both colliders, and parameters of the world. Contacts are with a fixed or driven collider.

    Attributes:
        friction: Coefficient of friction.
        restitution: Coefficient of restitution.
        num_solver_iterations: Substeps of the solver in a step.
        natural_frequency: Natural frequency of contacts with fixed bodies [Hz].
        damping_ratio: Damping ratio of the same contacts.
        allowed_linear_error: Penetration that is not corrected [m].
    """

    engine: ClassVar[str] = "rapier"
    is_soft: ClassVar[bool] = True
    aims: ClassVar[tuple[float, float]] = (0.0, 1.2)

    friction: float = Field(default=0.5, ge=0.0)
    restitution: float = Field(default=0.0, ge=0.0)
    num_solver_iterations: int = Field(default=4, ge=1)
    natural_frequency: float = Field(default=60.0, gt=0.0)
    damping_ratio: float = Field(default=10.0, gt=0.0)
    allowed_linear_error: float = Field(default=0.005, ge=0.0)

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the coefficients themselves, and a frequency of the contact for the depth."""
        depth_m = aim.depth_m
        given: dict[str, Any] = {}
        if depth_m is not None:
            share = MARGIN if aim.stiffness_n_per_m is None else 1.0
            frequency = math.sqrt(GRAVITY_M_PER_S2 / (share * depth_m)) / (2.0 * math.pi)
            stiff = aim.stiffness_n_per_m is not None
            given["natural_frequency"] = frequency if stiff else max(frequency, 60.0)
            given["allowed_linear_error"] = 0.0
            if aim.damping_n_s_per_m is not None and aim.rebound is not None:
                given["damping_ratio"] = max(damping_ratio_of(aim.rebound), 1e-3)
        return cls(timestep_s=aim.timestep_s, friction=aim.friction, restitution=aim.rebound or 0.0, **given)

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""
        return self.friction

    def build(self, mass_kg: float) -> Build:
        """Return Rapier's defaults with these settings, and without sleep."""
        given = {
            "preset": "out_of_box",
            "sleep": False,
            "solver_iterations": self.num_solver_iterations,
            "static_contact_frequency_hz": self.natural_frequency,
            "static_contact_damping_ratio": self.damping_ratio,
            "allowed_linear_error_m": self.allowed_linear_error,
        }
        return Build(friction=self.friction, restitution=self.restitution, mode=ContactMode.IMPACT, settings=given)

    def snippet(self, mass_kg: float) -> str:
        """Return Python for Rapier's bindings, whose names are those of Rust."""
        return (
            "import rapier3d as rapier\n\n"
            "def set_parameters(world):\n"
            "    parameters = world.integration_parameters\n"
            f"    parameters.dt = {self.timestep_s:.9g}\n"
            f"    parameters.num_solver_iterations = {self.num_solver_iterations}\n"
            "    parameters.static_contact_softness = rapier.SpringCoefficients("
            f"{self.natural_frequency:g}, {self.damping_ratio:g})\n"
            f"    parameters.normalized_allowed_linear_error = {self.allowed_linear_error:g}\n\n"
            "def with_contact(collider):  # both colliders; their bodies with .can_sleep(False)\n"
            f"    return collider.friction({self.friction:g}).restitution({self.restitution:g})\n"
        )

    @classmethod
    def limits(cls, quantity: str) -> str:
        """Return what Rapier limits."""
        return {
            "penetration_m": "Rapier's contact is a spring of a natural frequency, and its solver caps how hard it is",
            "restitution": "Rapier rebounds from the speed of approach in a substep",
        }.get(quantity, "")
