"""Checks of a log before anything is fitted: each corrects what it can, and names what was wrong."""

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import median_filter

from gauge_envs.errors import FileError
from gauge_envs.tools.replay.log import (
    SAMPLED,
    BoolArray,
    FloatArray,
    Log,
    noise_of,
)
from gauge_envs.tools.replay.rates import check_base, check_velocity, integral

MIN_SAMPLES = 20
MAX_INTERVAL_S = 1.0
MAX_NUMBER = 1e30
"""Size from which on a number is damaged; slopes and squares of much larger ones overflow. A clock has up to 2e18."""
MIN_JUMP = 0.02
"""Second difference of positions at a lost sample [rad or m]."""
LOST_STEP = 1.5
"""Step after repeated rows, over an ordinary one, from which on they were lost; an encoder of low resolution has 1."""
BEND = 5.0
"""Second difference of positions at a jump, over the 90th percentile."""
MAX_REST = 0.3
"""Difference of the second differences from those of a spike, over its size."""
FAR_STEP = 2.0
FAR_SIZE = 25.0
"""Size of a spike, over the 95th percentile of the steps between samples, and over the 90th of sizes in all rows."""
SPIKE = np.array([1.0, -2.0, 1.0])
"""Second differences of a spike."""
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


def _is_whole(*columns: FloatArray) -> BoolArray:
    """Return whether all numbers of a row are finite and of a plausible size, shape [row_count]."""
    return np.asarray((np.abs(np.column_stack(columns)) < MAX_NUMBER).all(axis=1))


def _check_numbers(log: Log) -> Iterator[str]:
    """Leave out rows without numbers; raise an error if few are left, or if the times are no clock in seconds."""
    # A lost sample may have a quaternion of zeros.
    log.base_pose[~log.base_pose[:, 3:].any(axis=1), 3:] = np.nan
    is_given = _is_whole(log.command_time_s, log.command)
    log.command_time_s = log.command_time_s[is_given]
    log.command = log.command[is_given]
    for name in SAMPLED:
        is_whole = _is_whole(getattr(log, name))
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
            # One origin keeps the distance between the two clocks.
            first = log.time_s[0]
            log.time_s = factor * (log.time_s - first)
            log.command_time_s = factor * (log.command_time_s - first)
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


def _zero_rows(log: Log) -> BoolArray:
    """Return the rows of zeros between whose neighbours a joint is elsewhere."""
    is_zero = (log.position == 0.0).all(axis=1)
    others = np.flatnonzero(~is_zero)
    if not len(others):
        return ~is_zero
    after = np.searchsorted(others, np.arange(len(is_zero)))
    ends = [others[(after + k).clip(0, len(others) - 1)] for k in (-1, 0)]
    jump = np.abs(log.position[ends[0]] + log.position[ends[1]])
    bend = np.abs(np.diff(log.position, n=2, axis=0))
    largest = MIN_JUMP + BEND * np.percentile(bend, 90.0, axis=0)
    return is_zero & (jump > largest).any(axis=1)


def _spikes(log: Log) -> BoolArray:
    """Return the rows of a jump that comes back, and is more than a joint moves in an interval.

    It has two opposite steps, and second differences in the ratio 1, -2, 1. An impact has one, a step 1, -1. Two
    impacts within an interval resemble it, so that the least size is far above the usual one.
    """
    path, steps = log.position, np.diff(log.position, axis=0)
    is_back, step = steps[1:-2] * steps[2:-1] < 0.0, np.abs(steps)
    if log.velocity.shape == path.shape:
        rest = path - integral(log.time_s, log.velocity)(log.time_s)
        # Velocities of another joint or unit tell nothing.
        left = np.median(np.abs(np.diff(rest, axis=0)), axis=0)
        path = np.where(left < 0.5 * np.median(step, axis=0), rest, path)
    bends = sliding_window_view(np.diff(path, n=2, axis=0), 3, axis=0)
    size = bends @ SPIKE / (SPIKE @ SPIKE)
    rest = np.abs(bends - size[..., None] * SPIKE).max(axis=-1)
    size = np.abs(size)
    limit = np.maximum(
        FAR_STEP * np.percentile(step, 95.0, axis=0),
        0.5 * MIN_JUMP + FAR_SIZE * np.percentile(size, 90.0, axis=0),
    )
    is_spike = is_back & (size > limit) & (rest < MAX_REST * size)
    return np.pad(is_spike.any(axis=1), 2)


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
    check_velocity,
    check_base,
    _check_clocks,
)
"""Checks of a log, in this order."""
