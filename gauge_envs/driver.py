"""Prescribed motion of a kinematic body: profiles of one coordinate, composed into a pose and a velocity at time t."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError
from gauge_envs.scene import Pose, RigidBody, Vector

__all__ = [
    "CosineProfile",
    "Driver",
    "DriverMotion",
    "DriverSource",
    "Profile",
    "SampledProfile",
    "TrapezoidProfile",
    "mean_velocity",
    "motion_coordinates",
    "pose_distance",
    "sampled_motions",
]


class DriverSource(StrEnum):
    """Which motion a driven body follows, where there are two to choose from."""

    IMPORTED = "imported"
    """The mean motion of the real trials of an imported dataset, where it has the variant; else as bundled."""
    BUNDLED = "bundled"
    """The motion that the task file states."""


@dataclass(frozen=True, kw_only=True)
class TrapezoidProfile:
    """Move by `amount` with constant acceleration, cruise and braking; the shape of a motor's speed ramp.

    Attributes:
        start_s: Time at which the motion starts.
        duration_s: Time from start to standstill.
        accelerate_s: Length of the speed-up; may be 0 for a start at cruising speed.
        brake_s: Length of the braking.
        amount: Signed total change of the coordinate [m or rad].
    """

    start_s: float
    duration_s: float
    accelerate_s: float
    brake_s: float
    amount: float

    @property
    def cruise_rate(self) -> float:
        """Signed rate between speed-up and braking [m/s or rad/s]."""
        return self.amount / (self.duration_s - 0.5 * (self.accelerate_s + self.brake_s))

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        return abs(self.cruise_rate)

    def value(self, time_s: float) -> float:
        """Coordinate at a time, relative to its start [m or rad]."""
        t = min(max(time_s - self.start_s, 0.0), self.duration_s)
        speed_up = min(t, self.accelerate_s)
        # Distance = cruising over all of t, less what is lost while speeding up and while braking.
        value = self.cruise_rate * t
        if self.accelerate_s > 0.0:
            value -= self.cruise_rate * (speed_up - 0.5 * speed_up**2 / self.accelerate_s)
        braking = max(t - (self.duration_s - self.brake_s), 0.0)
        if self.brake_s > 0.0:
            value -= 0.5 * self.cruise_rate * braking**2 / self.brake_s
        return value

    def rate(self, time_s: float) -> float:
        """Rate at a time [m/s or rad/s]."""
        t = time_s - self.start_s
        if not 0.0 <= t < self.duration_s:
            return 0.0
        if t < self.accelerate_s:
            return self.cruise_rate * t / self.accelerate_s
        left = self.duration_s - t
        return self.cruise_rate * (left / self.brake_s if left < self.brake_s else 1.0)


@dataclass(frozen=True, kw_only=True)
class CosineProfile:
    """Move by `amount` along half a cosine: starts and ends at rest, smooth between."""

    start_s: float
    duration_s: float
    amount: float

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        return 0.5 * np.pi * abs(self.amount) / self.duration_s

    def value(self, time_s: float) -> float:
        """Coordinate at a time, relative to its start [m or rad]."""
        phase = min(max((time_s - self.start_s) / self.duration_s, 0.0), 1.0)
        return 0.5 * self.amount * (1.0 - float(np.cos(np.pi * phase)))

    def rate(self, time_s: float) -> float:
        """Rate at a time [m/s or rad/s]."""
        phase = min(max((time_s - self.start_s) / self.duration_s, 0.0), 1.0)
        return 0.5 * np.pi * self.amount / self.duration_s * float(np.sin(np.pi * phase))


class SampledProfile:
    """Coordinate measured at times, interpolated by a monotone cubic (no overshoot), held before and after.

    Args:
        times_s: Strictly increasing times [s], shape [sample_count].
        values: Coordinate relative to the start pose [m or rad], same shape.
    """

    def __init__(self, *, times_s: tuple[float, ...], values: tuple[float, ...]) -> None:
        self.times_s = times_s
        self.values = values
        self._curve = PchipInterpolator(times_s, values)
        self._slope = self._curve.derivative()

    @property
    def largest_rate(self) -> float:
        """Largest absolute rate [m/s or rad/s]."""
        # Inside a cubic piece the slope is extreme where its derivative vanishes; roots of flat pieces come out as NaN.
        inside = self._slope.derivative().roots(extrapolate=False)
        return float(np.abs(self._slope(np.concatenate([self.times_s, inside[np.isfinite(inside)]]))).max())

    def value(self, time_s: float) -> float:
        """Coordinate at a time, relative to the start pose [m or rad]."""
        return float(self._curve(min(max(time_s, self.times_s[0]), self.times_s[-1])))

    def rate(self, time_s: float) -> float:
        """Rate at a time [m/s or rad/s]; 0 before the first and after the last sample."""
        return float(self._slope(time_s)) if self.times_s[0] <= time_s < self.times_s[-1] else 0.0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SampledProfile) and (self.times_s, self.values) == (other.times_s, other.values)

    def __hash__(self) -> int:
        return hash((self.times_s, self.values))


Profile = TrapezoidProfile | CosineProfile | SampledProfile


@dataclass(frozen=True, kw_only=True)
class DriverMotion:
    """One coordinate of a driver: a translation along, or a rotation about, a fixed world axis.

    Attributes:
        kind: `translate` (coordinate in m) or `rotate` (coordinate in rad).
        axis: Unit vector in the world.
        point_m: A point of the rotation axis; unused by a translation.
        profiles: Their sum is the recorded or nominal coordinate over time.
        residual_rate: Rate that an action of 1 adds [m/s or rad/s]; 0 where the action has no say.
    """

    kind: Literal["translate", "rotate"]
    axis: Vector
    profiles: tuple[Profile, ...]
    point_m: Vector = (0.0, 0.0, 0.0)
    residual_rate: float = 0.0

    def value(self, time_s: float) -> float:
        """Coordinate at a time [m or rad]."""
        return sum(profile.value(time_s) for profile in self.profiles)

    def rate(self, time_s: float) -> float:
        """Rate at a time [m/s or rad/s]."""
        return sum(profile.rate(time_s) for profile in self.profiles)

    @property
    def largest_rate(self) -> float:
        """Bound on the absolute rate, action included [m/s or rad/s]."""
        return sum(profile.largest_rate for profile in self.profiles) + self.residual_rate


@dataclass(frozen=True, kw_only=True)
class Driver:
    """Prescribed motion of one kinematic body.

    Attributes:
        body: Name of the kinematic body.
        motions: Applied in order to the start pose, each in the world frame.
        provenance: Where the motion is from: `video`, `mocap`, `nominal`, ...
    """

    body: str
    motions: tuple[DriverMotion, ...]
    provenance: str

    def pose(self, start: Pose, time_s: float, offsets: NDArray[np.float64] | None = None) -> Pose:
        """Pose at a time.

        Args:
            start: Pose of the body before anything moves.
            time_s: Time since the start of the episode.
            offsets: Added to each motion's coordinate [m or rad], shape [motion_count]; where actions have led.
        """
        return self.state(start, time_s, offsets)[0]

    def state(
        self,
        start: Pose,
        time_s: float,
        offsets: NDArray[np.float64] | None = None,
        rates: NDArray[np.float64] | None = None,
    ) -> tuple[Pose, NDArray[np.float64]]:
        """Pose and velocity at a time.

        Args:
            start: Pose of the body before anything moves.
            time_s: Time since the start of the episode.
            offsets: Added to each motion's coordinate [m or rad], shape [motion_count].
            rates: Added to each motion's rate [m/s or rad/s], shape [motion_count].

        Returns:
            The pose; and the linear velocity of the body origin [m/s] and the angular velocity [rad/s] in the world
            frame, shape [6].
        """
        position, rotation = np.asarray(start.position_m), start.rotation
        linear, angular = np.zeros(3), np.zeros(3)
        for index, motion in enumerate(self.motions):
            value = motion.value(time_s) + (0.0 if offsets is None else float(offsets[index]))
            rate = motion.rate(time_s) + (0.0 if rates is None else float(rates[index]))
            axis = np.asarray(motion.axis)
            if motion.kind == "translate":
                position = position + value * axis
                linear = linear + rate * axis
            else:
                turn = Rotation.from_rotvec(value * axis)
                arm = turn.apply(position - motion.point_m)
                position = arm + motion.point_m
                rotation = turn * rotation
                linear = turn.apply(linear) + np.cross(rate * axis, arm)
                angular = turn.apply(angular) + rate * axis
        w, x, y, z = rotation.as_quat(scalar_first=True).tolist()
        pose = Pose(position_m=(float(position[0]), float(position[1]), float(position[2])), quaternion=(w, x, y, z))
        return pose, np.concatenate([linear, angular])

    def speed_limit_m_per_s(self, body: RigidBody) -> float:
        """Bound on the speed of any point of the driven body [m/s]."""
        speed = 0.0
        corners = body.pose.to_world(body.shape.corners_m)
        for motion in self.motions:
            if motion.kind == "translate":
                speed += motion.largest_rate
            else:
                arm = np.linalg.norm(np.cross(corners - np.asarray(motion.point_m), motion.axis), axis=1).max()
                speed += motion.largest_rate * float(arm)
        return speed


def mean_velocity(start: Pose, end: Pose, interval_s: float) -> NDArray[np.float64]:
    """Constant velocity that carries a body from one pose to another.

    Returns:
        Linear velocity of the body origin [m/s] and angular velocity [rad/s] in the world frame, shape [6].
    """
    linear = (np.asarray(end.position_m) - np.asarray(start.position_m)) / interval_s
    angular = (end.rotation * start.rotation.inv()).as_rotvec() / interval_s
    return np.concatenate([linear, angular])


# --- motions from poses ----------------------------------------------------------------------------------------------

SAME_POSE = 1e-9
"""Motions reproduce sampled poses as closely as this [m, rad]."""

STEEP_RAD = np.radians(85.0)
"""Three successive turns describe a rotation badly where the second comes closer than this to a quarter turn."""

TURN_ORDERS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


def sampled_motions(
    start: Pose, times_s: Sequence[float], poses: Sequence[Pose], *, like: Sequence[DriverMotion] = ()
) -> tuple[DriverMotion, ...]:
    """Motions with sampled profiles whose poses at the samples are the given ones, within 1e-9 m and rad.

    The first of these that can: the motions `like`, as they are; a turn about the axis of the only one of them, about
    another point; a translation along a line; a turn about a fixed axis; turns about the body's origin, then
    translations. Of `like` stays what occurs among them again, with its rate of action.

    Args:
        start: Pose of the body before anything moves.
        times_s: Strictly increasing times [s], shape [sample_count], two at least.
        poses: World poses at these times.
        like: Motions to keep as far as possible; their profiles are replaced.

    Returns:
        The motions; none where the body stays at its start.

    Raises:
        ShapeError: Times and poses do not fit, or the body tumbles in a way that no three turns describe.
    """
    if len(times_s) != len(poses) or len(times_s) < 2 or not np.all(np.diff(times_s) > 0.0):
        raise ShapeError("poses at two or more strictly increasing times are expected")
    positions = np.array([pose.position_m for pose in poses])
    turned = Rotation.from_quat([pose.quaternion for pose in poses], scalar_first=True) * start.rotation.inv()
    for template in _templates(start, positions, turned, like):
        values, _, _ = motion_coordinates(template, start.position_m, positions, turned)
        motions = tuple(
            replace(motion, profiles=(SampledProfile(times_s=tuple(times_s), values=tuple(column)),))
            for motion, column in zip(template, values.T.tolist(), strict=True)
        )
        if _reproduces(motions, start, times_s, poses):
            return motions if template == tuple(like) else tuple(filter(_matters, motions))
    raise ShapeError("its rotation is too far from one about a fixed axis: no three turns describe it")


def _matters(motion: DriverMotion) -> bool:
    return motion.residual_rate > 0.0 or motion.largest_rate > 0.0 or abs(motion.value(0.0)) > SAME_POSE


def _templates(
    start: Pose, positions: NDArray[np.float64], turned: Rotation, like: Sequence[DriverMotion]
) -> Iterator[tuple[DriverMotion, ...]]:
    """Sets of motions that may lead through poses, simple ones first; their profiles are still those of `like`."""
    turns = [motion for motion in like if motion.kind == "rotate"]
    if like and len(turns) <= 1:
        yield tuple(like)
    if turns and len(like) == 1:
        yield (replace(turns[0], point_m=_centre(start, positions, turned)),)
    line = _direction(positions - np.asarray(start.position_m))
    yield (_motion("translate", line, like),)
    axis = _direction((turned[1:] * turned[:-1].inv()).as_rotvec())
    yield (_motion("rotate", axis, like, point_m=_centre(start, positions, turned)),)
    ways = tuple(_motion("translate", way, like) for way in _basis(like))
    yield (_motion("rotate", axis, like, point_m=start.position_m), *ways)
    order = min(TURN_ORDERS, key=lambda order: _steepness(turned, order))
    if _steepness(turned, order) < STEEP_RAD:
        units = np.eye(3)[list(order)]
        yield (*(_motion("rotate", unit, like, point_m=start.position_m) for unit in units), *ways)


def _motion(
    kind: Literal["translate", "rotate"],
    axis: NDArray[np.float64],
    like: Sequence[DriverMotion],
    point_m: Vector = (0.0, 0.0, 0.0),
) -> DriverMotion:
    """A motion along an axis, with the axis and rate of action of the one of `like` that is along it too."""
    x, y, z = axis.tolist()
    own = DriverMotion(kind=kind, axis=(x, y, z), profiles=(), point_m=point_m)
    for motion in like:
        if motion.kind == kind and np.linalg.norm(np.cross(motion.axis, axis)) < SAME_POSE:
            return replace(own, axis=motion.axis, residual_rate=motion.residual_rate)
    return own


def _direction(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector along which vectors lie, its largest component positive; shape [3]."""
    axis: NDArray[np.float64] = np.linalg.svd(vectors)[2][0]
    # What an axis of the world misses by rounding alone is that axis.
    axis = np.where(np.abs(axis) < SAME_POSE, 0.0, axis)
    return axis / np.linalg.norm(axis) * np.sign(axis[np.argmax(np.abs(axis))])


