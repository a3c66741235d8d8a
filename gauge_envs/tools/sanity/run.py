"""Run a sanity check: measure phenomena with the backend's default and the configuration, and find causes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gauge_envs.errors import GaugeError, ParameterError, TargetError
from gauge_envs.files import MEGABYTE, json_document, os_errors, read_regular, versions
from gauge_envs.tools.sanity.cause import candidates_of, find_cause
from gauge_envs.tools.sanity.measure import (
    Engine,
    Measured,
    Measurements,
    Subject,
    TimeLimitError,
    curve_of,
    result_of,
    simulation_limit_s,
    subject_of,
    worst_of,
)
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    Cure,
    GroupOutcome,
    PhenomenonResult,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import (
    CAPACITY_ID,
    GRASP,
    GRAVITY_ID,
    RIGID,
    ROBOT_IDS,
    phenomenon,
    selection,
)
from gauge_envs.tools.sanity.stacks import configuration as configuration_of, dialect
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.target_checks import target_fixes, target_rows

WARP_S = 1.1
"""Longest scene that is run on mujoco_warp on a CPU [s], which takes a second for each."""

LIMITS = ("njmax", "naconmax")
"""Changes that belong to the memory for contacts, not to the model."""

POINT_NOTE = "{}: a round fingertip has one contact, which with condim 3 holds no torque: see gauge recipe torsion_m="
"""Note on a hand between whose fingertips a body turns freely."""


def applied(
    configuration: TrainingConfiguration, changes: Mapping[str, Any]
) -> tuple[TrainingConfiguration, dict[str, list[str]]]:
    """Return the configuration that is read back with changes, and geoms that state a changed attribute themselves.

    Args:
        configuration: The configuration.
        changes: New values, as `Robot.changed` takes them, with the limits of the memory for contacts.
    """
    limits = {name: value for name, value in changes.items() if name in LIMITS}
    others = {name: value for name, value in changes.items() if name not in LIMITS}
    robot, geoms_by_setting = configuration.robot, {}
    if robot is None or configuration.backend != "mujoco":
        gravity = (
            {"gravity_m_per_s2": others.pop("gravity")} if "gravity" in others else {}
        )
        groups = tuple(
            replace(g, settings={**g.settings, **others})
            for g in configuration.contact_groups
        )
        settings = {**configuration.settings, **others}
        read = replace(
            configuration, settings=settings, contact_groups=groups, **gravity
        )
    else:
        from gauge_envs.tools.sanity.robot.mujoco_feet import geom_name
        from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

        model, geoms = robot.changed(others)
        for name, several in geoms.items():
            geoms_by_setting[name] = [geom_name(robot.model, geom) for geom in several]
        read = mujoco_configuration(
            model,
            name=configuration.name,
            source=configuration.source,
            spec=robot.spec,
            pair=robot.pair,
        )
        read = replace(
            read,
            language=configuration.language,
            trains_on=configuration.trains_on,
            capacity=configuration.capacity,
        )
    if limits and read.capacity is not None:
        larger = replace(read.capacity.limits, **limits)
        read = replace(read, capacity=replace(read.capacity, limits=larger))
    return read, geoms_by_setting


def find_cure(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    candidates: Sequence[Mapping[str, Any]],
    texts: Sequence[str],
    rows: Mapping[str, bool],
) -> Cure | None:
    """Return the candidate that mends most flags, as measured after it was applied; None when none mends one.

    Args:
        configuration: The checked configuration.
        dialect: Dialect of the target.
        measurements: Measurements on the engine of the rows.
        candidates: Changes of settings and of rows of arrays of the model, the preferred ones first.
        texts: What belongs to all of them and is no setting, in words that can be pasted.
        rows: Ids of the rows that count, and whether they are flagged.
    """
    verdict_of, engine = _training_verdicts(configuration, dialect, measurements, rows)
    flags = []
    for name, is_flag in rows.items():
        if is_flag and verdict_of(configuration, name) is not Verdict.INSIDE:
            flags.append(name)
    cures: list[Cure] = []
    for changes in candidates:
        try:
            cured, geoms_by_setting = applied(configuration, changes)
        except GaugeError:
            continue
        mended = [name for name in flags if verdict_of(cured, name) is Verdict.INSIDE]
        new_flags: list[str] = []
        if mended:
            new_flags = [
                name
                for name, is_flag in rows.items()
                if not is_flag and verdict_of(cured, name).is_off
            ]
        if len(mended) <= len(new_flags):
            continue
        pasted = _pasted(configuration, dialect, changes, geoms_by_setting, texts)
        cure = Cure(
            changes=changes,
            line=f"{pasted}: {_effect(flags, mended, new_flags, engine)}",
            flag_count=len(flags),
            mended_count=len(mended),
            new_flags=tuple(new_flags),
        )
        cures.append(cure)
        if len(mended) == len(flags) and not new_flags:
            break
    # Of equal cures, the first is the preferred one.
    return max(
        cures,
        key=lambda one: (one.mended_count - len(one.new_flags), -len(one.changes)),
        default=None,
    )


def _effect(
    flags: Sequence[str], mended: Sequence[str], new_flags: Sequence[str], engine: str
) -> str:
    """Return what a change does to the flags, in words."""
    count = (
        f"{len(mended)} of {len(flags)} flags go"
        if len(flags) > 1
        else "the one flag goes"
    )
    parts = [count + engine]
    left = [name for name in flags if name not in mended]
    if left:
        parts.append(f"left: {', '.join(left)}")
    if new_flags:
        parts.append(f"new flags: {', '.join(new_flags)}")
    return "; ".join(parts)


def _pasted(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    changes: Mapping[str, Any],
    geoms_by_setting: Mapping[str, Sequence[str]],
    texts: Sequence[str],
) -> str:
    """Return changes as text to paste, before further texts; geoms that state an attribute themselves are named."""
    robot, default = configuration.robot, {}
    for name, value in changes.items():
        if "[" in name or name == "gravity":
            # A row of an array, or gravity: the texts say it.
            continue
        if name in geoms_by_setting:
            is_default = robot is None or robot.needs_default(name, value)
        else:
            is_default = dialect.assignment(name, value) not in " ".join(texts)
        if is_default:
            default[name] = value
    parts = [dialect.paste_text(default)] if default else []
    for name, geoms in geoms_by_setting.items():
        more = f" and {len(geoms) - 3} more" if len(geoms) > 3 else ""
        assignment = dialect.assignment(name, changes[name])
        parts.append(
            f"{assignment} in {', '.join(geoms[:3])}{more}, which the default does not reach"
        )
    return " and ".join([*parts, *texts])


def _training_verdicts(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    rows: Mapping[str, bool],
) -> tuple[Callable[[TrainingConfiguration, str], Verdict], str]:
    """Return a function from a configuration and a row to its verdict, and the engine of training in words.

    Rows that are flagged are measured on the engine of training, others on that of the rows.
    """
    training, engine = measurements, ""
    flagged = [
        phenomenon(name)
        for name, is_flag in rows.items()
        if is_flag and name in (*RIGID, *GRASP)
    ]
    is_short = any(one.scenario.seconds <= WARP_S for one in flagged)
    if configuration.trains_on == "mujoco_warp" and is_short:
        try:
            from gauge_envs.tools.sanity.mujoco_warp_run import BackendMuJoCoWarp

            training, engine = (
                Measurements(BackendMuJoCoWarp()),
                " on mujoco_warp, where it trains",
            )
        except GaugeError:
            engine = " on MuJoCo's C engine; mujoco_warp, on which it trains, is not installed"

    def verdict_of(cured: TrainingConfiguration, name: str) -> Verdict:
        checked = target_rows(cured, dialect, [name])
        if checked:
            return checked[0].verdict
        one = phenomenon(name)
        is_training = rows[name] and one.scenario.seconds <= WARP_S
        subject = subject_of(training if is_training else measurements, cured, one)
        if not subject.sets:
            return Verdict.DECLINED
        return worst_of(subject.measured())[1].verdict

    return verdict_of, engine


def check(
    target: Any,
    *,
    only: Sequence[str] = (),
    include_deformables: bool = False,
    time_limit_s: float | None = None,
    explain: bool = True,
    notify: Callable[[PhenomenonResult], None] | None = None,
) -> Report:
    """Return what physics a training configuration gets wrong, and which of its settings are responsible.

    All phenomena are measured in the configuration first. Then come those of this package's preset and the causes where
    a row is not inside, and the change that mends most, which is applied and measured.

    Args:
        target: A `TrainingConfiguration`, or a target of `gauge_envs.tools.sanity.configuration`.
        only: Ids of phenomena or patterns such as `creep-*`; when empty, all of rigid bodies, and of grasps if the
            target is a model with a hand.
        include_deformables: Whether to measure phenomena of grasps and of deformable bodies too.
        time_limit_s: Time after which no simulation starts any more [s]; rows that are not measured by then are
            declined. It bounds each simulation of an engine of another package too. None for no limit.
        explain: Whether to find the responsible settings and the change that mends most.
        notify: Function that is called with each row as soon as it is complete.

    Returns:
        The report, with a row for each phenomenon in a fixed order.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no phenomenon.
        MissingExtraError: The backend's engine is not installed.
        ParameterError: The backend refuses the settings for every scene.
    """
    started = time.perf_counter()
    configuration = configuration_of(target)
    chosen = selection(only, include_deformables=include_deformables)
    if (
        not only
        and not include_deformables
        and any(group.is_held for group in configuration.contact_groups)
    ):
        chosen = (*chosen, *GRASP)
    with closing(
        Engine(configuration.backend, simulation_limit_s(time_limit_s))
    ) as engine:
        measurements = Measurements(
            engine, time_limit_s=math.inf if time_limit_s is None else time_limit_s
        )
        run = _Run(measurements, configuration, explain=explain)
        rows = []
        for row in run.rows(chosen):
            rows.append(row)
            if notify is not None:
                notify(row)
        # Rows that need no rollout are the last ones to be complete, and stand first.
        rows.sort(key=lambda row: bool(row.experiment))
        simulated = [row for row in rows if row.experiment and row.applies]
        refused = (
            simulated
            and all(row.verdict is Verdict.DECLINED for row in simulated)
            and not run.is_cut_short
        )
        if refused and any(row.default is not None for row in simulated):
            raise ParameterError(
                f"{configuration.name}: {engine.name} refuses these settings: {simulated[0].remark}"
            )
        cure = run.cure(rows) if explain else None
    points = [
        one.geoms
        for one in configuration.contact_groups
        if one.is_point and one.constants["condim"] == 3
    ]
    return Report(
        configuration=configuration,
        rows=tuple(rows),
        versions={**engine.versions, **versions()},
        wall_s=time.perf_counter() - started,
        cure=cure,
        notes=(
            *(
                [
                    f"the time limit, {time_limit_s} s, is reached: the check is incomplete"
                ]
                if run.is_cut_short
                else []
            ),
            *(
                POINT_NOTE.format(geoms)
                for geoms in points
                if "grasp-torsion" in chosen
            ),
        ),
        asked=tuple(name for name in chosen if name in only),
    )


class _Run:
    """Measures all phenomena in a configuration, and explains what is flagged."""

    def __init__(
        self,
        measurements: Measurements,
        configuration: TrainingConfiguration,
        *,
        explain: bool,
    ) -> None:
        self._explain = explain
        self._measurements = measurements
        self._configuration = configuration
        self._subjects: list[Subject] = []
        self._dialect = dialect(configuration.language)
        self.is_cut_short = False

    def rows(self, chosen: Sequence[str]) -> Iterator[PhenomenonResult]:
        """Yield a row for each phenomenon, those on what the target states at the end."""
        stated = (GRAVITY_ID, CAPACITY_ID, *ROBOT_IDS)
        simulated = [phenomenon(name) for name in chosen if name not in stated]
        self._subjects = [
            subject_of(self._measurements, self._configuration, one)
            for one in simulated
        ]
        outcomes = [self._in_time(one.measured) or {} for one in self._subjects]
        defaults = [
            self._in_time(partial(self._measurements.measure, one.phenomenon, {}))
            if _is_off(outcome)
            else None
            for one, outcome in zip(self._subjects, outcomes, strict=True)
        ]
        for subject, outcome, default in zip(
            self._subjects, outcomes, defaults, strict=True
        ):
            yield self._row(subject, outcome, default)
        yield from target_rows(self._configuration, self._dialect, chosen)

    def cure(self, rows: Sequence[PhenomenonResult]) -> Cure | None:
        """Return the change that mends most flags; None when there is no flag or no cure."""
        flags = {row.phenomenon for row in rows if row.is_flag}
        # Where an engine died, changes would let it die again.
        explained = {row.phenomenon for row in rows if row.cause is not None}
        flagged = [
            one for one in self._subjects if one.phenomenon.id in flags & explained
        ]
        others = [
            one
            for one in self._subjects
            if one.sets and one.phenomenon.id not in flags and not one.advisory
        ]
        named = {
            name for row in rows if row.cause is not None for name in row.cause.settings
        }
        search = (self._configuration, flagged, others, self._dialect, named)
        found = self._in_time(partial(candidates_of, *search)) or []
        fixes = target_fixes(self._configuration, self._dialect, flags)
        texts = tuple(
            dict.fromkeys(
                text for name, (text, _) in fixes.items() if name != CAPACITY_ID
            )
        )
        changes = {
            key: value
            for _, several in fixes.values()
            for key, value in several.items()
        }
        candidates = [{**one, **changes} for one in found] + [changes] * bool(changes)
        counted = {
            row.phenomenon: row.is_flag
            for row in rows
            if row.is_flag or row.verdict is Verdict.INSIDE
        }
        cure = partial(
            find_cure,
            self._configuration,
            self._dialect,
            self._measurements,
            candidates,
            texts,
            counted,
        )
        return self._in_time(cure) if candidates else None

    def _in_time(self, work: Callable[[], Any]) -> Any:
        """Return the result of work; None when the time limit is reached."""
        try:
            return work()
        except TimeLimitError:
            self.is_cut_short = True
            return None

    def _row(
        self, subject: Subject, outcomes: dict[str, Measured], default: Measured | None
    ) -> PhenomenonResult:
        phenomenon, advisory = subject.phenomenon, subject.advisory
        if not outcomes:
            remark = subject.inapplicable or "not measured within the time limit"
            unmeasured = Measured(verdict=Verdict.DECLINED, remark=remark)
            return result_of(
                phenomenon,
                unmeasured,
                default,
                advisory=advisory,
                applies=not subject.inapplicable,
            )
        geoms, configured = worst_of(outcomes)
        cause = None
        if configured.rollout is None:
            # A rollout that diverges is wrong whatever the target states.
            advisory = ""
        if self._explain and not advisory and default is not None:
            search = (
                self._measurements,
                phenomenon,
                subject.sets[geoms],
                configured,
                default,
                self._dialect,
            )
            cause = self._in_time(partial(find_cause, *search))
        # What an engine cannot simulate at all is no part of a check.
        unknown = default is not None and {configured.verdict, default.verdict} == {
            Verdict.DECLINED
        }
        row = result_of(
            phenomenon,
            configured,
            default,
            applies=not unknown,
            cause=cause,
            curve=curve_of(phenomenon, configured, default),
            advisory=advisory,
        )
        if len(outcomes) == 1:
            return row
        groups = [
            GroupOutcome(geoms=g, value=m.value, verdict=m.verdict, remark=m.remark)
            for g, m in outcomes.items()
        ]
        return replace(row, geoms=geoms, groups=tuple(groups))


def _is_off(outcome: Mapping[str, Measured]) -> bool:
    """Return whether an outcome needs that of the preset beside it."""
    return any(one.verdict is not Verdict.INSIDE for one in outcome.values())


# --- comparison with an earlier run ----------------------------------------------------------------------------------

MOST_BASELINE_BYTES = 16 * MEGABYTE
"""Largest size of a file with an earlier run."""

GROWTH = 1.0
"""Growth of a deviation, in half-widths of the interval of reality, from which on a flagged row is a regression."""


def read_baseline(path: Path) -> dict[str, float]:
    """Return the deviation of each row of an earlier run, in half-widths of the interval of reality, by its id.

    Args:
        path: File with the output of `gauge sanity TARGET --json`.
    """
    with os_errors(lambda cause: TargetError(f"{path}: cannot be read: {cause}")):
        content = read_regular(path, MOST_BASELINE_BYTES)
    try:
        lines = [json_document(line) for line in content.splitlines() if line.strip()]
        found = {
            line["phenomenon"]: _deviation(line)
            for line in lines
            if "phenomenon" in line
        }
    except (TypeError, ValueError, KeyError, ArithmeticError) as error:
        raise TargetError(
            f"{path}: is not the output of gauge sanity --json: {error}"
        ) from None
    if not found:
        raise TargetError(
            f"{path}: has no row; write it with gauge sanity TARGET --json > {path}"
        )
    return found


def _deviation(line: Mapping[str, Any]) -> float:
    verdict, value, reality = (
        Verdict(line["verdict"]),
        line["configured"],
        line["reality"],
    )
    if verdict in (Verdict.INSIDE, Verdict.DECLINED):
        return INSIDE_WITHIN
    return (
        math.inf
        if value is None
        else abs(value - reality["value"]) / reality["tolerance"]
    )


def regressions(
    report: Report, baseline: Mapping[str, float], *, least: Verdict
) -> list[PhenomenonResult]:
    """Return flagged rows, at least as bad as `least`, that are farther from reality than in the baseline.

    Farther is by more than a half-width of the interval, or out of the interval. A row that the baseline does not have,
    or that it declined, is compared with `inside`.
    """
    counted = (
        (Verdict.WRONG,) if least is Verdict.WRONG else (Verdict.WRONG, Verdict.VISIBLE)
    )
    worse = []
    for row in report.rows:
        before = baseline.get(row.phenomenon, INSIDE_WITHIN)
        after = row.deviation
        grown = after > before + GROWTH or before <= INSIDE_WITHIN
        if row.is_flag and row.verdict in counted and grown:
            worse.append(row)
    return worse
