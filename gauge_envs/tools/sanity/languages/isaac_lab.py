"""Write changes of settings as lines of an Isaac Lab configuration class, for its `__post_init__`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from gauge_envs.tools.sanity.languages.base import Language, number_text

SPAWN = "scene.robot.spawn"

COLLIDER = f"{SPAWN}.collision_props"
"""Properties of colliders. Most robots have none, so they are written as a whole."""

PHYSX_KEYS = {
    "bounce_threshold_m_per_s": "bounce_threshold_velocity",
    "continuous_detection": "enable_ccd",
    "enhanced_determinism": "enable_enhanced_determinism",
}
"""Attributes of PhysxCfg by name of the setting."""

KEYS = {
    "timestep_s": "sim.dt",
    "position_iterations": f"{SPAWN}.articulation_props.solver_position_iteration_count",
    "velocity_iterations": f"{SPAWN}.articulation_props.solver_velocity_iteration_count",
    "sleep_threshold_m2_per_s2": f"{SPAWN}.articulation_props.sleep_threshold",
    "linear_damping_per_s": f"{SPAWN}.rigid_props.linear_damping",
    "angular_damping_per_s": f"{SPAWN}.rigid_props.angular_damping",
    "max_linear_velocity_m_per_s": f"{SPAWN}.rigid_props.max_linear_velocity",
    "max_angular_velocity_rad_per_s": f"{SPAWN}.rigid_props.max_angular_velocity",
    "max_depenetration_velocity_m_per_s": f"{SPAWN}.rigid_props.max_depenetration_velocity",
}
"""Other attributes of the configuration by name of the setting."""

COLLIDER_KEYS = {
    "contact_offset_m": "contact_offset",
    "rest_offset_m": "rest_offset",
    "patch_radius_m": "torsional_patch_radius",
    "min_patch_radius_m": "min_torsional_patch_radius",
}
"""Attributes of CollisionPropertiesCfg by name of the setting."""

FRICTION_SCALE = {"friction_offset_threshold": 0.04, "friction_correlation_distance": 0.025}
"""Attributes of PhysxCfg that follow from the length scale, and their ratio to it."""

SOLVERS = {"PGS": 0, "TGS": 1}


class IsaacLab(Language):
    """Lines of Python: `self.sim.physx.bounce_threshold_velocity = 0.2`.

    Attributes:
        place: Attribute of the configuration that holds the PhysxCfg.
    """

    name = "isaac_lab"
    place: ClassVar[str] = "sim.physx"

    def writes(self, name: str) -> bool:
        """Return whether a configuration of Isaac Lab has the setting."""
        return name in {*PHYSX_KEYS, *KEYS, *COLLIDER_KEYS, "solver", "tolerance_length_m"}

    def assignment(self, name: str, value: Any) -> str:
        """Return the line; two lines with a semicolon for the length scale."""
        if name == "solver":
            return f"self.{self.place}.solver_type = {SOLVERS[value]}"
        if name == "tolerance_length_m":
            lines = {key: number_text(ratio * value) for key, ratio in FRICTION_SCALE.items()}
            return "; ".join(f"self.{self.place}.{key} = {text}" for key, text in lines.items())
        if name in PHYSX_KEYS:
            return f"self.{self.place}.{PHYSX_KEYS[name]} = {number_text(value)}"
        if name in COLLIDER_KEYS:
            return _collider({name: value})
        return f"self.{KEYS.get(name, name)} = {self.value_text(name, value)}"

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return the lines, separated by semicolons, as Python allows."""
        offsets = {name: value for name, value in changes.items() if name in COLLIDER_KEYS}
        lines = [self.assignment(name, value) for name, value in changes.items() if name not in offsets]
        return "; ".join([*lines, *([_collider(offsets)] if offsets else [])])

    def value_text(self, name: str, value: Any) -> str:
        """Return the value of a setting alone."""
        if name == "solver":
            return str(SOLVERS[value])
        return number_text(math.degrees(value) if name == "max_angular_velocity_rad_per_s" else value)

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `self.sim.gravity = (x, y, z)`."""
        return f"self.sim.gravity = ({', '.join(number_text(round(one, 2) + 0.0) for one in gravity_m_per_s2)})"


class IsaacLab3(IsaacLab):
    """Lines for Isaac Lab 3, which has its PhysxCfg at another place."""

    name = "isaac_lab_3"
    place = "sim.physics"


def _collider(offsets: Mapping[str, Any]) -> str:
    arguments = ", ".join(f"{COLLIDER_KEYS[name]}={number_text(value)}" for name, value in offsets.items())
    return f"self.{COLLIDER} = sim_utils.CollisionPropertiesCfg({arguments})"
