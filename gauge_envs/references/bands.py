"""What a variant is scored against: published baselines, bands of real trials, and laws that stand in for them.

All of it is data in `scoring/`; its README defines every quantity and says where each number is from. A variant is
named `<Family>[-<subtask>]-<material>`, as in `SlopeSlider-2-wood`. Whether such a variant exists is the task files'
business: a name that nothing was published for simply has no baselines, no band and no law.
"""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gauge_envs.errors import ReferenceFileError, ShapeError
from gauge_envs.files import data_folder

__all__ = [
    "Band",
    "BandGrade",
    "SigmaSource",
    "bundled_band",
    "read_band",
]

Value = TypeVar("Value")


_BAND_COLUMNS = ("time_s", "measured", "measured_trials")


class BandGrade(StrEnum):
    """How good the real reference of a variant is, best first."""

    TRIALS = "trials"
    """Mean and sigma per frame over real trials."""
    RECORDING = "recording"
    """Mean from the published recording of one trial, sigma from the published baseline where there is one."""
    LAW = "law"
    """Mean from a closed form that holds under a stated condition, sigma from the published baseline."""
    NONE = "none"
    """No real reference: no score."""


class SigmaSource(StrEnum):
    """What the sigma of a band is."""

    TRIALS = "trials"
    """Standard deviation over real trials, per frame."""
    BASELINE = "baseline"
    """From the published baseline, which gives its time average alone: constant, the same for each coordinate."""
    MEASUREMENT = "measurement"
    """Uncertainty of the measurement, where no scatter of real trials is published: it is not scatter of reality."""


