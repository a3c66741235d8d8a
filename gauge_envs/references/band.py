"""Bands: the reference motion of each experiment, with its scatter and its uncertainty.

`scoring/bands/<id>.toml` describes a reference, and `<id>.npz` has its arrays; `scoring/README.md` explains both.
A user's task file may have the pair `<id>.band.toml` and `<id>.band.npz` next to it. `gauge data import` writes one
file `<id>.npz` in the folder of the user, with the description in the array `ABOUT`. An archive has a checksum of each
array.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, lru_cache
from pathlib import Path
from textwrap import shorten
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from gauge_envs.errors import ReferenceFileError, ShapeError
from gauge_envs.files import npz_arrays
from gauge_envs.reading import reading
from gauge_envs.references.kind import Kind
from gauge_envs.references.tables import FileModel, scoring_folder
from gauge_envs.references.user_data import (
    DataSource,
    imported_file,
    own_band_file,
)
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.text import json_document, toml_document

MARKER_SIGMA_MM = 1.0
"""Smallest scale of a marker's distance in a reward [mm]; chosen, because no scatter of markers is published."""

MAX_TEXT = 80
"""Longest list of coordinates, and longest source, in the text of a band."""

AXES = {
    "projection": "CD",
    "mean": "TC",
    "sigma": "TC",
    "uncertainty": "TC",
    "measured": "T",
    "trials": "NTC",
    "trial_rmse": "N",
    "trial_rmse_aligned": "N",
    "baselines_without": "N",
}
"""Axes of the arrays of a band: frames T, coordinates C, coordinates of g(t) D and trials N.

`projection`, `uncertainty`, `measured` and those of trials may be absent.
"""

ARRAYS = tuple(AXES)
"""Arrays of a band."""

ABOUT = "about"
"""Array of an import with its `BandFile`: JSON in UTF-8, as bytes."""

FILE_FIELDS = (
    "unit",
    "coordinates",
    "source",
    "licence",
    "trial_count",
    "normalized",
    "exact_law",
)
"""Fields of a band with the same name in its TOML file."""

MARKER_ARRAYS = ("markers_mm", "markers_uncertainty_mm")
"""Arrays of a numerical solution of cloth or foam: positions of its markers, shape [T, 3 M]."""


class ExactLaw(StrEnum):
    """Closed form of a motion."""

    COULOMB_SLIDE = "coulomb-slide"
    """A box slides down a fixed box, or sticks."""
    IDEAL_REBOUNDS = "ideal-rebounds"
    """A ball falls on a plane and rebounds."""


class RecordedEvent(FileModel):
    """Real value of one event, measured in a recording.

    Attributes:
        name: Name of the event, as `swing_frequency_hz`.
        unit: Unit of the value.
        value: Real value.
        standard_uncertainty: Its standard uncertainty.
        markers: Indices of the markers that it uses; empty for all of them, or if the event uses none.
        source: Recording and method, one sentence.
    """

    name: str
    unit: str
    value: float
    standard_uncertainty: float = Field(gt=0.0)
    markers: tuple[int, ...] = ()
    source: str


