"""Motion of a driven body in N worlds, cut into intervals of uniform acceleration."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache, partial

import numpy as np

from gauge_envs.scene.drivers import Driver, recorded_coordinates
from gauge_envs.scene.geometry import (
    BoolArray,
    FloatArray,
    IntArray,
    quaternion_products,
    quaternion_vectors,
    unit_quaternions,
)
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.states import nominal_states, row_of
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S


class PrescribedMotion:
    """The motion of one driven body: the recorded motion plus a displacement by actions.

    Args:
        driver: The driver.
        start: Pose of the body before anything moves, position [m] and quaternion w x y z, shape [7].
        count: Number of intervals.
        world_count: Number of worlds N.
        interval_s: Length of an interval [s].

    Attributes:
        body: Name of the body.
        motion_count: Degrees of freedom M of the driver.
    """

    def __init__(
        self,
        driver: Driver,
        start: FloatArray,
        count: int,
        *,
        world_count: int = 1,
        interval_s: float = SAMPLE_INTERVAL_S,
    ) -> None:
        self.body = driver.body
        self.motion_count = len(driver.motions)
        self._interval_s = interval_s
        self._count = count
        times_s = interval_s * np.arange(count + 1, dtype=np.float64)
        self._times_s = times_s[:, None, None]
        self._scale = np.array([motion.residual_rate for motion in driver.motions])
        self._nominal = [driver] * world_count, np.tile(start, (world_count, 1))
        self._offsets = np.zeros((world_count, self.motion_count))
        self.reset()

    def reset(
        self,
        drivers: Sequence[Driver] | None = None,
        start_poses: FloatArray | None = None,
        worlds: BoolArray | None = None,
    ) -> None:
        """Return to the recorded motion.

        Args:
            drivers: Driver of each world, with the same degrees of freedom and action scales; None is the nominal
                driver.
            start_poses: Pose of the body in each world before anything moves, shape [N, 7]; None is the nominal pose.
            worlds: Which worlds return; the others must keep their driver and pose. None is all.
        """
        nominal_drivers, nominal_poses = self._nominal
        if drivers is None:
            drivers = nominal_drivers
        if start_poses is None:
            start_poses = nominal_poses
        self._drivers = list(drivers)
        self._start = np.array(start_poses, dtype=np.float64)
        self._start[:, 3:] = unit_quaternions(self._start[:, 3:])
        self._offsets[slice(None) if worlds is None else worlds] = 0.0
        # If all worlds have the same motion, they share it, and the axis of worlds has length 1.
        is_shared = all(driver is self._drivers[0] for driver in self._drivers)
        is_shared = is_shared and (self._start == self._start[0]).all()
        self._columns = np.arange(1 if is_shared else len(self._drivers))
        self._simple: SimpleTargets | None = None
        if is_shared and SimpleTargets.fit(self._drivers[0]):
            self._simple = SimpleTargets(
                self._drivers[0], self._start[0], self._interval_s
            )
        recorded = [
            _recorded(
                self._drivers[world],
                self._start[world].tobytes(),
                self._count,
                self._interval_s,
            )
            for world in self._columns
        ]
        self._targets, self._coordinates = (
            np.stack(arrays, axis=1) for arrays in zip(*recorded, strict=True)
        )

    def targets(
        self, first: int | IntArray, actions: FloatArray, count: int = 1
    ) -> FloatArray:
        """Return the targets of the next intervals for `Simulation.drive`, and add the displacement by the actions.

        After its last interval a motion repeats it, because worlds that have ended still move with the others.

        Args:
            first: Number of the first interval, from 0; or the number in each world, shape [N].
            actions: Action for each degree of freedom, from -1 to 1, shape [N, M], for all of these intervals.
            count: Number of intervals.

        Returns:
            Shape [count, N, 19].
        """
        rates = actions * self._scale
        samples = np.arange(count + 1)[:, None] + first
        if not (self._offsets.any() or rates.any()):
            numbers = np.minimum(samples[:-1], self._count - 1)
            recorded = self._targets[numbers, self._columns]
            return np.broadcast_to(recorded, (count, len(rates), 19))
        added = np.empty((count + 1, len(rates), 2 * self.motion_count))
        offsets, added[..., self.motion_count :] = (
            added[..., : self.motion_count],
            rates,
        )
        np.add(self._offsets, self._times_s[: count + 1] * rates, out=offsets)
        self._offsets = offsets[-1]
        numbers = np.minimum(samples, self._count)
        coordinates = self._coordinates[numbers, self._columns] + added
        if self._simple is not None:
            return self._simple.targets(coordinates)[0]
        values, part_rates = np.split(coordinates, 2, axis=-1)
        states = _states(self._drivers, self._start, values, part_rates)
        return uniformly_accelerated(states, self._interval_s)


WHOLE_AND_HALF = np.array([1.0, 0.5])
"""Factors of an angle for its position and for its quaternion."""


class SimpleTargets:
    """Targets of a body that translates, or rotates about one axis: few functions of its coordinates times a matrix.

    At an angle t of a rotation, the position is centre + a cos t + b sin t. The arm a leads from the axis to the body,
    and b = axis x a. The quaternion is q cos(t / 2) + p sin(t / 2) with p = (0, axis) q.

    Args:
        driver: A driver that `fit` accepts.
        start: Pose of the body before anything moves, position [m] and unit quaternion w x y z, shape [7].
        interval_s: Length of an interval [s].
    """

    def __init__(
        self, driver: Driver, start: FloatArray, interval_s: float = SAMPLE_INTERVAL_S
    ) -> None:
        count, motion = len(driver.motions), driver.motions[0]
        self._turns = motion.kind == "rotate"
        poses = np.zeros((8 if self._turns else 2 * count, 7))
        means, accelerations = np.zeros((2, len(poses), 6))
        axes = np.array([each.axis for each in driver.motions])
        self._start = start.copy()
        if self._turns:
            across = (start[:3] - motion.point_m) @ motion.cross_product
            arm = -across @ motion.cross_product
            self._start[:3] -= arm
            self._start[3:] = 0.0
            poses[0, :3], poses[2, :3] = arm, across
            poses[1, 3:], poses[3, 3:] = (
                start[3:],
                start[3:] @ motion.quaternion_product,
            )
            accelerations[4, :3], accelerations[5, :3] = -arm, across
            means[6, 3:] = accelerations[7, 3:] = axes
        else:
            poses[:count, :3] = accelerations[count:, :3] = axes
        means[:, :3] += poses[:, :3]
        # The mean velocity of the interval minus half of its gain is the velocity at its start.
        means /= interval_s
        accelerations /= interval_s
        means -= 0.5 * interval_s * accelerations
        self._poses, self._gains = poses, np.hstack([means, accelerations])

    @staticmethod
    def fit(driver: Driver) -> bool:
        """Return whether a driver has translations alone or one rotation."""
        kinds = [motion.kind for motion in driver.motions]
        return kinds == ["rotate"] or "rotate" not in kinds

    def targets(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the targets of intervals, shape [S - 1, N, 19], and the poses at their ends, shape [S, N, 7].

        Args:
            coordinates: Coordinates at the ends of the intervals [m or rad], then their rates, shape [S, N, 2 M].
        """
        functions = self._functions(coordinates) if self._turns else coordinates
        # Bits of a product by BLAS would depend on the number of worlds.
        product = partial(np.einsum, "snf,fk->snk")
        poses = product(functions, self._poses)
        poses += self._start
        targets = np.empty((len(poses) - 1, poses.shape[1], 19))
        targets[..., :7] = poses[:-1]
        gains = functions[1:] - functions[:-1]
        product(gains, self._gains, out=targets[..., 7:])
        return targets, poses

    def _functions(self, coordinates: FloatArray) -> FloatArray:
        """Return the functions of an angle and its rate, shape [S, N, 8].

        They are the cosines and sines of the angle and its half, the rate times sine and cosine, angle and rate.
        """
        functions = np.empty((*coordinates.shape[:-1], 8))
        angles = coordinates[..., :1] * WHOLE_AND_HALF
        np.cos(angles, out=functions[..., :2])
        np.sin(angles, out=functions[..., 2:4])
        sine_and_cosine = functions[..., 2::-2]
        np.multiply(sine_and_cosine, coordinates[..., 1:], out=functions[..., 4:6])
        functions[..., 6:] = coordinates
        return functions


