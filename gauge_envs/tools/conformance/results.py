"""Summaries of results: counts, levels, expected failures, a badge; and columns of engines in a file."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

from gauge_envs.backends import backend, backend_names
from gauge_envs.errors import (
    GaugeError,
    ParameterError,
    ResultFileError,
    UnknownNameError,
)
from gauge_envs.files import json_ready, os_errors, write_whole
from gauge_envs.registry import package_versions
from gauge_envs.runs.workers import Worker, call_engine
from gauge_envs.text import json_document, toml_document
from gauge_envs.tools.conformance.model import LEVELS, CheckResult, Status, checks
from gauge_envs.tools.conformance.run import run_checks


def counts_text(results: Sequence[CheckResult]) -> str:
    """Return the counts of all outcomes, as `63 pass, 14 fail, 0 error, 124 unsupported of 201`."""
    statuses = [result.status for result in results]
    counts = ", ".join(f"{statuses.count(status)} {status}" for status in Status)
    return f"{counts} of {len(results)}"


def levels(results: Sequence[CheckResult]) -> dict[str, str]:
    """Return the verdict of one engine on each level whose checks all ran.

    A level passes if no check fails and every check passes that is not optional. A level means little for an engine
    that fails an earlier level.
    """
    verdicts = {}
    for level in LEVELS:
        known = [check for check in checks() if check.level == level]
        ran = [result for result in results if result.of.level == level]
        if len(ran) < len(known):
            continue
        bad = sum(result.is_bad for result in ran)
        unsupported = [result for result in ran if result.status is Status.UNSUPPORTED]
        needed = [result.check for result in unsupported if not result.of.is_optional]
        verdicts[level] = "pass"
        if bad:
            verdicts[level] = f"{bad} of {len(ran) - len(unsupported)} fail"
        elif len(unsupported) == len(ran):
            verdicts[level] = "unsupported"
        elif needed:
            rest = f" and {len(needed) - 1} more" if needed[1:] else ""
            verdicts[level] = f"incomplete, {needed[0]}{rest} unsupported"
    return verdicts


# --- expected failures -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class KnownFailure:
    """A failure that the repository of an engine expects.

    Attributes:
        reason: Reason in words.
        measured: The measured value; None if the check raises an error.
    """

    reason: str
    measured: float | None = None


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Results that the repository of an engine expects of its checks.

    Attributes:
        failures: Failures by the id of the check.
        unsupported: Reasons by patterns of the ids of checks that may be unsupported.
    """

    failures: Mapping[str, KnownFailure] = field(default_factory=dict)
    unsupported: Mapping[str, str] = field(default_factory=dict)

    def surprise(self, result: CheckResult) -> str:
        """Return how a result differs from the expected result, in words; empty if it does not."""
        known = self.failures.get(result.check)
        is_unsupported = result.status is Status.UNSUPPORTED
        if known is not None and not result.is_bad:
            outcome = "is unsupported" if is_unsupported else "passes"
            return (
                f"{outcome}, but is listed as failing ({known.reason}): delete its line"
            )
        if is_unsupported:
            if any(fnmatchcase(result.check, pattern) for pattern in self.unsupported):
                return ""
            reasons = "; ".join(result.missing)
            return f'is unsupported ({reasons}); if that is right, add "{result.check}" to [unsupported]'
        if not result.is_bad:
            return ""
        if known is None:
            return f"{_failed_text(result)}; if that is known, add {_line(result)}"
        if self._is_same(known, result):
            return ""
        listed = "an error" if known.measured is None else f"{known.measured:.4g}"
        return f"{_failed_text(result)}; the list has {listed}"

    @staticmethod
    def _is_same(known: KnownFailure, result: CheckResult) -> bool:
        """Return whether a failure has the listed value, within the tolerance of its check."""
        listed = known.measured
        if listed is None or result.measured is None:
            return listed is result.measured
        if math.isnan(listed) or math.isnan(result.measured):
            return math.isnan(listed) and math.isnan(result.measured)
        return abs(result.measured - listed) <= (result.width or 0.0)