class BandFile(FileModel):
    """The description of a reference, such as its file `<id>.toml`.

    Attributes:
        kind: What the reference motion is; `none` for events alone.
        unit: Unit of g(t).
        coordinates: Names of the C coordinates of the band.
        source: Origin of the numbers, one sentence.
        licence: Licence of the data.
        trial_count: Number of real trials; None is unknown.
        normalized: Whether distances are divided by the published distance of real trials.
        standard_uncertainty: As `Band.standard_uncertainty`; for readers of the file.
        zero_motion_distance: As `Band.zero_motion_distance`; for readers of the file.
        exact_law: As `Band.exact_law`.
        exact_source: Words for the exact motion, or why there is none.
        events: Real values of events.
        imported: Facts of `gauge data import` about the trials; empty for bundled references.
    """

    kind: Literal["trials", "recording", "published", "analytic", "numerical", "none"]
    unit: str
    coordinates: tuple[str, ...] = ()
    source: str
    licence: str = ""
    trial_count: int | None = None
    normalized: bool = True
    standard_uncertainty: float | None = None
    zero_motion_distance: float | None = None
    exact_law: ExactLaw | None = None
    exact_source: str = ""
    events: tuple[RecordedEvent, ...] = ()
    imported: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Band:
    """Mean and scatter of a reference per frame, in coordinates that are a linear map of g(t).

    All arrays are read-only. T is the number of frames, C that of the band's coordinates, D the width of g(t).

    Attributes:
        kind: What the mean is.
        unit: Unit of all distances.
        coordinates: Names of the C coordinates.
        projection: Map from g(t) to the band's coordinates, shape [C, D]; it selects the measured directions.
        mean: Mean at frames 0, 1, ..., shape [T, C]; NaN is unknown.
        sigma: Standard deviation between real trials, shape [T, C]; for a solution, the scale of the reward.
        measured: Whether a frame was measured, shape [T]. RMSE and DTW also use extrapolated frames; z does not.
        source: Origin of the numbers, one sentence.
        licence: Licence of the data.
        trial_count: Number of real trials; None is unknown.
        uncertainty: Standard uncertainty of the mean, or of one measured trial, shape [T, C]; None if unknown.
        trials: Each real trial, shape [N, T, C]; NaN is unknown. None if only mean and scatter are known.
        trial_rmse: RMSE of each real trial to the mean of the others, shape [N]; None without single trials.
        trial_rmse_aligned: The same after the time shift with the smallest RMSE, shape [N].
        normalized: Whether distances are divided by the published distance of real trials.
        baselines_without: Mean of `trial_rmse_aligned` without each of the trials, for the jackknife, shape [N]; None
            below three trials.
        points: Positions of the markers as a band in mm; scores and rewards of cloth and foam use them.
        exact_law: Law of the exact motion of the scene, see `gauge_envs.scoring.exact`; None without a closed form.
        given_uncertainty: `standard_uncertainty` from a file; None computes it from the arrays.
        events: Real values of events of a single trial.

    Raises:
        ShapeError: Arrays do not fit each other.
    """

    kind: Kind
    unit: str
    coordinates: tuple[str, ...]
    projection: FloatArray
    mean: FloatArray
    sigma: FloatArray
    measured: BoolArray
    source: str
    licence: str = ""
    trial_count: int | None = None
    uncertainty: FloatArray | None = None
    trials: FloatArray | None = None
    trial_rmse: FloatArray | None = None
    trial_rmse_aligned: FloatArray | None = None
    normalized: bool = True
    baselines_without: FloatArray | None = None
    points: Band | None = None
    exact_law: ExactLaw | None = None
    given_uncertainty: float | None = None
    events: tuple[RecordedEvent, ...] = ()

    def __post_init__(self) -> None:
        for name in ARRAYS:
            given = getattr(self, name)
            if given is not None:
                values = np.array(given, dtype=bool if name == "measured" else float)
                values.setflags(write=False)
                object.__setattr__(self, name, values)
        sizes = {"C": len(self.coordinates)}
        for name, axes in AXES.items():
            values = getattr(self, name)
            if values is None:
                continue
            found = dict(zip(axes, values.shape, strict=False))
            sizes = found | sizes
            expected = tuple(sizes.get(axis) for axis in axes)
            if values.shape != expected:
                raise ShapeError(
                    f"{name} has shape {values.shape}, expected {axes} = {expected}: frames T, coordinates C, trials N"
                )
        for name in ("trial_rmse", "trial_rmse_aligned"):
            values = getattr(self, name)
            if values is not None and not np.isfinite(values).all():
                trial = int(np.isfinite(values).argmin())
                raise ShapeError(
                    f"{name}: trial {trial} has the distance {values[trial]}; leave this trial out of the band"
                )

    def __repr__(self) -> str:
        """Return kind, size, standard uncertainty and source in five lines."""
        compared = self.compared
        counts = [f"{len(self.mean)} frames", f"{compared.known.sum()} compared"]
        if self.trials is not None:
            counts.append(f"{len(self.trials)} single trials")
        names = shorten(", ".join(self.coordinates), MAX_TEXT, placeholder=" ...")
        return (
            f"Band({self.kind}, {', '.join(counts)}\n"
            f"    coordinates [{self.unit}]: {names}\n"
            f"    standard uncertainty: {self.standard_uncertainty:.3g} {compared.unit}\n"
            f"    source: {shorten(self.source, MAX_TEXT, placeholder=' ...')}\n"
            ")"
        )

    @cached_property
    def known(self) -> BoolArray:
        """Whether a frame has a mean, shape [T]."""
        return np.asarray(np.isfinite(self.mean).any(axis=1))

    @property
    def compared(self) -> Band:
        """The band that verdicts and rewards use: the band of the markers if there is one, else this band."""
        return self.points or self

    @property
    def marker_count(self) -> int:
        """Number of markers if the coordinates are marker positions, else 1."""
        is_of_markers = self.coordinates[0].startswith("marker-")
        return len(self.coordinates) // 3 if is_of_markers and self.unit == "mm" else 1

    def length(self, deviation: FloatArray) -> float:
        """Return the root mean square of a deviation, shape [T, C], over known frames and over markers, if any."""
        squares = np.where(np.isfinite(self.mean), np.square(deviation), 0.0)
        of_frames = squares.sum(axis=1)[self.known] / self.marker_count
        return math.sqrt(float(of_frames.mean()))

    @cached_property
    def standard_uncertainty(self) -> float:
        """Standard uncertainty u of the mean in the norm of the distance.

        For `trials` and `published` it is the scatter over the root of the number of trials. For `recording` it is the
        scatter and the measurement, and for `numerical` the discretization. For `analytic` it is what the closed form
        leaves out, 0 for an exact one.
        """
        if self.given_uncertainty is not None:
            return self.given_uncertainty
        compared = self.compared
        sigma, uncertainty = compared.sigma, compared.uncertainty
        if self.kind.is_mean_of_trials:
            return compared.length(sigma / math.sqrt(self.trial_count or 1))
        if uncertainty is None:
            return compared.length(sigma)
        if self.kind is Kind.RECORDING:
            return compared.length(np.hypot(sigma, uncertainty))
        return compared.length(uncertainty)

    @cached_property
    def zero_motion_distance(self) -> float:
        """Distance of a scene in which nothing moves."""
        return self.compared.length(displacements(self.compared.mean))

    @property
    def has_release(self) -> bool:
        """Whether the motion starts with a release at an unknown time, as measured motions do.

        Means computed from published numbers of trials start at frame 0.
        """
        return self.kind is Kind.RECORDING or self.trials is not None

    def of_trial(self, trial: int) -> Band:
        """Return the band of one of its trials, with the uncertainty of the measurement."""
        assert self.trials is not None and self.uncertainty is not None, (
            "only a band with single trials and their uncertainty has a band of a trial"
        )
        return replace(
            self,
            mean=self.trials[trial],
            sigma=np.nan_to_num(self.uncertainty),
            trial_count=1,
            source=f"trial {trial} of {self.source}",
            trials=None,
            trial_rmse=None,
            trial_rmse_aligned=None,
            normalized=False,
            baselines_without=None,
            given_uncertainty=None,
            exact_law=None,
        )

    def project(self, g: ArrayLike) -> FloatArray:
        """Return g(t), shape [frame_count, D], in the coordinates of the band, shape [frame_count, C]."""
        trajectory = np.asarray(g, dtype=np.float64)
        if trajectory.ndim != 2 or trajectory.shape[1] != self.projection.shape[1]:
            raise ShapeError(
                f"trajectory has shape {trajectory.shape}; [frame_count, {self.projection.shape[1]}] is needed"
            )
        return trajectory @ self.projection.T


