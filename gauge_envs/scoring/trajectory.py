"""Score generalized trajectories against the reference of their experiment: one in full, or the distances of many."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gauge_envs.errors import ReferenceFileError, ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.names import nearest
from gauge_envs.references.band import Band, RecordedEvent, band_file, recorded_events
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import SAMPLES_PER_FRAME
from gauge_envs.scoring.answers import baseline_means, united
from gauge_envs.scoring.distances import (
    ComparedMotion,
    has_unknown_release,
    with_distances,
)
from gauge_envs.scoring.estimates import ComparedQuantity, estimates
from gauge_envs.scoring.events import event_values
from gauge_envs.scoring.metrics import check_finite, frame_index, time_offset
from gauge_envs.scoring.recorded_events import EVENTS, SampledMotion
from gauge_envs.scoring.reference import has_real_structure, refusal
from gauge_envs.scoring.score import Score
from gauge_envs.scoring.user_file.likely_mistakes import value_mistake


def score_trajectory(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
    markers_m: FloatArray | None = None,
    is_moved: bool = False,
    is_checked: bool = False,
) -> Score:
    """Score a generalized trajectory.

    Args:
        experiment: Experiment that was simulated.
        band: Reference to score against. With None, the score holds only numbers that need no reference.
        times_s: Times of the samples since the first frame [s], strictly increasing, shape [sample_count]. Each 30 Hz
            frame has a sample within 0.1 ms. More samples make the time offset more precise. Samples after the last
            frame are ignored.
        values: g(t) at those times, shape [sample_count, coordinate_count].
        markers_m: Markers at the frames [m], shape [frame_count, marker_count, 3]; None if they are not known.
            Solutions of cloth and foam compare the markers.
        is_moved: Whether the initial state had noise, as with `jitter`.
        is_checked: Whether unit and start are known to be right, as in an episode of this package.

    Raises:
        ShapeError: A frame is missing, values are not finite or have the wrong width, the unit is wrong, or the motion
            starts elsewhere than the scene.
    """
    index = frame_index(times_s, experiment.frame_count, name=experiment.name)
    end = index[-1] + 1
    times_s, values, frames = times_s[:end], values[:end], values[index]
    check_finite(experiment.name, frames)
    if not is_checked:
        fault = value_mistake(experiment, frames)
        if fault is not None:
            raise ShapeError(f"{experiment.name}: {fault}")
    sampled = SampledMotion(
        scene=experiment.scene,
        times_s=times_s,
        samples=values,
        markers_m=np.empty((len(frames), 0, 3)) if markers_m is None else markers_m,
    )
    reason = refusal(experiment, band, is_moved=is_moved)
    events = {}
    if has_real_structure(experiment):
        events = _published_events(experiment, frames)
        events |= _recorded_events(experiment, band, sampled)
    unit = experiment.score.observable.unit
    score = Score(
        kind=(Kind.NONE if band is None else band.kind).value,
        unit=unit,
        distance_unit=unit if band is None else band.compared.unit,
        like_reality=united(event.answer for event in events.values()),
        refused=reason,
        events=events,
        estimates=estimates(experiment, band, times_s=times_s, values=values),
    )
    if band is None or reason is not None:
        return score
    motion = ComparedMotion(
        experiment=experiment,
        band=band,
        times_s=times_s,
        samples=band.project(values),
        frames=band.project(frames),
        markers_m=sampled.markers_m,
    )
    return with_distances(score, motion, is_moved=is_moved)


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


def _published_events(
    experiment: Experiment, frames: FloatArray
) -> dict[str, ComparedQuantity]:
    """Return the events of the paper with their published values."""
    events = {}
    for metric, value in event_values(experiment, frames).items():
        row = experiment.baselines.get(metric)
        events[metric] = ComparedQuantity(
            value=_or_none(value),
            unit=METRICS[metric].unit_of(experiment.score.observable.unit),
            real=row.mean if row else None,
            real_uncertainty=row.standard_uncertainty if row else None,
        )
    return events


def _recorded_events(
    experiment: Experiment, band: Band | None, motion: SampledMotion
) -> dict[str, ComparedQuantity]:
    """Return the events of recordings and of the trial with their real values; none if markers are not known."""
    if not motion.markers_m.size and experiment.scene.markers is not None:
        return {}
    of_trial = () if band is None else band.events
    return {
        event.name: ComparedQuantity(
            value=_or_none(_event_value(experiment.name, event, motion)),
            unit=event.unit,
            real=event.value,
            real_uncertainty=event.standard_uncertainty,
        )
        for event in (*recorded_events(experiment.name), *of_trial)
    }


def _event_value(variant: str, event: RecordedEvent, motion: SampledMotion) -> float:
    """Return the value of an event in a motion.

    Raises:
        ReferenceFileError: The file of the reference names an unknown event, or one that the scene cannot have.
    """
    file, place = band_file(variant) or variant, f"events.{event.name}"
    if event.name not in EVENTS:
        raise ReferenceFileError(
            file, place, f"no event has this name; {nearest(event.name, EVENTS)}"
        )
    try:
        return EVENTS[event.name](replace(motion, markers=event.markers))
    except (LookupError, ValueError, TypeError, StopIteration) as cause:
        reason = f"{variant} has not the bodies, markers or motion of this event"
        raise ReferenceFileError(file, place, reason) from cause


def _or_none(value: float) -> float | None:
    """Return the value of an event; None for NaN, an event that does not happen."""
    return None if math.isnan(value) else value
