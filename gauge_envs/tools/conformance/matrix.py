"""One canonical check per phenomenon on many engines, each with its solvers and presets: a matrix."""

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from gauge_envs.backends import backend, backend_names
from gauge_envs.backends.registry import engine_call
from gauge_envs.errors import (
    GaugeError,
    ParameterError,
    ResultFileError,
    UnknownNameError,
)
from gauge_envs.files import (
    json_document,
    json_ready,
    os_errors,
    versions,
    write_whole,
)
from gauge_envs.runs.isolation import Worker
from gauge_envs.tools.conformance.lab import RefusedSettingsError
from gauge_envs.tools.conformance.model import (
    Check,
    CheckResult,
    Outcome,
    Status,
    checks,
    texts_of_checks,
)
from gauge_envs.tools.conformance.run import run_checks

CANONICAL: tuple[str, ...] = tuple(texts_of_checks()["canonical"])
"""One check per phenomenon, or one per quantity where a phenomenon has several that fail apart."""


@dataclass(kw_only=True)
class MatrixColumn:
    """One engine with one configuration.

    Attributes:
        backend: Name of the engine.
        name: Name of the configuration; `default` for the engine's own choice.
        settings: Settings that select it.
        findings: Results of the checks, by id.
        refused: Why the engine refuses the settings in the scene of a check, by id.
        reason: Why no check ran; empty if one did.
        fingerprints: Fingerprint that each check had when it ran, by id.
        gauge_envs: Version of gauge-envs that ran it; empty before it ran.
        made: Day of the run, as `2026-01-31`; empty before it ran.
    """

    backend: str
    name: str
    settings: Mapping[str, Any]
    findings: dict[str, CheckResult] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    reason: str = ""
    fingerprints: dict[str, str] = field(default_factory=dict)
    gauge_envs: str = ""
    made: str = ""

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of the engine's packages; empty if no check ran."""
        return next((finding.versions for finding in self.findings.values()), {})

    @property
    def cpu_s(self) -> float | None:
        """CPU time of all checks [s]; None if that of a check that ran is not known."""
        spent = [finding.cpu_s for finding in self.findings.values()]
        return (
            None
            if None in spent
            else sum(value for value in spent if value is not None)
        )

    @property
    def is_of_this_version(self) -> bool:
        """Whether the installed gauge-envs ran it."""
        return self.gauge_envs in ("", versions()["gauge-envs"])

    @property
    def outdated(self) -> dict[str, str]:
        """Why a result does not answer the present check, by id; only a column from a file can have such results."""
        known = {check.id: check.fingerprint for check in checks()}
        reasons = {}
        for name, fingerprint in self.fingerprints.items():
            if name not in known:
                reasons[name] = (
                    f"gauge-envs {versions()['gauge-envs']} has no check {name!r}"
                )
            elif fingerprint != known[name]:
                reasons[name] = (
                    "the check had another scene, law or tolerance when this column ran"
                )
        return reasons

    def current(self) -> dict[str, CheckResult]:
        """Return the results that answer the present checks, by id."""
        outdated = self.outdated
        return {
            name: finding
            for name, finding in self.findings.items()
            if name not in outdated
        }

    @property
    def title(self) -> str:
        """Engine and configuration, as `physx PGS`."""
        return self.backend if self.name == "default" else f"{self.backend} {self.name}"

    def command(self, check: str) -> str:
        """Return the command that repeats one check."""
        words = ["gauge", "backend", "check", self.backend, "--only", check]
        for name, value in self.settings.items():
            words += [
                "--set",
                f"{name}={value!r}" if isinstance(value, float) else f"{name}={value}",
            ]
        return shlex.join(words)


def matrix_columns(
    names: Sequence[str],
    settings: Mapping[str, Any] | None = None,
    *,
    worker: Worker | None = None,
) -> list[MatrixColumn]:
    """Return the columns of a matrix, without running a check.

    Args:
        names: Engines or patterns, as `mujoco` for its default; with a colon, configurations that the engine declares,
            as `mujoco:PGS` or `*:*`.
        settings: Settings for every column, beside those of its configuration.
        worker: Another process that imports the engines; None for this one.

    Returns:
        The columns. An engine that cannot be imported has one column, with the reason.
    """
    known = backend_names()
    columns: dict[tuple[str, str], MatrixColumn] = {}
    for name in names:
        pattern, has_configuration, wanted = name.partition(":")
        engines = [engine for engine in known if fnmatchcase(engine, pattern)]
        if not engines:
            raise UnknownNameError("backend", pattern, known)
        found = [
            column
            for engine in engines
            for column in _columns(engine, bool(has_configuration), worker)
        ]
        chosen = [
            column for column in found if not wanted or fnmatchcase(column.name, wanted)
        ]
        if not chosen:
            raise UnknownNameError(
                "configuration", wanted, {column.name for column in found}
            )
        for column in chosen:
            column.settings = {**(settings or {}), **column.settings}
            columns.setdefault((column.backend, column.name), column)
    return list(columns.values())


