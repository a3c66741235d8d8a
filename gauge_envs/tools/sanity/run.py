"""Run a sanity check: measure phenomena with the configuration and the backend's default, and find the cure."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from gauge_envs.errors import ParameterError, TargetError
from gauge_envs.files import json_document, os_errors, versions
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
    INSIDE_WITHIN,
    Cure,
    PartOutcome,
    PhenomenonResult,
    Report,
    Settings,
    TrainingConfiguration,
    Verdict,
    deviation_of,
)
from gauge_envs.tools.sanity.phenomena import (
    GRASP,
    STATED_IDS,
    phenomenon,
    selection,
)
from gauge_envs.tools.sanity.stacks import configuration as configuration_of, dialect
from gauge_envs.tools.sanity.target_checks import target_rows

POINT_NOTE = "{}: a round fingertip has one contact, which with condim 3 holds no torque: see gauge recipe --torsion"
"""Note on a hand between whose fingertips a body turns freely."""


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

    All phenomena are measured in the configuration first. Then come those of this package's preset where a row is not
    inside, and the change that corrects most flags, which is applied and measured.

    Args:
        target: A `TrainingConfiguration`, or a target of `gauge_envs.tools.sanity.configuration`.
        only: Ids of phenomena or patterns such as `creep-*`; when empty, all of rigid bodies, and of grasps if the
            target is a model with a hand.
        include_deformables: Whether to measure phenomena of grasps and of deformable bodies too.
        time_limit_s: Time after which no simulation starts any more [s]; rows that are not measured by then are
            declined. It bounds each simulation of an engine of another package too. None for no limit.
        explain: Whether to find the change that corrects most.
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
        Measurements(configuration.backend, time_limit_s=time_limit_s)
    ) as measurements:
        run = _Run(measurements, configuration)
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
                f"{configuration.name}: {measurements.engine} refuses these settings: {simulated[0].remark}"
            )
        cure: Cure | None = None
        tried: tuple[str, ...] = ()
        trade = ""
        if explain:
            cure, tried, trade = run.cure(rows)
    notes = []
    if run.is_cut_short:
        notes.append(
            f"the time limit, {time_limit_s} s, is reached: the check is incomplete"
        )
    if "grasp-torsion" in chosen:
        notes += [
            POINT_NOTE.format(one.geoms)
            for one in configuration.contact_groups
            if one.is_point and one.constants["condim"] == 3
        ]
    return Report(
        configuration=configuration,
        rows=tuple(rows),
        versions={**measurements.versions, **versions()},
        wall_s=time.perf_counter() - started,
        cure=cure,
        tried=tried,
        trade=trade,
        notes=tuple(notes),
        asked=tuple(name for name in chosen if name in only),
    )


class _Run:
    """Measures all phenomena in a configuration, and finds what corrects the flags."""

    def __init__(
        self,
        measurements: Measurements,
        configuration: TrainingConfiguration,
    ) -> None:
        self._measurements = measurements
        self._configuration = configuration
        self.is_cut_short = False

    def rows(self, chosen: Sequence[str]) -> Iterator[PhenomenonResult]:
        """Yield a row for each phenomenon, those on what the target states at the end."""
        subjects = [
            subject_of(self._measurements, self._configuration, phenomenon(name))
            for name in chosen
            if name not in STATED_IDS
        ]
        outcomes = [self._in_time(one.measured) or {} for one in subjects]
        defaults: list[Measured | None] = []
        for subject, outcome in zip(subjects, outcomes, strict=True):
            measure = partial(self._measurements.measure, subject.phenomenon, {})
            is_off = any(one.verdict is not Verdict.INSIDE for one in outcome.values())
            defaults.append(self._in_time(measure) if is_off else None)
        yield from map(self._row, subjects, outcomes, defaults)
        yield from target_rows(self._configuration, chosen)

    def cure(
        self, rows: Sequence[PhenomenonResult]
    ) -> tuple[Cure | None, tuple[str, ...], str]:
        """Return the change that corrects most flags, what else was tried, and the best trade; see `find_cure`."""
        words = dialect(self._configuration.language)
        search = (self._configuration, words, self._measurements, rows)
        found = self._in_time(partial(find_cure, *search))
        return (None, (), "") if found is None else found

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
            applies = not subject.inapplicable
            return result_of(
                phenomenon, unmeasured, default, advisory=advisory, applies=applies
            )
        geoms, configured = worst_of(outcomes)
        if configured.rollout is None:
            # A rollout that diverges is wrong whatever the target states.
            advisory = ""
        # What an engine cannot simulate at all is no part of a check.
        is_unknown = default is not None and {configured.verdict, default.verdict} == {
            Verdict.DECLINED
        }
        row = result_of(
            phenomenon,
            configured,
            default,
            applies=not is_unknown,
            advisory=advisory,
        )
        if len(outcomes) == 1:
            return row
        parts = tuple(
            PartOutcome(
                name=name,
                value=one.value,
                verdict=one.verdict,
                deviation=one.deviation,
                remark=one.remark,
            )
            for name, one in outcomes.items()
        )
        return replace(row, geoms=geoms, parts=parts)


# --- comparison with an earlier run ----------------------------------------------------------------------------------

GROWTH = 1.0
"""Growth of a deviation, in half-widths of the interval of reality, from which on a flagged row is a regression."""


Baseline = Mapping[str, Mapping[str, float]]
"""Deviation of each part of each row of an earlier run, by the row's id and the part's name; `""` is the row itself."""


def read_baseline(path: Path) -> dict[str, dict[str, float]]:
    """Return the deviations of an earlier run, as `regressions` takes them.

    Args:
        path: File with the output of `gauge sanity TARGET --json`.
    """
    with os_errors(lambda cause: TargetError(f"{path}: cannot be read: {cause}")):
        content = path.read_bytes()
    try:
        lines = [json_document(line) for line in content.splitlines() if line.strip()]
        found = {
            line["phenomenon"]: {
                "": _deviation(line, line["configured"], line["reality"])
            }
            | {part["name"]: _part_deviation(part) for part in line["parts"]}
            for line in lines
            if "phenomenon" in line
        }
    except (TypeError, ValueError, KeyError, ArithmeticError) as error:
        what = "no list of parts" if error.args == ("parts",) else str(error)
        raise TargetError(
            f"{path}: is not the output of this version's gauge sanity --json ({what}): write it again"
        ) from None
    if not found:
        raise TargetError(
            f"{path}: has no row; write it with gauge sanity TARGET --json > {path}"
        )
    return found


def _deviation(line: Settings, value: float | None, reality: Settings) -> float:
    verdict = Verdict(line["verdict"])
    if not verdict.is_off:
        return INSIDE_WITHIN
    return deviation_of(verdict, value, reality["value"], reality["tolerance"])


def _part_deviation(part: Settings) -> float:
    """Return the deviation of a part; JSON has none for an infinite one."""
    if not Verdict(part["verdict"]).is_off:
        return INSIDE_WITHIN
    return math.inf if part["deviation"] is None else float(part["deviation"])


@dataclass(frozen=True, kw_only=True)
class Regression:
    """A flagged row, or a part of it, that is farther from reality than in the baseline.

    Attributes:
        row: The row.
        part: The part; without a name, the row itself.
        before: Its deviation in the baseline; None when the baseline has no such row or part.
    """

    row: PhenomenonResult
    part: PartOutcome
    before: float | None


def regressions(
    report: Report, baseline: Baseline, *, least: Verdict
) -> list[Regression]:
    """Return flagged rows and parts, at least as bad as `least`, that are farther from reality than in the baseline.

    Farther is by more than a half-width of the interval, or out of the interval. A row with parts is compared part by
    part. What the baseline does not have, or declined, is compared with `inside`.
    """
    counted = (
        (Verdict.WRONG,) if least is Verdict.WRONG else (Verdict.WRONG, Verdict.VISIBLE)
    )
    worse = []
    for row in report.rows:
        known = baseline.get(row.phenomenon, {})
        itself = PartOutcome(
            name="",
            value=row.configured,
            verdict=row.verdict,
            deviation=row.deviation,
        )
        for part in row.parts or (itself,):
            before = known.get(part.name, INSIDE_WITHIN)
            grown = part.deviation > before + GROWTH or before <= INSIDE_WITHIN
            if row.is_flag and part.verdict in counted and grown:
                was = known.get(part.name)
                worse.append(Regression(row=row, part=part, before=was))
    return worse