def prescribed_motions(
    scene: Scene,
    seconds: float,
    *,
    world_count: int = 1,
    interval_s: float = SAMPLE_INTERVAL_S,
) -> list[PrescribedMotion]:
    """Return the motions of a scene's driven bodies from its nominal start.

    Args:
        scene: The scene.
        seconds: Duration of the motion [s].
        world_count: Number of worlds.
        interval_s: Length of an interval [s].
    """
    states = nominal_states(scene)
    count = math.ceil(seconds / interval_s - 1e-6)
    return [
        PrescribedMotion(
            driver,
            states[row_of(scene, driver.body), :7],
            count,
            world_count=world_count,
            interval_s=interval_s,
        )
        for driver in scene.drivers
    ]


@lru_cache(maxsize=64)
def _recorded(
    driver: Driver, start: bytes, count: int, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the motion without actions in one world.

    Returns:
        Targets of the intervals, shape [count, 19]; coordinates [m or rad] at the ends of the intervals, then their
        rates, shape [count + 1, 2 M].
    """
    times_s = interval_s * np.arange(count + 1, dtype=np.float64)
    values, rates = recorded_coordinates(driver.motions, times_s)
    start_poses = np.frombuffer(start).reshape(1, 7)
    states = _states([driver], start_poses, values[:, None], rates[:, None])
    targets = uniformly_accelerated(states, interval_s)[:, 0]
    return targets, np.hstack([values, rates])


def _states(
    drivers: Iterable[Driver],
    start_poses: FloatArray,
    values: FloatArray,
    rates: FloatArray,
) -> FloatArray:
    """Return states of the body, shape [sample_count, N, 13], from coordinates of shape [sample_count, N, M]."""
    sample_count, world_count, _ = values.shape
    drivers = list(drivers)
    if all(driver is drivers[0] for driver in drivers):
        # Compute all worlds in one call.
        rows = np.tile(start_poses, (sample_count, 1))
        flat = sample_count * world_count
        states = drivers[0].moved(
            rows, values.reshape(flat, -1), rates.reshape(flat, -1)
        )
        return states.reshape(sample_count, world_count, 13)
    each = [
        driver.moved(pose[None], values[:, world], rates[:, world])
        for world, (driver, pose) in enumerate(zip(drivers, start_poses, strict=True))
    ]
    return np.stack(each, axis=1)


def uniformly_accelerated(states: FloatArray, interval_s: float) -> FloatArray:
    """Return uniformly accelerated motions that start at each state and end at the pose of the next one.

    Args:
        states: States at the ends of the intervals, shape [count + 1, N, 13].
        interval_s: Length of an interval [s].

    Returns:
        Pose, velocity and acceleration of each interval, shape [count, N, 19].
    """
    before, after = states[:-1], states[1:]
    gains = after[..., 7:] - before[..., 7:]
    rows = np.empty((*before.shape[:2], 19))
    rows[..., :7] = before[..., :7]
    rows[..., 7:10] = (after[..., :3] - before[..., :3]) / interval_s
    rows[..., 10:13] = _turns(before[..., 3:7], after[..., 3:7]) / interval_s
    # The mean velocity of the interval minus half of its gain is the velocity at its start.
    rows[..., 7:13] -= 0.5 * gains
    rows[..., 13:] = gains / interval_s
    return rows


def _turns(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the rotation vectors [rad] between unit quaternions, shape [count, N, 3], of at most half a turn."""
    back = before.reshape(-1, 4) * [1.0, -1.0, -1.0, -1.0]
    turns = quaternion_products(after.reshape(-1, 4), back)
    return quaternion_vectors(turns).reshape(*before.shape[:-1], 3)