def _basis(like: Sequence[DriverMotion]) -> NDArray[np.float64]:
    """Three orthogonal directions, those of the translations of `like` among them; the world's where these are not."""
    ways = np.array([motion.axis for motion in like if motion.kind == "translate"]).reshape(-1, 3)
    if not len(ways) or np.abs(ways @ ways.T - np.eye(len(ways))).max() > SAME_POSE:
        return np.eye(3)
    rest = np.eye(3) - ways.T @ ways
    others = np.linalg.svd(rest)[2][: 3 - len(ways)]
    return np.concatenate([ways, others])


def _centre(start: Pose, positions: NDArray[np.float64], turned: Rotation) -> Vector:
    """The point about which turns lead from the start to positions, as nearly as one does; the nearest such point."""
    matrices = np.eye(3) - turned.as_matrix()
    arm = np.linalg.lstsq(matrices.reshape(-1, 3), (positions - start.position_m).ravel(), rcond=1e-9)[0]
    x, y, z = (start.position_m + arm).tolist()
    return x, y, z


def _steepness(turned: Rotation, order: tuple[int, int, int]) -> float:
    """Largest second angle of three successive turns about world axes [rad]."""
    matrices = turned.as_matrix()
    first, _, last = order
    return float(np.arcsin(np.clip(np.abs(matrices[:, last, first]), 0.0, 1.0)).max())


