"""Builds scenes on a backend and records what happens, through the public contract alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from gauge_envs.backends import Backend, Simulation
from gauge_envs.backends.settings import check_drive_interval
from gauge_envs.checks.rollout import DeclinedError, Rollout, record
from gauge_envs.errors import GaugeError, ParameterError
from gauge_envs.scene import Scene

__all__ = [
    "BuildError",
    "Lab",
    "RefusedSettingsError",
]


T = TypeVar("T")


class RefusedSettingsError(ParameterError):
    """The backend refuses the settings that were given: no check can run with them."""


class BuildError(GaugeError):
    """`build` raised although `supports` was true."""


class Lab:
    """A backend on which scenes are built and run.

    Args:
        backend: The backend.
        settings: Numerical settings that replace its defaults.

    Attributes:
        settings_in_force: Settings of the last simulation that was built.
    """

    def __init__(self, backend: Backend, settings: Mapping[str, Any] | None = None) -> None:
        self.backend = backend
        self.settings_in_force: dict[str, Any] = {}
        self._settings = settings
        self._kept: dict[Callable[[Lab], Any], tuple[Any, Exception | None, dict[str, Any]]] = {}

    def build(self, scene: Scene) -> Simulation:
        """Build a scene; close the simulation after use.

        Raises:
            DeclinedError: The backend says that it cannot.
            BuildError: It said that it can, and could not.
            RefusedSettingsError: It refuses the settings that were given.
        """
        self.settings_in_force = {}
        support = self.backend.supports(scene)
        if not support:
            raise DeclinedError(support.missing)
        try:
            simulation = self.backend.build(scene, self._settings)
            check_drive_interval(simulation.settings)
        except Exception as error:
            if self._settings and isinstance(error, ParameterError):
                raise RefusedSettingsError(str(error)) from error
            raise BuildError(f"supports() was true, but build() raised {type(error).__name__}: {error}") from error
        self.settings_in_force = dict(simulation.settings)
        return simulation

    def first_supported(self, *scenes: Scene) -> Scene:
        """First scene that the backend can build, or else the last: from the richest to the simplest."""
        return next((scene for scene in scenes if self.backend.supports(scene)), scenes[-1])

    def rollout(self, scene: Scene, seconds: float) -> Rollout:
        """Build a scene, reset it, and record its rollout, drivers included.

        Args:
            scene: The scene.
            seconds: How long to simulate [s].
        """
        simulation = self.build(scene)
        try:
            simulation.reset(0)
            return record(simulation, scene, seconds)
        finally:
            simulation.close()

    def once(self, run: Callable[[Lab], T]) -> T:
        """What a run returned, run at its first use only: several checks may read one rollout.

        Raises:
            Exception: Whatever the run raised, at each use.
        """
        if run not in self._kept:
            self._kept[run] = self._attempt(run)
        value, failure, self.settings_in_force = self._kept[run]
        if failure is not None:
            raise failure
        return value  # type: ignore[no-any-return]

    def _attempt(self, run: Callable[[Lab], Any]) -> tuple[Any, Exception | None, dict[str, Any]]:
        """Result or exception of a run, and the settings that it ran with."""
        try:
            return run(self), None, self.settings_in_force
        except Exception as error:
            return None, error, self.settings_in_force
