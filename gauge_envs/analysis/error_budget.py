"""An error budget: how much of an episode's RMSE is release time, constant offset, scale or rate, and the rest.

The simulated trajectory is changed so that it fits the mean of reality best, and what a change takes off the mean
squared error is its part of the budget. Three stages, each a change that has a meaning in the laboratory:

- `release`: it is played later by a constant time and held at both ends, as `release_offset` of the score does;
- `offset`: a constant is added, one number a coordinate;
- `rate`: the motion is faster or larger, in the quantity that it has (`analysis.motion_kinds.MotionKind`): another
  acceleration, restitution, period and amplitude, or in general a stretch of time and of displacement.

Stages are nested least squares: each adds its change to those before it, and all of them are fitted again. So the
squared error only falls, its parts and the rest add up to the whole, and so do the falls of the RMSE. The split depends
on the order, as changes can stand in for each other; so beside it stands what a stage takes off `alone`, and what it
takes off as the `last` of the three. Frames are those of the score: all, extrapolated ones too, as in the paper.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gauge_envs.analysis.budget_fit import MAX_SHIFT_S, BudgetStage, FloatArray, _Budget, _Fit
from gauge_envs.analysis.motion_kinds import Change, MotionKind, recognized
from gauge_envs.errors import GaugeError, ParameterError, ShapeError
from gauge_envs.evaluation.reference import load_band, reference_band
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band, BandGrade
from gauge_envs.references.published import Baseline
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.scene_record import recorded_experiment
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "DEFAULT_ORDER",
    "MARKERS",
    "SEVERAL_BODIES",
    "Diagnosis",
    "DiagnosisError",
    "PublishedScore",
    "Remainder",
    "StagePart",
    "diagnose",
    "diagnose_trajectory",
    "stage_order",
]


STILL_SHARE = 0.1
"""A real motion below this share of the scatter of the trials is none, so that it has no rate."""


INSEPARABLE = 0.95
"""Squared cosine between two changes from which on noise decides which of them the fit takes."""


CLOSE_TO_BOUND = 1e-3
"""Share of a range within which a fit counts as ended at its limit."""

NO_PUBLISHED_SPLIT = (
    "only scalar scores are published: a split of the RMSE needs the trajectory. DTW over RMSE, both in the unit of "
    "g(t), says how much is left where time may be warped at will; PD is the period over the real one."
)


class DiagnosisError(GaugeError, ValueError):
    """An episode has no error budget; the message says what is missing."""


DEFAULT_ORDER = (BudgetStage.RELEASE, BudgetStage.OFFSET, BudgetStage.RATE)


@dataclass(frozen=True, kw_only=True)
class StagePart:
    """What one stage takes off the error.

    Squared errors are means over frames of the squared Euclidean deviation, in the squared unit of g(t).

    Attributes:
        stage: Which one.
        missing: Why it does not apply; None where it does. Then it explains 0.
        explained: What it takes off the mean squared error after the stages before it.
        share: The same over the whole mean squared error.
        rmse_before: RMSE before it.
        rmse_after: RMSE after it.
        rmse_before_normalized: Over the published baseline; None where none is published.
        rmse_after_normalized: The same.
        alone_share: What it takes off as the only change, over the whole.
        last_share: What it takes off after both others, over the whole.
        by_coordinate: What it takes off each coordinate's mean squared error, shape [C]; negative where a coordinate
            pays for the others. It sums to `explained`.
        changes: All changes in force after it, its own among them, as fitted together.
        alone_changes: Its own changes where it is the only one.
    """

    stage: BudgetStage
    missing: str | None
    explained: float
    share: float
    rmse_before: float
    rmse_after: float
    rmse_before_normalized: float | None
    rmse_after_normalized: float | None
    alone_share: float
    last_share: float
    by_coordinate: tuple[float, ...]
    changes: tuple[Change, ...]
    alone_changes: tuple[Change, ...]


@dataclass(frozen=True, kw_only=True)
class Remainder:
    """What no stage explains: its mean squared error, share of the whole, and RMSE."""

    mean_square: float
    share: float
    rmse: float
    rmse_normalized: float | None
    by_coordinate: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class PublishedScore:
    """What can be said of a published engine.

    Attributes:
        rmse: RMSE in the unit of g(t), from the normalized score; None where none was published.
        rmse_normalized: As published.
        dtw_normalized: As published.
        dtw_over_rmse: Ratio of the two in the unit of g(t).
        period_ratio: Period over the real mean, as published.
    """

    rmse: float | None
    rmse_normalized: float | None
    dtw_normalized: float | None
    dtw_over_rmse: float | None
    period_ratio: float | None


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The error budget of one episode.

    Attributes:
        id: Gymnasium id.
        grade: Grade of the band.
        source: Where the band is from.
        unit: Unit of g(t) and of every RMSE.
        baseline: Published mean RMSE of the real trials, by which RMSEs are normalized; None where there is none.
        coordinates: Names of the band coordinates.
        kind: What the simulated motion does, which decides what `rate` means.
        subject: What is observed, as `the ball`.
        driven: Whether something in the scene follows a recorded motion, so that nothing is let go.
        frames: Frames counted.
        extrapolated_frames: Those of them that the band extrapolates.
        extrapolated_share: Share of the squared error that lies in them.
        mean_square: Mean squared error.
        rmse: Its root: the RMSE of the score, unless `measured_only`.
        rmse_normalized: Over the baseline.
        dtw_over_rmse: DTW of the score over its RMSE; None where it is not known.
        measured_only: Whether extrapolated frames were left out.
        by_coordinate: Mean squared error of each coordinate, shape [C].
        parts: The stages in the order in which they were added.
        rest: What is left.
        published: What is known of the published engines; the split is not, see `published_note`.
        published_note: Why.
        notes: What to know about this budget.
    """

    id: str
    grade: str
    source: str
    unit: str
    baseline: float | None
    coordinates: tuple[str, ...]
    kind: MotionKind
    subject: str
    driven: bool
    frames: int
    extrapolated_frames: int
    extrapolated_share: float
    mean_square: float
    rmse: float
    rmse_normalized: float | None
    dtw_over_rmse: float | None
    measured_only: bool
    by_coordinate: tuple[float, ...]
    parts: tuple[StagePart, ...]
    rest: Remainder
    published: Mapping[str, PublishedScore]
    published_note: str = NO_PUBLISHED_SPLIT
    notes: tuple[str, ...] = ()

    def axes(self) -> dict[str, tuple[int, ...]]:
        """Coordinates by what they are along: `marker-3.x` counts to `x`; one that names no axis is its own."""
        groups: dict[str, list[int]] = {}
        for index, name in enumerate(self.coordinates):
            groups.setdefault(name.rpartition(".")[2], []).append(index)
        return {axis: tuple(indices) for axis, indices in groups.items()}

    def part(self, stage: BudgetStage) -> StagePart:
        """The part of one stage."""
        return next(part for part in self.parts if part.stage is stage)


