"""Write changes of settings as a SimConfig of ManiSkill."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.sanity.languages.base import Language, number_text

SCENE = {
    "bounce_threshold_m_per_s": "bounce_threshold",
    "sleep_threshold_m2_per_s2": "sleep_threshold",
    "contact_offset_m": "contact_offset",
    "rest_offset_m": "rest_offset",
    "position_iterations": "solver_position_iterations",
    "velocity_iterations": "solver_velocity_iterations",
    "persistent_manifolds": "enable_pcm",
    "continuous_detection": "enable_ccd",
    "enhanced_determinism": "enable_enhanced_determinism",
    "friction_every_iteration": "enable_friction_every_iteration",
    "solver": "enable_tgs",
}
"""Fields of SceneConfig by name of the setting."""


LINK = {"angular_damping_per_s": "set_angular_damping", "link_linear_damping_per_s": "set_linear_damping"}
"""Methods of a robot's links by name of the setting; a SimConfig has no field for them."""


class ManiSkill(Language):
    """Python: `SimConfig(sim_freq=200, scene_config=SceneConfig(bounce_threshold=0.2))`."""

    name = "maniskill"

    def writes(self, name: str) -> bool:
        """Return whether a SimConfig or the links of a robot have the setting."""
        return name in SCENE or name in LINK or name == "timestep_s"

    def assignment(self, name: str, value: Any) -> str:
        """Return `field=value`, or a loop over the links of the robot."""
        if name in LINK:
            return f"[link.{LINK[name]}({number_text(value)}) for link in self.agent.robot.links]"
        if name == "timestep_s":
            return f"sim_freq={round(1.0 / value)}"
        if name == "solver":
            value = value == "TGS"
        return f"{SCENE.get(name, name)}={number_text(value)}"

    def paste_text(self, changes: Mapping[str, Any], *, geoms: str = "") -> str:
        """Return the SimConfig with the changed fields, and loops over the links."""
        lines = {name: self.assignment(name, value) for name, value in changes.items()}
        fields = [line for name, line in lines.items() if name not in SCENE and name not in LINK]
        scene = [line for name, line in lines.items() if name in SCENE]
        fields += [f"scene_config=SceneConfig({', '.join(scene)})"] if scene else []
        config = [f"SimConfig({', '.join(fields)})"] if fields else []
        return " and ".join([*config, *(line for name, line in lines.items() if name in LINK)])

    def value_text(self, name: str, value: Any) -> str:
        """Return the value of a setting alone."""
        return number_text(value) if name in LINK else super().value_text(name, value)

    def gravity_text(self, gravity_m_per_s2: tuple[float, float, float]) -> str:
        """Return `SimConfig(scene_config=SceneConfig(gravity=[x, y, z]))`."""
        values = ", ".join(number_text(round(one, 2) + 0.0) for one in gravity_m_per_s2)
        return f"SimConfig(scene_config=SceneConfig(gravity=[{values}]))"
