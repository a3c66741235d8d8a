"""The score of an episode: how far its motion is from the reference, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
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
from gauge_envs.scoring.answers import (
    Answer,
    is_like_trials,
    mattering_distance,
    normalizing_baselines,
    real_limit,
    solves,
    united,
    within,
)
from gauge_envs.scoring.cause import DistanceCause, cause_of, distance_from_exact
from gauge_envs.scoring.estimates import ComparedQuantity, estimates
from gauge_envs.scoring.events import PUBLISHED_TRIALS, event_values
from gauge_envs.scoring.exact import MotionOfTime, exact_solution
from gauge_envs.scoring.interval import (
    distance_interval,
    distances_without,
    jackknife_half_width,
    mean_half_width,
    ratio_interval,
    student_t,
    trials_interval,
)
from gauge_envs.scoring.metrics import (
    MAX_TIME_OFFSET_S,
    frame_index,
    shifted_frames,
    time_offset,
    trajectory_dtw,
    trajectory_rmse,
)
from gauge_envs.scoring.recorded_events import EVENTS, SampledMotion
from gauge_envs.scoring.reference import has_real_structure, refusal
from gauge_envs.scoring.user_file.likely_mistakes import value_mistake

FROM_SOLUTION = "solution_distance"
"""Value of `Score.primary` for a solution."""

EVENT_WORDS = {
    "lsd": "longest rest",
    "mte": "momentum transfer",
    "pd": "period",
    "el": "energy loss",
}
"""Words for the events of the paper, by name."""

Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True, repr=False)
class Score:
    """Distances of an episode from its references, and what they mean. A field is None if it does not apply.

    | field | unit | meaning |
    | --- | --- | --- |
    | `kind` | | a `Kind`, as `trials`, `published` or `analytic`: what the reference motion is |
    | `unit` | | unit of g(t) |
    | `distance_unit` | | unit of `distance`: mm for solutions of cloth and foam, whose markers are compared |
    | `solves` | | whether the motion solves the scene: `yes`, `no`, `cannot tell`; None without a solution |
    | `like_reality` | | whether motion and events are like real ones; None if nothing real is known |
    | `solution_distance` | `distance_unit` | distance from the solution, or from the exact motion of a scene |
    | `solution_motion` | `distance_unit` | root mean square displacement of that solution |
    | `primary_interval` | 1 | 95 % interval of the primary distance over that of real trials, or over the motion |
    | `exact` | 1 | the primary ratio of the exact motion with the same constants, at the same times |
    | `cause` | | `none`, `constants`, `engine` or `both` (`DistanceCause`): what causes the distance from real trials |
    | `rmse` | unit | E_RMSE of the paper |
    | `rmse_normalized` | 1 | `rmse` over the published mean of real trials |
    | `dtw`, `dtw_normalized` | unit, 1 | E_DTW of the paper, and over the published mean of real trials |
    | `time_offset_s` | s | time shift with the smallest RMSE; positive if the real object is released later |
    | `rmse_aligned` | unit | RMSE after that shift |
    | `rmse_aligned_normalized` | 1 | `rmse_aligned` over the mean of the same distance of real trials |
    | `real_limit` | unit | primary distance within which one more real trial lies with a probability of 95 % |
    | `compared_frames` | | frames at which `distance` compares: those with known markers for cloth and foam |
    | `events` | each | `lsd`, `mte`, `pd`, `el` and recorded events, by name (`ComparedQuantity`) |
    | `estimates` | each | friction, restitution, ringing of this motion and of real trials (`ComparedQuantity`) |
    | `refused` | | why the reference cannot score this motion, one sentence |
    """

    PRINTED: ClassVar[tuple[str, ...]] = ("primary", "distance", "primary_normalized")
    """Properties that `to_dict` adds to the fields."""

    kind: str
    unit: str
    distance_unit: str = ""
    solves: Answer | None = None
    like_reality: Answer | None = None
    solution_distance: float | None = None
    solution_motion: float | None = None
    primary_interval: Interval | None = None
    exact: float | None = None
    cause: DistanceCause | None = None
    rmse: float | None = None
    rmse_normalized: float | None = None
    dtw: float | None = None
    dtw_normalized: float | None = None
    time_offset_s: float | None = None
    rmse_aligned: float | None = None
    rmse_aligned_normalized: float | None = None
    real_limit: float | None = None
    compared_frames: int | None = None
    events: Mapping[str, ComparedQuantity] = field(default_factory=dict, hash=False)
    estimates: Mapping[str, ComparedQuantity] = field(default_factory=dict, hash=False)
    refused: str | None = None

    @property
    def primary(self) -> str | None:
        """Distance that reports show first: `rmse`, `rmse_aligned` or `solution_distance`."""
        if Kind(self.kind).is_solution:
            return FROM_SOLUTION
        names = (
            name for name in ("rmse_aligned", "rmse") if getattr(self, name) is not None
        )
        return next(names, None)

    @property
    def distance(self) -> float | None:
        """The primary distance in `distance_unit`; None without one."""
        value: float | None = getattr(self, self.primary) if self.primary else None
        return value

    @property
    def primary_normalized(self) -> float | None:
        """The primary distance over that of real trials, or over the motion of a solution."""
        if self.primary is None:
            return None
        if self.primary != FROM_SOLUTION:
            value: float | None = getattr(self, f"{self.primary}_normalized")
            return value
        if self.solution_distance is None or not self.solution_motion:
            return None
        return self.solution_distance / self.solution_motion

    def summary(self) -> str:
        """Return both answers in one sentence, with the numbers that they follow from."""
        text = f"{self._solution_text}; {self._reality_text}"
        if self.refused is not None:
            text = f"no distance, because {self.refused}"
            if self.like_reality is not None:
                text += f"; {self._reality_text}"
        return f"{text[0].upper()}{text[1:]}."

    @property
    def _solution_text(self) -> str:
        """The first answer, as `solves the scene (0.034 mm of 27)`."""
        words = {
            Answer.YES: "solves the scene",
            Answer.NO: "does not solve the scene",
            Answer.CANNOT_TELL: "cannot tell whether it solves the scene",
        }
        if self.solves is None or self.solution_distance is None:
            return "no solution of the scene is known"
        distance, motion = _text(self.solution_distance), _text(self.solution_motion)
        return f"{words[self.solves]} ({distance} {self.distance_unit} of {motion})"

    @property
    def _reality_text(self) -> str:
        """The second answer, as `unlike reality: 3.33 mm, 4.95 times as far as real trials`."""
        words = {
            Answer.YES: "like reality",
            Answer.NO: "unlike reality",
            Answer.CANNOT_TELL: "cannot tell whether it is like reality",
            None: "nothing real to compare with",
        }
        parts = []
        if self.primary != FROM_SOLUTION and self.distance is not None:
            parts.append(f"{_text(self.distance)} {self.distance_unit}")
            if self.primary_normalized is not None:
                parts.append(self._scaled_text(self.primary_normalized))
        parts += self._measured_texts[:2]
        return ": ".join(filter(None, (words[self.like_reality], ", ".join(parts))))

    @property
    def _measured_texts(self) -> list[str]:
        """Events and estimates, each with its real value."""
        measured = {**self.events, **self.estimates}
        return [_compared_text(name, quantity) for name, quantity in measured.items()]

    def _scaled_text(self, ratio: float) -> str:
        """Return the distance over that of real trials in words."""
        owner = "published trials" if self.kind == Kind.PUBLISHED else "real trials"
        text = f"{_text(ratio)} times as far as {owner}"
        if self.primary_interval is not None:
            low, high = (_text(end) for end in self.primary_interval)
            text += f" [{low}, {high}]"
        if self.exact is not None:
            text += f", an exact solver {_text(self.exact)}"
        return text

    def __repr__(self) -> str:
        """Return at most ten lines; `to_dict` has all numbers."""
        left_out = ("events", "estimates", "refused")
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


def _text(value: float | None) -> str:
    """Return a number with three digits."""
    if value is None:
        return "-"
    if 0.0 < abs(value) < 5e-4:
        return "0.000"
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
    events = _events(experiment, times_s, values, frames, markers_m)
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
    motion = _ComparedMotion(
        experiment=experiment,
        band=band,
        times_s=times_s,
        samples=band.project(values),
        frames=band.project(frames),
        markers_m=markers_m,
    )
    score = _with_distances(score, motion)
    if band.kind.is_solution:
        return _from_solution(score, motion)
    score = _from_trials(score, motion)
    # The exact motion has the nominal start.
    return score if is_moved else _from_exact(score, motion)


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
    """Return a score with the distances of the paper."""
    band, frames = motion.band, motion.frames
    rmse = trajectory_rmse(frames, band.mean)
    # A recording may end before the episode. DTW would warp frames without a mean onto its last frame.
    dtw = trajectory_dtw(frames[band.known], band.mean[band.known])
    published = normalizing_baselines(motion.experiment, band)
    return replace(
        score,
        rmse=rmse,
        rmse_normalized=_over_published(rmse, published.get("rmse")),
        dtw=dtw,
        dtw_normalized=_over_published(dtw, published.get("dtw")),
        compared_frames=int(band.compared.known.sum()),
    )


def _over_published(distance: float, published: Baseline | None) -> float | None:
    """Return a distance over the published mean of real trials; None without one."""
    return None if published is None else distance / published.mean


def _from_solution(score: Score, motion: _ComparedMotion) -> Score:
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


def _from_trials(score: Score, motion: _ComparedMotion) -> Score:
    """Return a score with the distance from real trials, and whether the motion is like theirs."""
    band, experiment = motion.band, motion.experiment
    # The start of a driven motion is known.
    is_free = experiment.trial is None and not experiment.scene.drivers
    is_aligned = band.has_release and is_free
    with_distance = _aligned if is_aligned else _unaligned
    score = with_distance(score, motion)
    assert score.distance is not None, "the RMSE is a distance"
    limit = real_limit(experiment, band, is_aligned=is_aligned)
    of_motion = is_like_trials(band, score.distance, limit)
    answer = united([of_motion, score.like_reality])
    return replace(score, real_limit=limit, like_reality=answer)


def _unaligned(score: Score, motion: _ComparedMotion) -> Score:
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
    interval = ratio_interval(ratio, _relative(ends, distance), half_width)
    return replace(score, primary_interval=interval)


def _relative(ends: Interval, distance: float) -> Interval:
    """Return an interval over the distance that it belongs to."""
    low, high = ends
    return low / distance, high / distance


def _aligned(score: Score, motion: _ComparedMotion) -> Score:
    """Return a score with the distance after the best time shift."""
    band, frame_count = motion.band, len(motion.band.mean)
    offset_s, rmse = time_offset(motion.times_s, motion.samples, band.mean)
    ratio = _over_trials(rmse, band)
    score = replace(
        score,
        time_offset_s=offset_s,
        rmse_aligned=rmse,
        rmse_aligned_normalized=ratio,
    )
    trials = band.trials
    if not rmse or ratio is None or trials is None or len(trials) < 2:
        return score
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
    deviation = shifted - band.mean
    ends = trials_interval(
        deviation, trials, velocity=velocity, uncertainty=band.uncertainty
    )
    half_width, correlation = _error_of_baseline(band, deviation)
    interval = ratio_interval(ratio, _relative(ends, rmse), half_width, correlation)
    return replace(score, primary_interval=interval)


def _error_of_baseline(band: Band, deviation: FloatArray) -> tuple[float, float]:
    """Return half the 95 % interval of the logarithm of the mean distance of trials, and its correlation.

    The correlation is that with the logarithm of the length of a deviation from their mean, shape [T, C].
    """
    assert band.trials is not None and band.trial_rmse_aligned is not None
    if band.baselines_without is None:
        distances = band.trial_rmse_aligned
        return mean_half_width(distances) / float(distances.mean()), 0.0
    of_baseline = np.log(band.baselines_without)
    of_distance = np.log(distances_without(deviation, band.trials))
    half_width = jackknife_half_width(of_baseline)
    if half_width == 0.0 or np.ptp(of_distance) == 0.0:
        return half_width, 0.0
    return half_width, float(np.corrcoef(of_distance, of_baseline)[0, 1])


def _over_trials(rmse_aligned: float, band: Band) -> float | None:
    """Return an aligned distance over the mean of the same distance of real trials; None without a mean."""
    if band.trial_rmse_aligned is None:
        return None
    mean = float(band.trial_rmse_aligned.mean())
    return rmse_aligned / mean if 0.0 < mean < math.inf else None


def _from_exact(score: Score, motion: _ComparedMotion) -> Score:
    """Return a score with the distance from the exact motion, and the cause of the distance from real trials."""
    solution = exact_solution(motion.experiment)
    if solution is None:
        return score
    band, times_s = motion.band, np.arange(len(motion.frames)) / FRAME_RATE_HZ
    exact = band.project(solution(times_s))
    size = trajectory_rmse(exact, np.broadcast_to(exact[:1], exact.shape))
    distance = trajectory_rmse(motion.frames, exact)
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
    return score if of_trials is None else _with_cause(score, motion, solution, limit)


def _with_cause(
    score: Score, motion: _ComparedMotion, solution: MotionOfTime, limit: float
) -> Score:
    """Return a score with the ratio of the exact motion at the same times, and with the cause of the distance.

    Args:
        score: A score with a normalized distance from real trials.
        motion: The motion.
        solution: The exact motion.
        limit: Smallest distance from it that matters.
    """
    experiment, band = motion.experiment, motion.band
    samples = band.project(solution(motion.times_s))
    is_aligned = score.primary == "rmse_aligned"
    if is_aligned:
        _, distance = time_offset(motion.times_s, samples, band.mean)
        ratio = _over_trials(distance, band)
    else:
        frames = samples[frame_index(motion.times_s, len(motion.frames))]
        distance = trajectory_rmse(frames, band.mean)
        published = normalizing_baselines(experiment, band).get("rmse")
        ratio = _over_published(distance, published)
    from_exact = distance_from_exact(
        solution,
        band,
        motion.frames,
        is_aligned=is_aligned,
        time_offset_s=score.time_offset_s or 0.0,
    )
    of_engine = score.distance
    assert of_engine is not None and score.real_limit is not None, "as documented"
    cause = cause_of(
        is_real=of_engine <= score.real_limit,
        is_exact_real=distance <= score.real_limit,
        is_near_exact=from_exact <= limit,
    )
    return replace(score, exact=ratio, cause=cause)


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
