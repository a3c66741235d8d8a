"""Bounce a ball on a plate as high as its restitution allows."""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from gauge_envs.references.uncertainties import RESTITUTION_SHARE
from gauge_envs.scene import Scene, Sphere
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.control.stage import (
    FRAME_S,
    X_AXIS,
    Z_AXIS,
    Stage,
    acceleration_to_rest,
    stage_driver,
    with_box,
)
from gauge_envs.tools.control.task import ControlTask, Ending, Limit

BALL, PLATE = "ball", "plate"

PLATE_SIZE_M = (0.2, 0.2, 0.02)
"""Edges of the plate [m]."""
PLATE_TOP_M = 0.15
"""Height of the plate's top above the ground at the start, the middle of its stroke [m]."""
ASIDE_M = 0.15
"""Distance of the plate's centre from the ball's vertical at the start [m]; without a motion the ball misses it."""
SPEED_M_PER_S = 1.0
"""Largest speed of the plate along each axis [m/s]."""
STROKE_M = 0.1
"""Largest vertical displacement of the plate, up and down [m]."""
EDGE_M = 0.01
"""Width of the strip at the plate's edges along x where an impact does not count [m].

An edge can face sideways, and then the plate's speed along x throws the ball too. Ball and plate move by less than this
relative to each other in 1/180 s. So the ball is above the top if it is within the strips before and after.
"""
START_STD_M = 0.001
"""Standard uncertainty of the ball's start [m]. The start height of 22 drops of BouncingBall scatters by 0.95 mm."""
IMPACTS = 3
"""Number of impacts, after which the highest place counts."""
MEETING_M = 0.8 * STROKE_M
"""Place of the plate at which the law's policy meets the ball [m]."""
LOWEST_M = -STROKE_M + 0.005
"""Place of the plate from which the law's policy starts its stroke [m]."""


def highest_m(drop_m: float, restitution: float, gravity_m_per_s2: float) -> float:
    """Return the largest height that a ball can reach with three impacts on the plate [m].

    A ball that falls from the height H to the place z of the plate has the speed v = sqrt(2 g (H - z)). It leaves with
    e v + (1 + e) V at most, V being the plate's largest speed. The next height is z + (e v + (1 + e) V)^2 / (2 g), at
    the best z of the stroke. It grows with H, so the best height after each impact gives the best final height.

    Args:
        drop_m: Height of the ball at rest at the start, above the middle of the stroke [m]. Heights are those of
            the ball's lowest point.
        restitution: Coefficient of restitution of ball and plate.
        gravity_m_per_s2: Gravity [m/s^2].
    """
    extra = (1.0 + restitution) * SPEED_M_PER_S
    for _ in range(IMPACTS):
        fastest, slowest = (
            math.sqrt(2.0 * gravity_m_per_s2 * max(drop_m - place_m, 0.0))
            for place_m in (-STROKE_M, STROKE_M)
        )
        # The speed at which the derivative of the height by v is 0, if the stroke allows it.
        best = math.inf
        if restitution < 1.0:
            best = restitution * extra / (1.0 - restitution**2)
        comes = min(max(best, slowest), fastest)
        leaves = restitution * comes + extra
        drop_m += (leaves**2 - comes**2) / (2.0 * gravity_m_per_s2)
    return drop_m


