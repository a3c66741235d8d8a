"""PyBullet: sequential impulses for rigid bodies, Featherstone's algorithm for joints, tetrahedra for foam.

The first build imports the engine.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from gauge_envs.backends.base import Simulation
from gauge_envs.backends.pybullet.settings import settings_for
from gauge_envs.backends.pybullet.support import unsupported_features
from gauge_envs.backends.shared.bundled import BundledBackend
from gauge_envs.backends.shared.replay import ReplayedSimulation
from gauge_envs.scene import Scene

__all__ = ["BackendPyBullet"]

LAST_PYTHON_WITH_WHEELS = (3, 11)


class BackendPyBullet(BundledBackend):
    """PyBullet on the CPU, in double precision: rigid bodies, joints, and ropes and soft bodies without contacts.

    A hanging bar of foam is 3 % too soft, and a swinging rope gains 2.5 % of its energy.

    Bullet keeps contact forces between steps and cannot save them. A restore therefore repeats the episode.
    """

    name = "pybullet"
    modules = ("pybullet",)
    packages = ("pybullet",)
    settings_for = staticmethod(settings_for)
    unsupported = staticmethod(unsupported_features)
    configurations = MappingProxyType({"out_of_box": {"preset": "out_of_box"}})
    joins_bodies = True

    def failed_import(self, module: str) -> ImportError:
        """Return the failed import, with the way to PyBullet on this version of Python."""
        if sys.version_info[:2] <= LAST_PYTHON_WITH_WHEELS:
            return super().failed_import(module)
        return ModuleNotFoundError(
            "PyBullet on Python 3.11 (for later versions it has no wheels; 'pip install pybullet' then compiles it)"
        )

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are the fields of `SettingsPyBullet`."""
        from gauge_envs.backends.pybullet.simulation import SimulationPyBullet

        return ReplayedSimulation(SimulationPyBullet(scene, settings_for(scene, settings)))
