"""Push a cube over a board to a goal in the least time."""

import math
from dataclasses import replace

import numpy as np

from gauge_envs.scene import Box, Motion, Scene
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.states import row_of
from gauge_envs.tools.control.least_time import CUBE, LeastTimeLimit
from gauge_envs.tools.control.stage import (
    FRAME_S,
    X_AXIS,
    Y_AXIS,
    speed_to_rest,
    stage_driver,
    with_stage,
)
from gauge_envs.tools.control.tasks import EPISODE_STEPS

PUSHER = "pusher"
PUSHER_SIZE_M = (0.02, 0.12, 0.03)
"""Edges of the pusher [m]: wider than the cube, at the height of its middle."""
GAP_M = 0.001
"""Gap between pusher and cube at the start [m]."""
PAST_M = 0.005
"""Largest distance along x of the pusher's front past the cube's rear face at the start's orientation [m]."""
PUSHED_ON_M = 0.006
"""Distance by which the law's policy aims short [m]."""
LIFTED_M = 0.003
"""Largest change of height of the cube's centre [m]; a fall from there gives mu 0.24 m/s more braking."""


class PushLimit(LeastTimeLimit):
    """Push a cube over the level board to a goal 0.2 m away, in the scene of SlopeSlider-3.

    A pusher stands behind the cube, a bar that actions accelerate along x and y. It may push as hard as it likes, but
    friction alone brakes the cube. At the time t before its end, a motion that ends with the speed v is at most at
    v + mu g t. So the way is at most D = v T + mu g T^2 / 2, and from rest to rest T_law = sqrt(2 D / (mu g)): 0.39 s
    here. A pusher of the acceleration A that touches the cube from the start needs sqrt(1 + mu g / A) times as long:
    7 % here. So the optimum uses 0.88 of the limit or more. An impact can bring it nearer, and nothing beyond.

    The goal lies up to 8 degrees off the x axis, so the pusher must move obliquely, and the cube must not turn. The
    episode ends where the law would not hold: the pusher's front passes the cube's rear face by 5 mm, so that it could
    brake the cube, or the cube's centre leaves its height by 3 mm. See `LeastTimeLimit`.

    Two ways are left to pass the limit by a little, in an ideal engine too. The pusher's friction can brake the motion
    across x, where the cube ends up to 12 degrees off: 1 / cos 12 = 1.023. And friction that a lifted cube lacks comes
    later, at its fall, which lengthens the way by 0.8 mm. So `ratio` is at most 1.03; without an impact it is 0.88.

    Friction and restitution between pusher and cube are those of board and cube, as none were measured.
    """

    SCENE = "SlopeSlider-3"
    DRIVEN = PUSHER
    FLOOR = "board"
    LAW = "friction alone brakes the cube, so D <= mu g T^2 / 2 to rest"
    SIGMA_SOURCE = (
        "friction of the same cube on the same board in 19 or 20 real trials at 30 degrees: root mean square distance "
        "from the calibrated coefficient"
    )

    STEPS = EPISODE_STEPS["Push"]
    """Time of an episode: five times the least time."""

    ACCELERATION_M_PER_S2 = 20.0
    """Seven times what friction brakes with."""

    DISTANCE_M = 0.2
    WIDEST_RAD = math.radians(8.0)

    def _scene(self, stated: Scene) -> Scene:
        """Return the scene with the board at rest and the pusher behind the cube."""
        cube, board = stated.body(CUBE), stated.body(self.FLOOR)
        assert isinstance(cube.shape, Box)
        x, y, z = cube.pose.position_m
        behind = 0.5 * (cube.shape.size_m[0] + PUSHER_SIZE_M[0]) + GAP_M
        (on_board,) = (
            contact for contact in stated.contacts if self.FLOOR in contact.second
        )
        bodies = tuple(
            replace(board, motion=Motion.FIXED) if body is board else body
            for body in stated.bodies
        )
        driver = stage_driver(
            PUSHER,
            (X_AXIS, Y_AXIS),
            largest_speed_m_per_s=self.ACCELERATION_M_PER_S2 * self.duration_s,
        )
        still = replace(stated, bodies=bodies)
        return with_stage(
            still,
            PUSHER,
            PUSHER_SIZE_M,
            (x - behind, y, z),
            driver,
            pushes=CUBE,
            like=on_board,
        )

    def _clear(self, states: FloatArray) -> None:
        """Keep the pusher as far behind the cube as at its calibrated start."""
        scene = self.experiment.scene
        cube, pusher = row_of(scene, CUBE), row_of(scene, PUSHER)
        states[pusher, :3] += states[cube, :3] - scene.body(CUBE).pose.position_m

    @staticmethod
    def time_to_go_s(
        distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float
    ) -> float:
        """Return the time [s] of coasting to the goal, or past it and, if that were possible, back."""
        braked_s = abs(speed_m_per_s) / deceleration_m_per_s2
        over_m = 0.5 * speed_m_per_s * braked_s - distance_m
        if over_m <= 0.0:
            return math.sqrt(2.0 * distance_m / deceleration_m_per_s2)
        return braked_s + math.sqrt(2.0 * over_m / deceleration_m_per_s2)

    @staticmethod
    def least_deceleration_m_per_s2(
        distance_m: float, time_s: float, speed_m_per_s: float
    ) -> float:
        """Return the least deceleration a [m/s^2], with D = v T + a T^2 / 2."""
        return max(2.0 * (distance_m - speed_m_per_s * time_s) / time_s**2, 0.0)

    @property
    def _is_lost(self) -> bool:
        cube = self.experiment.scene.body(CUBE).shape
        assert isinstance(cube, Box)
        past_m = float(self._from_cube_m[0]) + 0.5 * (PUSHER_SIZE_M[0] + cube.size_m[0])
        return past_m > PAST_M or abs(self._risen_m) > LIFTED_M

    def _law_command(self, fraction: float) -> FloatArray:
        """Return the action that pushes until the cube coasts to the goal, if its friction is fraction mu."""
        braking = fraction * self.limit.value * self.experiment.scene.gravity_m_per_s2
        to_goal = self.goal_m - self._moved_m
        left_m = length_of(to_goal)
        direction = to_goal / max(left_m, 1e-9)
        speed = float(self._cube_velocity @ direction)
        pusher = self._stage.rate
        coasts_m = speed * abs(speed) / (2.0 * braking)
        wanted = np.zeros(2)
        # The pusher still pushes for a part of the frame in which it brakes.
        left_m -= PUSHED_ON_M
        if coasts_m < left_m:
            now = float(pusher @ direction)
            wanted = max(speed_to_rest(left_m, now, braking), 0.0) * direction
        change = (wanted - pusher) / FRAME_S / self.ACCELERATION_M_PER_S2
        return change / max(1.0, float(np.abs(change).max()))
