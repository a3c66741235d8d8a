"""Statistics of deformation of real trials per frame, which markers of a simulation are compared with.

The bundled tables are data in `scoring/statistics`; `scoring/README.md` names their sources. Their grade is
`statistics`: they enter no other score.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveInt

from gauge_envs.errors import ReferenceFileError, ShapeError
from gauge_envs.references.tables import (
    FileModel,
    FrameRow,
    frame_table,
    read_frames,
    read_toml,
    scoring_folder,
)
from gauge_envs.scene.geometry import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class DeformationReference:
    """Real statistics of deformation at the 30 Hz frames of an experiment.

    Attributes:
        statistics: Names of the statistics, as in `gauge_envs.observables.deformation.STATISTICS`.
        markers: Indices of the markers that they rest on; None for all.
        mean: Statistics, mm for `non_affine` and 1 for the others, shape [frame_count, statistic_count]; NaN where not
            measured.
        sigma: 1-sigma uncertainty of one trial, same shape and unit: that of the measurement for one recording, the
            scatter of the trials for several.
        trial_count: Number of real trials.
        source: Where the numbers are from, one sentence.
        note: What limits them; None without a limit.
    """

    statistics: tuple[str, ...]
    markers: tuple[int, ...] | None
    mean: FloatArray
    sigma: FloatArray
    trial_count: int
    source: str
    note: str | None = None

    def __post_init__(self) -> None:
        if (
            self.mean.ndim != 2
            or self.mean.shape[1] != len(self.statistics)
            or self.sigma.shape != self.mean.shape
        ):
            raise ShapeError(
                f"mean has shape {self.mean.shape}, sigma {self.sigma.shape}; "
                f"both must be [frame_count, {len(self.statistics)}]"
            )


class StatisticsSidecar(FileModel):
    """The file `<variant>.toml` beside the table `<variant>.csv` of statistics.

    Attributes:
        grade: Always `statistics`.
        statistics: Names of the statistics, as in the columns of the table.
        markers: Indices of the markers that they rest on.
        frames: Number of frames of the experiment; later ones than the table's are unknown.
        trial_count: Number of real trials.
        source: Where the numbers are from, one sentence.
        note: What limits them.
        recording: Facts about the recording.
    """

    grade: Literal["statistics"]
    statistics: Annotated[tuple[str, ...], Field(min_length=1)]
    markers: Annotated[tuple[NonNegativeInt, ...], Field(min_length=1)]
    frames: PositiveInt
    trial_count: PositiveInt
    source: str
    note: str
    recording: dict[str, Any]


class _StatisticsRow(FrameRow):
    """One row of the table; values are keyed by statistic, and None is not measured."""

    time_s: float
    mean: dict[str, float | None]
    uncertainty: dict[str, NonNegativeFloat | None]


def bundled_deformation(variant: str) -> DeformationReference | None:
    """Return the statistics of a variant that come with the package; None without any. Imports play no part."""
    return _bundled(scoring_folder("statistics"), variant)


@cache
def _bundled(folder: Path, variant: str) -> DeformationReference | None:
    file, sidecar_file = folder / f"{variant}.csv", folder / f"{variant}.toml"
    if not file.is_file():
        return None
    sidecar = read_toml(sidecar_file, StatisticsSidecar)
    columns = [
        f"{quantity}.{name}"
        for quantity in ("mean", "uncertainty")
        for name in sidecar.statistics
    ]
    rows = read_frames(file, ["frame", "time_s", *columns], _StatisticsRow)
    if sidecar.frames < len(rows):
        raise ReferenceFileError(
            sidecar_file,
            None,
            f"frames is {sidecar.frames}, but the table has {len(rows)}",
        )
    return DeformationReference(
        statistics=sidecar.statistics,
        markers=sidecar.markers,
        mean=frame_table(rows, "mean", sidecar.frames),
        sigma=frame_table(rows, "uncertainty", sidecar.frames),
        trial_count=sidecar.trial_count,
        source=sidecar.source,
        note=sidecar.note,
    )
