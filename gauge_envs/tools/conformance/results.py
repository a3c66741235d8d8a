"""Summaries of results: counts and levels; and the results of engines in a file."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from gauge_envs.backends import backend, backend_names
from gauge_envs.errors import GaugeError, ResultFileError, UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.names import first_names
from gauge_envs.pages.document import save_file
from gauge_envs.reading import reading
from gauge_envs.registry import package_versions
from gauge_envs.runs.workers import Worker, call_engine
from gauge_envs.text import json_document
from gauge_envs.tools.conformance.catalog import checks
from gauge_envs.tools.conformance.model import CheckResult, Level, Status
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
    verdicts: dict[str, str] = {}
    for level in Level:
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
            verdicts[level] = f"incomplete, {first_names(needed, 1)} unsupported"
    return verdicts


# --- columns ---------------------------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class EngineColumn:
    """Results of one engine with one configuration.

    Attributes:
        backend: Name of the engine.
        name: Name of the configuration; `default` for the engine's own choice.
        settings: Settings that select it.
        results: Results by the id of the check; of a file, only those of unchanged checks.
        reason: Why no check ran; empty if a check did.
        versions: Versions of the engine's packages.
        gauge_envs: Version of gauge-envs that ran it; empty before it ran.
        made: Day of the run, as `2026-01-31`; empty before it ran.
    """

    backend: str
    name: str
    settings: Mapping[str, Any]
    results: dict[str, CheckResult] = field(default_factory=dict)
    reason: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    gauge_envs: str = ""
    made: str = ""

    @property
    def title(self) -> str:
        """Engine and configuration, as `physx PGS`."""
        return self.backend if self.name == "default" else f"{self.backend} {self.name}"


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
        pattern, colon, configuration = name.partition(":")
        engines = [engine for engine in backend_names() if fnmatchcase(engine, pattern)]
        if not engines:
            raise UnknownNameError("backend", pattern, backend_names())
        known = {(engine, "default"): dict[str, Any]() for engine in engines}
        for engine in engines if colon else ():
            known |= call_engine(engine, _configurations, engine, isolate=isolate)
        chosen = [key for key in known if fnmatchcase(key[1], configuration or "*")]
        if not chosen:
            configurations = {key[1] for key in known}
            raise UnknownNameError("configuration", configuration, configurations)
        for key in chosen:
            changed = {**(settings or {}), **known[key]}
            column = EngineColumn(backend=key[0], name=key[1], settings=changed)
            columns.setdefault(key, column)
    return list(columns.values())


def _configurations(name: str) -> dict[tuple[str, str], dict[str, Any]]:
    """Return the settings of the configurations that an engine declares; none for an engine that is not installed."""
    try:
        engine = backend(name)
    except GaugeError:
        return {}
    return {
        (name, str(key)): dict(values) for key, values in engine.configurations.items()
    }


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
            named = replace(result, configuration=column.name)
            column.results[result.check] = named
            yield named
    except GaugeError as error:
        column.reason = str(error)


KIND = "gauge-envs conformance matrix"
STORED = ("status", "expected", "measured", "width", "diagnosis", "missing")
"""Fields of a result in a file, beside the fingerprint of its check."""


def write_columns(columns: Sequence[EngineColumn], path: Path) -> Path:
    """Write columns as JSON and return the path; `read_columns` reads them back."""
    rows = []
    for column in columns:
        results = {
            name: {"fingerprint": result.of.fingerprint}
            | {key: getattr(result, key) for key in STORED}
            for name, result in column.results.items()
        }
        values = json_ready(vars(column) | {"results": results})
        rows.append(json.dumps(values, ensure_ascii=False))
    text = ",\n".join(rows)
    return save_file(path, f'{{"kind": "{KIND}", "columns": [\n{text}\n]}}\n')


def read_columns(path: Path) -> list[EngineColumn]:
    """Return the columns of a file, without results of checks that have changed since.

    Raises:
        ResultFileError: The file cannot be read or has no columns.
    """
    hint = "write it with gauge backend check NAME --out FILE.json"
    noun = "a file of conformance checks"
    with reading(path, ResultFileError, noun, hint) as content:
        document = json_document(content)
        if document["kind"] != KIND:
            raise ValueError(f"its kind is {document['kind']!r}")
        return [_read_column(row) for row in document["columns"]]


def _read_column(row: Mapping[str, Any]) -> EngineColumn:
    known = {check.id: check for check in checks()}
    column = EngineColumn(**{**row, "results": {}})
    for name, stored in row["results"].items():
        check = known.get(name)
        if check is None or stored["fingerprint"] != check.fingerprint:
            continue
        outcome = {key: stored[key] for key in STORED}
        outcome["status"] = status = Status(stored["status"])
        outcome["missing"] = tuple(stored["missing"])
        if status is Status.FAIL and stored["measured"] is None:
            outcome["measured"] = math.nan  # JSON has no number that is not finite.
        column.results[name] = CheckResult(
            of=check,
            backend=column.backend,
            configuration=column.name,
            versions=column.versions,
            **outcome,
        )
    return column
