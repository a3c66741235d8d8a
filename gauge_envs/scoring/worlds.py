"""Distances of many worlds of one experiment as arrays, for training and for batches of thousands."""

from __future__ import annotations

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import SAMPLES_PER_FRAME
from gauge_envs.scoring.answers import baseline_means
from gauge_envs.scoring.distances import has_unknown_release
from gauge_envs.scoring.metrics import time_offset


def score_worlds(
    experiment: Experiment, band: Band, *, times_s: FloatArray, values: FloatArray
) -> dict[str, FloatArray]:
    """Return the distances of many trajectories from a reference; `score_trajectory` has the same numbers for one.

    Args:
        experiment: Experiment that was simulated.
        band: Its reference.
        times_s: Times of the samples [s], 180 a second from 0, shape [sample_count].
        values: g(t) of each world in the band's unit, shape [world_count, sample_count, coordinate_count]. A world with
            NaN at a frame has no distance.

    Returns:
        Arrays of shape [world_count] by field of `Score`, NaN for a world without a distance: `rmse`; and, where they
        apply, `rmse_normalized`, `time_offset_s`, `rmse_aligned` and `rmse_aligned_normalized`.

    Raises:
        ShapeError: The arrays do not fit each other.
    """
    last = (experiment.frame_count - 1) * SAMPLES_PER_FRAME
    width = band.projection.shape[1]
    if values.shape[1:] != (len(times_s), width) or len(times_s) <= last:
        raise ShapeError(
            f"values have shape {values.shape}; [world_count, {max(len(times_s), last + 1)}, {width}] is needed, "
            "with a time for each sample"
        )
    times_s, projected = times_s[: last + 1], values[:, : last + 1] @ band.projection.T
    deviation = projected[:, ::SAMPLES_PER_FRAME] - band.mean
    squares = np.where(np.isfinite(band.mean), np.square(deviation), 0.0).sum(
        axis=(1, 2)
    )
    scores = {"rmse": np.sqrt(squares / np.count_nonzero(band.known))}
    if has_unknown_release(experiment, band):
        aligned = np.full((len(values), 2), np.nan)
        for number in np.flatnonzero(np.isfinite(scores["rmse"])):
            aligned[number] = time_offset(times_s, projected[number], band.mean)
        scores["time_offset_s"], scores["rmse_aligned"] = aligned.T
    for name, mean in baseline_means(experiment, band).items():
        if name in scores:
            scores[f"{name}_normalized"] = scores[name] / mean
    return scores
