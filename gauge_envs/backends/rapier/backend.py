"""The Rapier backend. The first build imports the engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Backend, Simulation, Support, Worlds
from gauge_envs.backends.rapier.settings import settings_for
from gauge_envs.backends.rapier.support import unsupported_features
from gauge_envs.errors import MissingExtraError
from gauge_envs.scene import Scene


class BackendRapier(Backend):
    """Rapier on the CPU, in single precision: rigid bodies, hinges and strings.

    Trajectories are the same bit for bit in every run on one machine, and after each restored state.
    """

    name = "rapier"
    configurations = MappingProxyType(
        {"coulomb": {"friction_model": "coulomb"}, "out_of_box": {"preset": "out_of_box"}}
    )
    joins_bodies = True
    worlds_mix_constants = True

    def __init__(self) -> None:
        if find_spec("rapier3d") is None:
            raise MissingExtraError("backend 'rapier'", "rapier", ModuleNotFoundError(name="rapier3d"))

    def versions(self) -> dict[str, str]:
        """Return the version of the engine's package."""
        return {"rapier3d": version("rapier3d")}

    def supports(self, scene: Scene) -> Support:
        """Return the features of a scene that this backend does not support; see `support.unsupported_features`."""
        return Support(tuple(unsupported_features(scene)))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Return the settings of the scene's preset with the given changes."""
        return settings_for(scene, settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of `SettingsRapier`."""
        from gauge_envs.backends.rapier.simulation import SimulationRapier

        return SimulationRapier(scene, settings_for(scene, settings))

    def build_worlds(self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None) -> Worlds:
        """Build scenes in shared Rapier worlds, as far as the bits stay those of single simulations."""
        from gauge_envs.backends.rapier.simulation import WorldsRapier

        return WorldsRapier(scenes, settings_for(scenes[0], settings))
