"""Motions of a driver from sampled poses, and coordinates of poses along the motions of a driver."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError
from gauge_envs.scene.drivers import Driver, DriverMotion, SampledProfile
from gauge_envs.scene.geometry import Pose, Vector, pose_distance

__all__ = [
    "motion_coordinates",
    "sampled_motions",
]


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
    rotations = Rotation.from_quat([pose.quaternion for pose in poses], scalar_first=True) * start.rotation.inv()
    for template in _templates(start, positions, rotations, like):
        values, _, _ = motion_coordinates(template, start.position_m, positions, rotations)
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
    start: Pose, positions: NDArray[np.float64], rotations: Rotation, like: Sequence[DriverMotion]
) -> Iterator[tuple[DriverMotion, ...]]:
    """Sets of motions that may lead through poses, simple ones first; their profiles are still those of `like`."""
    rotary = [motion for motion in like if motion.kind == "rotate"]
    if like and len(rotary) <= 1:
        yield tuple(like)
    if rotary and len(like) == 1:
        yield (replace(rotary[0], point_m=_centre(start, positions, rotations)),)
    line = _direction(positions - np.asarray(start.position_m))
    yield (_motion("translate", line, like),)
    axis = _direction((rotations[1:] * rotations[:-1].inv()).as_rotvec())
    yield (_motion("rotate", axis, like, point_m=_centre(start, positions, rotations)),)
    linear = tuple(_motion("translate", axis, like) for axis in _basis(like))
    yield (_motion("rotate", axis, like, point_m=start.position_m), *linear)
    order = min(TURN_ORDERS, key=lambda order: _steepness(rotations, order))
    if _steepness(rotations, order) < STEEP_RAD:
        units = np.eye(3)[list(order)]
        yield (*(_motion("rotate", unit, like, point_m=start.position_m) for unit in units), *linear)


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
    linear = np.array([motion.axis for motion in like if motion.kind == "translate"]).reshape(-1, 3)
    if not len(linear) or np.abs(linear @ linear.T - np.eye(len(linear))).max() > SAME_POSE:
        return np.eye(3)
    rest = np.eye(3) - linear.T @ linear
    others = np.linalg.svd(rest)[2][: 3 - len(linear)]
    return np.concatenate([linear, others])


def _centre(start: Pose, positions: NDArray[np.float64], rotations: Rotation) -> Vector:
    """The point about which turns lead from the start to positions, as nearly as one does; the nearest such point."""
    matrices = np.eye(3) - rotations.as_matrix()
    arm = np.linalg.lstsq(matrices.reshape(-1, 3), (positions - start.position_m).ravel(), rcond=1e-9)[0]
    x, y, z = (start.position_m + arm).tolist()
    return x, y, z


def _steepness(rotations: Rotation, order: tuple[int, int, int]) -> float:
    """Largest second angle of three successive turns about world axes [rad]."""
    matrices = rotations.as_matrix()
    first, _, last = order
    return float(np.arcsin(np.clip(np.abs(matrices[:, last, first]), 0.0, 1.0)).max())


def motion_coordinates(
    motions: Sequence[DriverMotion], start_m: ArrayLike, positions_m: NDArray[np.float64], rotations: Rotation
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Invert `Driver.pose`: coordinates whose poses are nearest to given ones, sample by sample.

    Args:
        motions: Motions with no rotation, one, or three about the body's origin that come before all else.
        start_m: Position before anything moves [m], shape [3].
        positions_m: Positions [m], shape [sample_count, 3].
        rotations: Rotations since the start, less than half a turn apart, sample_count of them.

    Returns:
        Coordinates [m or rad], shape [sample_count, motion_count]; the distance [m] and the angle [rad] that they leave
        out, shape [sample_count] each.
    """
    values = np.zeros((len(positions_m), len(motions)))
    rotary = [index for index, motion in enumerate(motions) if motion.kind == "rotate"]
    arm = np.asarray(start_m)
    made = Rotation.identity(len(positions_m))
    if len(rotary) == 1:
        axis, point = np.asarray(motions[rotary[0]].axis), np.asarray(motions[rotary[0]].point_m)
        since = rotations.as_quat()
        # q and -q are one rotation, so the angle is known up to whole turns.
        values[:, rotary[0]] = np.unwrap(2.0 * np.arctan2(since[:, :3] @ axis, since[:, 3]))
        made = Rotation.from_rotvec(values[:, rotary] * axis)
        missing = positions_m - made.apply(arm - point) - point
    else:
        if rotary:
            letters = "".join("xyz"[int(np.argmax(np.abs(motions[index].axis)))] for index in rotary)
            signs = [float(np.sum(motions[index].axis)) for index in rotary]
            values[:, rotary] = np.unwrap(rotations.as_euler(letters), axis=0) * signs
            made = rotations
        missing = positions_m - arm
    linear = [index for index, motion in enumerate(motions) if motion.kind == "translate"]
    if linear:
        columns = np.empty((len(positions_m), 3, len(linear)))
        for column, index in enumerate(linear):
            axis = np.asarray(motions[index].axis)
            # What is moved before the turn is rotations along.
            columns[:, :, column] = made.apply(axis) if rotary and index < rotary[0] else axis
        values[:, linear] = (np.linalg.pinv(columns) @ missing[:, :, None])[:, :, 0]
        missing = missing - (columns @ values[:, linear, None])[:, :, 0]
    return values, np.linalg.norm(missing, axis=1), (rotations * made.inv()).magnitude()


def _reproduces(
    motions: tuple[DriverMotion, ...], start: Pose, times_s: Sequence[float], poses: Sequence[Pose]
) -> bool:
    driver = Driver(body="", motions=motions, provenance="")
    return all(pose_distance(driver.pose(start, t), pose) <= SAME_POSE for t, pose in zip(times_s, poses, strict=True))
