"""Prescribed motion of a kinematic body: profiles of coordinates over time, and the resulting pose and velocity."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene.bodies import RigidBody
from gauge_envs.scene.geometry import FloatArray, NonNegative, Pose, Positive, Vector, vector

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator


@dataclass(frozen=True, kw_only=True)
class TrapezoidProfile:
    """Trapezoidal speed profile of a motor: constant acceleration, constant speed, constant deceleration.

    Attributes:
        kind: Name of the profile in files.
        start_s: Time at which the motion starts [s].
        duration_s: Time from start to standstill [s].
        accelerate_s: Duration of the acceleration [s]; 0 for a start at full speed.
        brake_s: Duration of the deceleration [s].
        amount: Signed total change of the coordinate [m or rad].
    """

    kind: Literal["trapezoid"] = field(default="trapezoid", repr=False)
    start_s: float
    duration_s: Positive
    accelerate_s: NonNegative
    brake_s: NonNegative
    amount: float

    def __post_init__(self) -> None:
        if self.accelerate_s + self.brake_s > self.duration_s:
            raise ValueError("accelerate_s and brake_s together are longer than duration_s")

    @property
    def cruise_rate(self) -> float:
        """Signed rate between acceleration and deceleration [m/s or rad/s]."""
        return self.amount / (self.duration_s - 0.5 * (self.accelerate_s + self.brake_s))

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        return abs(self.cruise_rate)

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time, relative to its start [m or rad]."""
        t = min(max(time_s - self.start_s, 0.0), self.duration_s)
        speed_up = min(t, self.accelerate_s)
        # Distance at the cruise rate, less the distance lost during acceleration and deceleration.
        value = self.cruise_rate * t
        if self.accelerate_s > 0.0:
            value -= self.cruise_rate * (speed_up - 0.5 * speed_up**2 / self.accelerate_s)
        braking = max(t - (self.duration_s - self.brake_s), 0.0)
        if self.brake_s > 0.0:
            value -= 0.5 * self.cruise_rate * braking**2 / self.brake_s
        return value

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]."""
        t = time_s - self.start_s
        if not 0.0 <= t < self.duration_s:
            return 0.0
        if t < self.accelerate_s:
            return self.cruise_rate * t / self.accelerate_s
        left = self.duration_s - t
        return self.cruise_rate * (left / self.brake_s if left < self.brake_s else 1.0)


@dataclass(frozen=True, kw_only=True)
class CosineProfile:
    """Change by `amount` along half a cosine period, which starts and ends at rest."""

    kind: Literal["cosine"] = field(default="cosine", repr=False)
    start_s: float
    duration_s: Positive
    amount: float

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        return 0.5 * np.pi * abs(self.amount) / self.duration_s

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time, relative to its start [m or rad]."""
        phase = min(max((time_s - self.start_s) / self.duration_s, 0.0), 1.0)
        return 0.5 * self.amount * (1.0 - float(np.cos(np.pi * phase)))

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]."""
        phase = min(max((time_s - self.start_s) / self.duration_s, 0.0), 1.0)
        return 0.5 * np.pi * self.amount / self.duration_s * float(np.sin(np.pi * phase))


@dataclass(frozen=True, kw_only=True)
class SampledProfile:
    """Sampled coordinate with monotone cubic interpolation (no overshoot), constant before and after the samples.

    Attributes:
        kind: Name of the profile in files.
        times_s: Strictly increasing times [s], shape [sample_count].
        values: Coordinate relative to the start pose [m or rad], same shape.
    """

    kind: Literal["sampled"] = field(default="sampled", repr=False)
    times_s: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.times_s) < 2:
            raise ValueError(f"times_s has {len(self.times_s)} entries; at least 2 are needed")
        if len(self.values) != len(self.times_s):
            raise ValueError(f"{len(self.times_s)} times but {len(self.values)} values")
        for index in range(1, len(self.times_s)):
            before, time = self.times_s[index - 1 : index + 1]
            if time <= before:
                raise ValueError(f"driver time is not increasing: times_s[{index}] = {time} after {before}")

    @cached_property
    def _curve(self) -> PchipInterpolator:
        # Lists of experiments need no curve, and the import takes a tenth of a second.
        from scipy.interpolate import PchipInterpolator

        # Slopes of subnormal numbers have infinite inverses, from which the slope 0 follows.
        with np.errstate(over="ignore"):
            return PchipInterpolator(self.times_s, self.values)

    @cached_property
    def _slope(self) -> PchipInterpolator:
        return self._curve.derivative()

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        # The slope of a cubic piece is extreme at its ends or at a root of its derivative; flat pieces give NaN.
        inside = self._slope.derivative().roots(extrapolate=False)
        return float(np.abs(self._slope(np.concatenate([self.times_s, inside[np.isfinite(inside)]]))).max())

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time, relative to the start pose [m or rad]."""
        return float(self._curve(min(max(time_s, self.times_s[0]), self.times_s[-1])))

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]; 0 before the first and after the last sample."""
        return float(self._slope(time_s)) if self.times_s[0] <= time_s < self.times_s[-1] else 0.0


class _ByKind:
    """Metadata of a union whose member is chosen by `kind`; keeps pydantic out of the imports of this module."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic import Field

        return handler.generate_schema(Annotated[source, Field(discriminator="kind")])


Profile = Annotated[TrapezoidProfile | CosineProfile | SampledProfile, _ByKind()]
"""How a coordinate changes over time."""