def read_expected(file: Path) -> Expected:
    """Return the expected results of a TOML file.

        rebound-flat = { measured = 0.513, reason = "each point rebounds" }
        [unsupported]
        "cloth-*" = "rigid bodies only"

    Raises:
        ParameterError: The file cannot be read, or an entry has no reason or no value.
        UnknownNameError: It names a check that does not exist.
    """
    try:
        document = toml_document(file.read_bytes())
    except (OSError, ValueError) as error:
        raise ParameterError(f"{file}: cannot be read as TOML: {error}") from None
    # `declined` is the name of the table before 1.0; it is read until 1.2.
    unsupported = document.pop("declined", {}) | document.pop("unsupported", {})
    ids = [check.id for check in checks()]
    failures = {}
    for name, entry in document.items():
        if name not in ids:
            raise UnknownNameError("check", name, ids)
        known = entry if isinstance(entry, dict) else {}
        measured, reason = known.get("measured"), known.get("reason", "")
        is_number = measured is None or isinstance(measured, int | float)
        if (
            not str(reason).strip()
            or not is_number
            or {*known} - {"measured", "reason"}
        ):
            raise ParameterError(
                f"{file}: {name} needs a value and a reason, as {name} = "
                '{ measured = 0.513, reason = "no model of it" }; a run without its line prints the value'
            )
        failures[name] = KnownFailure(reason=reason, measured=measured)
    for pattern, reason in unsupported.items():
        if not any(fnmatchcase(name, pattern) for name in ids):
            raise UnknownNameError("check", pattern, ids)
        if not str(reason).strip():
            raise ParameterError(
                f"{file}: unsupported {pattern!r} needs a reason in words"
            )
    return Expected(failures=failures, unsupported=unsupported)


def _failed_text(result: CheckResult) -> str:
    if result.measured is None:
        return f"raises an error: {result.diagnosis}"
    return f"fails, {result.measured:.4g} instead of {result.expected:.4g}: {result.diagnosis}"


def _line(result: CheckResult) -> str:
    value = "" if result.measured is None else f"measured = {result.measured:.6g}, "
    return f'{result.check} = {{ {value}reason = "..." }}'


def badge(results: Sequence[CheckResult], expected: Expected) -> dict[str, str | int]:
    """Return a badge for shields.io: red if a result is unexpected, yellow if a level does not pass, else green."""
    verdicts = set(levels(results).values())
    color = "green" if verdicts <= {"pass", "unsupported"} else "yellow"
    is_measured = any(result.status is not Status.UNSUPPORTED for result in results)
    if not is_measured or any(expected.surprise(result) for result in results):
        color = "red"
    return {
        "schemaVersion": 1,
        "label": f"gauge-envs {package_versions()['gauge-envs']}",
        "message": counts_text(results),
        "color": color,
    }


# --- columns ---------------------------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class EngineColumn:
    """Results of one engine with one configuration.

    Attributes:
        backend: Name of the engine.
        name: Name of the configuration; `default` for the engine's own choice.
        settings: Settings that select it.
        results: Results by the id of the check; of a file, only results of unchanged checks.
        outdated: Ids of checks of a file that have changed or no longer exist.
        reason: Why no check ran; empty if a check did.
        versions: Versions of the engine's packages.
        gauge_envs: Version of gauge-envs that ran it; empty before it ran.
        made: Day of the run, as `2026-01-31`; empty before it ran.
    """

    backend: str
    name: str
    settings: Mapping[str, Any]
    results: dict[str, CheckResult] = field(default_factory=dict)
    outdated: tuple[str, ...] = ()
    reason: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    gauge_envs: str = ""
    made: str = ""

    @property
    def title(self) -> str:
        """Engine and configuration, as `physx PGS`."""
        return self.backend if self.name == "default" else f"{self.backend} {self.name}"

    @property
    def cpu_s(self) -> float:
        """CPU time of all checks whose time is known [s]."""
        return sum(result.cpu_s or 0.0 for result in self.results.values())


