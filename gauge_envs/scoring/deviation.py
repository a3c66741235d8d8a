"""Deviation of a simulation, and of each real trial, from the mean of a band, as it is and after release alignment."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.published import Baseline
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.dependence import LEVEL, refusal, widening
from gauge_envs.scoring.metrics.trajectory import (
    MAX_RELEASE_OFFSET_S,
    release_offset,
    trajectory_rmse,
)
from gauge_envs.scoring.numerics import (
    bounded_minimum,
    interpolated,
    share_interval,
)
from gauge_envs.scoring.uncertainty import BandErrors, band_errors

SHIFT_STEP_S = 1.0 / 120.0
"""Step of the grid of time shifts [s]; the best one is refined."""

LEAST_OVERLAP = 0.6
"""Smallest share of frames that a shifted trial must have in common with the mean."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Deviation:
    """Simulation minus mean at the frames.

    Attributes:
        values: Deviation in the band's unit, shape [T, C].
        rmse: Its root mean square over frames, E_RMSE of the paper.
        errors: Its errors.
        baseline: Mean of the same distance over real trials, which normalizes it: published for a simulation as it is,
            of the trials at hand for an aligned one. None without one.
    """

    values: FloatArray
    rmse: float
    errors: BandErrors
    baseline: float | None

    @property
    def normalized(self) -> float | None:
        """Root mean square over the baseline."""
        return None if self.baseline is None else self.rmse / self.baseline

    @cached_property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval of the root mean square, in the band's unit; None if refused."""
        return self.errors.interval(self.values, over_baseline=False)

    @property
    def refusals(self) -> tuple[str | None, str | None]:
        """Why the root mean square, and the normalized one, have no interval; None if they have one."""
        return (
            self.errors.refusal(self.values, over_baseline=False),
            None if self.baseline is None else self.errors.refusal(self.values),
        )

    @cached_property
    def normalized_interval(self) -> tuple[float, float] | None:
        """95 % interval of the normalized root mean square; None without a baseline, or if refused."""
        if self.baseline is None:
            return None
        ends = self.errors.interval(self.values)
        return ends and (ends[0] / self.baseline, ends[1] / self.baseline)


@dataclass(frozen=True, eq=False, kw_only=True)
class Deviations:
    """Deviations of one simulation.

    Attributes:
        raw: The simulation as it is.
        aligned: The simulation after the time shift that fits best; None for a law.
        release_offset_s: That shift [s]; None for a law.
        primary: Field of `Score` that reports show first: `rmse_aligned` for an experiment that starts with a release,
            else `rmse`.
    """

    raw: Deviation
    aligned: Deviation | None
    release_offset_s: float | None
    primary: str

    @property
    def first(self) -> Deviation:
        """The deviation of the primary score."""
        if self.primary == "rmse_aligned" and self.aligned is not None:
            return self.aligned
        return self.raw


def normalizing_baselines(experiment: Experiment, band: Band) -> Mapping[str, Baseline]:
    """Return the published scores of real trials that normalize scores against a band, by metric; may be empty.

    The distance from a law or a solved model is a numerical error, which the scatter of real trials does not measure.
    """
    is_normalized = band.grade.is_real and band.normalized_by_baseline
    if not is_normalized or experiment.impossible_scores:
        return {}
    return experiment.baselines


def band_baseline(experiment: Experiment, band: Band) -> Baseline | None:
    """Return the published RMSE of real trials that normalizes a score against a band; None without one."""
    baseline = normalizing_baselines(experiment, band).get("rmse")
    # A reference of a user may state a mean of 0, which normalizes nothing.
    return baseline if baseline is not None and baseline.mean else None


