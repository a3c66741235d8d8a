"""Build scenes on a backend and record them, through the public contract alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.backends import Backend, Simulation
from gauge_envs.backends.base import scene_support
from gauge_envs.backends.settings import check_drive_interval, settings_record
from gauge_envs.errors import BackendError, GaugeError, ParameterError, UnsupportedSceneError
from gauge_envs.runs.rollout import DeclinedError, Rollout, raised_at, record
from gauge_envs.scene import Scene

T = TypeVar("T")


class RefusedSettingsError(ParameterError):
    """The backend refuses the given settings, so that no check can run."""


class BuildError(GaugeError):
    """`build` raised an exception although `supports` was true."""


class Lab:
    """A backend, on which checks build and run their scenes.

    Args:
        backend: The backend.
        settings: Numerical settings that replace its defaults.

    Attributes:
        settings_in_force: Settings of the simulation that was built last.
    """

    def __init__(self, backend: Backend, settings: Mapping[str, Any] | None = None) -> None:
        self.backend = backend
        self.settings_in_force: dict[str, Any] = {}
        self._settings = settings
        self._kept: dict[Callable[[Lab], Any], tuple[Any, Exception | None, dict[str, Any]]] = {}

    def build(self, scene: Scene) -> Simulation:
        """Build a scene; close the simulation after use.

        Raises:
            DeclinedError: The backend reports that it cannot build the scene, or not with the given settings.
            BuildError: The backend reports that it can build the scene, and fails.
            RefusedSettingsError: The backend refuses the given settings.
        """
        self.settings_in_force = {}
        support = scene_support(self.backend, scene)
        if not support:
            raise DeclinedError(support.missing)
        try:
            simulation = self.backend.build(scene, self._settings)
            check_drive_interval(simulation.settings)
            settings_record(self.backend.name, simulation.settings)
        except Exception as error:
            if self._settings and isinstance(error, UnsupportedSceneError):
                # `supports` answers for the default settings; a preset for other scenes is no fault of the backend.
                raise DeclinedError((str(error),)) from error
            if self._settings and isinstance(error, ParameterError):
                raise RefusedSettingsError(str(error)) from error
            raise BuildError(
                f"supports() was true, but build() raised {type(error).__name__}: {error}{raised_at(error)}"
            ) from error
        self.settings_in_force = dict(simulation.settings)
        return simulation

    def first_supported(self, *scenes: Scene) -> Scene:
        """Return the first scene that the backend can build, or the last one when it can build none."""
        return next((scene for scene in scenes if scene_support(self.backend, scene)), scenes[-1])

    def rollout(self, scene: Scene, seconds: float | None = None) -> Rollout:
        """Build a scene, reset it, drive it and record it.

        Args:
            scene: The scene.
            seconds: Time to simulate [s]; None for the duration of the scene.
        """
        with closing(self.build(scene)) as simulation:
            simulation.reset(0)
            return record(simulation, scene, scene.duration_s if seconds is None else seconds)

    def once(self, function: Callable[[Lab], T]) -> T:
        """Return the value of a function of the lab, which is called at its first use only.

        Several checks can thus read one rollout.

        Raises:
            Exception: The exception of the function, at each use.
        """
        if function not in self._kept:
            self._kept[function] = self._attempt(function)
        value, error, self.settings_in_force = self._kept[function]
        if error is not None:
            raise error
        return value  # type: ignore[no-any-return]

    def _attempt(self, function: Callable[[Lab], Any]) -> tuple[Any, Exception | None, dict[str, Any]]:
        """Return the value or the exception of a function, and the settings that were in force."""
        try:
            return function(self), None, self.settings_in_force
        except Exception as error:
            return None, error, self.settings_in_force


def push(simulation: Simulation, body: str, wrench: ArrayLike) -> None:
    """Apply a wrench to a body; raise `DeclinedError` if the engine applies none."""
    try:
        simulation.apply_wrench(body, np.asarray(wrench))
    except BackendError as error:
        raise DeclinedError((str(error),)) from error
