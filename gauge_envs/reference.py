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
from dataclasses import dataclass
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
    "Band",
    "BandGrade",
    "Baseline",
    "Law",
    "ReferenceFileError",
    "band_grade",
    "carried_band",
    "law_for",
    "load_band",
    "published_baselines",
    "published_variants",
]

Value = TypeVar("Value")

_ENGINES = ("isaacsim", "genesis", "newton")
_BASELINE_COLUMNS = ("variant", "frames", "metric", "unit", "baseline_mean", "baseline_std", *_ENGINES)
_METRICS = ("rmse", "dtw", "lsd", "mte", "pd", "el")
_BAND_COLUMNS = ("frame", "time_s", "mean", "sigma", "measured", "measured_trials")
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
    """Mean from the published recording of one trial, sigma from the published baseline."""
    LAW = "law"
    """Mean from a closed form that holds under a stated condition, sigma from the published baseline."""
    NONE = "none"
    """No real reference: no score."""


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

    def __post_init__(self) -> None:
        for name, dtype in (("projection", float), ("mean", float), ("sigma", float), ("measured", bool)):
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
    """The bundled band of a variant, built by `scripts/build_bands.py`; None where there is none.

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
    """The best grade of band that a variant can be scored on without an imported dataset."""
    band = load_band(variant)
    if band is not None:
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
            engines={engine: number.get(engine) for engine in _ENGINES},
        )
    return table


@cache
def _bundled_band(folder: Path, variant: str) -> Band | None:
    file, facts_file = folder / f"{variant}.csv", folder / f"{variant}.toml"
    if not file.is_file():
        return None
    facts = _toml(facts_file)
    columns: dict[str, list[float]] = {name: [] for name in _BAND_COLUMNS}
    for line, row in _rows(file, _BAND_COLUMNS):
        if _count(file, line, "frame", row["frame"]) != len(columns["frame"]):
            raise ReferenceFileError(file, line, f"frame {row['frame']} where {len(columns['frame'])} is next")
        if row["measured"] not in ("0", "1"):
            raise ReferenceFileError(file, line, f"measured is {row['measured']!r}, neither 0 nor 1")
        if _number(file, line, "sigma", row["sigma"]) < 0:
            raise ReferenceFileError(file, line, f"sigma is {row['sigma']}, a standard deviation is never negative")
        for name, values in columns.items():
            values.append(_number(file, line, name, row[name]))
    grade = _field(facts_file, facts, "grade", str)
    if grade not in tuple(BandGrade):
        raise ReferenceFileError(facts_file, None, f"grade {grade!r} is none of {', '.join(BandGrade)}")
    try:
        return Band(
            grade=BandGrade(grade),
            unit=_field(facts_file, facts, "unit", str),
            coordinates=(_field(facts_file, facts, "coordinate", str),),
            projection=np.array([_field(facts_file, facts, "projection", list)]),
            mean=np.array(columns["mean"])[:, np.newaxis],
            sigma=np.array(columns["sigma"])[:, np.newaxis],
            measured=np.array(columns["measured"]),
            trial_count=_field(facts_file, facts, "trial_count", int),
            source=_field(facts_file, facts, "source", str),
        )
    except ValueError as error:
        raise ReferenceFileError(facts_file, None, str(error)) from None


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


def _field(file: Path, table: Mapping[str, Any], key: str, kind: type[Value]) -> Value:
    value = table.get(key)
    if not isinstance(value, kind):
        raise ReferenceFileError(file, None, f"{key} is {value!r}, expected a {kind.__name__}")
    return value
