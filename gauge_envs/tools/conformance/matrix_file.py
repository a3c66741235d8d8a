"""Columns of a matrix in a JSON file, so that engines of several environments share one page."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.files import MEGABYTE, json_document, json_ready, os_errors, read_regular, write_whole
from gauge_envs.tools.conformance.matrix import MatrixColumn
from gauge_envs.tools.conformance.model import Check, CheckResult, Outcome, Status, checks

KIND = "gauge-envs conformance matrix"

MOST_BYTES = 32 * MEGABYTE
"""Largest size of a file."""


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
    text = ",\n".join(json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows)
    with os_errors(lambda cause: ResultFileError(f"{path}: cannot be written: {cause}")):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, f'{{"kind": "{KIND}", "columns": [\n{text}\n]}}\n'.encode())
    return path


def _record(column: MatrixColumn) -> dict[str, Any]:
    """Return one column, JSON-ready."""
    findings = {
        name: {"fingerprint": column.fingerprints[name]} | dict(_entries(finding))
        for name, finding in column.findings.items()
    }
    facts = {name: getattr(column, name) for name in _Column.model_fields if name != "findings"}
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
        found = _Document.model_validate(json_document(read_regular(path, MOST_BYTES)))
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        reason = f"is no JSON document ({error})"
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            reason = f"{'.'.join(str(part) for part in first['loc']) or 'the document'}: {first['msg']}"
        raise ResultFileError(f"{path}: {reason}; write it with gauge backend check 'NAME:*' --out FILE") from None
    if found.kind != KIND:
        raise ResultFileError(f"{path}: its kind is {found.kind!r}, expected {KIND!r}")
    known = {check.id: check for check in checks()}
    return [_column(one, known) for one in found.columns]


def _column(one: _Column, known: Mapping[str, Check]) -> MatrixColumn:
    column = MatrixColumn(**one.model_dump(exclude={"versions", "findings"}))
    for name, finding in one.findings.items():
        values = {key: getattr(finding, key) for key in (entry.name for entry in fields(Outcome))}
        if finding.status is Status.FAIL and finding.measured is None:
            values["measured"] = math.nan  # JSON has no number that is not finite.
        check = known.get(name, Check(name))
        column.findings[name] = CheckResult(of=check, backend=one.backend, versions=one.versions, **values)
        column.fingerprints[name] = finding.fingerprint
    return column


def with_columns(columns: Sequence[MatrixColumn], files: Sequence[Path]) -> list[MatrixColumn]:
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