# --- entry points ----------------------------------------------------------------------------------------------------


def diagnose(
    result: Result,
    *,
    band: Band | None = None,
    order: Sequence[BudgetStage] = DEFAULT_ORDER,
    measured_only: bool = False,
    use_withheld: bool = False,
) -> Diagnosis:
    """Error budget of a result.

    Args:
        result: Result of an episode that ran to its end, or of a trajectory that a user brought.
        band: What to measure against; None takes the experiment's own, also a withheld one where the result was scored
            on that.
        order: Stages in the order in which they are added, each once.
        measured_only: Leave out the frames that the band extrapolates; then the whole is not the score's RMSE.
        use_withheld: Take a band too that is withheld by default; `gauge show` tells why it is.

    Raises:
        DiagnosisError: It did not run to its end, or there is no band for it.
        ParameterError: The order is not one of the three stages.
    """
    if result.outcome is not Outcome.FINISHED or result.trajectory is None:
        reason = result.error or result.diverged_reason or "it holds no trajectory"
        raise DiagnosisError(f"{result.id}: {result.outcome.value}, so that there is no score to explain: {reason}")
    experiment = recorded_experiment(result)
    if band is None:
        band = reference_band(experiment, use_withheld=use_withheld or result.score.withheld is not None)
    times_s, values = result.trajectory.arrays()
    if band is not None and (own := values.shape[1]) != (taken := band.projection.shape[1]):
        raise DiagnosisError(
            f"{result.id}: its trajectory has {own} coordinates, the band takes {taken}: it was made with another "
            "version of the task file; run it again"
        )
    diagnosis = diagnose_trajectory(
        experiment,
        band,
        times_s=times_s,
        values=values,
        order=order,
        measured_only=measured_only,
    )
    rmse, dtw = result.score.rmse, result.score.dtw
    if measured_only:
        return diagnosis
    if rmse is None or not math.isclose(rmse, diagnosis.rmse, rel_tol=1e-6, abs_tol=1e-9):
        stated = "without an RMSE" if rmse is None else f"an RMSE of {rmse:.4g} {diagnosis.unit}"
        note = f"the score in the result, {stated}, was not made against this band (its grade: {result.score.grade})"
        return replace(diagnosis, notes=(*diagnosis.notes, note))
    return replace(diagnosis, dtw_over_rmse=None if dtw is None or rmse == 0.0 else dtw / rmse)


