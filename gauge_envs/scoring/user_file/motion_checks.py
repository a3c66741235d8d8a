"""Check a motion: lost markers, jumps, another sampling rate, and motion that a score does not show.

`gauge score` checks a trajectory, `gauge data import` each trial, and `reference_band` the band of a user.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band, displacements
from gauge_envs.scene.geometry import FloatArray, IntArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ, frame_times_s
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S, time_offset
from gauge_envs.scoring.user_file.likely_mistakes import start_values

MAX_JITTER_S = 5e-3
"""Largest time of the first sample, and between the last one and the last frame, by a clock that jitters [s]."""

ROUNDING_MM = 1e-6
"""Rounding error of a position at rest [mm]."""

MIN_JUMP_MM = 20.0
"""Smallest distance of a lost position from the path, and smallest unscored motion [mm]; cloth flicks by 11 mm."""

MIN_HELD_JUMP_MM = 2.0
"""Smallest distance of equal rows from the path [mm]; equal rows are rare in a motion."""

MIN_JUMP_SHARE = 0.3
"""Smallest distance of a lost curvature or area from the path, over the largest change of any of them."""

MIN_JUMP = 0.02
"""The same distance [rad or mm^2]; smaller motion is numerical noise."""

RATES_HZ = (10, 15, 20, 24, 25, 50, 60, 90, 100, 120, 125, 180, 200, 240, 250, 500)
"""Sampling rates of simulators and cameras other than 30 Hz."""

MIN_COVERED = 0.01
"""Smallest share of the reference's squared displacements in the frames that rows cover at a rate."""

MIN_MISFIT, MAX_MISFIT = 0.4, 0.2
"""Smallest misfit at 30 Hz and largest at another rate: RMSE over the root mean square of the displacements."""

MAX_UNSCORED = 0.1
"""Largest unscored motion over the scored motion; simulations of all experiments have at most 0.001."""

MAX_REST_MM = 1.0
"""Largest motion of a body at rest in a file [mm], the noise of motion capture."""

MAX_ACROSS_MM = 5.0
"""Largest distance of the start from that of the scene, across the scored directions, without a note [mm]."""

MAX_SPEED_M_PER_S = 10.0
"""Largest speed of a real body or marker [m/s]; a fall from the ceiling of a laboratory, 3 m, ends at 7.7 m/s."""

MAX_PATH_M = 8.0
"""Largest distance from the start [m]; a capture volume is a few metres wide."""

MIN_HELD_FRAMES = 3
"""Smallest number of equal frames at the end of a motion."""

MIN_REST_SHARE = 0.1
"""Smallest motion of the reference from these frames on, over its whole motion."""


class Fault(NamedTuple):
    """Fault of a motion: its place, the value there, what to do, and whether only its distance from others shows it."""

    place: str
    problem: str
    remedy: str
    is_far: bool = False

    def __str__(self) -> str:
        return f"{self.place}: {self.problem}. {self.remedy}"


def owners_of(names: Sequence[str]) -> tuple[list[str], FloatArray]:
    """Return the bodies or markers of coordinates, and 1 where a coordinate is of one, shape [C, owner_count]."""
    owners = [name.rpartition(".")[0] or name for name in names]
    unique = [*dict.fromkeys(owners)]
    rows = [unique.index(owner) for owner in owners]
    return unique, np.eye(len(unique))[rows]


def filled(values: FloatArray) -> FloatArray:
    """Return g(t) with lines over lost frames; frames before the first and after the last sample stay NaN."""
    columns = values.copy()
    frames = np.arange(len(values))
    for column in columns.T:
        known = np.isfinite(column)
        if known.any():
            at_known = frames[known], column[known]
            column[:] = np.interp(frames, *at_known, left=np.nan, right=np.nan)
    return columns


def motion_fault(names: Sequence[str], unit: str, values: FloatArray) -> Fault | None:
    """Return a lost marker, a jump, or a path out of the capture volume; None if the motion is possible.

    Args:
        names: Names of the coordinates, as `cube.x`.
        unit: Unit of the values.
        values: g(t) at the 30 Hz frames, shape [T, C]; NaN is not captured.
    """
    times_s, whole = frame_times_s(len(values)), filled(values)
    lost = lost_marker(names, unit, times_s, whole)
    return lost or next(impossible_path(names, unit, whole), None)


