"""Read the CSV, TOML and JSON files of reference data; a pydantic model checks each row and table."""

import csv
from functools import cache
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
)

from gauge_envs.errors import ReferenceFileError
from gauge_envs.files import data_folder
from gauge_envs.reading import reading
from gauge_envs.scene.geometry import Vector, length_of
from gauge_envs.text import csv_text, toml_document


def _unit(axis: Vector) -> Vector:
    if abs(length_of(axis) - 1.0) > 1e-9:
        raise ValueError(f"{list(axis)} is not a unit vector: normalize it")
    return axis


UnitVector = Annotated[Vector, AfterValidator(_unit)]


class FileModel(BaseModel):
    """One table of a file: frozen, without unknown keys, all numbers finite."""

    # Build a validator at its first use, because most files need few of the tables.
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True
    )


Model = TypeVar("Model", bound=FileModel)


def scoring_folder(name: str) -> Path:
    """Return a folder of `scoring/`, as `bands`."""
    return data_folder("scoring") / name


@cache
def read_toml(file: Path, model: type[Model]) -> Model:
    """Read a TOML file, once."""
    with reading(file, ReferenceFileError) as content:
        return model.model_validate(toml_document(content))


def read_rows(file: Path, model: type[Model]) -> list[Model]:
    """Return the rows of a bundled CSV file as models; columns are fields, and an empty cell is None."""
    with reading(file, ReferenceFileError) as content:
        lines = csv_text(content)
        rows = csv.DictReader(line for line in lines if not line.startswith("#"))
        return [
            model.model_validate({name: cell or None for name, cell in row.items()})
            for row in rows
        ]
