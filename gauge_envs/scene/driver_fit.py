"""Fit of driver motions to sampled poses, and coordinates of poses along given motions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ShapeError
from gauge_envs.scene.drivers import DriverMotion
from gauge_envs.scene.geometry import FloatArray, Pose, vector
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

    They are the motions `like`, with their actions, if these reproduce the poses. Otherwise, they are rotations about
    the body's origin, one if the axis is fixed and else three, followed by translations along the world axes.

    Args:
        start: Pose of the body before anything moves.
        times_s: Two or more strictly increasing times [s], shape [sample_count].
        poses: World poses at these times.
        like: Motions to keep if possible; their profiles are replaced.

    Returns:
        The motions; empty if the body stays at its start.
    """
    positions_m = np.array([pose.position_m for pose in poses])
    quaternions = [pose.quaternion for pose in poses]
    rotations = Rotation.from_quat(quaternions, scalar_first=True)
    rotations *= start.rotation.inv()
    for template in _templates(start, rotations, like):
        values, missed_m, missed_rad = motion_coordinates(
            template, start.position_m, positions_m, rotations
        )
        if max(missed_m.max(), missed_rad.max()) <= SAME_POSE:
            return tuple(
                replace(motion, profiles=(_profile(times_s, column),))
                for motion, column in zip(template, values.T, strict=True)
                if np.abs(column).max() > SAME_POSE or motion.residual_rate
            )
    raise ShapeError(
        "no three successive rotations describe its rotation: keep it closer to a rotation about a fixed axis"
    )


def _profile(times_s: Sequence[float], values: FloatArray) -> SampledProfile:
    return SampledProfile(times_s=tuple(times_s), values=tuple(values.tolist()))


def _templates(
    start: Pose, rotations: Rotation, like: Sequence[DriverMotion]
) -> Iterator[tuple[DriverMotion, ...]]:
    """Yield candidate sets of motions, simple ones first; their profiles are not fitted yet."""
    if like and [motion.kind for motion in like].count("rotate") <= 1:
        yield tuple(like)
    choices = [_common_axis(rotations)[None]]
    order = min(permutations(range(3)), key=lambda order: _steepness(rotations, order))
    if _steepness(rotations, order) < STEEP_RAD:
        choices.append(np.eye(3)[list(order)])
    for axes in choices:
        turns = (
            DriverMotion(
                kind="rotate",
                axis=vector(axis),
                point_m=start.position_m,
                profiles=(),
            )
            for axis in axes
        )
        shifts = (
            DriverMotion(kind="translate", axis=vector(axis), profiles=())
            for axis in np.eye(3)
        )
        yield (*turns, *shifts)


def _common_axis(rotations: Rotation) -> FloatArray:
    """Return the axis of successive rotations, if they have one, with a positive largest component, shape [3]."""
    steps_rad = (rotations[1:] * rotations[:-1].inv()).as_rotvec()
    axis: FloatArray = np.linalg.svd(steps_rad)[2][0]
    # Remove the rounding error of directions along a world axis.
    axis = np.where(np.abs(axis) < SAME_POSE, 0.0, axis)
    return axis / np.linalg.norm(axis) * np.sign(axis[np.argmax(np.abs(axis))])


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
    kinds = np.array([motion.kind for motion in motions])
    axes = np.array([motion.axis for motion in motions])
    rotary = np.flatnonzero(kinds == "rotate")
    linear = np.flatnonzero(kinds == "translate")
    made = Rotation.identity(len(positions_m))
    missing_m = positions_m - np.asarray(start_m)
    if len(rotary) == 1:
        axis, point_m = axes[rotary[0]], np.asarray(motions[rotary[0]].point_m)
        since = rotations.as_quat()
        # q and -q are one rotation, so the angle is known up to multiples of 360 degrees.
        half_rad = np.arctan2(since[:, :3] @ axis, since[:, 3])
        values[:, rotary[0]] = np.unwrap(2.0 * half_rad)
        made = Rotation.from_rotvec(values[:, rotary] * axis)
        missing_m = positions_m - made.apply(start_m - point_m) - point_m
    elif len(rotary):
        letters = "".join("xyz"[number] for number in np.abs(axes[rotary]).argmax(1))
        angles_rad = np.unwrap(rotations.as_euler(letters), axis=0)
        values[:, rotary] = angles_rad * axes[rotary].sum(axis=1)
        made = rotations
    if len(linear):
        columns = np.empty((len(positions_m), 3, len(linear)))
        for column, index in enumerate(linear):
            # The rotation also rotates the translations that precede it.
            is_rotated = len(rotary) and index < rotary[0]
            columns[:, :, column] = (
                made.apply(axes[index]) if is_rotated else axes[index]
            )
        values[:, linear] = (np.linalg.pinv(columns) @ missing_m[:, :, None])[:, :, 0]
        missing_m = missing_m - (columns @ values[:, linear, None])[:, :, 0]
    missed_rad = (rotations * made.inv()).magnitude()
    return values, np.linalg.norm(missing_m, axis=1), missed_rad