def band_deviations(
    experiment: Experiment, band: Band, *, times_s: FloatArray, values: FloatArray
) -> Deviations:
    """Return the deviations of a generalized trajectory from a band, with their errors.

    Args:
        experiment: Experiment that was simulated.
        band: Reference of the score.
        times_s: Times of the samples since the first frame [s], strictly increasing, shape [sample_count].
        values: g(t) at those times, shape [sample_count, coordinate_count].
    """
    frames = sampled_frames(experiment, times_s, values)
    simulated = band.project(frames)
    published = band_baseline(experiment, band)
    errors = band_errors(band, published).with_projection(band, frames)
    raw = Deviation(
        values=simulated - band.mean,
        rmse=trajectory_rmse(simulated, band.mean),
        errors=errors,
        baseline=None if published is None else published.mean,
    )
    # A law and a model hold from frame 0 on, and a single-shot trial is measured from there. A shift of time would only
    # hide a drift.
    if not band.grade.is_real or experiment.trial is not None:
        return Deviations(raw=raw, aligned=None, release_offset_s=None, primary="rmse")
    projected = band.project(values)
    offset_s, rmse = release_offset(
        times_s, projected, band.mean, frame_rate_hz=FRAME_RATE_HZ
    )
    shifted, velocity = _shifted(times_s, projected, offset_s, len(band.mean))

    def moved(late_s: FloatArray) -> FloatArray:
        queries_s = (
            np.arange(len(band.mean)) / FRAME_RATE_HZ - offset_s - late_s[:, None]
        )
        return interpolated(queries_s, times_s, projected, after=np.nan)

    errors, baseline = errors.aligned(velocity, moved), aligned_baseline(band)
    if baseline is not None and (trials := trial_distances(band)) is not None:
        errors = errors.with_baseline(trials.aligned)
    return Deviations(
        raw=raw,
        aligned=Deviation(
            values=shifted - band.mean,
            rmse=rmse,
            errors=errors,
            baseline=baseline,
        ),
        release_offset_s=offset_s,
        primary="rmse" if experiment.scene.drivers else "rmse_aligned",
    )


def sampled_frames(
    experiment: Experiment, times_s: FloatArray, values: FloatArray
) -> FloatArray:
    """Return the samples at the 30 Hz frames of an experiment, shape [T, coordinate_count]."""
    wanted = np.arange(experiment.frame_count) / FRAME_RATE_HZ
    index = np.clip(np.searchsorted(times_s, wanted - 1e-6), 0, len(times_s) - 1)
    missing = np.abs(times_s[index] - wanted) > 1e-4
    if missing.any():
        frame = int(missing.argmax())
        raise ShapeError(
            f"{experiment.name} needs {experiment.frame_count} frames at 30 Hz: "
            f"no sample at frame {frame} (t = {wanted[frame]:.4f} s)"
        )
    return values[index]


def _shifted(
    times_s: FloatArray, values: FloatArray, offset_s: float, frame_count: int
) -> tuple[FloatArray, FloatArray]:
    """Return a simulation that is shifted in time, and its velocity, at the frames, each of shape [T, C]."""
    queries_s = np.arange(frame_count) / FRAME_RATE_HZ - offset_s
    shifted = interpolated(queries_s, times_s, values)
    velocity = interpolated(queries_s, times_s, np.gradient(values, times_s, axis=0))
    # Before its start the simulation is held.
    return shifted, np.where(queries_s[:, None] < 0.0, 0.0, velocity)


# --- real trials ---


@dataclass(frozen=True, eq=False)
class TrialDistances:
    """Distance of each real trial from the mean of the others, as that of a simulation is from the mean of all.

    A trial is nearer to a mean of N that it is part of, by the factor (N - 1) / N: 5 % of 20 trials. The published
    baseline is of such distances.

    Attributes:
        raw: E_RMSE, shape [trial_count].
        aligned: The same after the constant time shift that minimises it. A trial ends at the last frame, so a shift to
            earlier times compares fewer frames. Shape [trial_count].
        deviations: Each trial minus the mean of the others, shape [trial_count, T, C]; NaN where one is not known.
        aligned_deviations: The same after that shift.
    """

    raw: FloatArray
    aligned: FloatArray
    deviations: FloatArray
    aligned_deviations: FloatArray


@lru_cache(maxsize=64)
def trial_distances(band: Band) -> TrialDistances | None:
    """Return the distances of the trials of a band; None if it has fewer than two."""
    if band.trials is None or len(band.trials) < 2:
        return None
    seen = np.isfinite(band.trials)
    totals, counts = np.where(seen, band.trials, 0.0).sum(axis=0), seen.sum(axis=0)
    deviations: list[FloatArray] = []
    distances: list[FloatArray] = []
    for trial, is_seen in zip(band.trials, seen, strict=True):
        others = counts - is_seen
        mean = (totals - np.where(is_seen, trial, 0.0)) / np.maximum(others, 1)
        mean = np.where((others > 0) & np.isfinite(band.mean), mean, np.nan)
        shift_s = _release_shift_s(trial, mean)
        pair = _shifted_deviations(trial, mean, np.array([0.0, shift_s]))
        deviations.append(pair)
        distances.append(_mean_distances(pair, mean))
    both, distance_pairs = np.array(deviations), np.array(distances)
    return TrialDistances(
        raw=distance_pairs[:, 0],
        aligned=distance_pairs[:, 1],
        deviations=both[:, 0],
        aligned_deviations=both[:, 1],
    )


