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
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gauge_envs.errors import GaugeError, ShapeError, UnknownNameError
from gauge_envs.paths import data_folder

__all__ = [
    "ENGINES",
    "Band",
    "BandGrade",
    "Baseline",
    "Law",
    "Reference",
    "ReferenceFileError",
    "SigmaSource",
    "band_grade",
    "bundled_band",
    "carried_band",
    "law_for",
    "load_band",
    "published_baselines",
    "published_variants",
    "read_band",
]

Value = TypeVar("Value")

ENGINES = ("isaacsim", "genesis", "newton")
"""Engines whose scores were published."""

_BASELINE_COLUMNS = ("variant", "frames", "metric", "unit", "baseline_mean", "baseline_std", *ENGINES)
_METRICS = ("rmse", "dtw", "lsd", "mte", "pd", "el")
_BAND_COLUMNS = ("time_s", "measured", "measured_trials")
_LAW_KEYS = ("variants", "kind", "body", "carrier", "condition", "evidence")
_LAW_KINDS = ("carried",)


class ReferenceFileError(GaugeError, ValueError):
    """A data file in `scoring/` is damaged: names the file, the line where there is one, and the reason."""

    def __init__(self, file: Path, line: int | None, reason: str) -> None:
        super().__init__(f"{file}: {reason}" if line is None else f"{file}: line {line}: {reason}")
        self.file = file
        self.line = line
        self.reason = reason


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


@dataclass(frozen=True)
class Baseline:
    """One row of the published results (paper, Table 5): the scatter of real trials, and what three engines scored.

    Attributes:
        variant: Variant id, as in `SlopeSlider-2-wood`.
        metric: `rmse`, `dtw`, `lsd`, `mte`, `pd` or `el`.
        frames: Number of 30 Hz frames that were evaluated.
        unit: Unit of mean and std: `mm`, `rad`, `mm^2`, `s` or `1`. MTE is a ratio here, a percentage in the paper.
        mean: Mean over real trials.
        std: Standard deviation over real trials; None where none was published.
        engines: Published score of `isaacsim`, `genesis` and `newton` over `mean` (el: the raw value, as its mean is
            0); None where none was published.
    """

    variant: str
    metric: str
    frames: int
    unit: str
    mean: float
    std: float | None
    engines: Mapping[str, float | None]


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


@dataclass(frozen=True, eq=False)
class Reference:
    """What an experiment file brings to be scored against.

    Attributes:
        band: Mean and scatter of reality; None where the file has none.
        baselines: Scores of real trials by metric, which scores are divided by.
    """

    band: Band | None
    baselines: Mapping[str, Baseline]


@dataclass(frozen=True)
class Law:
    """A closed form that gives the real outcome of some variants (`scoring/bands/laws.toml`).

    Attributes:
        variants: Shell-style pattern of the variants that it covers.
        kind: `carried`: the body keeps its place on a carrier, whose motion the scene's driver gives.
        body: Name of the body that the law is about.
        carrier: Name of the body that carries it.
        condition: When the law holds, with the numbers that decide it.
        evidence: What in the published results supports it.
    """

    variants: str
    kind: str
    body: str
    carrier: str
    condition: str
    evidence: str


def _with_none(values: NDArray[Any]) -> list[Any]:
    """Nested lists with None for NaN, which JSON does not know; numpy reads None as NaN again."""
    if values.dtype.kind != "f":
        return values.tolist()
    entries = values.astype(object)
    entries[np.isnan(values)] = None
    return entries.tolist()


def published_baselines(variant: str) -> dict[str, Baseline]:
    """Published baselines of a variant by metric; empty where the paper scores none.

    Raises:
        ReferenceFileError: The table is damaged.
    """
    return dict(_all_baselines(_folder("published")).get(variant, {}))


def published_variants() -> tuple[str, ...]:
    """Variants with a published baseline, in the order of the paper's Table 5."""
    return tuple(_all_baselines(_folder("published")))


def load_band(variant: str) -> Band | None:
    """The band of a variant: that of imported trials where there are some, else the bundled one; None without either.

    Raises:
        ReferenceFileError: A file of the band is damaged.
    """
    from gauge_envs.dataset.store import load_imported  # the store holds bands, so it imports this module

    imported = load_imported(variant)
    return _bundled_band(_folder("bands"), variant) if imported is None else imported.band


def bundled_band(variant: str) -> Band | None:
    """The band of a variant that comes with the package, whatever was imported; None where there is none.

    Raises:
        ReferenceFileError: A file of the band is damaged.
    """
    return _bundled_band(_folder("bands"), variant)


def law_for(variant: str) -> Law | None:
    """The law that gives the real outcome of a variant; None where none is known.

    Raises:
        ReferenceFileError: The table of laws is damaged.
    """
    return next((law for law in _all_laws(_folder("bands")) if fnmatchcase(variant, law.variants)), None)


