"""Standard uncertainties of the inputs of a simulation, and how its trajectory changes with each of them.

The bundled tables are in `scoring/sensitivities/<engine>/<variant>.json`. The command `gauge run --uncertainty` writes
those of other engines to the user's data folder, in the same format.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import AfterValidator, PlainSerializer, PositiveInt, TypeAdapter

from gauge_envs.errors import DatasetError, ReferenceFileError
from gauge_envs.files import os_errors, write_whole
from gauge_envs.references.tables import (
    FileModel,
    faults_of,
    read_content,
    read_toml,
    scoring_folder,
)
from gauge_envs.references.user_data import user_data_folder
from gauge_envs.scene.geometry import FloatArray, Positive

FALLBACK_ENGINE = "mujoco"
"""Engine whose sensitivities serve others without their own: to first order they are those of the physics."""


class StandardUncertainty(FileModel):
    """Standard uncertainty of one kind of input (`scoring/uncertainties.toml`)."""

    std: Positive
    unit: str
    source: str


class ConstantUncertainty(FileModel):
    """Standard uncertainty of a published constant, over its value, by material."""

    relative: dict[str, Positive]
    source: str
    unit: str = "1"

    def std(self, value: float, material: str | None) -> float:
        """Return the standard uncertainty of a constant, in its unit.

        Args:
            value: Published value.
            material: Material of the variant; one without trials has the uncertainty of `other`.
        """
        return value * self.relative.get(material or "other", self.relative["other"])


class _TrialCount(FileModel):
    """Number of real trials where only their mean and standard deviation are published."""

    count: PositiveInt
    source: str


class StandardUncertainties(FileModel):
    """The file `scoring/uncertainties.toml`: 1-sigma uncertainties, each with its source."""

    friction: ConstantUncertainty
    restitution: ConstantUncertainty
    joint: dict[str, ConstantUncertainty]
    start: StandardUncertainty
    tilt: StandardUncertainty
    trials: _TrialCount


def input_uncertainties() -> StandardUncertainties:
    """Return the standard uncertainties of inputs."""
    return read_toml(scoring_folder("uncertainties.toml"), StandardUncertainties)


def _rounded(table: FloatArray) -> list[list[float]]:
    return [[float(f"{value:.4g}") for value in row] for row in table.tolist()]


if TYPE_CHECKING:
    _Table = FloatArray
else:
    _Table = Annotated[
        tuple[tuple[float, ...], ...],
        AfterValidator(lambda rows: np.array(rows, dtype=np.float64)),
        PlainSerializer(_rounded),
    ]


@dataclass(frozen=True, eq=False, kw_only=True)
class InputUncertainty:
    """One uncertain input, and the change of the trajectory for one standard uncertainty of it.

    Attributes:
        name: Name of the input, as `friction cube/board` or `time step`.
        kind: `constant`, `start`, `tilt` or `discretization`.
        std: Standard uncertainty, in `unit`.
        unit: Unit of `std`.
        source: Origin of `std`.
        change: Change of g(t) at the frames when the input is one standard uncertainty higher, shape [T, D], in the
            observable's unit. A file has four significant digits of it.
        change_below: The same for one standard uncertainty lower; None where it is the opposite of `change`.
    """

    __pydantic_config__ = FileModel.model_config

    name: str
    kind: str
    std: Positive
    unit: str
    source: str
    change: _Table
    change_below: _Table | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensitivities:
    """Uncertain inputs of one experiment on one engine.

    Attributes:
        variant: Name of the variant.
        backend: Engine that was perturbed.
        versions: Versions of its packages.
        settings: Preset and settings that were in force, as `preset` and `timestep_s`.
        left_out: Inputs without a value, with the reason.
        inputs: The inputs.
    """

    __pydantic_config__ = FileModel.model_config

    variant: str
    backend: str
    versions: dict[str, str]
    settings: dict[str, float | str]
    left_out: tuple[str, ...] = ()
    inputs: tuple[InputUncertainty, ...]


@cache
def _format() -> TypeAdapter[Sensitivities]:
    return TypeAdapter(Sensitivities)


def load_sensitivities(variant: str, backend: str | None) -> Sensitivities | None:
    """Return how the trajectory of a variant changes with its uncertain inputs.

    The user's own table of the engine comes first, then the bundled one, then that of MuJoCo; `Sensitivities.backend`
    states the engine.

    Args:
        variant: Name of the variant.
        backend: Name of the engine; None for a trajectory of unknown origin.

    Returns:
        The table, or None if there is none; one that version 0.1 measured does not count.
    """
    for engine in dict.fromkeys(filter(None, (backend, FALLBACK_ENGINE))):
        if Path(engine).name != engine:
            continue  # A file of a stranger may state any text as its engine.
        for folder in (
            user_data_folder() / "sensitivities",
            scoring_folder("sensitivities"),
        ):
            file = folder / engine / f"{variant}.json"
            try:
                stamp = file.stat()
            except OSError:
                continue
            table = _read(file, stamp.st_mtime_ns)
            # Version 0.1 moved constants by a smaller uncertainty, that of the scatter of trials.
            if all(
                one.change_below is not None
                for one in table.inputs
                if one.kind == "constant"
            ):
                return table
    return None


@lru_cache(maxsize=128)
def _read(file: Path, mtime_ns: int) -> Sensitivities:
    with faults_of(file):
        table = _format().validate_json(read_content(file))
    if len({entry.change.shape for entry in table.inputs}) > 1:
        raise ReferenceFileError(
            file, None, "the inputs disagree in the number of frames or coordinates"
        )
    return table


def sensitivities_text(table: Sensitivities) -> str:
    """Return a table as the text of its file; changes are rounded to 4 significant digits."""
    return _format().dump_json(table).decode() + "\n"


def write_sensitivities(table: Sensitivities) -> Path:
    """Store a table in the user's data folder, and return its file."""
    file = (
        user_data_folder() / "sensitivities" / table.backend / f"{table.variant}.json"
    )
    with os_errors(lambda cause: DatasetError(f"{file} cannot be written: {cause}")):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, sensitivities_text(table).encode())
    return file
