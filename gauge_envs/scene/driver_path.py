"""Prescribed motion of a driven body in intervals of uniform acceleration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.drivers import Driver, mean_velocity
from gauge_envs.scene.geometry import Pose
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

__all__ = ["DriverPath"]


class DriverPath:
    """A driver's motion in intervals of uniform acceleration; the motion without actions is computed once.

    Args:
        driver: The driver.
        scene: Its scene.
        frame_count: Number of driven frames, including the first.
        interval_s: Length of an interval [s].

    Attributes:
        offsets: Displacement of each motion by actions so far [m or rad], shape [motion_count].
    """

    def __init__(
        self, driver: Driver, scene: Scene, frame_count: int, *, interval_s: float = SAMPLE_INTERVAL_S
    ) -> None:
        self.body = driver.body
        self.interval_s = interval_s
        self.motion_count = len(driver.motions)
        self._driver = driver
        self._start = scene.body(driver.body).pose
        self._scale = np.array([motion.residual_rate for motion in driver.motions])
        self.offsets = np.zeros(self.motion_count)
        count = round((frame_count - 1) / FRAME_RATE_HZ / interval_s)
        states = [driver.state(self._start, k * interval_s) for k in range(count + 1)]
        self._path = [_interval(*a, *b, interval_s) for a, b in pairwise(states)]

    def reset(self) -> None:
        """Return to the recorded motion."""
        self.offsets[:] = 0.0

    def interval(
        self, sample: int, action: NDArray[np.float64]
    ) -> tuple[Pose, NDArray[np.float64], NDArray[np.float64]]:
        """Return pose, velocity and acceleration of an interval for `World.drive`, and add the action's displacement.

        Args:
            sample: Index of the interval.
            action: Normalized rate of each motion, shape [motion_count].
        """
        if not self.offsets.any() and not action.any():
            return self._path[sample]
        rates = action * self._scale
        before = self._driver.state(self._start, sample * self.interval_s, self.offsets, rates)
        self.offsets = self.offsets + rates * self.interval_s
        after = self._driver.state(self._start, (sample + 1) * self.interval_s, self.offsets, rates)
        return _interval(*before, *after, self.interval_s)


def _interval(
    start: Pose,
    start_velocity: NDArray[np.float64],
    end: Pose,
    end_velocity: NDArray[np.float64],
    interval_s: float,
) -> tuple[Pose, NDArray[np.float64], NDArray[np.float64]]:
    """Return the uniformly accelerated motion that ends at the end pose, with velocities closest to the given ones."""
    miss = mean_velocity(start, end, interval_s) - 0.5 * (start_velocity + end_velocity)
    return start, start_velocity + miss, (end_velocity - start_velocity) / interval_s
