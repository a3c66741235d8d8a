"""A driven body that actions accelerate, and the shortest way to bring it to rest at a place."""

import math
from dataclasses import replace

import numpy as np

from gauge_envs.scene import Box, Contact, Motion, Pose, RigidBody, Scene
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, Vector
from gauge_envs.scene.prescribed_motion import uniformly_accelerated
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S

X_AXIS, Y_AXIS, Z_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

FRAME_S = 1.0 / FRAME_RATE_HZ
"""Time of a step, in which the acceleration is constant [s]."""


def stage_driver(
    body: str, axes: tuple[Vector, ...], *, largest_speed_m_per_s: float
) -> Driver:
    """Return a driver that translates a body by actions alone.

    Args:
        body: Name of the kinematic body.
        axes: Unit vectors in the world, one for each entry of the action.
        largest_speed_m_per_s: Largest speed along each axis.
    """
    motions = tuple(
        DriverMotion(
            kind="translate",
            axis=axis,
            residual_rate=largest_speed_m_per_s,
            profiles=(),
        )
        for axis in axes
    )
    return Driver(body=body, motions=motions, provenance="action")


def with_stage(
    stated: Scene,
    body: str,
    size_m: Vector,
    position_m: Vector,
    driver: Driver,
    *,
    pushes: str,
    like: Contact,
) -> Scene:
    """Return a scene with a box that actions move.

    Args:
        stated: The scene.
        body: Name of the box.
        size_m: Its edges [m].
        position_m: Its centre at the start [m].
        driver: Driver of `stage_driver`.
        pushes: Name of the body that it touches.
        like: Contact of that body whose constants and mode the contact with the box has.
    """
    box = RigidBody(
        name=body,
        shape=Box(size_m=size_m),
        motion=Motion.KINEMATIC,
        pose=Pose(position_m=position_m),
        mass_kg=1.0,
    )
    contact = replace(like, first=(pushes,), second=(body,))
    return replace(
        stated,
        bodies=(*stated.bodies, box),
        contacts=(*stated.contacts, contact),
        drivers=(driver,),
    )


class Stage:
    """A body that is accelerated along the coordinates of its driver, up to a rate, within a stroke.

    A coordinate is a displacement [m] or an angle [rad]. `gauge_envs.tools.bench.recording.intervals` drives the body.

    Args:
        driver: Driver without a motion of its own; `residual_rate` is the largest rate of a coordinate.
        start: Pose of the body at the start.
        strokes: Largest absolute value of each coordinate; at its end the body stops at once.

    Attributes:
        body: Name of the body.
        sample: Number of intervals of the frame that have passed.
        left: Sum of the changes of each rate that is left.
        offsets: Coordinates at the samples of the frame, shape [sample_count, motion_count].
        rates: Their rates, of the same shape.
        states: States of the body at the samples, shape [sample_count, 13].
    """

    def __init__(self, driver: Driver, start: Pose, strokes: FloatArray) -> None:
        self.body = driver.body
        self.left = math.inf
        self._driver, self._strokes = driver, strokes.tolist()
        self._start = np.array([[*start.position_m, *start.quaternion]])
        self.reset()

    def reset(self) -> None:
        """Bring the body back to its start, at rest."""
        self.sample = 0
        self.offsets = self.rates = np.zeros((1, len(self._strokes)))
        self.states = self._driver.moved(self._start, self.offsets, self.rates)

    @property
    def offset(self) -> FloatArray:
        """Coordinates now [m or rad], shape [motion_count]."""
        return self.offsets[self.sample]

    @property
    def rate(self) -> FloatArray:
        """Rates of the coordinates now [m/s or rad/s], shape [motion_count]."""
        return self.rates[self.sample]

    @property
    def state(self) -> FloatArray:
        """State of the body now, shape [13]."""
        return self.states[self.sample]

    def targets(
        self, first: int, accelerations: FloatArray, count: int = 1
    ) -> FloatArray:
        """Return what `Simulation.drive` takes in the next intervals of uniform acceleration.

        Args:
            first: Number of the first interval, of no use here.
            accelerations: Acceleration of each coordinate, shape [1, motion_count].
            count: Number of intervals.

        Returns:
            Shape [count, 1, 19].
        """
        columns = [
            self._coordinate(index, acceleration, count)
            for index, acceleration in enumerate(accelerations[0].tolist())
        ]
        self.offsets, self.rates = np.array(columns).transpose(1, 2, 0)
        self.sample = 0
        starts = np.tile(self._start, (count + 1, 1))
        self.states = self._driver.moved(starts, self.offsets, self.rates)
        return uniformly_accelerated(self.states[:, None], SAMPLE_INTERVAL_S)

    def _coordinate(
        self, index: int, acceleration: float, count: int
    ) -> tuple[list[float], list[float]]:
        """Return a coordinate and its rate at the samples of the next intervals."""
        offset, rate = float(self.offset[index]), float(self.rate[index])
        fastest = self._driver.motions[index].residual_rate
        stroke, left = self._strokes[index], self.left
        offsets, rates = [offset], [rate]
        for _ in range(count):
            change = min(max(acceleration * SAMPLE_INTERVAL_S, -left), left)
            wanted_rate = min(max(rate + change, -fastest), fastest)
            left -= min(abs(wanted_rate - rate), left)
            wanted = offset + 0.5 * (rate + wanted_rate) * SAMPLE_INTERVAL_S
            offset = min(max(wanted, -stroke), stroke)
            rate = wanted_rate if offset == wanted else 0.0
            offsets.append(offset)
            rates.append(rate)
        return offsets, rates


def acceleration_to_rest(
    distance_m: float, speed_m_per_s: float, acceleration_m_per_s2: float
) -> float:
    """Return the acceleration of the next frame on the fastest way to rest at a distance.

    The body speeds up with the largest acceleration, and brakes with it. In the frame between, the acceleration is the
    one from which the braking distance ends at the place.

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
    # The speed w after the frame: distance = (v + w) t / 2 + w^2 / (2 a).
    half = 0.5 * deceleration_m_per_s2 * FRAME_S
    left_m = distance_m - 0.5 * speed_m_per_s * FRAME_S
    square = half**2 + 2.0 * deceleration_m_per_s2 * left_m
    return math.sqrt(square) - half if square > 0.0 else -math.inf
