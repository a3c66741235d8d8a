"""The score of an episode: how far its motion is from the reference, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from enum import StrEnum
from functools import cache
from typing import Any, ClassVar

import numpy as np
from pydantic import TypeAdapter

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band, recorded_events
from gauge_envs.references.kind import Kind
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import Baseline
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.cause import NEAR_EXACT, DistanceCause, distance_from_exact
from gauge_envs.scoring.estimates import ComparedQuantity, estimates
from gauge_envs.scoring.events import PUBLISHED_TRIALS, event_values
from gauge_envs.scoring.exact import MotionOfTime, exact_solution
from gauge_envs.scoring.interval import (
    distance_interval,
    mean_half_width,
    prediction_limit,
    ratio_interval,
    student_t,
    trials_interval,
)
from gauge_envs.scoring.metrics import (
    MAX_TIME_OFFSET_S,
    frame_index,
    shifted_frames,
    signed_error,
    time_offset,
    trajectory_dtw,
    trajectory_rmse,
    z_scores,
)
from gauge_envs.scoring.recorded_events import EVENTS, SampledMotion
from gauge_envs.scoring.reference import has_real_structure, refusal
from gauge_envs.scoring.user_file.likely_mistakes import value_mistake

COVERAGE_FACTOR = 1.96
"""Half width of a 95 % interval over the standard uncertainty."""

OVER_U = "over_uncertainty"
"""Value of `Score.primary` for a solution."""

EVENT_WORDS = {
    "lsd": "longest rest",
    "mte": "momentum transfer",
    "pd": "period",
    "el": "energy loss",
}
"""Words for the events of the paper, by name."""

Interval = tuple[float, float]


class ScoreVerdict(StrEnum):
    """Whether a motion is as close to its reference as real trials are, or within the uncertainty of a solution."""

    INSIDE = "inside"
    OUTSIDE = "outside"
    NO_REFERENCE = "no reference"


@dataclass(frozen=True, kw_only=True, repr=False)
class Score:
    """Distance of an episode from its reference. A field is None if it does not apply or has no reference.

    | field | unit | meaning |
    | --- | --- | --- |
    | `kind` | | a `Kind`, as `trials`, `published` or `analytic`: what the reference motion is |
    | `unit` | | unit of the distances |
    | `primary` | | distance that reports show first: `rmse_aligned` for a release, `over_uncertainty` for a solution |
    | `primary_interval` | 1 | 95 % interval of the primary distance over that of real trials, or over u |
    | `exact` | 1 | the primary ratio of the exact motion with the same constants, at the same times |
    | `cause` | | `none`, `constants`, `engine` or `both` (`DistanceCause`): what causes the distance from real trials |
    | `rmse` | unit | E_RMSE of the paper |
    | `rmse_95` | unit | its 95 % interval: from the scatter of single trials, else 1.96 u of the reference |
    | `rmse_normalized` | 1 | `rmse` over the published mean of real trials |
    | `dtw`, `dtw_normalized` | unit, 1 | E_DTW of the paper, and over the published mean of real trials |
    | `time_offset_s` | s | time shift with the smallest RMSE; positive if the real object is released later |
    | `rmse_aligned` | unit | RMSE after that shift |
    | `rmse_aligned_95` | unit | its 95 % interval |
    | `rmse_aligned_normalized` | 1 | `rmse_aligned` over the mean of the same distance of real trials |
    | `mean_abs_z` | 1 | mean deviation over the standard deviation of real trials; a real trial has 0.80 |
    | `real_limit` | unit | primary distance within which one more real trial lies with a probability of 95 % |
    | `signed_error` | unit | mean deviation of each coordinate of the reference |
    | `compared_frames` | | frames at which `distance` compares: those with known markers for cloth and foam |
    | `over_uncertainty` | 1 | distance over the standard uncertainty u of a solution |
    | `marker_rmse_mm` | mm | distance of the markers of cloth and foam; `over_uncertainty` divides it by u |
    | `events` | each | `lsd`, `mte`, `pd`, `el` and recorded events, by name (`ComparedQuantity`) |
    | `estimates` | each | friction, restitution, ringing of this motion and of real trials (`ComparedQuantity`) |
    | `refused` | | why the reference cannot score this motion, one sentence |
    """

    PRINTED: ClassVar[tuple[str, ...]] = ("verdict", "distance", "primary_normalized")
    """Properties that `to_dict` adds to the fields."""

    kind: str
    unit: str
    primary: str | None = None
    primary_interval: Interval | None = None
    exact: float | None = None
    cause: DistanceCause | None = None
    rmse: float | None = None
    rmse_95: Interval | None = None
    rmse_normalized: float | None = None
    dtw: float | None = None
    dtw_normalized: float | None = None
    time_offset_s: float | None = None
    rmse_aligned: float | None = None
    rmse_aligned_95: Interval | None = None
    rmse_aligned_normalized: float | None = None
    mean_abs_z: float | None = None
    real_limit: float | None = None
    signed_error: tuple[float, ...] | None = None
    compared_frames: int | None = None
    over_uncertainty: float | None = None
    marker_rmse_mm: float | None = None
    events: Mapping[str, ComparedQuantity] = field(default_factory=dict, hash=False)
    estimates: Mapping[str, ComparedQuantity] = field(default_factory=dict, hash=False)
    refused: str | None = None

    @property
    def distance(self) -> float | None:
        """The primary distance in its unit, `distance_unit`; None without one."""
        if self.primary == OVER_U and self.over_uncertainty is None:
            return None
        if self.primary == OVER_U:
            return self.rmse if self.marker_rmse_mm is None else self.marker_rmse_mm
        value: float | None = getattr(self, self.primary) if self.primary else None
        return value

    @property
    def distance_unit(self) -> str:
        """Unit of `distance`."""
        return self.unit if self.marker_rmse_mm is None else "mm"

    @property
    def primary_normalized(self) -> float | None:
        """The primary distance over that of real trials, or over u of a solution."""
        if self.primary in (None, OVER_U):
            return self.over_uncertainty
        value: float | None = getattr(self, f"{self.primary}_normalized")
        return value

    @property
    def verdict(self) -> ScoreVerdict:
        """`inside`, `outside` or `no reference`.

        The motion is inside if it is as close as one more real trial would be (`real_limit`). Without five single
        trials, the limit is twice the published mean of real trials, or 1.96 u if none is published. For a solution,
        the limit is 1.96 u. Without a reference motion, each event with a real value must be within 1.96 u.
        """
        if self.refused is not None:
            return ScoreVerdict.NO_REFERENCE
        if self.over_uncertainty is not None:
            return _verdict(self.over_uncertainty <= COVERAGE_FACTOR)
        if self.real_limit is not None and self.distance is not None:
            return _verdict(self.distance <= self.real_limit)
        if self.primary_normalized is not None:
            return _verdict(self.primary_normalized <= 2.0)
        if self.rmse_95 is not None:
            return _verdict(self.rmse_95[0] == 0.0)
        verdicts = [event.is_inside for event in self.events.values()]
        known_verdicts = [is_inside for is_inside in verdicts if is_inside is not None]
        if not known_verdicts:
            return ScoreVerdict.NO_REFERENCE
        return _verdict(all(known_verdicts))

    def summary(self) -> str:
        """Return the score in one sentence."""
        if self.refused is not None:
            return f"{self.refused[0].upper()}{self.refused[1:]}."
        parts = [self.verdict.value]
        if self.distance is not None:
            parts[0] += f": {_text(self.distance)} {self.distance_unit}"
        if self.primary_normalized is not None:
            parts.append(self._scaled_text(self.primary_normalized))
        parts += self._measured_texts[:2]
        text = ", ".join(parts)
        return f"{text[0].upper()}{text[1:]}."

    @property
    def _measured_texts(self) -> list[str]:
        """Events and estimates, each with its real value."""
        measured = {**self.events, **self.estimates}
        return [_compared_text(name, quantity) for name, quantity in measured.items()]

    def _scaled_text(self, ratio: float) -> str:
        """Return the primary ratio in words."""
        if self.primary == OVER_U:
            return f"{_text(ratio)} u of the {self.kind} reference"
        text = f"{_text(ratio)} times as far as real trials"
        if self.primary_interval is not None:
            low, high = (_text(end) for end in self.primary_interval)
            text += f" [{low}, {high}]"
        if self.exact is not None:
            text += f", an exact solver {_text(self.exact)}"
        return text

    def __repr__(self) -> str:
        """Return at most ten lines; `to_dict` has all numbers."""
        left_out = ("events", "estimates", "signed_error", "refused")
        numbers = [
            f"{field.name}={_value_text(getattr(self, field.name))}"
            for field in fields(self)
            if field.name not in left_out and getattr(self, field.name) is not None
        ]
        rows = [
            ", ".join(numbers[start : start + 4]) for start in range(0, len(numbers), 4)
        ]
        lines = [self.summary(), *rows, "; ".join(self._measured_texts[:8])]
        inner = "\n".join(f"    {line}" for line in lines if line)
        return f"Score(\n{inner}\n)"

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary of fields and `PRINTED`, with `over_real` of each event and estimate."""
        values = {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in asdict(self).items()
        }
        for key in ("events", "estimates"):
            values[key] = {
                name: asdict(measured) | {"over_real": measured.over_real}
                for name, measured in getattr(self, key).items()
            }
        for name in self.PRINTED:
            values[name] = getattr(self, name)
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Score:
        """Build a score from `to_dict`; keys of later versions are ignored.

        Raises:
            ValueError: A value is missing or has the wrong type.
        """
        return _score_adapter().validate_python(dict(values))