def impossible_path(
    names: Sequence[str], unit: str, frames: FloatArray
) -> Iterator[Fault]:
    """Yield a speed and a distance from the start that no real body has; for the arguments, see `motion_fault`."""
    if unit != "mm":
        return
    owners, is_of = owners_of(names)
    speeds_m_per_s = FRAME_RATE_HZ * 1e-3 * np.diff(frames, axis=0)
    for motion, largest, text in (
        (speeds_m_per_s, MAX_SPEED_M_PER_S, "moves at {:.3g} m/s"),
        (1e-3 * displacements(frames), MAX_PATH_M, "is {:.3g} m from its start"),
    ):
        sizes = np.sqrt(np.square(np.nan_to_num(motion)) @ is_of)
        frame, owner = np.unravel_index(sizes.argmax(), sizes.shape)
        if sizes[frame, owner] > largest:
            yield Fault(
                place_of(int(frame)),
                f"{owners[owner]} {text.format(sizes[frame, owner])}",
                f"In a laboratory, it is at most {largest:g}: check the unit and lost markers",
            )


def lost_marker(
    names: Sequence[str], unit: str, times_s: FloatArray, values: FloatArray
) -> Fault | None:
    """Return the rows at which a marker was lost, and their value; None if none was.

    A lost marker has zeros, another constant, its last position, or one wrong position.

    Args:
        names: Names of the coordinates, as `cube.x`.
        unit: Unit of the values.
        times_s: Times of the rows [s], shape [row_count].
        values: g(t), shape [row_count, coordinate_count]; rows at the ends may be NaN.
    """
    min_jump = max(MIN_JUMP, MIN_JUMP_SHARE * float(np.ptp(values, axis=0).max()))
    for name, given in zip(names, values.T, strict=True):
        rows = np.flatnonzero(np.isfinite(given))
        column = given[rows]
        if not rows.size:
            continue
        # Equal rows count as one sample. So zeros and held values are one sample off the path of its neighbours.
        starts = np.flatnonzero(np.append(True, np.diff(column) != 0.0))
        counts = np.diff(np.append(starts, len(column)))
        path = column[starts]
        starts += rows[0]
        is_integer = path == np.round(path)
        if unit == "mm":
            limits = np.where(counts > 1, MIN_HELD_JUMP_MM, MIN_JUMP_MM)
            # Elsewhere, a motion may begin or end with an impact.
            limits[[0, -1]] = np.where(is_integer[[0, -1]], MIN_JUMP_MM, np.inf)
        else:
            # Curvatures change quickly at contacts, and are 0 at the start.
            limits = np.where(is_integer, min_jump, np.inf)
            limits[0] = np.inf
        distances = _distances_off_path(path, counts)
        distances[distances <= limits] = 0.0
        if distances.any():
            sample = int(distances.argmax())
            first, last = starts[sample], starts[sample] + counts[sample] - 1
            place = f"rows {first} to {last}" if last > first else f"row {first}"
            return Fault(
                f"{place} (t = {times_s[first]:.4f} s)",
                f"{name} is {path[sample]:.6g}, {distances[sample]:.3g} {unit} off the path of the other rows: "
                "the marker was lost",
                "Interpolate over these rows",
            )
    return None


