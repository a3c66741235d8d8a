"""Scores of single real trials among themselves: how far each is from their mean."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from gauge_envs.evaluation.metrics import MAX_RELEASE_OFFSET_S
from gauge_envs.references.bands import Band
from gauge_envs.scene.timing import FRAME_RATE_HZ

FloatArray = NDArray[np.float64]

SHIFT_STEP_S = 1.0 / 120.0
"""Step of the grid of time shifts [s]; the best one is refined."""

LEAST_OVERLAP = 0.6
"""Smallest share of frames that a shifted trial must have in common with the mean."""


@dataclass(frozen=True, eq=False)
class TrialDistances:
    """Distance of each real trial from the mean of all.

    Attributes:
        raw: E_RMSE, shape [trial_count].
        aligned: The same after the constant time shift that minimises it. A trial ends at the last frame, so a shift to
            earlier times compares fewer frames. Shape [trial_count].
    """

    raw: FloatArray
    aligned: FloatArray


@lru_cache(maxsize=64)
def trial_distances(band: Band) -> TrialDistances | None:
    """Return the distances of the trials of a band from its mean; None if it has no trials."""
    if band.trials is None or not len(band.trials):
        return None
    zero = np.zeros(1)
    raw = [float(_shifted_rmse(trial, band.mean, zero)[0]) for trial in band.trials]
    aligned = [_aligned_rmse(trial, band.mean) for trial in band.trials]
    return TrialDistances(np.array(raw), np.array(aligned))


def percentile_among(distances: FloatArray, distance: float) -> float:
    """Return the percentage of trials that are closer to the mean than a distance: 0 is closer than all of them.

    Args:
        distances: Distance of each trial, shape [trial_count].
        distance: Distance of the simulation, in the same unit.
    """
    return 100.0 * float(np.mean(distances < distance))


def _shifted_rmse(trial: FloatArray, mean: FloatArray, shifts_s: FloatArray) -> FloatArray:
    """Return the RMSE of a trial that is shifted in time, over the common frames; inf where these are too few."""
    seen = np.isfinite(trial).all(axis=1)
    frames_s = np.arange(len(mean)) / FRAME_RATE_HZ
    known_s = frames_s[: len(trial)][seen]
    scores = np.full(len(shifts_s), np.inf)
    if not len(known_s):
        return scores
    wanted = np.isfinite(mean).any(axis=1)
    for number, shift_s in enumerate(shifts_s):
        queries_s = frames_s - shift_s
        # Before the release a body rests, so earlier times have the first sample; later ones are not known.
        usable = wanted & (queries_s <= known_s[-1] + 1e-9)
        if usable.sum() < LEAST_OVERLAP * wanted.sum():
            continue
        shifted = np.column_stack([np.interp(queries_s[usable], known_s, column) for column in trial[seen].T])
        squares = np.nansum(np.square(shifted - mean[usable]), axis=1)
        scores[number] = np.sqrt(squares.mean())
    return scores


def _aligned_rmse(trial: FloatArray, mean: FloatArray) -> float:
    count = round(MAX_RELEASE_OFFSET_S / SHIFT_STEP_S)
    grid_s: FloatArray = SHIFT_STEP_S * np.arange(-count, count + 1, dtype=np.float64)
    scores = _shifted_rmse(trial, mean, grid_s)
    best = int(np.argmin(scores))
    if not np.isfinite(scores[best]):
        return float(scores[best])
    refined = minimize_scalar(
        lambda shift_s: float(_shifted_rmse(trial, mean, np.array([shift_s]))[0]),
        bounds=(grid_s[best] - SHIFT_STEP_S, grid_s[best] + SHIFT_STEP_S),
        method="bounded",
        options={"xatol": 1e-5},
    )
    return min(float(refined.fun), float(scores[best]))
