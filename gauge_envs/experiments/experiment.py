"""One experiment: its scene, its observation and its score."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from gauge_envs.experiments.names import Variant
from gauge_envs.experiments.task_format import ScoreSpec, TaskSpec
from gauge_envs.experiments.variants import user_variants
from gauge_envs.names import first_names
from gauge_envs.observables.kinds import coordinate_names
from gauge_envs.references.published import Baseline, published_baselines
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import ContactMode, Scene
from gauge_envs.scene.diff import Change


class AssetKind(StrEnum):
    """Kind of asset."""

    USD = "usd"
    """A USD layer, for any engine."""
    MODEL = "model"
    """A model file in the format of one engine, only for that engine."""


@dataclass(frozen=True, kw_only=True)
class Asset:
    """File with a scene.

    Attributes:
        path: Path as given.
        kind: Kind of file.
        sha256: Hash of the file and of the files to which it refers.
        edited: Whether its physics differ from the published variant.
        changes: Differences from the published variant; those of an MJCF file are of the models of both.
    """

    path: Path
    kind: AssetKind
    sha256: str
    edited: bool = False
    changes: tuple[Change, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary without the folder of the file."""
        return {
            "file": self.path.name,
            "kind": self.kind.value,
            "sha256": self.sha256,
            "edited": self.edited,
            "changes": [*map(str, self.changes)],
        }


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment: its scene, its observation and its score.

    Attributes:
        variant: Family, subtask and material.
        spec: Content of the task file.
        scene: Scene that a backend builds.
        recorded: Names of the bodies whose positions are observed.
        frame_count: Frames of an episode, the first included.
        parameters: Name of the parameter set, or `custom`.
        overrides: Differences from the published constants, keyed `body.constant`.
        drivers: `imported` if any driven motion is from imported trials.
        reference_source: `imported` if imported trials are the reference.
        file_sha256: Hash of the task file.
        asset: File with the scene; None if the scene is from the task file.
        trial: Single-trial recording that gives the initial state and the reference; None without such recordings.
    """

    variant: Variant
    spec: TaskSpec
    scene: Scene
    recorded: tuple[str, ...]
    frame_count: int
    parameters: str
    overrides: Mapping[str, Any]
    drivers: DataSource = DataSource.BUNDLED
    reference_source: DataSource = DataSource.BUNDLED
    file_sha256: str
    asset: Asset | None = None
    trial: int | None = None

    @property
    def name(self) -> str:
        """Name, as `SlopeSlider-2-wood`."""
        return self.variant.name

    @property
    def id(self) -> str:
        """Gymnasium id and id of results, as `GAUGE/SlopeSlider-2-wood`."""
        return self.variant.id

    @property
    def title(self) -> str:
        """Title for reports."""
        subtask = self.spec.subtask_of(self.variant)
        return ", ".join([self.spec.title, *([subtask.title] if subtask else [])])

    @property
    def score(self) -> ScoreSpec:
        """Observable and metrics."""
        return self.spec.score

    @property
    def revision(self) -> int:
        """Revision of the task file."""
        return self.spec.revision

    @property
    def driver_provenance(self) -> str | None:
        """Origin of the driven motion; None without driven bodies."""
        origins = {driver.provenance for driver in self.scene.drivers}
        return ", ".join(sorted(origins)) or None

    @property
    def baselines(self) -> Mapping[str, Baseline]:
        """Published scores of real trials and of three engines, by metric."""
        return published_baselines(self.name)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of g(t), as `cube.x`, `marker-3` or `face-3`."""
        return coordinate_names(
            self.score.observable, recorded=self.recorded, markers=self.scene.markers
        )

    @property
    def materials(self) -> Mapping[str, str]:
        """Material of bodies by name, as `wood`, for pictures: of the body, else of the variant.

        A scene has no materials, because an engine needs only their constants.
        """
        materials = {}
        for body in (*self.scene.bodies, *self.scene.deformables):
            table = self.spec.owner(body.name)
            if table is not None:
                materials[body.name] = table.material or self.variant.material
        return materials

    @property
    def edited(self) -> bool:
        """Whether the scene comes from an asset and differs from the scene of the task file."""
        return self.asset is not None and self.asset.edited

    @property
    def unused_restitution(self) -> str:
        """The sentence that a restitution of the user has no effect, because its contact is sustained; else empty."""
        if self.model_file is not None:
            return ""
        changes = self.asset.changes if self.asset else ()
        is_users = any(change.field == ("restitution",) for change in changes)
        is_users |= self.variant in user_variants()
        given = [v for k, v in self.overrides.items() if k.endswith(".restitution")]
        pairs = [
            f"{contact.first[0]}/{contact.second[-1]} {contact.restitution:g}"
            for contact in self.scene.contacts
            if contact.mode is ContactMode.SUSTAINED
            and contact.restitution
            and (is_users or contact.restitution in given)
            and contact.first
            and contact.second
        ]
        if not pairs:
            return ""
        fix = "" if self.asset else ': set mode = "impact" in the contact to use it'
        return f"{self.name}: restitution has no effect in sustained contacts ({first_names(pairs, 3)}){fix}"

    @property
    def model_file(self) -> Path | None:
        """Model file of an engine that replaces the scene, or None."""
        if self.asset is None or self.asset.kind is not AssetKind.MODEL:
            return None
        return self.asset.path
