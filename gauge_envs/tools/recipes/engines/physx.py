"""Contact settings of SAPIEN's PhysX: materials of shapes, and options of the scene."""

from typing import Any, ClassVar, Self

from pydantic import Field, model_validator

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.recipes.aim import Aim
from gauge_envs.tools.recipes.engines.base import ContactSettings, NonNegative

THRESHOLD_STEPS = 4.0
"""Bounce threshold, divided by the speed that a resting body gains in a step."""


class PhysXSettings(ContactSettings):
    """Material of both shapes (PhysX averages them), and options of the scene.

    Attributes:
        static_friction: Coefficient of static friction.
        dynamic_friction: Coefficient of dynamic friction, equal to the static one.
        restitution: Coefficient of restitution.
    """

    engine = "physx"
    is_soft = False
    friction_field = "dynamic_friction"
    natives: ClassVar = {
        "bounce_threshold": "bounce_threshold_m_per_s",
        "contact_offset": "contact_offset_m",
        "solver_position_iterations": "position_iterations",
        "solver_velocity_iterations": "velocity_iterations",
    }
    limits: ClassVar = {
        "penetration_m": "Contacts in SAPIEN's PhysX are rigid: its materials have no stiffness",
        "restitution": "PhysX rebounds from the speed of approach at the start of the step, and only above the bounce "
        "threshold",
    }

    static_friction: NonNegative = 0.3
    dynamic_friction: NonNegative = 0.3
    restitution: float = Field(default=0.1, ge=0.0, le=1.0)
    bounce_threshold: float = 2.0
    contact_offset: float = 0.01
    solver_position_iterations: int = 10
    solver_velocity_iterations: int = 1

    @model_validator(mode="after")
    def _check_friction(self) -> Self:
        if self.static_friction != self.dynamic_friction:
            raise ValueError(
                "static_friction and dynamic_friction must be equal: different values are not supported"
            )
        return self

    @classmethod
    def constants(cls, aim: Aim) -> dict[str, Any]:
        """Return the requested coefficients, and a bounce threshold just above the speed of a resting body."""
        return {
            "static_friction": aim.sliding_friction,
            "restitution": aim.rebound or 0.0,
            "bounce_threshold": THRESHOLD_STEPS * GRAVITY_M_PER_S2 * aim.timestep_s,
        }

    def snippet(self) -> str:
        """Return Python for the configurations of PhysX and a material."""
        mu = f"{self.dynamic_friction:g}"
        return f"""\
import sapien

scene_config = sapien.physx.get_scene_config()  # all three before the scene
scene_config.bounce_threshold = {self.bounce_threshold:g}
sapien.physx.set_scene_config(scene_config)
shape_config = sapien.physx.get_shape_config()
shape_config.contact_offset = {self.contact_offset:g}
sapien.physx.set_shape_config(shape_config)
body_config = sapien.physx.get_body_config()
body_config.solver_position_iterations = {self.solver_position_iterations}
body_config.solver_velocity_iterations = {self.solver_velocity_iterations}
sapien.physx.set_body_config(body_config)
material = sapien.physx.PhysxMaterial(
    static_friction={mu}, dynamic_friction={mu}, restitution={self.restitution:g}
)  # of both shapes
timestep = {self.timestep_s:.9g}  # scene.set_timestep(timestep)
"""
