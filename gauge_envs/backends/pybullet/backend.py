"""The PyBullet backend. The first build imports the engine."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib.metadata import version
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Backend, Simulation, Support
from gauge_envs.backends.pybullet.settings import settings_for
from gauge_envs.backends.pybullet.support import unsupported_features
from gauge_envs.backends.shared.replay import ReplayedSimulation
from gauge_envs.errors import MissingExtraError
from gauge_envs.scene import Scene

LAST_PYTHON_WITH_WHEELS = (3, 11)


class BackendPyBullet(Backend):
    """PyBullet on the CPU, in double precision: rigid bodies, joints, and ropes and soft bodies without contacts.

    A hanging bar of foam is 3 % too soft, and a swinging rope gains 2.5 % of its energy.

    Bullet keeps contact forces between steps and cannot save them. A restore therefore repeats the episode.
    """

    name = "pybullet"
    configurations = MappingProxyType({"out_of_box": {"preset": "out_of_box"}})
    joins_bodies = True

    def __init__(self) -> None:
        if find_spec("pybullet") is None:
            raise MissingExtraError("backend 'pybullet'", "pybullet", _missing())

    def versions(self) -> dict[str, str]:
        """Return the version of PyBullet, which contains the engine."""
        return {"pybullet": version("pybullet")}

    def supports(self, scene: Scene) -> Support:
        """Return the features of a scene that this backend does not support; see `support.unsupported_features`."""
        return Support(tuple(unsupported_features(scene)))

    def resolved_settings(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Return the settings of the scene's preset with the given changes."""
        return settings_for(scene, settings).model_dump(mode="json")

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of `SettingsPyBullet`."""
        from gauge_envs.backends.pybullet.simulation import SimulationPyBullet

        return ReplayedSimulation(SimulationPyBullet(scene, settings_for(scene, settings)))


def _missing() -> ImportError:
    """Return the failed import, with the way to PyBullet on this version of Python."""
    if sys.version_info[:2] <= LAST_PYTHON_WITH_WHEELS:
        return ModuleNotFoundError(name="pybullet")
    return ModuleNotFoundError(
        "PyBullet on Python 3.11 (for later versions it has no wheels; 'pip install pybullet' then compiles it)"
    )
