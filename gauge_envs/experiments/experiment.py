"""One experiment: its scene, and how it is observed and scored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from gauge_envs.experiments.task_format import ScoreSpec, TaskSpec
from gauge_envs.experiments.variants import Variant
from gauge_envs.observables.kinds import coordinate_names
from gauge_envs.references.imported import DataSource
from gauge_envs.references.published import Baseline, Reference, published_baselines
from gauge_envs.scene import Scene

__all__ = [
    "ASSET_NAME",
    "Asset",
    "AssetKind",
    "Experiment",
    "TaskExperiment",
    "driver_provenance",
]


class AssetKind(StrEnum):
    """What an asset is."""

    USD = "usd"
    """A USD layer, for any engine."""
    MODEL = "model"
    """A model file in an engine's own format, for that engine alone."""
    EXPERIMENT = "experiment"
    """An experiment file, which names a USD layer."""


@dataclass(frozen=True, kw_only=True)
class Asset:
    """File that a scene is from.

    Attributes:
        path: Where it is, as it was given.
        kind: What it is.
        sha256: Hash of its bytes; where it names other files, as layers that it refers to, of theirs too.
        edited: Whether it differs from the calibrated variant in what moves it. An experiment file is its own measure.
        changes: How, a line each: `contact cube/board: friction 0.273673 -> 0.136837`.
    """

    path: Path
    kind: AssetKind
    sha256: str
    edited: bool = False
    changes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary, without the folder that the file is in."""
        return {
            "file": self.path.name,
            "kind": self.kind.value,
            "sha256": self.sha256,
            "edited": self.edited,
            "changes": list(self.changes),
        }


ASSET_NAME = "Asset"
"""Name, and after `GAUGE/` the Gymnasium id, under which experiment files run."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment: its scene, and how it is observed and scored.

    Attributes:
        name: `SlopeSlider-2-wood`; `Asset-crate` where a user's experiment file states it.
        title: What it is called.
        score: How it is observed and scored.
        scene: What a backend builds.
        recorded: Names of the bodies whose positions are observed.
        frame_count: Frames of an episode, the first included.
        parameters: Name of the parameter set, or `custom`.
        overrides: What differs from the calibrated constants, keyed `body.constant`.
        driver_provenance: Where the driven motion is from; None where nothing is driven.
        drivers: Whether any driven motion is that of imported trials, or all are bundled.
        reference_source: Whether it is scored against imported trials, or against what the package has.
        file_sha256: Hash of the task file; of the experiment file and what it names, where a user brought it.
        asset: File that the scene is from; None where the task file states it.
        reference: What it is scored against; None where the package has that under its name.
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
    asset: Asset | None = None
    reference: Reference | None = None

    @property
    def id(self) -> str:
        """`GAUGE/SlopeSlider-2-wood`: the Gymnasium id, and what results are filed under."""
        return f"GAUGE/{self.name}"

    @property
    def baselines(self) -> Mapping[str, Baseline]:
        """Scores of real trials by metric, and of three engines where they were published."""
        return published_baselines(self.name) if self.reference is None else self.reference.baselines

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of g(t), as `cube.x`, `marker-3` or `face-3`."""
        return coordinate_names(self.score.observable, recorded=self.recorded, markers=self.scene.markers)

    @property
    def edited(self) -> bool:
        """Whether the scene is that of an asset which differs from the calibrated one."""
        return self.asset is not None and self.asset.edited

    @property
    def model_file(self) -> Path | None:
        """File in an engine's own format that stands for the scene; None where there is none."""
        return self.asset.path if self.asset is not None and self.asset.kind is AssetKind.MODEL else None


@dataclass(frozen=True, kw_only=True)
class TaskExperiment(Experiment):
    """The experiment of one variant of a task file.

    Attributes:
        variant: Which one.
        spec: Its task file.
    """

    variant: Variant
    spec: TaskSpec


def driver_provenance(scene: Scene) -> str | None:
    """Where the driven motion of a scene is from; None where nothing is driven."""
    return ", ".join(sorted({driver.provenance for driver in scene.drivers})) or None
