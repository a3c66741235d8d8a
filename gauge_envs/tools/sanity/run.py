"""Run a sanity check: the target's own model, then measured objects with its settings, then the search for a fix."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.fixtures.parts import ball, contact, ground, thrown
from gauge_envs.registry import package_versions
from gauge_envs.scene import Scene
from gauge_envs.tools.sanity.fix import find_fix
from gauge_envs.tools.sanity.measure import (
    Measured,
    Measurements,
    Subject,
    TimeLimitError,
    result_of,
    subject_of,
    worst_of,
)
from gauge_envs.tools.sanity.model import (
    Fix,
    Need,
    PartOutcome,
    PhenomenonResult,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import GRASP, phenomenon
from gauge_envs.tools.sanity.robot.joints import unstated
from gauge_envs.tools.sanity.robot.robot import mujoco_warnings
from gauge_envs.tools.sanity.scenario import Scenario, effective_settings, run_scenario
from gauge_envs.tools.sanity.selection import TARGET_IDS, selection
from gauge_envs.tools.sanity.stacks import configuration as configuration_of, dialect
from gauge_envs.tools.sanity.target_checks import target_rows

POINT_NOTE = "{}: a round fingertip has one contact, which with condim 3 holds no torque: see gauge recipe --torsion"
"""Note on a hand between whose fingertips a body turns freely."""


@mujoco_warnings()
def check(
    target: Any,
    *,
    only: Sequence[str] = (),
    include_deformables: bool = False,
    time_limit_s: float | None = None,
    explain: bool = True,
    notify: Callable[[PhenomenonResult], None] | None = None,
) -> Report:
    """Check the physics of a training configuration, and find the change of its settings that fixes most.

    Args:
        target: A `TrainingConfiguration`, or a target of `gauge_envs.tools.sanity.configuration`.
        only: Ids of checks or patterns such as `creep-*`; when empty, all checks of the target's own model and of rigid
            bodies. A model with a hand also gets those of grasps.
        include_deformables: Whether to check grasps, a wall and deformable bodies too.
        time_limit_s: Time after which no simulation starts [s]; the checks that are left are not measured. None for
            no limit.
        explain: Whether to find the best fix.
        notify: Function that is called with each result as soon as it is complete.

    Returns:
        The report: checks of the target's own model, then of measured objects, in a fixed order.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no check.
        MissingExtraError: The backend's engine is not installed.
        ParameterError: The backend rejects the settings for every scene.
    """
    started = time.perf_counter()
    configuration = configuration_of(target)
    chosen = selection(only, include_deformables=include_deformables)
    has_hand = any(group.is_held for group in configuration.contact_groups)
    if has_hand and not only and not include_deformables:
        chosen = (*chosen, *GRASP)
    rows = target_rows(configuration, chosen, notify)
    search: tuple[Fix | None, tuple[str, ...], str] = (None, (), "")
    measurements = Measurements(configuration.backend, time_limit_s=time_limit_s)
    objects = _object_rows(measurements, configuration, chosen, notify)
    is_cut_short = any(row.remark == NO_TIME for row in objects)
    if not is_cut_short:
        _check_accepted(configuration, measurements.engine, objects)
    rows += objects
    if explain:
        try:
            language = dialect(configuration.language)
            search = find_fix(configuration, language, measurements, rows)
        except TimeLimitError:
            is_cut_short = True
    notes = []
    if is_cut_short:
        limit = f"the time limit, {time_limit_s} s, is reached"
        notes.append(f"{limit}: the check is incomplete")
    if "grasp-torsion" in chosen:
        notes += [
            POINT_NOTE.format(group.geoms)
            for group in configuration.contact_groups
            if group.is_point and group.constants["condim"] == 3
        ]
    if not only and not is_cut_short:
        notes += force_notes(measurements, configuration)
    fix, tried, trade = search
    return Report(
        configuration=configuration,
        rows=tuple(rows),
        versions={**measurements.versions, **package_versions()},
        wall_s=time.perf_counter() - started,
        fix=fix,
        tried=tried,
        trade=trade,
        unstated="" if configuration.robot is None else unstated(configuration.robot),
        notes=tuple(notes),
        asked=tuple(name for name in chosen if name in only),
    )


IMPACT = Scenario(
    "impact-force",
    "BouncingBall-rubber",
    0.1,
    Scene(
        bodies=(
            thrown(ball("ball", (0.0, 0.0, 0.04), mass_kg=1.0), (0.0, 0.0, -1.0)),
            ground(),
        ),
        contacts=(contact("ball", "ground", friction=0.5),),
        duration_s=0.1,
        gravity_m_per_s2=0.0,
    ),
    interval_s=0.0,
)
"""A ball of 1 kg that hits the ground at 1 m/s, sampled at each step."""

MAX_FORCE_RATIO = 2.0
"""Largest ratio of the peak forces with a tenth of the step and with the step; a rigid impact has 10."""


def force_notes(
    measurements: Measurements, configuration: TrainingConfiguration
) -> list[str]:
    """Return a note where the peak force of an impact depends on the step; no note where it cannot be measured."""
    settings = next(iter(configuration.contact_sets.values()), {})
    effective = measurements.outcome(effective_settings, IMPACT, settings)
    if isinstance(effective, Measured) or Need.CONTACT in configuration.inapplicable:
        return []
    peaks_n, step_s = [], effective["timestep_s"]
    for timestep_s in (step_s, 0.1 * step_s):
        changed = {**settings, "timestep_s": timestep_s}
        rollout = measurements.outcome(run_scenario, IMPACT, changed)
        if isinstance(rollout, Measured):
            return []
        accelerations = np.diff(rollout.velocity("ball")[:, 2]) / rollout.interval_s
        peaks_n.append(float(accelerations.max()))
    if peaks_n[1] <= MAX_FORCE_RATIO * peaks_n[0]:
        return []
    return [
        f"peak contact forces depend on the step: 1 kg at 1 m/s gives {peaks_n[0]:,.0f} N at {1e3 * step_s:g} ms and "
        f"{peaks_n[1]:,.0f} N at a tenth of it; average forces over a fixed time"
    ]


NO_TIME = "not measured within the time limit"
"""Reason of a check for which the time did not suffice."""


def _object_rows(
    measurements: Measurements,
    configuration: TrainingConfiguration,
    chosen: Sequence[str],
    notify: Callable[[PhenomenonResult], None] | None,
) -> list[PhenomenonResult]:
    """Return the chosen checks of measured objects; the preset is measured where a check does not pass."""
    rows = []
    for name in chosen:
        if name in TARGET_IDS:
            continue
        subject = subject_of(measurements, configuration, phenomenon(name))
        try:
            outcomes = subject.measured()
            is_off = any(
                outcome.verdict is not Verdict.PASSED for outcome in outcomes.values()
            )
            preset = measurements.measure(subject.phenomenon, {}) if is_off else None
            rows.append(_object_row(subject, outcomes, preset))
        except TimeLimitError:
            unmeasured = Measured(verdict=Verdict.NOT_MEASURED, remark=NO_TIME)
            rows.append(result_of(subject.phenomenon, unmeasured, None))
        if notify is not None:
            notify(rows[-1])
    return rows


def _object_row(
    subject: Subject, outcomes: dict[str, Measured], preset: Measured | None
) -> PhenomenonResult:
    """Return the result of the worst set of contact constants, with an outcome for each set."""
    phenomenon = subject.phenomenon
    if not outcomes:
        unmeasured = Measured(verdict=Verdict.NOT_MEASURED, remark=subject.inapplicable)
        return result_of(phenomenon, unmeasured, preset, applies=False)
    geoms, worst = worst_of(outcomes)
    # A scene that the engine cannot simulate at all is not checked.
    is_unknown = preset is not None and {worst.verdict, preset.verdict} == {
        Verdict.NOT_MEASURED
    }
    return result_of(
        phenomenon,
        worst,
        preset,
        applies=not is_unknown,
        # A rollout that diverges fails even where the check is advice.
        advisory="" if worst.rollout is None else subject.advisory,
        geoms=geoms if len(outcomes) > 1 else "",
        parts=tuple(
            PartOutcome(
                name=name,
                value=outcome.value,
                verdict=outcome.verdict,
                deviation=outcome.deviation,
                remark=outcome.remark,
            )
            for name, outcome in outcomes.items()
        ),
    )


def _check_accepted(
    configuration: TrainingConfiguration,
    engine: str,
    rows: Sequence[PhenomenonResult],
) -> None:
    """Raise an error where the engine rejects the settings in each scene that it simulates with its preset."""
    applying = [row for row in rows if row.applies]
    is_rejected = all(row.verdict is Verdict.NOT_MEASURED for row in applying)
    if is_rejected and any(row.default is not None for row in applying):
        cause = applying[0].remark
        raise ParameterError(
            f"{configuration.name}: {engine} rejects these settings: {cause}"
        )
