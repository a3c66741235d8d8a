"""Error over cost as the step and the iterations of an engine vary.

A *curve* is one engine with one preset in one experiment. Its settings differ in `EFFORT` alone, the step and the
iterations. All distances are those of `ErrorMeasure`, in the unit of the score.

- *Converged motion*: the finest run at the usual iterations. If the next coarser neighbours are closer to each other
  than the finest run is to its neighbour, it is the finer one of those, and so on: an engine in single precision moves
  away again at very fine steps, where rounding dominates.
- *Resolution*: the largest distance of the converged motion to its coarser neighbour and to any finer run. Nothing
  smaller is known about it.
- *Numerical error* of a setting: its distance to the converged motion of its own curve.
- *Real scatter*: the mean distance of a real trial to the mean of the trials.
- *Sufficient step*: the largest one from which on, down to the converged motion, the numerical error stays below the
  real scatter.
- *Error against reality*: the first score, over that of real trials. If it is aligned to the release, so are they.

Cost is the least CPU time over repeats per simulated second; it is wall time if a result states no CPU time.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any

import numpy as np

from gauge_envs.errors import GaugeError, ShapeError
from gauge_envs.evaluation.deviation import sampled_frames
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.swing import swing_metrics
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.pages.document import Document
from gauge_envs.pages.results import raw_score
from gauge_envs.pages.table import Column, Place, Table
from gauge_envs.pages.text import quantity_text, short_id
from gauge_envs.references.bands import Band
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene.geometry import FloatArray

STEP = "timestep_s"
EFFORT = (
    STEP,
    "iterations",
    "solver_iterations",
    "position_iterations",
    "velocity_iterations",
    "pgs_iterations",
    "ls_iterations",
    "line_search_iterations",
)
"""Settings that trade error for cost within a curve."""

EVENTS = ("pd", "mte", "lsd")
"""Event metrics that measure an experiment without a band, in this order."""

MIN_REFINEMENT = 1.5
"""Smallest ratio of two steps whose distance shows convergence; closer ones are close to each other anyway."""

REFERENCE_ENGINE = "mujoco"
"""Engine whose default settings are the unit of relative costs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorMeasure:
    """Measure of distances in one experiment.

    Attributes:
        experiment: The experiment, with its parameters.
        band: Band of its score; None without one.
        metric: `rmse`, or the event metric that is compared.
        unit: Unit of all distances.
        scatter: Scatter of real trials: the published mean RMSE of trials, or the standard deviation of the metric.
            None if none is published.
    """

    experiment: Experiment
    band: Band | None
    metric: str
    unit: str
    scatter: float | None

    @classmethod
    def of(cls, experiment: Experiment) -> ErrorMeasure:
        """Return the measure of an experiment."""
        band = reference_band(experiment)
        baselines = experiment.baselines
        event = next(
            (name for name in EVENTS if name in experiment.score.metrics), None
        )
        # A law until an event covers less than the published event.
        is_partial = band is None or not band.normalized_by_baseline
        if is_partial and event is not None and event in baselines:
            line = baselines[event]
            return cls(
                experiment=experiment,
                band=None,
                metric=event,
                unit=line.unit,
                scatter=line.std or None,
            )
        # The distance from a law or a solved model is a numerical error, which real trials do not measure.
        is_over_trials = band is None or (
            band.grade.is_real and band.normalized_by_baseline
        )
        has_scatter = "rmse" in baselines and is_over_trials
        return cls(
            experiment=experiment,
            band=band,
            metric="rmse",
            unit=experiment.score.observable.unit,
            scatter=(baselines["rmse"].mean or None) if has_scatter else None,
        )

    def frames(self, result: Result) -> FloatArray | None:
        """Return g(t) of a result at the frames, shape [T, D]; None if it did not run to its end."""
        if result.trajectory is None or result.error is not None or result.diverged:
            return None
        frames = sampled_frames(self.experiment, *result.trajectory.arrays())
        return frames if np.isfinite(frames).all() else None

    def distance(self, first: FloatArray, second: FloatArray) -> float:
        """Return the distance of two motions, each g(t) of shape [T, D]; NaN frames of the second are left out."""
        if self.metric != "rmse":
            one = swing_metrics(self.experiment, first)[self.metric]
            other = swing_metrics(self.experiment, second)[self.metric]
            return abs(one - other)
        compared = np.isfinite(second).all(axis=1)
        if self.band is not None:
            compared &= np.isfinite(self.band.mean).any(axis=1)
            first = self.band.project(first)
            second = self.band.project(second)
        return trajectory_rmse(first[compared], second[compared])

    @property
    def is_verified(self) -> bool:
        """Whether `to_reference` is the distance from the solution of the scene, and not from reality."""
        return self.band is not None and self.band.grade.is_solution

    def to_reference(self, result: Result) -> float | None:
        """Return the first score of a result; None without one.

        For a law or a solved model it is the distance of g(t) from the solution, in the unit of g(t). With a real
        scatter it is the normalized score in units of it: an aligned error counts in those of trials that are aligned
        too.
        """
        score = result.score
        if self.metric != "rmse":
            value = raw_score(score, self.metric)
            return (
                None
                if value is None
                else abs(value - self.experiment.baselines[self.metric].mean)
            )
        if score.primary is None:
            return None
        if self.is_verified:
            return raw_score(score, "rmse")
        normalized = score.primary_normalized
        if self.scatter is None or normalized is None:
            return raw_score(score, score.primary)
        return normalized * self.scatter


