"""Fit of driver motions to sampled poses, and coordinates of poses along given motions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import FloatArray, Pose, Vector, pose_distance, vector
from gauge_envs.scene.profiles import SampledProfile

SAME_POSE = 1e-9
"""Largest distance between sampled poses and those of the fitted motions [m, rad]."""

STEEP_RAD = np.radians(85.0)
"""Largest second angle of three successive rotations [rad]; at 90 degrees (gimbal lock) they are ambiguous."""


def sampled_motions(
    start: Pose,
    times_s: Sequence[float],
    poses: Sequence[Pose],
    *,
    like: Sequence[DriverMotion] = (),
) -> tuple[DriverMotion, ...]:
    """Return motions with sampled profiles that reproduce poses within 1e-9 m and rad.

    The result is the first of the following that reproduces the poses:

    1. the motions `like`;
    2. if `like` is a single rotation, a rotation about its axis through another point;
    3. a translation along a line;
    4. a rotation about a fixed axis;
    5. rotations about the body's origin, followed by translations.

    Motions along an axis of `like` keep the axis and the action's rate of the motion in `like`.

    Args:
        start: Pose of the body before anything moves.
        times_s: Two or more strictly increasing times [s], shape [sample_count].
        poses: World poses at these times.
        like: Motions to keep as far as possible; their profiles are replaced.

    Returns:
        The motions; empty if the body stays at its start.
    """
    if (
        len(times_s) != len(poses)
        or len(times_s) < 2
        or not np.all(np.diff(times_s) > 0.0)
    ):
        raise ShapeError(
            "times and poses do not match: give one pose for each of two or more increasing times"
        )
    positions = np.array([pose.position_m for pose in poses])
    rotations = (
        Rotation.from_quat([pose.quaternion for pose in poses], scalar_first=True)
        * start.rotation.inv()
    )
    for template in _templates(start, positions, rotations, like):
        values, _, _ = motion_coordinates(
            template, start.position_m, positions, rotations
        )
        motions = tuple(
            replace(
                motion,
                profiles=(
                    SampledProfile(times_s=tuple(times_s), values=tuple(column)),
                ),
            )
            for motion, column in zip(template, values.T.tolist(), strict=True)
        )
        driver = Driver(body="", motions=motions, provenance="")
        if all(
            pose_distance(driver.pose(start, t), pose) <= SAME_POSE
            for t, pose in zip(times_s, poses, strict=True)
        ):
            if template == tuple(like):
                return motions
            # Actions are part of the largest rate.
            return tuple(
                motion
                for motion in motions
                if motion.largest_rate > 0.0 or abs(motion.value(0.0)) > SAME_POSE
            )
    raise ShapeError(
        "no three successive rotations describe its rotation: keep it closer to a rotation about a fixed axis"
    )


def _templates(
    start: Pose,
    positions: FloatArray,
    rotations: Rotation,
    like: Sequence[DriverMotion],
) -> Iterator[tuple[DriverMotion, ...]]:
    """Yield candidate sets of motions, simple ones first; their profiles are not fitted yet."""
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
    order = min(permutations(range(3)), key=lambda order: _steepness(rotations, order))
    if _steepness(rotations, order) < STEEP_RAD:
        units = np.eye(3)[list(order)]
        yield (
            *(
                _motion("rotate", unit, like, point_m=start.position_m)
                for unit in units
            ),
            *linear,
        )


def _motion(
    kind: Literal["translate", "rotate"],
    axis: FloatArray,
    like: Sequence[DriverMotion],
    point_m: Vector = (0.0, 0.0, 0.0),
) -> DriverMotion:
    """Return a motion along an axis; a parallel motion of `like` determines its exact axis and the action's rate."""
    derived = DriverMotion(kind=kind, axis=vector(axis), profiles=(), point_m=point_m)
    for motion in like:
        if (
            motion.kind == kind
            and np.linalg.norm(np.cross(motion.axis, axis)) < SAME_POSE
        ):
            return replace(
                derived, axis=motion.axis, residual_rate=motion.residual_rate
            )
    return derived