def diagnose_trajectory(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
    order: Sequence[BudgetStage] = DEFAULT_ORDER,
    measured_only: bool = False,
) -> Diagnosis:
    """Error budget of a generalized trajectory.

    Args:
        experiment: The experiment that it is of.
        band: What to measure against.
        times_s: Times of the samples from frame 0 on [s], strictly increasing, shape [sample_count]; they must reach
            the last frame. 180 samples a second or more make times exact.
        values: g(t) at those times, shape [sample_count, coordinate_count].
        order: Stages in the order in which they are added, each once.
        measured_only: Leave out the frames that the band extrapolates.

    Raises:
        DiagnosisError: There is no band, or it says nothing about any frame.
        ParameterError: The order is not one of the three stages.
        ShapeError: Times or values do not fit the experiment, or are not finite.
    """
    stages = stage_order(order)
    if band is None:
        raise DiagnosisError(f"{experiment.id}: {_why_no_band(experiment.name)}")
    times_s, values = _checked(times_s, values, len(band.mean))
    reference = np.where(band.measured[:, None], band.mean, np.nan) if measured_only else np.array(band.mean)
    if not np.isfinite(reference).any():
        raise DiagnosisError(f"{experiment.id}: its band has no {'measured ' if measured_only else ''}frame")
    simulated = band.project(values)
    last_s = float(np.flatnonzero(np.isfinite(reference).any(axis=1))[-1]) / FRAME_RATE_HZ
    motion = recognized(experiment, band, times_s, simulated, until_s=last_s)
    budget = _Budget(reference, times_s, simulated, motion, _missing(band, simulated))
    return _diagnosis(experiment, band, budget, stages, measured_only=measured_only)


def stage_order(names: Iterable[str]) -> tuple[BudgetStage, ...]:
    """Stages by name.

    Raises:
        ParameterError: They are not the three stages, each once.
    """
    given = list(names)
    known = [stage.value for stage in DEFAULT_ORDER]
    if sorted(given) != sorted(known):
        raise ParameterError(f"order is {', '.join(given) or 'empty'}, expected each of {', '.join(known)} once")
    return tuple(BudgetStage(name) for name in given)


def _why_no_band(variant: str) -> str:
    found = load_band(variant)
    if found is not None and found.withheld is not None:
        return f"its band is withheld: {found.withheld}; use_withheld=True or --use-withheld splits the error to it"
    return (
        "there is no reference band (grade none), so no error to split; it needs the mean of real trials "
        "(gauge data import), of a recording or of a law"
    )


