"""Prescribed motion of a driven body in intervals of uniform acceleration."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from gauge_envs.scene.drivers import (
    Driver,
    DriverMotion,
    recorded_coordinates,
    start_rows,
)
from gauge_envs.scene.geometry import (
    FloatArray,
    IntArray,
    Pose,
    quaternion_products,
    quaternion_vectors,
    unit_quaternions,
)
from gauge_envs.scene.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

Interval = tuple[Pose, FloatArray, FloatArray]


class Intervals:
    """Uniformly accelerated motions between states, with velocities closest to the given ones.

    The pose of an interval is made at its first use: those of minutes of motion take longer than the reset of a cloth.

    Args:
        states: Position, quaternion and velocity at the ends of the intervals, shape [interval_count + 1, 13]; each
            motion ends at the next pose.
        interval_s: Length of an interval [s].

    Attributes:
        rows: Position, quaternion, velocity and acceleration of each interval, shape [interval_count, 19].
    """

    def __init__(self, states: FloatArray, interval_s: float) -> None:
        motions = _between(states[:-1], states[1:], interval_s)
        self.rows = np.concatenate([states[:-1, :7], *motions], axis=1)
        self.rows.flags.writeable = False
        self._made: dict[int, Interval] = {}

    def __getitem__(self, index: int) -> Interval:
        made = self._made.get(index)
        if made is None:
            row = self.rows[index]
            x, y, z, a, b, c, d = row[:7].tolist()
            pose = Pose(position_m=(x, y, z), quaternion=(a, b, c, d))
            made = self._made[index] = pose, row[7:13], row[13:]
        return made


class DriverPath:
    """A driver's motion in intervals of uniform acceleration.

    The motion without actions is computed once and shared; its arrays are read-only.

    Args:
        driver: The driver.
        scene: Its scene.
        frame_count: Number of driven frames, including the first.
        interval_s: Length of an interval [s].

    Attributes:
        offsets: Displacement of each motion by actions so far [m or rad], shape [motion_count].
    """

    def __init__(
        self,
        driver: Driver,
        scene: Scene,
        frame_count: int,
        *,
        interval_s: float = SAMPLE_INTERVAL_S,
    ) -> None:
        self.body = driver.body
        self.interval_s = interval_s
        self.motion_count = len(driver.motions)
        self._driver = driver
        start = scene.body(driver.body).pose
        self._starts = start_rows([start])
        self._scale = np.array([motion.residual_rate for motion in driver.motions])
        self.offsets = np.zeros(self.motion_count)
        count = round((frame_count - 1) / FRAME_RATE_HZ / interval_s)
        self._path = _recorded_path(driver, start, count, interval_s)
        self._recorded = _recorded_coordinates(_still(driver), count, interval_s)

    def reset(self) -> None:
        """Return to the recorded motion."""
        self.offsets = np.zeros(self.motion_count)

    def interval(self, sample: int, action: FloatArray) -> Interval:
        """Return pose, velocity and acceleration of one interval; see `intervals`."""
        return self.intervals(sample, action, 1)[0]

    def intervals(
        self, sample: int, action: FloatArray, count: int
    ) -> Sequence[Interval]:
        """Return what `World.drive` takes in intervals with one action, and add the displacement by the action.

        Args:
            sample: Index of the first interval.
            action: Normalized rate of each motion, shape [motion_count].
            count: Number of intervals; six at once take as long as one.

        Returns:
            Pose, velocity and acceleration of each interval.
        """
        if not (self.offsets.any() or action.any()):
            return [self._path[index] for index in range(sample, sample + count)]
        rates = action * self._scale
        offsets = np.add.accumulate([self.offsets] + count * [rates * self.interval_s])
        self.offsets = offsets[-1]
        rows = slice(sample, sample + count + 1)
        coordinates, recorded_rates = self._recorded
        states = self._driver.moved(
            self._starts,
            self.interval_s * np.arange(rows.start, rows.stop, dtype=np.float64),
            coordinates[rows] + offsets,
            recorded_rates[rows] + rates,
        )
        ahead = Intervals(states, self.interval_s)
        return [ahead[index] for index in range(count)]


class DriverPathOfWorlds:
    """A driver's motion in many worlds, whose actions differ, in the rows of `Worlds.drive`.

    Args:
        driver: The driver.
        scenes: The scene of each world.
        frame_count: Number of driven frames, including the first.
    """

    def __init__(
        self, driver: Driver, scenes: Sequence[Scene], frame_count: int
    ) -> None:
        self.body = driver.body
        self.motion_count = len(driver.motions)
        self._driver = driver
        self._scale = np.array([motion.residual_rate for motion in driver.motions])
        poses = [scene.body(driver.body).pose for scene in scenes]
        kinds = list(dict.fromkeys(poses))
        numbers = {pose: number for number, pose in enumerate(kinds)}
        self._kinds = np.array([numbers[pose] for pose in poses])
        self._starts = start_rows(poses)
        count = round((frame_count - 1) / FRAME_RATE_HZ / SAMPLE_INTERVAL_S)
        self._paths = np.array(
            [
                _recorded_path(driver, pose, count, SAMPLE_INTERVAL_S).rows
                for pose in kinds
            ]
        )
        self._recorded = _recorded_coordinates(driver.motions, count, SAMPLE_INTERVAL_S)
        self.offsets = np.zeros((len(poses), self.motion_count))
        self._ended: tuple[int, FloatArray, FloatArray] | None = None

    def reset(self) -> None:
        """Return to the recorded motion in all worlds."""
        self.offsets[:] = 0.0
        self._ended = None

    def interval(self, sample: int, actions: FloatArray) -> FloatArray:
        """Return the motions of an interval for `Worlds.drive`, and add the displacements of the actions.

        Args:
            sample: Index of the interval.
            actions: Normalized rate of each motion, shape [world_count, motion_count].

        Returns:
            Shape [world_count, 19]; worlds that share their motion may share its memory.
        """
        at = self._paths[:, sample]
        rows = (
            np.broadcast_to(at[0], (len(self._kinds), 19))
            if len(at) == 1
            else at[self._kinds]
        )
        moved = np.flatnonzero(
            (self.offsets != 0.0).any(axis=1) | (actions != 0.0).any(axis=1)
        )
        if not len(moved):
            return rows
        rates = actions[moved] * self._scale
        before = self._end_of_last(sample, actions)
        if before is None:
            before = self._state(sample, moved, rates)
        self.offsets[moved] += rates * SAMPLE_INTERVAL_S
        after = self._state(sample + 1, moved, rates)
        self._ended = (sample + 1, actions.copy(), after)
        rows = rows.copy()
        rows[moved] = np.concatenate(
            [before[:, :7], *_between(before, after, SAMPLE_INTERVAL_S)], axis=1
        )
        return rows

    def _state(self, sample: int, moved: IntArray, rates: FloatArray) -> FloatArray:
        """Return the states at a sample of the worlds that actions moved, shape [moved_count, 13]."""
        coordinates, recorded_rates = self._recorded
        return self._driver.moved(
            self._starts[moved],
            np.array([sample * SAMPLE_INTERVAL_S]),
            coordinates[sample] + self.offsets[moved],
            recorded_rates[sample] + rates,
        )

    def _end_of_last(self, sample: int, actions: FloatArray) -> FloatArray | None:
        """Return the states at the end of the last interval if this one goes on from it with the same actions."""
        if self._ended is None:
            return None
        next_sample, last_actions, states = self._ended
        goes_on = next_sample == sample and np.array_equal(last_actions, actions)
        return states if goes_on else None


class DriverPathInArrays:
    """A driver's motion in many worlds, in arrays of any library, where nothing is read by the host.

    Its numbers are those of `DriverPathOfWorlds` but for rounding. The body starts in all worlds at the same place.

    Args:
        driver: The driver; it is not misplaced.
        start: Pose of the body before anything moves.
        frame_count: Number of driven frames, including the first.
        world_count: Number of worlds.
        arrays: Module of the library's functions; see `DeviceWorlds.arrays`.
        put: Function that makes an array of the library from a NumPy array.
    """

    def __init__(
        self,
        driver: Driver,
        start: Pose,
        frame_count: int,
        world_count: int,
        *,
        arrays: Any,
        put: Callable[[FloatArray], Any],
    ) -> None:
        self.body = driver.body
        self.motion_count = len(driver.motions)
        self._arrays = arrays
        intervals = round((frame_count - 1) / FRAME_RATE_HZ / SAMPLE_INTERVAL_S)
        times_s = [SAMPLE_INTERVAL_S * number for number in range(intervals + 1)]
        self._motions = [
            (
                motion.kind == "rotate",
                [motion.value(time_s) for time_s in times_s],
                [motion.rate(time_s) for time_s in times_s],
                put(np.array(motion.axis)),
                put(np.array(motion.point_m)),
                # The rows of r @ matrix are the cross products of the axis and rows r.
                put(np.cross(motion.axis, np.eye(3))),
            )
            for motion in driver.motions
        ]
        self._scale = put(np.array([one.residual_rate for one in driver.motions]))
        self._position = put(np.tile(start.position_m, (world_count, 1)))
        self._quaternion = put(np.tile(start.quaternion, (world_count, 1)))
        self._still = put(np.zeros((world_count, 3)))
        self._no_offsets = put(np.zeros((world_count, self.motion_count)))
        self.reset()

    def reset(self) -> None:
        """Return to the recorded motion in all worlds."""
        self._offsets = self._rates = self._no_offsets

    def begin_frame(self, sample: int, actions: Any) -> None:
        """Set the normalized rate of each motion from a sample on, shape [world_count, motion_count]."""
        self._rates = actions * self._scale
        self._before = self._state(sample)

    def interval(self, sample: int) -> Any:
        """Return the motions of the interval after a sample for `DeviceWorlds.drive`, shape [world_count, 19]."""
        self._offsets = self._offsets + SAMPLE_INTERVAL_S * self._rates
        before, after = self._before, self._state(sample + 1)
        self._before = after
        position, quaternion, velocity = before
        turn = self._rotation_vector(quaternion, after[1])
        mean = self._arrays.concat([after[0] - position, turn], axis=1)
        mean = mean / SAMPLE_INTERVAL_S
        first = velocity + mean - 0.5 * (velocity + after[2])
        rise = (after[2] - velocity) / SAMPLE_INTERVAL_S
        return self._arrays.concat([position, quaternion, first, rise], axis=1)

    def _state(self, sample: int) -> tuple[Any, Any, Any]:
        """Return position, quaternion, and linear and angular velocity of the body at a sample; see `Driver.moved`."""
        arrays = self._arrays
        position, quaternion = self._position, self._quaternion
        linear = angular = self._still
        for column, motion in enumerate(self._motions):
            rotates, values, rates, axis, point_m, cross = motion
            value = values[sample] + self._offsets[:, column : column + 1]
            rate = rates[sample] + self._rates[:, column : column + 1]
            if not rotates:
                position = position + value * axis
                linear = linear + rate * axis
                continue
            cosine, sine = arrays.cos(value), arrays.sin(value)

            def turned(
                rows: Any, c: Any = cosine, s: Any = sine, k: Any = motion
            ) -> Any:
                """Return rotated vectors by Rodrigues' formula."""
                along = (rows * k[3]).sum(axis=1)[:, None] * k[3]
                return c * rows + s * arrays.matmul(rows, k[5]) + (1.0 - c) * along

            arm = turned(position - point_m)
            position = arm + point_m
            linear = turned(linear) + rate * arrays.matmul(arm, cross)
            angular = turned(angular) + rate * axis
            half = arrays.concat(
                [arrays.cos(0.5 * value), arrays.sin(0.5 * value) * axis], axis=1
            )
            quaternion = self._product(half, quaternion)
        return position, quaternion, arrays.concat([linear, angular], axis=1)

    def _product(self, one: Any, other: Any) -> Any:
        """Return the products of quaternions w x y z, shape [world_count, 4]."""
        a, b, c, d = (one[:, column] for column in range(4))
        w, x, y, z = (other[:, column] for column in range(4))
        return self._arrays.stack(
            [
                a * w - b * x - c * y - d * z,
                a * x + b * w + c * z - d * y,
                a * y - b * z + c * w + d * x,
                a * z + b * y - c * x + d * w,
            ],
            axis=1,
        )

    def _rotation_vector(self, before: Any, after: Any) -> Any:
        """Return the rotation vectors from orientations to others, less than a turn apart, shape [world_count, 3]."""
        arrays = self._arrays
        back = arrays.concat([before[:, :1], -before[:, 1:]], axis=1)
        turn = self._product(after, back)
        # The shorter of both ways round.
        turn = arrays.where(turn[:, :1] < 0.0, -turn, turn)
        half_sine = arrays.sqrt(arrays.square(turn[:, 1:]).sum(axis=1))[:, None]
        angle = 2.0 * arrays.atan2(half_sine, turn[:, :1])
        is_small = half_sine < 1e-12
        divisor = arrays.where(is_small, 1.0 + half_sine, half_sine)
        return turn[:, 1:] * arrays.where(is_small, 2.0 + half_sine, angle / divisor)


