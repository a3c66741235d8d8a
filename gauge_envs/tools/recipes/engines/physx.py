"""SAPIEN's PhysX: materials of shapes and the scene's contact options."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field

from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2, ContactMode
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.probes import Build

THRESHOLD_STEPS = 4.0
"""Bounce threshold over the speed that a resting body gains in a step."""


class PhysXSettings(ContactSettings):
    """Material of both shapes, and options of the scene.

    Attributes:
        static_friction: Coefficient of static friction.
        dynamic_friction: Coefficient of dynamic friction; this package's materials have both equal.
        restitution: Coefficient of restitution.
        bounce_threshold: Speed of approach below which nothing rebounds [m/s].
        contact_offset: Distance at which contacts begin [m].
        solver_position_iterations: Position iterations of a body.
        solver_velocity_iterations: Velocity iterations of a body.
    """

    engine: ClassVar[str] = "physx"
    is_soft: ClassVar[bool] = False

    static_friction: float = Field(default=0.3, ge=0.0)
    dynamic_friction: float = Field(default=0.3, ge=0.0)
    restitution: float = Field(default=0.1, ge=0.0, le=1.0)
    bounce_threshold: float = Field(default=2.0, ge=0.0)
    contact_offset: float = Field(default=0.01, gt=0.0)
    solver_position_iterations: int = Field(default=10, ge=1, le=255)
    solver_velocity_iterations: int = Field(default=1, ge=0, le=255)

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the coefficients themselves, and a bounce threshold just above a resting body's speed."""
        return cls(
            timestep_s=aim.timestep_s,
            static_friction=aim.friction,
            dynamic_friction=aim.friction,
            restitution=aim.rebound or 0.0,
            bounce_threshold=THRESHOLD_STEPS * GRAVITY_M_PER_S2 * aim.timestep_s,
        )

    @property
    def sliding_friction(self) -> float:
        """Coefficient of friction of the pair."""
        return self.dynamic_friction

    def build(self, mass_kg: float) -> Build:
        """Return SAPIEN's defaults with these settings."""
        if self.static_friction != self.dynamic_friction:
            raise ParameterError(
                f"static_friction {self.static_friction:g} and dynamic_friction {self.dynamic_friction:g}: recipes "
                "measure one coefficient for both: give the same value"
            )
        given = {
            "preset": "out_of_box",
            "bounce_threshold_m_per_s": self.bounce_threshold,
            "contact_offset_m": self.contact_offset,
            "position_iterations": self.solver_position_iterations,
            "velocity_iterations": self.solver_velocity_iterations,
        }
        return Build(
            friction=self.dynamic_friction, restitution=self.restitution, mode=ContactMode.IMPACT, settings=given
        )

    def snippet(self, mass_kg: float) -> str:
        """Return Python for SAPIEN; `material` belongs on both shapes, because PhysX takes the mean."""
        return (
            "import sapien\n\n"
            "scene_config = sapien.physx.get_scene_config()  # all three before the scene\n"
            f"scene_config.bounce_threshold = {self.bounce_threshold:g}\n"
            "sapien.physx.set_scene_config(scene_config)\n"
            "shape_config = sapien.physx.get_shape_config()\n"
            f"shape_config.contact_offset = {self.contact_offset:g}\n"
            "sapien.physx.set_shape_config(shape_config)\n"
            "body_config = sapien.physx.get_body_config()\n"
            f"body_config.solver_position_iterations = {self.solver_position_iterations}\n"
            f"body_config.solver_velocity_iterations = {self.solver_velocity_iterations}\n"
            "sapien.physx.set_body_config(body_config)\n"
            "material = sapien.physx.PhysxMaterial(\n"
            f"    static_friction={self.static_friction:g}, dynamic_friction={self.dynamic_friction:g}, "
            f"restitution={self.restitution:g}\n"
            ")  # of both shapes\n"
            f"timestep = {self.timestep_s:.9g}  # scene.set_timestep(timestep)\n"
        )

    @classmethod
    def limits(cls, quantity: str) -> str:
        """Return what SAPIEN's PhysX limits."""
        return {
            "penetration_m": "contacts in SAPIEN's PhysX are rigid: its materials have no stiffness",
            "restitution": "PhysX rebounds from the speed of approach at the start of the step, and only above the "
            "bounce threshold",
        }.get(quantity, "")