@dataclass
class SettingCost:
    """One setting of a curve, with its repeats; errors in the unit of the score, None if they are not known.

    Attributes:
        effort: Settings of `EFFORT` in force.
        time: What the cost counts, `cpu` or `wall`.
        results: Its repeats.
        frames: g(t) at the frames, shape [T, D]; None if it did not run to its end.
        numerical: Numerical error.
        to_reference: Error against reality, or against the solution of the scene; see `ErrorMeasure.to_reference`.
        is_converged: Whether it is the converged motion.
        is_main: Whether only the step differs from the curve's usual effort.
    """

    effort: dict[str, float]
    time: str
    results: list[Result] = field(default_factory=list)
    frames: FloatArray | None = None
    numerical: float | None = None
    to_reference: float | None = None
    is_converged: bool = False
    is_main: bool = True

    @property
    def step_s(self) -> float:
        """Time step [s]; 0 for an engine without one."""
        return self.effort.get(STEP, 0.0)

    @property
    def costs(self) -> list[float]:
        """Seconds of each repeat per simulated second."""
        spent_s = [
            (one.cpu_s if self.time == "cpu" else one.wall_s) or 0.0
            for one in self.results
        ]
        return [one / max(self.results[0].sim_s, 1e-9) for one in spent_s]

    @property
    def cost(self) -> float:
        """Least of the costs."""
        return min(self.costs)


@dataclass
class CostCurve:
    """One engine with one preset in one experiment.

    Attributes:
        key: Key that the same engine and preset have in other experiments.
        measure: Measure of distances.
        settings: Its settings.
        resolution: Resolution, in the unit of the score; infinite if a finer run diverged, None with less than two
            steps.
    """

    key: str
    measure: ErrorMeasure
    settings: list[SettingCost] = field(default_factory=list)
    resolution: float | None = None

    @property
    def first(self) -> Result:
        """A result of the curve."""
        return self.settings[0].results[0]

    @property
    def time(self) -> str:
        """What the costs count, `cpu` or `wall`."""
        return self.settings[0].time

    @property
    def id(self) -> str:
        """Id of the experiment."""
        return self.measure.experiment.id

    @property
    def unit(self) -> str:
        """Unit of `over_scatter`."""
        return "real scatter" if self.measure.scatter else self.measure.unit

    @property
    def name(self) -> str:
        """Engine, preset and other settings, as `rapier out_of_box`."""
        given = other_settings(self.first)
        preset = [str(given.pop("preset"))] if "preset" in given else []
        changes = [
            f"{key}={value}"
            for key, value in given.items()
            if key != "drive_interval_s"
        ]
        return " ".join([self.first.backend or "file", *preset, *changes])

    @property
    def main_line(self) -> list[SettingCost]:
        """The settings in which the step alone differs, the finest first."""
        return sorted(
            (one for one in self.settings if one.is_main and one.step_s),
            key=lambda one: one.step_s,
        )

    def over_scatter(self, error: float | None) -> float | None:
        """Return an error in units of the real scatter, if there is one."""
        return None if error is None else error / (self.measure.scatter or 1.0)

    def default(self) -> SettingCost | None:
        """Return the setting with the engine's own step; None if it did not run."""
        for setting in self.settings:
            if setting.is_main and any(
                STEP not in one.settings_given for one in setting.results
            ):
                return setting
        return None

    def sufficient(self) -> SettingCost | None:
        """Return the setting of the sufficient step; None if there is none."""
        limit = self.measure.scatter
        # The converged motion itself proves nothing where its own resolution is above the limit.
        if limit is None or self.resolution is None or self.resolution > limit:
            return None
        enough = takewhile(
            lambda one: one.numerical is not None and one.numerical <= limit,
            self.main_line,
        )
        return max(enough, key=lambda one: one.step_s, default=None)

    def cheapest(self) -> SettingCost | None:
        """Return the cheapest setting whose error against reality is at most the real scatter; None without one."""
        limit = self.measure.scatter or 0.0
        within = [
            one
            for one in self.settings
            if one.to_reference is not None and one.to_reference <= limit
        ]
        return min(within, key=lambda one: one.cost, default=None)


