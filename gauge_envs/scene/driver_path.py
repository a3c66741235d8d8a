"""Prescribed motion of a driven body in intervals of uniform acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import FloatArray, Pose
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

Interval = tuple[Pose, FloatArray, FloatArray]


class DriverPath:
    """A driver's motion in intervals of uniform acceleration.

    The motion without actions is computed once and shared; its arrays are read-only.

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
        self._path = _recorded_path(driver, self._start, count, interval_s)

    def reset(self) -> None:
        """Return to the recorded motion."""
        self.offsets[:] = 0.0

    def interval(self, sample: int, action: FloatArray) -> Interval:
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
        return _intervals([before, after], self.interval_s)[0]


@lru_cache(maxsize=32)
def _recorded_path(driver: Driver, start: Pose, count: int, interval_s: float) -> tuple[Interval, ...]:
    """Return the motion without actions; for minutes of motion it takes longer than the build of most scenes."""
    return _intervals([driver.state(start, k * interval_s) for k in range(count + 1)], interval_s)


def _intervals(states: Sequence[tuple[Pose, FloatArray]], interval_s: float) -> tuple[Interval, ...]:
    """Return the uniformly accelerated motions between states, with velocities closest to the given ones.

    Args:
        states: Pose and velocity at the ends of the intervals; each motion ends at the next pose.
        interval_s: Length of an interval [s].
    """
    poses, velocities = [pose for pose, _ in states], np.array([velocity for _, velocity in states])
    turns = Rotation.from_quat([pose.quaternion for pose in poses], scalar_first=True)
    linear = np.diff([pose.position_m for pose in poses], axis=0) / interval_s
    angular = (turns[1:] * turns[:-1].inv()).as_rotvec() / interval_s
    starts, ends = velocities[:-1], velocities[1:]
    miss = np.concatenate([linear, angular], axis=1) - 0.5 * (starts + ends)
    motions = starts + miss, (ends - starts) / interval_s
    for motion in motions:
        motion.flags.writeable = False
    return tuple(zip(poses[:-1], *motions, strict=True))
