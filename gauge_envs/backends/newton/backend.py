"""The Newton backend. The first build imports the engine, which takes seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Backend, Simulation, Support, Worlds
from gauge_envs.backends.newton.settings import SettingsNewton, settings_for
from gauge_envs.backends.newton.support import check_preset, check_support, unsupported_features
from gauge_envs.errors import MissingExtraError
from gauge_envs.scene import Scene

MODULES = ("newton", "warp", "mujoco_warp")


class BackendNewton(Backend):
    """NVIDIA Newton on the CPU or a GPU.

    Its MuJoCo solver simulates rigid scenes and VBD all others; presets `mpm...` select implicit MPM for foam.
    """

    name = "newton"
    configurations = MappingProxyType({"out_of_box": {"preset": "out_of_box"}, "paper": {"preset": "paper"}})
    joins_bodies = True
    worlds_mix_constants = True
    worlds_restart_alone = True

    def __init__(self) -> None:
        for module in MODULES:
            if find_spec(module) is None:
                raise MissingExtraError("backend 'newton'", "newton", ModuleNotFoundError(name=module))

    def versions(self) -> dict[str, str]:
        """Return the versions of the engine and of its solver packages."""
        return {package: version(package) for package in ("newton", "warp-lang", "mujoco-warp", "mujoco")}

    def supports(self, scene: Scene) -> Support:
        """Return the features of a scene that Newton's solvers do not support; see `support.unsupported_features`."""
        return Support(tuple(unsupported_features(scene)))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Return the settings of the scene's preset with the given changes."""
        return settings_for(scene, settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of the settings class of the preset's solver."""
        resolved = _checked_settings(scene, settings)
        _start_quietly()
        from gauge_envs.backends.newton.simulation import SimulationNewton

        return SimulationNewton(scene, resolved)

    def build_worlds(self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None) -> Worlds:
        """Build scenes as worlds of one model, which advance in the same step."""
        resolved = _checked_settings(scenes[0], settings)
        _start_quietly()
        from gauge_envs.backends.newton.simulation import WorldsNewton

        return WorldsNewton(scenes, resolved)


def _checked_settings(scene: Scene, changes: Mapping[str, Any] | None) -> SettingsNewton:
    settings = settings_for(scene, changes)
    check_preset(scene, settings)
    check_support(scene, settings)
    return settings


@cache
def _start_quietly() -> None:
    """Keep Warp from logging every kernel that it loads."""
    import warp

    warp.config.log_level = warp.LOG_WARNING