def engine_columns(
    names: Sequence[str],
    settings: Mapping[str, Any] | None = None,
    *,
    isolate: bool = True,
) -> list[EngineColumn]:
    """Return the columns of engines, without running a check.

    Args:
        names: Engines or patterns, as `mujoco` for its default; with a colon, configurations that the engine declares,
            as `mujoco:PGS` or `*:*`.
        settings: Settings for every column, in addition to those of its configuration.
        isolate: Whether the engines are imported in another process.

    Raises:
        UnknownNameError: There is no such engine or configuration.
    """
    columns: dict[tuple[str, str], EngineColumn] = {}
    for name in names:
        pattern, has_configuration, wanted = name.partition(":")
        engines = [engine for engine in backend_names() if fnmatchcase(engine, pattern)]
        if not engines:
            raise UnknownNameError("backend", pattern, backend_names())
        declared: dict[str, dict[str, dict[str, Any]]] = {}
        for engine in engines:
            declared[engine] = {"default": {}}
            if has_configuration:
                declared[engine] |= call_engine(
                    engine, _configurations, engine, isolate=isolate
                )
        chosen = [
            (engine, key)
            for engine, known in declared.items()
            for key in known
            if not wanted or fnmatchcase(key, wanted)
        ]
        if not chosen:
            known = {key for of_engine in declared.values() for key in of_engine}
            raise UnknownNameError("configuration", wanted, known)
        for engine, key in chosen:
            changed = {**(settings or {}), **declared[engine][key]}
            column = EngineColumn(backend=engine, name=key, settings=changed)
            columns.setdefault((engine, key), column)
    return list(columns.values())


def _configurations(name: str) -> dict[str, dict[str, Any]]:
    """Return the configurations that an engine declares; none for an engine that is not installed."""
    try:
        engine = backend(name)
    except GaugeError:
        return {}
    return {str(key): dict(values) for key, values in engine.configurations.items()}


def run_column(
    column: EngineColumn, only: Sequence[str], worker: Worker | None
) -> Iterator[CheckResult]:
    """Run the checks of a column, keep each result in it, and yield it.

    An engine that cannot be imported gives the column a reason and no result.

    Args:
        column: The column.
        only: Ids or patterns of checks.
        worker: Another process for the checks, so that an engine that crashes loses one check; None for this process.
    """
    column.gauge_envs = package_versions()["gauge-envs"]
    column.made = datetime.now(UTC).date().isoformat()
    try:
        for result in run_checks(
            column.backend, settings=column.settings or None, only=only, worker=worker
        ):
            column.versions = result.versions
            column.results[result.check] = result
            yield result
    except GaugeError as error:
        column.reason = str(error)


KIND = "gauge-envs conformance matrix"
STORED = ("status", "expected", "measured", "width", "diagnosis", "missing", "cpu_s")
"""Fields of a result in a file of columns, beside the fingerprint of its check."""


def write_columns(columns: Sequence[EngineColumn], path: Path) -> Path:
    """Write columns as JSON and return the path; `read_columns` reads them back."""
    rows = []
    for column in columns:
        values = {key: value for key, value in vars(column).items() if key != "results"}
        values["findings"] = {
            name: {"fingerprint": result.of.fingerprint}
            | {key: getattr(result, key) for key in STORED}
            for name, result in column.results.items()
        }
        rows.append(json.dumps(json_ready(values), ensure_ascii=False))
    text = ",\n".join(rows)
    with os_errors(lambda why: ResultFileError(f"{path}: cannot be written: {why}")):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, f'{{"kind": "{KIND}", "columns": [\n{text}\n]}}\n'.encode())
    return path


