"""An error budget: how much of an episode's RMSE is release time, constant offset, scale or rate, and the rest.

The simulated trajectory is changed so that it fits the mean of reality best, and what a change takes off the mean
squared error is its part of the budget. Three stages, each a change that has a meaning in the laboratory:

- `release`: it is played later by a constant time and held at both ends, as `release_offset` of the score does;
- `offset`: a constant is added, one number a coordinate;
- `rate`: the motion is faster or larger, in the quantity that it has (`gauge_envs.motion.MotionKind`): another
  acceleration, restitution, period and amplitude, or in general a stretch of time and of displacement.

Stages are nested least squares: each adds its change to those before it, and all of them are fitted again. So the
squared error only falls, its parts and the rest add up to the whole, and so do the falls of the RMSE. The split depends
on the order, as changes can stand in for each other; so beside it stands what a stage takes off `alone`, and what it
takes off as the `last` of the three. Frames are those of the score: all, extrapolated ones too, as in the paper.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from gauge_envs.episode import reference_band
from gauge_envs.errors import GaugeError, ParameterError, ShapeError
from gauge_envs.experiment import Experiment
from gauge_envs.metrics import release_offset
from gauge_envs.motion import Change, Motion, MotionKind, recognized
from gauge_envs.reference import Band, BandGrade, Baseline, load_band
from gauge_envs.result import Outcome, Result, json_ready, recorded_experiment
from gauge_envs.task_format import FRAME_RATE_HZ

__all__ = [
    "DEFAULT_ORDER",
    "MAX_SHIFT_S",
    "Diagnosis",
    "DiagnosisError",
    "PublishedScore",
    "Remainder",
    "Stage",
    "StagePart",
    "diagnose",
    "diagnose_trajectory",
    "stage_order",
]

FloatArray = NDArray[np.float64]

MAX_SHIFT_S = 10.0 / 30.0
"""Largest time shift tried to either side [s]; that of the score's release offset."""

STILL_SHARE = 0.1
"""A real motion below this share of the scatter of the trials is none, so that it has no rate."""

SHIFT_STEP_S = 1.0 / 180.0
"""Step of the grid of time shifts, a sample [s]."""

RATE_STEP = 0.01
"""Step of the grid of rates."""

CYCLE_STEP = 0.1
"""Largest step of the grid of rates for an oscillation, in cycles at its end: minima are half a cycle wide."""

GRID_COORDINATES = 12
"""Coordinates that the grid looks at; the refinement has them all."""

GRID_NUMBERS = 5_000_000
"""Numbers that a grid may compute; with more, it leaves out frames."""

CHUNK_NUMBERS = 1_000_000
"""Numbers that are computed at once: 8 MB an array."""

START_COUNT = 4
"""Local minima of the grid that are refined."""

INSEPARABLE = 0.95
"""Squared cosine between two changes from which on noise decides which of them the fit takes."""

NOTABLE_SHARE = 0.01
"""Share of the squared error by which another first part must be better to be told."""

CLOSE_TO_BOUND = 1e-3
"""Share of a range within which a fit counts as ended at its limit."""

NO_PUBLISHED_SPLIT = (
    "only scalar scores are published: a split of the RMSE needs the trajectory. DTW over RMSE, both in the unit of "
    "g(t), says how much is left where time may be warped at will; PD is the period over the real one."
)


class DiagnosisError(GaugeError, ValueError):
    """An episode has no error budget; the message says what is missing."""


class Stage(StrEnum):
    """A part of the error budget."""

    RELEASE = "release"
    """Constant time shift."""
    OFFSET = "offset"
    """Constant offset of each coordinate."""
    RATE = "rate"
    """Scale or rate of the motion."""