def band_grade(variant: str) -> BandGrade:
    """The grade of what a variant is scored on; a band that is withheld does not count."""
    band = load_band(variant)
    if band is not None and band.withheld is None:
        return band.grade
    return BandGrade.NONE if law_for(variant) is None else BandGrade.LAW


def carried_band(*, variant: str, positions_mm: ArrayLike) -> Band:
    """Band of a body that a law says is rigidly carried: the caller's mean, sigma from the published baseline.

    Sigma is constant in time. The mean over trials of the squared E_RMSE is the time-averaged variance of the vector
    deviation, hence sigma_rms^2 = mean^2 + std^2 of the published E_RMSE. That is exact where all three divide by the
    number of trials n; where std and sigma divide by n - 1, sigma_rms^2 is larger by mean^2 / (n - 1), which is left
    out, as n is not published (sigma then is at most 2.6 % too small for n = 20). How the variance splits over x, y
    and z is not published either: it is taken as equal, sigma_rms / sqrt(3) each.

    Args:
        variant: A variant for which `law_for` gives a law of kind `carried`.
        positions_mm: Position of the carried body as the law and the scene's driver give it, in mm, shape
            [published frame count, 3].

    Returns:
        Band of grade `law` over x, y and z in mm; every frame counts as measured, as the law states every frame.

    Raises:
        UnknownNameError: No law says that the body is carried in this variant.
        ShapeError: `positions_mm` is not of the published length and width 3, or not finite.
    """
    law, baseline = law_for(variant), published_baselines(variant).get("rmse")
    if law is None or baseline is None:
        raise UnknownNameError("carried variant", variant, filter(law_for, published_variants()))
    positions = np.asarray(positions_mm, dtype=np.float64)
    if positions.shape != (baseline.frames, 3):
        raise ShapeError(f"positions_mm has shape {positions.shape}; {(baseline.frames, 3)} is needed for {variant}")
    if not np.isfinite(positions).all():
        raise ShapeError("positions_mm holds a value that is not finite")
    sigma_rms = math.hypot(baseline.mean, baseline.std or 0.0)
    return Band(
        grade=BandGrade.LAW,
        sigma_source=SigmaSource.BASELINE,
        unit=baseline.unit,
        coordinates=("x", "y", "z"),
        projection=np.eye(3),
        mean=positions,
        sigma=np.full(positions.shape, sigma_rms / math.sqrt(3)),
        measured=np.ones(len(positions), dtype=bool),
        trial_count=None,
        source=f"{law.body} carried by {law.carrier}, {law.condition}; sigma from the paper's Table 5",
    )


def _folder(name: str) -> Path:
    return data_folder("scoring") / name


@cache
def _all_baselines(folder: Path) -> dict[str, dict[str, Baseline]]:
    file = folder / "engine_results.csv"
    table: dict[str, dict[str, Baseline]] = {}
    for line, row in _rows(file, _BASELINE_COLUMNS):
        variant, metric, unit = row["variant"], row["metric"], row["unit"]
        if metric not in _METRICS:
            raise ReferenceFileError(file, line, f"metric {metric!r} is none of {', '.join(_METRICS)}")
        if metric in table.setdefault(variant, {}):
            raise ReferenceFileError(file, line, f"{variant} has a second row for {metric}")
        number = {name: _number(file, line, name, row[name]) for name in _BASELINE_COLUMNS[4:] if row[name]}
        if "baseline_mean" not in number:
            raise ReferenceFileError(file, line, "baseline_mean is empty")
        mean, std = number["baseline_mean"], number.get("baseline_std")
        if unit == "percent":
            mean, std, unit = mean / 100, None if std is None else std / 100, "1"
        table[variant][metric] = Baseline(
            variant=variant,
            metric=metric,
            frames=_count(file, line, "frames", row["frames"]),
            unit=unit,
            mean=mean,
            std=std,
            engines={engine: number.get(engine) for engine in ENGINES},
        )
    return table


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


@cache
def _all_laws(folder: Path) -> tuple[Law, ...]:
    file = folder / "laws.toml"
    laws = []
    for table in _field(file, _toml(file), "law", list):
        if not isinstance(table, dict) or set(table) != set(_LAW_KEYS):
            raise ReferenceFileError(file, None, f"law {table!r}: expected a table of {', '.join(_LAW_KEYS)}")
        law = Law(**{key: _field(file, table, key, str) for key in _LAW_KEYS})
        if law.kind not in _LAW_KINDS:
            raise ReferenceFileError(file, None, f"kind {law.kind!r} is none of {', '.join(_LAW_KINDS)}")
        laws.append(law)
    return tuple(laws)


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
