"""Intervals of identified numbers: of the least squares, and of the next file; and what logs do not tell apart."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.identify.identified import Setting
from gauge_envs.tools.identify.problem import UNBOUNDED, Problem
from gauge_envs.tools.identify.rig import OFFSET, SERVO
from gauge_envs.tools.identify.spread import (
    NORMAL_95,
    pattern,
    sensor_noise_rad,
    spread_of,
)
from gauge_envs.tools.identify.stages import Fit

ZERO = "0 is in the interval"

SCALE = "only ratios of torques are told: a weight, a known armature or a known kp would tell their scale"

NOTHING = "no angle depends on it"

UNTOLD = 10.0
"""Standard error of a file's number, over its value in all files, from which the file tells nothing about it."""

FEWEST_FILES = 2
"""Number of files whose spread is too uncertain to leave a number out."""

ZERO_NEXT = "0 is in the interval of the next file"

TRADE = 0.9
"""Correlation from which two numbers are printed as a group."""

ALIKE = 0.98
"""Correlation from which the data does not tell two parameters apart."""


def settings_of(
    problem: Problem, unknowns: FloatArray, covariance: FloatArray
) -> tuple[Setting, ...]:
    """Return the numbers of all joints with their intervals of least squares, and why some are undetermined."""
    std = np.sqrt(np.diag(covariance))
    found = []
    for joint in range(problem.joints):
        alike = _correlations(problem, covariance, joint)
        is_free = np.isnan(problem.fixed[:, joint])
        # A number at 0 tells nothing about a scale.
        is_free &= unknowns[joint :: problem.joints][: is_free.size] > 0.0
        torques = [
            kind
            for kind, name in enumerate(problem.names)
            if is_free[kind] and name not in (SERVO[2], OFFSET)
        ]
        is_scale = len(torques) > 2 and bool(
            (alike[np.ix_(torques, torques)] > ALIKE).all()
        )
        for kind, name in enumerate(problem.names):
            column = kind * problem.joints + joint
            value = unknowns[column] - problem.shifts[kind, 0]
            half = NORMAL_95 * std[column]
            twins = [
                other
                for k, other in enumerate(problem.names)
                if k != kind and abs(alike[kind, k]) > ALIKE
            ]
            unknown = (
                f"goes with {' and '.join(twins)}"
                if twins and half > 0.1 * abs(value)
                else ""
            )
            if is_scale and unknown and kind in torques:
                unknown = SCALE
            is_known = not np.isnan(problem.fixed[kind, joint])
            if is_known:
                unknown, half = "", 0.0
                value = problem.fixed[kind, joint] / problem.sizes[kind, joint]
            elif std[column] >= UNBOUNDED:
                unknown, half = unknown or NOTHING, max(half, abs(value))
            elif not unknown and half >= abs(value):
                unknown = ZERO
            size = problem.sizes[kind, joint]
            low, high = (value - half) * size, (value + half) * size
            low = low if name == OFFSET else max(low, 0.0)
            found.append(
                Setting(
                    joint=joint,
                    joint_name="",
                    name=name,
                    value=value * size,
                    low=low,
                    high=high,
                    std=std[column] * size,
                    is_known=is_known,
                    unknown=unknown,
                )
            )
    return tuple(found)


def _correlations(problem: Problem, covariance: FloatArray, joint: int) -> FloatArray:
    """Return the correlations of the numbers of a joint, shape [name_count, name_count]."""
    columns = np.arange(len(problem.names)) * problem.joints + joint
    block = covariance[np.ix_(columns, columns)]
    sizes = np.sqrt(np.diag(block))
    return np.asarray(block / np.maximum(np.outer(sizes, sizes), 1e-300))


def with_load_error(
    settings: Sequence[Setting], load_error: float
) -> tuple[Setting, ...]:
    """Return settings whose interval of least squares holds the uncertainty of the load too."""
    found = []
    for one in settings:
        if one.is_known or one.name in (SERVO[2], OFFSET):
            found.append(one)
            continue
        half = np.hypot(one.high - one.value, NORMAL_95 * load_error * one.value)
        found.append(
            replace(one, low=max(one.value - half, 0.0), high=one.value + half)
        )
    return tuple(found)


