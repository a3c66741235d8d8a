"""The reference of an experiment file: its table `[band]`, and the CSV file that it names (format: docs/assets.md)."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt, model_validator

from gauge_envs.errors import ReferenceFileError
from gauge_envs.files import csv_text
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.tables import FileModel, faults_of, read_content
from gauge_envs.scene.geometry import FloatArray, Positive

NAN = float("nan")


class BandTable(FileModel):
    """The table `[band]` of an experiment file.

    Attributes:
        file: CSV file, relative to the experiment file.
        kind: What the mean is, as in `Band`.
        coordinates: Names of the C coordinates, as in the columns of the CSV file.
        projection: Linear map from g(t) of width D to the coordinates, shape [C, D]; None is the identity.
        indices: Indices of the coordinates in g(t), in place of `projection`.
        sigma: Standard deviation at every frame, for a CSV file without columns of it.
        trial_count: Number of real trials; None is unknown.
        source: Where the numbers are from, one sentence.
    """

    file: str
    kind: Literal["trials", "recording", "analytic"]
    coordinates: Annotated[tuple[str, ...], Field(min_length=1)]
    projection: tuple[tuple[float, ...], ...] | None = None
    indices: tuple[NonNegativeInt, ...] | None = None
    sigma: Positive | None = None
    trial_count: PositiveInt | None = None
    source: str

    @model_validator(mode="before")
    @classmethod
    def _without_old_keys(cls, values: Any) -> Any:
        if isinstance(values, dict) and "grade" in values:
            raise ValueError("grade is now kind: trials, recording or analytic")
        return values


def _columns(file: Path) -> dict[str, FloatArray]:
    """Return the columns of a CSV file by name; an empty cell is NaN, and lines that start with `#` are notes."""
    reader = csv.reader(csv_text(read_content(file)))
    header: list[str] = []
    rows: list[list[float]] = []
    for cells in reader:
        if cells and cells[0].startswith("#"):
            continue
        if not header:
            header = cells
            continue
        with faults_of(file, reader.line_num):
            if len(cells) != len(header):
                raise ValueError(f"{len(cells)} cells, expected {len(header)}")
            rows.append([float(cell) if cell else NAN for cell in cells])
    values = np.array(rows).reshape(-1, len(header))
    return dict(zip(header, values.T, strict=True))


def read_band(
    file: Path, table: BandTable, *, unit: str, frame_count: int, width: int
) -> Band:
    """Return the reference that a table and its CSV file state.

    Args:
        file: CSV file with a row for each frame: `frame`, `mean.*`, and optionally `time_s`, `sigma.*`,
            `uncertainty.*`. Frames after its end are unknown. Without sigma, uncertainty counts as sigma.
        table: What the experiment file states.
        unit: Unit of g(t).
        frame_count: Number of frames of the experiment.
        width: Number of coordinates of g(t).
    """
    names = table.coordinates
    columns = _columns(file)
    count = len(columns.get("frame", ()))
    expected = np.arange(count)
    if not 0 < count <= frame_count or (columns["frame"] != expected).any():
        raise ReferenceFileError(
            file, None, f"column frame: frames from 0 to at most {frame_count - 1}"
        )
    arrays: dict[str, FloatArray] = {}
    for quantity in ("mean", "sigma", "uncertainty"):
        wanted = [f"{quantity}.{name}" for name in names]
        missing = [name for name in wanted if name not in columns]
        if missing and (quantity == "mean" or len(missing) < len(wanted)):
            raise ReferenceFileError(file, None, f"no column {missing[0]}")
        if not missing:
            arrays[quantity] = np.full((frame_count, len(names)), NAN)
            arrays[quantity][:count] = np.stack([columns[one] for one in wanted], 1)
    mean, uncertainty = arrays["mean"], arrays.get("uncertainty")
    stated = uncertainty if table.sigma is None else table.sigma
    sigma = np.broadcast_to(
        arrays.get("sigma", NAN if stated is None else stated), mean.shape
    )
    if not np.isfinite(mean + sigma).any():
        raise ReferenceFileError(file, None, "no frame has both mean and sigma")
    identity = np.eye(len(names))
    if table.indices is not None:
        if max(table.indices) >= width:
            raise ReferenceFileError(
                file, None, f"g(t) has {width} coordinates: [band] has larger indices"
            )
        identity = np.eye(width)[list(table.indices)]
    return Band(
        kind=Kind(table.kind),
        unit=unit,
        coordinates=names,
        projection=identity if table.projection is None else np.array(table.projection),
        mean=mean,
        sigma=sigma,
        measured=np.asarray(np.isfinite(mean).any(axis=1)),
        source=table.source,
        trial_count=table.trial_count,
        uncertainty=uncertainty,
    )
