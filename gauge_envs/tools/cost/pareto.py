"""Points, families and phenomena of results; `model` states the definitions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.pages.text import short_id
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Result
from gauge_envs.tools.cost.model import ERRORS, Family, Phenomenon, Point, Tradeoff
from gauge_envs.tools.cost.runs import ExperimentFamily, SettingRun, experiment_families, is_usable, other_settings

REFERENCE_ENGINE = "mujoco"
"""Engine whose default settings are the unit of relative costs."""


def tradeoff(results: Iterable[Result]) -> Tradeoff:
    """Return error over cost for results of many settings.

    Repeats of one setting differ in their seed alone. Results with a jittered start, and those that did not run, are
    left out with a note.
    """
    notes: list[str] = []
    usable = [one for one in results if is_usable(one, notes)]
    if not usable:
        raise ShapeError("no result has a time and a calibrated start: run gauge run with several --set timestep_s=...")
    kind = "cpu" if all(one.cpu_s is not None for one in usable) else "wall"
    members = experiment_families(usable, notes)
    groups: dict[str, list[ExperimentFamily]] = {}
    for member in members:
        groups.setdefault(_phenomenon_name(member.runs[0].results[0]), []).append(member)
    phenomena = [_phenomenon(name, group, kind, notes) for name, group in groups.items()]
    return Tradeoff(
        cost=kind,
        reference=f"{REFERENCE_ENGINE} with its default settings, on the same experiments",
        phenomena=tuple(phenomena),
        versions={name: usable[0].versions[name] for name in ("gauge-envs", "python") if name in usable[0].versions},
        notes=tuple(dict.fromkeys(notes)),
    )


def _phenomenon_name(result: Result) -> str:
    name = short_id(result.id).rpartition("-")[0]
    if result.parameters == "calibrated":
        return name
    return f"{name}, {result.parameters if isinstance(result.parameters, str) else 'custom'}"


def _phenomenon(name: str, members: Sequence[ExperimentFamily], kind: str, notes: list[str]) -> Phenomenon:
    """Return the families that ran all experiments of a phenomenon."""
    first = members[0].measure
    ids = sorted({member.measure.experiment.id for member in members})
    scatter = {m.measure.experiment.id: m.measure.scatter for m in members if m.measure.scatter is not None}
    over_scatter = len(scatter) == len(ids)
    by_key: dict[str, list[ExperimentFamily]] = {}
    for member in members:
        by_key.setdefault(member.key, []).append(member)
    for key, group in list(by_key.items()):
        missing = set(ids) - {member.measure.experiment.id for member in group}
        if missing:
            one = group[0].runs[0].results[0]
            which = f"{one.backend} with {other_settings(one) or 'its presets'}"
            notes.append(f"{name}: {which} is left out, as it did not run {', '.join(sorted(missing))}")
            del by_key[key]
    unit_cost = _reference_cost(by_key.values(), kind)
    families = [_family(group, kind, unit_cost, over_scatter=over_scatter) for group in by_key.values()]
    return Phenomenon(
        name=name,
        ids=tuple(ids),
        metric=first.metric,
        unit="scatter" if over_scatter else first.unit,
        scatter=scatter if over_scatter else {},
        families=tuple(_with_fronts(sorted(families, key=lambda one: (one.backend, not one.is_default, one.name)))),
    )


def _reference_cost(groups: Iterable[Sequence[ExperimentFamily]], kind: str) -> float | None:
    """Return the cost of the reference engine with default settings; None if it did not run."""
    for group in groups:
        chosen = [
            run
            for member in group
            for run in member.runs
            if any(one.backend == REFERENCE_ENGINE and not one.settings_given for one in run.results)
        ]
        if len(chosen) == len(group):
            return _common_costs(chosen, kind)[0]
    return None


def _common_costs(runs: Sequence[SettingRun], kind: str) -> tuple[float, float]:
    """Return the least and the most cost of settings of several experiments, over their common time."""
    spans_s = np.array([run.results[0].sim_s for run in runs])
    least, most = spans_s @ np.array([run.costs(kind) for run in runs]) / max(spans_s.sum(), 1e-9)
    return float(least), float(most)


def _family(group: Sequence[ExperimentFamily], kind: str, unit_cost: float | None, *, over_scatter: bool) -> Family:
    """Return a family over all experiments of a phenomenon."""
    first = group[0].runs[0].results[0]
    units = [member.unit_error if over_scatter else 1.0 for member in group]
    by_effort = ([run for m in group for run in m.runs if run.effort == one.effort] for one in group[0].runs)
    points = [_point(runs, units, kind, unit_cost) for runs in by_effort if len(runs) == len(group)]
    limits = [member.floor or member.measure.scatter for member in group]
    presets = dict.fromkeys(str(run.results[0].settings.get("preset", "")) for m in group for run in m.runs)
    given = other_settings(first)
    return Family(
        backend=first.backend or "file",
        preset=", ".join(presets),
        is_default="preset" not in given,
        given={name: value for name, value in given.items() if name != "preset"},
        versions=RunConfiguration.of(first).engine_versions,
        points=tuple(sorted(points, key=lambda point: point.cost)),
        resolution=_worst([m.resolution for m in group], units),
        model=_worst([m.model for m in group], units),
        floor=_worst([m.floor for m in group], units),
        floor_source="; ".join(dict.fromkeys(m.floor_source for m in group if m.floor_source)),
        sufficient_step_s=_sufficient_step_s(group, limits),
    )


def _point(runs: Sequence[SettingRun], units: Sequence[float], kind: str, unit_cost: float | None) -> Point:
    cost, cost_most = _common_costs(runs, kind)
    # The shortest request for the setting is that of a user.
    given = min((one.settings_given for one in runs[0].results), key=len)
    return Point(
        effort=runs[0].effort,
        settings_given=given,
        step_s=runs[0].step_s,
        cost=cost,
        cost_most=cost_most,
        cost_ratio=cost / unit_cost if unit_cost else None,
        repeats=min(len(run.results) for run in runs),
        diverged=any(run.frames is None for run in runs),
        numerical=_worst([run.numerical for run in runs], units),
        to_closed_form=_worst([run.closed for run in runs], units),
        to_reality=_worst([run.real for run in runs], units),
        is_reference=all(run.is_reference for run in runs),
        is_on_main_line=all(run.is_main for run in runs),
    )


def _worst(values: Sequence[float | None], units: Sequence[float]) -> float | None:
    """Return the largest error over its unit; None if one is unknown."""
    known = [value / unit for value, unit in zip(values, units, strict=True) if value is not None]
    return max(known) if len(known) == len(values) else None


def _sufficient_step_s(group: Sequence[ExperimentFamily], limits: Sequence[float | None]) -> float | None:
    """Return the largest step from which on the numerical error of every experiment stays below its limit."""
    steps: list[float] = []
    for member, limit in zip(group, limits, strict=True):
        line = sorted((run for run in member.runs if run.is_main and run.step_s), key=lambda run: run.step_s or 0.0)
        start = next((index for index, run in enumerate(line) if run.is_reference), None)
        if limit is None or start is None:
            return None
        enough = None
        for run in line[start:]:
            if run.numerical is None or run.numerical > limit:
                break
            enough = run.step_s
        # The converged motion itself proves nothing where its own resolution is above the limit.
        if enough is None or (member.resolution or 0.0) > limit:
            return None
        steps.append(enough)
    return min(steps)


def _with_fronts(families: Sequence[Family]) -> list[Family]:
    """Return the families with their points marked that lie on a front."""
    every = [(family, point) for family in families for point in family.points if not point.diverged]
    fronts: dict[int, list[str]] = {}
    for error in ERRORS:
        lowest = float("inf")
        known = [(value, point) for family, point in every if (value := _shown_error(family, point, error)) is not None]
        for value, point in sorted(known, key=lambda one: (one[1].cost, one[0])):
            if value < lowest:
                lowest = value
                fronts.setdefault(id(point), []).append(error)
    return [
        replace(one, points=tuple(replace(p, fronts=tuple(fronts.get(id(p), ()))) for p in one.points))
        for one in families
    ]


def _shown_error(family: Family, point: Point, error: str) -> float | None:
    """Return the error of a point; a numerical one is at least the resolution, as the converged motion has 0 itself."""
    value: float | None = getattr(point, error)
    if value is None or error != "numerical":
        return value
    return max(value, family.resolution or 0.0)
