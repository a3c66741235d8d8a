"""Carry a cube on a plate to a goal in the least time."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from gauge_envs.scene import Cylinder, Scene
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.control.least_time import LeastTimeLimit
from gauge_envs.tools.control.stage import (
    X_AXIS,
    Y_AXIS,
    acceleration_to_rest,
    stage_driver,
)
from gauge_envs.tools.control.tasks import EPISODE_STEPS

FALLEN_M = 0.01
"""Height that a cube loses as it leaves the plate [m]."""


class CarryLimit(LeastTimeLimit):
    """Carry a cube that stands on a plate over half a metre, in the scene of Turntable-1.

    The plate moves horizontally and does not turn. The cube speeds up and brakes with mu g at most, so from rest to
    rest it needs T_law = 2 sqrt(D / (mu g)): 0.73 to 0.80 s here. With the speed v left at the end, the least friction
    a / g solves 4 a D = (a T + v)^2 - 2 v^2. The goal lies in any direction. See `LeastTimeLimit`.
    """

    SCENE = "Turntable-1"
    DRIVEN = FLOOR = "plate"
    LAW = "the cube's acceleration is at most mu g, so 4 D / T^2 <= mu g from rest to rest"
    SIGMA_SOURCE = (
        "the relative uncertainty of the same cube's friction on the slope, from 19 or 20 real trials; no trial shows "
        "where cubes slip on the plate"
    )

    STEPS = EPISODE_STEPS["Carry"]
    """Time of an episode: four times the least time."""

    OWN_STEPS_S: ClassVar[Mapping[str, Mapping[str, float]]] = {
        "mujoco": {"training": 1 / 180}
    }

    ACCELERATION_M_PER_S2 = 4.5
    """1.2 to 1.4 times the 3.2 to 3.7 m/s^2 that friction holds, so that the actuator does not limit the task."""

    DISTANCE_M = 0.5
    WIDEST_RAD = math.pi

    def _scene(self, stated: Scene) -> Scene:
        """Return the scene, in which actions translate the plate."""
        driver = stage_driver(
            self.DRIVEN,
            (X_AXIS, Y_AXIS),
            largest_speed_m_per_s=self.ACCELERATION_M_PER_S2 * self.duration_s,
        )
        return replace(stated, drivers=(driver,))

    @staticmethod
    def time_to_go_s(
        distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float
    ) -> float:
        """Return the least time [s] to rest at the goal: a cube that is too fast passes the goal and comes back."""
        braked_s = abs(speed_m_per_s) / deceleration_m_per_s2
        braked_m = 0.5 * speed_m_per_s * braked_s
        if 0.0 < braked_m <= distance_m:
            fastest = math.sqrt(
                deceleration_m_per_s2 * distance_m + 0.5 * speed_m_per_s**2
            )
            return (2.0 * fastest - speed_m_per_s) / deceleration_m_per_s2
        return braked_s + 2.0 * math.sqrt(
            abs(distance_m - braked_m) / deceleration_m_per_s2
        )

    @staticmethod
    def least_deceleration_m_per_s2(
        distance_m: float, time_s: float, speed_m_per_s: float
    ) -> float:
        """Return the least acceleration a [m/s^2], with 4 a D = (a T + v)^2 - 2 v^2."""
        twice = 4.0 * distance_m - 2.0 * time_s * speed_m_per_s
        return (twice + math.hypot(twice, 2.0 * time_s * speed_m_per_s)) / (
            2.0 * time_s**2
        )

    @property
    def _is_lost(self) -> bool:
        plate = self.experiment.scene.body(self.DRIVEN).shape
        assert isinstance(plate, Cylinder)
        aside_m = length_of(self._from_cube_m)
        return aside_m > plate.radius_m or self._risen_m < -FALLEN_M

    def _law_command(self, fraction: float) -> FloatArray:
        """Return the action that accelerates and brakes towards the goal with fraction mu g."""
        limit_m_per_s2 = (
            fraction * self.limit.value * self.experiment.scene.gravity_m_per_s2
        )
        along = self.goal_m / self.DISTANCE_M
        across = np.array([-along[1], along[0]])
        left_m, speed = self.goal_m - self._moved_m, self._stage.rate
        # The little that brings a policy back to the line leaves the rest of the friction to the way.
        aside = acceleration_to_rest(
            float(left_m @ across), float(speed @ across), 0.2 * limit_m_per_s2
        )
        ahead = acceleration_to_rest(
            float(left_m @ along),
            float(speed @ along),
            math.sqrt(limit_m_per_s2**2 - aside**2),
        )
        return (ahead * along + aside * across) / self.ACCELERATION_M_PER_S2