def other_settings(result: Result) -> dict[str, Any]:
    """Return the settings that were given and are no effort."""
    return {
        name: value
        for name, value in result.settings_given.items()
        if name not in EFFORT
    }


def cost_curves(results: Iterable[Result], notes: list[str]) -> list[CostCurve]:
    """Return the curves of results, with their errors.

    Args:
        results: Results of many settings. Repeats of one differ in their seed alone. Those with a jittered start, and
            those that did not run, are left out.
        notes: Receives a sentence for each that is left out.
    """
    usable = []
    for result in results:
        if result.error is not None or result.trajectory is None or not result.wall_s:
            notes.append(
                f"{result.id} on {result.backend}: left out, it has no time or did not run"
            )
        elif result.jitter:
            notes.append(
                f"{result.id} on {result.backend}: left out, its start is jittered"
            )
        else:
            usable.append(result)
    time = "cpu" if all(one.cpu_s is not None for one in usable) else "wall"
    curves: dict[str, CostCurve] = {}
    measures: dict[str, ErrorMeasure] = {}
    for result in usable:
        subject = [
            result.id,
            result.parameters,
            result.asset.get("sha256"),
            result.dataset,
        ]
        place = json.dumps(subject, sort_keys=True)
        try:
            if place not in measures:
                measures[place] = ErrorMeasure.of(recorded_experiment(result))
        except GaugeError as error:
            notes.append(f"{result.id}: left out, {error}")
            continue
        versions = RunConfiguration.of(result).engine_versions
        key = json.dumps(
            [result.backend, versions, other_settings(result), result.marker_proxy],
            sort_keys=True,
        )
        curve = curves.setdefault(place + key, CostCurve(key, measures[place]))
        # Rounded, so that 1/9000 and 1/180/50 are one step.
        effort = {
            name: float(f"{result.settings[name]:.9g}")
            for name in EFFORT
            if result.settings.get(name) is not None
        }
        setting = next((one for one in curve.settings if one.effort == effort), None)
        if setting is None:
            setting = SettingCost(effort, time)
            curve.settings.append(setting)
        setting.results.append(result)
    if not curves:
        raise ShapeError(
            "no result has a time and a calibrated start: run gauge run with several --set timestep_s=..."
        )
    for curve in curves.values():
        _find_errors(curve, notes)
    return list(curves.values())


def _find_errors(curve: CostCurve, notes: list[str]) -> None:
    """Find the errors of a curve's settings."""
    measure = curve.measure
    iterations = [
        {name: one.effort[name] for name in one.effort if name != STEP}
        for one in curve.settings
    ]
    usual = max(iterations, key=iterations.count)
    for setting, chosen in zip(curve.settings, iterations, strict=True):
        setting.is_main = chosen == usual
        setting.frames = measure.frames(setting.results[0])
        if setting.frames is None:
            continue
        setting.to_reference = measure.to_reference(setting.results[0])
        repeats = [measure.frames(one) for one in setting.results[1:]]
        if any(
            again is None or not np.array_equal(setting.frames, again)
            for again in repeats
        ):
            first = setting.results[0]
            notes.append(
                f"{first.id} on {first.backend}: repeats of a setting differ; the first counts"
            )
    converged = _converged(curve)
    if converged is None or converged.frames is None:
        return
    converged.is_converged = True
    for setting in curve.settings:
        if setting.frames is not None:
            distance = measure.distance(setting.frames, converged.frames)
            # An event may never happen.
            setting.numerical = distance if np.isfinite(distance) else None
    for setting in curve.main_line:
        if setting.step_s < converged.step_s:
            # A finer run that moves away may round, or may converge to something else.
            away = math.inf if setting.numerical is None else setting.numerical
            curve.resolution = max(curve.resolution or 0.0, away)


