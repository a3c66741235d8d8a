"""The MuJoCo backend."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco

from gauge_envs.backends.base import Backend, ModelFile, Support
from gauge_envs.backends.mujoco.deformables import unsupported_features
from gauge_envs.backends.mujoco.mjcf_reader import load_model, read_model
from gauge_envs.backends.mujoco.model import build_model
from gauge_envs.backends.mujoco.settings import settings_for
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.errors import ParameterError
from gauge_envs.scene import Scene

__all__ = ["BackendMuJoCo"]


class BackendMuJoCo(Backend):
    """MuJoCo 4 on the CPU: rigid bodies, hinges, tethers, driven bodies, cloth, soft bodies, ropes and rods."""

    name = "mujoco"
    file_suffixes = (".xml",)

    def versions(self) -> dict[str, str]:
        """Return the version of the engine."""
        return {"mujoco": mujoco.__version__}

    def supports(self, scene: Scene) -> Support:
        """Return the unsupported features, such as cloth or a soft body that is attached to a dynamic body."""
        return Support(tuple(unsupported_features(scene)))

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> SimulationMuJoCo:
        """Build a scene; settings are the fields of `SettingsMuJoCo`."""
        chosen = settings_for(scene, settings)
        return SimulationMuJoCo(scene, chosen.model_dump(mode="json"), *build_model(scene, chosen))

    def read_file(self, path: Path, scene: Scene) -> ModelFile:
        """Read an MJCF file; see `gauge_envs.backends.mujoco.mjcf_reader`."""
        return read_model(path, scene, self.build(scene))

    def build_file(self, path: Path, scene: Scene, settings: Mapping[str, Any] | None = None) -> SimulationMuJoCo:
        """Build an MJCF file. It contains all numerical settings, so `settings` must be empty."""
        if settings:
            raise ParameterError(
                f"settings {', '.join(map(repr, settings))} with {path.name}: an MJCF file contains its own settings; "
                "change them in the file"
            )
        return SimulationMuJoCo(scene, *load_model(path, scene))
