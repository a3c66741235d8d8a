"""Scores of a swing: the event metrics, their alternative estimators, and event times beside those of a recording."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.metrics import EVENT_METRICS
from gauge_envs.references.published import Baseline, EventQuantity, recorded_events
from gauge_envs.references.uncertainties import PUBLISHED_TRIALS
from gauge_envs.scene import Hinge
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.metrics.events import (
    SwingTimes,
    dropped_rests,
    energy_loss,
    longest_stationary_duration,
    momentum_transfer_efficiency,
    oscillation_period,
    spectral_peak_period,
    swing_times,
)

NORMAL_95 = 1.959964
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""

CHOICES = {
    "lsd": ("lsd_central_s", 0.5 / FRAME_RATE_HZ),
    "mte": ("", 0.0),
    "pd": ("pd_fft_s", 0.0),
}
"""Other likely estimator of each metric, as a field of `Score`, and half the step in which it is counted [s]."""


@dataclass(frozen=True, kw_only=True)
class EventTime:
    """One time or duration of a swing, simulated and recorded.

    Attributes:
        quantity: `leaves`, `returns` or `rests`: start of a swing, end of a swing, or rest until the next swing.
        number: Number of the swing, from 1.
        simulated_s: Time after frame 0, or duration [s]; None if the simulation ends before.
        recorded_s: The same in the published recording of one trial [s].
        sigma_s: 1-sigma uncertainty of `recorded_s` [s].
    """

    quantity: str
    number: int
    simulated_s: float | None
    recorded_s: float
    sigma_s: float


@dataclass(frozen=True)
class _Swing:
    """The swinging body that is recorded first."""

    frames: FloatArray
    """Position at each frame [mm], shape [frame_count, 3]."""
    rest_height_mm: float
    drop_height_mm: float

    @property
    def height_mm(self) -> FloatArray:
        """Height at each frame [mm], shape [frame_count]."""
        return self.frames[:, 2]


def swing_metrics(experiment: Experiment, frames: FloatArray) -> dict[str, float]:
    """Return the raw event metrics of the first recorded body that the experiment asks for, by metric.

    Args:
        experiment: The experiment.
        frames: Positions of the recorded bodies at the frames [mm], shape [frame_count, D].
    """
    swing, wanted = _swing(experiment, frames), set(experiment.score.metrics)
    if swing is None:
        return {}
    heights, rest_mm = swing.height_mm, swing.rest_height_mm
    scores: dict[str, float] = {}
    if "lsd" in wanted:
        scores["lsd"] = longest_stationary_duration(
            heights, frame_rate_hz=FRAME_RATE_HZ
        )
    if "mte" in wanted:
        scores["mte"] = momentum_transfer_efficiency(
            heights, drop_height_mm=swing.drop_height_mm, rest_height_mm=rest_mm
        )
    if "pd" in wanted:
        scores["pd"] = oscillation_period(
            _period_signal(experiment, swing), frame_rate_hz=FRAME_RATE_HZ
        )
    if "el" in wanted:
        scores["el"] = energy_loss(heights, rest_height_mm=rest_mm)
    return scores


def swing_notes(
    experiment: Experiment,
    frames: FloatArray,
    *,
    times_s: FloatArray,
    values: FloatArray,
) -> dict[str, Any]:
    """Return the fields of `Score` that show what the choice of an estimator does, and the times of events.

    Args:
        experiment: The experiment.
        frames: Positions of the recorded bodies at the frames [mm], shape [frame_count, D].
        times_s: Times of all samples [s], shape [sample_count].
        values: Positions at all samples [mm], shape [sample_count, D].
    """
    swing, wanted = _swing(experiment, frames), set(experiment.score.metrics)
    if swing is None:
        return {}
    notes: dict[str, Any] = {}
    if "lsd" in wanted:
        heights = swing.height_mm
        inside = times_s <= (len(frames) - 1) / FRAME_RATE_HZ + 1e-9
        seen = swing_times(
            times_s[inside], values[inside, 2], rest_height_mm=swing.rest_height_mm
        )
        notes |= {
            "lsd_speed_3d_s": longest_stationary_duration(
                heights, path_mm=swing.frames, frame_rate_hz=FRAME_RATE_HZ
            ),
            "lsd_central_s": longest_stationary_duration(
                heights, central=True, frame_rate_hz=FRAME_RATE_HZ
            ),
            "lsd_dropped_rests_s": dropped_rests(heights, frame_rate_hz=FRAME_RATE_HZ),
            "events": _events(experiment.name, seen),
        }
        notes |= _normalized(experiment, "lsd", notes, ("lsd_speed_3d", "lsd_central"))
    if "pd" in wanted:
        notes["pd_fft_s"] = spectral_peak_period(
            _period_signal(experiment, swing), frame_rate_hz=FRAME_RATE_HZ
        )
        notes |= _normalized(experiment, "pd", notes, ("pd_fft",))
    return notes


def _swing(experiment: Experiment, frames: FloatArray) -> _Swing | None:
    """Return the swing that the experiment scores, or None."""
    if set(experiment.score.metrics).isdisjoint(EVENT_METRICS):
        return None
    scene, body = experiment.scene, experiment.recorded[0]
    hinge = next(j for j in scene.joints if isinstance(j, Hinge) and j.body == body)
    arm_m = length_of(np.subtract(scene.body(body).pose.position_m, hinge.anchor_m))
    rest_height_mm = 1e3 * (hinge.anchor_m[2] - arm_m)
    highest_m = max(scene.body(joint.body).pose.position_m[2] for joint in scene.joints)
    return _Swing(frames[:, :3], rest_height_mm, 1e3 * highest_m - rest_height_mm)


def _period_signal(experiment: Experiment, swing: _Swing) -> FloatArray:
    """Return the coordinate whose period is scored, over the frames of the published period."""
    baselines = experiment.baselines
    count = baselines["pd"].frames if "pd" in baselines else len(swing.frames)
    return swing.frames[:count, "xyz".index(experiment.score.period_axis or "x")]


def _normalized(
    experiment: Experiment,
    metric: str,
    notes: Mapping[str, Any],
    names: tuple[str, ...],
) -> dict[str, float | None]:
    """Return alternatives over the published mean of their metric; None without one."""
    baseline = experiment.baselines.get(metric)
    mean = None if baseline is None else baseline.mean
    return {
        f"{name}_normalized": notes[f"{name}_s"] / mean if mean else None
        for name in names
    }


def _events(variant: str, seen: SwingTimes) -> tuple[EventTime, ...] | None:
    """Return the recorded events of a variant beside the simulated ones; None without a recording of events."""
    simulated = {
        EventQuantity.LEAVES: seen.leaves_s,
        EventQuantity.RETURNS: seen.returns_s,
        EventQuantity.RESTS: seen.rests_s,
    }
    events = [
        EventTime(
            quantity=event.quantity.value,
            number=number,
            simulated_s=simulated[event.quantity][number - 1]
            if number <= len(simulated[event.quantity])
            else None,
            recorded_s=value_s,
            sigma_s=event.sigma_s,
        )
        for event in recorded_events(variant)
        for number, value_s in enumerate(event.values_s, start=1)
    ]
    return tuple(events) or None


def event_intervals(
    events: Mapping[str, float],
    notes: Mapping[str, Any],
    baselines: Mapping[str, Baseline],
) -> dict[str, tuple[float, float]]:
    """Return the 95 % intervals of normalized event metrics, by field of `Score`.

    Contributions: the published mean, its standard deviation over the root of 20 trials; half a frame of a duration
    that is counted in frames; and the choice of the estimator, the difference between the two likely ones. The latter
    two are half widths of rectangular distributions (GUM 4.3.7).

    Args:
        events: Raw metrics from `swing_metrics`.
        notes: Fields from `swing_notes`.
        baselines: Published scores by metric.
    """
    intervals: dict[str, tuple[float, float]] = {}
    for metric, (alternative, counted_s) in CHOICES.items():
        value, line = events.get(metric), baselines.get(metric)
        if (
            value is None
            or line is None
            or not line.mean
            or line.std is None
            or not np.isfinite(value)
        ):
            continue
        other = notes.get(alternative)
        choice = 0.0 if other is None else abs(other - value) / math.sqrt(3.0)
        of_estimator = math.hypot(choice, counted_s / math.sqrt(3.0)) / line.mean
        relative = line.std / line.mean / math.sqrt(PUBLISHED_TRIALS)
        half = NORMAL_95 * math.hypot(of_estimator, relative * value / line.mean)
        intervals[f"{metric}_normalized_95"] = (
            max(value / line.mean - half, 0.0),
            value / line.mean + half,
        )
    return intervals