@lru_cache(maxsize=32)
def _recorded_path(
    driver: Driver, start: Pose, count: int, interval_s: float
) -> Intervals:
    """Return the motion without actions; for minutes of motion it takes longer than the build of most scenes."""
    times_s = interval_s * np.arange(count + 1, dtype=np.float64)
    coordinates, rates = _recorded_coordinates(_still(driver), count, interval_s)
    states = driver.moved(
        start_rows([start]), times_s, coordinates[: count + 1], rates[: count + 1]
    )
    return Intervals(states, interval_s)


def _still(driver: Driver) -> tuple[DriverMotion, ...]:
    """Return motions about the same line, whose coordinates are those of the driver's also where its scene leans."""
    return tuple(
        replace(one, axis=(1.0, 0.0, 0.0), point_m=(0.0, 0.0, 0.0))
        for one in driver.motions
    )


@lru_cache(maxsize=32)
def _recorded_coordinates(
    motions: tuple[DriverMotion, ...], count: int, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return coordinates without actions [m or rad] and their rates at `count` samples and those of the next frame.

    They are the same for a misplaced body, and in each episode with actions.
    """
    samples = np.arange(count + 1 + SAMPLES_PER_FRAME, dtype=np.float64)
    return recorded_coordinates(motions, interval_s * samples)


def _between(
    before: FloatArray, after: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return velocity and acceleration of the motions from some states to others, shape [count, 6] each."""
    back = before[:, 3:7] * [1.0, -1.0, -1.0, -1.0]
    turns = unit_quaternions(quaternion_products(after[:, 3:7], back))
    linear = (after[:, :3] - before[:, :3]) / interval_s
    angular = quaternion_vectors(turns) / interval_s
    starts, ends = before[:, 7:], after[:, 7:]
    miss = np.concatenate([linear, angular], axis=1) - 0.5 * (starts + ends)
    return starts + miss, (ends - starts) / interval_s