def displacements(motion: FloatArray) -> FloatArray:
    """Return a motion relative to its first known position, shape [T, C]; NaN is unknown."""
    first = np.isfinite(motion).argmax(axis=0)
    return motion - np.take_along_axis(motion, first[None], axis=0)


# --- files -----------------------------------------------------------------------------------------------------------


def band_file(variant: str, source: DataSource = DataSource.BUNDLED) -> Path | None:
    """Return the file that describes the reference of a variant; None without one.

    The first file that exists counts: of the package, next to the user's task file, of imported trials. With
    `source=imported` the order is reversed.
    """
    bundled = scoring_folder("bands") / f"{variant}.toml"
    files = [bundled, own_band_file(variant), imported_file(variant)]
    if source is DataSource.IMPORTED:
        files.reverse()
    return next((file for file in files if file is not None and file.is_file()), None)


def load_band(variant: str, source: DataSource = DataSource.BUNDLED) -> Band | None:
    """Return the reference motion of a variant, or None.

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        source: `bundled` or `imported`, see `band_file`.

    Raises:
        ReferenceFileError: A file is damaged.
    """
    file = band_file(variant, source)
    return None if file is None else _read_band(file, file.stat().st_mtime_ns)


def read_band_file(file: Path) -> BandFile:
    """Return the description in a file of `band_file`."""
    return _read_band_file(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=256)
