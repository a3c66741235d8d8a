"""A driven body that actions accelerate, and the acceleration that brings it to rest at a place."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.scene import Box, Motion, Pose, RigidBody, Scene
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray, Vector
from gauge_envs.scene.prescribed_motion import SimpleTargets
from gauge_envs.scene.timing import (
    FRAME_RATE_HZ,
    SAMPLE_INTERVAL_S,
    SAMPLES_PER_FRAME,
)

X_AXIS, Y_AXIS, Z_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

FRAME_S = 1.0 / FRAME_RATE_HZ
"""Time of a step, in which the acceleration is constant [s]."""

INTERVALS = np.arange(1, SAMPLES_PER_FRAME + 1)[:, None, None]
"""Numbers of the samples of a frame after its start, shape [6, 1, 1]."""


def stage_driver(body: str, *axes: Vector) -> Driver:
    """Return a driver that translates a body by actions alone.

    Args:
        body: Name of the kinematic body.
        *axes: Unit vectors in the world, one for each entry of the action.
    """
    motions = tuple(
        DriverMotion(kind="translate", axis=axis, profiles=()) for axis in axes
    )
    return Driver(body=body, motions=motions, provenance="action")


def with_box(scene: Scene, size_m: Vector, position_m: Vector, driver: Driver) -> Scene:
    """Return a scene with an additional box, which actions move; its contact equals the first contact of the scene.

    Args:
        scene: The scene.
        size_m: Edges of the box [m].
        position_m: Its centre at the start [m].
        driver: Its driver, which names it.
    """
    box = RigidBody(
        name=driver.body,
        shape=Box(size_m=size_m),
        motion=Motion.KINEMATIC,
        pose=Pose(position_m=position_m),
        mass_kg=1.0,
    )
    return replace(
        scene,
        bodies=(*scene.bodies, box),
        contacts=(*scene.contacts, replace(scene.contacts[0], second=(box.name,))),
        drivers=(driver,),
    )


class Stage:
    """A body that actions accelerate along the coordinates of its driver, up to a rate, within a stroke, in N worlds.

    A coordinate is a displacement [m] or an angle [rad].

    Args:
        scene: Scene with the body at its start; its one driver has no motion of its own.
        acceleration: Acceleration of a coordinate that an action of 1 commands [m/s^2 or rad/s^2].
        world_count: Number of worlds N.
        max_rate: Largest rate of a coordinate [m/s or rad/s].
        strokes: Largest absolute value of each coordinate, where the body stops at once.
        speed_change: Sum of all changes of the rates in an episode [m/s or rad/s]; the body then keeps its rate.

    Attributes:
        body: Name of the body.
        motion_count: Number of its coordinates M.
        acceleration: Acceleration of each coordinate in the frame, shape [N, M].
        coordinates: Coordinates at the seven samples of the frame, then their rates, shape [7, N, 2 M].
        offsets: View of the coordinates, shape [7, N, M].
        rates: View of the rates, of the same shape.
        speed_changes_left: Rest of `speed_change` at the samples, shape [7, N].
        poses: Poses of the body at the samples, position [m] and unit quaternion w x y z, shape [7, N, 7].
    """

    def __init__(
        self,
        scene: Scene,
        acceleration: float,
        world_count: int,
        *,
        max_rate: float = math.inf,
        strokes: tuple[float, ...] = (math.inf,),
        speed_change: float = math.inf,
    ) -> None:
        (driver,) = scene.drivers
        pose = scene.body(driver.body).pose
        self.body = driver.body
        self.motion_count = len(driver.motions)
        self._start = np.array([*pose.position_m, *pose.quaternion])
        self._scale, self._max_rate = acceleration, max_rate
        self._strokes = np.array(strokes * (self.motion_count // len(strokes)))
        self._has_stroke = min(strokes) < math.inf
        self._speed_change = speed_change
        shape = SAMPLES_PER_FRAME + 1, world_count
        self.coordinates = np.zeros((*shape, 2 * self.motion_count))
        self.offsets = self.coordinates[..., : self.motion_count]
        self.rates = self.coordinates[..., self.motion_count :]
        self.speed_changes_left = np.full(shape, speed_change)
        self.poses = np.zeros((*shape, 7))
        self._shifts_m = np.zeros((world_count, 3))
        self._simple = SimpleTargets(driver, self._start)
        self.reset(worlds=np.ones(world_count, dtype=np.bool_))

    def reset(
        self,
        drivers: Sequence[Driver] | None = None,
        start_poses: FloatArray | None = None,
        worlds: BoolArray | None = None,
    ) -> None:
        """Return to the start in some worlds, at other positions; see `gauge_envs.envs.rollout.Motion`."""
        chosen = slice(None) if worlds is None else worlds
        poses = self._start if start_poses is None else start_poses[chosen]
        self.offsets[:, chosen] = self.rates[:, chosen] = 0.0
        self.speed_changes_left[:, chosen] = self._speed_change
        self.poses[:, chosen] = poses
        self._shifts_m[chosen] = (poses - self._start)[..., :3]
        self._is_shifted = bool(self._shifts_m.any())

    def targets(
        self, first: int | IntArray, actions: FloatArray, count: int = SAMPLES_PER_FRAME
    ) -> FloatArray:
        """Return the targets of `Simulation.drive` in the six intervals of a frame of uniform acceleration.

        Args:
            first: Number of the first interval; unused.
            actions: Action for each coordinate, from -1 to 1, shape [N, M].
            count: Number of intervals; always six.

        Returns:
            Shape [6, N, 19].
        """
        self.acceleration = actions * self._scale
        self._move(INTERVALS * (self.acceleration * SAMPLE_INTERVAL_S))
        targets, self.poses = self._simple.targets(self.coordinates)
        if self._is_shifted:
            targets[..., :3] += self._shifts_m
            self.poses[..., :3] += self._shifts_m
        return targets

    def _move(self, gains: FloatArray) -> None:
        """Advance coordinates and rates by a frame with gains of the rates since its start, shape [6, N, M]."""
        offsets, rates = self.offsets, self.rates
        is_limited = self._speed_change < math.inf
        if is_limited:
            left = self.speed_changes_left[-1, :, None]
            gains = np.clip(gains, -left, left)
        rates[0], offsets[0] = rates[-1], offsets[-1]
        np.add(rates[0], gains, out=rates[1:])
        if self._max_rate < math.inf:
            # `np.clip` takes three times as long.
            rates[:] = np.minimum(np.maximum(rates, -self._max_rate), self._max_rate)
        np.add(rates[1:], rates[:-1], out=offsets[1:])
        offsets[1:] *= 0.5 * SAMPLE_INTERVAL_S
        np.add.accumulate(offsets, out=offsets)
        if is_limited:
            used = np.abs(rates - rates[0]).sum(axis=-1)
            self.speed_changes_left = np.maximum(self.speed_changes_left[-1] - used, 0)
        if self._has_stroke and (np.abs(offsets) > self._strokes).any():
            self._stop(np.diff(gains, axis=0, prepend=0.0))

    def _stop(self, gains: FloatArray) -> None:
        """Stop coordinates at the ends of their strokes, interval by interval, whose gains of rates are given."""
        offsets, rates = self.offsets, self.rates
        for index, gain in enumerate(gains):
            rate = np.minimum(rates[index] + gain, self._max_rate)
            rate = np.maximum(rate, -self._max_rate)
            wanted = offsets[index] + 0.5 * SAMPLE_INTERVAL_S * (rates[index] + rate)
            reached = np.minimum(np.maximum(wanted, -self._strokes), self._strokes)
            offsets[index + 1] = reached
            rates[index + 1] = np.where(reached == wanted, rate, 0.0)


def acceleration_to_rest(
    distance_m: float, speed_m_per_s: float, acceleration_m_per_s2: float
) -> float:
    """Return the acceleration of the next frame on the fastest way to rest at a distance.

    The body speeds up and brakes with the largest acceleration. In the frame between, the acceleration is chosen so
    that the braking distance ends at the place.

    Args:
        distance_m: Signed distance to the place [m].
        speed_m_per_s: Velocity towards positive distances [m/s].
        acceleration_m_per_s2: Largest acceleration, also of the braking [m/s^2].
    """
    if distance_m < 0.0:
        return -acceleration_to_rest(-distance_m, -speed_m_per_s, acceleration_m_per_s2)
    speed = speed_to_rest(distance_m, speed_m_per_s, acceleration_m_per_s2)
    change = (speed - speed_m_per_s) / FRAME_S
    return min(max(change, -acceleration_m_per_s2), acceleration_m_per_s2)


def speed_to_rest(
    distance_m: float, speed_m_per_s: float, deceleration_m_per_s2: float
) -> float:
    """Return the speed after the next frame [m/s] whose braking ends at a distance, or -inf if none does."""
    # The speed w after the frame of length t: distance = (v + w) t / 2 + w^2 / (2 a).
    half = 0.5 * deceleration_m_per_s2 * FRAME_S
    left_m = distance_m - 0.5 * speed_m_per_s * FRAME_S
    square = half**2 + 2.0 * deceleration_m_per_s2 * left_m
    return math.sqrt(square) - half if square > 0.0 else -math.inf
