"""The result of one episode: all data to judge, plot or repeat it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import InstanceOf, PlainValidator

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready
from gauge_envs.references.user_data import BUNDLED_DATA
from gauge_envs.registry import package_versions
from gauge_envs.runs.motion import Motion
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, frame_times_s
from gauge_envs.scoring.metrics import FRAME_TOLERANCE_S
from gauge_envs.scoring.score import Score

MARKER_DECIMALS = 4
"""Decimals of a marker position in a file [mm]: 0.1 um, a thousandth of the smallest uncertainty of a solution."""

ROUNDING_S = 1e-6
"""Largest delay of the sample of the last frame [s]."""


class Outcome(StrEnum):
    """Outcome of an episode."""

    FINISHED = "finished"
    """The episode ran to its last frame."""
    DIVERGED = "diverged"
    """The simulation left the physical bounds of the scene; there is no score."""
    UNSUPPORTED = "unsupported"
    """The episode did not run: the backend cannot build the scene, or the experiment does not have the parameters."""
    FAILED = "failed"
    """An error ended the episode or prevented it."""


def rows_of(values: ArrayLike) -> FloatArray:
    """Return numbers as an array, with NaN for null and for values that are not finite.

    Raises:
        ValueError: Rows differ in length, or a value is not a number.
    """
    try:
        rows = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("rows of equal length with numbers are expected") from None
    rows[~np.isfinite(rows)] = np.nan
    return rows


StoredArray = Annotated[FloatArray, PlainValidator(rows_of)]
"""Array that a file stores as lists, with null for NaN."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedTrajectory:
    """Generalized trajectory of an episode, dense enough to plot and to score again.

    A value that is not finite is NaN, and null in a file. Arrays take a sixth of the memory of lists.

    Attributes:
        unit: Unit of the samples.
        coordinates: Names of the coordinates, as `cube.x`.
        times_s: Times [s], 180 a second, shape [sample_count].
        samples: g(t) at those times, shape [sample_count, coordinate_count].
        markers_mm: x, y, z of each marker at the 30 Hz frames [mm], shape [frame_count, 3 marker_count]; empty without
            markers.
    """

    unit: str
    coordinates: list[str]
    times_s: StoredArray
    samples: StoredArray
    markers_mm: StoredArray = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        count, width = len(self.times_s), len(self.coordinates)
        if len(self.samples) != count:
            raise ValueError(f"{count} times but {len(self.samples)} samples")
        if count and self.samples.shape != (count, width):
            raise ValueError(f"a sample does not have {width} coordinates")

    def __eq__(self, other: object) -> bool:
        """Return whether all values are the same; NaN equals NaN."""
        if not isinstance(other, RecordedTrajectory):
            return NotImplemented
        mine, its = (json_ready(asdict(trajectory)) for trajectory in (self, other))
        return bool(mine == its)

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        times_s: FloatArray,
        samples: FloatArray,
        markers_m: FloatArray | None = None,
    ) -> RecordedTrajectory:
        """Return the record of a generalized trajectory.

        Args:
            experiment: The experiment of the trajectory.
            times_s: Times [s], shape [sample_count].
            samples: g(t) at those times in the unit of the observable, shape [sample_count, coordinate_count].
            markers_m: Markers at the frames [m], shape [frame_count, marker_count, 3]; None or empty without markers.
        """
        markers_mm = np.empty((0, 0))
        if markers_m is not None and markers_m.size:
            markers_mm = 1e3 * markers_m.reshape(len(markers_m), -1)
        return cls(
            unit=experiment.score.observable.unit,
            coordinates=list(experiment.coordinates),
            times_s=times_s,
            samples=rows_of(samples),
            markers_mm=np.round(markers_mm, MARKER_DECIMALS),
        )

    @cached_property
    def frames(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Numbers of the 30 Hz frames with finite samples, and g(t) there; see `recorded_frames`."""
        return recorded_frames(*self.arrays())

    @property
    def compared(self) -> RecordedTrajectory:
        """What engines are compared by: positions of the markers of cloth and foam [mm], else g(t)."""
        if not self.markers_mm.size:
            return self
        numbers = range(self.markers_mm.shape[1] // 3)
        return RecordedTrajectory(
            unit="mm",
            coordinates=[f"marker-{n}.{axis}" for n in numbers for axis in "xyz"],
            times_s=frame_times_s(len(self.markers_mm)),
            samples=self.markers_mm,
        )

    @property
    def marker_count(self) -> int:
        """Number of markers if the coordinates are those of `compared` markers, else 1."""
        is_of_markers = self.unit == "mm" and self.coordinates[0].startswith("marker-")
        return len(self.coordinates) // 3 if is_of_markers else 1

    def markers_m(self) -> FloatArray | None:
        """Return the markers at the frames [m], shape [frame_count, marker_count, 3]; None without markers."""
        if not self.markers_mm.size:
            return None
        return 1e-3 * self.markers_mm.reshape(len(self.markers_mm), -1, 3)

    def arrays(self) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and g(t), shape [sample_count, coordinate_count]."""
        return self.times_s, self.samples


def recorded_frames(
    times_s: FloatArray, samples: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the numbers of the 30 Hz frames with finite samples, and the samples there.

    Args:
        times_s: Times [s], shape [sample_count].
        samples: Values at those times, shape [sample_count, coordinate_count].
    """
    frames = np.rint(times_s * FRAME_RATE_HZ).astype(np.int64)
    is_frame = np.abs(times_s - frames / FRAME_RATE_HZ) < FRAME_TOLERANCE_S
    hits = is_frame & np.isfinite(samples).all(axis=1)
    return frames[hits], samples[hits]


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of one episode, or of one trajectory file of a user, which has no `backend`, `seed`, `wall_s` and `cpu_s`.

    Attributes:
        id: Gymnasium id.
        outcome: How the episode ended.
        backend: Name of the physics engine.
        parameters: Name of the parameter set, or the overrides.
        score: Distance to reality; a metric that does not apply is None.
        task_sha256: Hash of the task file.
        revision: Revision of the experiment; results of different ones are not compared.
        frames: Number of recorded frames, the first included.
        diverged: Whether the simulation left the physical bounds of the scene.
        diverged_reason: Bound that it left; None without divergence.
        wall_s: Wall time of reset and steps [s], without building the scene. Episodes that ran together share it
            evenly.
        cpu_s: CPU time of the process over the same span [s], all its threads, shared in the same way. Other processes
            on the machine change it far less than `wall_s`. It has no time of a GPU.
        sim_s: Simulated time [s].
        settings: All numerical settings of the engine.
        settings_given: The settings that the caller gave.
        versions: Versions of the engine, gauge-envs, gymnasium, numpy and python.
        processor: The machine's processor, see `processors.processor_name`; empty without a run.
        seed: Seed of the reset and of the jitter.
        jitter: Standard deviations of the start, or `trial`, the number of the imported trial that it is from; empty
            for the published start.
        marker_proxy: Marker proxy of deformable bodies: `material` or `node`.
        driver_provenance: Source of the driven motion; None without driven bodies.
        dataset: Source of driven motion (`drivers`) and band (`reference`), `bundled` or `imported`. If one of them is
            imported, also `revision` of the dataset and `sha256` over the imported trials.
        asset: File with the scene: its name `file`, `kind`, `sha256`, whether it is `edited`, and its `changes`.
            A scene that the package does not have is in `scene`, as text of a USD layer. Empty if the scene is that of
            the task file.
        task_file: Task file of the user with the id; None for the ids of the package.
        created: Time of creation, ISO 8601, UTC.
        error: Why the episode is unsupported or failed; None otherwise.
        trajectory: Its trajectory; None if it did not run.
        motion: Its poses and nodes for 3D views, in a file of their own; None if they were not recorded or read.
    """

    id: str
    outcome: Outcome
    parameters: str | dict[str, Any]
    score: Score
    task_sha256: str
    revision: int = 1
    backend: str | None = None
    frames: int = 0
    diverged: bool = False
    diverged_reason: str | None = None
    wall_s: float | None = None
    cpu_s: float | None = None
    sim_s: float = 0.0
    settings: dict[str, Any] = field(default_factory=dict)
    settings_given: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=package_versions)
    processor: str = ""
    seed: int | None = None
    jitter: dict[str, int | float] = field(default_factory=dict)
    marker_proxy: str = "material"
    driver_provenance: str | None = None
    dataset: dict[str, str] = field(default_factory=BUNDLED_DATA.copy)
    asset: dict[str, Any] = field(default_factory=dict)
    task_file: str | None = None
    created: str = field(
        default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds")
    )
    error: str | None = None
    trajectory: RecordedTrajectory | None = None
    motion: InstanceOf[Motion] | None = field(default=None, compare=False, repr=False)

    @property
    def is_edited(self) -> bool:
        """Whether the scene comes from an asset and differs from the scene of the task file."""
        return bool(self.asset.get("edited"))

    def version_difference(self, installed: Mapping[str, str]) -> str:
        """Return the first package whose version differs from the installed one; empty if none differs."""
        for name, version in installed.items():
            if self.versions.get(name) != version:
                return f"made with {name} {self.versions.get(name)}, not {version}"
        return ""

    def to_dict(self, *, trajectory: bool = True) -> dict[str, Any]:
        """Return a JSON-ready dictionary with every field but `motion`.

        Args:
            trajectory: Whether to include the trajectory and the long parts of the asset.
        """
        kept = replace(self, motion=None)
        if not trajectory:
            kept = replace(kept, trajectory=None)
        values: dict[str, Any] = json_ready(asdict(kept))
        del values["motion"]
        values["score"] = json_ready(self.score.to_dict())
        if not trajectory:
            del values["trajectory"]
            values["asset"].pop("scene", None)
        return values
