"""A driven body that actions accelerate, and the acceleration that brings it to rest at a place."""

import math
from dataclasses import replace

import numpy as np

from gauge_envs.scene import Box, Motion, Pose, RigidBody, Scene
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, Vector
from gauge_envs.scene.prescribed_motion import uniformly_accelerated
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

X_AXIS, Y_AXIS, Z_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

FRAME_S = 1.0 / FRAME_RATE_HZ
"""Time of a step, in which the acceleration is constant [s]."""


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


class AxisRotation:
    """Targets of a body that only rotates about one axis: products of few functions of the angle with a matrix.

    With preset `training`, a step of a rotating stage takes two thirds of the time that it takes with `Driver.moved`.

    The arm a leads from the axis to the body, and b = axis x a. At the angle t and the rate w, the position is
    centre + a cos t + b sin t, the velocity is w (b cos t - a sin t), and the quaternion is q cos(t / 2) + p sin(t / 2)
    with p = (0, axis) q.

    Args:
        motion: The rotation.
        start: Pose before anything moves, position [m] and unit quaternion w x y z, shape [7].
    """

    def __init__(self, motion: DriverMotion, start: FloatArray) -> None:
        across = (start[:3] - motion.point_m) @ motion.cross_product
        arm = -across @ motion.cross_product
        self._constant = np.zeros(19)
        self._constant[:3] = start[:3] - arm
        # A row for each function in `targets`: of its values at the starts of intervals, then of its gains.
        values, gains = np.zeros((2, 8, 19))
        values[0, :3], values[1, :3] = arm, across
        values[2, 3:7], values[3, 3:7] = (
            start[3:],
            start[3:] @ motion.quaternion_product,
        )
        means, accelerations = gains[:, 7:13], gains[:, 13:]
        means[0, :3], means[1, :3] = arm / SAMPLE_INTERVAL_S, across / SAMPLE_INTERVAL_S
        means[7, 3:] = np.array(motion.axis) / SAMPLE_INTERVAL_S
        accelerations[4, :3], accelerations[5, :3] = means[0, :3], means[1, :3]
        accelerations[6, 3:] = means[7, 3:]
        # The mean velocity of the interval minus half of its gain is the velocity at its start.
        means -= 0.5 * SAMPLE_INTERVAL_S * accelerations
        self._matrix = np.concatenate([values, gains])

    def targets(
        self, angles_rad: FloatArray, rates_rad_per_s: FloatArray
    ) -> FloatArray:
        """Return the targets of intervals, shape [count, N, 19], from ends of intervals, shape [count + 1, N]."""
        cosines, sines = np.cos(angles_rad), np.sin(angles_rad)
        functions = np.empty((*angles_rad.shape, 8))
        functions[..., 0], functions[..., 1] = cosines, sines
        functions[..., 2] = np.cos(0.5 * angles_rad)
        functions[..., 3] = np.sin(0.5 * angles_rad)
        functions[..., 4] = -rates_rad_per_s * sines
        functions[..., 5] = rates_rad_per_s * cosines
        functions[..., 6], functions[..., 7] = rates_rad_per_s, angles_rad
        before, after = functions[:-1], functions[1:]
        features = np.concatenate([before, after - before], axis=-1)
        return np.asarray(features @ self._matrix + self._constant)


