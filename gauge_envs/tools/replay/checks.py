"""Checks of a log before anything is fitted: each corrects what it can, and names what was wrong."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import compress, product
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.integrate import cumulative_simpson, cumulative_trapezoid
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from gauge_envs.errors import FileError
from gauge_envs.names import first_names
from gauge_envs.tools.replay.log import (
    MIN_NOISE,
    MIN_RATE_NOISE,
    NOISE_WINDOW,
    SAMPLED,
    BoolArray,
    FloatArray,
    Log,
    best_columns,
    noise_of,
)

MIN_SAMPLES = 20
MAX_INTERVAL_S = 1.0
MIN_JUMP = 0.02
"""Second difference of positions at a lost sample [rad or m]."""
TURN_S = 0.2
"""Time over which the motion of the base is compared with its velocities."""
MAX_MISFIT = 0.3
"""Squared difference of the motion and the integrated velocities, over the squared motion."""
SURE = 4.0
"""Relative difference of two mean squared errors that is significant in a log of length TURN_S; it decreases with the
length."""
LOST_STEP = 1.5
"""Step after repeated rows, over an ordinary one, from which on they were lost; an encoder of low resolution has 1."""
MAX_RATE_RATIO = 1.5
"""Ratio of velocities and slopes from which on the unit or clock is wrong; motion too fast for the log has less."""
UPRIGHT = {
    up: Rotation.from_euler(axis, angle, degrees=True)
    for up, axis, angle in (
        ("z", "x", 0),
        ("y", "x", 90),
        ("-y", "x", -90),
        ("x", "y", -90),
        ("-x", "y", 90),
        ("-z", "x", 180),
    )
}
"""Rotation that turns each axis that may be up to z."""
MAX_LATE = 0.4
"""Squared difference of velocities and slopes with velocities of a neighbouring row, over that of their own."""
RATE_UNITS = {
    "deg/s": np.rad2deg(1.0),
    "turns/s": 0.5 / np.pi,
    "rpm": 30.0 / np.pi,
    "rad/s, and positions in deg": np.deg2rad(1.0),
}
"""Units of velocities, over that of the slopes of the positions."""
BASE_MISTAKES = (
    "base_quat is x y z w: it is turned to w x y z",
    "base_linvel is in the body frame: it is turned",
    "base_angvel is in the world frame: it is turned",
)
NEIGHBOURS = 9
"""Ordinary steps around a repeated row with which the step after it is compared."""
MIN_REGULAR = 0.7
"""Fraction of equal runs of samples from which on the encoder is slower than the log."""


def check_log(log: Log) -> None:
    """Correct a log, and add its mistakes and what it does not tell.

    Raises:
        FileError: The log has too few rows with numbers, or times that are no clock.
    """
    for check in CHECKS:
        log.mistakes += check(log)
    log.findings += _unknown(log)


def _check_numbers(log: Log) -> Iterator[str]:
    """Leave out rows without numbers; raise an error if few are left, or if the times are no clock in seconds."""
    # A lost sample may have a quaternion of zeros.
    log.base_pose[~log.base_pose[:, 3:].any(axis=1), 3:] = np.nan
    is_given = np.isfinite(np.column_stack([log.command_time_s, log.command])).all(
        axis=1
    )
    log.command_time_s = log.command_time_s[is_given]
    log.command = log.command[is_given]
    for name in SAMPLED:
        values = np.column_stack([getattr(log, name)])
        is_whole = np.isfinite(values).all(axis=1)
        log.keep(is_whole)
        if not is_whole.all():
            yield f"rows without a number of {name} are left out: {sum(~is_whole)}"
        if len(log.time_s) < MIN_SAMPLES:
            reason = f"{sum(is_whole)} rows with numbers; a log needs {MIN_SAMPLES}"
            raise FileError(log.name, name, reason)
    yield from _time_unit(log)
    steps = np.diff(log.time_s)
    if steps.min() <= 0.0 or log.interval_s >= MAX_INTERVAL_S:
        place = f"time {log.time_s[np.argmin(steps)]:g}"
        reason = (
            f"the next time is {steps.min():g} s later; sort the rows, and give seconds"
        )
        raise FileError(log.name, place, reason)
    if not len(log.command) or (np.diff(log.command_time_s) <= 0.0).any():
        reason = "expected numbers at times that increase"
        raise FileError(log.name, log.command_kind or "time", reason)


def _time_unit(log: Log) -> Iterator[str]:
    """Bring times in ms, us or ns to seconds: the interval of a log is between 0.5 ms and 0.5 s."""
    for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if 5e-4 <= factor * log.interval_s < 0.5 and log.interval_s >= MAX_INTERVAL_S:
            log.time_s = factor * (log.time_s - log.time_s[0])
            log.command_time_s = factor * (log.command_time_s - log.command_time_s[0])
            yield f"times are in {unit}: they are converted"
            return


def _check_samples(log: Log) -> Iterator[str]:
    """Leave out samples that repeat the one before, lost ones that were written as 0, and spikes."""
    is_fresh = np.append(True, np.diff(log.position, axis=0).any(axis=1))
    fresh = np.flatnonzero(is_fresh)
    gaps = np.diff(fresh[1:])
    period = int(np.median(gaps)) if len(gaps) else 1
    if period > 1 and np.mean(np.abs(gaps - period) <= period // 4) > MIN_REGULAR:
        log.keep(fresh[1:])
        yield f"positions are held for {period} rows: the first of each is used"
    elif (lost := _held_rows(log, is_fresh)).any():
        log.keep(~lost)
        yield f"rows that repeat the position before while the robot moves are left out: {lost.sum()}"
    for find, words in (
        (_zero_rows, "lost samples, written as 0,"),
        (_spikes, "spikes"),
    ):
        is_gap = (
            np.diff(log.time_s, prepend=-np.inf, append=np.inf) > 3.0 * log.interval_s
        )
        rows = find(log) & ~is_gap[1:] & ~is_gap[:-1]
        if rows.any():
            first_s = log.time_s[np.argmax(rows)]
            yield f"{rows.sum()} {words} are left out, the first at {first_s:.3g} s"
            log.keep(~rows)


def _largest_bend(log: Log) -> FloatArray:
    """Return the largest second difference of positions without a jump, shape [J]."""
    bend = np.abs(np.diff(log.position, n=2, axis=0))
    return MIN_JUMP + 12.0 * np.median(bend, axis=0)


def _zero_rows(log: Log) -> BoolArray:
    """Return the rows of zeros between whose neighbours a joint is elsewhere."""
    is_zero = (log.position == 0.0).all(axis=1)
    others = np.flatnonzero(~is_zero)
    if not is_zero.any() or not len(others):
        return is_zero & False
    after = np.searchsorted(others, np.arange(len(is_zero)))
    ends = [others[(after + k).clip(0, len(others) - 1)] for k in (-1, 0)]
    bend = np.abs(log.position[ends[0]] + log.position[ends[1]])
    is_lost: BoolArray = (bend > _largest_bend(log)).any(axis=1)
    return is_zero & is_lost


def _spikes(log: Log) -> BoolArray:
    """Return the rows that leave both neighbours in a direction, and what the velocities say."""
    path = log.position
    if log.velocity.shape == path.shape:
        rest = path - cumulative_trapezoid(
            log.velocity, log.time_s, axis=0, initial=0.0
        )
        # Velocities of another joint or unit tell nothing.
        steps = [np.median(np.abs(np.diff(x, axis=0)), axis=0) for x in (rest, path)]
        path = np.where(steps[0] < 0.5 * steps[1], rest, path)
    bend = 2.0 * np.abs(path - median_filter(path, (3, 1)))
    rows: BoolArray = (bend > _largest_bend(log)).any(axis=1)
    return rows


def _held_rows(log: Log, is_fresh: BoolArray) -> BoolArray:
    """Return the rows that repeat the position before, if the robot has moved by more than a step after them."""
    step = np.abs(np.diff(log.position, axis=0)).sum(axis=1)
    held, fresh = (
        np.flatnonzero(before & is_fresh[1:])
        for before in (~is_fresh[:-1], is_fresh[:-1])
    )
    if not len(held) or not len(fresh):
        return ~is_fresh & False
    ordinary = np.interp(held, fresh, median_filter(step[fresh], NEIGHBOURS))
    return ~is_fresh & bool(np.mean(step[held]) > LOST_STEP * np.mean(ordinary))


def _check_wraps(log: Log) -> Iterator[str]:
    """Unwrap angles modulo 2 pi."""
    turns = np.unwrap(log.position, axis=0)
    # Angles in degrees jump too, but leave one turn.
    is_wrapped = (turns != log.position).any(axis=0)
    is_wrapped &= np.ptp(log.position, axis=0) < 2.0 * np.pi
    if is_wrapped.any():
        turns -= 2.0 * np.pi * np.round(np.median(turns, axis=0) / (2.0 * np.pi))
        log.position = np.where(is_wrapped, turns, log.position)
        yield "angles modulo 2 pi are unwrapped"


def _check_jitter(log: Log) -> Iterator[str]:
    """Replace stamps that jitter by regular ones where the motion is smoother with them."""
    steps = np.diff(log.time_s)
    if steps.max() > 3.0 * log.interval_s:
        return
    regular_s = np.linspace(log.time_s[0], log.time_s[-1], len(log.time_s))
    noise = noise_of(log.time_s, log.position).mean()
    if noise_of(regular_s, log.position).mean() < 0.9 * noise:
        log.command_time_s = np.interp(log.command_time_s, log.time_s, regular_s)
        log.time_s = regular_s
        yield f"stamps jitter by {1e3 * np.std(steps):.2g} ms, and the motion does not: samples are taken as regular"


def _check_velocity(log: Log) -> Iterator[str]:
    """Add noise levels, and velocities where the log has none; compare those that it has with the positions."""
    log.position_noise = np.maximum(noise_of(log.time_s, log.position), MIN_NOISE)
    if log.velocity.shape != log.position.shape:
        half = NOISE_WINDOW // 2
        slope = np.gradient(log.position, log.time_s, axis=0)
        log.velocity = np.where(_is_regular(log.time_s), _smooth_slope(log), slope)
        log.velocity_noise = 0.6 * log.position_noise / log.interval_s
        # A polynomial has no slope at its ends.
        log.keep(np.arange(len(slope))[half:-half])
        log.findings.append(
            "no velocities of all joints: differences of positions are used"
        )
        return
    yield from _check_rates(log)
    slope = np.gradient(log.position, log.time_s, axis=0)
    spread = 1.4826 * np.median(np.abs(log.velocity - slope), axis=0)
    noise = np.hypot(noise_of(log.time_s, log.velocity), 0.2 * spread)
    log.velocity_noise = np.maximum(noise, MIN_RATE_NOISE)


def _smooth_slope(log: Log) -> FloatArray:
    """Return the slopes of polynomials of degree 4 through seven samples, shape [N, J].

    They have 0.51 of the noise of a position over the interval, and central differences 0.71.
    """
    slopes = (
        savgol_filter(each, NOISE_WINDOW, 4, deriv=1, axis=0)
        for each in (log.position, log.time_s[:, None])
    )
    return np.divide(*slopes)


def _is_regular(time_s: FloatArray) -> BoolArray:
    """Return whether a sample is in the middle of seven with equal intervals, shape [N, 1]."""
    steps = sliding_window_view(np.diff(time_s), NOISE_WINDOW - 1)
    is_even = steps.max(axis=1) < 1.2 * steps.min(axis=1)
    return np.pad(is_even, NOISE_WINDOW // 2)[:, None]


def _check_rates(log: Log) -> Iterator[str]:
    """Bring velocities to the order, signs and unit of the slopes of the positions, where these are clear."""
    path = cumulative_simpson(log.velocity, x=log.time_s, axis=0, initial=0.0)
    length = min(1 + round(TURN_S / log.interval_s), len(path) // 2)
    moved, turned = (each[length:] - each[:-length] for each in (log.position, path))
    columns = np.arange(len(log.joints))
    # Noise moves a joint that rests.
    moves = np.std(moved, axis=0) > 8.0 * log.position_noise
    order, match = best_columns(moved, turned)
    best = np.abs(match[columns, order])
    exchanged = moves & (best > 0.9) & (np.abs(np.diag(match)) < best - 0.2)
    if exchanged.sum() > 1:
        order = np.where(exchanged, order, columns)
        pairs = ", ".join(
            f"{log.joints[k]} has that of {log.joints[order[k]]}"
            for k in columns[exchanged]
        )
        log.velocity, turned, match = (
            each[:, order] for each in (log.velocity, turned, match)
        )
        yield f"velocities are exchanged ({pairs}): they are put back"
    clear = moves & (np.abs(np.diag(match)) > 0.9)
    ratio = np.sum(moved * turned, axis=0) / np.maximum(np.sum(moved**2, axis=0), 1e-12)
    flipped = clear & (ratio < 0.0)
    if flipped.any():
        log.velocity[:, flipped] *= -1.0
        names = first_names([log.joints[k] for k in columns[flipped]])
        yield f"velocities of {names} have the opposite sign of the slope of the positions: it is turned"
    yield from _rate_unit(log, np.abs(ratio[clear]))
    yield from _late_rates(log)


def _late_rates(log: Log) -> Iterator[str]:
    """Bring velocities that are a row late or early to the slopes of the positions."""
    slope = np.gradient(log.position, log.time_s, axis=0)[2:-2]
    errors = {
        shift: np.mean((np.roll(log.velocity, -shift, axis=0)[2:-2] - slope) ** 2)
        for shift in (-1, 0, 1)
    }
    shift = min(errors, key=lambda row: errors[row])
    if errors[shift] < MAX_LATE * errors[0]:
        log.velocity = np.roll(log.velocity, -shift, axis=0)
        log.keep(np.arange(1, len(log.time_s) - 1))
        yield f"velocities are a row {'late' if shift > 0 else 'early'}: they are put back"


def _rate_unit(log: Log, ratio: FloatArray) -> Iterator[str]:
    """Bring velocities to the unit of the slopes, given their ratio."""
    if not len(ratio) or abs(np.log(np.median(ratio))) < np.log(MAX_RATE_RATIO):
        return
    for unit, factor in RATE_UNITS.items():
        if np.allclose(ratio, factor, rtol=0.15):
            log.velocity /= factor
            yield f"velocities are in {unit}, by the slope of the positions: they are converted"
            return
    log.is_usable = False
    yield (
        f"velocities are {np.median(ratio):.3g} times the slope of the positions: another unit, or the clock runs at "
        "another rate"
    )


def _base_readings(log: Log) -> Iterator[tuple[Any, ...]]:
    """Yield each order of quaternions, frame of angular and of linear velocities with its base.

    Yields:
        Misfit of the linear and the angular velocities to the pose, over the limit; order; what is wrong; pose and
        twist in the terms of a log; velocities that the pose shows.
    """
    position, quaternion = np.split(log.base_pose, [3], axis=1)
    # Without velocities, zeros are compared with the pose.
    linear, angular = np.hsplit(np.resize(log.base_twist, (len(position), 6)), 2)
    window = 1 + round(TURN_S / log.interval_s)

    def power(rates: FloatArray) -> FloatArray:
        # Mean squares of linear and angular rates without their noise.
        smooth = uniform_filter1d(rates, window, axis=0).reshape(-1, 2, 3)
        return np.mean(smooth**2, axis=(0, 2))

    # A turn has the noise of two quaternions, whose change is half of the angle.
    noise = (noise_of(log.time_s, log.base_pose).max() + MIN_NOISE) / TURN_S
    for order, shift in (("wxyz", 0), ("xyzw", 1)):
        if log.mapped.quaternion not in (None, order):
            continue
        pose = np.hstack([position, np.roll(quaternion, shift, axis=1)])
        turn = Rotation.from_quat(pose[:, 3:], scalar_first=True)
        steps = (turn[:-1].inv() * turn[1:]).as_rotvec()
        rate = np.vstack([steps, steps[-1:]]) / np.gradient(log.time_s)[:, None]
        slope = np.hstack([np.gradient(position, log.time_s, axis=0), rate])
        limit = MAX_MISFIT * power(slope) + 8.0 * noise**2
        for in_world, in_body in product((False, True), repeat=2):
            found = compress(BASE_MISTAKES, (shift, in_body, in_world))
            turned = turn.inv().apply(angular) if in_world else angular
            moved = turn.apply(linear) if in_body else linear
            twist = np.hstack([moved, turned])
            yield power(twist - slope) / limit, order, found, pose, twist, slope


def _check_base(log: Log) -> Iterator[str]:
    """Bring the base to quaternions w x y z and angular velocities in its own frame.

    Each order of quaternions is tried with each frame of velocities. Velocities that the pose contradicts are
    replaced by its differences.
    """
    if log.base_pose.shape[1] != 7:
        return
    is_given = log.base_twist.shape[1] == 6
    readings = [*_base_readings(log)]
    best = min(misfit[1] for misfit, *_ in readings)
    limit = min(1.0, (1.0 + SURE * TURN_S / np.ptp(log.time_s)) * best)
    near = [each for each in readings if each[0][1] <= limit] or readings
    reading = min(near, key=lambda each: bool(each[0][0] > 1.0))
    misfit, _, found, log.base_pose, log.base_twist, slope = reading
    yield from found
    if len({order for _, order, *_ in near}) > 1:
        log.findings.append(
            "base_angvel does not show the order of base_quat: it is taken as w x y z; "
            'if it is x y z w, add quaternion = "xyzw" to --map'
        )
    if (misfit > 1.0).any():
        log.base_twist = slope
        if is_given:
            yield "base velocities do not fit the pose: its differences are used"
        else:
            log.findings.append("no base velocities: differences of the pose are used")
    _turn_upright(log)


def _turn_upright(log: Log) -> None:
    """Turn the base, or its position alone, so that z is up."""
    turn = UPRIGHT[log.mapped.up]
    for columns in (log.base_pose[:, :3], log.base_twist[:, :3]):
        columns[:] = turn.apply(columns)
    if log.mapped.up_of == "pose":
        pose = Rotation.from_quat(log.base_pose[:, 3:], scalar_first=True)
        log.base_pose[:, 3:] = (turn * pose * turn.inv()).as_quat(scalar_first=True)
        log.base_twist[:, 3:] = turn.apply(log.base_twist[:, 3:])


def _check_clocks(log: Log) -> Iterator[str]:
    """Name commands whose clock is not that of the samples."""
    (first_s, last_s), (begin_s, end_s) = (
        log.time_s[[0, -1]],
        log.command_time_s[[0, -1]],
    )
    overlap_s = min(last_s, end_s) - max(first_s, begin_s)
    if overlap_s < 0.5 * (last_s - first_s) and log.command_kind:
        log.is_usable = False
        yield (
            f"command_t runs from {begin_s:g} to {end_s:g} s, but t from {first_s:g} to {last_s:g} s: "
            "give both by one clock"
        )


def _unknown(log: Log) -> Iterator[str]:
    """Report what a log does not tell, as what happens between samples with commands that move at each one."""
    is_fast = log.command_interval_s < 1.1 * log.interval_s
    if not log.command_kind:
        yield "no commands: the mechanism is taken as passive"
    elif is_fast and log.command_kind in ("target", "tau"):
        yield f"commands change at every sample: they cannot show a delay below {1e3 * log.interval_s:.3g} ms"


CHECKS = (
    _check_numbers,
    _check_samples,
    _check_wraps,
    _check_jitter,
    _check_velocity,
    _check_base,
    _check_clocks,
)
"""Checks of a log, in this order."""