class ThrowLimit(ControlTask):
    """Bounce a falling ball as high as possible with three impacts on a plate, with the ball of BouncingBall.

    **Law.** An impact gives a ball at most the speed e v + (1 + e) V. Here v is the speed of the ball and V the speed
    of the plate, at most 1 m/s. `highest_m` derives the largest height after three impacts: 0.67 m from 0.26 m.

    **Task.** The plate starts 0.15 m beside the ball's vertical and must move under it. An episode ends at the highest
    place after the third time that the ball turns upwards. It also ends, as lost, when the ball falls past the plate or
    turns upwards less than 1 cm inside the plate's edge. There the law does not hold: the speed of an edge that is hit
    from the side also has a part along x.

    **Reward.** The gain of the largest height so far, over the law's largest gain. No policy earns more than 1.

    **Reached** is the largest height of the ball's lowest point above the middle of the plate's stroke, in m; 0 if
    the ball was lost.

    **Action.** Acceleration of the plate along x and z, in units of 30 m/s^2.

    Friction and restitution of ball and plate equal those of ball and ground in the experiment.

    Args:
        material: Material of the ball: `rubber`.

    The other arguments are those of `ControlTask`.
    """

    SCENE = "BouncingBall"
    LIMIT = Limit(
        quantity="height after three impacts",
        unit="m",
        law="an impact gives at most e v + (1 + e) V; z + (e v + (1 + e) V)^2 / (2 g) for the best place z, three "
        "times",
        sigma_source="restitution: root mean square distance of 22 real drops from the published coefficient; start "
        "height: their scatter",
    )
    FAMILY = "Throw"
    """Time of an episode; three impacts and the last rise take 1.8 s."""
    MUJOCO_TIMESTEPS_S: ClassVar = {"training": 1 / 180}
    ACCELERATION = 30.0
    """Full speed after one step."""
    CAMERA: ClassVar = {"target_m": (0.53, 0.44, 0.44), "distance_m": 2.22}
    COMMANDED = ("acceleration_x", "acceleration_z")
    OBSERVED = (
        "ball_from_plate_x_m",
        "ball_height_m",
        "ball_velocity_x_m_per_s",
        "ball_velocity_z_m_per_s",
        "plate_height_m",
        "plate_velocity_x_m_per_s",
        "plate_velocity_z_m_per_s",
        "impacts",
        "time_s",
    )
    _stage: Stage

    # --- scene and limit ---

    def _scene(self, scene: Scene) -> Scene:
        """Return the scene with a plate beside the ball's vertical."""
        x, y, _ = scene.body(BALL).pose.position_m
        top_m = scene.body("ground").pose.position_m[2] + PLATE_TOP_M
        place_m = (x + ASIDE_M, y, top_m - 0.5 * PLATE_SIZE_M[2])
        driver = stage_driver(PLATE, X_AXIS, Z_AXIS)
        return with_box(scene, PLATE_SIZE_M, place_m, driver)

    def _prepare(self, scene: Scene) -> tuple[float, float]:
        ball, plate = scene.body(BALL), scene.body(PLATE).pose
        assert isinstance(ball.shape, Sphere)
        self._stage = Stage(
            scene,
            self.ACCELERATION,
            self.world_count,
            max_rate=SPEED_M_PER_S,
            strokes=(math.inf, STROKE_M),
        )
        # The height of the ball's centre in the world when it lies on the plate at the start.
        self._zero_m = plate.position_m[2] + 0.5 * PLATE_SIZE_M[2] + ball.shape.radius_m
        self._restitution = scene.contacts[0].restitution
        # The uncertainty belongs to the published coefficient, also if an override replaces the coefficient.
        self._std = RESTITUTION_SHARE * self.published_scene.contacts[0].restitution
        self._highest_m, self._drop_m = np.zeros((2, self.world_count))
        self._from_plate_m = self._entry("ball_from_plate_x_m")
        self._height_m = self._entry("ball_height_m")
        self._velocity = self._entries("ball_velocity_x_m_per_s", 2)
        self._plate_m = self._entry("plate_height_m")
        self._plate_velocity = self._entries("plate_velocity_x_m_per_s", 2)
        self._impacts = self._entry("impacts")
        return self._limit_of(ball.pose.position_m[2] - self._zero_m)

    def _limit_of(self, drop_m: float) -> tuple[float, float]:
        """Return the largest height of a ball that falls from a height [m], and its standard uncertainty."""
        restitution, gravity = self._restitution, self.gravity_m_per_s2
        value = highest_m(drop_m, restitution, gravity)
        bouncier_m = highest_m(drop_m, restitution + self._std, gravity)
        started_higher_m = highest_m(drop_m + START_STD_M, restitution, gravity)
        return value, math.hypot(bouncier_m - value, started_higher_m - value)

    # --- episode ---

    def _begin(self, worlds: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        from_plate_m, heights_m, velocities = self._ball()
        self._from_plate_m[worlds] = from_plate_m[-1, worlds]
        self._velocity[worlds] = velocities[-1, worlds]
        for array in (self._height_m, self._highest_m, self._drop_m):
            array[worlds] = heights_m[-1, worlds]
        for world in worlds.tolist():
            limit = self._limit_of(float(self._drop_m[world]))
            self.limits[world], self.sigmas[world] = limit

    def _ball(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the ball's place from the plate's centre along x, height and velocity at the seven samples."""
        states = self._frame.values[:, :, 0]
        from_plate_m = states[..., 0] - self._stage.poses[..., 0]
        return from_plate_m, states[..., 2] - self._zero_m, states[..., 7:10:2]

    def _after_frame(self) -> None:
        from_plate_m, heights_m, velocities = self._ball()
        falls = velocities[..., 1] < 0.0
        rises = velocities[1:, :, 1] > 0.0
        has_turned = falls[:-1] & rises
        is_lost = heights_m[1:] < -STROKE_M - PLATE_SIZE_M[2]
        impacts = self._impacts + has_turned.cumsum(axis=0)
        if has_turned.any():
            # Whether the ball is above the plate's top, and not near its edges.
            is_inside = np.abs(from_plate_m) <= 0.5 * PLATE_SIZE_M[0] - EDGE_M
            is_lost |= has_turned & ~(is_inside[:-1] & is_inside[1:])
        is_top = (impacts >= IMPACTS) & falls[1:]
        last = self._end({Ending.LOST: is_lost, Ending.REACHED: is_top})
        counted_m = np.where(is_lost, -np.inf, heights_m[1:])
        counted_m[0] = np.maximum(counted_m[0], self._highest_m)
        self._highest_m = np.maximum.accumulate(counted_m)[last]
        self._from_plate_m[:] = from_plate_m[1:][last]
        self._height_m[:] = heights_m[1:][last]
        self._velocity[:] = velocities[1:][last]
        self._plate_m[:] = self._stage.offsets[1:, :, 1][last]
        self._plate_velocity[:] = self._stage.rates[1:][last]
        self._impacts[:] = impacts[last]

    def _total_reward(self) -> FloatArray:
        return self._highest_m / (self.limits - self._drop_m)

    def _reached(self, world: int) -> float:
        return float(self._highest_m[world])

    # --- policy of the law ---

    def _law_command(self, fraction: float, world: int) -> FloatArray:
        """Return the action that meets the ball near the top of the stroke with the speed fraction V."""
        gravity = self.gravity_m_per_s2
        braking_m_per_s2 = 0.5 * self.ACCELERATION
        speed = fraction * SPEED_M_PER_S
        velocity_x, velocity_z = self._velocity[world].tolist()
        above_m = float(self._height_m[world]) - MEETING_M
        square = velocity_z**2 + 2.0 * gravity * above_m
        meets_s = (velocity_z + math.sqrt(max(square, 0.0))) / gravity
        across_m = float(self._from_plate_m[world]) + velocity_x * meets_s
        rate_x, rate_z = self._plate_velocity[world].tolist()
        across = acceleration_to_rest(across_m, rate_x, braking_m_per_s2)
        height_m = float(self._plate_m[world])
        # A plate that is on this line in time, half a frame later, meets the ball at its place with its speed.
        if MEETING_M - speed * (meets_s - 0.5 * FRAME_S) >= height_m:
            up = (speed - rate_z) / FRAME_S
        else:
            up = acceleration_to_rest(LOWEST_M - height_m, rate_z, braking_m_per_s2)
        return np.array([across, up]) / self.ACCELERATION
