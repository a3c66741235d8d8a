"""The tasks that bring a cube to a goal in the least time that its friction allows: carry and push."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from gauge_envs.evaluation.reference_path import ReferencePath
from gauge_envs.scene import Box, Cylinder, Motion, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from gauge_envs.tools.control.env import ControlEnv, Frame
from gauge_envs.tools.control.limit import Ending, Limit
from gauge_envs.tools.control.stage import FRAME_S, Stage, acceleration_to_rest, stage_driver, with_stage

CUBE = "cube"

X_AXIS, Y_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)

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
        SUBTASK: Subtask of the experiment that states the scene.
        DRIVEN: Name of the driven body.
        FLOOR: Name of the body below the cube, whose friction limits the cube.
        ACCELERATION_M_PER_S2: Acceleration along an axis that an action of 1 commands.
        DISTANCE_M: Distance of the goal.
        WIDEST_RAD: Largest angle between the goal and the x axis.
        goal_m: Displacement of the cube that is asked for [m], shape [2].
    """

    SUBTASK: ClassVar[str]
    DRIVEN: ClassVar[str]
    FLOOR: ClassVar[str]
    ACCELERATION_M_PER_S2: ClassVar[float]
    DISTANCE_M: ClassVar[float]
    WIDEST_RAD: ClassVar[float]
    COMMANDED: ClassVar[tuple[str, ...]] = ("acceleration_x", "acceleration_y")
    OBSERVED: ClassVar[tuple[str, ...]] = (
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

    def __init__(self, material: str, **options: Any) -> None:
        super().__init__(f"{self.FAMILY}-{self.SUBTASK}-{material}", **options)
        scene = self.experiment.scene
        self._stage = Stage(
            scene.drivers[0], scene.body(self.DRIVEN).pose, stroke_m=np.full(2, self.ACCELERATION_M_PER_S2)
        )
        self._cube_start = scene.body(CUBE).pose
        self._cube_start_m = np.array(self._cube_start.position_m)
        self._driven_start_m = np.array(scene.body(self.DRIVEN).pose.position_m[:2])
        self.goal_m = np.array([self.DISTANCE_M, 0.0])

    def reach(self) -> ReferencePath:
        """Return the goals, and the places of the driven body as far from the cube as at the start."""
        angles = np.linspace(-self.WIDEST_RAD, self.WIDEST_RAD, GOALS_IN_VIEW)
        away = self.DISTANCE_M * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(GOALS_IN_VIEW)])
        starts = [self.experiment.scene.body(name).pose.position_m for name in (CUBE, self.DRIVEN)]
        return ReferencePath(names=(CUBE, self.DRIVEN), places_m=away[:, None] + np.asarray(starts), is_full=True)

    def _limit(self) -> Limit:
        return self._friction_limit((CUBE, self.FLOOR), "friction that the time needs")

    # --- what a subclass states ---

    @staticmethod
    @abstractmethod
    def least_deceleration_m_per_s2(distance_m: float, time_s: float, speed_m_per_s: float) -> float:
        """Return mu g of the smallest friction that allows a distance in a time with a speed left, at least 0."""

    @staticmethod
    @abstractmethod
    def time_to_go_s(distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float) -> float:
        """Return the time [s] that is left at a distance from the goal with a speed towards it, negative if away."""

    @abstractmethod
    def _is_lost(self, cube_m: FloatArray) -> bool:
        """Return whether the cube can no longer arrive; `cube_m` is its centre [m], shape [3]."""

    # --- rollout ---

    def _begin(self) -> None:
        angle = self.np_random.uniform(-self.WIDEST_RAD, self.WIDEST_RAD)
        self.goal_m = self.DISTANCE_M * np.array([math.cos(angle), math.sin(angle)])
        self._stage.begin()
        self._cube_m = self._cube_start_m
        self._yaw_rad = self._arrived_s = 0.0
        self._cube_velocity = np.zeros(2)
        self._samples = 0
        self._to_go = self._time_to_go()

    def _advance(self, command: FloatArray) -> Frame:
        to_go, ending = self._to_go, None
        for _ in range(SAMPLES_PER_FRAME):
            self._stage.drive(self.world, command * self.ACCELERATION_M_PER_S2)
            yield
            self._samples += 1
            self._look()
            if self._is_lost(self._cube_m):
                ending = Ending.LOST
            elif self._has_arrived:
                ending, self._arrived_s = Ending.REACHED, self._samples * SAMPLE_INTERVAL_S
            if ending is not None:
                break
        self._to_go = 0.0 if ending is Ending.REACHED else self._time_to_go()
        progress = to_go - self._to_go
        arrival = self._reached() / self.limit.value
        return (1.0 - ARRIVAL_SHARE) * progress + ARRIVAL_SHARE * arrival, ending

    def _time_to_go(self) -> float:
        """Return the time to go, over that at the start. Speed across the way takes its braking time in addition."""
        most = self.limit.value * self.experiment.scene.gravity_m_per_s2
        way, left_m = self.goal_m - self._moved_m, self._left_m
        speed = float(self._cube_velocity @ way) / left_m if left_m > 0.0 else 0.0
        across = math.sqrt(max(float(self._cube_velocity @ self._cube_velocity) - speed**2, 0.0))
        return (self.time_to_go_s(left_m, speed, most) + across / most) / self.time_to_go_s(self.DISTANCE_M, 0.0, most)

    def _look(self) -> None:
        """Read the cube's place, its yaw, and its mean velocity since the last look, 1/180 s ago."""
        state, before = self.world.body_states((CUBE,))[0], self._cube_m
        self._cube_m = state[:3]
        self._cube_velocity = (self._cube_m - before)[:2] / SAMPLE_INTERVAL_S
        self._yaw_rad = _turned_rad(state[3:7].tolist(), self._cube_start.quaternion)

    @property
    def _moved_m(self) -> FloatArray:
        """Horizontal displacement of the cube since the start [m], shape [2]."""
        return (self._cube_m - self._cube_start_m)[:2]

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
        return self._driven_start_m + self._stage.offset_m - self._cube_m[:2]

    def _observation(self) -> FloatArray:
        return np.concatenate(
            [
                self.goal_m - self._moved_m,
                self._cube_velocity,
                [self._yaw_rad],
                self._from_cube_m,
                self._stage.rate_m_per_s - self._cube_velocity,
                [self._samples / (FRAME_RATE_HZ * SAMPLES_PER_FRAME)],
            ]
        )

    def _reached(self) -> float:
        if self._arrived_s == 0.0:
            return 0.0
        distance_m, speed = float(np.linalg.norm(self._moved_m)), float(np.linalg.norm(self._cube_velocity))
        needed = self.least_deceleration_m_per_s2(distance_m, self._arrived_s, speed)
        return needed / self.experiment.scene.gravity_m_per_s2


