"""Check the trials of one experiment against each other: lost frames, copies, and motions that are too far."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gauge_envs.references.band import Band, displacements
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.interval import student_limit
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S, MIN_OVERLAP
from gauge_envs.scoring.user_file.likely_mistakes import START_TOLERANCE_MM, corrections
from gauge_envs.scoring.user_file.motion_checks import (
    MIN_HELD_FRAMES,
    RATES_HZ,
    Fault,
    against_law,
    motion_fault,
    owners_of,
    place_of,
)

MIN_WHOLE_SHARE = 0.9
"""Smallest share of the frames of most trials that a trial has; bodies hide each other for a few frames at most."""

MIN_TRIALS = 5
"""Smallest number of trials whose scatter is known."""

MAX_RMS, MAX_DISTANCE = 3.0, 7.0
"""Root mean square and largest distance of a point by noise, over the noise of a coordinate; these are never too far.

The root mean square is 1.7 with its scatter over eight frames; the distance is the largest of a million."""

MIN_NOISE_MM, MAX_NOISE_MM = 0.1, 1.0
"""Range of the noise of motion capture [mm]; the paper states 1 mm."""

MAX_QUARTERS = 12.0
"""Largest distance beyond the median of the trials, over that of the upper quartile.

If a single normal constant scatters, such as a friction, the limit is 6 of its standard deviations."""

MIN_RATIO, MIN_RATIO_OF_FEW = 8.0, 200.0
"""Distance over the median of the trials that is always plausible, and its addition over the square of their number.