def read_columns(path: Path) -> list[EngineColumn]:
    """Return the columns of a file.

    Raises:
        ResultFileError: The file cannot be read or has no columns.
    """
    hint = "write it with gauge backend check NAME --out FILE.json"
    try:
        document = json_document(path.read_bytes())
    except (OSError, ValueError) as error:
        raise ResultFileError(f"{path}: cannot be read ({error}); {hint}") from None
    if not isinstance(document, dict) or document.get("kind") != KIND:
        raise ResultFileError(f"{path}: has no columns of conformance checks; {hint}")
    try:
        return [_read_column(row) for row in document["columns"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ResultFileError(f"{path}: is damaged ({error!r}); {hint}") from None


def _read_column(row: Mapping[str, Any]) -> EngineColumn:
    known = {entry.id: entry for entry in checks()}
    column = EngineColumn(**{key: row[key] for key in _FIELDS})
    outdated = []
    for name, stored in row["findings"].items():
        check = known.get(name)
        if check is None or stored["fingerprint"] != check.fingerprint:
            outdated.append(name)
            continue
        outcome = {key: stored[key] for key in STORED}
        outcome["status"] = status = Status(stored["status"])
        outcome["missing"] = tuple(stored["missing"])
        if status is Status.FAIL and stored["measured"] is None:
            outcome["measured"] = math.nan  # JSON has no number that is not finite.
        column.results[name] = CheckResult(
            of=check, backend=column.backend, versions=column.versions, **outcome
        )
    column.outdated = tuple(outdated)
    return column


_FIELDS = (
    "backend",
    "name",
    "settings",
    "reason",
    "versions",
    "gauge_envs",
    "made",
)


def with_columns(
    columns: Sequence[EngineColumn], files: Sequence[Path]
) -> list[EngineColumn]:
    """Return columns and the columns of files, grouped by engine in the order of first appearance.

    Raises:
        ParameterError: Two have the same engine and configuration.
    """
    by_title = {column.title: column for column in columns}
    for file in files:
        for column in read_columns(file):
            if column.title in by_title:
                raise ParameterError(
                    f"{file}: column {column.title!r} is there twice: leave out one of them"
                )
            by_title[column.title] = column
    engines = list(dict.fromkeys(column.backend for column in by_title.values()))
    return sorted(by_title.values(), key=lambda column: engines.index(column.backend))


# --- an earlier version of an engine ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Change:
    """Result of a check that differs from the result of an earlier version of the engine.

    Attributes:
        column: Engine and configuration.
        kind: `worse` if a pass ended, `fixed` if a failure ended, else `moved`.
        before: The earlier result.
        after: The current result.
    """

    column: str
    kind: Literal["worse", "moved", "fixed"]
    before: CheckResult
    after: CheckResult


def changes(
    columns: Sequence[EngineColumn], before: Sequence[EngineColumn]
) -> list[Change]:
    """Return the checks whose outcome changed, or whose value moved by more than the tolerance of the check.

    New and changed checks are left out.

    Raises:
        ParameterError: An engine or configuration has no earlier column.
    """
    known = {column.title: column for column in before}
    changed = []
    for column in columns:
        if column.title not in known:
            raise ParameterError(
                f"the baseline has no column {column.title!r}; it has {', '.join(known) or 'none'}"
            )
        for name, current in column.results.items():
            old = known[column.title].results.get(name)
            if old is not None and (kind := _change(old, current)):
                change = Change(
                    column=column.title, kind=kind, before=old, after=current
                )
                changed.append(change)
    return changed


def _change(
    old: CheckResult, current: CheckResult
) -> Literal["", "worse", "moved", "fixed"]:
    if old.status is not current.status:
        was, is_now = (result.status is Status.PASS for result in (old, current))
        return "worse" if was else "fixed" if is_now else "moved"
    if old.measured is None or current.measured is None:
        return ""
    if math.isnan(old.measured) and math.isnan(current.measured):
        return ""
    is_near = abs(current.measured - old.measured) <= (current.width or 0.0)
    return "" if is_near or current.measured == old.measured else "moved"
