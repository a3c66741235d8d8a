"""The Drake backend. The first build imports the engine, which takes a second."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Backend, Simulation, Support
from gauge_envs.backends.drake.settings import settings_for
from gauge_envs.backends.drake.support import unsupported_features
from gauge_envs.errors import MissingExtraError
from gauge_envs.scene import Scene


class BackendDrake(Backend):
    """Drake's discrete multibody plant on the CPU: rigid bodies, hinges, tethers and driven bodies."""

    name = "drake"
    configurations = MappingProxyType(
        {name: {"preset": name} for name in ("tamsi", "sap", "similar", "point", "out_of_box")}
    )
    joins_bodies = True

    def __init__(self) -> None:
        if find_spec("pydrake") is None:
            raise MissingExtraError("backend 'drake'", "drake", ModuleNotFoundError(name="pydrake"))

    def versions(self) -> dict[str, str]:
        """Return the version of the engine."""
        return {"drake": version("drake")}

    def supports(self, scene: Scene) -> Support:
        """Return the features of a scene that this backend does not build; see `support.unsupported_features`."""
        return Support(tuple(unsupported_features(scene)))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Return the settings of the scene's preset with the given changes."""
        return settings_for(scene, settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of `SettingsDrake`."""
        from gauge_envs.backends.drake.simulation import SimulationDrake

        _start_quietly()
        return SimulationDrake(scene, settings_for(scene, settings))


@cache
def _start_quietly() -> None:
    """Keep Drake from logging a warning about deformable bodies for half-spaces. Its import resets the level."""
    logging.getLogger("drake").setLevel(logging.ERROR)