DEFAULT_ORDER = (Stage.RELEASE, Stage.OFFSET, Stage.RATE)


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

    stage: Stage
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

    def part(self, stage: Stage) -> StagePart:
        """The part of one stage."""
        return next(part for part in self.parts if part.stage is stage)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary, every field present, with `findings` in words."""
        values: dict[str, Any] = json_ready(asdict(self) | {"findings": self.findings()})
        return values

    def findings(self) -> tuple[str, ...]:
        """The budget in words, one line a finding."""
        if self.mean_square == 0.0:
            return ("The simulation is on the mean of the band: there is no error to explain.",)
        lines = [_finding(self, part) for part in self.parts]
        left = _told_rmse(self, self.rest.rmse)
        lines.append(f"{_percent(self.rest.share)} of the squared error is none of these: {left} is left.")
        applied = [part for part in self.parts if part.missing is None]
        most = max(applied, key=lambda part: part.alone_share, default=None)
        if most is not None and most.alone_share > applied[0].alone_share + NOTABLE_SHARE:
            told = _told_change(self, most.stage, most.alone_changes)
            lines.append(
                f"The order matters: {_percent(most.alone_share)} is gone already if {told}, and nothing else."
            )
        return tuple(lines)


# --- entry points ----------------------------------------------------------------------------------------------------


def diagnose(
    result: Result,
    *,
    band: Band | None = None,
    order: Sequence[Stage] = DEFAULT_ORDER,
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
    resolved = recorded_experiment(result)
    if band is None:
        band = reference_band(resolved, use_withheld=use_withheld or result.score.withheld is not None)
    times_s, values = result.trajectory.arrays()
    if band is not None and (own := values.shape[1]) != (taken := band.projection.shape[1]):
        raise DiagnosisError(
            f"{result.id}: its trajectory has {own} coordinates, the band takes {taken}: it was made with another "
            "version of the task file; run it again"
        )
    diagnosis = diagnose_trajectory(
        resolved,
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
    resolved: Experiment,
    band: Band | None,
    *,
    times_s: FloatArray,
    values: FloatArray,
    order: Sequence[Stage] = DEFAULT_ORDER,
    measured_only: bool = False,
) -> Diagnosis:
    """Error budget of a generalized trajectory.

    Args:
        resolved: The experiment that it is of.
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
        raise DiagnosisError(f"{resolved.id}: {_why_no_band(resolved.name)}")
    times_s, values = _checked(times_s, values, len(band.mean))
    reference = np.where(band.measured[:, None], band.mean, np.nan) if measured_only else np.array(band.mean)
    if not np.isfinite(reference).any():
        raise DiagnosisError(f"{resolved.id}: its band has no {'measured ' if measured_only else ''}frame")
    simulated = band.project(values)
    last_s = float(np.flatnonzero(np.isfinite(reference).any(axis=1))[-1]) / FRAME_RATE_HZ
    motion = recognized(resolved, band, times_s, simulated, until_s=last_s)
    budget = _Budget(reference, times_s, simulated, motion, _missing(band, simulated))
    return _diagnosis(resolved, band, budget, stages, measured_only=measured_only)


def stage_order(names: Iterable[str]) -> tuple[Stage, ...]:
    """Stages by name.

    Raises:
        ParameterError: They are not the three stages, each once.
    """
    given = list(names)
    known = [stage.value for stage in DEFAULT_ORDER]
    if sorted(given) != sorted(known):
        raise ParameterError(f"order is {', '.join(given) or 'empty'}, expected each of {', '.join(known)} once")
    return tuple(Stage(name) for name in given)


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


def _missing(band: Band, simulated: FloatArray) -> dict[Stage, str]:
    """Stages that do not apply, and why."""
    missing = {}
    if band.grade is BandGrade.LAW:
        # As in the score: a law is exact from frame 0 on, and a shift would only hide a drift.
        missing[Stage.RELEASE] = "a law has no release: it holds from frame 0 on"
    real = float(np.sqrt(np.nanmean(np.square(band.mean - np.nanmean(band.mean, axis=0)))))
    own = float(np.sqrt(np.mean(np.square(simulated - simulated[0]))))
    scatter = float(np.sqrt(np.nanmean(np.square(band.sigma))))
    if real <= STILL_SHARE * scatter:
        missing[Stage.RATE] = "the real mean does not move by more than a tenth of its scatter, so it has no rate"
    elif own <= 1e-3 * real:
        missing[Stage.RATE] = "the simulation does not move, so it has no rate"
    return missing