@cache
def _score_adapter() -> TypeAdapter[Score]:
    """Return the validator of scores; it is slow to build."""
    return TypeAdapter(Score)


def _verdict(is_inside: bool) -> ScoreVerdict:
    return ScoreVerdict.INSIDE if is_inside else ScoreVerdict.OUTSIDE


def _text(value: float) -> str:
    """Return a number with three digits."""
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def _value_text(value: Any) -> str:
    """Return a number with three digits, an interval, or a word."""
    if isinstance(value, tuple):
        return f"({', '.join(_text(end) for end in value)})"
    return _text(value) if isinstance(value, float) else str(value)


def _compared_text(name: str, quantity: ComparedQuantity) -> str:
    """Return a quantity with its real value, as `friction 0.273 (real 0.257 +- 0.006)`."""
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    text = f"{EVENT_WORDS.get(name, name)} "
    if quantity.value is None:
        text += "does not happen"
    else:
        text += f"{_text(quantity.value)}{unit}"
    if quantity.real is None:
        return text
    # The published energy loss is an ideal, not a value of real trials.
    owner = "real" if name not in METRICS or METRICS[name].is_normalized else "ideal"
    real = _text(quantity.real)
    if quantity.real_uncertainty is not None:
        real += f" +- {quantity.real_uncertainty:.2g}{unit}"
    return f"{text} ({owner} {real})"


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
    if not is_checked and np.isfinite(frames[0]).all():
        fault = value_mistake(experiment, frames)
        if fault is not None:
            raise ShapeError(f"{experiment.name}: {fault}")
    reason = refusal(experiment, band, is_moved=is_moved)
    score = Score(
        kind=(Kind.NONE if band is None else band.kind).value,
        unit=experiment.score.observable.unit,
        refused=reason,
        events=_events(experiment, times_s, values, frames, markers_m),
        estimates=estimates(experiment, band, times_s=times_s, values=values),
    )
    if band is None or reason is not None:
        return score
    motion = _ComparedMotion(
        experiment=experiment,
        band=band,
        times_s=times_s,
        samples=band.project(values),
        frames=band.project(frames),
        markers_m=markers_m,
    )
    score = _with_distances(score, motion)
    # The exact motion has the nominal start.
    if not is_moved:
        score = _with_cause(score, motion)
    if band.kind.is_solution and score.over_uncertainty is None:
        reason = "no verdict: the reference compares markers, which are not given; RMSE and DTW compare g(t)"
        score = replace(score, refused=reason)
    return score


