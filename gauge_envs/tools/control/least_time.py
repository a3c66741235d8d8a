"""Base of the tasks that bring a cube to a goal in the least time that its friction allows: carry and push."""

import math
from abc import abstractmethod
from typing import ClassVar

import numpy as np

from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import (
    FloatArray,
    length_of,
    quaternion_products,
    quaternion_vectors,
)
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.limit import Ending
from gauge_envs.tools.control.stage import Stage

CUBE = "cube"

TOLERANCE_M = 0.015
"""Largest distance of the cube's centre from the goal [m]."""

TOLERANCE_RAD = math.radians(10.0)
"""Largest rotation of the cube about the vertical from its start [rad]."""

REST_M_PER_S = 0.02
"""Largest horizontal speed of the cube at the goal, mean over 1/180 s [m/s]."""

ARRIVAL_SHARE = 2.0 / 3.0
"""Largest part of the reward that an arrival pays for its time; the way pays the rest."""


GOALS_IN_VIEW = 9
"""Number of directions in which the camera of pictures looks for goals."""


class LeastTimeLimit(ControlEnv):
    """Bring a cube to a goal, to rest and without turning it, in the least time.

    **Law.** Only friction holds the cube on the level face below it, so its horizontal acceleration is at most mu g.
    Each subclass states the least time that follows.

    **Goal.** A displacement of the cube of fixed length; the seed of the reset draws its direction. The cube has
    arrived when its centre is within 15 mm of the goal, it has turned by less than 10 degrees, and it is slower than
    20 mm/s.

    **Reached** is the smallest friction with which any motion could bring the cube as far in the same time, with the
    speed that it has left: at most mu. It is 0 if the cube did not arrive.

    **Reward.** A third of the decrease of the time to go, over that at the start, and on arrival two thirds of reached
    over mu. The time to go is the least time from the cube's place and velocity to rest at the goal, 0 on arrival. Its
    decreases add up to 1 at most, so an arrival earns 1/3 + 2/3 reached / mu, which the law limits to 1, and any other
    ending 1/3 at most. Time costs nothing by itself and the loss of the cube takes nothing: with such costs, to leave
    the cube alone is better than most of what exploration does.

    **Action.** Acceleration of the driven body along x and y, in units of `ACCELERATION_M_PER_S2`.

    Args:
        material: Material of the cube: `wood`, `plastic` or `metal`.
        **options: Keywords of `ControlEnv`: `backend`, `parameters`, `settings`, `render_mode`, `width`, `height`.

    Attributes:
        DRIVEN: Name of the driven body.
        FLOOR: Name of the body below the cube, whose friction limits the cube.
        ACCELERATION_M_PER_S2: Acceleration along an axis that an action of 1 commands.
        DISTANCE_M: Distance of the goal.
        WIDEST_RAD: Largest angle between the goal and the x axis.
        goal_m: Displacement of the cube that is asked for [m], shape [2].
    """

    DRIVEN: ClassVar[str]
    FLOOR: ClassVar[str]
    ACCELERATION_M_PER_S2: ClassVar[float]
    DISTANCE_M: ClassVar[float]
    WIDEST_RAD: ClassVar[float]
    QUANTITY = "friction that the time needs"
    COMMANDED = ("acceleration_x", "acceleration_y")
    OBSERVED = (
        "to_goal_x_m",
        "to_goal_y_m",
        "cube_velocity_x_m_per_s",
        "cube_velocity_y_m_per_s",
        "cube_yaw_rad",
        "driven_from_cube_x_m",
        "driven_from_cube_y_m",
        "driven_from_cube_velocity_x_m_per_s",
        "driven_from_cube_velocity_y_m_per_s",
        "time_s",
    )
    _at_time_limit = Ending.MISSED
    _stage: Stage

    def _prepare(self, scene: Scene) -> None:
        driven = scene.body(self.DRIVEN).pose
        self._stage = Stage(scene.drivers[0], driven, np.full(2, math.inf))

    def _limit_and_sigma(self) -> tuple[float, float]:
        return self._friction_and_sigma(CUBE, self.FLOOR)

    def reach_m(self) -> FloatArray:
        """Return goals, and places of the driven body as far from the cube as at the start [m], shape [n, 2, 3]."""
        angles = np.linspace(-self.WIDEST_RAD, self.WIDEST_RAD, GOALS_IN_VIEW)
        away = self.DISTANCE_M * np.column_stack(
            [np.cos(angles), np.sin(angles), np.zeros(GOALS_IN_VIEW)]
        )
        starts = [
            self.experiment.scene.body(name).pose.position_m
            for name in (CUBE, self.DRIVEN)
        ]
        return away[:, None] + np.asarray(starts)

    # --- what a subclass states ---

    @staticmethod
    @abstractmethod
    def least_deceleration_m_per_s2(
        distance_m: float, time_s: float, speed_m_per_s: float
    ) -> float:
        """Return mu g of the smallest friction that allows a distance in a time with a speed left, at least 0."""

    @staticmethod
    @abstractmethod
    def time_to_go_s(
        distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float
    ) -> float:
        """Return the time [s] that is left at a distance from the goal with a speed towards it, negative if away."""

    @property
    @abstractmethod
    def _is_lost(self) -> bool:
        """Whether the cube can no longer arrive."""

    # --- physics ---

    def _accelerate(self, command: FloatArray) -> FloatArray:
        return command * self.ACCELERATION_M_PER_S2

    @property
    def _yaw_rad(self) -> float:
        """Component along z of the cube's rotation vector since the start [rad]."""
        back = self._start[3:7] * [1.0, -1.0, -1.0, -1.0]
        turn = quaternion_products(self._cube[3:7], back)
        return float(quaternion_vectors(turn[None])[0, 2])

    @property
    def _moved_m(self) -> FloatArray:
        """Horizontal displacement of the cube since the start [m], shape [2]."""
        return (self._cube - self._start)[:2]

    @property
    def _risen_m(self) -> float:
        """Displacement of the cube upwards [m]."""
        return float(self._cube[2] - self._start[2])

    @property
    def _left_m(self) -> float:
        """Horizontal distance of the cube from the goal [m]."""
        return math.hypot(*(self.goal_m - self._moved_m).tolist())

    @property
    def _has_arrived(self) -> bool:
        return (
            self._left_m <= TOLERANCE_M
            and abs(self._yaw_rad) <= TOLERANCE_RAD
            and math.hypot(*self._cube_velocity.tolist()) <= REST_M_PER_S
        )

    @property
    def _from_cube_m(self) -> FloatArray:
        """Place of the driven body relative to the cube [m], shape [2]."""
        return (self._stage.state - self._cube)[:2]

    # --- task ---

    def _begin(self) -> None:
        angle = self.np_random.uniform(-self.WIDEST_RAD, self.WIDEST_RAD)
        self.goal_m = self.DISTANCE_M * np.array([math.cos(angle), math.sin(angle)])
        self._start = self._cube = self._state(CUBE)
        self._arrived_s = 0.0
        self._cube_velocity = np.zeros(2)
        self._samples = 0

    def _look(self) -> Ending | None:
        self._samples += 1
        before, self._cube = self._cube, self._state(CUBE)
        self._cube_velocity = (self._cube - before)[:2] / SAMPLE_INTERVAL_S
        if self._is_lost:
            return Ending.LOST
        if self._has_arrived:
            self._arrived_s = self._samples * SAMPLE_INTERVAL_S
            return Ending.REACHED
        return None

    def _observation(self) -> FloatArray:
        return np.concatenate(
            [
                self.goal_m - self._moved_m,
                self._cube_velocity,
                [self._yaw_rad],
                self._from_cube_m,
                self._stage.rate - self._cube_velocity,
                [self._samples * SAMPLE_INTERVAL_S],
            ]
        )

    # --- reward ---

    def _earned(self, ending: Ending | None) -> float:
        to_go = 0.0 if ending is Ending.REACHED else self._time_to_go()
        arrival = self._reached() / self.limit.value
        return ARRIVAL_SHARE * arrival - (1.0 - ARRIVAL_SHARE) * to_go

    def _time_to_go(self) -> float:
        """Return the time to go, over that at the start. Speed across the way takes its braking time in addition."""
        limit_m_per_s2 = self.limit.value * self.experiment.scene.gravity_m_per_s2
        way, left_m = self.goal_m - self._moved_m, self._left_m
        speed = float(self._cube_velocity @ way) / left_m if left_m > 0.0 else 0.0
        across = math.sqrt(
            max(float(self._cube_velocity @ self._cube_velocity) - speed**2, 0.0)
        )
        return (
            self.time_to_go_s(left_m, speed, limit_m_per_s2) + across / limit_m_per_s2
        ) / self.time_to_go_s(self.DISTANCE_M, 0.0, limit_m_per_s2)

    def _reached(self) -> float:
        if self._arrived_s == 0.0:
            return 0.0
        distance_m, speed = length_of(self._moved_m), length_of(self._cube_velocity)
        needed = self.least_deceleration_m_per_s2(distance_m, self._arrived_s, speed)
        return needed / self.experiment.scene.gravity_m_per_s2
