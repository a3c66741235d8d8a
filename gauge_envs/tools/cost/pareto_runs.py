"""Runs of one experiment grouped by engine and preset, with the errors of each run; `pareto` states the definitions."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.laws import closed_form
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.tools.cost.error_measure import ErrorMeasure

FloatArray = NDArray[np.float64]

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
"""Settings that trade error for cost within a family."""

LEAST_REFINEMENT = 1.5
"""Smallest ratio of two steps whose distance shows convergence; closer ones are close to each other anyway."""


@dataclass
class SettingRun:
    """One setting of one experiment, with its repeats.

    Attributes:
        effort: Settings of `EFFORT` in force.
        results: Its repeats.
        frames: g(t) at the frames, shape [T, D]; None if it did not run to its end.
        numerical: Numerical error, in the unit of the score; None if it is not known, as the others.
        closed: Distance to the exact motion.
        real: Error against reality.
        is_reference: Whether it is the converged motion.
        is_main: Whether only the step differs from the family's usual effort.
    """

    effort: dict[str, float]
    results: list[Result]
    frames: FloatArray | None = None
    numerical: float | None = None
    closed: float | None = None
    real: float | None = None
    is_reference: bool = False
    is_main: bool = True

    def costs(self, kind: str) -> tuple[float, float]:
        """Return the least and the most seconds of a repeat per simulated second; `kind` is `cpu` or `wall`."""
        spent = [(one.cpu_s if kind == "cpu" else one.wall_s) or 0.0 for one in self.results]
        span_s = max(self.results[0].sim_s, 1e-9)
        return min(spent) / span_s, max(spent) / span_s

    @property
    def step_s(self) -> float | None:
        """Time step [s]; None for an engine without one."""
        return self.effort.get(STEP)


@dataclass
class ExperimentFamily:
    """A family on one experiment; errors in the unit of the score.

    Attributes:
        key: Key that the same family has on other experiments.
        measure: Measure of distances.
        exact: Exact motion, shape [T, D]; None without one.
        runs: Its settings.
        resolution: Largest distance of the converged motion to its coarser neighbour and to any finer run.
        model: Model error.
        floor: Parametric floor.
        floor_source: Origin of the floor.
    """

    key: str
    measure: ErrorMeasure
    exact: FloatArray | None
    runs: list[SettingRun] = field(default_factory=list)
    resolution: float | None = None
    model: float | None = None
    floor: float | None = None
    floor_source: str = ""

    @property
    def unit_error(self) -> float:
        """What errors are divided by."""
        return self.measure.scatter or 1.0


def is_usable(result: Result, notes: list[str]) -> bool:
    """Return whether a result has a time and the calibrated start; else add a note."""
    if result.error is not None or result.trajectory is None or not result.wall_s:
        notes.append(f"{result.id} on {result.backend}: left out, it has no time or did not run")
    elif result.jitter:
        notes.append(f"{result.id} on {result.backend}: left out, its start is jittered")
    else:
        return True
    return False


def _effort(result: Result) -> dict[str, float]:
    """Return the effort in force, rounded, so that 1/9000 and 1/180/50 are one step."""
    return {name: float(f"{result.settings[name]:.9g}") for name in EFFORT if result.settings.get(name) is not None}


def other_settings(result: Result) -> dict[str, Any]:
    """Return the settings that were given and are no effort."""
    return {name: value for name, value in result.settings_given.items() if name not in EFFORT}


def experiment_families(results: Sequence[Result], notes: list[str]) -> list[ExperimentFamily]:
    """Return the families of each experiment, analysed."""
    found: dict[str, ExperimentFamily] = {}
    experiments: dict[str, tuple[ErrorMeasure, FloatArray | None]] = {}
    for result in results:
        configuration = RunConfiguration.of(result)
        place = json.dumps([result.id, result.parameters, result.asset.get("sha256"), result.dataset], sort_keys=True)
        family = [result.backend, configuration.engine_versions, other_settings(result), result.marker_proxy]
        try:
            if place not in experiments:
                experiment = recorded_experiment(result)
                experiments[place] = ErrorMeasure.of(experiment), closed_form(experiment)
        except GaugeError as error:
            notes.append(f"{result.id}: left out, {error}")
            continue
        key = json.dumps(family, sort_keys=True)
        member = found.setdefault(place + key, ExperimentFamily(key, *experiments[place]))
        effort = _effort(result)
        run = next((one for one in member.runs if one.effort == effort), None)
        if run is None:
            member.runs.append(SettingRun(effort, [result]))
        else:
            run.results.append(result)
    for member in found.values():
        _analyse(member, notes)
    return list(found.values())


def _analyse(member: ExperimentFamily, notes: list[str]) -> None:
    """Fill in the errors of a family on one experiment."""
    measure, exact = member.measure, member.exact
    others = [{k: v for k, v in run.effort.items() if k != STEP} for run in member.runs]
    usual = max(others, key=others.count)
    for run, other in zip(member.runs, others, strict=True):
        run.is_main = other == usual
        run.frames = measure.frames(run.results[0])
        if run.frames is None:
            continue
        repeats = [measure.frames(one) for one in run.results[1:]]
        if any(again is None or not np.array_equal(run.frames, again) for again in repeats):
            notes.append(
                f"{run.results[0].id} on {run.results[0].backend}: repeats of a setting differ; the first counts"
            )
        run.real = measure.to_reality(run.results[0])
        run.closed = None if exact is None else _finite(measure.distance(run.frames, exact))
    backend = member.runs[0].results[0].backend
    member.floor, member.floor_source = measure.floor(backend) or (None, "")
    reference = _converged(member)
    if reference is None or reference.frames is None:
        return
    reference.is_reference, member.model = True, reference.closed
    for run in member.runs:
        if run.frames is not None:
            run.numerical = _finite(measure.distance(run.frames, reference.frames))
    finer = [run for run in member.runs if run.is_main and (run.step_s or 0.0) < (reference.step_s or 0.0)]
    # Finer runs that move away may round, or may converge to something else.
    away = [math.inf if run.numerical is None else run.numerical for run in finer]
    member.resolution = max([member.resolution or 0.0, *away])


def _converged(member: ExperimentFamily) -> SettingRun | None:
    """Return the run of the converged motion, and keep its distance to its neighbour; None with less than two steps."""
    line = sorted(
        (run for run in member.runs if run.is_main and run.frames is not None and run.step_s),
        key=lambda run: run.step_s or 0.0,
    )
    best: SettingRun | None = None
    while len(line) > 1:
        fine, least_s = line[0], LEAST_REFINEMENT * (line[0].step_s or 0.0)
        coarser = [one for one in line if (one.step_s or 0.0) >= least_s]
        if not coarser:
            break
        assert fine.frames is not None and coarser[0].frames is not None
        distance = member.measure.distance(fine.frames, coarser[0].frames)
        if member.resolution is not None and distance >= member.resolution:
            break
        member.resolution, best, line = distance, fine, coarser
    return best


def _finite(value: float) -> float | None:
    """Return a distance, or None for an event that never happens."""
    return value if np.isfinite(value) else None
