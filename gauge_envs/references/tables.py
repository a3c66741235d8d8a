"""Read the CSV, TOML and JSON files of reference data, each row and table checked by a pydantic model."""

import csv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    NonNegativeInt,
    ValidationError,
)

from gauge_envs.errors import ReferenceFileError, first_fault
from gauge_envs.files import (
    csv_text,
    data_folder,
    toml_document,
)
from gauge_envs.scene.geometry import FloatArray, Vector, length_of


def _unit(axis: Vector) -> Vector:
    if abs(length_of(axis) - 1.0) > 1e-9:
        raise ValueError(f"{list(axis)} is not a unit vector: normalize it")
    return axis


UnitVector = Annotated[Vector, AfterValidator(_unit)]


class FileModel(BaseModel):
    """One table of a file: frozen, without unknown keys, all numbers finite."""

    # A validator is built at first use: most files need few of the tables.
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True
    )


class FrameRow(FileModel):
    """Row of a table with one row for each frame."""

    frame: NonNegativeInt


Model = TypeVar("Model", bound=FileModel)
Row = TypeVar("Row", bound=FrameRow)


def scoring_folder(name: str) -> Path:
    """Return a folder of `scoring/`, as `bands`."""
    return data_folder("scoring") / name


def read_content(file: Path) -> bytes:
    """Return the content of a file of reference data."""
    try:
        return file.read_bytes()
    except FileNotFoundError:
        raise ReferenceFileError(file, None, "the file is missing") from None
    except OSError as error:
        raise ReferenceFileError(
            file, None, f"cannot be read: {error.strerror or error}"
        ) from None


@contextmanager
def faults_of(file: Path, line: int | None = None) -> Iterator[None]:
    """Raise an error with the place of what pydantic refuses, or with the reason of another ValueError."""
    try:
        yield
    except ValidationError as error:
        raise ReferenceFileError(
            file, line, ": ".join(filter(None, first_fault(error)))
        ) from None
    except ReferenceFileError:
        raise
    except ValueError as error:
        raise ReferenceFileError(file, line, str(error)) from None


@cache
def read_toml(file: Path, model: type[Model]) -> Model:
    """Read a TOML file, once."""
    with faults_of(file):
        return model.model_validate(toml_document(read_content(file)))


def csv_header(file: Path) -> list[str]:
    """Return the names of the columns of a CSV file."""
    return next(_csv_rows(file), (1, []))[1]


def _csv_rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the fields of each row; lines that start with `#` are notes."""
    line = 0
    try:
        reader = csv.reader(csv_text(read_content(file)))
        for fields in reader:
            line = reader.line_num
            if not (fields and fields[0].startswith("#")):
                yield line, fields
    except (UnicodeDecodeError, csv.Error) as error:
        raise ReferenceFileError(
            file, line + 1, f"is not CSV in UTF-8: {error}"
        ) from None


def header_fault(header: Sequence[str], columns: Sequence[str]) -> str:
    """Return the known columns of a header, and the number of unknown ones: the file may be a private one."""
    known = [name for name in header if name in columns]
    return f"columns are {','.join(known) or 'none of these'} and {len(header) - len(known)} unknown ones"


def read_rows(
    file: Path, columns: Sequence[str], model: type[Model]
) -> Iterator[tuple[int, Model]]:
    """Read the rows of a CSV file.

    A column `mean.x` is the entry `x` of the field `mean`. An empty field is None.

    Args:
        file: The file.
        columns: Columns that it must have, in this order.
        model: Model of one row.

    Returns:
        Iterator over the line number and the content of each row.
    """
    rows = _csv_rows(file)
    line, header = next(rows, (1, []))
    if header != list(columns):
        raise ReferenceFileError(
            file, line, f"{header_fault(header, columns)}, expected {','.join(columns)}"
        )
    for line, fields in rows:
        if len(fields) != len(columns):
            raise ReferenceFileError(
                file, line, f"{len(fields)} fields, expected {len(columns)}"
            )
        with faults_of(file, line):
            row = model.model_validate(_nested(columns, fields))
        yield line, row


def _nested(columns: Sequence[str], fields: Sequence[str]) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for column, field in zip(columns, fields, strict=True):
        name, dot, entry = column.partition(".")
        if dot:
            row.setdefault(name, {})[entry] = field or None
        else:
            row[name] = field or None
    return row


def read_frames(file: Path, columns: Sequence[str], model: type[Row]) -> list[Row]:
    """Read the rows of a CSV file with one row for each frame, from frame 0; arguments as of `read_rows`."""
    rows: list[Row] = []
    for line, row in read_rows(file, columns, model):
        if row.frame != len(rows):
            raise ReferenceFileError(
                file, line, f"frame {row.frame} where {len(rows)} is next"
            )
        rows.append(row)
    return rows


def frame_table(
    rows: Sequence[Row], field: str, frame_count: int | None = None
) -> FloatArray:
    """Return the values of a field that is keyed by column, shape [frame_count, column_count]; NaN is unknown.

    Args:
        rows: The rows, at least one.
        field: Name of the field.
        frame_count: Number of frames, whose last ones may have no row; the number of rows if None.
    """
    values = np.array(
        [[*getattr(row, field).values()] for row in rows], dtype=np.float64
    )
    padding = 0 if frame_count is None else frame_count - len(rows)
    return np.pad(values, ((0, padding), (0, 0)), constant_values=np.nan)