def aligned_baseline(band: Band) -> float | None:
    """Return the mean aligned distance of the trials of a band; None without trials."""
    trials = trial_distances(band)
    mean = 0.0 if trials is None else float(trials.aligned.mean())
    return mean if 0.0 < mean < np.inf else None


def percentile_among(distances: FloatArray, distance: float) -> float:
    """Return the percentage of trials that are closer to the mean than a distance: 0 is closer than all of them.

    Args:
        distances: Distance of each trial, shape [trial_count].
        distance: Distance of the simulation, in the same unit.
    """
    return 100.0 * float(np.mean(distances < distance))


def percentile_interval(
    distances: FloatArray, distance: float, interval: tuple[float, float] | None
) -> tuple[float, float] | None:
    """Return a 95 % interval of the percentage of all real trials, seen or not, that are closer to the mean.

    Two things are uncertain, and their widths add in quadrature on each side: which trials were drawn, after Clopper
    and Pearson, and the distance. Trials that are like the one before count as fewer.

    Args:
        distances: Distance of each trial, in recorded order, shape [trial_count].
        distance: Distance of the simulation, in the same unit.
        interval: Its 95 % interval; None if refused.

    Returns:
        The interval; None without that of the distance, or if the distances depend too much on their order.
    """
    if interval is None or refusal(distances) is not None:
        return None
    count = len(distances) / widening(distances) ** 2
    least_share, share, largest_share = (
        float(np.mean(distances < end)) for end in (interval[0], distance, interval[1])
    )
    low, high = share_interval(share * count, count, LEVEL)
    below, above = (
        math.hypot(share - low, share - least_share),
        math.hypot(high - share, largest_share - share),
    )
    return 100.0 * max(share - below, 0.0), 100.0 * min(share + above, 1.0)


def _shifted_deviations(
    trial: FloatArray, mean: FloatArray, shifts_s: FloatArray
) -> FloatArray:
    """Return a trial that is shifted in time minus the mean, shape [shift_count, T, C]; NaN at frames beyond its end.

    Args:
        trial: The trial, shape [T, C].
        mean: The mean, shape [T, C].
        shifts_s: Shifts to later times [s], shape [shift_count].
    """
    seen = np.isfinite(trial).all(axis=1)
    frames_s = np.arange(len(mean)) / FRAME_RATE_HZ
    known_s = frames_s[: len(trial)][seen]
    if not len(known_s):
        return np.full((len(shifts_s), *mean.shape), np.nan)
    queries_s = frames_s - shifts_s[:, None]
    # Before the release a body rests, so earlier times have the first sample; later ones are not known.
    usable = np.isfinite(mean).any(axis=1) & (queries_s <= known_s[-1] + 1e-9)
    shifted = interpolated(queries_s, known_s, trial[seen])
    return np.where(usable[:, :, None], shifted - mean, np.nan)


def _mean_distances(deviations: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the RMSE of deviations over their known frames, shape [shift_count]; inf where these are too few."""
    counts = np.isfinite(deviations).any(axis=2).sum(axis=1)
    squares = np.nansum(np.square(deviations), axis=(1, 2))
    wanted = np.isfinite(mean).any(axis=1).sum()
    is_enough = (counts > 0) & (counts >= LEAST_OVERLAP * wanted)
    distances = np.sqrt(squares / np.maximum(counts, 1))
    return np.where(is_enough, distances, math.inf)


def _release_shift_s(trial: FloatArray, mean: FloatArray) -> float:
    """Return the constant time shift [s] that minimises the RMSE of a trial."""

    def distances(shifts_s: FloatArray) -> FloatArray:
        return _mean_distances(_shifted_deviations(trial, mean, shifts_s), mean)

    count = round(MAX_RELEASE_OFFSET_S / SHIFT_STEP_S)
    grid_s: FloatArray = SHIFT_STEP_S * np.arange(-count, count + 1, dtype=np.float64)
    scores = distances(grid_s)
    best = int(np.argmin(scores))
    coarse_s = float(grid_s[best])
    if not np.isfinite(scores[best]):
        return coarse_s
    low_s, high_s = coarse_s - SHIFT_STEP_S, coarse_s + SHIFT_STEP_S
    refined_s, least = bounded_minimum(distances, low_s, high_s, 1e-5)
    return float(refined_s) if least < scores[best] else coarse_s