def normalizing_baselines(experiment: Experiment, band: Band) -> Mapping[str, Baseline]:
    """Return the published distances of real trials that normalize scores, by metric; empty if there are none."""
    is_normalized = band.normalized and not band.kind.is_solution
    if not is_normalized:
        return {}
    return {
        metric: row
        for metric, row in experiment.baselines.items()
        if row.mean and not row.disputed
    }


@dataclass(frozen=True, kw_only=True)
class _ComparedMotion:
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


def _with_distances(score: Score, motion: _ComparedMotion) -> Score:
    """Return a score with the distances of a motion from its reference."""
    band, frames = motion.band, motion.frames
    rmse = trajectory_rmse(frames, band.mean)
    # A recording may end before the episode. DTW would warp frames without a mean onto its last frame.
    dtw = trajectory_dtw(frames[band.known], band.mean[band.known])
    score = replace(
        score,
        rmse=rmse,
        dtw=dtw,
        compared_frames=int(band.compared.known.sum()),
        signed_error=tuple(signed_error(frames, band.mean).tolist()),
    )
    if band.kind.is_solution:
        return _over_uncertainty(score, motion, rmse)
    published = normalizing_baselines(motion.experiment, band)
    score = replace(
        score,
        rmse_normalized=_over_published(rmse, published.get("rmse")),
        dtw_normalized=_over_published(dtw, published.get("dtw")),
    )
    return _in_scatter(_over_real_trials(score, motion, rmse), motion)


