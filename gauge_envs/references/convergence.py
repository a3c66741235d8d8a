"""Convergence: the change of a whole episode when the time step or the cells of the mesh are halved.

`scripts/build_convergence.py` measures it and writes `scoring/convergence/<engine>.csv`. A row that is absent was not
measured.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, get_args

from pydantic import NonNegativeFloat, PositiveFloat, ValidationError

from gauge_envs.errors import ReferenceFileError, first_fault
from gauge_envs.files import read_regular
from gauge_envs.references.tables import MOST_TABLE_BYTES, FileModel, scoring_folder

RefinedSetting = Literal["timestep_s", "cell_m"]
"""Setting that is halved: the time step, or the edge of the cells of a deformable body."""

REFINED_SETTINGS: tuple[RefinedSetting, ...] = get_args(RefinedSetting)
"""The settings that are halved, in the order of reports."""

COMMENT = "#"


class Convergence(FileModel):
    """Difference between an episode with default settings and one with a finer step or mesh, over all frames.

    The distance of one frame is Euclidean over the coordinates of g(t), as in the paper's RMSE. Deformable bodies are
    observed at the material points of their markers.

    Attributes:
        variant: Variant id, as in `SlopeSlider-2-wood`.
        setting: Setting that differs: `timestep_s` [s] or `cell_m` [m].
        default: Its value in the default run; for a mesh that has no single edge, the smallest edge of its cells.
        refined: Its value in the finer run.
        unit: Unit of rms and max.
        rms: Root mean square of the distance over frames; None if one of the runs diverged.
        max: Largest distance of a frame; None if one of the runs diverged.
        share: `rms` over the scatter of real trials, the mean of their published RMSE; None if none was published.
        points_rms_mm: Root mean square distance of the observed points over frames and points [mm].
        points_max_mm: Largest distance of an observed point [mm].
    """

    variant: str
    setting: RefinedSetting
    default: PositiveFloat
    refined: PositiveFloat
    unit: str
    rms: NonNegativeFloat | None = None
    max: NonNegativeFloat | None = None
    share: NonNegativeFloat | None = None
    points_rms_mm: NonNegativeFloat | None = None
    points_max_mm: NonNegativeFloat | None = None


@dataclass(frozen=True)
class ConvergenceTable:
    """Measured convergence of one engine.

    Attributes:
        notes: Texts of the head of the file by key: `engine` with its version, and `date`.
        rows: Measured rows, by variant and setting.
    """

    notes: Mapping[str, str]
    rows: Mapping[tuple[str, RefinedSetting], Convergence]

    def of(self, variant: str) -> dict[RefinedSetting, Convergence]:
        """Return the rows of a variant by setting; a setting that was not measured is absent."""
        return {setting: row for setting in REFINED_SETTINGS if (row := self.rows.get((variant, setting)))}

    @classmethod
    def read(cls, file: Path) -> ConvergenceTable:
        """Read a table."""
        try:
            lines = read_regular(file, MOST_TABLE_BYTES).decode("utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise ReferenceFileError(file, None, f"the file cannot be read: {error}") from None
        head = [line for line in lines if line.startswith(COMMENT)]
        notes = dict(line.removeprefix(COMMENT).strip().partition(": ")[::2] for line in head if ": " in line)
        body = list(csv.reader(line for line in lines if not line.startswith(COMMENT)))
        columns = list(Convergence.model_fields)
        if not body or body[0] != columns:
            found = ",".join(body[0]) if body else "none"
            raise ReferenceFileError(file, len(head) + 1, f"columns are {found}, expected {','.join(columns)}")
        rows: dict[tuple[str, RefinedSetting], Convergence] = {}
        for number, fields in enumerate(body[1:], start=len(head) + 2):
            if len(fields) != len(columns):
                raise ReferenceFileError(file, number, f"{len(fields)} fields, expected {len(columns)}")
            try:
                row = Convergence.model_validate(
                    {name: field or None for name, field in zip(columns, fields, strict=True)}
                )
            except ValidationError as error:
                raise ReferenceFileError(file, number, ": ".join(first_fault(error))) from None
            if (row.variant, row.setting) in rows:
                raise ReferenceFileError(file, number, f"{row.variant}, {row.setting} has a row above: remove one")
            rows[row.variant, row.setting] = row
        return cls(notes=notes, rows=rows)

    def text(self) -> str:
        """Return the table as the text of its file, sorted by variant and setting."""
        lines = [f"{COMMENT} {key}: {note}" for key, note in self.notes.items()]
        lines.append(",".join(Convergence.model_fields))
        ordered = sorted(self.rows.values(), key=lambda row: (row.variant, REFINED_SETTINGS.index(row.setting)))
        return "\n".join([*lines, *(_line(row) for row in ordered)]) + "\n"

    def with_rows(self, rows: Iterable[Convergence]) -> ConvergenceTable:
        """Return the table with further rows, which replace those of the same variant and setting."""
        return ConvergenceTable(self.notes, {**self.rows, **{(row.variant, row.setting): row for row in rows}})


def _line(row: Convergence) -> str:
    values = row.model_dump().values()
    return ",".join("" if value is None else f"{value:.4g}" if isinstance(value, float) else value for value in values)


def convergence_table(engine: str) -> ConvergenceTable:
    """Return the bundled table of an engine, as `mujoco`; it is empty if there is no such file."""
    return _bundled(scoring_folder("convergence") / f"{engine}.csv")


@cache
def _bundled(file: Path) -> ConvergenceTable:
    return ConvergenceTable.read(file) if file.is_file() else ConvergenceTable({}, {})