def motion_coordinates(
    motions: Sequence[DriverMotion], start_m: ArrayLike, positions_m: NDArray[np.float64], turned: Rotation
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Invert `Driver.pose`: coordinates whose poses are nearest to given ones, sample by sample.

    Args:
        motions: Motions with no rotation, one, or three about the body's origin that come before all else.
        start_m: Position before anything moves [m], shape [3].
        positions_m: Positions [m], shape [sample_count, 3].
        turned: Rotations since the start, less than half a turn apart, sample_count of them.

    Returns:
        Coordinates [m or rad], shape [sample_count, motion_count]; the distance [m] and the angle [rad] that they leave
        out, shape [sample_count] each.
    """
    values = np.zeros((len(positions_m), len(motions)))
    turns = [index for index, motion in enumerate(motions) if motion.kind == "rotate"]
    arm = np.asarray(start_m)
    made = Rotation.identity(len(positions_m))
    if len(turns) == 1:
        axis, point = np.asarray(motions[turns[0]].axis), np.asarray(motions[turns[0]].point_m)
        since = turned.as_quat()
        # q and -q are one rotation, so the angle is known up to whole turns.
        values[:, turns[0]] = np.unwrap(2.0 * np.arctan2(since[:, :3] @ axis, since[:, 3]))
        made = Rotation.from_rotvec(values[:, turns] * axis)
        missing = positions_m - made.apply(arm - point) - point
    else:
        if turns:
            letters = "".join("xyz"[int(np.argmax(np.abs(motions[index].axis)))] for index in turns)
            signs = [float(np.sum(motions[index].axis)) for index in turns]
            values[:, turns] = np.unwrap(turned.as_euler(letters), axis=0) * signs
            made = turned
        missing = positions_m - arm
    ways = [index for index, motion in enumerate(motions) if motion.kind == "translate"]
    if ways:
        columns = np.empty((len(positions_m), 3, len(ways)))
        for column, index in enumerate(ways):
            axis = np.asarray(motions[index].axis)
            # What is moved before the turn is turned along.
            columns[:, :, column] = made.apply(axis) if turns and index < turns[0] else axis
        values[:, ways] = (np.linalg.pinv(columns) @ missing[:, :, None])[:, :, 0]
        missing = missing - (columns @ values[:, ways, None])[:, :, 0]
    return values, np.linalg.norm(missing, axis=1), (turned * made.inv()).magnitude()


def _reproduces(
    motions: tuple[DriverMotion, ...], start: Pose, times_s: Sequence[float], poses: Sequence[Pose]
) -> bool:
    driver = Driver(body="", motions=motions, provenance="")
    return all(pose_distance(driver.pose(start, t), pose) <= SAME_POSE for t, pose in zip(times_s, poses, strict=True))


def pose_distance(one: Pose, other: Pose) -> float:
    """The larger of the distance of two poses' origins [m] and of the angle between them [rad], small ones exact."""
    apart = np.linalg.norm(np.subtract(one.position_m, other.position_m))
    # Of the two quaternions of a rotation the nearer one; an arc cosine would lose half the digits.
    chord = min(np.linalg.norm(np.subtract(one.quaternion, np.multiply(s, other.quaternion))) for s in (1.0, -1.0))
    return float(max(apart, 2.0 * chord))