def _checked(times_s: FloatArray, values: FloatArray, frame_count: int) -> tuple[FloatArray, FloatArray]:
    times_s, values = np.asarray(times_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if times_s.ndim != 1 or values.ndim != 2 or len(times_s) != len(values) or len(times_s) < 2:
        raise ShapeError(
            f"times_s has shape {times_s.shape}, values {values.shape}; [T] and [T, C] with T > 1 are needed"
        )
    if not (np.isfinite(times_s).all() and np.isfinite(values).all()):
        raise ShapeError("the trajectory holds a value that is not finite")
    end_s = (frame_count - 1) / FRAME_RATE_HZ
    if abs(times_s[0]) > 1e-6 or (np.diff(times_s) <= 0.0).any() or times_s[-1] < end_s - 1e-6:
        raise ShapeError(
            f"times_s must increase from 0 to the last frame at {end_s:.4f} s; it runs to {times_s[-1]:.4f} s"
        )
    return times_s, values


def _missing(band: Band, simulated: FloatArray) -> dict[BudgetStage, str]:
    """Stages that do not apply, and why."""
    missing = {}
    if band.grade is BandGrade.LAW:
        # As in the score: a law is exact from frame 0 on, and a shift would only hide a drift.
        missing[BudgetStage.RELEASE] = "a law has no release: it holds from frame 0 on"
    real = float(np.sqrt(np.nanmean(np.square(band.mean - np.nanmean(band.mean, axis=0)))))
    own = float(np.sqrt(np.mean(np.square(simulated - simulated[0]))))
    scatter = float(np.sqrt(np.nanmean(np.square(band.sigma))))
    if real <= STILL_SHARE * scatter:
        missing[BudgetStage.RATE] = "the real mean does not move by more than a tenth of its scatter, so it has no rate"
    elif own <= 1e-3 * real:
        missing[BudgetStage.RATE] = "the simulation does not move, so it has no rate"
    return missing


# --- budget ----------------------------------------------------------------------------------------------------------


def _diagnosis(
    experiment: Experiment, band: Band, budget: _Budget, order: Sequence[BudgetStage], *, measured_only: bool
) -> Diagnosis:
    baselines = experiment.baselines
    baseline = baselines["rmse"].mean if "rmse" in baselines else None
    whole, left = budget.fit(()), budget.fit(order)
    deviations = budget.deviations()
    extrapolated = ~band.measured[budget.known]
    return Diagnosis(
        id=experiment.id,
        grade=band.grade.value,
        source=band.source,
        unit=band.unit,
        baseline=baseline,
        coordinates=band.coordinates,
        kind=budget.motion.kind,
        subject=_subject(experiment),
        driven=bool(experiment.scene.drivers),
        frames=budget.frame_count,
        extrapolated_frames=int(extrapolated.sum()),
        extrapolated_share=_over(float(deviations[extrapolated].sum()), float(deviations.sum())),
        mean_square=whole.mean_square,
        rmse=math.sqrt(whole.mean_square),
        rmse_normalized=_normalized(whole.mean_square, baseline),
        dtw_over_rmse=None,
        measured_only=measured_only,
        by_coordinate=tuple(whole.mean_squares.tolist()),
        parts=tuple(_part(budget, band, order, index, baseline) for index in range(len(order))),
        rest=Remainder(
            mean_square=left.mean_square,
            share=_over(left.mean_square, whole.mean_square),
            rmse=math.sqrt(left.mean_square),
            rmse_normalized=_normalized(left.mean_square, baseline),
            by_coordinate=tuple(left.mean_squares.tolist()),
        ),
        published=_published(baselines),
        notes=_notes(budget, band, order, measured_only=measured_only),
    )


def _part(budget: _Budget, band: Band, order: Sequence[BudgetStage], index: int, baseline: float | None) -> StagePart:
    stage = order[index]
    whole, before, after = budget.fit(()), budget.fit(order[:index]), budget.fit(order[: index + 1])
    alone, others, everything = budget.fit([stage]), budget.fit(set(order) - {stage}), budget.fit(order)
    return StagePart(
        stage=stage,
        missing=budget.missing.get(stage),
        explained=before.mean_square - after.mean_square,
        share=_over(before.mean_square - after.mean_square, whole.mean_square),
        rmse_before=math.sqrt(before.mean_square),
        rmse_after=math.sqrt(after.mean_square),
        rmse_before_normalized=_normalized(before.mean_square, baseline),
        rmse_after_normalized=_normalized(after.mean_square, baseline),
        alone_share=_over(whole.mean_square - alone.mean_square, whole.mean_square),
        last_share=_over(others.mean_square - everything.mean_square, whole.mean_square),
        by_coordinate=tuple((before.mean_squares - after.mean_squares).tolist()),
        changes=_changes(budget, band, order[: index + 1], after),
        alone_changes=_changes(budget, band, [stage], alone),
    )


def _changes(budget: _Budget, band: Band, stages: Sequence[BudgetStage], fit: _Fit) -> tuple[Change, ...]:
    """What a fit changed, in the order of the stages."""
    motion = budget.motion
    told: dict[BudgetStage, tuple[Change, ...]] = {
        BudgetStage.RELEASE: (
            Change(
                quantity="release_time",
                unit="s",
                simulated=0.0,
                fitted=fit.shift_s,
                at_bound=_at_bound(fit.shift_s, (-MAX_SHIFT_S, MAX_SHIFT_S)),
            ),
        ),
        BudgetStage.OFFSET: tuple(
            Change(quantity="offset", unit=band.unit, simulated=0.0, fitted=float(value), coordinate=name)
            for name, value in zip(band.coordinates, fit.offsets, strict=True)
        ),
        BudgetStage.RATE: motion.changes(
            fit.rate,
            fit.scale,
            rate_at_bound=_at_bound(fit.rate, motion.rate_bounds),
            scale_at_bound=_at_bound(fit.scale, motion.scale_bounds),
        ),
    }
    return tuple(change for stage in stages if stage not in budget.missing for change in told[stage])


def _at_bound(value: float, bounds: tuple[float, float]) -> bool:
    close = CLOSE_TO_BOUND * (bounds[1] - bounds[0])
    return min(abs(value - bound) for bound in bounds) <= close


def _notes(budget: _Budget, band: Band, order: Sequence[BudgetStage], *, measured_only: bool) -> tuple[str, ...]:
    notes = []
    fit = budget.fit(order)
    late = budget.continued_frames(fit)
    if late:
        how = "periodically" if budget.motion.period_s is not None else "at constant velocity"
        notes.append(f"{late} frames of the faster motion lie past the end of the simulation, continued {how}")
    if budget.likeness(fit) > INSEPARABLE:
        notes.append("speed and displacement change this motion alike: the part is sure, how they share it is not")
    if measured_only:
        notes.append("frames that the band extrapolates are left out, so the whole is not the RMSE of the score")
    impact = budget.motion.impact
    if impact is not None and impact.until_s < budget.motion.end_s - 1e-9:
        notes.append(f"restitution acts on the flight after the first impact, which ends at {impact.until_s:.3f} s")
    if band.withheld is not None:
        notes.append(f"the band is withheld from scores: {band.withheld}")
    if len(band.coordinates) < 3 and band.unit == "mm":
        notes.append(f"the band has {', '.join(band.coordinates)} only; what is off across it is not in the RMSE")
    return tuple(notes)


def _published(baselines: Mapping[str, Baseline]) -> dict[str, PublishedScore]:
    engines = next((line.engines for line in baselines.values()), {})
    return {engine: _published_score(baselines, engine) for engine in engines}


def _published_score(baselines: Mapping[str, Baseline], engine: str) -> PublishedScore:
    normalized = {metric: value for metric, line in baselines.items() if (value := line.engines[engine]) is not None}
    rmse, dtw = (
        normalized[metric] * baselines[metric].mean if metric in normalized else None for metric in ("rmse", "dtw")
    )
    return PublishedScore(
        rmse=rmse,
        rmse_normalized=normalized.get("rmse"),
        dtw_normalized=normalized.get("dtw"),
        dtw_over_rmse=dtw / rmse if dtw is not None and rmse else None,
        period_ratio=normalized.get("pd"),
    )


def _over(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else 0.0


def _normalized(mean_square: float, baseline: float | None) -> float | None:
    return math.sqrt(mean_square) / baseline if baseline else None


# --- words -----------------------------------------------------------------------------------------------------------

MARKERS, SEVERAL_BODIES = "the markers", "the bodies"


def _subject(experiment: Experiment) -> str:
    if not experiment.recorded:
        return MARKERS
    return f"the {experiment.recorded[0]}" if len(experiment.recorded) == 1 else SEVERAL_BODIES
