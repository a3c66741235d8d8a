"""Columns of a matrix in a JSON file, so that engines of several environments share one page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.files import MEGABYTE, json_document, json_ready, read_regular, write_whole
from gauge_envs.tools.conformance.matrix import MatrixColumn
from gauge_envs.tools.conformance.model import Check, CheckResult, Status
from gauge_envs.tools.conformance.registry import checks

KIND = "gauge-envs conformance matrix"

MOST_BYTES = 32 * MEGABYTE
"""Largest size of a file."""

TEXTS = ("title", "measures", "law", "source", "unit")
"""Attributes of a result that are those of its check, and so are not in a file."""

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Finding(_Strict):
    """What one check gave; its texts are those of the check, whose fingerprint it has."""

    fingerprint: str
    status: Status
    expected: Finite | None = None
    measured: Finite | None = None
    width: Finite | None = None
    diagnosis: str = ""
    missing: tuple[str, ...] = ()
    reported_by: str = ""
    wall_s: Finite = 0.0
    cpu_s: Finite | None = None


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
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, f'{{"kind": "{KIND}", "columns": [\n{text}\n]}}\n'.encode())
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path


def _record(column: MatrixColumn) -> dict[str, Any]:
    """Return one column, JSON-ready."""
    kept = set(_Finding.model_fields) - {"fingerprint"}
    findings = {
        name: {"fingerprint": column.fingerprints[name]}
        | {key: _short(value) for key, value in json_ready(asdict(finding)).items() if key in kept and _says(value)}
        for name, finding in column.findings.items()
    }
    facts = {name: getattr(column, name) for name in ("backend", "name", "settings", "gauge_envs", "made", "versions")}
    values: dict[str, Any] = json_ready(
        facts | {"reason": column.reason, "refused": column.refused, "findings": findings}
    )
    return values


def _says(value: Any) -> bool:
    return value not in (None, "", [], ())


def _short(value: Any) -> Any:
    """Return a number with nine significant digits, more than any tolerance asks for."""
    return float(f"{value:.9g}") if isinstance(value, float) else value


def read_columns(path: Path) -> list[MatrixColumn]:
    """Return the columns of a file.

    A result whose check has another definition now, or is not known, is kept; `MatrixColumn.outdated` names it.
    """
    try:
        found = _Document.model_validate(json_document(read_regular(path, MOST_BYTES)))
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the document"
        raise ResultFileError(
            f"{path}: {place}: {first['msg']}; write it with gauge backend check 'NAME:*' --out FILE"
        ) from None
    except ValueError as error:
        raise ResultFileError(
            f"{path}: is no JSON document ({error}); write it with gauge backend check 'NAME:*' --out FILE"
        ) from None
    if found.kind != KIND:
        raise ResultFileError(f"{path}: its kind is {found.kind!r}, expected {KIND!r}")
    known = {check.id: check for check in checks()}
    return [_column(one, known) for one in found.columns]


def _column(one: _Column, known: Mapping[str, Check]) -> MatrixColumn:
    column = MatrixColumn(
        backend=one.backend,
        name=one.name,
        settings=one.settings,
        refused=dict(one.refused),
        reason=one.reason,
        gauge_envs=one.gauge_envs,
        made=one.made,
    )
    for name, finding in one.findings.items():
        check = known.get(name)
        values: dict[str, Any] = {text: "" if check is None else getattr(check, text) for text in TEXTS}
        values |= {"rationale": "" if check is None else check.tolerance.rationale}
        values |= finding.model_dump(exclude={"fingerprint"})
        result = CheckResult(check=name, backend=one.backend, versions=one.versions, **values)
        if result.status is Status.FAIL and result.measured is None:
            # JSON has no number that is not finite.
            result = replace(result, measured=math.nan)
        column.findings[name] = result
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