def _columns(
    engine: str, has_configurations: bool, worker: Worker | None
) -> list[MatrixColumn]:
    """Return the default of an engine, and its configurations if they are asked for."""
    configurations: dict[str, dict[str, Any]] = {"default": {}}
    reason = ""
    if has_configurations:
        try:
            configurations |= (
                _declared(engine) if worker is None else worker.call(_declared, engine)
            )
        except GaugeError as error:
            reason = str(error)
    return [
        MatrixColumn(backend=engine, name=name, settings=settings, reason=reason)
        for name, settings in configurations.items()
    ]


def _declared(name: str) -> dict[str, dict[str, Any]]:
    """Return the configurations that an engine declares."""
    engine = backend(name)
    with engine_call(name, "configurations"):
        return {str(key): dict(values) for key, values in engine.configurations.items()}


def run_column(
    column: MatrixColumn, only: Sequence[str], worker: Worker | None
) -> Iterator[CheckResult]:
    """Run the checks of a column, keep each result in it, and yield it.

    An engine that cannot be imported, or that refuses the settings, gives the column a reason and no result.

    Args:
        column: The column.
        only: Ids or patterns of checks.
        worker: Another process for the checks, so that an engine that crashes costs one of them; None for this one.
    """
    column.gauge_envs, column.made = (
        versions()["gauge-envs"],
        datetime.now(UTC).date().isoformat(),
    )
    for one in () if column.reason else checks(only):
        try:
            # One by one, as a solver that refuses the scene of one check may take that of the next.
            (finding,) = run_checks(
                column.backend,
                settings=column.settings or None,
                only=[one.id],
                worker=worker,
            )
        except RefusedSettingsError as error:
            column.refused[one.id] = str(error)
            continue
        except GaugeError as error:
            column.reason = str(error)
            return
        column.findings[finding.check] = finding
        column.fingerprints[finding.check] = one.fingerprint
        yield finding
    if column.refused and not column.findings:
        column.reason = (
            f"the settings are refused: {next(iter(column.refused.values()))}"
        )


# --- columns in a file -----------------------------------------------------------------------------------------------

KIND = "gauge-envs conformance matrix"


@dataclass(frozen=True, kw_only=True)
class _Finding(Outcome):
    """What one check gave; its texts are those of the check, whose fingerprint it has."""

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    fingerprint: str


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Column(_Strict):
    backend: str
    name: str
    settings: dict[str, Any]
    gauge_envs: str
    made: str
    versions: dict[str, str]
    reason: str = ""
    refused: dict[str, str]
    findings: dict[str, _Finding]


class _Document(_Strict):
    kind: str
    columns: tuple[_Column, ...]


def write_columns(columns: Sequence[MatrixColumn], path: Path) -> Path:
    """Write columns as JSON and return the path; `read_columns` reads them back."""
    rows = [_record(column) for column in columns]
    text = ",\n".join(
        json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows
    )
    with os_errors(
        lambda cause: ResultFileError(f"{path}: cannot be written: {cause}")
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, f'{{"kind": "{KIND}", "columns": [\n{text}\n]}}\n'.encode())
    return path


def _record(column: MatrixColumn) -> dict[str, Any]:
    """Return one column, JSON-ready."""
    findings = {
        name: {"fingerprint": column.fingerprints[name]} | dict(_entries(finding))
        for name, finding in column.findings.items()
    }
    facts = {
        name: getattr(column, name)
        for name in _Column.model_fields
        if name != "findings"
    }
    values: dict[str, Any] = json_ready(facts) | {"findings": findings}
    return values