The largest of the 81 is 5.5 times the median, and 6.9 times with a twentieth of the frames lost. The quartiles of few
trials are uncertain."""

OWN_PROBABILITY = 0.99998
"""Probability with which the size of the motion of a trial is plausible, if a single normal constant scatters."""

MIN_MOTION = 5.0
"""Smallest displacement whose size is compared, over the noise of a coordinate."""

MIN_SHARE = 0.1
"""Smallest relative difference of the size of a motion from that of the median trial that is a fault."""

OWN_SHARE, OWN_SCATTER = 0.9, 0.79
"""Share of the trials, the nearest ones, that gives the scatter, and their deviation over that of a normal constant."""

MAX_LAW_SHARE = 0.5
"""Largest distance from a solution with the published constants, over the root mean square of its displacement."""

MAX_HELD_SHARE = 0.1
"""Largest share of trials with held values, so that holding them is a fault and not a rest without noise."""

MAX_LEFT = 0.3
"""Largest share of a distance that is left after a correction, so that the correction is the cause."""

UNEXPLAINED = "is it of this material and task?"
"""Remedy of a motion that no correction explains."""

SAME_MM = 1e-3
"""Largest distance of a copied trial or marker [mm], the digits of files; noise of motion capture is larger."""

SHIFT_STEP_S = 1.0 / 120.0
"""Step of the grid of time shifts [s]."""

SHIFT_TOLERANCE_S = 1e-7
"""Largest error of the best time shift [s]."""


def trial_faults(
    names: Sequence[str],
    trials: Mapping[str, FloatArray],
    *,
    unit: str = "mm",
    law: Band | None = None,
    others: Mapping[str, FloatArray] = MappingProxyType({}),
    may_repeat: bool = False,
) -> dict[str, Fault]:
    """Return the fault of each trial that has one, by its file or number.

    Args:
        names: Names of the coordinates, as `cube.x`.
        trials: The trials at the 30 Hz frames by file or number, shape [T, C] each; NaN is not captured.
        unit: Unit of the coordinates.
        law: Reference of the experiment in the coordinates of the trials; None without one. Fewer than `MIN_TRIALS`
            trials are compared with it, more of them with each other.
        others: Motions of the other materials by their experiment, shape [T, C] each.
        may_repeat: Whether trials may be equal, as the motion of a machine.
    """
    if not trials:
        return {}
    faults = dict(_incomplete(names, trials))
    motions: dict[str, FloatArray] = {}
    for file, trial in trials.items():
        if file in faults:
            continue
        fault = motion_fault(names, unit, trial)
        if fault is None and not may_repeat:
            fault = _copy(trial, motions)
        if fault is None and law is not None:
            fault = against_law(law, trial)
            if fault is None and len(trials) < MIN_TRIALS:
                fault = _far_from_law(law, trial)
        if fault is None:
            motions[file] = trial
        else:
            faults[file] = fault
    if len(motions) >= MIN_TRIALS:
        faults |= _far(names, motions, unit, others)
        faults |= _held(names, motions)
    return faults


def band_fault(band: Band) -> Fault | None:
    """Return the first fault of the trials of a band, or of its mean if it has none."""
    trials = band.mean[None] if band.trials is None else band.trials
    numbered = {f"trial {number}": trial for number, trial in enumerate(trials)}
    faults = trial_faults(band.coordinates, numbered, unit=band.unit)
    for trial, fault in faults.items():
        return fault._replace(place=f"{trial}, {fault.place}")
    return None


def _incomplete(
    names: Sequence[str], trials: Mapping[str, FloatArray]
) -> Iterator[tuple[str, Fault]]:
    """Yield trials in which a body or marker lacks too many of the frames that half of the trials have."""
    owners, is_of = owners_of(names)
    seen = np.isfinite([*trials.values()]) @ is_of == is_of.sum(axis=0)
    known = 2 * seen.sum(axis=0) >= len(trials)
    counts, needed = (seen & known).sum(axis=1), known.sum(axis=0)
    for file, seen_counts in zip(trials, counts, strict=True):
        is_short = seen_counts < np.floor(MIN_WHOLE_SHARE * needed)
        if is_short.any():
            owner = int(is_short.argmax())
            problem = f"it has {seen_counts[owner]} of {needed[owner]} frames"
            remedy = f"at least {100 * MIN_WHOLE_SHARE:g} % are needed: fill its gaps"
            yield file, Fault(owners[owner], problem, remedy)


def _copy(motion: FloatArray, others: Mapping[str, FloatArray]) -> Fault | None:
    """Return which of the other trials a trial copies; None if none."""
    for file, other in others.items():
        if np.nanmax(np.abs(motion - other), initial=0.0) <= SAME_MM:
            return Fault("(file)", f"it is a copy of {file}", "each trial counts once")
    return None


def _far(
    names: Sequence[str],
    trials: Mapping[str, FloatArray],
    unit: str,
    others: Mapping[str, FloatArray],
) -> Iterator[tuple[str, Fault]]:
    """Yield trials that are too far from the median trial, have another size, or are of another material.

    A deviation is that of the trial as recorded and after the best time shift, each also without a constant offset.
    """
    owners, is_of = owners_of(names)
    motions = _without_wide_offsets(np.stack([*trials.values()]))
    centre = median_motion(_aligned(motions, median_motion(motions)))
    deviations = [motions - median_motion(motions), _aligned(motions, centre) - centre]
    moved = [*map(_without_offset, deviations)]
    noise = _noise_mm(motions) if unit == "mm" else np.zeros(len(motions))
    least = MIN_MOTION * float(np.median(noise))
    sizes = dict(_of_another_size([*trials], centre, moved, least))
    materials = dict(_of_others([*trials], centre, moved, others, least))
    distances = [_sizes(kind, is_of) for kind in (*deviations, *moved)]
    ratios = np.array([_ratios(kind, noise) for kind in distances])
    for index, file in enumerate(trials):
        largest = int(ratios[:, index].argmax())
        ratio = ratios[largest, index]
        if ratio <= 1.0 and file not in sizes and file not in materials:
            continue
        remedy = _remedy(motions[index], centre)
        if file in materials and remedy == UNEXPLAINED:
            yield file, materials[file]
        elif ratio <= 1.0:
            yield file, (materials | sizes)[file]._replace(remedy=remedy)
        else:
            distance = distances[largest][index]
            frame, owner = np.unravel_index(distance.argmax(), distance.shape)
            problem = (
                f"{owners[owner]} is {distance[frame, owner]:.3g} {unit} from the median trial, "
                f"{ratio:.2g} times what the scatter of the trials allows"
            )
            yield file, Fault(place_of(int(frame)), problem, remedy, is_far=True)


def _of_another_size(
    files: Sequence[str],
    centre: FloatArray,
    moved: Sequence[FloatArray],
    least: float,
) -> Iterator[tuple[str, Fault]]:
    """Yield trials whose motion, or its part along an axis, is larger or smaller than the scatter of the trials allows.

    Args:
        files: Names of the trials.
        centre: The median trial, shape [T, C].
        moved: Deviations from it, as recorded and aligned, without offset, shape [N, T, C] each.
        least: Smallest displacement that is no noise.
    """
    motion = _without_offset(centre[None])
    axes = np.arange(motion.shape[2]) % 3
    parts = {"its motion": np.ones(axes.shape)}
    if len(axes) % 3 == 0:
        parts |= {f"its motion along {'xyz'[axis]}": axes == axis for axis in range(3)}
    for name, part in parts.items():
        if not np.nanmax(np.abs(motion * part)) > least:
            continue
        shares, limit = _shares(moved, [motion * part] * 2)
        for index in np.flatnonzero(np.abs(shares) > max(limit, MIN_SHARE)).tolist():
            problem = (
                f"{name} is {1.0 + shares[index]:.2g} times that of the median trial, "
                f"and the scatter of the trials allows 1 +- {limit:.2g}"
            )
            yield files[index], Fault("(file)", problem, UNEXPLAINED, is_far=True)


def _of_others(
    files: Sequence[str],
    centre: FloatArray,
    moved: Sequence[FloatArray],
    others: Mapping[str, FloatArray],
    least: float,
) -> Iterator[tuple[str, Fault]]:
    """Yield trials that are nearer to the motion of another material than the scatter of the trials allows.

    Args:
        files: Names of the trials.
        centre: The median trial, shape [T, C].
        moved: Deviations from it, as recorded and aligned, without offset, shape [N, T, C] each.
        others: Motions of the other materials by their experiment, shape [T, C] each.
        least: Smallest difference of the materials that is no noise.
    """
    for name, motion in others.items():
        if motion.shape[1] != centre.shape[1]:
            continue
        # Materials may have another number of frames.
        other = np.full_like(centre, np.nan)
        other[: len(motion)] = motion[: len(other)]
        ways = [other[None] - centre, _aligned(other[None], centre) - centre]
        if not np.nanmax(np.abs(ways[1])) > least:
            continue
        shares, limit = _shares(moved, [*map(_without_offset, ways)])
        for index in np.flatnonzero(shares > max(limit, 0.5)).tolist():
            problem = (
                f"its motion is {100 * shares[index]:.0f} % of the way from the median trial to {name}, "
                f"and the scatter of the trials allows {100 * limit:.0f} %"
            )
            remedy = f"is it a trial of {name}?"
            yield files[index], Fault("(file)", problem, remedy, is_far=True)


def _shares(
    moved: Sequence[FloatArray], ways: Sequence[FloatArray]
) -> tuple[FloatArray, float]:
    """Return the deviations along a way, over the way, and the largest plausible one; of two kinds, the less scattered.

    Student's t with the standard deviation of nine tenths of the trials gives the limit, so that a few trials of
    another material do not widen it.

    Args:
        moved: Deviations, shape [N, T, C] each.
        ways: A way for each, shape [1, T, C].
    """
    kinds = []
    for deviations, way in zip(moved, ways, strict=True):
        known = np.where(np.isfinite(deviations), way, np.nan)
        squares = np.nansum(np.square(known), axis=(1, 2))
        shares = np.nansum(deviations * way, axis=(1, 2)) / np.maximum(squares, 1e-12)
        shares -= np.median(shares)
        own = np.sort(np.abs(shares))[: int(OWN_SHARE * len(shares))]
        scatter = math.sqrt(float(np.square(own).sum()) / (len(own) - 1)) / OWN_SCATTER
        kinds.append((student_limit(len(own), OWN_PROBABILITY) * scatter, shares))
    limit, shares = min(kinds, key=lambda kind: kind[0])
    return shares, limit


def _far_from_law(law: Band, trial: FloatArray) -> Fault | None:
    """Return where a motion is too far from its reference up to the largest displacement; None if nowhere.

    Args:
        law: The reference.
        trial: The motion in the coordinates of g(t), shape [T, D]; NaN is not captured.
    """
    real, motion = displacements(law.mean), displacements(law.project(trial))
    sizes = np.linalg.norm(np.nan_to_num(real), axis=1)
    # Later, oscillations of another period also move against each other.
    real[int(np.argmax(sizes >= 0.95 * sizes.max())) + 1 :] = np.nan
    limit = MAX_LAW_SHARE * rms_over_frames(real)
    if law.trial_rmse_aligned is not None:
        limit = MIN_RATIO * float(np.median(law.trial_rmse_aligned))
    deviation = _without_offset(_aligned(motion[None], real) - real)[0]
    distance = rms_over_frames(deviation)
    if law.unit != "mm" or not distance > max(limit, MAX_RMS * MAX_NOISE_MM):
        return None
    frame = int(np.nan_to_num(np.linalg.norm(deviation, axis=1)).argmax())
    problem = f"it is {distance:.3g} mm from the reference, and at most {limit:.3g} mm is plausible"
    return Fault(place_of(frame), problem, _remedy(motion, real), is_far=True)


def _held(
    names: Sequence[str], trials: Mapping[str, FloatArray]
) -> Iterator[tuple[str, Fault]]:
    """Yield trials in which a body or marker keeps its values, if it moves or has noise in nearly all others."""
    owners, is_of = owners_of(names)
    motions = np.stack([*trials.values()])
    equal = (np.diff(motions, axis=1) == 0.0) @ is_of == is_of.sum(axis=0)
    # A body rests before its release.
    rests = np.logical_and.accumulate(equal, axis=1)
    equal &= ~rests | rests[:, -1:]
    runs = np.all(sliding_window_view(equal, MIN_HELD_FRAMES, axis=1), axis=-1)
    places = [np.argwhere(trial_runs) for trial_runs in runs]
    if sum(map(bool, map(len, places))) > max(1.0, MAX_HELD_SHARE * len(motions)):
        return
    for file, held in zip(trials, places, strict=True):
        if len(held):
            frame, owner = held[0]
            problem = f"{owners[owner]} keeps its values, unlike in the other trials"
            yield file, Fault(place_of(frame), problem, "write null for lost frames")


def _sizes(deviations: FloatArray, is_of: FloatArray) -> FloatArray:
    """Return the distance of each body or marker, shape [N, T, owner_count]; 0 where it is unknown."""
    return np.sqrt(np.nan_to_num(np.square(deviations)) @ is_of)


def _ratios(sizes: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the larger of the RMS and the maximum of each trial, over the largest plausible one, shape [N].

    Args:
        sizes: Distances of the bodies or markers, shape [N, T, owner_count].
        noise: Noise of each trial, shape [N].
    """
    ratios = np.zeros(len(sizes))
    for distances, factor in (
        (np.sqrt(np.square(sizes).mean(axis=1)), MAX_RMS),
        (sizes.max(axis=1), MAX_DISTANCE),
    ):
        largest = distances.max(axis=1)
        median, quarter = np.quantile(largest, (0.5, 0.75))
        plausible = (MIN_RATIO + MIN_RATIO_OF_FEW / len(largest) ** 2) * median
        plausible = max(plausible, median + MAX_QUARTERS * (quarter - median))
        limits = np.maximum(plausible, factor * noise)
        limits[limits == 0.0] = math.inf
        ratios = np.fmax(ratios, largest / limits)
    return ratios