def _direction(vectors: FloatArray) -> FloatArray:
    """Return the unit vector along which vectors lie, with a positive largest component, shape [3]."""
    axis: FloatArray = np.linalg.svd(vectors)[2][0]
    # Remove the rounding error of directions along a world axis.
    axis = np.where(np.abs(axis) < SAME_POSE, 0.0, axis)
    return axis / np.linalg.norm(axis) * np.sign(axis[np.argmax(np.abs(axis))])


def _basis(like: Sequence[DriverMotion]) -> FloatArray:
    """Return three orthogonal directions that include the translations of `like`, or the world axes if impossible."""
    linear = np.array(
        [motion.axis for motion in like if motion.kind == "translate"]
    ).reshape(-1, 3)
    if (
        not len(linear)
        or np.abs(linear @ linear.T - np.eye(len(linear))).max() > SAME_POSE
    ):
        return np.eye(3)
    rest = np.eye(3) - linear.T @ linear
    orthogonal = np.linalg.svd(rest)[2][: 3 - len(linear)]
    return np.concatenate([linear, orthogonal])


def _centre(start: Pose, positions: FloatArray, rotations: Rotation) -> Vector:
    """Return the centre of rotation from the start to positions, in the least-squares sense, closest to the start."""
    matrices = np.eye(3) - rotations.as_matrix()
    arm = np.linalg.lstsq(
        matrices.reshape(-1, 3), (positions - start.position_m).ravel(), rcond=1e-9
    )[0]
    return vector(start.position_m + arm)


def _steepness(rotations: Rotation, order: tuple[int, ...]) -> float:
    """Return the largest second angle of three successive rotations about world axes [rad]."""
    matrices = rotations.as_matrix()
    first, _, last = order
    return float(np.arcsin(np.clip(np.abs(matrices[:, last, first]), 0.0, 1.0)).max())


def motion_coordinates(
    motions: Sequence[DriverMotion],
    start_m: ArrayLike,
    positions_m: FloatArray,
    rotations: Rotation,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the coordinates whose poses are closest to given poses, the inverse of `Driver.pose`.

    Args:
        motions: Motions with no rotation, with one rotation, or with three rotations about the body's origin that
            precede all translations.
        start_m: Position before anything moves [m], shape [3].
        positions_m: Positions [m], shape [sample_count, 3].
        rotations: Rotations since the start, sample_count of them, successive ones less than 180 degrees apart.

    Returns:
        Coordinates [m or rad], shape [sample_count, motion_count], and the residual distance [m] and angle [rad] of
        each sample, both of shape [sample_count].
    """
    values = np.zeros((len(positions_m), len(motions)))
    rotary = [index for index, motion in enumerate(motions) if motion.kind == "rotate"]
    arm = np.asarray(start_m)
    made = Rotation.identity(len(positions_m))
    if len(rotary) == 1:
        axis, point = (
            np.asarray(motions[rotary[0]].axis),
            np.asarray(motions[rotary[0]].point_m),
        )
        since = rotations.as_quat()
        # q and -q are one rotation, so the angle is known up to multiples of 360 degrees.
        values[:, rotary[0]] = np.unwrap(
            2.0 * np.arctan2(since[:, :3] @ axis, since[:, 3])
        )
        made = Rotation.from_rotvec(values[:, rotary] * axis)
        missing = positions_m - made.apply(arm - point) - point
    else:
        if rotary:
            letters = "".join(
                "xyz"[int(np.argmax(np.abs(motions[index].axis)))] for index in rotary
            )
            signs = [float(np.sum(motions[index].axis)) for index in rotary]
            values[:, rotary] = np.unwrap(rotations.as_euler(letters), axis=0) * signs
            made = rotations
        missing = positions_m - arm
    linear = [
        index for index, motion in enumerate(motions) if motion.kind == "translate"
    ]
    if linear:
        columns = np.empty((len(positions_m), 3, len(linear)))
        for column, index in enumerate(linear):
            axis = np.asarray(motions[index].axis)
            # The rotation also rotates the translations that precede it.
            columns[:, :, column] = (
                made.apply(axis) if rotary and index < rotary[0] else axis
            )
        values[:, linear] = (np.linalg.pinv(columns) @ missing[:, :, None])[:, :, 0]
        missing = missing - (columns @ values[:, linear, None])[:, :, 0]
    return values, np.linalg.norm(missing, axis=1), (rotations * made.inv()).magnitude()
