"""Newton behind the backend contract. The engine is imported with the first build: it takes seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

from gauge_envs.backends.base import Backend, Simulation, Support, Worlds
from gauge_envs.backends.newton.settings import settings_for
from gauge_envs.backends.newton.support import undoable
from gauge_envs.errors import MissingExtraError
from gauge_envs.scene import Scene

__all__ = [
    "BackendNewton",
]

MODULES = ("newton", "warp", "mujoco_warp")


class BackendNewton(Backend):
    """NVIDIA Newton on the CPU or a GPU: rigid bodies by its MuJoCo solver, all else by VBD, foam by implicit MPM too.

    Raises:
        MissingExtraError: Newton or what it needs is not installed.
    """

    name = "newton"

    def __init__(self) -> None:
        for module in MODULES:
            if find_spec(module) is None:
                raise MissingExtraError("backend 'newton'", "newton", ModuleNotFoundError(name=module))

    def versions(self) -> dict[str, str]:
        """Versions of the engine and of what it computes with."""
        return {package: version(package) for package in ("newton", "warp-lang", "mujoco-warp", "mujoco")}

    def supports(self, scene: Scene) -> Support:
        """What each of Newton's solvers can do; see `support.undoable`."""
        return Support(tuple(undoable(scene)))

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; settings are those of the preset's solver, see `settings.py`."""
        _start_quietly()
        from gauge_envs.backends.newton.simulation import SimulationNewton

        return SimulationNewton(scene, settings_for(scene, settings))

    def build_worlds(self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None) -> Worlds:
        """Build scenes as the worlds of one model, which a single step advances."""
        _start_quietly()
        from gauge_envs.backends.newton.simulation import WorldsNewton

        return WorldsNewton(scenes, settings_for(scenes[0], settings))


@cache
def _start_quietly() -> None:
    """Keep Warp from telling of every kernel that it loads."""
    import warp

    warp.config.log_level = warp.LOG_WARNING