def _noise_mm(motions: FloatArray) -> FloatArray:
    """Return the noise of a coordinate in each trial [mm], from the third differences, of variance 20."""
    differences = np.abs(np.diff(motions, 3, axis=1)).reshape(len(motions), -1)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        noise_mm = np.nanmedian(differences, axis=1) / (0.6745 * math.sqrt(20.0))
    return np.clip(np.nan_to_num(noise_mm), MIN_NOISE_MM, MAX_NOISE_MM)


def _without_offset(deviations: FloatArray) -> FloatArray:
    """Return deviations, shape [N, T, C], without the mean over the frames."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.asarray(deviations - np.nanmean(deviations, axis=1, keepdims=True))


def _without_wide_offsets(motions: FloatArray) -> FloatArray:
    """Return trials without offsets if most of the trials are far apart in a coordinate.

    Otherwise, lost frames would move the median, and time shifts would reduce offsets.
    """
    deviations = motions - median_motion(motions)
    offsets = deviations - _without_offset(deviations)
    sizes = np.median(np.nan_to_num(median_motion(np.abs(offsets))), axis=0)
    return motions - offsets if sizes.max() > START_TOLERANCE_MM else motions


def median_motion(motions: FloatArray) -> FloatArray:
    """Return the median of trials of shape [N, T, C], shape [T, C]; NaN is unknown."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.asarray(np.nanmedian(motions, axis=0))


