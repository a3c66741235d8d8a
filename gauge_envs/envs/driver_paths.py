"""Drive the kinematic bodies of a scene interval by interval."""

import math

import numpy as np

from gauge_envs.backends.base import Simulation
from gauge_envs.scene import Scene
from gauge_envs.scene.driver_path import DriverPath, motor_commands
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S


class DriverPaths:
    """Recorded motions of a scene's kinematic bodies, cut into intervals.

    Args:
        scene: The scene.
        seconds: Time for which the scene will be driven [s].
        interval_s: Length of an interval [s].
    """

    def __init__(self, scene: Scene, seconds: float, interval_s: float = SAMPLE_INTERVAL_S) -> None:
        frame_count = 2 + math.ceil(seconds * FRAME_RATE_HZ)
        self._interval_s = interval_s
        self._commands = motor_commands(scene, math.ceil(seconds / interval_s) + 1, interval_s)
        self._paths = [DriverPath(driver, scene, frame_count, interval_s=interval_s) for driver in scene.drivers]

    def advance(self, simulation: Simulation, index: int) -> None:
        """Drive all kinematic bodies and joints through an interval, counted from 0, and simulate it."""
        for path in self._paths:
            simulation.drive(path.body, *path.interval(index, np.zeros(path.motion_count)))
        if self._commands.size:
            simulation.command(self._commands[index])
        simulation.advance(self._interval_s)
