"""Error budgets: an episode's RMSE split into release time, constant offset, rate or scale, and the rest.

The simulated trajectory is changed to fit the mean of the real trials best. The reduction of the mean squared error by
a change is its part of the budget. There are three stages, each a change with a meaning in the laboratory:

- `release`: the trajectory starts later by a constant time and is held at both ends, as for the score's
  `release_offset`;
- `offset`: one constant is added to each coordinate;
- `rate`: the motion is faster or larger, in the quantity of its kind (`evaluation.motion_kinds.MotionKind`): another
  acceleration, restitution, or period and amplitude; else a stretch of time and of displacement.

The stages are nested least squares: each adds its change to those before it, and all of them are fitted again. So the
squared error only falls, and its parts and the rest sum to the whole; so do the reductions of the RMSE. The split
depends on the order, because one change can replace another. Each part therefore also states the reduction by the stage
`alone` and as the `last` of the three. The frames are those of the score: all, including extrapolated ones, as in the
paper.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.errors import GaugeError, ParameterError, ShapeError
from gauge_envs.evaluation.motion_kinds import Change, recognized
from gauge_envs.evaluation.reference import load_band, reference_band
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.metrics import METRICS
from gauge_envs.references.published import Baseline
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.diagnose.budget_fit import MAX_SHIFT_S, NestedFits, StageFit
from gauge_envs.tools.diagnose.model import (
    MARKERS,
    SEVERAL_BODIES,
    BudgetStage,
    Diagnosis,
    PublishedScore,
    Remainder,
    StagePart,
)

DEFAULT_ORDER = (BudgetStage.RELEASE, BudgetStage.OFFSET, BudgetStage.RATE)
"""Default order of the stages."""

STILL_SHARE = 0.1
"""Real motion over scatter of the trials up to which the motion counts as none, so that it has no rate."""

INSEPARABLE = 0.95
"""Squared cosine between two changes above which noise decides between them."""

CLOSE_TO_BOUND = 1e-3
"""Distance to the end of a range, over its length, within which a fit counts as at its bound."""


class DiagnosisError(GaugeError, ValueError):
    """An episode has no error budget; the message states the reason."""


def diagnose(
    result: Result,
    *,
    band: Band | None = None,
    order: Sequence[BudgetStage] = DEFAULT_ORDER,
    measured_only: bool = False,
    use_withheld: bool = False,
) -> Diagnosis:
    """Return the error budget of a result.

    Args:
        result: Result of an episode that ran to its end, or of a trajectory file of a user.
        band: Band to compare with. None takes that of the experiment, also a withheld one if the result was scored
            against it.
        order: The three stages in the order in which they are added.
        measured_only: Leave out the frames that the band extrapolates; the whole is then not the score's RMSE.
        use_withheld: Take also a band that is withheld by default; `gauge show` gives the reason.
    """
    if result.outcome is not Outcome.FINISHED or result.trajectory is None:
        reason = result.error or result.diverged_reason or "it holds no trajectory"
        raise DiagnosisError(
            f"{result.id}: {result.outcome.value}, so there is no score to split: {reason}"
        )
    experiment = recorded_experiment(result)
    if band is None:
        band = reference_band(
            experiment, use_withheld=use_withheld or result.score.withheld is not None
        )
    times_s, values = result.trajectory.arrays(later=True)
    if band is not None and (width := values.shape[1]) != (
        taken := band.projection.shape[1]
    ):
        raise DiagnosisError(
            f"{result.id}: its trajectory has {width} coordinates, the band needs {taken}. It was made with another "
            "version of the task file: run it again."
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
    if rmse is None or not math.isclose(
        rmse, diagnosis.rmse, rel_tol=1e-6, abs_tol=1e-9
    ):
        scored = (
            "without an RMSE"
            if rmse is None
            else f"an RMSE of {rmse:.4g} {diagnosis.unit}"
        )
        note = f"the score in the result, {scored}, was not made against this band (its grade: {result.score.grade})"
        return replace(diagnosis, notes=(*diagnosis.notes, note))
    return replace(
        diagnosis, dtw_over_rmse=None if dtw is None or rmse == 0.0 else dtw / rmse
    )


def diagnose_trajectory(
    experiment: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
    order: Sequence[BudgetStage] = DEFAULT_ORDER,
    measured_only: bool = False,
) -> Diagnosis:
    """Return the error budget of a generalized trajectory.

    Args:
        experiment: The experiment of the trajectory.
        band: Band to compare with.
        times_s: Times of the samples from frame 0 on [s], strictly increasing, shape [sample_count]; they must reach
            the last frame. 180 samples a second or more give exact times.
        values: g(t) at those times, shape [sample_count, coordinate_count].
        order: The three stages in the order in which they are added.
        measured_only: Leave out the frames that the band extrapolates.
    """
    stages = stage_order(order)
    if band is not None and band.grade is BandGrade.MODEL:
        raise DiagnosisError(
            f"{experiment.id}: there is no reference band of reality (grade model), so no error to split; it needs the "
            "mean of real trials (gauge data import), of a recording or of a law"
        )
    if band is None:
        found = load_band(experiment.name)
        if found is not None and found.withheld is not None:
            raise DiagnosisError(
                f"{experiment.id}: its band is withheld: {found.withheld}; use_withheld=True or --use withheld splits "
                "the error to it"
            )
        raise DiagnosisError(
            f"{experiment.id}: there is no reference band (grade none), so no error to split; it needs the mean of "
            "real trials (gauge data import), of a recording or of a law"
        )
    times_s, values = _checked(times_s, values, len(band.mean))
    reference = (
        np.where(band.measured[:, None], band.mean, np.nan)
        if measured_only
        else np.array(band.mean)
    )
    if not np.isfinite(reference).any():
        raise DiagnosisError(
            f"{experiment.id}: its band has no {'measured ' if measured_only else ''}frame"
        )
    simulated = band.project(values)
    last_s = (
        float(np.flatnonzero(np.isfinite(reference).any(axis=1))[-1]) / FRAME_RATE_HZ
    )
    motion = recognized(experiment, band, times_s, simulated, until_s=last_s)
    budget = NestedFits(
        reference, times_s, simulated, motion, _missing(band, simulated)
    )
    return _diagnosis(experiment, band, budget, stages, measured_only=measured_only)


def stage_order(names: Iterable[str]) -> tuple[BudgetStage, ...]:
    """Return stages by name."""
    given = list(names)
    known = [stage.value for stage in DEFAULT_ORDER]
    if sorted(given) != sorted(known):
        raise ParameterError(
            f"order is {', '.join(given) or 'empty'}, expected each of {', '.join(known)} once"
        )
    return tuple(BudgetStage(name) for name in given)


def _checked(
    times_s: FloatArray, values: FloatArray, frame_count: int
) -> tuple[FloatArray, FloatArray]:
    times_s, values = (
        np.asarray(times_s, dtype=np.float64),
        np.asarray(values, dtype=np.float64),
    )
    if (
        times_s.ndim != 1
        or values.ndim != 2
        or len(times_s) != len(values)
        or len(times_s) < 2
    ):
        raise ShapeError(
            f"times_s has shape {times_s.shape}, values {values.shape}; [T] and [T, C] with T > 1 are needed"
        )
    if not (np.isfinite(times_s).all() and np.isfinite(values).all()):
        raise ShapeError("the trajectory holds a value that is not finite")
    end_s = (frame_count - 1) / FRAME_RATE_HZ
    if (
        abs(times_s[0]) > 1e-6
        or (np.diff(times_s) <= 0.0).any()
        or times_s[-1] < end_s - 1e-6
    ):
        raise ShapeError(
            f"times_s must increase from 0 to the last frame at {end_s:.4f} s; it runs to {times_s[-1]:.4f} s"
        )
    return times_s, values


def _missing(band: Band, simulated: FloatArray) -> dict[BudgetStage, str]:
    """Return the stages that do not apply, with the reason."""
    missing = {}
    if not band.grade.is_real:
        # As in the score: a shift could only hide a drift.
        missing[BudgetStage.RELEASE] = (
            f"a {band.grade} has no release: it holds from frame 0 on"
        )
    real = float(
        np.sqrt(np.nanmean(np.square(band.mean - np.nanmean(band.mean, axis=0))))
    )
    simulated_size = float(np.sqrt(np.mean(np.square(simulated - simulated[0]))))
    scatter = float(np.sqrt(np.nanmean(np.square(band.sigma))))
    if real <= STILL_SHARE * scatter:
        missing[BudgetStage.RATE] = (
            "the mean of the reference does not move by more than a tenth of its sigma, so it has no rate"
        )
    elif simulated_size <= 1e-3 * real:
        missing[BudgetStage.RATE] = "the simulation does not move, so it has no rate"
    return missing


# --- budget ----------------------------------------------------------------------------------------------------------


def _diagnosis(
    experiment: Experiment,
    band: Band,
    budget: NestedFits,
    order: Sequence[BudgetStage],
    *,
    measured_only: bool,
) -> Diagnosis:
    baselines, recorded = experiment.baselines, experiment.recorded
    whole, left = budget.fit(()), budget.fit(order)
    deviations = budget.deviations()
    extrapolated = ~band.measured[budget.known]

    def part(index: int) -> StagePart:
        stage, before, after = (
            order[index],
            budget.fit(order[:index]),
            budget.fit(order[: index + 1]),
        )
        alone, others = budget.fit([stage]), budget.fit(set(order) - {stage})
        return StagePart(
            stage=stage,
            missing=budget.missing.get(stage),
            explained=before.mean_square - after.mean_square,
            share=_over(before.mean_square - after.mean_square, whole.mean_square),
            rmse_before=before.rmse,
            rmse_after=after.rmse,
            alone_share=_over(whole.mean_square - alone.mean_square, whole.mean_square),
            last_share=_over(others.mean_square - left.mean_square, whole.mean_square),
            by_coordinate=tuple((before.mean_squares - after.mean_squares).tolist()),
            changes=_changes(budget, band, order[: index + 1], after),
            alone_changes=_changes(budget, band, [stage], alone),
        )

    return Diagnosis(
        id=experiment.id,
        grade=band.grade.value,
        source=band.source,
        unit=band.unit,
        coordinates=band.coordinates,
        kind=budget.motion.kind,
        subject=MARKERS
        if not recorded
        else f"the {recorded[0]}"
        if len(recorded) == 1
        else SEVERAL_BODIES,
        driven=bool(experiment.scene.drivers),
        frames=budget.frame_count,
        extrapolated_frames=int(extrapolated.sum()),
        extrapolated_share=_over(
            float(deviations[extrapolated].sum()), float(deviations.sum())
        ),
        mean_square=whole.mean_square,
        rmse=whole.rmse,
        dtw_over_rmse=None,
        measured_only=measured_only,
        by_coordinate=tuple(whole.mean_squares.tolist()),
        parts=tuple(map(part, range(len(order)))),
        rest=Remainder(
            mean_square=left.mean_square,
            share=_over(left.mean_square, whole.mean_square),
            rmse=left.rmse,
            by_coordinate=tuple(left.mean_squares.tolist()),
        ),
        published=_published(
            {
                metric: line
                for metric, line in baselines.items()
                if band.grade.is_real or METRICS[metric].is_event
            }
        ),
        notes=tuple(_notes(budget, band, order, measured_only=measured_only)),
    )


def _changes(
    budget: NestedFits, band: Band, stages: Sequence[BudgetStage], fit: StageFit
) -> tuple[Change, ...]:
    """Return the changes of a fit, in the order of the stages."""
    motion, late = budget.motion, _at_bound(fit.shift_s, (-MAX_SHIFT_S, MAX_SHIFT_S))
    offsets = zip(band.coordinates, fit.offsets.tolist(), strict=True)
    changes: dict[BudgetStage, tuple[Change, ...]] = {
        BudgetStage.RELEASE: (
            Change(
                quantity="release_time",
                unit="s",
                simulated=0.0,
                fitted=fit.shift_s,
                at_bound=late,
            ),
        ),
        BudgetStage.OFFSET: tuple(
            Change(
                quantity="offset",
                unit=band.unit,
                simulated=0.0,
                fitted=value,
                coordinate=name,
            )
            for name, value in offsets
        ),
        BudgetStage.RATE: motion.changes(
            fit.rate,
            fit.scale,
            rate_at_bound=_at_bound(fit.rate, motion.rate_bounds),
            scale_at_bound=_at_bound(fit.scale, motion.scale_bounds),
        ),
    }
    return tuple(
        change
        for stage in stages
        if stage not in budget.missing
        for change in changes[stage]
    )


def _at_bound(value: float, bounds: tuple[float, float]) -> bool:
    close = CLOSE_TO_BOUND * (bounds[1] - bounds[0])
    return min(abs(value - bound) for bound in bounds) <= close


def _notes(
    budget: NestedFits, band: Band, order: Sequence[BudgetStage], *, measured_only: bool
) -> Iterator[str]:
    motion, fit = budget.motion, budget.fit(order)
    if late := budget.continued_frames(fit):
        how = "periodically" if motion.period_s is not None else "at constant velocity"
        yield f"{late} frames of the faster motion lie past the end of the simulation, continued {how}"
    if budget.likeness(fit) > INSEPARABLE:
        yield "speed and displacement change this motion alike: their sum is determined, its split between them is not"
    if measured_only:
        yield "frames that the band extrapolates are left out, so the whole is not the RMSE of the score"
    if motion.impact is not None and motion.impact.until_s < motion.end_s - 1e-9:
        yield f"restitution acts on the flight after the first impact, which ends at {motion.impact.until_s:.3f} s"
    if band.withheld is not None:
        yield f"the band is withheld from scores: {band.withheld}"
    if len(band.coordinates) < 3 and band.unit == "mm":
        yield f"the band has {', '.join(band.coordinates)} only; errors in other directions are not in the RMSE"


def _published(baselines: Mapping[str, Baseline]) -> dict[str, PublishedScore]:
    found = {}
    for engine in next((line.engines for line in baselines.values()), {}):
        normalized = {
            metric: line.engines[engine] for metric, line in baselines.items()
        }
        rmse, dtw = (
            None
            if (value := normalized.get(metric)) is None
            else value * baselines[metric].mean
            for metric in ("rmse", "dtw")
        )
        found[engine] = PublishedScore(
            rmse=rmse,
            rmse_normalized=normalized.get("rmse"),
            dtw_normalized=normalized.get("dtw"),
            dtw_over_rmse=dtw / rmse if dtw is not None and rmse else None,
            period_ratio=normalized.get("pd"),
        )
    return found


def _over(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else 0.0
