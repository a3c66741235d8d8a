"""One experiment: its scene, and how it is observed and scored."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from gauge_envs.experiments.tables import Camera, task_camera
from gauge_envs.experiments.task_format import ScoreSpec, TaskSpec
from gauge_envs.experiments.variants import Variant
from gauge_envs.observables.kinds import coordinate_names, largest_distance
from gauge_envs.references.published import Baseline, Reference, published_baselines
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Scene
from gauge_envs.scene.timing import FRAME_RATE_HZ


class AssetKind(StrEnum):
    """Kind of asset."""

    USD = "usd"
    """A USD layer, for any engine."""
    MODEL = "model"
    """A model file in the format of one engine, for that engine alone."""
    EXPERIMENT = "experiment"
    """An experiment file, which names a USD layer."""


@dataclass(frozen=True, kw_only=True)
class Asset:
    """File that states a scene.

    Attributes:
        path: Path as it was given.
        kind: Kind of file.
        sha256: Hash of the file, and of the files that it refers to.
        edited: Whether its physics differ from the calibrated variant; an experiment file is never edited.
        changes: Differences, one line each, as `contact cube/board: friction 0.273673 -> 0.136837`.
    """

    path: Path
    kind: AssetKind
    sha256: str
    edited: bool = False
    changes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary without the folder of the file."""
        return {
            "file": self.path.name,
            "kind": self.kind.value,
            "sha256": self.sha256,
            "edited": self.edited,
            "changes": list(self.changes),
        }


ASSET_NAME = "Asset"
"""Name of experiment files; their Gymnasium id is `GAUGE/Asset`."""


EXPERIMENT_NAME = "[A-Za-z0-9][A-Za-z0-9_-]{0,99}"
"""Pattern of the name of an experiment file, which is part of ids and of file names."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment: its scene, and how it is observed and scored.

    Attributes:
        name: Name, as `SlopeSlider-2-wood`, or `Asset-crate` for an experiment file.
        title: Title for reports.
        score: Observable and metrics.
        scene: Scene that a backend builds.
        recorded: Names of the bodies whose positions are observed.
        frame_count: Frames of an episode, the first included.
        parameters: Name of the parameter set, or `custom`.
        overrides: Differences from the calibrated constants, keyed `body.constant`.
        driver_provenance: Origin of the driven motion; None without driven bodies.
        drivers: `imported` if any driven motion is that of imported trials.
        reference_source: `imported` if scores refer to the imported trials.
        file_sha256: Hash of the task file, or of an experiment file and the files that it names.
        revision: Revision of the task file; 1 for an experiment file.
        asset: File that states the scene; None if the task file states it.
        reference: Reference of an experiment file; None for a variant of the package.
        trial: Single-shot trial whose measured start the scene has, and which scores it; None without such trials.
    """

    name: str
    title: str
    score: ScoreSpec
    scene: Scene
    recorded: tuple[str, ...]
    frame_count: int
    parameters: str
    overrides: Mapping[str, Any]
    driver_provenance: str | None
    drivers: DataSource = DataSource.BUNDLED
    reference_source: DataSource = DataSource.BUNDLED
    file_sha256: str
    revision: int = 1
    asset: Asset | None = None
    reference: Reference | None = None
    trial: int | None = None

    @property
    def id(self) -> str:
        """Gymnasium id and id of results, as `GAUGE/SlopeSlider-2-wood`."""
        return f"GAUGE/{self.name}"

    @property
    def baselines(self) -> Mapping[str, Baseline]:
        """Baselines by metric: scores of real trials, and published scores of three engines."""
        return (
            published_baselines(self.name)
            if self.reference is None
            else self.reference.baselines
        )

    @property
    def impossible_scores(self) -> str:
        """Published scores that geometry forbids, so that they have another unit or observable; empty without any."""
        found: dict[str, list[str]] = {}
        for metric, line in self.baselines.items():
            largest = self._largest_score(line)
            for engine, over in {
                "real trials": line.mean and 1.0,
                **line.engines,
            }.items():
                # The energy loss of real trials is 0, so that of engines is not divided by it.
                value = (over or 0.0) * (line.mean or 1.0)
                if abs(value) > largest:
                    text = f"{metric.upper()} of {engine} {value:.3g} {line.unit}"
                    found.setdefault(f"{largest:.3g} {line.unit}", []).append(text)
        return "; ".join(
            f"at most {largest} is possible, and published are {', '.join(texts)}: "
            "their unit or observable is another one"
            for largest, texts in found.items()
        )

    def _largest_score(self, line: Baseline) -> float:
        """Return a bound on a score, in its unit: of distances by the geometry of g(t), of times the duration.

        The momentum that arrives and the energy that is lost are at most those at the start.
        """
        if line.metric in ("rmse", "dtw"):
            return largest_distance(
                self.score.observable, self.scene, recorded=self.recorded
            )
        return line.frames / FRAME_RATE_HZ if line.unit == "s" else 1.0

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of g(t), as `cube.x`, `marker-3` or `face-3`."""
        return coordinate_names(
            self.score.observable, recorded=self.recorded, markers=self.scene.markers
        )

    @property
    def materials(self) -> Mapping[str, str]:
        """Material of bodies by name, as `wood`, for pictures; empty where no task file states the scene.

        A scene has no materials: an engine sees their constants alone.
        """
        return {}

    @property
    def camera(self) -> Camera | None:
        """Camera of pictures; None for the one that follows from the scene."""
        return task_camera(self.name)

    @property
    def edited(self) -> bool:
        """Whether the scene is that of an asset which differs from the calibrated scene."""
        return self.asset is not None and self.asset.edited

    @property
    def model_file(self) -> Path | None:
        """Model file of an engine that replaces the scene, or None."""
        return (
            self.asset.path
            if self.asset is not None and self.asset.kind is AssetKind.MODEL
            else None
        )


@dataclass(frozen=True, kw_only=True)
class TaskExperiment(Experiment):
    """The experiment of one variant of a task file.

    Attributes:
        variant: The variant.
        spec: Content of the task file.
    """

    variant: Variant
    spec: TaskSpec

    @property
    def materials(self) -> Mapping[str, str]:
        """Material of bodies by name, as `wood`: that of the body in the task file, else that of the variant."""
        found = {}
        for body in (*self.scene.bodies, *self.scene.deformables):
            name, _, number = body.name.rpartition("-")
            for owner in (body.name, name if number.isdecimal() else ""):
                try:
                    found[body.name] = (
                        self.spec.owner(owner).material or self.variant.material
                    )
                    break
                except KeyError:
                    continue
        return found


def driver_provenance(scene: Scene) -> str | None:
    """Return the origin of the driven motion of a scene; None without driven bodies."""
    return ", ".join(sorted({driver.provenance for driver in scene.drivers})) or None
