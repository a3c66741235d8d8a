"""The PhysX backend. The first build imports SAPIEN, which takes 0.4 s."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Backend, Simulation, Support
from gauge_envs.backends.physx.settings import settings_for
from gauge_envs.backends.physx.support import unsupported_features
from gauge_envs.backends.shared.replay import ReplayedSimulation
from gauge_envs.errors import MissingExtraError
from gauge_envs.scene import Scene


class BackendPhysX(Backend):
    """NVIDIA PhysX 5 on the CPU, in single precision, as SAPIEN ships it: rigid bodies, hinges, strings, driven bodies.

    `restore` repeats all calls since the reset, since PhysX keeps contact caches that cannot be saved.
    """

    name = "physx"
    configurations = MappingProxyType(
        {"PGS": {"solver": "PGS"}, "out_of_box": {"preset": "out_of_box"}, "isaac": {"preset": "isaac"}}
    )
    joins_bodies = True

    def __init__(self) -> None:
        if find_spec("sapien") is None:
            raise MissingExtraError("backend 'physx'", "physx", ModuleNotFoundError(name="sapien"))

    def versions(self) -> dict[str, str]:
        """Return the version of SAPIEN and of the PhysX that it contains."""
        from gauge_envs.backends.physx.engine import physx

        return {"sapien": version("sapien"), "physx": str(physx.version())}

    def supports(self, scene: Scene) -> Support:
        """Return the features of a scene that this backend does not support, such as deformable bodies."""
        return Support(tuple(unsupported_features(scene)))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Return the settings of the scene's preset with the given changes."""
        return settings_for(scene, settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of `SettingsPhysX`."""
        chosen = settings_for(scene, settings)
        from gauge_envs.backends.physx.simulation import SimulationPhysX

        return ReplayedSimulation(SimulationPhysX(scene, chosen))