# --- fits ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Fit:
    """Best fit of some stages together."""

    shift_s: float
    rate: float
    scale: float
    offsets: FloatArray
    mean_squares: FloatArray
    """Of each coordinate, shape [C]; they sum to `mean_square`."""

    @property
    def mean_square(self) -> float:
        return float(self.mean_squares.sum())


class _Budget:
    """Least-squares fits of a motion to the mean of reality, of every set of stages.

    Shift and rate are searched on a grid and refined; offsets and scale enter linearly and are solved for at each.
    """

    def __init__(
        self,
        reference: FloatArray,
        times_s: FloatArray,
        simulated: FloatArray,
        motion: Motion,
        missing: Mapping[Stage, str],
    ) -> None:
        # The score divides by the frames that have anything to compare; the others play no part.
        self.known = np.isfinite(reference).any(axis=1)
        self.frame_count = int(self.known.sum())
        self.motion = motion
        self.missing = missing
        self._times_s = times_s
        self._simulated = simulated
        self._whole_reference = reference
        self._reference = reference[self.known]
        self._frames_s = np.flatnonzero(self.known) / FRAME_RATE_HZ
        self._fits: dict[frozenset[Stage], _Fit] = {}

    def fit(self, stages: Iterable[Stage]) -> _Fit:
        """Best fit of a set of stages; those that do not apply are left out."""
        wanted = frozenset(stages) - set(self.missing)
        if wanted not in self._fits:
            self._fits[wanted] = self._searched(wanted)
        return self._fits[wanted]

    def deviations(self) -> FloatArray:
        """Squared deviation of the unchanged simulation at each known frame."""
        played, _ = self.motion.at(self._frames_s, np.zeros(1), np.ones(1))
        return np.nansum(np.square(self._reference - played[0]), axis=1)

    def continued_frames(self, fit: _Fit) -> int:
        """Frames at which a fit shows the motion past the end of the simulation."""
        since_start = np.clip(self._frames_s - fit.shift_s, 0.0, self.motion.end_s)
        return int((fit.rate * since_start > self.motion.end_s + 1e-9).sum()) if fit.rate > 1.0 else 0

    def likeness(self, fit: _Fit) -> float:
        """How alike a change of rate and one of scale are at a fit, as the squared cosine between them; 0 with one."""
        low, high = self.motion.rate_bounds
        if Stage.RATE in self.missing or low == high:
            return 0.0
        rates = np.clip(fit.rate + np.array([-RATE_STEP, RATE_STEP]), low, high)
        played, basis = self.motion.at(self._frames_s, np.full(2, fit.shift_s), rates)
        known = np.isfinite(self._reference)
        faster, larger = (np.where(known, change, 0.0) for change in (played[1] - played[0], basis.mean(axis=0)))
        both = np.square(faster).sum() * np.square(larger).sum()
        return float(np.square((faster * larger).sum()) / both) if both > 0.0 else 0.0

    def _searched(self, stages: frozenset[Stage]) -> _Fit:
        smaller = [self.fit(some) for some in combinations(sorted(stages), len(stages) - 1)] if stages else []
        if stages == {Stage.RELEASE}:
            # The score's own alignment, so that both give the same number.
            shift_s, _ = release_offset(
                self._times_s,
                self._simulated,
                self._whole_reference,
                frame_rate_hz=FRAME_RATE_HZ,
                max_offset_s=MAX_SHIFT_S,
            )
            found = [np.array([shift_s, 1.0])]
        else:
            found = self._refined(stages, smaller)
        fits = [self._solved(stages, *point) for point in found]
        best = min(fits, key=lambda one: one.mean_square)
        # A larger model contains the smaller one: what the search finds is never worse.
        least = min(smaller, key=lambda one: one.mean_square, default=None)
        return best if least is None or best.mean_square <= least.mean_square else least

    def _refined(self, stages: frozenset[Stage], smaller: Sequence[_Fit]) -> list[FloatArray]:
        """Shift and rate of the best local minima."""
        bounds = np.array([self._shift_bounds(stages), self._rate_bounds(stages)])
        free = bounds[:, 0] < bounds[:, 1]
        if not free.any():
            return [bounds[:, 0]]
        shifts, rates, steps = self._grid(bounds)
        starts = _local_minima(shifts, rates, self._grid_errors(stages, shifts, rates))
        starts += [np.array([one.shift_s, one.rate]) for one in smaller]
        found = []
        for start in starts:
            point = np.clip(start, bounds[:, 0], bounds[:, 1])

            def error(chosen: FloatArray, point: FloatArray = point) -> float:
                full = point.copy()
                full[free] = chosen
                return self._solved(stages, *full).mean_square

            corners = np.tile(point[free], (int(free.sum()) + 1, 1))
            for axis, step in enumerate(steps[free]):
                inward = step if point[free][axis] + step <= bounds[free][axis, 1] else -step
                corners[axis + 1, axis] += inward
            options = {"initial_simplex": corners, "xatol": 1e-7, "fatol": math.inf, "maxfev": 400}
            fitted = minimize(error, point[free], method="Nelder-Mead", bounds=bounds[free], options=options)
            full = point.copy()
            full[free] = fitted.x
            found += [point, full]
        # The least change among equals, so that a body at rest is not shifted.
        found.append(np.array([0.0, 1.0]))
        return sorted(found, key=lambda one: (abs(one[0]), abs(one[1] - 1.0)))

    def _shift_bounds(self, stages: frozenset[Stage]) -> tuple[float, float]:
        return (-MAX_SHIFT_S, MAX_SHIFT_S) if Stage.RELEASE in stages else (0.0, 0.0)

    def _rate_bounds(self, stages: frozenset[Stage]) -> tuple[float, float]:
        return self.motion.rate_bounds if Stage.RATE in stages else (1.0, 1.0)

    def _grid(self, bounds: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values of shift and rate to try, and their steps."""
        rate_step = RATE_STEP
        if self.motion.period_s is not None:
            rate_step = min(rate_step, CYCLE_STEP * self.motion.period_s / self._frames_s[-1])
        steps = np.array([SHIFT_STEP_S, rate_step])
        counts = np.ceil((bounds[:, 1] - bounds[:, 0]) / steps - 1e-9).astype(int) + 1
        shifts, rates = (np.linspace(low, high, count) for (low, high), count in zip(bounds, counts, strict=True))
        return shifts, rates, steps

    def _grid_errors(self, stages: frozenset[Stage], shifts: FloatArray, rates: FloatArray) -> FloatArray:
        """Mean squared error on the grid, shape [shifts, rates]; of the coordinates and frames that matter most.

        It only finds where to start from, so a part of many coordinates and frames is enough.
        """
        weight = np.nansum(np.square(self._reference - self._simulated[0]), axis=0)
        columns = np.sort(np.argsort(weight)[::-1][:GRID_COORDINATES])
        stride = max(1, math.ceil(len(shifts) * len(rates) * len(self._reference) * len(columns) / GRID_NUMBERS))
        reference, motion = self._reference[::stride, columns], self.motion.select(columns)
        points = np.stack(np.meshgrid(shifts, rates, indexing="ij"), axis=-1).reshape(-1, 2)
        chunks = np.array_split(points, math.ceil(reference.size * len(points) / CHUNK_NUMBERS))
        played = (motion.at(self._frames_s[::stride], chunk[:, 0], chunk[:, 1]) for chunk in chunks)
        errors = [self._linear(stages, reference, *one)[0].sum(axis=1) for one in played]
        return np.concatenate(errors).reshape(len(shifts), len(rates))

    def _solved(self, stages: frozenset[Stage], shift_s: float, rate: float) -> _Fit:
        played = self.motion.at(self._frames_s, np.array([shift_s]), np.array([rate]))
        squares, scale, offsets = self._linear(stages, self._reference, *played)
        return _Fit(float(shift_s), float(rate), float(scale[0]), offsets[0], squares[0] / self.frame_count)

    def _linear(
        self, stages: frozenset[Stage], reference: FloatArray, played: FloatArray, basis: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Best scale and offsets for G motions, with the squared error that is left.

        With offsets solved for, the error is a parabola in the scale, so that its bounded minimum is the clipped one.

        Returns:
            Summed squared error of each coordinate, shape [G, C]; scales, shape [G]; offsets, shape [G, C].
        """
        known = np.isfinite(reference)
        counts = np.maximum(known.sum(axis=0), 1)

        def centred(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Values where something is known, less their mean over time where offsets are free; and that mean."""
            kept = values if known.all() else np.where(known, values, 0.0)
            if Stage.OFFSET not in stages:
                return kept, np.zeros((len(played), reference.shape[1]))
            mean = kept.sum(axis=1) / counts
            kept = kept - mean[:, None]
            return (kept if known.all() else np.where(known, kept, 0.0)), mean

        deviation, offsets = centred(reference - played)
        scale = np.zeros(len(played))
        if Stage.RATE in stages:
            change, mean = centred(basis)
            size, overlap = (np.einsum("gtc,gtc->g", change, other) for other in (change, deviation))
            best = np.divide(overlap, size, out=np.zeros_like(size), where=size > 0.0)
            scale = np.clip(best, *self.motion.scale_bounds)
            deviation = deviation - scale[:, None, None] * change
            offsets = offsets - scale[:, None] * mean
        return np.einsum("gtc,gtc->gc", deviation, deviation), scale, offsets


def _local_minima(shifts: FloatArray, rates: FloatArray, errors: FloatArray) -> list[FloatArray]:
    """The deepest local minima of a grid, deepest first."""
    padded = np.pad(errors, 1, constant_values=np.inf)
    around = [padded[i : i + len(shifts), j : j + len(rates)] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    rows, columns = np.nonzero(errors <= np.min(around, axis=0))
    order = np.argsort(errors[rows, columns], kind="stable")[:START_COUNT]
    return [np.array([shifts[rows[k]], rates[columns[k]]]) for k in order]


# --- budget ----------------------------------------------------------------------------------------------------------


def _diagnosis(
    resolved: Experiment, band: Band, budget: _Budget, order: Sequence[Stage], *, measured_only: bool
) -> Diagnosis:
    baselines = resolved.baselines
    baseline = baselines["rmse"].mean if "rmse" in baselines else None
    whole, left = budget.fit(()), budget.fit(order)
    deviations = budget.deviations()
    extrapolated = ~band.measured[budget.known]
    return Diagnosis(
        id=resolved.id,
        grade=band.grade.value,
        source=band.source,
        unit=band.unit,
        baseline=baseline,
        coordinates=band.coordinates,
        kind=budget.motion.kind,
        subject=_subject(resolved),
        driven=bool(resolved.scene.drivers),
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


def _part(budget: _Budget, band: Band, order: Sequence[Stage], index: int, baseline: float | None) -> StagePart:
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


def _changes(budget: _Budget, band: Band, stages: Sequence[Stage], fit: _Fit) -> tuple[Change, ...]:
    """What a fit changed, in the order of the stages."""
    motion = budget.motion
    told: dict[Stage, tuple[Change, ...]] = {
        Stage.RELEASE: (
            Change(
                quantity="release_time",
                unit="s",
                simulated=0.0,
                fitted=fit.shift_s,
                at_bound=_at_bound(fit.shift_s, (-MAX_SHIFT_S, MAX_SHIFT_S)),
            ),
        ),
        Stage.OFFSET: tuple(
            Change(quantity="offset", unit=band.unit, simulated=0.0, fitted=float(value), coordinate=name)
            for name, value in zip(band.coordinates, fit.offsets, strict=True)
        ),
        Stage.RATE: motion.changes(
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


def _notes(budget: _Budget, band: Band, order: Sequence[Stage], *, measured_only: bool) -> tuple[str, ...]:
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
MOST_OFFSETS_TOLD = 3

_TOLD_RATE = {
    "acceleration": "the acceleration is {fitted:.3f} instead of {simulated:.3f} m/s^2",
    "restitution": "the restitution is {fitted:.3f} instead of {simulated:.3f}",
    "period": "the period is {fitted:.3f} instead of {simulated:.3f} s",
    "amplitude": "the amplitude is {fitted:.3f} times as large",
    "speed": "the motion is {fitted:.3f} times as fast",
    "displacement": "it goes {fitted:.3f} times as far",
}


def _subject(resolved: Experiment) -> str:
    if not resolved.recorded:
        return MARKERS
    return f"the {resolved.recorded[0]}" if len(resolved.recorded) == 1 else SEVERAL_BODIES


def _finding(diagnosis: Diagnosis, part: StagePart) -> str:
    """One stage in words."""
    if part.missing is not None:
        return f"{part.stage.value.capitalize()} does not apply: {part.missing}."
    first = all(other is part or other.missing for other in diagnosis.parts[: diagnosis.parts.index(part) + 1])
    own = _own_changes(part)
    course = _told_rmse(diagnosis, part.rmse_before, part.rmse_after)
    bound = " (the limit of what was tried: it may be more)" if any(change.at_bound for change in own) else ""
    also = "" if first else " as well"
    return (
        f"{_percent(part.share)} of the squared error is gone ({course}) if "
        f"{_told_change(diagnosis, part.stage, own)}{also}{bound}."
    )


def _own_changes(part: StagePart) -> tuple[Change, ...]:
    """Changes of the stage itself, among all that are in force after it."""
    quantities = {change.quantity for change in part.alone_changes}
    return tuple(change for change in part.changes if change.quantity in quantities)


def _told_change(diagnosis: Diagnosis, stage: Stage, changes: Sequence[Change]) -> str:
    subject = diagnosis.subject
    verb = "are" if subject in (SEVERAL_BODIES, MARKERS) else "is"
    if stage is Stage.RELEASE:
        late_s = changes[0].fitted
        when = f"{abs(late_s):.3f} s {'earlier' if late_s < 0.0 else 'later'}"
        if diagnosis.driven or subject == MARKERS:
            return f"the simulation starts {when}"
        return f"{subject} {verb} let go {when}"
    if stage is Stage.OFFSET:
        most = max(changes, key=lambda change: abs(change.fitted))
        if len(changes) > MOST_OFFSETS_TOLD:
            rms = math.sqrt(sum(change.fitted**2 for change in changes) / len(changes))
            return (
                f"each of {len(changes)} coordinates has a constant added, {rms:.3g} {diagnosis.unit} root mean square "
                f"({most.fitted:+.3g} at most, {most.coordinate})"
            )
        told = ", ".join(f"{change.fitted:+.3g} {diagnosis.unit} along {change.coordinate}" for change in changes)
        return f"{subject} {verb} moved by {told}"
    return " and ".join(_TOLD_RATE[change.quantity].format(**asdict(change)) for change in changes)


def _percent(share: float) -> str:
    percent = 100.0 * share
    if 0.0 < percent < 0.01:
        return "<0.01 %"
    if 99.5 <= percent < 99.995:
        # Nearly all is not all.
        return f"{percent:.2f} %"
    return f"{percent:.2g} %" if 0.0 < percent < 9.95 else f"{percent:.0f} %"


def _told_rmse(diagnosis: Diagnosis, *rmses: float) -> str:
    """One RMSE, or its course from one to another, in the unit and in baselines."""
    told = f"RMSE {' to '.join(f'{rmse:.3g}' for rmse in rmses)} {diagnosis.unit}"
    if diagnosis.baseline is None:
        return told
    return f"{told}, {' to '.join(f'{rmse / diagnosis.baseline:.3g}' for rmse in rmses)} baselines"
