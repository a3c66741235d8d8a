"""Read the CSV and TOML files of reference data, each row and table checked by a pydantic model."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from gauge_envs.errors import ReferenceFileError, first_fault
from gauge_envs.files import data_folder

__all__ = ["FileModel", "csv_header", "read_rows", "read_toml", "scoring_folder"]


class FileModel(BaseModel):
    """One table of a file: frozen, without unknown keys, all numbers finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=FileModel)


def scoring_folder(name: str) -> Path:
    """Return a folder of `scoring/`, as `bands`."""
    return data_folder("scoring") / name


def read_toml(file: Path, model: type[Model]) -> Model:
    """Read a TOML file.

    Raises:
        ReferenceFileError: The file is missing, is not TOML, or does not fit the model.
    """
    if not file.is_file():
        raise ReferenceFileError(file, None, "the file is missing")
    try:
        return model.model_validate(tomllib.loads(file.read_text(encoding="utf-8")))
    except ValidationError as error:
        raise ReferenceFileError(file, None, ": ".join(filter(None, first_fault(error)))) from None
    except ValueError as error:
        raise ReferenceFileError(file, None, str(error)) from None


def csv_header(file: Path) -> list[str]:
    """Return the names of the columns of a CSV file.

    Raises:
        ReferenceFileError: The file is missing.
    """
    if not file.is_file():
        raise ReferenceFileError(file, None, "the file is missing")
    with file.open(encoding="utf-8", newline="") as stream:
        return next(csv.reader(stream), [])


def read_rows(file: Path, columns: Sequence[str], model: type[Model]) -> Iterator[tuple[int, Model]]:
    """Read the rows of a CSV file.

    A column `mean.x` is the entry `x` of the field `mean`. An empty field is None.

    Args:
        file: The file.
        columns: Columns that it must have, in this order.
        model: Model of one row.

    Returns:
        Iterator over the line number and the content of each row.

    Raises:
        ReferenceFileError: The file is missing, has other columns, or a row does not fit the model.
    """
    header = csv_header(file)
    if header != list(columns):
        raise ReferenceFileError(file, 1, f"columns are {','.join(header)}, expected {','.join(columns)}")
    with file.open(encoding="utf-8", newline="") as stream:
        reader = csv.reader(stream)
        next(reader)
        for fields in reader:
            if len(fields) != len(columns):
                raise ReferenceFileError(file, reader.line_num, f"{len(fields)} fields, expected {len(columns)}")
            try:
                yield reader.line_num, model.model_validate(_nested(columns, fields))
            except ValidationError as error:
                raise ReferenceFileError(file, reader.line_num, ": ".join(first_fault(error))) from None


def _nested(columns: Sequence[str], fields: Sequence[str]) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for column, field in zip(columns, fields, strict=True):
        name, dot, entry = column.partition(".")
        if dot:
            row.setdefault(name, {})[entry] = field or None
        else:
            row[name] = field or None
    return row