def _entries(outcome: Outcome) -> Iterator[tuple[str, Any]]:
    """Yield what an outcome states; numbers with nine significant digits, more than any tolerance asks for."""
    for one in fields(Outcome):
        value = json_ready(getattr(outcome, one.name))
        if value not in (None, "", []):
            yield one.name, float(f"{value:.9g}") if isinstance(value, float) else value


def read_columns(path: Path) -> list[MatrixColumn]:
    """Return the columns of a file.

    A result whose check has another definition now, or is not known, is kept; `MatrixColumn.outdated` names it.
    """
    try:
        found = _Document.model_validate(json_document(path.read_bytes()))
    except OSError as error:
        raise ResultFileError(
            f"{path}: cannot be read: {error.strerror or error}"
        ) from None
    except ValueError as error:
        reason = f"is no JSON document ({error})"
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            reason = f"{'.'.join(str(part) for part in first['loc']) or 'the document'}: {first['msg']}"
        raise ResultFileError(
            f"{path}: {reason}; write it with gauge backend check 'NAME:*' --out FILE"
        ) from None
    if found.kind != KIND:
        raise ResultFileError(f"{path}: its kind is {found.kind!r}, expected {KIND!r}")
    known = {check.id: check for check in checks()}
    return [_column(one, known) for one in found.columns]


def _column(one: _Column, known: Mapping[str, Check]) -> MatrixColumn:
    column = MatrixColumn(**one.model_dump(exclude={"versions", "findings"}))
    for name, finding in one.findings.items():
        values = {
            key: getattr(finding, key)
            for key in (entry.name for entry in fields(Outcome))
        }
        if finding.status is Status.FAIL and finding.measured is None:
            values["measured"] = math.nan  # JSON has no number that is not finite.
        check = known.get(name, Check(name))
        column.findings[name] = CheckResult(
            of=check, backend=one.backend, versions=one.versions, **values
        )
        column.fingerprints[name] = finding.fingerprint
    return column


def with_columns(
    columns: Sequence[MatrixColumn], files: Sequence[Path]
) -> list[MatrixColumn]:
    """Return columns together with those of files, grouped by engine in the order of the first appearance."""
    found = {(column.backend, column.name): column for column in columns}
    places = dict.fromkeys(found, "this run")
    for file in files:
        for column in read_columns(file):
            key = (column.backend, column.name)
            if key in found:
                raise ParameterError(
                    f"column {column.title!r} is in {places[key]} and in {file}: leave one of them out"
                )
            found[key], places[key] = column, str(file)
    engines = list(dict.fromkeys(backend for backend, _ in found))
    return sorted(found.values(), key=lambda column: engines.index(column.backend))


# --- an earlier version of an engine ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Change:
    """What a check gives now, where an earlier version of the engine gave another result.

    Attributes:
        column: Engine and configuration.
        before: The earlier result.
        now: The present result.
    """

    column: str
    before: CheckResult
    now: CheckResult

    @property
    def kind(self) -> str:
        """`worse` if it failed to keep a pass, `mended` if a failure ended, else `moved`."""
        was, is_now = (
            one.is_bad or one.status is Status.DECLINED
            for one in (self.before, self.now)
        )
        return "moved" if was == is_now else "worse" if is_now else "mended"


def changes(
    columns: Sequence[MatrixColumn], before: Sequence[MatrixColumn]
) -> list[Change]:
    """Return the checks whose outcome is another one, or whose value moved by more than the tolerance of the check.

    Checks that are new, or had another definition, are left out.

    Raises:
        ParameterError: An engine or configuration has no earlier column.
    """
    known = {one.title: one for one in before}
    found = []
    for column in columns:
        if column.title not in known:
            raise ParameterError(
                f"the baseline has no column {column.title!r}; it has {', '.join(known) or 'none'}"
            )
        earlier = known[column.title].current()
        pairs = [
            (earlier[name], now)
            for name, now in column.findings.items()
            if name in earlier
        ]
        found += [
            Change(column=column.title, before=old, now=now)
            for old, now in pairs
            if _differs(old, now)
        ]
    return found


def _differs(old: CheckResult, now: CheckResult) -> bool:
    if old.status is not now.status or old.measured is None or now.measured is None:
        return old.status is not now.status
    is_same = old.measured == now.measured or (
        math.isnan(old.measured) and math.isnan(now.measured)
    )
    return not is_same and not abs(now.measured - old.measured) <= (now.width or 0.0)