def _turned_rad(now: Sequence[float], start: Sequence[float]) -> float:
    """Return the component along z of the rotation vector [rad] from one orientation w, x, y, z to another."""
    w, x, y, z = now
    # The start's inverse.
    a, b, c, d = start[0], -start[1], -start[2], -start[3]
    real = w * a - x * b - y * c - z * d
    imaginary = (w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a)
    size = math.hypot(*imaginary)
    # The shorter way round; q and -q are the same orientation.
    angle = 2.0 * math.atan2(size if real >= 0.0 else -size, abs(real))
    return angle * imaginary[2] / size if size > 0.0 else 0.0


class CarryLimit(LeastTimeLimit):
    """Carry a cube that stands on a plate over half a metre, in the scene of Turntable-1.

    The plate moves horizontally and does not turn. The cube speeds up and brakes with mu g at most, so from rest to
    rest it needs T_law = 2 sqrt(D / (mu g)): 0.73 to 0.80 s here. With the speed v left at the end, the least friction
    a / g solves 4 a D = (a T + v)^2 - 2 v^2. The goal lies in any direction. See `LeastTimeLimit`.
    """

    FAMILY = "Turntable"
    SUBTASK = "1"
    DRIVEN = FLOOR = "plate"
    LAW = "the cube's acceleration is at most mu g, so 4 D / T^2 <= mu g from rest to rest"
    SIGMA_SOURCE = (
        "the relative uncertainty of the same cube's friction on the slope, from 19 or 20 real trials; no trial shows "
        "where cubes slip on the plate"
    )

    DURATION_S = 3.0
    """Time of an episode: four times the least time."""

    ACCELERATION_M_PER_S2 = 4.5
    """1.2 to 1.4 times the 3.2 to 3.7 m/s^2 that friction holds, so that the actuator does not limit the task."""

    DISTANCE_M = 0.5
    WIDEST_RAD = math.pi

    def _scene(self, stated: Scene) -> Scene:
        """Return the scene, in which actions translate the plate."""
        driver = stage_driver(
            self.DRIVEN, (X_AXIS, Y_AXIS), largest_speed_m_per_s=self.ACCELERATION_M_PER_S2 * self.DURATION_S
        )
        return replace(stated, drivers=(driver,))

    @staticmethod
    def time_to_go_s(distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float) -> float:
        """Return the least time [s] to rest at the goal: a cube that is too fast passes the goal and comes back."""
        braked_s = abs(speed_m_per_s) / deceleration_m_per_s2
        braked_m = 0.5 * speed_m_per_s * braked_s
        if 0.0 < braked_m <= distance_m:
            fastest = math.sqrt(deceleration_m_per_s2 * distance_m + 0.5 * speed_m_per_s**2)
            return (2.0 * fastest - speed_m_per_s) / deceleration_m_per_s2
        return braked_s + 2.0 * math.sqrt(abs(distance_m - braked_m) / deceleration_m_per_s2)

    @staticmethod
    def least_deceleration_m_per_s2(distance_m: float, time_s: float, speed_m_per_s: float) -> float:
        """Return the least acceleration a [m/s^2], with 4 a D = (a T + v)^2 - 2 v^2."""
        twice = 4.0 * distance_m - 2.0 * time_s * speed_m_per_s
        return (twice + math.hypot(twice, 2.0 * time_s * speed_m_per_s)) / (2.0 * time_s**2)

    def _is_lost(self, cube_m: FloatArray) -> bool:
        plate = self.experiment.scene.body(self.DRIVEN).shape
        assert isinstance(plate, Cylinder)
        return math.hypot(*self._from_cube_m.tolist()) > plate.radius_m or cube_m[2] < self._cube_start_m[2] - 0.01

    def _law_command(self, fraction: float) -> FloatArray:
        """Return the action that accelerates and brakes towards the goal with fraction mu g."""
        most = fraction * self.limit.value * self.experiment.scene.gravity_m_per_s2
        along = self.goal_m / self.DISTANCE_M
        across = np.array([-along[1], along[0]])
        left_m, speed = self.goal_m - self._moved_m, self._stage.rate_m_per_s
        # The little that brings a policy back to the line leaves the rest of the friction to the way.
        aside = acceleration_to_rest(float(left_m @ across), float(speed @ across), 0.2 * most)
        ahead = acceleration_to_rest(float(left_m @ along), float(speed @ along), math.sqrt(most**2 - aside**2))
        return (ahead * along + aside * across) / self.ACCELERATION_M_PER_S2


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

    FAMILY = "SlopeSlider"
    SUBTASK = "3"
    DRIVEN = PUSHER
    FLOOR = "board"
    LAW = "friction alone brakes the cube, so D <= mu g T^2 / 2 to rest"
    SIGMA_SOURCE = (
        "friction of the same cube on the same board in 19 or 20 real trials at 30 degrees: root mean square distance "
        "from the calibrated coefficient"
    )

    DURATION_S = 2.0
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
        (on_board,) = (contact for contact in stated.contacts if self.FLOOR in contact.second)
        bodies = tuple(replace(board, motion=Motion.FIXED) if body is board else body for body in stated.bodies)
        driver = stage_driver(
            PUSHER, (X_AXIS, Y_AXIS), largest_speed_m_per_s=self.ACCELERATION_M_PER_S2 * self.DURATION_S
        )
        still = replace(stated, bodies=bodies)
        return with_stage(still, PUSHER, PUSHER_SIZE_M, (x - behind, y, z), driver, pushes=CUBE, like=on_board)

    @staticmethod
    def time_to_go_s(distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float) -> float:
        """Return the time [s] of coasting to the goal, or past it and, if that were possible, back."""
        braked_s = abs(speed_m_per_s) / deceleration_m_per_s2
        over_m = 0.5 * speed_m_per_s * braked_s - distance_m
        if over_m <= 0.0:
            return math.sqrt(2.0 * distance_m / deceleration_m_per_s2)
        return braked_s + math.sqrt(2.0 * over_m / deceleration_m_per_s2)

    @staticmethod
    def least_deceleration_m_per_s2(distance_m: float, time_s: float, speed_m_per_s: float) -> float:
        """Return the least deceleration a [m/s^2], with D = v T + a T^2 / 2."""
        return max(2.0 * (distance_m - speed_m_per_s * time_s) / time_s**2, 0.0)

    def _is_lost(self, cube_m: FloatArray) -> bool:
        cube = self.experiment.scene.body(CUBE).shape
        assert isinstance(cube, Box)
        past_m = float(self._from_cube_m[0]) + 0.5 * (PUSHER_SIZE_M[0] + cube.size_m[0])
        return past_m > PAST_M or abs(cube_m[2] - self._cube_start_m[2]) > LIFTED_M

    def _law_command(self, fraction: float) -> FloatArray:
        """Return the action that pushes until the cube coasts to the goal, if its friction is fraction mu."""
        braking = fraction * self.limit.value * self.experiment.scene.gravity_m_per_s2
        to_goal = self.goal_m - self._moved_m
        left_m = float(np.linalg.norm(to_goal))
        direction = to_goal / max(left_m, 1e-9)
        speed = float(self._cube_velocity @ direction)
        pusher = self._stage.rate_m_per_s
        coasts_m = speed * abs(speed) / (2.0 * braking)
        wanted = np.zeros(2)
        # The pusher still pushes for a part of the frame in which it brakes.
        left_m -= PUSHED_ON_M
        if coasts_m < left_m:
            # The speed w after the frame: left = (v + w) t / 2 + w^2 / (2 a).
            half = 0.5 * braking * FRAME_S
            now = float(pusher @ direction)
            square = half**2 + 2.0 * braking * (left_m - 0.5 * now * FRAME_S)
            wanted = max(math.sqrt(max(square, 0.0)) - half, 0.0) * direction
        change = (wanted - pusher) / FRAME_S / self.ACCELERATION_M_PER_S2
        return change / max(1.0, float(np.abs(change).max()))
