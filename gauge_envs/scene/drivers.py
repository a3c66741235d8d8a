"""Prescribed motion of a kinematic body: motions along and about axes, with the resulting poses and velocities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from gauge_envs.scene.bodies import RigidBody
from gauge_envs.scene.geometry import (
    FloatArray,
    NonNegative,
    Pose,
    Vector,
    length_of,
    quaternion_products,
    unit_quaternions,
)
from gauge_envs.scene.profiles import Profile


@dataclass(frozen=True, kw_only=True)
class DriverMotion:
    """One coordinate of a driver: a translation along a fixed world axis, or a rotation about it.

    Attributes:
        kind: `translate` (coordinate in m) or `rotate` (coordinate in rad).
        axis: Unit vector in the world.
        point_m: A point of the rotation axis [m]; a translation does not use it.
        residual_rate: Rate that an action of 1 adds [m/s or rad/s]; 0 if actions have no effect.
        profiles: Profiles whose sum is the coordinate over time.
    """

    kind: Literal["translate", "rotate"]
    axis: Vector
    point_m: Vector = (0.0, 0.0, 0.0)
    residual_rate: NonNegative = 0.0
    profiles: tuple[Profile, ...]

    def __post_init__(self) -> None:
        if abs(length_of(self.axis) - 1.0) > 1e-9:
            raise ValueError(f"axis {list(self.axis)} is not a unit vector")

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time [m or rad]."""
        return sum(profile.value(time_s) for profile in self.profiles)

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]."""
        return sum(profile.rate(time_s) for profile in self.profiles)

    @cached_property
    def cross_product(self) -> FloatArray:
        """Matrix M of the cross product with the axis: v M is axis x v."""
        return np.cross(self.axis, np.eye(3))

    @cached_property
    def quaternion_product(self) -> FloatArray:
        """Matrix M of the product with half a turn about the axis: q M is the rotation q, then half a turn."""
        half_turn = np.tile([0.0, *self.axis], (4, 1))
        return quaternion_products(half_turn, np.eye(4))

    def rotated(self, vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
        """Return vectors, shape [count, 3], after rotations about the axis by angles [rad], shape [count, 1]."""
        # Rodrigues' rotation formula.
        across = vectors @ self.cross_product
        inward = across @ self.cross_product
        return np.asarray(
            vectors + np.sin(angles_rad) * across + (1.0 - np.cos(angles_rad)) * inward
        )

    @property
    def largest_rate(self) -> float:
        """Bound on the absolute rate, actions included [m/s or rad/s]."""
        return (
            sum(profile.largest_rate for profile in self.profiles) + self.residual_rate
        )


@dataclass(frozen=True, kw_only=True)
class Driver:
    """Prescribed motion of one kinematic body.

    Attributes:
        body: Name of the kinematic body.
        motions: Motions that apply in order to the start pose, each in the world frame.
        provenance: Source of the motion: `video`, `mocap`, `nominal`, ...
    """

    body: str
    motions: tuple[DriverMotion, ...]
    provenance: str

    def pose(self, start: Pose, time_s: float) -> Pose:
        """Return the pose at a time, without actions.

        Args:
            start: Pose of the body before anything moves.
            time_s: Time since the start of the episode [s].
        """
        return Pose.of_state(self.path(start, np.array([time_s]))[0])

    def path(self, start: Pose, times_s: FloatArray) -> FloatArray:
        """Return poses and velocities at times, without actions, shape [time_count, 13]; see `moved`."""
        coordinates, rates = recorded_coordinates(self.motions, times_s)
        pose = np.array([[*start.position_m, *start.quaternion]])
        return self.moved(pose, coordinates, rates)

    def moved(
        self, start_poses: FloatArray, coordinates: FloatArray, rates: FloatArray
    ) -> FloatArray:
        """Return poses and velocities of the body.

        Args:
            start_poses: Poses before anything moves, position [m] and quaternion w x y z, shape [count, 7] or [1, 7].
            coordinates: Coordinate of each motion [m or rad], shape [count, motion_count].
            rates: Rate of each motion [m/s or rad/s], shape [count, motion_count].

        Returns:
            Position, quaternion, linear velocity of the body origin [m/s] (3) and angular velocity [rad/s] (3) in the
            world frame, shape [count, 13].
        """
        position, quaternions = start_poses[:, :3], start_poses[:, 3:]
        linear = angular = np.zeros_like(position)
        for index, motion in enumerate(self.motions):
            value, rate = coordinates[:, index, None], rates[:, index, None]
            change = rate * motion.axis
            if motion.kind == "translate":
                position = position + value * motion.axis
                linear = linear + change
                continue
            rotated = motion.rotated
            arm = rotated(position - motion.point_m, value)
            position = arm + motion.point_m
            if index:
                linear, angular = rotated(linear, value), rotated(angular, value)
            linear = linear + rate * (arm @ motion.cross_product)
            angular = angular + change
            half = 0.5 * value
            products = quaternions @ motion.quaternion_product
            quaternions = np.cos(half) * quaternions + np.sin(half) * products
        states = np.empty((len(coordinates), 13))
        states[:, :3] = position
        states[:, 3:7] = unit_quaternions(quaternions)
        states[:, 7:10] = linear
        states[:, 10:] = angular
        return states

    def speed_limit_m_per_s(self, body: RigidBody) -> float:
        """Return a bound on the speed of any point of the driven body [m/s]."""
        corners = body.pose.to_world(body.shape.corners_m)
        speed = 0.0
        for motion in self.motions:
            if motion.kind == "translate":
                speed += motion.largest_rate
            else:
                arm = np.linalg.norm(
                    np.cross(corners - np.asarray(motion.point_m), motion.axis), axis=1
                ).max()
                speed += motion.largest_rate * float(arm)
        return speed


def recorded_coordinates(
    motions: Sequence[DriverMotion], times_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return coordinates of motions [m or rad] and their rates, without actions, shape [time_count, motion_count]."""
    times = times_s.tolist()
    values = [[motion.value(time_s) for motion in motions] for time_s in times]
    rates = [[motion.rate(time_s) for motion in motions] for time_s in times]
    shape = len(times), len(motions)
    return np.reshape(values, shape), np.reshape(rates, shape)
