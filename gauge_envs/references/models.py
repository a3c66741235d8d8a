"""Models: the solution of a calibrated scene by engines of different families, refined until its uncertainty is known.

A variant without a real reference may have `scoring/models/<variant>.npz` and a sidecar `<variant>.json`;
`unsolved.json` says why others have none. A distance to it is the numerical error of an engine: verification (ASME
V&V 20), and not validation. It says nothing of reality.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import (
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    TypeAdapter,
)

from gauge_envs.errors import ReferenceFileError
from gauge_envs.files import npz_arrays
from gauge_envs.references.bands import Band, SigmaSource
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.published import published_baselines
from gauge_envs.references.tables import (
    FileModel,
    faults_of,
    read_content,
    scoring_folder,
)
from gauge_envs.scene.geometry import FloatArray

SHEET = "sheet"
"""Name of the one-dimensional sheet among the engines of a solution, of which it is the mean."""

BLOCK = "block"
"""Name of the block at rest among them, likewise."""

STRIDE = 5
"""Frames between stored values of an uncertainty, which varies slowly."""


POINT_SIGMA_MM = 1.0
"""Distance of a marker that a reward counts as 1 where the solution is surer than that [mm]. It is a choice: no scatter
of marker positions is published for these experiments."""

ARRAYS = ("mean", "offsets", "uncertainty", "points", "points_uncertainty")
"""Arrays of a file. The last two are absent where g(t) is of positions."""


class Refinement(FileModel):
    """How the solution of an engine changes as one parameter is refined.

    Attributes:
        parameter: `step`, `cell` or `iterations`.
        factors: Parameter of each run over that of the default settings, coarse to fine.
        order: Observed order of convergence; None if it was not observed, so that nothing was extrapolated.
        change: Root mean square difference of g(t) between the two finest runs, in the unit of g(t).
        uncertainty: Standard uncertainty that is left, root mean square over frames, in the unit of g(t).
    """

    parameter: str
    factors: tuple[PositiveFloat, ...]
    order: float | None = None
    change: NonNegativeFloat
    uncertainty: NonNegativeFloat


class EngineSolution(FileModel):
    """The solution of one engine.

    Attributes:
        engine: Name of the engine.
        version: Its version.
        preset: Its preset.
        refinements: What was refined.
        correction: Root mean square difference of g(t) between its default settings and its solution.
    """

    engine: str
    version: str
    preset: str
    refinements: tuple[Refinement, ...]
    correction: NonNegativeFloat


class ModelSidecar(FileModel):
    """The file `<variant>.json` beside the arrays of a model.

    Attributes:
        unit: Unit of g(t).
        coordinates: Names of the coordinates of g(t).
        frames: Number of frames of the episode.
        solved_frames: Number of frames, from the first one, at which g(t) is known.
        point_frames: The same of the points; None where g(t) is of positions.
        gap: First frame before the last one at which g(t) is not known, and the frame after them; None without any.
        point_gap: The same of the points.
        point_solver: What solves the points independently of the engines, so that they are the mean of both; empty for
            nothing.
        ends: Why g(t) is not known at some frames; empty if it covers the episode.
        quantum: Value of one count of `mean` and `offsets`, in the unit of g(t).
        point_quantum_mm: Value of one count of `points` [mm].
        families_apart: Largest distance of an engine's g(t) from the mean, root mean square over frames.
        engines: The solutions that the mean is of.
        processor_s: Processor time of all runs [s].
    """

    unit: str
    coordinates: Annotated[tuple[str, ...], Field(min_length=1)]
    frames: PositiveInt
    solved_frames: PositiveInt
    point_frames: PositiveInt | None = None
    gap: tuple[NonNegativeInt, PositiveInt] | None = None
    point_gap: tuple[NonNegativeInt, PositiveInt] | None = None
    point_solver: str = ""
    ends: str = ""
    quantum: PositiveFloat
    point_quantum_mm: PositiveFloat | None = None
    families_apart: NonNegativeFloat
    engines: Annotated[tuple[EngineSolution, ...], Field(min_length=1)]
    processor_s: NonNegativeFloat

    @property
    def source(self) -> str:
        """The reference in one sentence."""
        *first, last = (one.engine for one in self.engines)
        if first and first[0] == SHEET:
            how = f"an undamped one-dimensional sheet solves it, checked with {last}"
        elif first and first[0] == BLOCK:
            how = f"a block at rest by finite elements solves it, checked with {last}"
        elif first:
            how = f"{', '.join(first)} and {last} solve it"
        else:
            how = f"{last} solves it"
        found = f"the calibrated scene as {how}, refined one parameter at a time"
        if self.point_solver:
            found += f"; markers are the mean of that and {self.point_solver}"
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedModel:
    """Solution of a calibrated scene.

    Attributes:
        sidecar: What it rests on.
        band: Weighted mean of the engines' solutions and its uncertainty, of grade `model`.
        others: Mean of the solutions without one engine, by that engine, shape [T, C]; empty with one engine.
    """

    sidecar: ModelSidecar
    band: Band
    others: Mapping[str, FloatArray]


class UnsolvedScene(FileModel):
    """Why the calibrated scene of a variant has no solution, and what its engines do nevertheless.

    Attributes:
        reason: Why not.
        statistics: Of the last frame, by name and engine: mean, standard deviation and number of runs, which differ in
            step, cell and iterations.
    """

    reason: str
    statistics: Mapping[str, Mapping[str, tuple[float, NonNegativeFloat, PositiveInt]]]


@cache
def unsolved_scenes() -> Mapping[str, UnsolvedScene]:
    """Return the variants without a solution."""
    file = scoring_folder("models") / "unsolved.json"
    with faults_of(file):
        return TypeAdapter(dict[str, UnsolvedScene]).validate_json(read_content(file))


def solved_model(variant: str) -> SolvedModel | None:
    """Return the solution of a variant's calibrated scene, or None."""
    return _read(scoring_folder("models") / f"{variant}.npz", variant)


