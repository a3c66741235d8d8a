"""Error over cost of phenomena: the curves of `gauge_envs.tools.compare.cost` over experiments of one family.

`pareto_model` states the definitions.

An exact motion of an experiment with its own constants is chosen by what is in the scene, never by a name: of carried
bodies, slides, rebounds and pendulums. A scene has one if a single rigid body is recorded, and its motion follows from
friction, restitution or gravity alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.evaluation.deviation import experiment_sensitivities
from gauge_envs.evaluation.laws import distance_to_contact_m, slide
from gauge_envs.evaluation.pendulum_laws import Pendulum
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.pages.text import short_id
from gauge_envs.references.grades import BandGrade
from gauge_envs.runs.configuration import RunConfiguration
from gauge_envs.runs.result import Result
from gauge_envs.scene import Hinge, Motion, Plane, RigidBody, Scene, Sphere
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare.cost import (
    REFERENCE_ENGINE,
    CostCurve,
    ErrorMeasure,
    SettingCost,
    cost_curves,
    other_settings,
)
from scripts.pareto_model import Family, Phenomenon, Point, Tradeoff

INPUT_KINDS = ("constant", "start", "tilt")
"""Kinds of uncertain inputs that make up the parametric error; the discretization is numerical error."""

LEAST_APEX_M = 1e-9
"""Height of a rebound below which the ball rests [m]."""


def closed_form(experiment: Experiment) -> FloatArray | None:
    """Return the exact g(t) of an experiment at its frames.

    - Where the package states a law of all coordinates in place of trials, as for a carried body, it is that law.
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
    if (
        experiment.score.observable is not Observable.POSITION
        or len(experiment.recorded) != 1
        or not is_alone
    ):
        return None
    body = scene.body(experiment.recorded[0])
    if any(isinstance(joint, Hinge) for joint in scene.joints):
        if scene.contacts or scene.drivers:
            return None
        pendulum = Pendulum.of(scene, body.name)
        times_s = np.arange(experiment.frame_count) / FRAME_RATE_HZ
        return pendulum.positions_mm(pendulum.released_rad(times_s))
    band = reference_band(experiment)
    if band and band.grade is BandGrade.LAW and band.projection.shape == (3, 3):
        return np.asarray(band.mean @ np.linalg.inv(band.projection).T)
    if scene.drivers or body.motion is not Motion.DYNAMIC or not body.starts_at_rest:
        return None
    if isinstance(body.shape, Sphere):
        return _rebounds(scene, body, experiment.frame_count)
    return _slide(scene, body, experiment.frame_count)


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
    contact = next(
        (one for one in scene.contacts if pair in map(set, scene.colliding_pairs(one))),
        None,
    )
    normal = planes[0].pose.rotation.apply([0.0, 0.0, 1.0])
    if contact is None or normal[2] < 1.0 - 1e-9:
        return None
    gravity, restitution = scene.gravity_m_per_s2, contact.restitution
    drop_m = distance_to_contact_m(ball, planes[0], np.array([0.0, 0.0, -1.0]))
    start = np.array(ball.pose.position_m)
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    heights_m = np.maximum(drop_m - 0.5 * gravity * times_s**2, 0.0)
    speed = restitution * math.sqrt(2.0 * gravity * drop_m)
    begin_s = math.sqrt(2.0 * drop_m / gravity)
    while begin_s < times_s[-1] and speed**2 / (2.0 * gravity) > LEAST_APEX_M:
        since_s = times_s - begin_s
        inside = (since_s >= 0.0) & (since_s <= 2.0 * speed / gravity)
        heights_m[inside] = (speed * since_s - 0.5 * gravity * since_s**2)[inside]
        begin_s += 2.0 * speed / gravity
        speed *= restitution
    return 1e3 * (start + np.outer(heights_m - drop_m, [0.0, 0.0, 1.0]))


def parametric_floor(measure: ErrorMeasure, backend: str | None) -> float | None:
    """Return the parametric floor; None without stored sensitivities, or with other constants.

    It is the root sum of squares, over the uncertain inputs, of the distance by which one standard uncertainty of the
    input moves the simulated motion: the root mean square of up and down, where these differ.
    """
    table = (
        None
        if measure.metric != "rmse"
        else experiment_sensitivities(measure.experiment, backend)
    )
    if table is None or measure.experiment.overrides:
        return None
    is_exact = measure.band is not None and not measure.band.grade.is_real
    # A law keeps the body where it starts, so another start moves simulation and law alike.
    kinds = [kind for kind in INPUT_KINDS if not (is_exact and kind == "start")]
    count = measure.experiment.frame_count
    inputs = [
        one for one in table.inputs if one.kind in kinds and len(one.change) >= count
    ]
    if not inputs:
        return None
    pairs = [
        (one.change, one.change if one.change_below is None else one.change_below)
        for one in inputs
    ]
    squares = [
        measure.distance(side[:count], np.zeros_like(side[:count])) ** 2
        for pair in pairs
        for side in pair
    ]
    return math.sqrt(sum(squares) / 2.0)


