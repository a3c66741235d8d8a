"""The reference of an experiment file: its table `[band]`, and the CSV file that it names (format: docs/assets.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt, model_validator

from gauge_envs.errors import ReferenceFileError
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.tables import FileModel, csv_header, read_rows
from gauge_envs.scene.geometry import FloatArray, NonNegative, Positive

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


class _Row(FileModel):
    """Row of the CSV file; values are keyed by coordinate, and None is unknown."""

    frame: NonNegativeInt
    time_s: float | None = None
    mean: dict[str, float | None]
    sigma: dict[str, NonNegative] = Field(default_factory=dict)
    uncertainty: dict[str, NonNegative | None] = Field(default_factory=dict)


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
    names, header = table.coordinates, csv_header(file)
    columns = ["frame", *({"time_s"} & set(header))]
    arrays: dict[str, FloatArray] = {}
    for quantity in ("mean", "sigma", "uncertainty"):
        if quantity == "mean" or f"{quantity}.{names[0]}" in header:
            columns += [f"{quantity}.{name}" for name in names]
            arrays[quantity] = np.full((frame_count, len(names)), NAN)
    for index, (line, row) in enumerate(read_rows(file, columns, _Row)):
        if row.frame != index or index >= frame_count:
            expected = f"frames count from 0 to {frame_count - 1}"
            raise ReferenceFileError(file, line, f"frame is {row.frame}: {expected}")
        for quantity, values in arrays.items():
            values[index] = [*getattr(row, quantity).values()]
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
