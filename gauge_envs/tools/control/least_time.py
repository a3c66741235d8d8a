"""Bring a cube to a goal in the least time that its friction allows: carry it on a plate, or push it over a board."""

import math
from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from gauge_envs.scene import Motion, Pose, Scene
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.states import row_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.control.env import Ending, Limit
from gauge_envs.tools.control.friction import CUBE, CubeLimit
from gauge_envs.tools.control.stage import (
    FRAME_S,
    X_AXIS,
    Y_AXIS,
    acceleration_to_rest,
    speed_to_rest,
    stage_driver,
    with_box,
)

TOLERANCE_M = 0.015
"""Largest distance of the cube's centre from the goal [m]."""
TOLERANCE_RAD = math.radians(10.0)
"""Largest rotation of the cube about the vertical from its start [rad]."""
REST_M_PER_S = 0.02
"""Largest horizontal speed of the cube at the goal, mean over 1/180 s [m/s]."""
ARRIVAL_SHARE = 2.0 / 3.0
"""Largest part of the reward that an arrival pays for its time; the displacement pays the rest."""

FALLEN_M = 0.01
"""Height that a carried cube loses as it leaves the plate [m]."""
ASIDE_SHARE = 0.2
"""Share of the friction with which the law's carrying policy returns to the line; the rest acts along the line."""

PUSHER = "pusher"
PUSHER_SIZE_M = (0.02, 0.12, 0.03)
"""Edges of the pusher [m]: wider than the cube, at the height of its middle."""
GAP_M = 0.001
"""Gap between pusher and cube at the start [m]."""
PAST_M = 0.005
"""Largest distance along x of the pusher's front past the cube's rear face at the start's orientation [m]."""
PUSHED_ON_M = 0.006
"""Distance by which the law's pushing policy aims short [m], as the pusher still pushes while it begins to brake."""
LIFTED_M = 0.003
"""Largest change of height of the cube's centre [m]; a fall from there gives mu 0.24 m/s more braking."""