def _over_published(distance: float, published: Baseline | None) -> float | None:
    """Return a distance over the published mean of real trials; None without one."""
    return None if published is None else distance / published.mean


def _over_uncertainty(score: Score, motion: _ComparedMotion, rmse: float) -> Score:
    """Return a score with the distance from a solution over its standard uncertainty."""
    band = motion.band
    score = replace(score, primary=OVER_U)
    if band.points is None:
        interval = distance_interval(rmse, band.standard_uncertainty)
        score = replace(score, rmse_95=interval)
    deviation = motion.compared_deviation
    if deviation is None:
        return score
    distance = band.compared.length(deviation)
    if band.compared.marker_count > 1:
        score = replace(score, marker_rmse_mm=distance)
    ratio = distance / band.standard_uncertainty
    return replace(
        score, over_uncertainty=ratio, primary_interval=distance_interval(ratio, 1.0)
    )


def _over_real_trials(score: Score, motion: _ComparedMotion, rmse: float) -> Score:
    """Return a score with the interval of its primary distance, and its place among real trials."""
    band, experiment = motion.band, motion.experiment
    score = replace(
        score, primary="rmse", rmse_95=_real_interval(band, rmse, motion.deviation)
    )
    of_trials = band.trial_rmse
    if band.has_release and experiment.trial is None:
        offset_s, aligned = time_offset(motion.times_s, motion.samples, band.mean)
        score = _aligned(score, motion, offset_s, aligned)
        if not experiment.scene.drivers:
            score = replace(score, primary="rmse_aligned")
            of_trials = band.trial_rmse_aligned
    if of_trials is not None:
        score = replace(score, real_limit=prediction_limit(of_trials))
    return replace(score, primary_interval=_primary_interval(score, motion))


def _primary_interval(score: Score, motion: _ComparedMotion) -> Interval | None:
    """Return the interval of the primary distance over the mean of real trials, whose error counts too."""
    band = motion.band
    if not score.distance or score.primary_normalized is None:
        return None
    baseline = score.distance / score.primary_normalized
    if score.primary == "rmse_aligned":
        assert band.trial_rmse_aligned is not None and score.rmse_aligned_95 is not None
        half = mean_half_width(band.trial_rmse_aligned)
        if band.baseline_uncertainty is not None:
            freedom = len(band.trial_rmse_aligned) - 1
            half = student_t(freedom) * band.baseline_uncertainty
        return ratio_interval(score.distance, score.rmse_aligned_95, baseline, half)
    published = normalizing_baselines(motion.experiment, band)["rmse"]
    error = (published.std or 0.0) / math.sqrt(PUBLISHED_TRIALS)
    half = student_t(PUBLISHED_TRIALS - 1) * error
    assert score.rmse_95 is not None
    return ratio_interval(score.distance, score.rmse_95, baseline, half)


def _aligned(
    score: Score, motion: _ComparedMotion, offset_s: float, rmse: float
) -> Score:
    """Return a score with the distance after the best time shift."""
    band, frame_count = motion.band, len(motion.band.mean)
    shifted = shifted_frames(
        motion.times_s, motion.samples, offset_s, frame_count=frame_count
    )
    velocity = None
    # At the bound, the shift cannot follow an error of the mean.
    if abs(offset_s) < MAX_TIME_OFFSET_S - 1e-6:
        velocity = shifted_frames(
            motion.times_s,
            np.gradient(motion.samples, motion.times_s, axis=0),
            offset_s,
            frame_count=frame_count,
        )
        # The simulation rests before its start.
        velocity[np.arange(frame_count) / FRAME_RATE_HZ < offset_s] = 0.0
    return replace(
        score,
        time_offset_s=offset_s,
        rmse_aligned=rmse,
        rmse_aligned_95=_real_interval(band, rmse, shifted - band.mean, velocity),
        rmse_aligned_normalized=_over_trials(rmse, band),
    )


def _over_trials(rmse_aligned: float, band: Band) -> float | None:
    """Return an aligned distance over the mean of the same distance of real trials; None without a mean."""
    if band.trial_rmse_aligned is None:
        return None
    mean = float(band.trial_rmse_aligned.mean())
    return rmse_aligned / mean if 0.0 < mean < math.inf else None


