"""Distances of a motion from its reference, with their intervals and their cause."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.references.published import PUBLISHED_TRIALS
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import frame_times_s
from gauge_envs.scoring.answers import (
    baseline_means,
    cause_of,
    is_like_trials,
    mattering_distance,
    normalizing_baselines,
    real_limit,
    solves,
    united,
    within,
)
from gauge_envs.scoring.exact import Path, exact_path, law_holds
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
    best_offset,
    rms_deviation,
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
        markers_m: Markers at the frames [m], shape [T, M, 3]; M is 0 if they are not known.
    """

    experiment: Experiment
    band: Band
    times_s: FloatArray
    samples: FloatArray
    frames: FloatArray
    markers_m: FloatArray

    def over_trials(self, metric: str, distance: float) -> float | None:
        """Return a distance over the mean distance of real trials; None without one."""
        mean = baseline_means(self.experiment, self.band).get(metric)
        return None if mean is None else distance / mean


def with_distances(score: Score, motion: ComparedMotion, *, is_moved: bool) -> Score:
    """Return a score with the distances of a motion, and what they mean.

    Args:
        score: A score without distances.
        motion: The motion.
        is_moved: Whether the initial state had noise; the exact motion has the nominal start.
    """
    band, frames = motion.band, motion.frames
    rmse = trajectory_rmse(frames, band.mean)
    # A recording may end before the episode. DTW would warp frames without a mean onto its last frame.
    dtw = trajectory_dtw(frames[band.known], band.mean[band.known])
    score = replace(
        score,
        rmse=rmse,
        rmse_normalized=motion.over_trials("rmse", rmse),
        dtw=dtw,
        dtw_normalized=motion.over_trials("dtw", dtw),
        compared_frames=int(band.compared.known.sum()),
    )
    if band.kind.is_solution:
        return _from_solution(score, motion)
    score = _from_trials(score, motion)
    return score if is_moved else _from_exact(score, motion)


def _from_solution(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the distance from a solution of the scene."""
    band, compared = motion.band, motion.frames
    if band.points is not None:
        compared = 1e3 * motion.markers_m.reshape(len(motion.markers_m), -1)
        if not compared.size:
            reason = "the reference compares markers, which are not given; RMSE and DTW compare g(t)"
            return replace(score, refused=reason)
    distance = band.compared.length(compared - band.compared.mean)
    size = band.zero_motion_distance
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
    score = (_aligned if is_aligned else _unaligned)(score, motion)
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
        deviation = motion.frames - band.mean
        ends = trials_interval(deviation, band.trials, uncertainty=band.uncertainty)
    published = normalizing_baselines(motion.experiment, band)["rmse"]
    error = published.standard_uncertainty or 0.0
    half_width = student_t(PUBLISHED_TRIALS - 1) * error / published.mean
    relative = np.divide(ends, distance)
    interval = ratio_interval(ratio, relative, (half_width, half_width))
    return replace(score, primary_interval=interval)


def _aligned(score: Score, motion: ComparedMotion) -> Score:
    """Return a score with the distance after the best time shift."""
    band, times_s, samples = motion.band, motion.times_s, motion.samples
    offset_s, rmse = time_offset(times_s, samples, band.mean)
    ratio = motion.over_trials("rmse_aligned", rmse)
    score = replace(
        score,
        time_offset_s=offset_s,
        rmse_aligned=rmse,
        rmse_aligned_normalized=ratio,
    )
    without = band.baselines_without
    if not rmse or ratio is None or band.trials is None or without is None:
        return score
    frames, velocity = (
        shifted_frames(times_s, values, offset_s, frame_count=len(band.mean))
        for values in (samples, np.gradient(samples, times_s, axis=0))
    )
    # The simulation rests before its start.
    velocity[frame_times_s(len(frames)) < offset_s] = 0.0
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
    experiment, band, frames = motion.experiment, motion.band, motion.frames
    exact_places = exact_path(experiment, band)
    if exact_places is None:
        return score
    places = exact_places(frame_times_s(len(frames)))
    exact = band.project(places)
    holds = law_holds(experiment, places, band)
    path = exact[holds]
    size = trajectory_rmse(path, np.broadcast_to(path[:1], path.shape))
    distance = trajectory_rmse(frames[holds], path)
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
        distance = _distance_from_exact(
            exact_places, band, frames, holds, score.time_offset_s
        )
        # Both shifts interpolate between the same samples.
        samples = band.project(exact_places(motion.times_s))
        from_trials = _aligned_rmse(motion.times_s.tobytes(), samples.tobytes(), band)
    assert score.distance is not None and score.real_limit is not None, "as documented"
    cause = cause_of(
        is_real=score.distance <= score.real_limit,
        is_exact_real=from_trials <= score.real_limit,
        is_near_exact=distance <= limit,
    )
    return replace(score, exact=from_trials / of_trials, cause=cause)


@lru_cache(maxsize=64)
def _aligned_rmse(times: bytes, samples: bytes, band: Band) -> float:
    """Return the RMSE of an exact motion after the best time shift; worlds with the same start have the same."""
    times_s = np.frombuffer(times)
    values = np.frombuffer(samples).reshape(len(times_s), -1)
    return time_offset(times_s, values, band.mean)[1]


def _distance_from_exact(
    exact_places: Path,
    band: Band,
    frames: FloatArray,
    holds: BoolArray,
    time_offset_s: float,
) -> float:
    """Return the RMSE of a motion to the exact motion after the best time shift, in the unit of the reference.

    The exact motion is shifted, not the other one: its law holds at any time, so nothing is interpolated.

    Args:
        exact_places: The exact path.
        band: The reference.
        frames: The motion at the 30 Hz frames in the coordinates of the reference, shape [T, C].
        holds: Frames at which the law holds, shape [T].
        time_offset_s: Time shift of the motion to the trials [s]. Frames that this shift moves beyond the end of the
            trials do not count, as in the score.
    """
    times_s = frame_times_s(len(frames))
    is_compared = holds & (times_s <= times_s[-1] - max(time_offset_s, 0.0))

    def shifted_rmse(offset_s: FloatArray) -> FloatArray:
        queries_s = times_s[is_compared] - offset_s[..., None]
        exact = band.project(exact_places(queries_s.ravel()))
        projected = exact.reshape(*queries_s.shape, -1)
        return rms_deviation(projected - frames[is_compared])

    return best_offset(shifted_rmse)[1]