def between_files(
    settings: Sequence[Setting], alone: Sequence[Fit], load_error: float
) -> tuple[Setting, ...]:
    """Return settings with the spread of the fits to single logs; those whose next value may be 0 are undetermined."""
    if not alone:
        return tuple(settings)
    files = [settings_of(one.problem, one.unknowns, one.covariance) for one in alone]
    found = []
    for row, one in enumerate(settings):
        values = np.array([file[row].value for file in files])
        stds = np.array([file[row].std for file in files])
        is_determined = stds < UNTOLD * abs(one.value)
        is_determined &= [file[row].unknown != NOTHING for file in files]
        if is_determined.sum() > 1:
            values, stds = values[is_determined], stds[is_determined]
        if one.is_known or not np.isfinite(stds).all():
            found.append(one)
            continue
        is_torque = one.name not in (SERVO[2], OFFSET)
        least = -np.inf if one.name == OFFSET else 0.0
        spread = spread_of(values, stds, load_error if is_torque else 0.0, least)
        unknown = one.unknown
        is_open = spread.low <= 0.0 <= spread.high and len(alone) > FEWEST_FILES
        if not unknown and is_open and one.name != SERVO[2]:
            unknown = ZERO_NEXT
        found.append(
            replace(
                one,
                of_files=tuple(values.tolist()),
                of_files_std=tuple(stds.tolist()),
                next_low=spread.low,
                next_high=spread.high,
                between=spread.between,
                unknown=unknown,
            )
        )
    return tuple(found)


def sensor_noise_of(problem: Problem, unknowns: FloatArray) -> FloatArray:
    """Return the sensor's noise of each joint, the median of the parts [rad], shape [J]."""
    errors = problem.errors(unknowns)
    return np.median(
        [[sensor_noise_rad(column) for column in one.T] for one in errors], axis=0
    )


def patterns_of(problem: Problem, unknowns: FloatArray) -> dict[str, tuple[str, ...]]:
    """Return what the residual of each log looks like, by joint; of several parts the first."""
    found: dict[str, tuple[str, ...]] = {}
    for errors, part in zip(problem.errors(unknowns), problem.parts, strict=True):
        looks = tuple(
            pattern(part.times_s, angles, column)
            for angles, column in zip(
                (part.position_rad + errors).T, errors.T, strict=True
            )
        )
        found.setdefault(part.name.split(", part ")[0], looks)
    return found


def trades_of(
    problem: Problem, covariance: FloatArray, joints: Sequence[str]
) -> tuple[str, ...]:
    """Return which numbers of a joint the logs hardly tell apart: a sentence for each pair."""
    found = []
    for joint, word in enumerate(joints):
        alike = _correlations(problem, covariance, joint)
        for first, second in zip(*np.triu_indices(len(alike), 1), strict=True):
            if abs(alike[first, second]) > TRADE:
                pair = f"{problem.names[first]} and {problem.names[second]}"
                found.append(
                    f"{word}: {pair} trade, correlation {alike[first, second]:.2f}"
                )
    return tuple(found)


def errors_of_step(problem: Problem, unknowns: FloatArray) -> FloatArray:
    """Return by what the logs move with half the step of the engine, root mean square [rad], shape [J]."""
    half = problem.machine.with_step(0.5 * problem.machine.timestep_s)
    errors, finer = (
        np.concatenate(replace(problem, machine=one).errors(unknowns, may_diverge=True))
        for one in (problem.machine, half)
    )
    return np.sqrt(((finer - errors) ** 2).mean(axis=0))


def errors_of_logs(problem: Problem, unknowns: FloatArray) -> dict[str, FloatArray]:
    """Return the root mean square error of each log [rad], over its parts."""
    squares: dict[str, list[FloatArray]] = {}
    for errors, part in zip(problem.errors(unknowns), problem.parts, strict=True):
        squares.setdefault(part.name.split(", part ")[0], []).append(errors**2)
    return {
        name: np.sqrt(np.concatenate(parts).mean(axis=0))
        for name, parts in squares.items()
    }