def _read_band_file(file: Path, modified_ns: int) -> BandFile:
    """Return the content of a file; its time distinguishes versions in the cache."""
    with reading(file, ReferenceFileError, hint=renewal(file)) as content:
        if file.suffix == ".toml":
            return BandFile.model_validate(toml_document(content))
        about = npz_arrays(content, [ABOUT])[ABOUT]
        return BandFile.model_validate(json_document(about.tobytes()))


def renewal(file: Path) -> str:
    """Return the command that renews a damaged file of a reference; empty if it is no import."""
    is_import = file.suffix == ".npz" and file == imported_file(file.stem)
    return f"gauge data import DIR {file.stem} renews it" if is_import else ""


@lru_cache(maxsize=128)
def _read_band(file: Path, modified_ns: int) -> Band | None:
    """Return the band of a file of `band_file`, and of the NPZ file of its name."""
    content = read_band_file(file)
    if Kind(content.kind) is Kind.NONE:
        return None
    arrays_file = file.with_suffix(".npz")
    with reading(arrays_file, ReferenceFileError, hint=renewal(file)) as packed:
        arrays = npz_arrays(packed, (*ARRAYS, *MARKER_ARRAYS))
        arrays.setdefault("projection", np.eye(len(content.coordinates)))
        arrays.setdefault("measured", np.isfinite(arrays["mean"]).all(axis=1))
        facts: dict[str, Any] = {name: getattr(content, name) for name in FILE_FIELDS}
        facts |= {name: arrays[name] for name in ARRAYS if name in arrays}
        band = Band(
            kind=Kind(content.kind),
            given_uncertainty=content.standard_uncertainty,
            **facts,
        )
        if "markers_mm" not in arrays:
            return band
        return replace(band, points=_marker_band(band, arrays))


def _marker_band(band: Band, arrays: Mapping[str, NDArray[Any]]) -> Band:
    """Return the band of the markers of a numerical solution."""
    mean_mm, uncertainty_mm = (arrays[name] for name in MARKER_ARRAYS)
    count = mean_mm.shape[1] // 3
    names = tuple(f"marker-{index}.{axis}" for index in range(count) for axis in "xyz")
    return Band(
        kind=band.kind,
        unit="mm",
        coordinates=names,
        projection=np.eye(3 * count),
        mean=mean_mm,
        sigma=np.fmax(uncertainty_mm, MARKER_SIGMA_MM),
        measured=np.isfinite(mean_mm).all(axis=1),
        source=band.source,
        licence=band.licence,
        uncertainty=uncertainty_mm,
        normalized=False,
    )


def recorded_events(
    variant: str, source: DataSource = DataSource.BUNDLED
) -> tuple[RecordedEvent, ...]:
    """Return the events of a variant that have a real value in a recording."""
    file = band_file(variant, source)
    return () if file is None else read_band_file(file).events
