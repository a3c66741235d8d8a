"""The reference of an experiment file: its table `[band]`, and the CSV file that it names (format: docs/assets.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt, create_model, model_validator

from gauge_envs.errors import ReferenceFileError
from gauge_envs.files import csv_text
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.references.tables import FileModel, faults_of, read_content, read_rows
from gauge_envs.scene.geometry import NonNegative, Positive

NAN = float("nan")
QUANTITIES: dict[str, Any] = {
    "mean": float,
    "sigma": NonNegative,
    "uncertainty": NonNegative,
}
"""Columns of the CSV file by their first word, with the type of a cell."""


class BandTable(FileModel):
    """The table `[band]` of an experiment file.

    Attributes:
        file: CSV file, relative to the experiment file.
        kind: What the mean is, as in `Band`.
        coordinates: Names of the C coordinates, as in the columns of the CSV file.
        projection: Linear map from g(t) of width D to the coordinates, shape [C, D]; None is the identity.
        indices: Indices of the coordinates in g(t), in place of `projection`.
        sigma: Standard deviation at every frame, in place of columns.
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


def read_band(
    file: Path, table: BandTable, *, unit: str, frame_count: int, width: int
) -> Band:
    """Return the reference that a table and its CSV file state.

    Args:
        file: CSV file with a row for each frame: `frame`, `mean.*`, and optionally `sigma.*`, `uncertainty.*`. Frames
            after its end are unknown. Without sigma, uncertainty counts as sigma.
        table: What the experiment file states.
        unit: Unit of g(t).
        frame_count: Number of frames of the experiment.
        width: Number of coordinates of g(t).
    """
    names = table.coordinates
    with faults_of(file):
        header = csv_text(read_content(file)).readline().strip().split(",")
        stated = [one for one in QUANTITIES if f"{one}.{names[0]}" in header]
        quantities = stated if "mean" in stated else ["mean", *stated]
        fields: dict[str, Any] = {"frame": (NonNegativeInt, ...)}
        for quantity in quantities:
            kind = QUANTITIES[quantity]
            fields |= {f"{quantity}.{name}": (kind | None, ...) for name in names}
        rows = read_rows(file, create_model("Row", __base__=FileModel, **fields))
    frames = [row.model_dump()["frame"] for row in rows]
    if frames != list(range(len(rows))) or not 0 < len(rows) <= frame_count:
        expected = f"column frame: 0, 1, ... to at most {frame_count - 1} is expected"
        raise ReferenceFileError(file, None, expected)
    values = np.full((frame_count, len(fields)), NAN)
    values[: len(rows)] = [[*row.model_dump().values()] for row in rows]
    parts = np.split(values[:, 1:], len(quantities), axis=1)
    arrays = dict(zip(quantities, parts, strict=True))
    mean, uncertainty = arrays["mean"], arrays.get("uncertainty")
    sigma = arrays.get("sigma", uncertainty)
    if table.sigma is not None or sigma is None:
        sigma = np.full(mean.shape, table.sigma or NAN)
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
