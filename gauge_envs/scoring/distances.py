"""Distances of a motion from its reference, with their intervals and their cause."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.answers import (
    baseline_means,
    is_like_trials,
    mattering_distance,
    normalizing_baselines,
    real_limit,
    solves,
    united,
    within,
)
from gauge_envs.scoring.cause import cause_of, distance_from_exact
from gauge_envs.scoring.events import PUBLISHED_TRIALS
from gauge_envs.scoring.exact import exact_solution
from gauge_envs.scoring.interval import (
    distance_interval,
    distances_without,
    jackknife_interval,
    ratio_interval,
    student_t,
    trials_interval,
)
from gauge_envs.scoring.metrics import (
    MAX_TIME_OFFSET_S,
    shifted_frames,
    time_offset,
    trajectory_dtw,
    trajectory_rmse,
)
from gauge_envs.scoring.score import Score


@dataclass(frozen=True, kw_only=True)
class ComparedMotion:
    """Motion of an episode in the coordinates of its reference.

    Attributes:
        experiment: Experiment that was simulated.
        band: The reference.
        times_s: Times of the samples [s], shape [S].
        samples: The motion at those times, shape [S, C].
        frames: The motion at the 30 Hz frames, shape [T, C].
        markers_m: Markers at the frames [m], shape [T, M, 3]; None if they are not known.
    """

    experiment: Experiment
    band: Band
    times_s: FloatArray
    samples: FloatArray
    frames: FloatArray
    markers_m: FloatArray | None

    @property
    def deviation(self) -> FloatArray:
        """Motion minus reference at the frames, shape [T, C]."""
        return self.frames - self.band.mean

    @property
    def compared_deviation(self) -> FloatArray | None:
        """Deviation of the coordinates that a verdict compares; None if these are unknown markers."""
        points = self.band.points
        if points is None:
            return self.deviation
        if self.markers_m is None or not self.markers_m.size:
            return None
        markers_mm = 1e3 * self.markers_m.reshape(len(self.markers_m), -1)
        motion_mm = np.full(points.mean.shape, np.nan)
        count = min(len(markers_mm), len(motion_mm))
        motion_mm[:count] = markers_mm[:count]
        return motion_mm - points.mean


def with_distances(score: Score, motion: ComparedMotion, *, is_moved: bool) -> Score:
    """Return a score with the distances of a motion, and what they mean.

    Args:
        score: A score without distances.
        motion: The motion.
        is_moved: Whether the initial state had noise; the exact motion has the nominal start.
    """
    score = _with_paper_distances(score, motion)
    if motion.band.kind.is_solution:
        return _from_solution(score, motion)
    score = _from_trials(score, motion)
    return score if is_moved else _from_exact(score, motion)


def _with_paper_distances(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the distances of the paper."""
    band, frames = motion.band, motion.frames
    rmse = trajectory_rmse(frames, band.mean)
    # A recording may end before the episode. DTW would warp frames without a mean onto its last frame.
    dtw = trajectory_dtw(frames[band.known], band.mean[band.known])
    means = baseline_means(motion.experiment, band)
    return replace(
        score,
        rmse=rmse,
        rmse_normalized=_over(rmse, means.get("rmse")),
        dtw=dtw,
        dtw_normalized=_over(dtw, means.get("dtw")),
        compared_frames=int(band.compared.known.sum()),
    )


def _over(distance: float, mean: float | None) -> float | None:
    """Return a distance over the mean distance of real trials; None without one."""
    return None if mean is None else distance / mean