@dataclass(frozen=True, eq=False)
class Band:
    """Mean and scatter of reality per frame, in coordinates that a linear map takes from a generalized trajectory.

    All arrays are read-only copies.

    Attributes:
        grade: Where mean and sigma are from.
        unit: Unit of mean, sigma and of the trajectories that `project` takes.
        coordinates: Names of the C band coordinates.
        projection: Linear map from g(t) of width D to the band coordinates, shape [C, D]. It is needed where only some
            directions were measured.
        mean: Mean of the real trajectories at frames 0, 1, ..., shape [T, C]; NaN where it is unknown.
        sigma: Standard deviation over real trials, shape [T, C].
        measured: Frames where mean and sigma rest on what the grade names, shape [T]: samples of at least half of the
            trials (trials), a picture (recording), the law, which states every frame (law). The others are
            extrapolated: the published baselines cover them, |z| and coverage should not.
        trial_count: Number of real trials; None where it is not known.
        source: Where the numbers are from, one sentence.
        sigma_source: What sigma is.
        uncertainty: 1-sigma uncertainty of the measurement of the mean, shape [T, C]; NaN where the mean is. None where
            it is not stated. It says how well one trial was measured, sigma how far trials are apart.
        withheld: Why nothing is scored on the band unless it is asked for; None where it is scored on.

    Raises:
        ShapeError: The arrays do not agree in shape, or a sigma is negative.
    """

    grade: BandGrade
    unit: str
    coordinates: tuple[str, ...]
    projection: NDArray[np.float64]
    mean: NDArray[np.float64]
    sigma: NDArray[np.float64]
    measured: NDArray[np.bool_]
    trial_count: int | None
    source: str
    sigma_source: SigmaSource = SigmaSource.TRIALS
    uncertainty: NDArray[np.float64] | None = None
    withheld: str | None = None

    def __post_init__(self) -> None:
        arrays = {"projection": float, "mean": float, "sigma": float, "measured": bool, "uncertainty": float}
        for name, dtype in arrays.items():
            if getattr(self, name) is None:
                continue
            values = np.array(getattr(self, name), dtype=dtype)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        count = len(self.coordinates)
        if self.projection.ndim != 2 or len(self.projection) != count:
            raise ShapeError(f"projection has shape {self.projection.shape}; [{count}, width of g(t)] is needed")
        if self.mean.ndim != 2 or self.mean.shape[1] != count or self.sigma.shape != self.mean.shape:
            raise ShapeError(
                f"mean has shape {self.mean.shape}, sigma {self.sigma.shape}; both must be [frame_count, {count}]"
            )
        if self.measured.shape != self.mean.shape[:1]:
            raise ShapeError(f"measured has shape {self.measured.shape}; {self.mean.shape[:1]} is needed")
        if self.uncertainty is not None and self.uncertainty.shape != self.mean.shape:
            raise ShapeError(f"uncertainty has shape {self.uncertainty.shape}; {self.mean.shape} is needed")
        if (self.sigma < 0).any():
            raise ShapeError("sigma: a standard deviation is never negative")

    def project(self, g: ArrayLike) -> NDArray[np.float64]:
        """A generalized trajectory in the band's coordinates.

        Args:
            g: Generalized trajectory in the band's unit, shape [frame_count, D]; any number of frames.

        Returns:
            Band coordinates in the same unit, shape [frame_count, C].

        Raises:
            ShapeError: `g` is not of width D.
        """
        trajectory = np.asarray(g, dtype=np.float64)
        if trajectory.ndim != 2 or trajectory.shape[1] != self.projection.shape[1]:
            raise ShapeError(
                f"trajectory has shape {trajectory.shape}; [frame_count, {self.projection.shape[1]}] is needed"
            )
        return trajectory @ self.projection.T

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary; None stands for what is not known."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays = {name: _with_none(value) for name, value in values.items() if isinstance(value, np.ndarray)}
        return values | arrays | {"coordinates": list(self.coordinates)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Band:
        """Inverse of `to_dict`.

        Raises:
            ShapeError: The arrays do not agree.
            ValueError: A value is of the wrong kind, or one is missing.
        """
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
    """Nested lists with None for NaN, which JSON does not know; numpy reads None as NaN again."""
    if values.dtype.kind != "f":
        return values.tolist()
    entries = values.astype(object)
    entries[np.isnan(values)] = None
    return entries.tolist()


def bundled_band(variant: str) -> Band | None:
    """The band of a variant that comes with the package, whatever was imported; None where there is none.

    Raises:
        ReferenceFileError: A file of the band is damaged.
    """
    return _bundled_band(_folder("bands"), variant)


def _folder(name: str) -> Path:
    return data_folder("scoring") / name


@cache
def _bundled_band(folder: Path, variant: str) -> Band | None:
    """The band that a table `<variant>.csv` and its sidecar `<variant>.toml` describe."""
    file, facts_file = folder / f"{variant}.csv", folder / f"{variant}.toml"
    return read_band(file, _toml(facts_file), facts_file) if file.is_file() else None


def read_band(file: Path, facts: Mapping[str, Any], facts_file: Path) -> Band:
    """The band of a table of numbers and what is stated of them (format: scoring/README.md).

    Args:
        file: The table, a row a frame: `frame`, `mean.*`, and where they are known `time_s`, `measured`,
            `measured_trials`, `sigma.*`, `uncertainty.*`.
        facts: `grade`, `sigma_source`, `unit`, `coordinates`, `projection` or `indices` and `width`, `source`, and
            where they apply `trial_count`, `sigma`, `frames`, `withheld`.
        facts_file: File that states them, for messages.

    Raises:
        ReferenceFileError: One of the files is missing, or wrong.
    """
    if not file.is_file():
        raise ReferenceFileError(file, None, "the file is missing")
    coordinates = _field(facts_file, facts, "coordinates", list)
    columns = _band_columns(file, coordinates)
    frames = _optional_field(facts_file, facts, "frames", int) or len(columns["measured"])
    missing = frames - len(columns["measured"])
    if missing < 0:
        raise ReferenceFileError(facts_file, None, f"frames is {frames}, but the table has {frames - missing}")
    padded = {name: np.pad(values, ((0, missing), (0, 0)), constant_values=np.nan) for name, values in columns.items()}
    grade = BandGrade(_choice(facts_file, facts, "grade", BandGrade))
    sigma_source = SigmaSource(_choice(facts_file, facts, "sigma_source", SigmaSource))
    try:
        return Band(
            grade=grade,
            unit=_field(facts_file, facts, "unit", str),
            coordinates=tuple(coordinates),
            projection=_projection(facts_file, facts),
            mean=padded["mean"],
            sigma=_sigma(facts_file, facts, sigma_source, padded),
            measured=padded["measured"][:, 0] == 1,
            trial_count=_field(facts_file, facts, "trial_count", int) if grade is BandGrade.TRIALS else None,
            source=_field(facts_file, facts, "source", str),
            sigma_source=sigma_source,
            uncertainty=padded.get("uncertainty"),
            withheld=_optional_field(facts_file, facts, "withheld", str),
        )
    except ReferenceFileError:
        raise
    except ValueError as error:
        raise ReferenceFileError(facts_file, None, str(error)) from None


def _choice(file: Path, facts: Mapping[str, Any], key: str, known: type[StrEnum]) -> str:
    value = _field(file, facts, key, str)
    if value not in tuple(known):
        raise ReferenceFileError(file, None, f"{key} {value!r} is none of {', '.join(known)}")
    return value


def _sigma(
    file: Path, facts: Mapping[str, Any], source: SigmaSource, columns: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Sigma per frame and coordinate: columns of the table, the uncertainty, or one number of the sidecar."""
    if "sigma" in columns:
        return columns["sigma"]
    if source is not SigmaSource.MEASUREMENT:
        return np.full(columns["mean"].shape, _field(file, facts, "sigma", float))
    if "uncertainty" not in columns:
        raise ReferenceFileError(file, None, "sigma_source is 'measurement', but the table has no uncertainty")
    return columns["uncertainty"]


def _band_columns(file: Path, coordinates: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Columns of a band's table: `measured`, shape [T, 1], and `mean`, `sigma`, `uncertainty`, each of shape [T, C].

    A field of `mean` or `uncertainty` may be empty, which is NaN: not known. A quantity without columns is left out,
    and without a column `measured` a frame is measured where it has a mean.
    """
    with file.open(encoding="utf-8", newline="") as stream:
        header = next(csv.reader(stream), [])
    quantities = [q for q in ("mean", "sigma", "uncertainty") if any(name.startswith(f"{q}.") for name in header)]
    named = {q: [f"{q}.{coordinate}" for coordinate in coordinates] for q in quantities}
    known = [name for name in _BAND_COLUMNS if name in header]
    expected = ["frame", *known, *(name for names in named.values() for name in names)]
    if "mean" not in named:
        raise ReferenceFileError(file, 1, f"columns are {','.join(header)}, expected mean.{coordinates[0]} among them")
    rows: dict[str, list[Any]] = {"measured": [], **{q: [] for q in quantities}}
    for line, row in _rows(file, expected):
        if _count(file, line, "frame", row["frame"]) != len(rows["measured"]):
            raise ReferenceFileError(file, line, f"frame {row['frame']} where {len(rows['measured'])} is next")
        measured = row.get("measured", "1" if any(row[name] for name in named["mean"]) else "0")
        if measured not in ("0", "1"):
            raise ReferenceFileError(file, line, f"measured is {measured!r}, neither 0 nor 1")
        rows["measured"].append([float(measured)])
        for quantity, names in named.items():
            optional = quantity != "sigma"
            values = [
                math.nan if optional and not row[name] else _number(file, line, name, row[name]) for name in names
            ]
            negative = [name for name, value in zip(names, values, strict=True) if value < 0]
            if negative and quantity != "mean":
                raise ReferenceFileError(
                    file, line, f"{negative[0]} is {row[negative[0]]}, a standard deviation is never negative"
                )
            rows[quantity].append(values)
    return {name: np.array(values) for name, values in rows.items()}


def _projection(file: Path, facts: Mapping[str, Any]) -> NDArray[np.float64]:
    """Linear map from g(t) to the band's coordinates: `projection`, its rows; or `indices` of g(t) and its `width`."""
    if "indices" not in facts:
        return np.array(_field(file, facts, "projection", list), dtype=np.float64)
    width, indices = _field(file, facts, "width", int), _field(file, facts, "indices", list)
    if any(not isinstance(index, int) or not 0 <= index < width for index in indices):
        raise ReferenceFileError(file, None, f"indices is {indices!r}, expected whole numbers from 0 to {width - 1}")
    return np.eye(width)[indices]


def _rows(file: Path, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and fields of each row of a CSV file that must have exactly these columns."""
    with file.open(encoding="utf-8", newline="") as stream:
        reader = csv.reader(stream)
        header = next(reader, [])
        if header != list(columns):
            raise ReferenceFileError(file, 1, f"columns are {','.join(header)}, expected {','.join(columns)}")
        for fields in reader:
            if len(fields) != len(columns):
                raise ReferenceFileError(file, reader.line_num, f"{len(fields)} fields, expected {len(columns)}")
            yield reader.line_num, dict(zip(columns, fields, strict=True))


def _number(file: Path, line: int, column: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        raise ReferenceFileError(file, line, f"{column} is {text!r}, not a number") from None
    if not math.isfinite(number):
        raise ReferenceFileError(file, line, f"{column} is {text!r}, not finite")
    return number


def _count(file: Path, line: int, column: str, text: str) -> int:
    if not text.isdecimal():
        raise ReferenceFileError(file, line, f"{column} is {text!r}, not a whole number")
    return int(text)


def _toml(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise ReferenceFileError(file, None, "the file is missing")
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ReferenceFileError(file, None, str(error)) from None


def _optional_field(file: Path, table: Mapping[str, Any], key: str, kind: type[Value]) -> Value | None:
    return _field(file, table, key, kind) if key in table else None


def _field(file: Path, table: Mapping[str, Any], key: str, kind: type[Value]) -> Value:
    value = table.get(key)
    if not isinstance(value, kind):
        raise ReferenceFileError(file, None, f"{key} is {value!r}, expected a {kind.__name__}")
    return value
