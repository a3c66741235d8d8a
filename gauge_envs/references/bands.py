"""Bands: mean and scatter of reality per frame, which trajectories are scored against.

The bundled bands are data in `scoring/bands`. `scoring/README.md` defines every quantity and names its sources. A
variant is named `<Family>[-<subtask>]-<material>`, as in `SlopeSlider-2-wood`; an unknown name has no band.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, NonNegativeInt, PositiveInt, model_validator

from gauge_envs.errors import ReferenceFileError, ShapeError
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.tables import (
    FileModel,
    FrameRow,
    csv_header,
    faults_of,
    frame_table,
    header_fault,
    read_frames,
    read_toml,
    scoring_folder,
)
from gauge_envs.scene.geometry import BoolArray, FloatArray, NonNegative, Positive
from gauge_envs.scene.timing import MOST_FRAMES

MOST_COORDINATES = 10_000
"""Largest width of g(t) that a file can state."""

QUANTITIES = ("mean", "sigma", "uncertainty")
"""Quantities that the table of a band has for each coordinate; all but the mean may be absent."""


class SigmaSource(StrEnum):
    """Origin of the sigma of a band."""

    TRIALS = "trials"
    """Standard deviation over real trials, per frame."""
    BASELINE = "baseline"
    """Published baseline, which gives a time average alone: sigma is constant and the same for each coordinate."""
    MEASUREMENT = "measurement"
    """Uncertainty of the measurement, as no scatter of real trials is published."""
    MODEL = "model"
    """Uncertainty of that solution, as no scatter of real trials is published."""


@dataclass(frozen=True, eq=False)
class Band:
    """Mean and scatter of reality per frame, in coordinates that are a linear map of the generalized trajectory.

    All arrays are read-only copies.

    Attributes:
        grade: Origin of the mean.
        unit: Unit of mean, sigma and of the trajectories that `project` takes.
        coordinates: Names of the C band coordinates.
        projection: Linear map from g(t) of width D to the band coordinates, shape [C, D]. It picks the directions that
            were measured.
        mean: Mean of the real trajectories at frames 0, 1, ..., shape [T, C]; NaN is unknown.
        sigma: Standard deviation over real trials, shape [T, C].
        measured: Whether a frame was measured, shape [T]. Grade `trials` needs samples of at least half of the trials,
            grade `recording` a picture; a law states every frame. Frames that were not measured are extrapolated. RMSE
            and DTW include them, as the published baselines do; |z| and coverage leave them out.
        trial_count: Number of real trials; None is unknown.
        source: Where the numbers are from, one sentence.
        sigma_source: Origin of sigma.
        uncertainty: 1-sigma uncertainty of the measurement of the mean, shape [T, C]; NaN where the mean is unknown,
            None if it is not stated. It is the error of one measured trial; sigma is the spread between trials.
        withheld: Why the band is not used by default; None for a band that is.
        trials: Band coordinates of each real trial, shape [trial_count, T, C]; NaN is unknown. None if only their mean
            and scatter are known.
        normalized_by_baseline: Whether distances to the band are divided by the published baseline. False for a band
            of another span than the baseline.
        points: Positions of the markers at the same frames, from which rewards are, of a band in other coordinates;
            else None.
        is_exact: Whether the mean is a closed form that solves the stated scene exactly. `uncertainty` then says how
            far reality, and not an engine, may be from it.
    """

    grade: BandGrade
    unit: str
    coordinates: tuple[str, ...]
    projection: FloatArray
    mean: FloatArray
    sigma: FloatArray
    measured: BoolArray
    trial_count: int | None
    source: str
    sigma_source: SigmaSource = SigmaSource.TRIALS
    uncertainty: FloatArray | None = None
    withheld: str | None = None
    trials: FloatArray | None = None
    normalized_by_baseline: bool = True
    points: Band | None = None
    is_exact: bool = False

    def __post_init__(self) -> None:
        for name in (
            "projection",
            "mean",
            "sigma",
            "measured",
            "uncertainty",
            "trials",
        ):
            if getattr(self, name) is not None:
                values = np.array(
                    getattr(self, name), dtype=bool if name == "measured" else float
                )
                values.setflags(write=False)
                object.__setattr__(self, name, values)
        count = len(self.coordinates)
        if self.projection.ndim != 2 or len(self.projection) != count:
            raise ShapeError(
                f"projection has shape {self.projection.shape}; [{count}, width of g(t)] is needed"
            )
        if (
            self.mean.ndim != 2
            or self.mean.shape[1] != count
            or self.sigma.shape != self.mean.shape
        ):
            raise ShapeError(
                f"mean has shape {self.mean.shape}, sigma {self.sigma.shape}; both must be [frame_count, {count}]"
            )
        if self.measured.shape != self.mean.shape[:1]:
            raise ShapeError(
                f"measured has shape {self.measured.shape}; {self.mean.shape[:1]} is needed"
            )
        if self.uncertainty is not None and self.uncertainty.shape != self.mean.shape:
            raise ShapeError(
                f"uncertainty has shape {self.uncertainty.shape}; {self.mean.shape} is needed"
            )
        if self.trials is not None and (
            self.trials.ndim != 3 or self.trials.shape[1:] != self.mean.shape
        ):
            raise ShapeError(
                f"trials has shape {self.trials.shape}; [trial_count, {self.mean.shape}] is needed"
            )
        if (self.sigma < 0).any():
            raise ShapeError("sigma: a standard deviation is never negative")

    def of_trial(self, trial: int) -> Band:
        """Return the band of one of its trials, with the uncertainty of measuring it."""
        assert self.trials is not None and self.uncertainty is not None, (
            "a band of trials, each of them measured"
        )
        return replace(
            self,
            mean=self.trials[trial],
            sigma=np.nan_to_num(self.uncertainty),
            trial_count=1,
            source=f"trial {trial} of {self.source}",
            sigma_source=SigmaSource.MEASUREMENT,
            trials=None,
            normalized_by_baseline=False,
        )

    def project(self, g: ArrayLike) -> FloatArray:
        """Map a generalized trajectory to the band's coordinates.

        Args:
            g: Generalized trajectory in the band's unit, shape [frame_count, D]; any number of frames.

        Returns:
            Band coordinates in the same unit, shape [frame_count, C].
        """
        trajectory = np.asarray(g, dtype=np.float64)
        if trajectory.ndim != 2 or trajectory.shape[1] != self.projection.shape[1]:
            raise ShapeError(
                f"trajectory has shape {trajectory.shape}; [frame_count, {self.projection.shape[1]}] is needed"
            )
        return trajectory @ self.projection.T

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary; an unknown number is None."""
        values = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name != "points"
        }
        arrays = {
            name: _with_none(value)
            for name, value in values.items()
            if isinstance(value, np.ndarray)
        }
        return values | arrays | {"coordinates": list(self.coordinates)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Band:
        """Build a band from `to_dict`."""
        try:
            return cls(
                **{
                    **values,
                    "grade": BandGrade(values["grade"]),
                    "sigma_source": SigmaSource(values["sigma_source"]),
                    "coordinates": tuple(values["coordinates"]),
                }
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a band: {error}") from error


def _with_none(values: NDArray[Any]) -> list[Any]:
    """Return nested lists with None for NaN, which JSON lacks; numpy reads None as NaN."""
    if values.dtype.kind != "f":
        return values.tolist()
    entries = values.astype(object)
    entries[np.isnan(values)] = None
    return entries.tolist()


class BandSpec(FileModel):
    """Statements about the table of a band: a sidecar, or the `band` table of an experiment file.

    Attributes:
        grade: As in `Band`.
        sigma_source: As in `Band`.
        coordinates: Names of the C band coordinates, as in the columns of the table.
        projection: Linear map from g(t) of width D to the band coordinates, shape [C, D].
        indices: Indices of the coordinates of g(t), in place of `projection`.
        width: Width D of g(t), given with `indices`.
        sigma: Standard deviation of each coordinate at every frame, for a table without columns of it.
        trial_count: Number of real trials; grade `trials` needs it.
        source: Where the numbers are from, one sentence.
    """

    grade: Literal["trials", "recording", "law"]
    sigma_source: Literal["trials", "baseline", "measurement"]
    coordinates: Annotated[tuple[str, ...], Field(min_length=1)]
    projection: tuple[tuple[float, ...], ...] | None = None
    indices: tuple[int, ...] | None = None
    width: Annotated[int, Field(ge=1, le=MOST_COORDINATES)] | None = None
    sigma: Positive | None = None
    trial_count: PositiveInt | None = None
    source: str

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.grade == "trials" and self.trial_count is None:
            raise ValueError("grade 'trials' needs trial_count")
        if self.projection is not None and self.indices is not None:
            raise ValueError("projection and indices exclude each other")
        if (self.indices is None) != (self.width is None):
            raise ValueError("indices and width go together")
        if (
            self.indices is not None
            and self.width is not None
            and not set(self.indices) <= set(range(self.width))
        ):
            raise ValueError(
                f"indices is {list(self.indices)}, expected whole numbers from 0 to {self.width - 1}"
            )
        return self

    @property
    def projection_matrix(self) -> FloatArray:
        """Linear map from g(t) to the band coordinates, shape [C, D]; identity if the table states none."""
        if self.projection is not None:
            return np.array(self.projection, dtype=np.float64)
        if self.indices is not None and self.width is not None:
            matrix = np.zeros((len(self.indices), self.width))
            matrix[np.arange(len(self.indices)), list(self.indices)] = 1.0
            return matrix
        return np.eye(len(self.coordinates))


class TrialScores(FileModel):
    """Score of real trials among themselves.

    Attributes:
        mean: Mean over trials, in the unit of the metric.
        std: Standard deviation over trials, in the unit of the metric.
    """

    mean: float
    std: float | None = None


class BandSidecar(BandSpec):
    """The file `<variant>.toml` beside the table `<variant>.csv` of a band.

    Attributes:
        unit: Unit of the table.
        frames: Number of frames of the band; later ones than the table's are unknown. None is the table's number.
        withheld: As in `Band`.
        normalized_by_baseline: As in `Band`.
        rmse: E_RMSE of each trial to the mean.
        dtw: E_DTW of each trial to the mean.
        recording: Facts about the recording that the band was measured from.
    """

    unit: str
    frames: Annotated[int, Field(ge=1, le=MOST_FRAMES)] | None = None
    withheld: str | None = None
    normalized_by_baseline: bool = True
    rmse: TrialScores | None = None
    dtw: TrialScores | None = None
    recording: dict[str, Any] | None = None


def bundled_band(variant: str) -> Band | None:
    """Return the band of a variant that comes with the package; None without one. Imports play no part."""
    return _bundled_band(scoring_folder("bands"), variant)


@cache
def _bundled_band(folder: Path, variant: str) -> Band | None:
    file, sidecar_file = folder / f"{variant}.csv", folder / f"{variant}.toml"
    if not file.is_file():
        return None
    sidecar = read_toml(sidecar_file, BandSidecar)
    band = read_band(file, sidecar, sidecar_file)
    trials_file = folder.parent / "trials" / f"{variant}.csv"
    if not trials_file.is_file():
        return band
    with faults_of(trials_file):
        columns = [
            f"trial.{n + 1}.{name}"
            for n in range(sidecar.trial_count or 0)
            for name in sidecar.coordinates
        ]
        values = frame_table(
            read_frames(trials_file, ["frame", *columns], _TrialsRow), "trial"
        )
        return replace(
            band,
            trials=values.reshape(len(values), -1, len(sidecar.coordinates)).transpose(
                1, 0, 2
            ),
        )


class _TrialsRow(FrameRow):
    """One row of the table of single trials; values are keyed `<trial>.<coordinate>`."""

    trial: dict[str, float | None]


def bundled_sidecar(variant: str) -> BandSidecar | None:
    """Return what the package states about the band of a variant; None without a band."""
    file = scoring_folder("bands") / f"{variant}.toml"
    return read_toml(file, BandSidecar) if file.is_file() else None


def read_band(file: Path, sidecar: BandSidecar, sidecar_file: Path) -> Band:
    """Read the table of a band (format: scoring/README.md).

    Args:
        file: The table, with a row for each frame: `frame`, `mean.*`, and optionally `time_s`, `measured`,
            `measured_trials`, `sigma.*`, `uncertainty.*`.
        sidecar: Statements about the table.
        sidecar_file: File that makes them, for messages.
    """
    columns = _band_columns(file, sidecar.coordinates)
    rows = read_frames(file, columns, _BandRow)
    if not rows:
        raise ReferenceFileError(
            file, None, "it has no rows: a row for each frame is expected"
        )
    frames = len(rows) if sidecar.frames is None else sidecar.frames
    if frames < len(rows):
        raise ReferenceFileError(
            sidecar_file, None, f"frames is {frames}, but the table has {len(rows)}"
        )
    values = {
        quantity: frame_table(rows, quantity, frames)
        for quantity in QUANTITIES
        if f"{quantity}.{sidecar.coordinates[0]}" in columns
    }
    measured = np.zeros(frames, dtype=bool)
    # A table without the column has measured every frame that has a mean.
    measured[: len(rows)] = (
        [row.measured == "1" for row in rows]
        if "measured" in columns
        else ~np.isnan(values["mean"][: len(rows)]).all(axis=1)
    )
    sigma = (
        values["sigma"]
        if "sigma" in values
        else _stated_sigma(sidecar, sidecar_file, values)
    )
    with faults_of(sidecar_file):
        return Band(
            grade=BandGrade(sidecar.grade),
            unit=sidecar.unit,
            coordinates=sidecar.coordinates,
            projection=sidecar.projection_matrix,
            mean=values["mean"],
            sigma=sigma,
            measured=measured,
            trial_count=sidecar.trial_count if sidecar.grade == "trials" else None,
            source=sidecar.source,
            sigma_source=SigmaSource(sidecar.sigma_source),
            uncertainty=values.get("uncertainty"),
            withheld=sidecar.withheld,
            normalized_by_baseline=sidecar.normalized_by_baseline,
        )


def _stated_sigma(
    sidecar: BandSidecar, file: Path, values: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the sigma of a table without a column of it: the uncertainty, or one number of the sidecar."""
    if sidecar.sigma_source != "measurement":
        if sidecar.sigma is None:
            raise ReferenceFileError(
                file, None, "sigma is missing here, and the table has no column of it"
            )
        return np.full(values["mean"].shape, sidecar.sigma)
    if "uncertainty" not in values:
        raise ReferenceFileError(
            file,
            None,
            "sigma_source is 'measurement', but the table has no uncertainty",
        )
    return values["uncertainty"]


class _BandRow(FrameRow):
    """One row of the table of a band; values are keyed by coordinate, and None is unknown."""

    time_s: float | None = None
    measured: Literal["0", "1"] = "1"
    measured_trials: NonNegativeInt | None = None
    mean: dict[str, float | None]
    sigma: dict[str, NonNegative] = Field(default_factory=dict)
    uncertainty: dict[str, NonNegative | None] = Field(default_factory=dict)


def _band_columns(file: Path, coordinates: Sequence[str]) -> list[str]:
    """Return the columns that the table must have, from the quantities in its header."""
    header = csv_header(file)
    quantities = [
        q for q in QUANTITIES if any(name.startswith(f"{q}.") for name in header)
    ]
    if "mean" not in quantities:
        raise ReferenceFileError(
            file,
            1,
            f"{header_fault(header, ['frame'])}, expected mean.{coordinates[0]} among them",
        )
    optional = [
        name for name in ("time_s", "measured", "measured_trials") if name in header
    ]
    return [
        "frame",
        *optional,
        *(f"{q}.{coordinate}" for q in quantities for coordinate in coordinates),
    ]
