"""Drive the kinematic bodies of a scene interval by interval."""

import math
from collections.abc import Sequence

import numpy as np

from gauge_envs.backends.world import Simulation, World
from gauge_envs.scene import Scene
from gauge_envs.scene.driver_path import DriverPath, Interval
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S


class DriverPaths:
    """Recorded motions of a scene's kinematic bodies, cut into intervals.

    Args:
        scene: The scene.
        seconds: Time for which the scene will be driven [s].
        interval_s: Length of an interval [s].

    Attributes:
        is_passive: Whether nothing is driven.
        no_rates: Residual rates of zero, shape [motion_count].
    """

    def __init__(
        self, scene: Scene, seconds: float, interval_s: float = SAMPLE_INTERVAL_S
    ) -> None:
        frame_count = 2 + math.ceil(seconds * FRAME_RATE_HZ)
        self._interval_s = interval_s
        self._paths = [
            DriverPath(driver, scene, frame_count, interval_s=interval_s)
            for driver in scene.drivers
        ]
        self.is_passive = not self._paths
        self.no_rates = np.zeros(sum(path.motion_count for path in self._paths))

    def reset(self) -> None:
        """Return to the recorded motion."""
        for path in self._paths:
            path.reset()

    def drive(self, world: World, index: int, rates: FloatArray) -> None:
        """Prescribe the motion of all kinematic bodies for an interval, counted from 0.

        Args:
            world: A world of the scene.
            index: Number of the interval.
            rates: Normalized residual rate of each motion, shape [motion_count].
        """
        self.prescribe(world, self.motions(index, rates, 1)[0])

    def motions(
        self, index: int, rates: FloatArray, count: int
    ) -> list[tuple[Interval, ...]]:
        """Return the motions of all kinematic bodies in each of `count` intervals; see `DriverPath.intervals`."""
        of_paths, first = [], 0
        for path in self._paths:
            end = first + path.motion_count
            of_paths.append(path.intervals(index, rates[first:end], count))
            first = end
        return [
            tuple(intervals[number] for intervals in of_paths)
            for number in range(count)
        ]

    def prescribe(self, world: World, motions: Sequence[Interval]) -> None:
        """Prescribe motions of `motions` for an interval."""
        for path, motion in zip(self._paths, motions, strict=True):
            world.drive(path.body, *motion)

    def advance(self, simulation: Simulation, index: int) -> None:
        """Drive a scene through an interval of its recorded motion, counted from 0, and simulate it."""
        self.drive(simulation, index, self.no_rates)
        simulation.advance(self._interval_s)