def _converged(curve: CostCurve) -> SettingCost | None:
    """Return the converged motion, and keep its distance to its neighbour; None with less than two steps."""
    line = [one for one in curve.main_line if one.frames is not None]
    best: SettingCost | None = None
    while line:
        fine = line[0]
        coarser = [one for one in line if one.step_s >= MIN_REFINEMENT * fine.step_s]
        if not coarser:
            break
        assert fine.frames is not None and coarser[0].frames is not None
        distance = curve.measure.distance(fine.frames, coarser[0].frames)
        if curve.resolution is not None and distance >= curve.resolution:
            break
        curve.resolution = distance
        best = fine
        line = coarser
    return best


def cost_document(curves: Sequence[CostCurve]) -> Document:
    """Return a table with a row for each curve; its JSON has a row for each setting."""
    # The cost of the reference engine with default settings, by experiment.
    units: dict[str, float] = {}
    for curve in curves:
        for setting in curve.settings:
            if curve.first.backend == REFERENCE_ENGINE and any(
                not one.settings_given for one in setting.results
            ):
                units[curve.id] = setting.cost

    def cost(curve: CostCurve, setting: SettingCost | None) -> str:
        if setting is None:
            return "-"
        ratio = f", {setting.cost / units[curve.id]:.2g}" if curve.id in units else ""
        return f"{step_text(setting.step_s)}: {setting.cost:.2g} s{ratio}"

    table = Table(
        columns=(
            Column("id", "experiment", short_id, place=Place.HEADING),
            Column("first.parameters", "", place=Place.HEADING),
            Column("name", "engine"),
            Column(
                "",
                "resolution",
                lambda one: _error_text(one.over_scatter(one.resolution)),
                is_number=True,
            ),
            Column("unit", "unit"),
            Column("", "sufficient step", lambda one: cost(one, one.sufficient())),
            Column(
                "",
                "cheapest within real scatter",
                lambda one: cost(one, one.cheapest()),
            ),
            Column("", "default step", lambda one: cost(one, one.default())),
        ),
        rows=curves,
        notes=(
            f"Behind a step: {curves[0].time} time per simulated second, and its ratio to that of "
            f"{REFERENCE_ENGINE} with its default settings.",
        ),
    )
    rows = [
        _row(curve, setting, units.get(curve.id))
        for curve in curves
        for setting in curve.settings
    ]
    return Document(parts=(table,), rows=rows)


def _row(
    curve: CostCurve, setting: SettingCost, unit_cost: float | None
) -> dict[str, Any]:
    """Return the numbers of a setting."""
    return {
        "id": curve.id,
        "parameters": curve.first.parameters,
        "engine": curve.name,
        "versions": RunConfiguration.of(curve.first).engine_versions,
        "effort": setting.effort,
        # The shortest request for the setting is that of a user.
        "settings_given": min((one.settings_given for one in setting.results), key=len),
        "time": setting.time,
        "cost": setting.cost,
        "cost_max": max(setting.costs),
        "cost_ratio": setting.cost / unit_cost if unit_cost else None,
        "repeats": len(setting.results),
        "diverged": setting.frames is None,
        "unit": curve.unit,
        "numerical": curve.over_scatter(setting.numerical),
        "to_reality": None
        if curve.measure.is_verified
        else curve.over_scatter(setting.to_reference),
        "to_solution": setting.to_reference if curve.measure.is_verified else None,
        "resolution": curve.over_scatter(curve.resolution),
        "is_converged": setting.is_converged,
    }


def _error_text(error: float | None) -> str:
    return "-" if error is None else quantity_text(error)


def step_text(step_s: float | None) -> str:
    """Return a step as a fraction of a second; empty without one."""
    return f"1/{1.0 / step_s:.6g} s" if step_s else ""
