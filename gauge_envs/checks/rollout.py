"""Records what happens in a scene on an engine, through the public contract alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Simulation
from gauge_envs.errors import GaugeError
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

__all__ = [
    "Course",
    "DeclinedError",
    "DivergedError",
    "PathsOfDrivers",
    "record",
    "states_now",
]


SAMPLES_PER_SECOND = round(1.0 / SAMPLE_INTERVAL_S)


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
