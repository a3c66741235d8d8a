"""Bring a cube to a goal in the least time that its friction allows: carry it on a plate, or push it over a board."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import (
    BoolArray,
    FloatArray,
    IntArray,
    length_of,
    quaternion_products,
    quaternion_vectors,
)
from gauge_envs.scene.states import row_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from gauge_envs.tools.control.friction import CUBE, CubeLimit
from gauge_envs.tools.control.stage import (
    FRAME_S,
    INTERVALS,
    X_AXIS,
    Y_AXIS,
    acceleration_to_rest,
    speed_to_rest,
    stage_driver,
    with_box,
)
from gauge_envs.tools.control.task import Ending, Limit

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

CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
"""Factors of a unit quaternion w, x, y, z that give the inverse rotation."""

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

    The other arguments are those of `ControlTask`.

    Attributes:
        DRIVEN: Name of the driven body.
        DISTANCE_M: Distance of the goal.
        MAX_ANGLE_RAD: Largest angle between the goal and the x axis.
        goals_m: Desired displacement of the cube in each world [m], shape [N, 2].
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
        distance_m: FloatArray, speed_m_per_s: FloatArray, deceleration: FloatArray
    ) -> FloatArray:
        """Return the remaining time [s].

        Args:
            distance_m: Distance from the goal [m], shape [N].
            speed_m_per_s: Speed towards it, negative if away [m/s], shape [N].
            deceleration: Largest deceleration [m/s^2], shape [N].
        """

    @abstractmethod
    def _is_lost(
        self, driven_from_cube_m: FloatArray, risen_m: FloatArray
    ) -> BoolArray:
        """Return whether the cube can no longer arrive, shape [6, N].

        Args:
            driven_from_cube_m: Place of the driven body relative to the cube [m], shape [6, N, 2].
            risen_m: Displacement of the cube upwards [m], shape [6, N].
        """

    # --- episode ---

    def _prepare(self, scene: Scene) -> tuple[float, float]:
        count = self.world_count
        self.goals_m = np.zeros((count, 2))
        self._to_goal_m = self._entries("to_goal_x_m", 2)
        self._velocity = self._entries("cube_velocity_x_m_per_s", 2)
        self._yaw_rad = self._entry("cube_yaw_rad")
        self._driven_m = self._entries("driven_from_cube_x_m", 2)
        self._driven_velocity = self._entries("driven_from_cube_velocity_x_m_per_s", 2)
        self._time_s = self._entry("time_s")
        self._intervals = np.repeat(INTERVALS[..., 0], count, axis=1)
        self._starts_m = np.zeros((count, 3))
        # Matrices of the product with the inverse of the rotation at the start.
        self._back = np.zeros((count, 4, 4))
        # Distances from the goal, and speeds towards it.
        self._at_start_and_now = np.zeros((2, 2, count))
        self._at_start_and_now[0] = self.DISTANCE_M
        return super()._prepare(scene)

    def _begin(self, worlds: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        for world in worlds.tolist():
            angle = randoms[world].uniform(-self.MAX_ANGLE_RAD, self.MAX_ANGLE_RAD)
            direction = np.array([math.cos(angle), math.sin(angle)])
            self.goals_m[world] = self.DISTANCE_M * direction
        states = self._frame.values[-1, worlds, 0]
        self._starts_m[worlds] = states[:, :3]
        for world, start in zip(worlds, states[:, 3:7] * CONJUGATE, strict=True):
            self._back[world] = quaternion_products(np.eye(4), np.tile(start, (4, 1)))
        self._to_goal_m[worlds] = self.goals_m[worlds]
        self._driven_m[worlds] = self._stage.poses[-1, worlds, :2] - states[:, :2]

    def _after_frame(self) -> None:
        cubes = self._frame.values[:, :, 0]
        velocities = (cubes[1:, :, :2] - cubes[:-1, :, :2]) / SAMPLE_INTERVAL_S
        moved_m = cubes[1:, :, :3] - self._starts_m
        to_goal_m = self.goals_m - moved_m[..., :2]
        driven_m = self._stage.poses[1:, :, :2] - cubes[1:, :, :2]
        yaws_rad = self._yaws_rad(cubes[1:, :, 3:7])
        is_lost = self._is_lost(driven_m, moved_m[..., 2])
        has_arrived = _lengths(to_goal_m) <= TOLERANCE_M
        if has_arrived.any():
            has_arrived &= np.abs(yaws_rad) <= TOLERANCE_RAD
            has_arrived &= _lengths(velocities) <= REST_M_PER_S
        last = self._end({Ending.LOST: is_lost, Ending.REACHED: has_arrived})
        self._to_goal_m[:] = to_goal_m[last]
        self._velocity[:] = velocities[last]
        self._yaw_rad[:] = yaws_rad[last]
        self._driven_m[:] = driven_m[last]
        self._driven_velocity[:] = self._stage.rates[1:][last] - self._velocity
        # The last frame of an episode may be incomplete.
        before = (self.rollout.frames - 1) * SAMPLES_PER_FRAME
        self._time_s[:] = SAMPLE_INTERVAL_S * (before + self._intervals[last])

    def _yaws_rad(self, quaternions: FloatArray) -> FloatArray:
        """Return the z component of the rotation vectors since the start [rad], shape [6, N]."""
        turns = np.einsum("snp,npq->snq", quaternions, self._back)
        return quaternion_vectors(turns.reshape(-1, 4))[:, 2].reshape(turns.shape[:2])

    def _moved_m(self, world: int) -> float:
        """Return the distance of the cube from its start [m]."""
        return length_of(self.goals_m[world] - self._to_goal_m[world])

    def _total_reward(self) -> FloatArray:
        total: FloatArray = -(1.0 - ARRIVAL_SHARE) * self._times_to_go()
        for world, ending in enumerate(self.endings):
            if ending is Ending.REACHED:
                total[world] = ARRIVAL_SHARE * self._reached(world) / self.limits[world]
        return total

    def _times_to_go(self) -> FloatArray:
        """Return the time to go over its initial value. Speed across the line to the goal adds its braking time."""
        limits_m_per_s2 = self.limits * self.gravity_m_per_s2
        velocity, to_goal_m = self._velocity, self._to_goal_m
        left_m = _lengths(to_goal_m)
        speed = (velocity * to_goal_m).sum(axis=-1) / np.maximum(left_m, 1e-300)
        square = (velocity * velocity).sum(axis=-1) - speed**2
        across = np.sqrt(np.maximum(square, 0.0))
        distances_m, speeds = self._at_start_and_now
        distances_m[1], speeds[1] = left_m, speed
        at_start_s, now_s = self.time_to_go_s(distances_m, speeds, limits_m_per_s2)
        return (now_s + across / limits_m_per_s2) / at_start_s


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the lengths of vectors of shape [..., 2]."""
    return np.asarray(np.hypot(vectors[..., 0], vectors[..., 1]))


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
        self._plate_radius_m = scene.body(self.DRIVEN).shape.corners_m[:, 0].max()
        return replace(scene, drivers=(stage_driver(self.DRIVEN, X_AXIS, Y_AXIS),))

    @staticmethod
    def time_to_go_s(
        distance_m: FloatArray, speed_m_per_s: FloatArray, deceleration: FloatArray
    ) -> FloatArray:
        """Return the least time [s] to rest at the goal: a cube that is too fast passes the goal and comes back."""
        braked_s = np.abs(speed_m_per_s) / deceleration
        braked_m = 0.5 * speed_m_per_s * braked_s
        can_brake = (braked_m > 0.0) & (braked_m <= distance_m)
        square = deceleration * distance_m + 0.5 * speed_m_per_s**2
        direct_s = (2.0 * np.sqrt(square) - speed_m_per_s) / deceleration
        left_m = np.abs(distance_m - braked_m)
        back_s = braked_s + 2.0 * np.sqrt(left_m / deceleration)
        return np.where(can_brake, direct_s, back_s)

    def _reached(self, world: int) -> float:
        """Return a / g with the least acceleration a, which solves 4 a D = (a T + v)^2 - 2 v^2."""
        time_s, speed = float(self._time_s[world]), length_of(self._velocity[world])
        twice = 4.0 * self._moved_m(world) - 2.0 * time_s * speed
        root = math.hypot(twice, 2.0 * time_s * speed)
        return (twice + root) / (2.0 * time_s**2) / self.gravity_m_per_s2

    def _is_lost(
        self, driven_from_cube_m: FloatArray, risen_m: FloatArray
    ) -> BoolArray:
        has_left = _lengths(driven_from_cube_m) > self._plate_radius_m
        return has_left | (risen_m < -FALLEN_M)

    def _law_command(self, fraction: float, world: int) -> FloatArray:
        """Return the action that accelerates and brakes towards the goal with fraction mu g."""
        limit_m_per_s2 = fraction * float(self.limits[world]) * self.gravity_m_per_s2
        along = self.goals_m[world] / self.DISTANCE_M
        across = np.array([-along[1], along[0]])
        left_m = self._to_goal_m[world]
        speed = self._stage.rates[-1, world]
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
        distance_m: FloatArray, speed_m_per_s: FloatArray, deceleration: FloatArray
    ) -> FloatArray:
        """Return the time [s] of coasting to the goal, or past it and back, if that were possible."""
        braked_s = np.abs(speed_m_per_s) / deceleration
        over_m = 0.5 * speed_m_per_s * braked_s - distance_m
        coasts_s = np.sqrt(2.0 * distance_m / deceleration)
        back_s = braked_s + np.sqrt(2.0 * np.maximum(over_m, 0.0) / deceleration)
        return np.where(over_m <= 0.0, coasts_s, back_s)

    def _reached(self, world: int) -> float:
        """Return a / g with the least deceleration a, which solves D = v T + a T^2 / 2, at least 0."""
        time_s, speed = float(self._time_s[world]), length_of(self._velocity[world])
        braked_m = self._moved_m(world) - speed * time_s
        return max(2.0 * braked_m / time_s**2, 0.0) / self.gravity_m_per_s2

    def _is_lost(
        self, driven_from_cube_m: FloatArray, risen_m: FloatArray
    ) -> BoolArray:
        past_m = driven_from_cube_m[..., 0] + self._touching_m
        return (past_m > PAST_M) | (np.abs(risen_m) > LIFTED_M)

    def _law_command(self, fraction: float, world: int) -> FloatArray:
        """Return the action that pushes until the cube coasts to the goal, if its friction is fraction mu."""
        braking_m_per_s2 = fraction * float(self.limits[world]) * self.gravity_m_per_s2
        to_goal_m = self._to_goal_m[world]
        left_m = length_of(to_goal_m)
        direction = to_goal_m / max(left_m, 1e-9)
        speed = float(self._velocity[world] @ direction)
        coasts_m = speed * abs(speed) / (2.0 * braking_m_per_s2)
        left_m -= PUSHED_ON_M
        pusher, wanted = self._stage.rates[-1, world], np.zeros(2)
        if coasts_m < left_m:
            pushed = float(pusher @ direction)
            wanted = (
                max(speed_to_rest(left_m, pushed, braking_m_per_s2), 0.0) * direction
            )
        change = (wanted - pusher) / FRAME_S / self.ACCELERATION
        return change / max(1.0, float(np.abs(change).max()))