def _aligned(motions: FloatArray, centre: FloatArray) -> FloatArray:
    step_s = 1.0 / FRAME_RATE_HZ
    shifts_s = [best_shift(motion, centre, step_s)[1] for motion in motions]
    return np.stack([*map(shifted, motions, shifts_s)])


def _remedy(motion: FloatArray, centre: FloatArray) -> str:
    """Return the correction that explains the distance of a trial from the others."""
    frames = np.arange(len(motion))
    corrected = [
        (f"the rows look like {hz} Hz", _at_rows(motion, frames * hz / FRAME_RATE_HZ))
        for hz in RATES_HZ
    ]
    corrected.append(("the frames look reversed", motion[::-1]))
    if motion.shape[1] % 3 == 0:
        # The start is right in recordings whose motion alone is mirrored.
        for start, origin in ((0.0, 0.0), (motion[0], centre[0])):
            for text, places in corrections((motion - start).reshape(-1, 3), "mm"):
                corrected.append((text, places.reshape(motion.shape) + origin))
    sizes = [_nearest(candidate, centre) for _, candidate in corrected]
    best = int(np.argmin(sizes))
    if sizes[best] < MAX_LEFT * _nearest(motion, centre):
        return corrected[best][0]
    return UNEXPLAINED


def _nearest(motion: FloatArray, centre: FloatArray) -> float:
    """Return the smallest distance of a motion over shifts by whole frames, with a quarter of the frames in common."""
    shifts_s = np.arange(-10, 11) / FRAME_RATE_HZ
    return min(_shifted_rms(motion, centre, shift_s, 0.25) for shift_s in shifts_s)


