"""Read the CSV and TOML files of reference data, each row and table checked by a pydantic model."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from gauge_envs.errors import ReferenceFileError, first_fault
from gauge_envs.files import MEGABYTE, data_folder, read_regular, toml_document

MOST_TABLE_BYTES = 16 * MEGABYTE
"""Largest size of a table."""


class FileModel(BaseModel):
    """One table of a file: frozen, without unknown keys, all numbers finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=FileModel)


def scoring_folder(name: str) -> Path:
    """Return a folder of `scoring/`, as `bands`."""
    return data_folder("scoring") / name


def read_toml(file: Path, model: type[Model]) -> Model:
    """Read a TOML file."""
    try:
        return model.model_validate(toml_document(_content(file)))
    except ValidationError as error:
        raise ReferenceFileError(file, None, ": ".join(filter(None, first_fault(error)))) from None
    except ValueError as error:
        raise ReferenceFileError(file, None, str(error)) from None


def csv_header(file: Path) -> list[str]:
    """Return the names of the columns of a CSV file."""
    return next(_csv_rows(file), (1, []))[1]


def _content(file: Path) -> bytes:
    try:
        return read_regular(file, MOST_TABLE_BYTES)
    except FileNotFoundError:
        raise ReferenceFileError(file, None, "the file is missing") from None
    except OSError as error:
        raise ReferenceFileError(file, None, f"cannot be read: {error.strerror or error}") from None


def _csv_rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the fields of each row."""
    line = 0
    try:
        reader = csv.reader(io.StringIO(_content(file).decode("utf-8"), newline=""))
        for fields in reader:
            line = reader.line_num
            yield line, fields
    except (UnicodeDecodeError, csv.Error) as error:
        raise ReferenceFileError(file, line + 1, f"is not CSV in UTF-8: {error}") from None


def header_fault(header: Sequence[str], columns: Sequence[str]) -> str:
    """Return the known columns of a header, and the number of unknown ones: the file may be a private one."""
    known = [name for name in header if name in columns]
    return f"columns are {','.join(known) or 'none of these'} and {len(header) - len(known)} unknown ones"


def read_rows(file: Path, columns: Sequence[str], model: type[Model]) -> Iterator[tuple[int, Model]]:
    """Read the rows of a CSV file.

    A column `mean.x` is the entry `x` of the field `mean`. An empty field is None.

    Args:
        file: The file.
        columns: Columns that it must have, in this order.
        model: Model of one row.

    Returns:
        Iterator over the line number and the content of each row.
    """
    header = csv_header(file)
    if header != list(columns):
        raise ReferenceFileError(file, 1, f"{header_fault(header, columns)}, expected {','.join(columns)}")
    for line, fields in islice(_csv_rows(file), 1, None):
        if len(fields) != len(columns):
            raise ReferenceFileError(file, line, f"{len(fields)} fields, expected {len(columns)}")
        try:
            yield line, model.model_validate(_nested(columns, fields))
        except ValidationError as error:
            raise ReferenceFileError(file, line, ": ".join(first_fault(error))) from None


def _nested(columns: Sequence[str], fields: Sequence[str]) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for column, field in zip(columns, fields, strict=True):
        name, dot, entry = column.partition(".")
        if dot:
            row.setdefault(name, {})[entry] = field or None
        else:
            row[name] = field or None
    return row
