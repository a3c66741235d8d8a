"""Scores of many worlds of one experiment in one pass, for training and for batches of thousands.

`score_worlds` reads trajectories on the host, `score_samples` on the engine's device, with the same arithmetic.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.device import HOST, DeviceWorlds, HostArrays
from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME
from gauge_envs.scoring.metrics import MAX_TIME_OFFSET_S
from gauge_envs.scoring.score import normalizing_baselines

MOST_STEPS = round(MAX_TIME_OFFSET_S / SAMPLE_INTERVAL_S)
"""Largest time shift [samples]."""


def score_worlds(
    experiment: Experiment, band: Band, *, times_s: FloatArray, values: FloatArray
) -> dict[str, FloatArray]:
    """Return the distances of many trajectories from a band, as `score_trajectory` gives them for one.

    Args:
        experiment: Experiment that was simulated.
        band: Its reference.
        times_s: Times of the samples [s], 180 a second from 0, shape [sample_count].
        values: g(t) of each world in the band's unit, shape [world_count, sample_count, coordinate_count]. A world with
            a frame that is NaN has no score. NaN after the last frame shortens the range of time shifts, as in
            `time_offset`.

    Returns:
        Arrays of shape [world_count] by field of `Score`, NaN for a world without a score: `rmse`; `rmse_normalized` if
        there is a published baseline; and for bands that are aligned `time_offset_s` and `rmse_aligned`, with
        `rmse_aligned_normalized` if the band has single trials.
    """
    needed = (experiment.frame_count - 1) * SAMPLES_PER_FRAME + 1
    if (
        values.ndim != 3
        or values.shape[1:] != (len(times_s), band.projection.shape[1])
        or len(times_s) < needed
    ):
        raise ShapeError(
            f"values have shape {values.shape}; [world_count, {max(len(times_s), needed)}, {band.projection.shape[1]}] "
            "is needed, with a time for each sample"
        )
    if np.abs(times_s - SAMPLE_INTERVAL_S * np.arange(len(times_s))).max() > 1e-9:
        raise ShapeError("times_s: 180 samples a second from 0 are needed")
    # Time comes first, so that a sample of all worlds is one block of memory.
    projected = values.transpose(1, 0, 2) @ band.projection.T
    return _scores(experiment, band, projected, HOST)


def score_samples(
    experiment: Experiment,
    band: Band,
    samples: Sequence[Any],
    device: DeviceWorlds,
) -> dict[str, Any]:
    """Return the distances of trajectories from a band where they lie, as `score_worlds` does on the host.

    Args:
        experiment: Experiment that was simulated.
        band: Its reference.
        samples: g(t) of all worlds at each sample, 180 a second from 0, in the band's unit, shape
            [world_count, coordinate_count] each. A world that is not finite has no score.
        device: Where they lie.
    """
    projected = device.arrays.matmul(
        device.arrays.stack([*samples], axis=0), device.asarray(band.projection.T)
    )
    return _scores(experiment, band, projected, device)


def _scores(
    experiment: Experiment,
    band: Band,
    projected: Any,
    device: DeviceWorlds | HostArrays,
) -> dict[str, Any]:
    """Return the scores of trajectories in coordinates of the band, shape [sample_count, world_count, C]."""
    arrays = device.arrays
    known = np.isfinite(band.mean)
    count = int(np.count_nonzero(known.any(axis=1)))
    weight = device.asarray(known[:, None].astype(np.float64))
    target = device.asarray(np.where(known, band.mean, 0.0)[:, None])
    frames = projected[::SAMPLES_PER_FRAME][: len(band.mean)]
    apart = arrays.where(weight > 0.0, frames - target, 0.0 * target)
    rmse = arrays.sqrt(arrays.einsum("tnc,tnc->n", apart, apart) / count)
    scores = {"rmse": rmse}
    if band.has_release and experiment.trial is None:
        last_known = SAMPLES_PER_FRAME * int(np.flatnonzero(known.any(axis=1))[-1])
        samples = projected
        earliest: Any = last_known + 1 - len(projected)
        if device is HOST:
            samples, earliest = _whole(projected, last_known)
        shifts, squares = _best_shift(arrays, samples, target, weight, earliest)
        is_missing = ~arrays.isfinite(rmse)
        missing = np.nan + rmse
        scores["time_offset_s"] = arrays.where(
            is_missing, missing, SAMPLE_INTERVAL_S * shifts
        )
        scores["rmse_aligned"] = arrays.where(
            is_missing, missing, arrays.sqrt(arrays.clip(squares, 0.0, None) / count)
        )
    return _normalized(experiment, band, scores)


def _normalized(
    experiment: Experiment, band: Band, scores: dict[str, Any]
) -> dict[str, Any]:
    """Return scores with those over the distances of real trials added, where these are known."""
    published = normalizing_baselines(experiment, band).get("rmse")
    aligned = band.trial_rmse_aligned
    baselines = {
        "rmse": None if published is None else published.mean,
        "rmse_aligned": None if aligned is None else float(aligned.mean()),
    }
    return scores | {
        f"{key}_normalized": scores[key] / mean
        for key, mean in baselines.items()
        if mean is not None and key in scores
    }


def _whole(projected: FloatArray, last_known: int) -> tuple[FloatArray, IntArray]:
    """Return trajectories that keep their last sample before the first NaN, and the earliest shift of each world.

    Args:
        projected: Trajectories, shape [sample_count, world_count, C].
        last_known: Number of the last sample that the band knows.
    """
    missing = np.isnan(projected.sum(axis=2))
    ends = np.maximum(
        np.where(missing.any(axis=0), missing.argmax(axis=0), len(projected)) - 1, 0
    )
    samples = np.ascontiguousarray(projected)
    if (ends < len(projected) - 1).any():
        numbers = np.minimum(np.arange(len(projected))[:, None], ends)
        samples = np.nan_to_num(projected)[numbers, np.arange(projected.shape[1])]
    return samples, last_known - ends


def _best_shift(
    arrays: Any, samples: Any, target: Any, weight: Any, earliest: Any
) -> tuple[Any, Any]:
    """Return the time shift of each world that minimises its squares [samples], and those squares, shape [world_count].

    Frames are samples, so all of them pass from one pair of samples to the next at the same shifts. Between two such
    shifts the squared distance is a parabola, whose minimum is exact.

    Args:
        arrays: Module of the functions of the arrays.
        samples: Trajectories, shape [sample_count, world_count, C].
        target: Mean of the band, shape [frame_count, 1, C].
        weight: 1 where it is known and 0 elsewhere, of that shape.
        earliest: Smallest shift of each world [samples], or of all.
    """
    frames = SAMPLES_PER_FRAME * np.arange(len(target))

    def deviations(shift: int) -> Any:
        """Return the deviations of worlds that are shifted by a number of samples, shape [frame_count, N, C]."""
        chosen = np.clip(frames - shift, 0, len(samples) - 1)
        return (samples[chosen] - target) * weight

    def product(one: Any, other: Any) -> Any:
        return arrays.einsum("tnc,tnc->n", one, other)

    centre = deviations(0)
    best = product(centre, centre)
    shifts = 0.0 * best
    nearer = {1: centre, -1: centre}
    # From the smallest shift on, so that of equally good shifts the smallest is kept.
    for first, step in (
        (shift, sign) for shift in range(MOST_STEPS) for sign in (1, -1)
    ):
        here, there = nearer[step], deviations(step * (first + 1))
        nearer[step] = there
        change = there - here
        slope, along = product(change, change), product(here, change)
        divisor = arrays.where(slope > 0.0, slope, 1.0 + slope)
        share = arrays.clip(-along / divisor, 0.0, 1.0)
        squares = product(here, here) + share * (2.0 * along + share * slope)
        better = squares < best
        if step < 0:
            better = better & (earliest <= -(first + 1))
        shifts = arrays.where(better, step * (first + share), shifts)
        best = arrays.where(better, squares, best)
    return shifts, best