def _from_solution(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the distance from a solution of the scene."""
    band, deviation = motion.band, motion.compared_deviation
    if deviation is None:
        reason = "the reference compares markers, which are not given; RMSE and DTW compare g(t)"
        return replace(score, refused=reason)
    distance, size = band.compared.length(deviation), band.zero_motion_distance
    interval = distance_interval(distance / size, band.standard_uncertainty / size)
    return replace(
        score,
        solves=solves(band, distance),
        solution_distance=distance,
        solution_motion=size,
        primary_interval=interval,
    )


def _from_trials(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the distance from real trials, and whether the motion is like theirs."""
    band, experiment = motion.band, motion.experiment
    is_aligned = has_unknown_release(experiment, band)
    with_distance = _aligned if is_aligned else _unaligned
    score = with_distance(score, motion)
    assert score.distance is not None, "the RMSE is a distance"
    limit = real_limit(experiment, band, is_aligned=is_aligned)
    of_motion = is_like_trials(band, score.distance, limit)
    answer = united([of_motion, score.like_reality])
    return replace(score, real_limit=limit, like_reality=answer)


def has_unknown_release(experiment: Experiment, band: Band) -> bool:
    """Return whether scores ignore a time shift; a replayed trial and a driven motion start at a known time."""
    is_free = experiment.trial is None and not experiment.scene.drivers
    return band.has_release and is_free


def _unaligned(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the interval of the RMSE over its published value for real trials."""
    band, distance, ratio = motion.band, score.rmse, score.rmse_normalized
    if not distance or ratio is None:
        return score
    ends = distance_interval(distance, band.standard_uncertainty)
    if band.trials is not None and len(band.trials) > 1:
        ends = trials_interval(
            motion.deviation, band.trials, uncertainty=band.uncertainty
        )
    published = normalizing_baselines(motion.experiment, band)["rmse"]
    error = (published.std or 0.0) / math.sqrt(PUBLISHED_TRIALS)
    half_width = student_t(PUBLISHED_TRIALS - 1) * error / published.mean
    interval = ratio_interval(
        ratio, np.divide(ends, distance), (half_width, half_width)
    )
    return replace(score, primary_interval=interval)


def _aligned(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the distance after the best time shift."""
    band, times_s, samples = motion.band, motion.times_s, motion.samples
    offset_s, rmse = time_offset(times_s, samples, band.mean)
    ratio = _over(rmse, baseline_means(motion.experiment, band).get("rmse_aligned"))
    score = replace(
        score,
        time_offset_s=offset_s,
        rmse_aligned=rmse,
        rmse_aligned_normalized=ratio,
    )
    without = band.baselines_without
    if not rmse or ratio is None or band.trials is None or without is None:
        return score
    rates = np.gradient(samples, times_s, axis=0)
    frames, velocity = np.split(
        shifted_frames(
            times_s, np.hstack([samples, rates]), offset_s, frame_count=len(band.mean)
        ),
        2,
        axis=1,
    )
    # The simulation rests before its start.
    velocity[np.arange(len(frames)) / FRAME_RATE_HZ < offset_s] = 0.0
    # At the bound, the shift cannot follow an error of the mean.
    is_at_bound = abs(offset_s) >= MAX_TIME_OFFSET_S - 1e-6
    deviation = frames - band.mean
    ends = trials_interval(
        deviation,
        band.trials,
        velocity=None if is_at_bound else velocity,
        uncertainty=band.uncertainty,
    )
    interval = jackknife_interval(
        ratio,
        np.divide(ends, rmse),
        baselines=without,
        distances=distances_without(deviation, band.trials),
    )
    return replace(score, primary_interval=interval)


def _from_exact(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the distance from the exact motion, and the cause of the distance from real trials."""
    solution = exact_solution(motion.experiment)
    if solution is None:
        return score
    band, frames = motion.band, motion.frames
    exact = band.project(solution(np.arange(len(frames)) / FRAME_RATE_HZ))
    size = trajectory_rmse(exact, np.broadcast_to(exact[:1], exact.shape))
    distance = trajectory_rmse(frames, exact)
    of_trials = None
    if score.distance and score.primary_normalized:
        of_trials = score.distance / score.primary_normalized
    limit = mattering_distance(size, score.distance_unit, of_trials)
    score = replace(
        score,
        solves=within(distance, limit),
        solution_distance=distance,
        solution_motion=size,
    )
    if of_trials is None:
        return score
    from_trials = trajectory_rmse(exact, band.mean)
    if score.time_offset_s is not None:
        distance = distance_from_exact(solution, band, frames, score.time_offset_s)
        # Both shifts interpolate between the same samples.
        samples = band.project(solution(motion.times_s))
        _, from_trials = time_offset(motion.times_s, samples, band.mean)
    assert score.distance is not None and score.real_limit is not None, "as documented"
    cause = cause_of(
        is_real=score.distance <= score.real_limit,
        is_exact_real=from_trials <= score.real_limit,
        is_near_exact=distance <= limit,
    )
    return replace(score, exact=from_trials / of_trials, cause=cause)