class LeastTimeLimit(CubeLimit):
    """Bring a cube to a goal, to rest and without turning it, in the least time.

    **Law.** Only friction holds the cube on the level face below it, so its horizontal acceleration is at most mu g.
    Each subclass gives the least time that follows.

    **Goal.** A displacement of the cube of fixed length; the seed of the reset draws its direction. The cube has
    arrived when its centre is within 15 mm of the goal, its rotation is below 10 degrees, and its speed is below
    20 mm/s.

    **Reached** is the smallest friction with which any motion could bring the cube as far in the same time, with the
    same final speed. It is at most mu, and 0 if the cube did not arrive.

    **Reward.** A third of the decrease of the time to go, over the time to go at the start; on arrival, two thirds of
    reached over mu. The time to go is the least time from the cube's place and velocity to rest at the goal, 0 on
    arrival. Its decreases add up to 1 at most. So an arrival earns 1/3 + 2/3 reached / mu, which the law limits to 1.
    Any other ending earns 1/3 at most. Time and the loss of the cube cost nothing: with such costs, not moving the cube
    would earn more than most exploration.

    **Action.** Acceleration of the driven body along x and y, in units of `ACCELERATION`, in m/s^2.

    Args:
        material: Material of the cube: `wood`, `plastic` or `metal`.

    The other arguments are those of `ControlEnv`.

    Attributes:
        DRIVEN: Name of the driven body.
        DISTANCE_M: Distance of the goal.
        MAX_ANGLE_RAD: Largest angle between the goal and the x axis.
        goal_m: Desired displacement of the cube [m], shape [2].
    """

    DRIVEN: ClassVar[str]
    DISTANCE_M: ClassVar[float]
    MAX_ANGLE_RAD: ClassVar[float]
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

    # --- hooks of a subclass ---

    @staticmethod
    @abstractmethod
    def time_to_go_s(
        distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float
    ) -> float:
        """Return the remaining time [s] at a distance from the goal, with a speed towards it, negative if away."""

    @abstractmethod
    def _is_lost(self, driven_from_cube_m: FloatArray, risen_m: float) -> bool:
        """Return whether the cube can no longer arrive.

        Args:
            driven_from_cube_m: Place of the driven body relative to the cube [m], shape [2].
            risen_m: Displacement of the cube upwards [m].
        """

    # --- episode ---

    def _begin(self) -> None:
        angle = self.np_random.uniform(-self.MAX_ANGLE_RAD, self.MAX_ANGLE_RAD)
        self.goal_m = self.DISTANCE_M * np.array([math.cos(angle), math.sin(angle)])
        self._start = self._cube = self._state(CUBE)
        self._intervals = 0
        self._read(self._start)

    def _read(self, before: FloatArray) -> None:
        """Compute time, place and velocity of the cube from its state and its state before, shape [13]."""
        # The last frame of an episode may be incomplete.
        self._time_s = self._intervals * SAMPLE_INTERVAL_S
        self._cube_velocity = (self._cube - before)[:2] / SAMPLE_INTERVAL_S
        # Horizontal displacements since the start, and to the goal [m], shape [2].
        self._moved_m = (self._cube - self._start)[:2]
        self._to_goal_m = self.goal_m - self._moved_m

    def _after_interval(self) -> Ending | None:
        self._intervals += 1
        before, self._cube = self._cube, self._state(CUBE)
        self._read(before)
        risen_m = float(self._cube[2] - self._start[2])
        if self._is_lost(self._driven_from_cube_m, risen_m):
            return Ending.LOST
        has_arrived = (
            math.hypot(*self._to_goal_m) <= TOLERANCE_M
            and abs(self._yaw_rad) <= TOLERANCE_RAD
            and math.hypot(*self._cube_velocity) <= REST_M_PER_S
        )
        return Ending.REACHED if has_arrived else None

    @property
    def _yaw_rad(self) -> float:
        """Component along z of the cube's rotation vector since the start [rad]."""
        start, current = Pose.of_state(self._start), Pose.of_state(self._cube)
        return float((current.rotation * start.rotation.inv()).as_rotvec()[2])

    @property
    def _driven_from_cube_m(self) -> FloatArray:
        """Place of the driven body relative to the cube [m], shape [2]."""
        return self._stage.pose[:2] - self._cube[:2]

    def _observation(self) -> list[float]:
        return [
            *self._to_goal_m,
            *self._cube_velocity,
            self._yaw_rad,
            *self._driven_from_cube_m,
            *(self._stage.rate - self._cube_velocity),
            self._time_s,
        ]

    def _total_reward(self) -> float:
        if self._ending is Ending.REACHED:
            return ARRIVAL_SHARE * (self._reached() / self.limit.value)
        return -(1.0 - ARRIVAL_SHARE) * self._time_to_go()

    def _time_to_go(self) -> float:
        """Return the time to go over its initial value. Speed across the line to the goal adds its braking time."""
        limit_m_per_s2 = self.limit.value * self.gravity_m_per_s2
        velocity, to_goal_m = self._cube_velocity, self._to_goal_m
        left_m = math.hypot(*to_goal_m)
        speed = float(velocity @ to_goal_m) / left_m if left_m > 0.0 else 0.0
        across = math.sqrt(max(float(velocity @ velocity) - speed**2, 0.0))
        at_start_s = self.time_to_go_s(self.DISTANCE_M, 0.0, limit_m_per_s2)
        now_s = self.time_to_go_s(left_m, speed, limit_m_per_s2)
        return (now_s + across / limit_m_per_s2) / at_start_s


