"""Read experiment files: a user's own experiment on a USD layer (format: docs/assets.md).

The USD layer states the scene. A short TOML file beside it states the duration, the observable, the reference and where
the numbers are from.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from gauge_envs.errors import AssetError, TaskFileError
from gauge_envs.experiments.experiment import (
    ASSET_NAME,
    EXPERIMENT_NAME,
    Asset,
    AssetKind,
    Experiment,
    driver_provenance,
)
from gauge_envs.experiments.scene_source import check_fit, contents_sha256, read_bytes
from gauge_envs.experiments.tables import (
    Camera,
    DriverSpec,
    Fraction,
)
from gauge_envs.experiments.task_files import task_file_error
from gauge_envs.experiments.task_format import MarkersSpec, ScoreSpec
from gauge_envs.files import toml_document
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.references.metrics import METRICS, BaselineMetric
from gauge_envs.references.published import PUBLISHED_ENGINES, Baseline, Reference
from gauge_envs.references.tables import FileModel
from gauge_envs.scene import Contact, ContactMode, Markers, Motion, Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import NonNegative, Positive, Vector
from gauge_envs.scene.timing import FRAME_RATE_HZ, MOST_FRAMES
from gauge_envs.tools.usd.band_table import BandTable, read_band
from gauge_envs.tools.usd.reader import read_points, read_usd


class PairSpec(FileModel):
    """Constants of the contact of two bodies that replace those of the USD layer."""

    bodies: tuple[str, str]
    friction: NonNegative | None = None
    restitution: Fraction | None = None
    mode: ContactMode | None = None


class FileMarkersSpec(MarkersSpec):
    """Markers on deformable bodies: listed here, or the points of a prim of the layer.

    Attributes:
        prim: Path of a Points or Mesh prim, in place of `positions_m`.
    """

    positions_m: tuple[Vector, ...] = ()
    prim: str | None = None

    @model_validator(mode="after")
    def _indices(self) -> FileMarkersSpec:
        if bool(self.positions_m) == (self.prim is not None):
            raise ValueError("one of prim and positions_m is expected")
        # The number of points of a prim is known when the layer is read. Indices are checked there.
        return self


class BaselineSpec(FileModel):
    """Score of real trials against their own mean, in the unit of the metric; scores are divided by the mean."""

    mean: Positive
    std: NonNegative | None = None


class ExperimentFile(FileModel):
    """One experiment file.

    Attributes:
        name: Short name; the id of results is `GAUGE/Asset-<name>`.
        title: Title for reports.
        summary: One sentence about the motion.
        evaluates: Physical effects that it tests.
        usd: USD layer, relative to the file.
        frames: Number of 30 Hz frames, the first included.
        friction: The coefficient of USD that counts if its two differ; None makes a difference an error.
        score: Observable, metrics and period_axis, as in a task file.
        recorded: Bodies whose positions are observed, by prim path or name; empty if markers are observed.
        markers: Markers on deformable bodies that replace those of the layer.
        contacts: Constants of single pairs.
        drivers: Motion of kinematic bodies that the layer does not animate.
        band: Mean and scatter to score against; without a band there is no distance to reality.
        baseline: Scores of real trials, by metric.
        camera: Where pictures are taken from; without one, it shows the start and the ends of driven motion.
        provenance: Origin of the numbers, by topic.
    """

    name: Annotated[str, Field(pattern=f"^{EXPERIMENT_NAME}$")]
    title: str
    summary: str = ""
    evaluates: tuple[str, ...] = ()
    usd: str
    frames: Annotated[int, Field(ge=2, le=MOST_FRAMES)]
    friction: Literal["dynamic", "static"] | None = None
    score: ScoreSpec
    recorded: tuple[str, ...] = ()
    markers: FileMarkersSpec | None = None
    contacts: tuple[PairSpec, ...] = ()
    drivers: tuple[DriverSpec, ...] = ()
    band: BandTable | None = None
    baseline: dict[BaselineMetric, BaselineSpec] = Field(default_factory=dict)
    camera: Camera | None = None
    provenance: dict[str, str] = Field(min_length=1)


@dataclass(frozen=True, kw_only=True)
class FileExperiment(Experiment):
    """The experiment of an experiment file.

    Attributes:
        definition: Content of the file.
    """

    definition: ExperimentFile

    @property
    def camera(self) -> Camera | None:
        """Camera of the file, or None."""
        return self.definition.camera


def load_experiment_file(path: str | PathLike[str]) -> FileExperiment:
    """Read an experiment file, and the USD layer and the band that it names.

    Raises:
        TaskFileError: The file is not TOML, or has an unknown key or a value out of range.
        AssetError: The USD layer cannot be read, or lacks a prim that the file names.
        ReferenceFileError: The band is damaged.
    """
    path = Path(path)
    content = read_bytes(path)
    try:
        definition = ExperimentFile.model_validate(toml_document(content))
    except ValidationError as error:
        raise task_file_error(path, error) from error
    except ValueError as error:
        raise TaskFileError(path, None, str(error)) from error
    layer = path.parent / definition.usd
    scene, recorded, used_files = _scene(path, layer, definition)
    contents = [content, read_bytes(layer), *map(read_bytes, used_files)]
    if definition.band is not None:
        contents.append(read_bytes(path.parent / definition.band.file))
    experiment = _file_experiment(
        definition.model_copy(update={"recorded": recorded}),
        scene,
        None,
        asset=Asset(
            path=path, kind=AssetKind.EXPERIMENT, sha256=contents_sha256(contents)
        ),
        file_sha256=contents_sha256(contents),
    )
    check_fit(experiment, experiment)
    return _with_band(experiment, path)


def _with_band(experiment: FileExperiment, path: Path) -> FileExperiment:
    """Return an experiment with the reference that its file states."""
    table, reference = experiment.definition.band, experiment.reference
    if table is None or reference is None:
        return experiment
    names = experiment.coordinates
    band = read_band(
        path.parent / table.file,
        table,
        unit=experiment.score.observable.unit,
        frame_count=experiment.frame_count,
        width=len(names),
    )
    if band.projection.shape[1] != len(names):
        taken = f"it takes {band.projection.shape[1]} coordinates"
        raise TaskFileError(
            path, "band", f"{taken}, g(t) has {len(names)}: {', '.join(names[:6])}"
        )
    return replace(experiment, reference=replace(reference, band=band))


def _file_experiment(
    definition: ExperimentFile,
    scene: Scene,
    band: Band | None,
    *,
    asset: Asset,
    file_sha256: str,
) -> FileExperiment:
    name = f"{ASSET_NAME}-{definition.name}"
    unit = definition.score.observable.unit
    baselines: dict[str, Baseline] = {
        metric: Baseline(
            variant=name,
            metric=metric,
            frames=definition.frames,
            unit=METRICS[metric].unit_of(unit),
            mean=stated.mean,
            std=stated.std,
            engines=dict.fromkeys(PUBLISHED_ENGINES),
        )
        for metric, stated in definition.baseline.items()
    }
    return FileExperiment(
        name=name,
        title=definition.title,
        score=definition.score,
        scene=scene,
        recorded=definition.recorded,
        frame_count=definition.frames,
        parameters="calibrated",
        overrides={},
        driver_provenance=driver_provenance(scene),
        file_sha256=file_sha256,
        asset=asset,
        reference=Reference(band=band, baselines=baselines),
        definition=definition,
    )


# --- in a result -----------------------------------------------------------------------------------------------------


def experiment_record(experiment: FileExperiment) -> dict[str, Any]:
    """Return the content and the band of an experiment file for a result, JSON-ready."""
    band = experiment.reference.band if experiment.reference is not None else None
    absent = {"camera"} if experiment.camera is None else None
    return {
        "definition": experiment.definition.model_dump(mode="json", exclude=absent),
        "band": None if band is None else band.to_dict(),
    }


def recorded_experiment_file(
    record: Mapping[str, Any], scene: Scene, *, asset: Asset, file_sha256: str
) -> FileExperiment:
    """Build an experiment from `experiment_record` and its scene."""
    definition = ExperimentFile.model_validate(record["definition"])
    band = None if record["band"] is None else Band.from_dict(record["band"])
    return _file_experiment(
        definition, scene, band, asset=asset, file_sha256=file_sha256
    )


# --- scene -----------------------------------------------------------------------------------------------------------


def _scene(
    path: Path, layer: Path, definition: ExperimentFile
) -> tuple[Scene, tuple[str, ...], tuple[Path, ...]]:
    """Return the layer's scene with the additions of the file, the recorded bodies, and the layer's files."""
    duration_s = (definition.frames - 1) / FRAME_RATE_HZ
    has_markers = definition.markers is None
    found = read_usd(
        layer,
        duration_s=duration_s,
        friction=definition.friction,
        has_markers=has_markers,
    )
    scene = replace(found.scene, duration_s=duration_s)
    names = _names(path, layer, found.paths)
    for index, pair in enumerate(definition.contacts):
        scene = _with_pair(path, f"contacts.{index}", scene, names, pair)
    scene = replace(
        scene,
        drivers=(*scene.drivers, *_drivers(path, names, scene, definition.drivers)),
    )
    if definition.markers is not None:
        scene = replace(scene, markers=_markers(path, layer, names, definition.markers))
    if (definition.score.observable is Observable.POSITION) != bool(
        definition.recorded
    ):
        needed = (
            "recorded bodies"
            if not definition.recorded
            else "no recorded bodies, but markers"
        )
        raise TaskFileError(
            path,
            "recorded",
            f"observable {definition.score.observable.value!r} needs {needed}",
        )
    return (
        scene,
        tuple(names("recorded", name) for name in definition.recorded),
        found.used_files,
    )


Names = Callable[[str, str], str]
"""Function that returns the name of a body for the key that states it, and the stated name or prim path."""


def _names(path: Path, layer: Path, paths: Mapping[str, str]) -> Names:
    known = {name: name for name in paths} | {
        prim: name for name, prim in paths.items()
    }

    def name_of(key: str, stated: str) -> str:
        if stated not in known:
            prims = ", ".join(paths.values()) or "none"
            raise AssetError(
                path, key, f"{stated!r} is no body of {layer.name}, which has: {prims}"
            )
        return known[stated]

    return name_of


def _markers(path: Path, layer: Path, names: Names, spec: FileMarkersSpec) -> Markers:
    stated = spec.model_dump(exclude={"prim"})
    if spec.prim is not None:
        try:
            stated["positions_m"] = read_points(layer, spec.prim).tolist()
        except AssetError as error:
            raise AssetError(
                path, "markers.prim", f"{error.place} of {layer.name}: {error.reason}"
            ) from None
    try:
        whole = MarkersSpec.model_validate(stated)
    except ValidationError as error:
        raise task_file_error(path, error, "markers") from error
    bodies = tuple(names("markers.bodies", name) for name in spec.bodies)
    return Markers(**(whole.model_dump() | {"bodies": bodies}))


def _with_pair(
    path: Path, key: str, scene: Scene, names: Names, pair: PairSpec
) -> Scene:
    """Return the scene with the constants of one pair; a contact of several pairs is split."""
    wanted = frozenset(names(f"{key}.bodies", name) for name in pair.bodies)
    changes = pair.model_dump(exclude={"bodies"}, exclude_none=True)
    contacts: list[Contact] = []
    found = False
    for contact in scene.contacts:
        pairs = list(scene.colliding_pairs(contact))
        if not any(frozenset(one) == wanted for one in pairs):
            contacts.append(contact)
            continue
        found = True
        for first, second in pairs:
            one = replace(contact, first=(first,), second=(second,))
            contacts.append(
                replace(one, **changes) if frozenset((first, second)) == wanted else one
            )
    if not found:
        raise AssetError(
            path,
            f"{key}.bodies",
            f"{' and '.join(sorted(wanted))} do not collide in the USD layer",
        )
    return replace(scene, contacts=tuple(contacts))


def _drivers(
    path: Path, names: Names, scene: Scene, specs: Sequence[DriverSpec]
) -> list[Driver]:
    drivers = []
    for index, spec in enumerate(specs):
        key = f"drivers.{index}"
        body = scene.body(names(f"{key}.body", spec.body))
        if body.motion is not Motion.KINEMATIC:
            raise AssetError(
                path,
                f"{key}.body",
                f"{body.name} is {body.motion.value} in the USD layer, not kinematic",
            )
        if any(driver.body == body.name for driver in scene.drivers):
            raise AssetError(
                path, f"{key}.body", f"{body.name} is animated in the USD layer already"
            )
        if not isinstance(spec.provenance, str):
            raise TaskFileError(
                path,
                f"{key}.provenance",
                "one word is expected: there are no materials here",
            )
        drivers.append(spec.build(body.name, body.pose, spec.provenance))
    return drivers