@dataclass
class Member:
    """A family on one experiment.

    Attributes:
        curve: Its settings and their errors.
        exact: Distance of each setting to the exact motion, in the unit of the score; None without one.
    """

    curve: CostCurve
    exact: list[float | None]

    @classmethod
    def of(cls, curve: CostCurve) -> Member:
        """Return the family of a curve."""
        exact = closed_form(curve.measure.experiment)
        distances: list[float | None] = []
        for setting in curve.settings:
            distance = math.inf
            if exact is not None and setting.frames is not None:
                distance = curve.measure.distance(setting.frames, exact)
            # An event may never happen.
            distances.append(distance if np.isfinite(distance) else None)
        return cls(curve, distances)

    @property
    def id(self) -> str:
        """Id of the experiment."""
        return self.curve.measure.experiment.id

    @property
    def model(self) -> float | None:
        """Model error."""
        settings = zip(self.curve.settings, self.exact, strict=True)
        return next(
            (distance for setting, distance in settings if setting.is_converged), None
        )


def tradeoff(results: Iterable[Result]) -> Tradeoff:
    """Return error over cost for results of many settings.

    Repeats of one setting differ in their seed alone. Results with a jittered start, and those that did not run, are
    left out with a note.
    """
    notes: list[str] = []
    curves = cost_curves(results, notes)
    groups: dict[str, list[Member]] = {}
    for curve in curves:
        groups.setdefault(_phenomenon_name(curve.first), []).append(Member.of(curve))
    phenomena = [_phenomenon(name, group, notes) for name, group in groups.items()]
    versions = curves[0].first.versions
    return Tradeoff(
        cost=curves[0].time,
        reference=f"{REFERENCE_ENGINE} with its default settings, on the same experiments",
        phenomena=tuple(phenomena),
        versions={
            name: versions[name]
            for name in ("gauge-envs", "python")
            if name in versions
        },
        notes=tuple(dict.fromkeys(notes)),
    )


def _phenomenon_name(result: Result) -> str:
    name = short_id(result.id).rpartition("-")[0]
    if result.parameters == "calibrated":
        return name
    return f"{name}, {result.parameters if isinstance(result.parameters, str) else 'custom'}"


def _phenomenon(name: str, members: Sequence[Member], notes: list[str]) -> Phenomenon:
    """Return the families that ran all experiments of a phenomenon."""
    first = members[0].curve.measure
    ids = sorted({member.id for member in members})
    scatter = {
        one.id: one.curve.measure.scatter
        for one in members
        if one.curve.measure.scatter is not None
    }
    over_scatter = len(scatter) == len(ids)
    by_key: dict[str, list[Member]] = {}
    for member in members:
        by_key.setdefault(member.curve.key, []).append(member)
    for key, group in list(by_key.items()):
        missing = set(ids) - {member.id for member in group}
        if missing:
            one = group[0].curve.first
            which = f"{one.backend} with {other_settings(one) or 'its presets'}"
            notes.append(
                f"{name}: {which} is left out, as it did not run {', '.join(sorted(missing))}"
            )
            del by_key[key]
    unit_cost = _reference_cost(by_key.values())
    families = [
        _family(group, unit_cost, over_scatter=over_scatter)
        for group in by_key.values()
    ]
    return Phenomenon(
        name=name,
        ids=tuple(ids),
        metric=first.metric,
        unit="scatter" if over_scatter else first.unit,
        scatter=scatter if over_scatter else {},
        families=tuple(
            sorted(
                families, key=lambda one: (one.backend, not one.is_default, one.name)
            )
        ),
    )


def _reference_cost(groups: Iterable[Sequence[Member]]) -> float | None:
    """Return the cost of the reference engine with default settings; None if it did not run."""
    for group in groups:
        chosen = [
            setting
            for member in group
            for setting in member.curve.settings
            if any(
                one.backend == REFERENCE_ENGINE and not one.settings_given
                for one in setting.results
            )
        ]
        if len(chosen) == len(group):
            return _common_costs(chosen)[0]
    return None


