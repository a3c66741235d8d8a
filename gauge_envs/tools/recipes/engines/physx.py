"""SAPIEN's PhysX: materials of shapes and the scene's contact options."""

from typing import ClassVar, Self

from pydantic import Field

from gauge_envs.backends.physx.settings import PRESETS
from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, stated_by
from gauge_envs.tools.recipes.probes import Build

THRESHOLD_STEPS = 4.0
"""Bounce threshold over the speed that a resting body gains in a step."""


@stated_by(PRESETS["out_of_box"])
class PhysXSettings(ContactSettings):
    """Material of both shapes, which PhysX averages, and options of the scene.

    Attributes:
        static_friction: Coefficient of static friction.
        dynamic_friction: Coefficient of dynamic friction; this package's materials have both equal.
        restitution: Coefficient of restitution.
    """

    engine: ClassVar[str] = "physx"
    is_soft: ClassVar[bool] = False
    friction_field: ClassVar[str] = "dynamic_friction"
    limits: ClassVar[dict[str, str]] = {
        "penetration_m": "contacts in SAPIEN's PhysX are rigid: its materials have no stiffness",
        "restitution": "PhysX rebounds from the speed of approach at the start of the step, and only above the bounce "
        "threshold",
    }
    template: ClassVar[str] = """\
import sapien

scene_config = sapien.physx.get_scene_config()  # all three before the scene
scene_config.bounce_threshold = {bounce_threshold}
sapien.physx.set_scene_config(scene_config)
shape_config = sapien.physx.get_shape_config()
shape_config.contact_offset = {contact_offset}
sapien.physx.set_shape_config(shape_config)
body_config = sapien.physx.get_body_config()
body_config.solver_position_iterations = {solver_position_iterations}
body_config.solver_velocity_iterations = {solver_velocity_iterations}
sapien.physx.set_body_config(body_config)
material = sapien.physx.PhysxMaterial(
    static_friction={static_friction}, dynamic_friction={dynamic_friction}, restitution={restitution}
)  # of both shapes
timestep = {timestep_s}  # scene.set_timestep(timestep)
"""

    static_friction: float = Field(default=0.3, ge=0.0)
    dynamic_friction: float = Field(default=0.3, ge=0.0)
    restitution: float = Field(default=0.1, ge=0.0, le=1.0)
    bounce_threshold: float
    contact_offset: float
    solver_position_iterations: int
    solver_velocity_iterations: int

    @classmethod
    def aimed(cls, aim: Aim) -> Self:
        """Return the coefficients themselves, and a bounce threshold just above a resting body's speed."""
        return cls.of(
            timestep_s=aim.timestep_s,
            static_friction=aim.friction,
            dynamic_friction=aim.friction,
            restitution=aim.rebound or 0.0,
            bounce_threshold=THRESHOLD_STEPS * GRAVITY_M_PER_S2 * aim.timestep_s,
        )

    def build(self, mass_kg: float) -> Build:
        """Return SAPIEN's defaults with these settings."""
        if self.static_friction != self.dynamic_friction:
            raise ParameterError(
                f"static_friction {self.static_friction:g} and dynamic_friction {self.dynamic_friction:g}: recipes "
                "measure one coefficient for both: give the same value"
            )
        return super().build(mass_kg)
