"""Write changes of settings as lines of a configuration in the style of IsaacGym."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import Language, number_text

KEYS = {
    "timestep_s": "sim.dt",
    "position_iterations": "sim.physx.num_position_iterations",
    "velocity_iterations": "sim.physx.num_velocity_iterations",
    "bounce_threshold_m_per_s": "sim.physx.bounce_threshold_velocity",
    "contact_offset_m": "sim.physx.contact_offset",
    "rest_offset_m": "sim.physx.rest_offset",
    "max_depenetration_velocity_m_per_s": "sim.physx.max_depenetration_velocity",
    "linear_damping_per_s": "asset.linear_damping",
    "angular_damping_per_s": "asset.angular_damping",
    "max_linear_velocity_m_per_s": "asset.max_linear_velocity",
    "max_angular_velocity_rad_per_s": "asset.max_angular_velocity",
}
"""Keys of the configuration by name of the setting."""

SOLVERS = {"PGS": 0, "TGS": 1}


class IsaacGym(Language):
    """Keys with their values: `sim.physx.bounce_threshold_velocity = 0.2`.

    They are lines of Python for a configuration object, and overrides on the command line of Hydra without the spaces.
    """

    name = "isaac_gym"

    def writes(self, name: str) -> bool:
        """Return whether a configuration in the style of IsaacGym has the setting."""
        return name in KEYS or name == "solver"

    def assignment(self, name: str, value: Any) -> str:
        """Return the line. The step is that of the engine, so `sim.substeps` is then 1."""
        if name == "solver":
            return f"sim.physx.solver_type = {SOLVERS[value]}"
        return f"{KEYS.get(name, name)} = {number_text(value)}" + ("; sim.substeps = 1" if name == "timestep_s" else "")

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return the lines, separated by semicolons."""
        return "; ".join(self.assignment(name, value) for name, value in changes.items())

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `sim.gravity = [x, y, z]`."""
        return f"sim.gravity = [{', '.join(number_text(round(one, 2) + 0.0) for one in gravity_m_per_s2)}]"
