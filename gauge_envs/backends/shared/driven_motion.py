"""Motion of a driven body within one interval, for engines that take poses or constant velocities in each step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.backends.shared.rigid import body_state
from gauge_envs.scene import Pose
from gauge_envs.scene.geometry import vector


@dataclass(frozen=True)
class DrivenMotion:
    """Uniformly accelerated motion of a driven body, with the arguments of `World.drive`.

    Attributes:
        start: Pose at the start of the interval.
        velocity: Linear [m/s] and angular [rad/s] velocity at the start, world frame, shape [6].
        acceleration: Linear [m/s^2] and angular [rad/s^2] acceleration, world frame, shape [6].
    """

    start: Pose
    velocity: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))
    acceleration: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6))

    @classmethod
    def copied(cls, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> DrivenMotion:
        """Return the motion of a call of `World.drive`, whose arrays may change afterwards."""
        return cls(pose, np.array(velocity, dtype=float), np.array(acceleration, dtype=float))

    def travel(self, times_s: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return displacement [m] and rotation vector [rad] since the start.

        Args:
            times_s: Time since the start of the interval [s], or several ones, shape [time_count, 1].

        Returns:
            Shape [6], or [time_count, 6].
        """
        return np.asarray((self.velocity + 0.5 * np.asarray(self.acceleration) * times_s) * times_s)

    def pose(self, time_s: float) -> Pose:
        """Return the pose at a time since the start of the interval [s]."""
        travel = self.travel(time_s)
        rotation = Rotation.from_rotvec(travel[3:]) * self.start.rotation
        return Pose.from_rotation(vector(np.asarray(self.start.position_m) + travel[:3]), rotation)

    def velocity_at(self, time_s: float) -> NDArray[np.float64]:
        """Return linear [m/s] and angular [rad/s] velocity at a time since the start [s], shape [6]."""
        return np.asarray(self.velocity + np.asarray(self.acceleration) * time_s)

    def state_at(self, time_s: float) -> NDArray[np.float64]:
        """Return the state of the body at a time since the start [s], shape [13]; see `World.body_states`."""
        return body_state(self.pose(time_s), self.velocity_at(time_s))

    def mean_velocity(self, start_s: float, end_s: float) -> NDArray[np.float64]:
        """Return the constant velocity that takes the body from its pose at one time to that at another.

        A semi-implicit engine moves a body by its new velocity times the step, and so follows the motion exactly.

        Args:
            start_s: Start of the step since the start of the interval [s].
            end_s: End of the step [s].

        Returns:
            Linear [m/s] and angular [rad/s] velocity in the world frame, shape [6].
        """
        before, after = self.travel(start_s), self.travel(end_s)
        turned = Rotation.from_rotvec(after[3:]) * Rotation.from_rotvec(before[3:]).inv()
        return np.concatenate([after[:3] - before[:3], turned.as_rotvec()]) / (end_s - start_s)