def _distances_off_path(path: FloatArray, counts: IntArray) -> FloatArray:
    """Return how far each sample is from the cubic through its neighbours, shape [sample_count]; 0 on the path.

    An impact between two uniform motions is off the cubic by at most a third of its change of step, and a vibration by
    as much at most other samples.

    Args:
        path: Samples, each different from the previous one.
        counts: Number of equal rows of each sample.
    """
    steps = np.diff(np.pad(path, 2, mode="edge"))
    # The fourth difference is six times the distance.
    distances = np.abs(np.diff(steps, 3)) / 6.0
    change_of_step = np.abs(steps[3:] - steps[:-3])
    vibration = np.median(np.pad(distances, (0, counts.sum() - len(path))))
    distances[distances <= 2.0 * change_of_step + 5.0 * vibration] = 0.0
    # The padding halves the distances of both ends.
    distances[[0, -1]] *= 2.0
    # After held rows, the motion catches up with about one step for each row.
    before, out, after = np.abs([steps[1:-2], steps[2:-1], steps[3:]])
    is_late = (out > 2.0 * np.maximum(before, after)) & (out < 2.0 * counts * before)
    is_held = is_late & (counts > 1)
    distances[is_held] = (out - out / counts)[is_held]
    # In a file of a slower clock, most rows repeat. A body may rest, move within a few rows, and rest again.
    if len(path) > 5 and np.median(counts) >= 2.0:
        distances[len(path) // 2] = out.max()
    return distances


def likely_rate_hz(band: Band | None, values: FloatArray) -> int | None:
    """Return the rate at which rows without times follow the reference, if 30 Hz does not; else None.

    Args:
        band: The reference; None is unknown.
        values: g(t), shape [row_count, coordinate_count], at least one row.
    """
    if band is None:
        return None
    projected = band.project(values)
    if not MIN_MISFIT < _misfit(band, projected, FRAME_RATE_HZ) < np.inf:
        return None
    misfit, best_hz = min((_misfit(band, projected, hz), hz) for hz in RATES_HZ)
    return best_hz if misfit < MAX_MISFIT else None


def _misfit(band: Band, projected: FloatArray, rate_hz: float) -> float:
    """Return the RMSE of rows at a rate over the root mean square of the displacements; infinite for little motion."""
    times_s = np.arange(len(projected)) / rate_hz
    squares = np.square(_displacements(band)).sum(axis=1)
    covered = squares[: int(times_s[-1] * FRAME_RATE_HZ + 1e-9) + 1]
    if covered.sum() <= MIN_COVERED * squares.sum():
        return np.inf
    rows = times_s < len(covered) / FRAME_RATE_HZ
    mean = band.mean[: len(covered)]
    # A shift to earlier times would leave out frames, and resemble a lower rate.
    _, rmse = time_offset(times_s[rows], projected[rows], mean, earliest_s=0.0)
    return rmse / math.sqrt(covered.mean())


def release_row(experiment: Experiment, times_s: FloatArray, values: FloatArray) -> int:
    """Return the last row of a rest before the release that is too long for the time alignment; 0 without one.

    A file without a whole episode after the release has no such row. Neither has one of a scene with prescribed motion,
    because its time has a meaning.

    Args:
        experiment: Experiment that was simulated.
        times_s: Times of the rows [s], shape [row_count].
        values: g(t), shape [row_count, coordinate_count].
    """
    if experiment.scene.drivers or not experiment.score.observable.is_of_places:
        return 0
    since_s = times_s - times_s[0]
    distances_mm = np.abs(values - values[0]).max(axis=1)
    noise_mm = distances_mm[since_s <= MAX_TIME_OFFSET_S].max()
    is_moving = distances_mm > 2.0 * noise_mm + ROUNDING_MM
    # Without motion, the row is the first one.
    row = max(int(is_moving.argmax()) - 1, 0)
    episode_s = (experiment.frame_count - 1) / FRAME_RATE_HZ
    is_whole = since_s[-1] - since_s[row] >= episode_s - MAX_JITTER_S
    is_long_rest = noise_mm <= MAX_REST_MM and since_s[row] > MAX_TIME_OFFSET_S
    return row if is_whole and is_long_rest else 0


def start_across(experiment: Experiment, band: Band, start: FloatArray) -> str | None:
    """Return a sentence for a start beside that of the scene, in directions that are not scored; None if it is near.

    Args:
        experiment: Experiment that was simulated.
        band: The reference.
        start: g(t) of the first frame, shape [coordinate_count].
    """
    if experiment.score.observable is not Observable.POSITION:
        return None
    across_mm = length_of(_unscored(band, (start - start_values(experiment))[None]))
    if across_mm <= MAX_ACROSS_MM:
        return None
    return f"throughout: {across_mm:.3g} mm off across from the start of the scene, which is not scored"


def unusual_motion(
    experiment: Experiment, band: Band, frames: FloatArray
) -> Iterator[str]:
    """Yield a sentence for motion against the reference, for motion that is not scored, and for a lost end.

    Args:
        experiment: Experiment that was simulated.
        band: The reference.
        frames: g(t) at the 30 Hz frames, shape [frame_count, coordinate_count].
    """
    unit = experiment.score.observable.unit
    moved = frames - frames[0]
    yield from map(str, filter(None, [against_law(band, frames)]))
    yield from map(str, impossible_path(experiment.coordinates, unit, frames))
    across = _unscored(band, moved)
    across_size = np.linalg.norm(across, axis=1)
    last = int(across_size.argmax())
    scored = _largest(band.project(moved))
    if across_size[last] > max(MIN_JUMP_MM, MAX_UNSCORED * scored):
        name = experiment.coordinates[np.abs(across[last]).argmax()]
        yield f"{place_of(last)}: {across_size[last]:.3g} {unit} of motion across is not scored, mainly {name}"
    yield from _held_to_end(experiment, band, frames)


def _unscored(band: Band, shifts: FloatArray) -> FloatArray:
    """Return the part of shifts of g(t), shape [T, D], in directions that a band does not score."""
    return shifts - band.project(shifts) @ np.linalg.pinv(band.projection).T


def against_law(band: Band, frames: FloatArray) -> Fault | None:
    """Return where a motion is against its reference; None if nowhere. For the arguments, see `unusual_motion`."""
    moved, real = band.project(frames - frames[0]), _displacements(band)
    real_size = np.linalg.norm(real, axis=1)
    # Later, oscillations of another period also move against each other.
    early = int(np.argmax(real_size >= 0.5 * real_size.max()))
    against = -float(moved[early] @ real[early]) / max(real_size[early], 1e-12)
    size = max(length_of(moved[early]), 0.2 * real_size[early])
    if not against > 0.5 * size:
        return None
    problem = f"moves {against:.3g} {band.unit} against the reference"
    return Fault(
        place_of(early), problem, "Check the axes, and the order of the frames"
    )


def _held_to_end(
    experiment: Experiment, band: Band, frames: FloatArray
) -> Iterator[str]:
    """Yield a sentence for each body or marker that stops within a frame and stays while the reference moves on.

    A body that friction stops moves in its last frame by at most a third of the frame before.

    Args:
        experiment: Experiment that was simulated.
        band: The reference.
        frames: g(t) at the 30 Hz frames, shape [frame_count, coordinate_count].
    """
    reference = _displacements(band) @ np.linalg.pinv(band.projection).T
    owners, is_of = owners_of(experiment.coordinates)
    for owner, columns in zip(owners, is_of.T > 0.0, strict=True):
        path = frames[:, columns]
        moves = np.linalg.norm(np.diff(path, axis=0), axis=1)
        moving = np.flatnonzero(moves > 1e-9 * (1.0 + np.abs(path).max()))
        start = int(moving[-1]) + 1 if moving.size else 0
        is_abrupt = start > 1 and moves[start - 1] > 0.6 * moves[start - 2]
        if not is_abrupt or band.known[start:].sum() < MIN_HELD_FRAMES:
            continue
        real = reference[:, columns]
        # The reference hits nothing near this frame: its steps change slowly.
        steps = np.diff(real[start - 2 : start + 3], axis=0)
        is_smooth = _largest(np.diff(steps, axis=0)) <= 0.5 * _largest(steps)
        rest = length_of(np.ptp(real[start:][band.known[start:]], axis=0))
        if is_smooth and rest > MIN_REST_SHARE * length_of(np.ptp(real, axis=0)):
            yield (
                f"{place_of(start)} to the end: {owner} keeps its values, and the reference moves on by "
                f"{rest:.3g} {experiment.score.observable.unit}: the marker was lost"
            )


def _largest(vectors: FloatArray) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def _displacements(band: Band) -> FloatArray:
    """Return the displacements of the reference, 0 at unknown frames, shape [T, C]."""
    return np.nan_to_num(displacements(band.mean))


def place_of(frame: int) -> str:
    """Return a frame and its time in words."""
    return f"frame {frame} (t = {frame / FRAME_RATE_HZ:.4f} s)"