def _real_interval(
    band: Band,
    distance: float,
    deviation: FloatArray,
    velocity: FloatArray | None = None,
) -> Interval:
    """Return the 95 % interval of a distance from real trials; see `trials_interval` for the arguments."""
    if band.trials is None or len(band.trials) < 2:
        return distance_interval(distance, band.standard_uncertainty)
    return trials_interval(
        deviation, band.trials, velocity=velocity, uncertainty=band.uncertainty
    )


def _with_cause(score: Score, motion: _ComparedMotion) -> Score:
    """Return a score with that of the exact motion at the same times, and with the cause of its distance."""
    solution = exact_solution(motion.experiment)
    if solution is None or score.primary_normalized is None:
        return score
    exact_score = _exact_score(score, motion, solution)
    score = replace(score, exact=exact_score.primary_normalized)
    if score.verdict is ScoreVerdict.INSIDE:
        return replace(score, cause=DistanceCause.NONE)
    if exact_score.verdict is ScoreVerdict.INSIDE:
        return replace(score, cause=DistanceCause.ENGINE)
    is_near = _ratio_to_exact(score, motion, solution) <= NEAR_EXACT
    return replace(
        score, cause=DistanceCause.CONSTANTS if is_near else DistanceCause.BOTH
    )


def _exact_score(
    score: Score, motion: _ComparedMotion, solution: MotionOfTime
) -> Score:
    """Return a score with the primary distance of the exact motion at the times of the scored motion."""
    band = motion.band
    samples = band.project(solution(motion.times_s))
    if score.primary == "rmse_aligned":
        _, distance = time_offset(motion.times_s, samples, band.mean)
        ratio = _over_trials(distance, band)
        return replace(score, rmse_aligned=distance, rmse_aligned_normalized=ratio)
    frames = samples[frame_index(motion.times_s, len(motion.frames))]
    distance = trajectory_rmse(frames, band.mean)
    published = normalizing_baselines(motion.experiment, band).get("rmse")
    ratio = _over_published(distance, published)
    return replace(score, rmse=distance, rmse_normalized=ratio)


def _ratio_to_exact(
    score: Score, motion: _ComparedMotion, solution: MotionOfTime
) -> float:
    """Return the distance of a motion from the exact one over the mean distance of real trials."""
    distance, ratio = score.distance, score.primary_normalized
    assert distance and ratio, "the motion has a distance from the trials"
    from_exact = distance_from_exact(
        solution,
        motion.band,
        motion.frames,
        is_aligned=score.primary == "rmse_aligned",
        time_offset_s=score.time_offset_s or 0.0,
    )
    of_trials = distance / ratio
    return from_exact / of_trials


def _in_scatter(score: Score, motion: _ComparedMotion) -> Score:
    """Return a score with the place of a motion in the scatter of real trials at measured frames."""
    band = motion.band
    # Extrapolated frames have a usable mean. Their scatter was not measured.
    sigma = np.where(band.measured[:, None], band.sigma, np.nan)
    z = np.abs(z_scores(motion.frames, band.mean, sigma))
    z = z[np.isfinite(z)]
    if not z.size:
        return score
    return replace(score, mean_abs_z=float(z.mean()))


def _events(
    experiment: Experiment,
    times_s: FloatArray,
    values: FloatArray,
    frames: FloatArray,
    markers_m: FloatArray | None,
) -> dict[str, ComparedQuantity]:
    """Return the events of an episode with the published and the recorded values."""
    if not has_real_structure(experiment):
        return {}
    events = {}
    for metric, value in event_values(experiment, frames).items():
        row = experiment.baselines.get(metric)
        std = None if row is None else row.std
        events[metric] = _event(
            value,
            unit=METRICS[metric].unit or experiment.score.observable.unit,
            real=None if row is None else row.mean,
            real_uncertainty=None if std is None else std / math.sqrt(PUBLISHED_TRIALS),
        )
    if markers_m is None and experiment.scene.markers is not None:
        return events
    for event in recorded_events(experiment.name):
        motion = SampledMotion(
            scene=experiment.scene,
            times_s=times_s,
            samples=values,
            markers_m=np.empty((len(frames), 0, 3)) if markers_m is None else markers_m,
            markers=event.markers,
        )
        events[event.name] = _event(
            EVENTS[event.name](motion),
            unit=event.unit,
            real=event.value,
            real_uncertainty=event.standard_uncertainty,
        )
    return events


def _event(
    value: float, *, unit: str, real: float | None, real_uncertainty: float | None
) -> ComparedQuantity:
    """Return an event with its real value; NaN is an event that does not happen."""
    known = None if math.isnan(value) else value
    return ComparedQuantity(
        value=known, unit=unit, real=real, real_uncertainty=real_uncertainty
    )
