"""Write changes of settings as lines of an Isaac Lab configuration class, for its `__post_init__`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gauge_envs.checks.sanity.languages.base import Language, number_text

__all__ = ["IsaacLab"]

SPAWN = "scene.robot.spawn"

KEYS = {
    "timestep_s": "sim.dt",
    "bounce_threshold_m_per_s": "sim.physx.bounce_threshold_velocity",
    "continuous_detection": "sim.physx.enable_ccd",
    "enhanced_determinism": "sim.physx.enable_enhanced_determinism",
    "position_iterations": f"{SPAWN}.articulation_props.solver_position_iteration_count",
    "velocity_iterations": f"{SPAWN}.articulation_props.solver_velocity_iteration_count",
    "sleep_threshold_m2_per_s2": f"{SPAWN}.articulation_props.sleep_threshold",
    "linear_damping_per_s": f"{SPAWN}.rigid_props.linear_damping",
    "angular_damping_per_s": f"{SPAWN}.rigid_props.angular_damping",
    "max_linear_velocity_m_per_s": f"{SPAWN}.rigid_props.max_linear_velocity",
    "max_angular_velocity_rad_per_s": f"{SPAWN}.rigid_props.max_angular_velocity",
    "max_depenetration_velocity_m_per_s": f"{SPAWN}.rigid_props.max_depenetration_velocity",
    "contact_offset_m": f"{SPAWN}.collision_props.contact_offset",
    "rest_offset_m": f"{SPAWN}.collision_props.rest_offset",
    "patch_radius_m": f"{SPAWN}.collision_props.torsional_patch_radius",
    "min_patch_radius_m": f"{SPAWN}.collision_props.min_torsional_patch_radius",
}
"""Attributes of the configuration by name of the setting."""

FRICTION_SCALE = {"sim.physx.friction_offset_threshold": 0.04, "sim.physx.friction_correlation_distance": 0.025}
"""Attributes that follow from the length scale, and their ratio to it."""

SOLVERS = {"PGS": 0, "TGS": 1}


class IsaacLab(Language):
    """Lines of Python: `self.sim.physx.bounce_threshold_velocity = 0.2`."""

    name = "isaac_lab"

    def writes(self, name: str) -> bool:
        """Return whether a configuration of Isaac Lab has the setting."""
        return name in KEYS or name in ("solver", "tolerance_length_m")

    def assignment(self, name: str, value: Any) -> str:
        """Return the line; two lines with a semicolon for the length scale."""
        if name == "solver":
            return f"self.sim.physx.solver_type = {SOLVERS[value]}"
        if name == "tolerance_length_m":
            return "; ".join(f"self.{key} = {number_text(ratio * value)}" for key, ratio in FRICTION_SCALE.items())
        if name == "max_angular_velocity_rad_per_s":
            value = math.degrees(value)
        return f"self.{KEYS.get(name, name)} = {number_text(value)}"

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return the lines, separated by semicolons, as Python allows."""
        return "; ".join(self.assignment(name, value) for name, value in changes.items())

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `self.sim.gravity = (x, y, z)`."""
        return f"self.sim.gravity = ({', '.join(number_text(round(one, 2) + 0.0) for one in gravity_m_per_s2)})"
