"""A driven body that actions accelerate along fixed axes, and the shortest way to bring it to rest at a place."""

import math
from dataclasses import replace
from operator import add, mul

import numpy as np

from gauge_envs.backends.world import World
from gauge_envs.scene import Box, Contact, Motion, Pose, RigidBody, Scene
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, Vector
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
    """A body that is accelerated along the axes of its driver, up to a speed, within a stroke.

    Args:
        driver: Driver of `stage_driver`, which translates.
        start: Pose of the body at the start.
        stroke_m: Largest displacement along each axis, to both sides [m], shape [axis_count]. At its end the body
            stops at once.

    Attributes:
        driver: The driver.
        largest_speed_m_per_s: Largest speed along each axis, shape [axis_count].
        offset_m: Displacement along the axes [m], shape [axis_count].
        rate_m_per_s: Velocity along the axes [m/s], shape [axis_count].
    """

    def __init__(self, driver: Driver, start: Pose, *, stroke_m: FloatArray) -> None:
        self.driver = driver
        self.largest_speed_m_per_s = np.array(
            [motion.residual_rate for motion in driver.motions]
        )
        self._start, self._stroke_m = start, stroke_m
        self._limits = list(
            zip(self.largest_speed_m_per_s.tolist(), stroke_m.tolist(), strict=True)
        )
        # Components along x, y and z of all axes.
        self._columns = [*zip(*(motion.axis for motion in driver.motions), strict=True)]
        self.begin()

    def begin(self) -> None:
        """Bring the body back to its start, at rest."""
        self.offset_m = self.rate_m_per_s = np.zeros(len(self._limits))
        self._pose = self._start
        self._moved_m = self._velocity = [0.0, 0.0, 0.0]

    def reach_m(self, duration_s: float) -> FloatArray:
        """Return the largest displacement along each axis in some time [m], shape [axis_count]."""
        return np.minimum(self._stroke_m, self.largest_speed_m_per_s * duration_s)

    def drive(self, world: World, acceleration_m_per_s2: FloatArray) -> None:
        """Drive the body for the next 1/180 s with a uniform acceleration along the axes, shape [axis_count]."""
        # Numbers of Python are faster than arrays of so few.
        step = SAMPLE_INTERVAL_S
        offsets, rates = [], []
        for offset_m, rate, acceleration, (fastest, stroke_m) in zip(
            self.offset_m.tolist(),
            self.rate_m_per_s.tolist(),
            acceleration_m_per_s2.tolist(),
            self._limits,
            strict=True,
        ):
            wanted_rate = min(max(rate + acceleration * step, -fastest), fastest)
            wanted_m = offset_m + 0.5 * (rate + wanted_rate) * step
            reached_m = min(max(wanted_m, -stroke_m), stroke_m)
            offsets.append(reached_m)
            rates.append(wanted_rate if reached_m == wanted_m else 0.0)
        moved_m, velocity = self._along_axes(offsets), self._along_axes(rates)
        # A uniform acceleration that ends exactly at the pose.
        linear = [
            2.0 / step**2 * (after_m - before_m) - 2.0 / step * speed
            for after_m, before_m, speed in zip(
                moved_m, self._moved_m, self._velocity, strict=True
            )
        ]
        still = [0.0, 0.0, 0.0]
        world.drive(
            self.driver.body,
            self._pose,
            np.array(self._velocity + still),
            np.array(linear + still),
        )
        self.offset_m, self.rate_m_per_s = np.array(offsets), np.array(rates)
        self._moved_m, self._velocity = moved_m, velocity
        x_m, y_m, z_m = map(add, self._start.position_m, moved_m)
        self._pose = Pose(position_m=(x_m, y_m, z_m), quaternion=self._start.quaternion)

    def _along_axes(self, values: list[float]) -> list[float]:
        """Return the vector with some components along the axes, three numbers."""
        return [sum(map(mul, values, column)) for column in self._columns]


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
    # The speed w after the frame: distance = (v + w) t / 2 + w^2 / (2 a).
    half = 0.5 * acceleration_m_per_s2 * FRAME_S
    left = half**2 + 2.0 * acceleration_m_per_s2 * (
        distance_m - 0.5 * speed_m_per_s * FRAME_S
    )
    speed = math.sqrt(left) - half if left > 0.0 else -math.inf
    change = (speed - speed_m_per_s) / FRAME_S
    return min(max(change, -acceleration_m_per_s2), acceleration_m_per_s2)