@dataclass(frozen=True, kw_only=True)
class DriverMotion:
    """One coordinate of a driver: a translation along a fixed world axis, or a rotation about it.

    Attributes:
        kind: `translate` (coordinate in m) or `rotate` (coordinate in rad).
        axis: Unit vector in the world.
        point_m: A point of the rotation axis [m]; unused by a translation.
        residual_rate: Rate that an action of 1 adds [m/s or rad/s]; 0 if actions have no effect.
        profiles: Profiles whose sum is the coordinate over time.
    """

    kind: Literal["translate", "rotate"]
    axis: Vector
    point_m: Vector = (0.0, 0.0, 0.0)
    residual_rate: NonNegative = 0.0
    profiles: tuple[Profile, ...]

    def __post_init__(self) -> None:
        if abs(float(np.linalg.norm(self.axis)) - 1.0) > 1e-9:
            raise ValueError(f"axis {list(self.axis)} is not a unit vector")

    def value(self, time_s: float) -> float:
        """Return the coordinate at a time [m or rad]."""
        return sum(profile.value(time_s) for profile in self.profiles)

    def rate(self, time_s: float) -> float:
        """Return the rate at a time [m/s or rad/s]."""
        return sum(profile.rate(time_s) for profile in self.profiles)

    @property
    def largest_rate(self) -> float:
        """Bound on the absolute rate, actions included [m/s or rad/s]."""
        return sum(profile.largest_rate for profile in self.profiles) + self.residual_rate


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

    def pose(self, start: Pose, time_s: float, offsets: FloatArray | None = None) -> Pose:
        """Return the pose at a time.

        Args:
            start: Pose of the body before anything moves.
            time_s: Time since the start of the episode [s].
            offsets: Displacement of each motion by actions [m or rad], shape [motion_count].
        """
        return self.state(start, time_s, offsets)[0]

    def state(
        self,
        start: Pose,
        time_s: float,
        offsets: FloatArray | None = None,
        rates: FloatArray | None = None,
    ) -> tuple[Pose, FloatArray]:
        """Return the pose and the velocity at a time.

        Args:
            start: Pose of the body before anything moves.
            time_s: Time since the start of the episode [s].
            offsets: Displacement of each motion by actions [m or rad], shape [motion_count].
            rates: Rate of each motion due to actions [m/s or rad/s], shape [motion_count].

        Returns:
            The pose; and the linear velocity of the body origin [m/s] and the angular velocity [rad/s] in the world
            frame, shape [6].
        """
        single = (np.zeros(len(self.motions)) if one is None else np.asarray(one) for one in (offsets, rates))
        state = self.states(np.array([[*start.position_m, *start.quaternion]]), time_s, *(one[None] for one in single))[
            0
        ]
        w, x, y, z = state[3:7].tolist()
        return Pose(position_m=vector(state[:3]), quaternion=(w, x, y, z)), state[7:]

    def states(
        self, starts: FloatArray, time_s: float | FloatArray, offsets: FloatArray, rates: FloatArray
    ) -> FloatArray:
        """Return poses and velocities in many worlds at a time, or in one at many times.

        Args:
            starts: Position [m] (3) and quaternion w x y z (4) in each world before anything moves, shape
                [world_count, 7].
            time_s: Time since the start of the episode [s], or one for each row of `starts`.
            offsets: Displacement of each motion by actions [m or rad], shape [world_count, motion_count].
            rates: Rate of each motion due to actions [m/s or rad/s], shape [world_count, motion_count].

        Returns:
            Position, quaternion, linear velocity of the body origin [m/s] (3) and angular velocity [rad/s] (3) in the
            world frame, shape [world_count, 13].
        """
        position, rotation = starts[:, :3], Rotation.from_quat(starts[:, 3:], scalar_first=True)
        linear, angular = np.zeros_like(position), np.zeros_like(position)
        times_s = np.atleast_1d(time_s).tolist()
        for index, motion in enumerate(self.motions):
            value = (np.array([motion.value(one) for one in times_s]) + offsets[:, index])[:, None]
            rate = (np.array([motion.rate(one) for one in times_s]) + rates[:, index])[:, None]
            axis = np.asarray(motion.axis)
            if motion.kind == "translate":
                position = position + value * axis
                linear = linear + rate * axis
            else:
                own_rotation = Rotation.from_rotvec(value * axis)
                # `Rotation.apply` of one rotation is this product, and of several another one with other last bits.
                turn = own_rotation.as_matrix()
                arm = np.matmul(turn, (position - motion.point_m)[:, :, None])[:, :, 0]
                position = arm + motion.point_m
                rotation = own_rotation * rotation
                linear = np.matmul(turn, linear[:, :, None])[:, :, 0] + np.cross(rate * axis, arm)
                angular = np.matmul(turn, angular[:, :, None])[:, :, 0] + rate * axis
        return np.concatenate([position, rotation.as_quat(scalar_first=True), linear, angular], axis=1)

    def speed_limit_m_per_s(self, body: RigidBody) -> float:
        """Return a bound on the speed of any point of the driven body [m/s]."""
        speed = 0.0
        corners = body.pose.to_world(body.shape.corners_m)
        for motion in self.motions:
            if motion.kind == "translate":
                speed += motion.largest_rate
            else:
                arm = np.linalg.norm(np.cross(corners - np.asarray(motion.point_m), motion.axis), axis=1).max()
                speed += motion.largest_rate * float(arm)
        return speed