class Stage:
    """A body that actions accelerate along the coordinates of its driver, up to a rate, within a stroke.

    A coordinate is a displacement [m] or an angle [rad]. `gauge_envs.envs.rollout.intervals` drives the body.

    Args:
        scene: Scene with the body at its start; its one driver has no motion of its own.
        acceleration: Acceleration of a coordinate that an action of 1 commands [m/s^2 or rad/s^2].
        max_rate: Largest rate of a coordinate [m/s or rad/s].
        strokes: Largest absolute value of each coordinate, where the body stops at once.
        speed_change: Sum of all changes of the rates in an episode [m/s or rad/s]; the body then keeps its rate.

    Attributes:
        body: Name of the body.
        sample: Number of intervals of the frame that have passed.
        acceleration: Acceleration of each coordinate in the frame, shape [1, motion_count].
        offsets: Coordinates at the samples of the frame, shape [sample_count, motion_count].
        rates: Their rates, of the same shape.
        speed_changes_left: Rest of `speed_change` at the samples.
        poses: Poses of the body at the samples, shape [sample_count, 7].
    """

    def __init__(
        self,
        scene: Scene,
        acceleration: float,
        *,
        max_rate: float = math.inf,
        strokes: tuple[float, ...] = (math.inf,),
        speed_change: float = math.inf,
    ) -> None:
        (driver,) = scene.drivers
        start = scene.body(driver.body).pose
        self.body = driver.body
        self._driver = driver
        self._start = np.array([[*start.position_m, *start.quaternion]])
        motion, *others = driver.motions
        self._rotation = None
        if motion.kind == "rotate" and not others:
            self._rotation = AxisRotation(motion, self._start[0])
        self._scale = acceleration
        self._max_rate = max_rate
        self._strokes = strokes * (len(driver.motions) // len(strokes))
        self.sample = 0
        self.offsets = self.rates = np.zeros((1, len(driver.motions)))
        self.speed_changes_left = [speed_change]
        self.poses = self._start

    @property
    def offset(self) -> FloatArray:
        """Current coordinates [m or rad], shape [motion_count]."""
        return self.offsets[self.sample]

    @property
    def rate(self) -> FloatArray:
        """Current rates of the coordinates [m/s or rad/s], shape [motion_count]."""
        return self.rates[self.sample]

    @property
    def pose(self) -> FloatArray:
        """Current pose of the body, position [m] and unit quaternion w x y z, shape [7]."""
        return self.poses[self.sample]

    def targets(self, first: int, actions: FloatArray, count: int = 1) -> FloatArray:
        """Return the targets of `Simulation.drive` in the next intervals of uniform acceleration.

        Args:
            first: Number of the first interval; unused.
            actions: Action for each coordinate, from -1 to 1, shape [1, motion_count].
            count: Number of intervals.

        Returns:
            Shape [count, 1, 19].
        """
        self.acceleration = actions * self._scale
        changes = (self.acceleration[0] * SAMPLE_INTERVAL_S).tolist()
        offset, rate = self.offset.tolist(), self.rate.tolist()
        left = self.speed_changes_left[self.sample]
        offsets, rates, self.speed_changes_left = [offset], [rate], [left]
        # Floats are several times as fast here as arrays of one to three numbers.
        for _ in range(count):
            coordinates = zip(offset, rate, changes, self._strokes, strict=True)
            offset, rate, speed_change = [], [], 0.0
            for place, before, change, stroke in coordinates:
                after = _clipped(before + _clipped(change, left), self._max_rate)
                speed_change += abs(after - before)
                wanted = place + 0.5 * (before + after) * SAMPLE_INTERVAL_S
                reached = _clipped(wanted, stroke)
                offset.append(reached)
                rate.append(after if reached == wanted else 0.0)
            left = max(left - speed_change, 0.0)
            offsets.append(offset)
            rates.append(rate)
            self.speed_changes_left.append(left)
        self.sample = 0
        # One more interval, whose start has the pose at the last sample.
        ends, end_rates = np.array([*offsets, offset]), np.array([*rates, rate])
        self.offsets, self.rates = ends[:-1], end_rates[:-1]
        if self._rotation is not None:
            targets = self._rotation.targets(ends, end_rates)
        else:
            states = self._driver.moved(self._start, ends, end_rates)
            targets = uniformly_accelerated(states[:, None], SAMPLE_INTERVAL_S)
        self.poses = targets[:, 0, :7]
        return targets[:-1]


def _clipped(value: float, limit: float) -> float:
    """Return a value between minus and plus a limit."""
    return min(max(value, -limit), limit)


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
