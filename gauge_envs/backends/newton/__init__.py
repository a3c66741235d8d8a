"""NVIDIA Newton: its MuJoCo solver for rigid bodies, VBD for deformable bodies, implicit MPM as a choice for foam.

The first build imports the engine, which takes seconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Simulation, Worlds
from gauge_envs.backends.newton.settings import SettingsNewton, settings_for
from gauge_envs.backends.newton.support import check_preset, unsupported_features
from gauge_envs.backends.shared.bundled import BundledBackend, check_settings
from gauge_envs.scene import Scene

__all__ = ["BackendNewton"]


class BackendNewton(BundledBackend):
    """NVIDIA Newton on the CPU or a GPU.

    Its MuJoCo solver simulates rigid scenes and VBD all others; presets `mpm...` select implicit MPM for foam.
    """

    name = "newton"
    modules = ("newton", "warp", "mujoco_warp")
    packages = ("newton", "warp-lang", "mujoco-warp", "mujoco")
    settings_for = staticmethod(settings_for)
    unsupported = staticmethod(unsupported_features)
    configurations = MappingProxyType({"out_of_box": {"preset": "out_of_box"}, "paper": {"preset": "paper"}})
    joins_bodies = True
    worlds_mix_constants = True
    worlds_restart_alone = True

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of the settings class of the preset's solver."""
        chosen = _checked(scene, settings)
        from gauge_envs.backends.newton.simulation import SimulationNewton

        return SimulationNewton(scene, chosen)

    def build_worlds(self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None) -> Worlds:
        """Build scenes as worlds of one model, which advance in the same step."""
        chosen = _checked(scenes[0], settings)
        from gauge_envs.backends.newton.simulation import WorldsNewton

        return WorldsNewton(scenes, chosen)


def _checked(scene: Scene, changes: Mapping[str, Any] | None) -> SettingsNewton:
    """Return the settings for a scene if their solver supports it, and start Warp."""
    settings = settings_for(scene, changes)
    check_preset(scene, settings)
    check_settings("Newton", settings, unsupported_features(scene, settings))
    _start_quietly()
    return settings


@cache
def _start_quietly() -> None:
    """Keep Warp from logging every kernel that it loads."""
    import warp

    warp.config.log_level = warp.LOG_WARNING
