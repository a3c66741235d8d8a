"""Check the motion in a trajectory file: lost markers, another sampling rate, and motion that a score does not show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S, interpolated

MIN_JUMP_MM = 20.0
"""Smallest distance of a lost position from the path, and smallest unscored motion [mm]; cloth flicks by 11 mm."""

MIN_JUMP_SHARE = 0.3
"""Smallest distance of a lost curvature or area from its path, over the largest change of any of them."""

MIN_JUMP = 0.02
"""The same distance [rad or mm^2]; smaller motion is numerical noise."""

MIN_HELD_ROWS = 3
"""Smallest number of equal rows of a held value."""

HELD_SHARE = 0.1
"""Smallest distance of repeated rows from the path, over that of a single row."""

MAX_SPEED_RATIO = 5.0
"""Largest ratio of the first or last step to the next one, if that step begins or ends at an integer, as 0 or -9999."""

RATES_HZ = (10, 15, 20, 24, 25, 50, 60, 90, 100, 120, 125, 180, 200, 240, 250, 500)
"""Sampling rates of simulators and cameras other than 30 Hz."""

MIN_COVERED = 0.01
"""Smallest share of the reference's squared displacements that frames must cover for a misfit."""

MIN_MISFIT, MAX_MISFIT = 0.4, 0.2
"""Smallest misfit at 30 Hz and largest at another rate: root mean square over that of the reference's displacements."""

MAX_UNSCORED = 0.1
"""Largest unscored motion over the scored motion; simulations of all experiments have at most 0.001."""

# --- lost markers ----------------------------------------------------------------------------------------------------