def _common_costs(settings: Sequence[SettingCost]) -> tuple[float, float]:
    """Return the least and the most cost of settings of several experiments, over their common time."""
    spans_s = np.array([one.results[0].sim_s for one in settings])
    costs = np.array([(one.cost, max(one.costs)) for one in settings])
    smallest, largest = spans_s @ costs / max(spans_s.sum(), 1e-9)
    return float(smallest), float(largest)


def _family(
    group: Sequence[Member], unit_cost: float | None, *, over_scatter: bool
) -> Family:
    """Return a family over all experiments of a phenomenon."""
    curves = [member.curve for member in group]
    first = curves[0].first
    units = [
        (curve.measure.scatter or 1.0) if over_scatter else 1.0 for curve in curves
    ]
    points = []
    for one in curves[0].settings:
        found = [
            (member, number)
            for member in group
            for number, setting in enumerate(member.curve.settings)
            if setting.effort == one.effort
        ]
        if len(found) == len(group):
            points.append(_point(found, units, unit_cost))
    presets = dict.fromkeys(
        str(one.results[0].settings.get("preset", ""))
        for c in curves
        for one in c.settings
    )
    given = other_settings(first)
    family = Family(
        backend=first.backend or "file",
        preset=", ".join(presets),
        is_default="preset" not in given,
        given={name: value for name, value in given.items() if name != "preset"},
        versions=RunConfiguration.of(first).engine_versions,
        points=tuple(sorted(points, key=lambda point: point.cost)),
        resolution=_worst([curve.resolution for curve in curves], units),
        model=_worst([member.model for member in group], units),
    )
    return with_floor(
        family, [curve.measure for curve in curves], over_scatter=over_scatter
    )


def with_floor(
    family: Family, measures: Sequence[ErrorMeasure], *, over_scatter: bool
) -> Family:
    """Return a family with the parametric floor of its experiments, and the step that is sufficient for it."""
    found = [parametric_floor(measure, family.backend) for measure in measures]
    units = [one.scatter or 1.0 if over_scatter else 1.0 for one in measures]
    floors = [
        floor / unit
        for floor, unit in zip(found, units, strict=True)
        if floor is not None
    ]
    limits = floors + [
        one.scatter / unit
        for one, unit in zip(measures, units, strict=True)
        if one.scatter
    ]
    return replace(
        family,
        floor=min(floors) if len(floors) == len(found) else None,
        sufficient_step_s=_sufficient_step_s(family, min(limits)) if limits else None,
    )


def _point(
    found: Sequence[tuple[Member, int]], units: Sequence[float], unit_cost: float | None
) -> Point:
    settings = [member.curve.settings[number] for member, number in found]
    cost, cost_most = _common_costs(settings)
    # The shortest request for the setting is that of a user.
    given = min((one.settings_given for one in settings[0].results), key=len)
    return Point(
        effort=settings[0].effort,
        settings_given=given,
        step_s=settings[0].step_s or None,
        cost=cost,
        cost_most=cost_most,
        cost_ratio=cost / unit_cost if unit_cost else None,
        repeats=min(len(one.results) for one in settings),
        diverged=any(one.frames is None for one in settings),
        numerical=_worst([one.numerical for one in settings], units),
        to_closed_form=_worst(
            [member.exact[number] for member, number in found], units
        ),
        to_reality=_worst(
            [
                None if member.curve.measure.is_verified else one.to_reference
                for (member, _), one in zip(found, settings, strict=True)
            ],
            units,
        ),
        is_reference=all(one.is_converged for one in settings),
        is_on_main_line=all(one.is_main for one in settings),
    )


def _worst(values: Sequence[float | None], units: Sequence[float]) -> float | None:
    """Return the largest error over its unit; None if one is unknown."""
    known = [
        value / unit
        for value, unit in zip(values, units, strict=True)
        if value is not None
    ]
    return max(known) if len(known) == len(values) else None


def _sufficient_step_s(family: Family, limit: float) -> float | None:
    """Return the largest step from which on the numerical error stays below a limit; None if there is none."""
    line = sorted(
        (one for one in family.points if one.is_on_main_line and one.step_s),
        key=lambda one: one.step_s or 0.0,
    )
    # The converged motion itself proves nothing where its own resolution is above the limit.
    if family.resolution is None or family.resolution > limit:
        return None
    enough = takewhile(
        lambda one: one.numerical is not None and one.numerical <= limit, line
    )
    return max((one.step_s or 0.0 for one in enough), default=None)