class CarryLimit(LeastTimeLimit):
    """Carry a cube that stands on a plate over half a metre, in the scene of Turntable-1.

    The plate moves horizontally and does not turn. The cube speeds up and brakes with mu g at most, so from rest to
    rest it needs T_law = 2 sqrt(D / (mu g)): 0.73 to 0.80 s here. With the final speed v, the least friction a / g
    solves 4 a D = (a T + v)^2 - 2 v^2. The goal lies in any direction. See `LeastTimeLimit`.
    """

    SCENE = "Turntable-1"
    DRIVEN = "plate"
    LIMIT = Limit(
        quantity="friction that the time needs",
        law="the cube's acceleration is at most mu g, so 4 D / T^2 <= mu g from rest to rest",
        sigma_source="relative uncertainty of the same cube's friction on the slope, from 19 or 20 real trials; no "
        "trial shows where cubes slip on the plate",
    )
    FAMILY = "Carry"
    """Time of an episode: four times the least time."""
    MUJOCO_TIMESTEPS_S: ClassVar = {"training": 1 / 180}
    ACCELERATION = 4.5
    """1.2 to 1.4 times the 3.2 to 3.7 m/s^2 that friction holds, so that the actuator does not limit the task."""
    DISTANCE_M = 0.5
    MAX_ANGLE_RAD = math.pi
    CAMERA: ClassVar = {"target_m": (0.48, 0.44, 0.12), "distance_m": 3.6}

    def _scene(self, scene: Scene) -> Scene:
        """Return the scene, in which actions translate the plate."""
        return replace(scene, drivers=(stage_driver(self.DRIVEN, X_AXIS, Y_AXIS),))

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
        left_m = abs(distance_m - braked_m)
        return braked_s + 2.0 * math.sqrt(left_m / deceleration_m_per_s2)

    def _reached(self) -> float:
        """Return a / g with the least acceleration a, which solves 4 a D = (a T + v)^2 - 2 v^2."""
        time_s, speed = self._time_s, length_of(self._cube_velocity)
        twice = 4.0 * length_of(self._moved_m) - 2.0 * time_s * speed
        root = math.hypot(twice, 2.0 * time_s * speed)
        return (twice + root) / (2.0 * time_s**2) / self.gravity_m_per_s2

    def _is_lost(self, driven_from_cube_m: FloatArray, risen_m: float) -> bool:
        plate = self.experiment.scene.body(self.DRIVEN).shape
        radius_m = plate.corners_m[:, 0].max()
        return length_of(driven_from_cube_m) > radius_m or risen_m < -FALLEN_M

    def _law_command(self, fraction: float) -> FloatArray:
        """Return the action that accelerates and brakes towards the goal with fraction mu g."""
        limit_m_per_s2 = fraction * self.limit.value * self.gravity_m_per_s2
        along = self.goal_m / self.DISTANCE_M
        across = np.array([-along[1], along[0]])
        left_m, speed = self._to_goal_m, self._stage.rate
        aside = acceleration_to_rest(
            float(left_m @ across), float(speed @ across), ASIDE_SHARE * limit_m_per_s2
        )
        ahead = acceleration_to_rest(
            float(left_m @ along),
            float(speed @ along),
            math.sqrt(limit_m_per_s2**2 - aside**2),
        )
        return (ahead * along + aside * across) / self.ACCELERATION