def lost_marker(
    experiment: Experiment, times_s: FloatArray, values: FloatArray
) -> str | None:
    """Return the first rows at which a marker was lost, and their value; None if none was.

    A lost marker has zeros, another constant, its last position, or one wrong position.

    Args:
        experiment: Experiment that was simulated.
        times_s: Times of the rows [s], shape [row_count].
        values: g(t), shape [row_count, coordinate_count].
    """
    observable = experiment.score.observable
    is_place = observable in (Observable.POSITION, Observable.MARKER_POSITION)
    min_jump = MIN_JUMP_MM
    if not is_place:
        largest_change = float(np.ptp(values, axis=0).max())
        min_jump = max(MIN_JUMP, MIN_JUMP_SHARE * largest_change)
    for name, column in zip(experiment.coordinates, values.T, strict=True):
        # Equal rows count as one sample. So zeros and held values are one sample off the path of its neighbours.
        starts = np.flatnonzero(np.append(True, np.diff(column) != 0.0))
        counts = np.diff(np.append(starts, len(column)))
        path = column[starts]
        distances = _distances_off_path(path, counts)
        # Curvatures and areas change quickly at contacts.
        is_lost = is_place | (counts > 1) | (path == np.round(path))
        # A flat sheet has curvatures of 0 at its start.
        is_lost[0] = is_place
        limits = np.where(is_place & (counts > 1), HELD_SHARE, 1.0) * min_jump
        distances[~is_lost | (distances <= limits)] = 0.0
        if distances.any():
            sample = int(distances.argmax())
            first, last = starts[sample], starts[sample] + counts[sample] - 1
            rows = f"rows {first} to {last}" if last > first else f"row {first}"
            return (
                f"{rows} (t = {times_s[first]:.4f} s): {name} is {path[sample]:.6g}, {distances[sample]:.3g} "
                f"{observable.unit} off the path of the other rows: the marker was lost. Interpolate over these rows"
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
    if len(path) < 2:
        return np.zeros(len(path))
    padded = np.pad(path, 2, mode="edge")
    earlier, before, _, after, later = (
        padded[shift : len(path) + shift] for shift in range(5)
    )
    distances = np.abs(path - (4.0 * (before + after) - earlier - later) / 6.0)
    change_of_step = np.abs((later - after) - (before - earlier))
    is_off = distances > 2.0 * change_of_step + 5.0 * np.median(distances)
    distances[~is_off] = 0.0
    steps = np.abs(np.diff(path))
    # After held rows, the motion catches up with about one step for each row.
    before, out, after = (
        np.pad(steps, 2)[shift : len(path) + shift] for shift in (1, 2, 3)
    )
    is_late = (out > 2.0 * np.maximum(before, after)) & (out < 2.0 * counts * before)
    is_held = is_late & (counts >= MIN_HELD_ROWS)
    distances[is_held] = out[is_held]
    for end, step, next_step in ((0, out[0], out[1]), (-1, before[-1], before[-2])):
        is_jump = path[end] == round(path[end]) and step > MAX_SPEED_RATIO * next_step
        distances[end] = step if is_jump else 0.0
    # A file with repeated rows has samples of a slower clock.
    if np.median(counts) >= 2.0:
        distances[1] = steps.max()
    return distances


# --- sampling rate ---------------------------------------------------------------------------------------------------


def likely_rate_hz(band: Band, values: FloatArray) -> int | None:
    """Return the rate at which rows without times follow the reference, if 30 Hz does not; else None.

    Args:
        band: The reference.
        values: g(t), shape [row_count, coordinate_count].
    """
    projected = band.project(values)
    if not MIN_MISFIT < _misfit(band, projected, FRAME_RATE_HZ) < np.inf:
        return None
    misfits = {rate: _misfit(band, projected, rate) for rate in RATES_HZ}
    best = min(misfits, key=lambda rate: misfits[rate])
    return best if misfits[best] < MAX_MISFIT else None


def _misfit(band: Band, projected: FloatArray, rate_hz: float) -> float:
    """Return the smallest misfit of rows at a rate over all times of release; infinite for too little motion."""
    times_s = np.arange(len(projected)) / rate_hz
    moved = _displacements(band)
    motion = np.cumsum(np.square(moved).sum(axis=1))
    frames_s = np.arange(len(moved)) / FRAME_RATE_HZ
    smallest = np.inf
    for release_s in frames_s[frames_s <= MAX_TIME_OFFSET_S]:
        covered = frames_s <= times_s[-1] + release_s + 1e-9
        last = np.count_nonzero(covered) - 1
        if motion[last] <= MIN_COVERED * motion[-1]:
            continue
        at_frames = interpolated(frames_s[covered] - release_s, times_s, projected)
        deviation = (at_frames - projected[0] - moved[covered])[band.known[covered]]
        smallest = min(smallest, float(np.square(deviation).sum() / motion[last]))
    return float(np.sqrt(smallest))


# --- other motion ----------------------------------------------------------------------------------------------------


def unusual_motion(
    experiment: Experiment, band: Band, frames: FloatArray
) -> Iterator[str]:
    """Yield a sentence for motion against the reference and for motion that is not scored.

    Args:
        experiment: Experiment that was simulated.
        band: The reference.
        frames: g(t) at the 30 Hz frames, shape [frame_count, coordinate_count].
    """
    unit = experiment.score.observable.unit
    moved = frames - frames[0]
    scored = band.project(moved)
    real = _displacements(band)
    distances = np.linalg.norm(real, axis=1)
    scored_distances = np.linalg.norm(scored, axis=1)
    # Later, oscillations of another period also move against each other.
    early = int(np.argmax(distances >= 0.5 * distances.max()))
    against = -float(scored[early] @ real[early]) / max(distances[early], 1e-12)
    if against > 0.5 * max(scored_distances[early], 0.2 * distances[early]):
        yield f"{_place(early)}: moves {against:.3g} {unit} against the reference"
    unscored = moved - scored @ np.linalg.pinv(band.projection).T
    sizes = np.linalg.norm(unscored, axis=1)
    last = int(sizes.argmax())
    if sizes[last] > max(MIN_JUMP_MM, MAX_UNSCORED * scored_distances.max()):
        column = int(np.abs(unscored[last]).argmax())
        yield (
            f"{_place(last)}: {sizes[last]:.3g} {unit} of motion across is not scored, mainly "
            f"{experiment.coordinates[column]}"
        )


def _displacements(band: Band) -> FloatArray:
    """Return the displacements of the reference from its first known frame, 0 at others, shape [T, C]."""
    return np.nan_to_num(band.mean - band.mean[band.known][0])


def _place(frame: int) -> str:
    return f"frame {frame} (t = {frame / FRAME_RATE_HZ:.4f} s)"
