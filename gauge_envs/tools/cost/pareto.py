"""Runs of one experiment by engine and preset, with their errors: points, families and phenomena of results.

`model` states the definitions.

An exact motion of an experiment with its own constants is chosen by what is in the scene, never by a name: of carried
bodies, slides, rebounds and pendulums. A scene has one if a single rigid body is recorded, and its motion follows from
friction, restitution or gravity alone.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any

import numpy as np

from gauge_envs.errors import GaugeError, ShapeError
from gauge_envs.evaluation.deviation import experiment_sensitivities, sampled_frames
from gauge_envs.evaluation.laws import distance_to_contact_m, slide
from gauge_envs.evaluation.metrics.trajectory import trajectory_rmse
from gauge_envs.evaluation.pendulum_laws import Pendulum
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.swing import swing_metrics
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.pages.results import raw_score
from gauge_envs.pages.text import short_id
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import recorded_experiment
from gauge_envs.scene import Hinge, Motion, Plane, RigidBody, Scene, Sphere
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.cost.model import EFFORT, ERRORS, STEP, Family, Phenomenon, Point, Tradeoff

LEAST_APEX_M = 1e-9
"""Height of a rebound below which the ball rests [m]."""


def closed_form(experiment: Experiment) -> FloatArray | None:
    """Return the exact g(t) of an experiment at its frames.

    - Where the package states a law in place of trials, as for a carried body, it is that law.
    - A body that starts on the face of a fixed one slides with g (sin - mu cos), until it tips over the edge.
    - A ball above a level plane falls, and each rebound has `e` times the speed of the impact, in no time.
    - A body on a hinge that touches nothing swings as a physical pendulum, for all frames.

    Args:
        experiment: The experiment; its constants are those of its parameters.

    Returns:
        Positions [mm], shape [frame_count, 3], NaN where the form has ended; None without a form.
    """
    scene = experiment.scene
    is_alone = len(scene.dynamic_bodies) == 1 and not scene.deformables
    if experiment.score.observable is not Observable.POSITION or len(experiment.recorded) != 1 or not is_alone:
        return None
    body = scene.body(experiment.recorded[0])
    if any(isinstance(joint, Hinge) for joint in scene.joints):
        return None if scene.contacts or scene.drivers else _swing(scene, body.name, experiment.frame_count)
    stated = _stated(experiment)
    if stated is not None:
        return stated
    if scene.drivers or body.motion is not Motion.DYNAMIC or not body.starts_at_rest:
        return None
    if isinstance(body.shape, Sphere):
        return _rebounds(scene, body, experiment.frame_count)
    return _slide(scene, body, experiment.frame_count)


def _stated(experiment: Experiment) -> FloatArray | None:
    """Return the law that the package states for an experiment, if it gives all three coordinates."""
    band = reference_band(experiment)
    if band is None or band.grade is not BandGrade.LAW or band.projection.shape != (3, 3):
        return None
    return np.asarray(band.mean @ np.linalg.inv(band.projection).T)


def _swing(scene: Scene, body: str, frame_count: int) -> FloatArray:
    pendulum = Pendulum.of(scene, body)
    return pendulum.positions_mm(pendulum.released_rad(np.arange(frame_count) / FRAME_RATE_HZ))


def _slide(scene: Scene, body: RigidBody, frame_count: int) -> FloatArray | None:
    for support in scene.bodies:
        if support.motion is Motion.FIXED and not isinstance(support.shape, Plane):
            try:
                return slide(scene, body.name, support.name).positions_mm(frame_count)
            except ShapeError:
                continue
    return None


def _rebounds(scene: Scene, ball: RigidBody, frame_count: int) -> FloatArray | None:
    """Return the motion of a ball that falls on a level plane and rebounds."""
    planes = [other for other in scene.bodies if other.name != ball.name]
    if len(planes) != 1 or not isinstance(planes[0].shape, Plane):
        return None
    pair = {ball.name, planes[0].name}
    contact = next((one for one in scene.contacts if pair in map(set, scene.colliding_pairs(one))), None)
    normal = planes[0].pose.rotation.apply([0.0, 0.0, 1.0])
    if contact is None or normal[2] < 1.0 - 1e-9:
        return None
    gravity, restitution = scene.gravity_m_per_s2, contact.restitution
    drop_m = distance_to_contact_m(ball, planes[0], np.array([0.0, 0.0, -1.0]))
    start = np.array(ball.pose.position_m)
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    heights_m = np.maximum(drop_m - 0.5 * gravity * times_s**2, 0.0)
    speed, begin_s = restitution * math.sqrt(2.0 * gravity * drop_m), math.sqrt(2.0 * drop_m / gravity)
    while begin_s < times_s[-1] and speed**2 / (2.0 * gravity) > LEAST_APEX_M:
        since_s = times_s - begin_s
        inside = (since_s >= 0.0) & (since_s <= 2.0 * speed / gravity)
        heights_m[inside] = (speed * since_s - 0.5 * gravity * since_s**2)[inside]
        begin_s += 2.0 * speed / gravity
        speed *= restitution
    return 1e3 * (start + np.outer(heights_m - drop_m, [0.0, 0.0, 1.0]))


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
    presets = dict.fromkeys(str(run.results[0].settings.get("preset", "")) for m in group for run in m.runs)
    given = other_settings(first)
    family = Family(
        backend=first.backend or "file",
        preset=", ".join(presets),
        is_default="preset" not in given,
        given={name: value for name, value in given.items() if name != "preset"},
        versions=RunConfiguration.of(first).engine_versions,
        points=tuple(sorted(points, key=lambda point: point.cost)),
        resolution=_worst([m.resolution for m in group], units),
        model=_worst([m.model for m in group], units),
    )
    return with_floor(family, [member.measure for member in group], over_scatter=over_scatter)


def with_floor(family: Family, measures: Sequence[ErrorMeasure], *, over_scatter: bool) -> Family:
    """Return a family with the parametric floor of its experiments, and the step that is sufficient for it."""
    found = [measure.floor(family.backend) for measure in measures]
    units = [one.scatter or 1.0 if over_scatter else 1.0 for one in measures]
    floors = [floor[0] / unit for floor, unit in zip(found, units, strict=True) if floor is not None]
    limits = floors + [one.scatter / unit for one, unit in zip(measures, units, strict=True) if one.scatter]
    return replace(
        family,
        floor=min(floors) if len(floors) == len(found) else None,
        floor_source="; ".join(dict.fromkeys(floor[1] for floor in found if floor is not None)),
        sufficient_step_s=_sufficient_step_s(family, min(limits)) if limits else None,
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


def _sufficient_step_s(family: Family, limit: float) -> float | None:
    """Return the largest step from which on the numerical error stays below a limit; None if there is none."""
    line = sorted(
        (one for one in family.points if one.is_on_main_line and one.step_s), key=lambda one: one.step_s or 0.0
    )
    # The converged motion itself proves nothing where its own resolution is above the limit.
    if family.resolution is None or family.resolution > limit:
        return None
    enough = takewhile(lambda one: one.numerical is not None and one.numerical <= limit, line)
    return max((one.step_s or 0.0 for one in enough), default=None)


def _with_fronts(families: Sequence[Family]) -> list[Family]:
    """Return the families with their points marked that lie on a front."""
    every = [(family, point) for family in families for point in family.points if not point.diverged]
    fronts: dict[int, list[str]] = {}
    for error in ERRORS:
        lowest = float("inf")
        # A numerical error is at least the resolution, as the converged motion has 0 itself.
        known = [
            (max(value, family.resolution or 0.0) if error == "numerical" else value, point)
            for family, point in every
            if (value := getattr(point, error)) is not None
        ]
        for value, point in sorted(known, key=lambda one: (one[1].cost, one[0])):
            if value < lowest:
                lowest = value
                fronts.setdefault(id(point), []).append(error)
    return [
        replace(one, points=tuple(replace(p, fronts=tuple(fronts.get(id(p), ()))) for p in one.points))
        for one in families
    ]


# --- runs ------------------------------------------------------------------------------------------------------------

EVENTS = ("pd", "mte", "lsd")
"""Event metrics that measure an experiment without a band, in this order."""

INPUT_KINDS = ("constant", "start", "tilt")
"""Kinds of uncertain inputs that make up the parametric error; the discretization is numerical error."""


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
        band, baselines = reference_band(experiment), experiment.baselines
        event = next((name for name in EVENTS if name in experiment.score.metrics), None)
        # A law until an event covers less than the published event.
        is_partial = band is None or not band.normalized_by_baseline
        if is_partial and event is not None and event in baselines:
            line = baselines[event]
            return cls(experiment=experiment, band=None, metric=event, unit=line.unit, scatter=line.std or None)
        rmse, unit = baselines.get("rmse"), experiment.score.observable.unit
        scatter = None if rmse is None or (band is not None and not band.normalized_by_baseline) else rmse.mean
        return cls(experiment=experiment, band=band, metric="rmse", unit=unit, scatter=scatter or None)

    def frames(self, result: Result) -> FloatArray | None:
        """Return g(t) of a result at the frames, shape [T, D]; None if it did not run to its end."""
        if result.trajectory is None or result.error is not None or result.diverged:
            return None
        frames = sampled_frames(self.experiment, *result.trajectory.arrays())
        return frames if np.isfinite(frames).all() else None

    def distance(self, first: FloatArray, second: FloatArray) -> float:
        """Return the distance of two motions, each g(t) of shape [T, D]; NaN frames of the second are left out."""
        if self.metric != "rmse":
            one, other = (swing_metrics(self.experiment, frames)[self.metric] for frames in (first, second))
            return abs(one - other)
        compared = np.isfinite(second).all(axis=1)
        if self.band is not None:
            compared &= np.isfinite(self.band.mean).any(axis=1)
            first, second = self.band.project(first), self.band.project(second)
        return trajectory_rmse(first[compared], second[compared])

    def to_reality(self, result: Result) -> float | None:
        """Return the first score of a result; None without one.

        With a real scatter it is the normalized score in units of it: an aligned error counts in those of trials that
        are aligned too.
        """
        score = result.score
        if self.metric != "rmse":
            value = raw_score(score, self.metric)
            return None if value is None else abs(value - self.experiment.baselines[self.metric].mean)
        if score.primary is None:
            return None
        normalized = getattr(score, f"{score.primary}_normalized")
        is_counted = self.scatter is not None and normalized is not None
        return normalized * self.scatter if is_counted else getattr(score, score.primary)

    def floor(self, backend: str | None) -> tuple[float, str] | None:
        """Return the parametric floor and its origin; None without stored sensitivities, or with other constants.

        It is the root sum of squares, over the uncertain inputs, of the distance by which one standard uncertainty of
        the input moves the simulated motion: the root mean square of up and down, where these differ.
        """
        table = None if self.metric != "rmse" else experiment_sensitivities(self.experiment, backend)
        if table is None or self.experiment.overrides:
            return None
        is_exact = self.band is not None and not self.band.grade.is_real
        # A law keeps the body where it starts, so another start moves simulation and law alike.
        kinds = [kind for kind in INPUT_KINDS if not (is_exact and kind == "start")]
        count = self.experiment.frame_count
        inputs = [one for one in table.inputs if one.kind in kinds and len(one.change) >= count]
        if not inputs:
            return None
        pairs = [(one.change, one.change if one.change_below is None else one.change_below) for one in inputs]
        squares = [self.distance(side[:count], np.zeros_like(side[:count])) ** 2 for pair in pairs for side in pair]
        return math.sqrt(sum(squares) / 2.0), f"{len(inputs)} inputs, sensitivities of {table.backend}"


# --- runs ---

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
    """

    key: str
    measure: ErrorMeasure
    exact: FloatArray | None
    runs: list[SettingRun] = field(default_factory=list)
    resolution: float | None = None
    model: float | None = None

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
