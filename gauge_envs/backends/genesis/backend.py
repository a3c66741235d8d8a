"""The Genesis backend. The first build imports the engine and compiles its kernels, which takes up to two minutes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Backend, Simulation, Support, Worlds
from gauge_envs.backends.genesis.presets import settings_for
from gauge_envs.backends.genesis.support import check_support, unsupported_features
from gauge_envs.errors import MissingExtraError
from gauge_envs.scene import Scene

MODULES = ("genesis", "torch")


class BackendGenesis(Backend):
    """Genesis on the CPU.

    Rigid bodies move by its constraint solver, a descendant of MuJoCo's with a friction cone of its own.
    """

    name = "genesis"
    configurations = MappingProxyType({"CG": {"constraint_solver": "CG"}, "out_of_box": {"preset": "out_of_box"}})

    def __init__(self) -> None:
        for module in MODULES:
            if find_spec(module) is None:
                raise MissingExtraError("backend 'genesis'", "genesis", ModuleNotFoundError(name=module))

    def versions(self) -> dict[str, str]:
        """Return the versions of the engine, its compiler, PyTorch and MuJoCo, which reads the bodies' description."""
        return {package: version(package) for package in ("genesis-world", "quadrants", "torch", "mujoco")}

    def supports(self, scene: Scene) -> Support:
        """Return the features of a scene that Genesis does not support; see `support.unsupported_features`."""
        return Support(tuple(unsupported_features(scene, settings_for(scene))))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Return the settings of the scene's preset with the given changes."""
        return settings_for(scene, settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of `SettingsGenesis`, or of the class of the preset's solver."""
        chosen = settings_for(scene, settings)
        check_support(scene, chosen)
        from gauge_envs.backends.genesis.simulation import SimulationGenesis

        return SimulationGenesis(scene, chosen)

    def build_worlds(self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None) -> Worlds:
        """Build scenes as environments of one Genesis scene, which advance in the same step.

        Scenes with deformable bodies, and scenes that differ in more than start poses, advance one after another.
        """
        chosen = settings_for(scenes[0], settings)
        check_support(scenes[0], chosen)
        from gauge_envs.backends.genesis.worlds import can_share, new_worlds

        return new_worlds(scenes, chosen) if can_share(scenes, chosen) else super().build_worlds(scenes, settings)
