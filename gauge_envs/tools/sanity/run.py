"""Run a sanity check: the target's own model, then measured objects with its settings, then the change of settings."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from gauge_envs.errors import ParameterError
from gauge_envs.files import versions
from gauge_envs.tools.sanity.cure import find_cure
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
    Cure,
    PartOutcome,
    PhenomenonResult,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import GRASP, phenomenon
from gauge_envs.tools.sanity.robot.robot import mujoco_warnings
from gauge_envs.tools.sanity.selection import OWN_IDS, selection
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
    """Return what physics a training configuration gets wrong, and which change of its settings corrects most.

    Args:
        target: A `TrainingConfiguration`, or a target of `gauge_envs.tools.sanity.configuration`.
        only: Ids of rows or patterns such as `creep-*`; when empty, all rows on the target's own model and on rigid
            bodies, and those on grasps if the target is a model with a hand.
        include_deformables: Whether to measure rows on grasps, a wall and deformable bodies too.
        time_limit_s: Time after which no simulation starts [s]; rows that are not measured by then are declined. None
            for no limit.
        explain: Whether to find the change that corrects most.
        notify: Function that is called with each row as soon as it is complete.

    Returns:
        The report: rows on the target's own model, then rows on measured objects, in a fixed order.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no row.
        MissingExtraError: The backend's engine is not installed.
        ParameterError: The backend refuses the settings for every scene.
    """
    started = time.perf_counter()
    configuration = configuration_of(target)
    chosen = selection(only, include_deformables=include_deformables)
    has_hand = any(group.is_held for group in configuration.contact_groups)
    if has_hand and not only and not include_deformables:
        chosen = (*chosen, *GRASP)
    rows = target_rows(configuration, chosen, notify)
    search: tuple[Cure | None, tuple[str, ...], str] | None = None
    measurements = Measurements(configuration.backend, time_limit_s=time_limit_s)
    objects = _object_rows(measurements, configuration, chosen, notify)
    is_cut_short = any(row.remark == NO_TIME for row in objects)
    if not is_cut_short:
        _check_accepted(configuration, measurements.engine, objects)
    rows += objects
    if explain:
        try:
            words = dialect(configuration.language)
            search = find_cure(configuration, words, measurements, rows)
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
    change, tried, trade = search or (None, (), "")
    return Report(
        configuration=configuration,
        rows=tuple(rows),
        versions={**measurements.versions, **versions()},
        wall_s=time.perf_counter() - started,
        cure=change,
        tried=tried,
        trade=trade,
        unstated=_unstated(configuration),
        notes=tuple(notes),
        asked=tuple(name for name in chosen if name in only),
    )


NO_TIME = "not measured within the time limit"
"""Reason of a row for which the time did not suffice."""


def _object_rows(
    measurements: Measurements,
    configuration: TrainingConfiguration,
    chosen: Sequence[str],
    notify: Callable[[PhenomenonResult], None] | None,
) -> list[PhenomenonResult]:
    """Return the chosen rows on measured objects; the preset is measured where a row is off."""
    rows = []
    for name in chosen:
        if name in OWN_IDS:
            continue
        subject = subject_of(measurements, configuration, phenomenon(name))
        try:
            outcomes = subject.measured()
            is_off = any(out.verdict is not Verdict.INSIDE for out in outcomes.values())
            preset = measurements.measure(subject.phenomenon, {}) if is_off else None
            rows.append(_object_row(subject, outcomes, preset))
        except TimeLimitError:
            unmeasured = Measured(verdict=Verdict.DECLINED, remark=NO_TIME)
            rows.append(result_of(subject.phenomenon, unmeasured, None))
        if notify is not None:
            notify(rows[-1])
    return rows


def _object_row(
    subject: Subject, outcomes: dict[str, Measured], preset: Measured | None
) -> PhenomenonResult:
    """Return the row of the worst set of contact constants, with an outcome for each set."""
    phenomenon = subject.phenomenon
    if not outcomes:
        unmeasured = Measured(verdict=Verdict.DECLINED, remark=subject.inapplicable)
        return result_of(phenomenon, unmeasured, preset, applies=False)
    geoms, worst = worst_of(outcomes)
    # What an engine cannot simulate at all is no part of a check.
    is_unknown = preset is not None and {worst.verdict, preset.verdict} == {
        Verdict.DECLINED
    }
    return result_of(
        phenomenon,
        worst,
        preset,
        applies=not is_unknown,
        # A rollout that diverges is wrong whatever the target states.
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
    """Raise an error where the engine refuses the settings in each scene that it simulates with its preset."""
    applying = [row for row in rows if row.applies]
    is_refused = all(row.verdict is Verdict.DECLINED for row in applying)
    if is_refused and any(row.default is not None for row in applying):
        cause = applying[0].remark
        raise ParameterError(
            f"{configuration.name}: {engine} refuses these settings: {cause}"
        )


def _unstated(configuration: TrainingConfiguration) -> str:
    """Return in one sentence what the target's model leaves open."""
    return ""
    from gauge_envs.tools.sanity.robot.joints import unstated

    return unstated(configuration.robot)
