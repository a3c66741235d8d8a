"""Run a sanity check: measure phenomena with the backend's default and the configuration, and find causes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.files import versions
from gauge_envs.tools.sanity.capacity import CAPACITY_ID, capacity_changes, capacity_row
from gauge_envs.tools.sanity.cause import find_cause
from gauge_envs.tools.sanity.cure import find_cure
from gauge_envs.tools.sanity.engine import Engine, simulation_limit_s
from gauge_envs.tools.sanity.gravity import GRAVITY_ID, gravity_row, upright_gravity
from gauge_envs.tools.sanity.languages import language
from gauge_envs.tools.sanity.measure import Measured, Measurements, TimeLimitError
from gauge_envs.tools.sanity.model import (
    Cause,
    Cure,
    Curve,
    GroupOutcome,
    PhenomenonResult,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import Phenomenon, phenomena
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray
from gauge_envs.tools.sanity.selection import selection
from gauge_envs.tools.sanity.subject import Subject, subject_of, worst_of

CURVE_SAMPLES = 200
"""Largest number of samples of a curve; a figure shows fewer."""


def check(
    target: Any,
    *,
    only: Sequence[str] = (),
    include_deformables: bool = False,
    time_limit_s: float | None = None,
    notify: Callable[[PhenomenonResult], None] | None = None,
) -> Report:
    """Return what physics a training configuration gets wrong, and which of its settings are responsible.

    All phenomena are measured in the configuration first. Then come those of this package's preset, the causes, and the
    change that mends most.

    Args:
        target: A `TrainingConfiguration`, or a target of `gauge_envs.tools.sanity.configuration`.
        only: Ids of phenomena or patterns such as `creep-*`; all when empty.
        include_deformables: Whether to measure phenomena of deformable bodies.
        time_limit_s: Time after which no simulation starts any more [s]; rows that are not measured by then are
            declined. It bounds each simulation of an engine of another package too. None for no limit.
        notify: Function that is called with each row as soon as it is complete.

    Returns:
        The report, with a row for each phenomenon in a fixed order.

    Raises:
        UnknownNameError: There is no such backend, or a pattern matches no phenomenon.
        MissingExtraError: The backend's engine is not installed.
        ParameterError: The backend refuses the settings for every scene.
    """
    started = time.perf_counter()
    configuration = _configuration(target)
    chosen = selection(only, include_deformables=include_deformables)
    with Engine(configuration.backend, simulation_limit_s(time_limit_s)) as engine:
        measurements = Measurements(engine, time_limit_s=math.inf if time_limit_s is None else time_limit_s)
        run = _Run(measurements, configuration)
        rows = run.rows([one for one in phenomena(include_deformables=True) if one.id in chosen], notify=notify)
        stated = run.stated_rows(chosen)
        rows = [*stated, *rows]
        for row in stated:
            if notify is not None:
                notify(row)
        simulated = [row for row in rows if row.experiment and row.applies]
        refused = simulated and all(row.verdict is Verdict.DECLINED for row in simulated) and not run.is_cut_short
        if refused and any(row.default is not None for row in simulated):
            raise ParameterError(f"{configuration.name}: {engine.name} refuses these settings: {simulated[0].remark}")
        cure = run.cure(rows)
    return Report(
        configuration=configuration,
        rows=tuple(rows),
        versions={**engine.versions, **versions()},
        wall_s=time.perf_counter() - started,
        cure=cure,
        notes=(f"the time limit, {time_limit_s} s, is reached: the check is incomplete",) if run.is_cut_short else (),
    )


def _configuration(target: Any) -> TrainingConfiguration:
    if isinstance(target, TrainingConfiguration):
        return target
    from gauge_envs.tools.sanity.target import configuration

    return configuration(target)


class _Run:
    """Measures all phenomena in a configuration, and explains what is flagged.

    Args:
        measurements: Measurements on the backend.
        configuration: The checked configuration.
    """

    def __init__(self, measurements: Measurements, configuration: TrainingConfiguration) -> None:
        self._measurements = measurements
        self._configuration = configuration
        self._subjects: list[Subject] = []
        self.language = language(configuration.language)
        self.is_cut_short = False

    def rows(
        self, chosen: Sequence[Phenomenon], *, notify: Callable[[PhenomenonResult], None] | None
    ) -> list[PhenomenonResult]:
        """Return a row for each phenomenon."""
        self._subjects = [subject_of(self._measurements, self._configuration, one) for one in chosen]
        outcomes = [self._in_time(partial(one.measured, self._measurements)) or {} for one in self._subjects]
        defaults = [
            self._in_time(partial(self._measurements.measure, one.phenomenon, {})) if one.sets else None
            for one in self._subjects
        ]
        rows = []
        for subject, outcome, default in zip(self._subjects, outcomes, defaults, strict=True):
            row = self._row(subject, outcome, default) if outcome else self._unmeasured(subject, default)
            rows.append(row)
            if notify is not None:
                notify(row)
        return rows

    def cure(self, rows: Sequence[PhenomenonResult]) -> Cure | None:
        """Return the change that mends most flags; None when there is no flag or no cure."""
        flags = {row.phenomenon for row in rows if row.is_flag}
        # Where an engine died, changes would let it die again.
        explained = {row.phenomenon for row in rows if row.cause is not None}
        flagged = [one for one in self._subjects if one.phenomenon.id in flags & explained]
        others = [one for one in self._subjects if one.sets and one.phenomenon.id not in flags and not one.advisory]
        named = {name for row in rows if row.cause is not None for name in row.cause.settings}
        search = (self._measurements, self._configuration, flagged, others, self.language)
        cure = self._in_time(lambda: find_cure(*search, named=named))
        for name, (text, changes) in self._stated_fixes().items():
            if name in flags:
                cure = _with_fix(cure, name, text, changes, flag_count=len(flags))
        return cure

    def stated_rows(self, chosen: Sequence[str]) -> list[PhenomenonResult]:
        """Return the rows on what the target states, which need no rollout."""
        rows = [gravity_row(self._configuration, self.language)] if GRAVITY_ID in chosen else []
        wanted = len(chosen) == 1
        capacity = capacity_row(self._configuration, self.language, is_wanted=wanted) if CAPACITY_ID in chosen else None
        return rows if capacity is None else [*rows, capacity]

    def _stated_fixes(self) -> dict[str, tuple[str, dict[str, Any]]]:
        """Return the change that mends each row on what the target states, as text to paste and as settings."""
        upright = upright_gravity(self._configuration)
        fixes: dict[str, tuple[str, dict[str, Any]]] = {
            GRAVITY_ID: (self.language.gravity_text(upright), {GRAVITY_ID: upright})
        }
        if self._configuration.capacity is not None:
            limits = capacity_changes(self._configuration.capacity)
            fixes[CAPACITY_ID] = (self.language.paste_text(limits), limits)
        return fixes

    def _in_time(self, work: Callable[[], Any]) -> Any:
        """Return the result of work; None when the time limit is reached."""
        try:
            return work()
        except TimeLimitError:
            self.is_cut_short = True
            return None

    def _unmeasured(self, subject: Subject, default: Measured | None) -> PhenomenonResult:
        phenomenon = subject.phenomenon
        return PhenomenonResult(
            phenomenon=phenomenon.id,
            title=phenomenon.title,
            experiment=phenomenon.scenario.id,
            unit=phenomenon.unit,
            reality=phenomenon.reality,
            default=None if default is None else default.value,
            configured=None,
            verdict=Verdict.DECLINED,
            default_verdict=Verdict.DECLINED if default is None else default.verdict,
            remark=subject.inapplicable or "not measured within the time limit",
            advisory=subject.advisory,
            applies=not subject.inapplicable,
        )

    def _row(self, subject: Subject, outcomes: dict[str, Measured], default: Measured | None) -> PhenomenonResult:
        phenomenon = subject.phenomenon
        geoms, configured = worst_of(outcomes)
        # A rollout that diverges is wrong whatever the target states.
        advisory = subject.advisory if configured.rollout is not None else ""
        cause = None
        if not advisory and default is not None:
            cause = self._in_time(lambda: self._cause(subject, geoms, configured, default))
        several = [
            GroupOutcome(geoms=g, value=m.value, verdict=m.verdict, remark=m.remark) for g, m in outcomes.items()
        ]
        is_judged_by_group = len(self._configuration.contact_sets) > 1 and len(several) > 1
        return PhenomenonResult(
            phenomenon=phenomenon.id,
            title=phenomenon.title,
            experiment=phenomenon.scenario.id,
            unit=phenomenon.unit,
            reality=phenomenon.reality,
            default=None if default is None else default.value,
            configured=configured.value,
            verdict=configured.verdict,
            default_verdict=Verdict.DECLINED if default is None else default.verdict,
            cause=cause,
            remark=configured.remark,
            curve=curve_of(phenomenon, configured, default),
            advisory=advisory,
            geoms=geoms if is_judged_by_group else "",
            groups=tuple(several) if is_judged_by_group else (),
        )

    def _cause(self, subject: Subject, geoms: str, configured: Measured, default: Measured) -> Cause | None:
        search = (self._measurements, subject.phenomenon, subject.sets[geoms], configured, default)
        return find_cause(*search, language=self.language)


def _with_fix(cure: Cure | None, name: str, text: str, changes: dict[str, Any], *, flag_count: int) -> Cure:
    """Return a cure with a further change that mends one row on what the target states."""
    if cure is None:
        line = f"{text}: {f'1 of {flag_count} flags goes' if flag_count > 1 else 'the one flag goes'}"
        return Cure(changes=changes, line=line, flag_count=flag_count, mended_count=1)
    return Cure(
        changes={**cure.changes, **changes},
        line=f"{cure.line}; and {text} for the row {name}",
        flag_count=flag_count,
        mended_count=cure.mended_count + 1,
        new_flags=cure.new_flags,
    )


def curve_of(phenomenon: Phenomenon, configured: Measured, default: Measured | None) -> Curve | None:
    """Return the curves of a phenomenon that has one; reality is at the times of the default, if there is a default."""
    trace = phenomenon.trace
    if trace is None:
        return None
    times, values = _thinned(phenomenon, configured)
    default_times, default_values = (times, ()) if default is None else _thinned(phenomenon, default)
    centre, tolerance = _real_curve(phenomenon, np.asarray(default_times))
    return Curve(
        label=trace.label,
        times_s=default_times,
        default=default_values,
        configured_times_s=times,
        configured=values,
        reality=tuple(centre.tolist()),
        tolerance=tuple(tolerance.tolist()),
    )


def _real_curve(phenomenon: Phenomenon, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return centre and half-width of the interval of reality at times; empty when only one value is known."""
    trace, reality = phenomenon.trace, phenomenon.reality
    if trace is not None and trace.reality is not None:
        return trace.reality(times_s)
    if trace is not None and trace.is_level:
        return np.full_like(times_s, reality.value), np.full_like(times_s, reality.tolerance)
    return np.zeros(0), np.zeros(0)


def _thinned(phenomenon: Phenomenon, measured: Measured) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return times and values of a trace, at `CURVE_SAMPLES` samples at most; empty without a rollout or a trace."""
    if measured.rollout is None or phenomenon.trace is None:
        return (), ()
    shown = measured.rollout.between(0.0, phenomenon.trace.until_s)
    times, values = measured.rollout.times_s[shown], phenomenon.trace.values(measured.rollout)[shown]
    stride = max(1, -(-len(times) // CURVE_SAMPLES))
    return tuple(times[::stride].tolist()), tuple(values[::stride].tolist())