def best_shift(
    motion: FloatArray, mean: FloatArray, step_s: float = SHIFT_STEP_S
) -> tuple[float, float]:
    """Return the smallest distance of a trial from a mean over time shifts, and the shift [s].

    Args:
        motion: The trial, shape [T, C]; NaN is not captured.
        mean: The mean, shape [T, C].
        step_s: Step of the grid of shifts, of which the best is refined [s].
    """
    from scipy.optimize import minimize_scalar

    count = round(MAX_TIME_OFFSET_S / step_s)
    # Of equal shifts, the smallest comes first.
    shifts_s = step_s * np.array(sorted(range(-count, count + 1), key=abs))
    sizes = [_shifted_rms(motion, mean, shift_s) for shift_s in shifts_s]
    best = int(np.argmin(sizes))
    near_s = shifts_s[best] + step_s * np.array([-1.0, 1.0])
    # Shifts with too few common frames have an infinite distance.
    with np.errstate(invalid="ignore"):
        finest = minimize_scalar(
            lambda shift_s: _shifted_rms(motion, mean, shift_s),
            bounds=np.clip(near_s, -MAX_TIME_OFFSET_S, MAX_TIME_OFFSET_S),
            options={"xatol": SHIFT_TOLERANCE_S},
        )
    on_grid = sizes[best], float(shifts_s[best])
    return min(on_grid, (float(finest.fun), float(finest.x)))


def _shifted_rms(
    motion: FloatArray, mean: FloatArray, shift_s: float, share: float = MIN_OVERLAP
) -> float:
    """Return the distance of a shifted trial from a mean; infinity with less than a share of its known frames."""
    deviation = shifted(motion, shift_s) - mean
    common, known = (np.isfinite(x).any(axis=1).sum() for x in (deviation, mean))
    return rms_over_frames(deviation) if common >= max(share * known, 1) else math.inf


def shifted(motion: FloatArray, shift_s: float) -> FloatArray:
    """Return a trial after a delay [s], shape [T, C].

    A body rests before its release, so earlier times have the value of the first frame. Times after the last frame are
    unknown.
    """
    rows = np.arange(len(motion)) - shift_s * FRAME_RATE_HZ
    return _at_rows(motion, np.maximum(rows, 0.0))


def _at_rows(motion: FloatArray, rows: FloatArray) -> FloatArray:
    """Return a trial at fractional rows, shape [T, C]; NaN after the last row."""
    # Whole rows have rounding errors.
    rows = np.minimum(np.round(rows, 9), len(motion))
    padded = np.vstack([motion, np.full(motion.shape[1], np.nan)])
    low = padded[np.floor(rows).astype(int)]
    high = padded[np.ceil(rows).astype(int)]
    return low + (rows % 1.0)[:, None] * (high - low)


def rms_over_frames(deviation: FloatArray) -> float:
    """Return the root mean square over frames; each coordinate counts at the frames at which it is known.

    A coordinate that is never known does not count; without any, the result is NaN.
    """
    counts = np.isfinite(deviation).sum(axis=0)
    if not counts.any():
        return math.nan
    sums = np.nansum(np.square(deviation), axis=0)
    return math.sqrt((sums / np.maximum(counts, 1)).sum())