@cache
def _read(file: Path, variant: str) -> SolvedModel | None:
    if not file.is_file():
        return None
    with faults_of(file.with_suffix(".json")):
        sidecar = ModelSidecar.model_validate_json(
            read_content(file.with_suffix(".json"))
        )
    with faults_of(file):
        arrays = npz_arrays(read_content(file), ARRAYS)
    count, width = sidecar.solved_frames, len(sidecar.coordinates)
    expected = {"mean": (count, width), "offsets": (len(sidecar.engines), count, width)}
    shapes = {name: array.shape for name, array in arrays.items() if name in expected}
    if shapes != expected:
        raise ReferenceFileError(
            file, None, f"has arrays {shapes}, expected {expected}"
        )
    mean = unpacked(arrays["mean"], sidecar.quantum)
    mean[_frames_of(sidecar.gap)] = np.nan
    uncertainty = interpolated(arrays["uncertainty"], count)
    points = None
    if sidecar.point_quantum_mm is not None and sidecar.point_frames is not None:
        points_mm = unpacked(arrays["points"], sidecar.point_quantum_mm).reshape(
            sidecar.point_frames, -1
        )
        spread = np.repeat(
            interpolated(arrays["points_uncertainty"], sidecar.point_frames), 3, axis=1
        )
        names = tuple(
            f"marker-{index}.{axis}"
            for index in range(points_mm.shape[1] // 3)
            for axis in "xyz"
        )
        points_mm[_frames_of(sidecar.point_gap)] = np.nan
        points = _band(sidecar, points_mm, spread, unit="mm", coordinates=names)
        points = replace(points, sigma=np.maximum(points.sigma, POINT_SIGMA_MM))
    baseline = published_baselines(variant).get("rmse")
    band = _band(
        sidecar, mean, uncertainty, unit=sidecar.unit, coordinates=sidecar.coordinates
    )
    if baseline is not None and baseline.mean:
        # The mean over trials of the squared E_RMSE is the variance of the vector; see `carried_band`.
        sigma = np.hypot(baseline.mean, baseline.std or 0.0) / np.sqrt(width)
        band = replace(
            band,
            sigma=np.full_like(band.mean, sigma),
            sigma_source=SigmaSource.BASELINE,
        )
        band = replace(band, normalized_by_baseline=bool(np.isfinite(band.mean).all()))
    solutions = mean + unpacked(
        arrays["offsets"].swapaxes(0, 1), sidecar.quantum
    ).swapaxes(0, 1)
    engines = [one.engine for one in sidecar.engines]
    others = {
        name: padded(np.delete(solutions, place, axis=0).mean(axis=0), sidecar.frames)
        for place, name in enumerate(engines)
        if len(engines) > 1
    }
    return SolvedModel(
        sidecar=sidecar, band=replace(band, points=points), others=others
    )


def _band(
    sidecar: ModelSidecar,
    mean: FloatArray,
    uncertainty: FloatArray,
    *,
    unit: str,
    coordinates: tuple[str, ...],
) -> Band:
    """Return a band whose sigma is the uncertainty of its mean."""
    mean = padded(mean, sidecar.frames)
    spread = np.where(np.isfinite(mean), padded(uncertainty, sidecar.frames), np.nan)
    return Band(
        grade=BandGrade.MODEL,
        unit=unit,
        coordinates=coordinates,
        projection=np.eye(mean.shape[1]),
        mean=mean,
        sigma=np.nan_to_num(spread),
        measured=np.asarray(np.isfinite(mean).all(axis=1)),
        trial_count=None,
        source=sidecar.source,
        sigma_source=SigmaSource.MODEL,
        uncertainty=spread,
        normalized_by_baseline=False,
    )


def _frames_of(gap: tuple[int, int] | None) -> slice:
    return slice(0, 0) if gap is None else slice(*gap)


def unpacked(differences: np.ndarray, quantum: float) -> FloatArray:
    """Return values from differences of whole counts along the first axis."""
    return quantum * np.cumsum(differences, axis=0, dtype=np.int64).astype(np.float64)


def interpolated(values: np.ndarray, frames: int) -> FloatArray:
    """Return an uncertainty at all frames, from its values at every `STRIDE`-th one, shape [frames, ...]."""
    at = np.arange(frames) / STRIDE
    low = np.minimum(at.astype(int), len(values) - 1)
    high, share = np.minimum(low + 1, len(values) - 1), (at - low)[:, None]
    stored = values.astype(np.float64)
    return np.asarray((1.0 - share) * stored[low] + share * stored[high])


def padded(values: FloatArray, frames: int) -> FloatArray:
    """Return values with NaN at later frames, shape [frames, ...]."""
    missing = np.full((frames - len(values), *values.shape[1:]), np.nan)
    return np.concatenate([values, missing])