class PushLimit(LeastTimeLimit):
    """Push a cube over the level board to a goal 0.2 m away, in the scene of SlopeSlider-3.

    A pusher stands behind the cube, a bar that actions accelerate along x and y. It may push as hard as it likes, but
    friction alone brakes the cube. At the time t before the end, a motion with the final speed v has the speed
    v + mu g t at most. So the distance is at most D = v T + mu g T^2 / 2. From rest to rest, T_law = sqrt(2 D / (mu g))
    is 0.39 s here. A pusher of the acceleration A that touches the cube from the start needs sqrt(1 + mu g / A) times
    as long: 7 % here. So the optimum uses 0.88 of the limit or more. An impact can come nearer to the limit, but not
    pass it.

    The goal lies up to 8 degrees off the x axis, so the pusher must move obliquely, and the cube must not turn. The
    episode ends if the law would no longer hold. Then the pusher's front is 5 mm past the cube's rear face, so that it
    could brake the cube, or the cube's centre has left its height by 3 mm. See `LeastTimeLimit`.

    Two effects can pass the limit by a little, in an ideal engine too. The pusher's friction can brake the motion
    across x, if the cube ends up to 12 degrees off: 1 / cos 12 = 1.023. A lifted cube lacks friction until it falls,
    which lengthens the distance by 0.8 mm. So `ratio` is at most 1.03; without an impact it is 0.88.

    Friction and restitution between pusher and cube equal those of board and cube, because none were measured.
    """

    SCENE = "SlopeSlider-3"
    DRIVEN = PUSHER
    LIMIT = Limit(
        quantity="friction that the time needs",
        law="friction alone brakes the cube, so D <= mu g T^2 / 2 to rest",
        sigma_source="friction of the same cube on the same board in 19 or 20 real trials at 30 degrees: root mean "
        "square distance from the published coefficient",
    )
    FAMILY = "Push"
    """Time of an episode: five times the least time."""
    ACCELERATION = 20.0
    """Seven times the deceleration by friction."""
    DISTANCE_M = 0.2
    MAX_ANGLE_RAD = math.radians(8.0)
    CAMERA: ClassVar = {"target_m": (0.29, 0.39, 0.15), "distance_m": 1.5}

    def _scene(self, scene: Scene) -> Scene:
        """Return the scene with the board at rest and the pusher behind the cube."""
        x, y, z = scene.body(CUBE).pose.position_m
        bodies = tuple(
            replace(body, motion=Motion.FIXED) if body.name == "board" else body
            for body in scene.bodies
        )
        half_cube_m = float(scene.body(CUBE).shape.corners_m[:, 0].max())
        self._touching_m = half_cube_m + 0.5 * PUSHER_SIZE_M[0]
        place_m = (x - self._touching_m - GAP_M, y, z)
        driver = stage_driver(PUSHER, X_AXIS, Y_AXIS)
        return with_box(replace(scene, bodies=bodies), PUSHER_SIZE_M, place_m, driver)

    def _follow(self, states: FloatArray) -> None:
        """Keep the published distance of the pusher behind the cube."""
        scene = self.experiment.scene
        cube, pusher = row_of(scene, CUBE), row_of(scene, PUSHER)
        states[pusher, :3] += states[cube, :3] - scene.body(CUBE).pose.position_m

    @staticmethod
    def time_to_go_s(
        distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float
    ) -> float:
        """Return the time [s] of coasting to the goal, or past it and back, if that were possible."""
        braked_s = abs(speed_m_per_s) / deceleration_m_per_s2
        over_m = 0.5 * speed_m_per_s * braked_s - distance_m
        if over_m <= 0.0:
            return math.sqrt(2.0 * distance_m / deceleration_m_per_s2)
        return braked_s + math.sqrt(2.0 * over_m / deceleration_m_per_s2)

    def _reached(self) -> float:
        """Return a / g with the least deceleration a, which solves D = v T + a T^2 / 2, at least 0."""
        time_s, speed = self._time_s, length_of(self._cube_velocity)
        braked_m = length_of(self._moved_m) - speed * time_s
        return max(2.0 * braked_m / time_s**2, 0.0) / self.gravity_m_per_s2

    def _is_lost(self, driven_from_cube_m: FloatArray, risen_m: float) -> bool:
        past_m = float(driven_from_cube_m[0]) + self._touching_m
        return past_m > PAST_M or abs(risen_m) > LIFTED_M

    def _law_command(self, fraction: float) -> FloatArray:
        """Return the action that pushes until the cube coasts to the goal, if its friction is fraction mu."""
        braking_m_per_s2 = fraction * self.limit.value * self.gravity_m_per_s2
        left_m = length_of(self._to_goal_m)
        direction = self._to_goal_m / max(left_m, 1e-9)
        speed = float(self._cube_velocity @ direction)
        coasts_m = speed * abs(speed) / (2.0 * braking_m_per_s2)
        left_m -= PUSHED_ON_M
        pusher, wanted = self._stage.rate, np.zeros(2)
        if coasts_m < left_m:
            pushed = float(pusher @ direction)
            wanted = (
                max(speed_to_rest(left_m, pushed, braking_m_per_s2), 0.0) * direction
            )
        change = (wanted - pusher) / FRAME_S / self.ACCELERATION
        return change / max(1.0, float(np.abs(change).max()))
