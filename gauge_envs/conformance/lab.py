"""Builds scenes on a backend and records what happens, through the public contract alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Backend, Simulation
from gauge_envs.backends.presets import check_drive_interval
from gauge_envs.driver import Driver
from gauge_envs.episode import SAMPLE_INTERVAL_S, DriverPath
from gauge_envs.errors import GaugeError, ParameterError
from gauge_envs.scene import Pose, Scene

__all__ = [
    "SAMPLE_INTERVAL_S",
    "BuildError",
    "Course",
    "DeclinedError",
    "DivergedError",
    "Lab",
    "PathsOfDrivers",
    "RefusedSettingsError",
    "record",
    "states_now",
]

SAMPLES_PER_SECOND = round(1.0 / SAMPLE_INTERVAL_S)

T = TypeVar("T")


class DeclinedError(GaugeError):
    """The backend says that it cannot build a scene.

    Attributes:
        missing: Its reasons.
    """

    def __init__(self, missing: tuple[str, ...]) -> None:
        super().__init__("; ".join(missing))
        self.missing = missing


class DivergedError(GaugeError):
    """A simulation returned something that is not a finite number."""


class RefusedSettingsError(ParameterError):
    """The backend refuses the settings that were given: no check can run with them."""


class BuildError(GaugeError):
    """`build` raised although `supports` was true."""


@dataclass(frozen=True)
class Course:
    """What happened in a scene, 180 samples a second.

    Attributes:
        scene: The scene.
        times_s: Times of the samples, shape [sample_count].
        states: States of each rigid body by name, shape [sample_count, 13]; see `Simulation.body_states`.
        nodes_m: Nodes of each deformable body by name [m], shape [sample_count, node_count, 3].
    """

    scene: Scene
    times_s: NDArray[np.float64]
    states: dict[str, NDArray[np.float64]]
    nodes_m: dict[str, NDArray[np.float64]]

    def position(self, name: str) -> NDArray[np.float64]:
        """Positions of a rigid body [m], shape [sample_count, 3]."""
        return self.states[name][:, :3]

    def velocity(self, name: str) -> NDArray[np.float64]:
        """Velocities of a rigid body's origin [m/s], shape [sample_count, 3]."""
        return self.states[name][:, 7:10]

    def spin(self, name: str) -> NDArray[np.float64]:
        """Angular velocities of a rigid body [rad/s], shape [sample_count, 3]."""
        return self.states[name][:, 10:]

    def between(self, start_s: float, end_s: float) -> slice:
        """Samples from one time to another, both included."""
        return slice(round(start_s * SAMPLES_PER_SECOND), round(end_s * SAMPLES_PER_SECOND) + 1)

    def driven_pose(self, driver: Driver, sample: int) -> Pose:
        """Pose that a driver asks for at a sample."""
        return driver.pose(self.scene.body(driver.body).pose, float(self.times_s[sample]))


class PathsOfDrivers:
    """Drives the kinematic bodies of a scene along their recorded motions.

    Args:
        scene: The scene.
        seconds: How long it will be driven.
    """

    def __init__(self, scene: Scene, seconds: float) -> None:
        self._paths = [DriverPath(driver, scene, round(30 * seconds) + 2) for driver in scene.drivers]

    def drive(self, simulation: Simulation, sample: int) -> None:
        """Prescribe all driven bodies for the interval that starts at a sample."""
        for path in self._paths:
            simulation.drive(path.body, *path.interval(sample, np.zeros(path.motion_count)))


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

    def course(self, scene: Scene, seconds: float) -> Course:
        """Build a scene, reset it, and record its course, drivers included.

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
        """What a run returned, run at its first use only: several checks may read one course.

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


def record(simulation: Simulation, scene: Scene, seconds: float) -> Course:
    """Record a simulation from where it stands, at its start.

    Args:
        simulation: The simulation, at time 0.
        scene: Its scene.
        seconds: How long to simulate [s].

    Raises:
        DivergedError: A state or a node is not finite.
    """
    count = round(seconds * SAMPLES_PER_SECOND)
    names = [body.name for body in scene.bodies]
    paths = PathsOfDrivers(scene, seconds)
    states = np.empty((count + 1, len(names), 13))
    nodes: dict[str, list[NDArray[np.float64]]] = {body.name: [] for body in scene.deformables}
    for sample in range(count + 1):
        states[sample] = simulation.body_states(names)
        for name, rows in nodes.items():
            rows.append(np.array(simulation.nodes(name), dtype=np.float64))
        if sample < count:
            paths.drive(simulation, sample)
            simulation.advance(SAMPLE_INTERVAL_S)
    course = Course(
        scene=scene,
        times_s=SAMPLE_INTERVAL_S * np.arange(count + 1, dtype=np.float64),
        states={name: states[:, index] for index, name in enumerate(names)},
        nodes_m={name: np.array(rows) for name, rows in nodes.items()},
    )
    _check_finite(course)
    return course


def states_now(simulation: Simulation, names: Sequence[str]) -> NDArray[np.float64]:
    """Copy of the states of bodies now, shape [len(names), 13]."""
    return np.array(simulation.body_states(names), dtype=np.float64)


def _check_finite(course: Course) -> None:
    for name, values in (course.states | course.nodes_m).items():
        finite = np.isfinite(values).reshape(len(values), -1).all(axis=1)
        if not finite.all():
            raise DivergedError(f"{name!r} is not finite from {course.times_s[int(finite.argmin())]:.3g} s on")
