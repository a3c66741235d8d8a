"""One experiment, resolved: task file + parameters, or an asset -> scene, and how it is observed and scored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from os import PathLike
from pathlib import Path
from typing import Any, overload

from pydantic import ValidationError

from gauge_envs.asset import Asset, AssetKind
from gauge_envs.dataset.store import chosen_drivers, recorded_drivers
from gauge_envs.driver import Driver, DriverSource
from gauge_envs.errors import ParameterError, TaskFileError
from gauge_envs.reference import Baseline, Reference, published_baselines
from gauge_envs.scene import (
    Attachment,
    Box,
    Cloth,
    Contact,
    Deformable,
    Hinge,
    Markers,
    Motion,
    Region,
    RigidBody,
    Rod,
    Rope,
    Scene,
    SoftBody,
    Tether,
)
from gauge_envs.task import find_variant, task_path, task_sha256, task_spec
from gauge_envs.task_format import FRAME_RATE_HZ, JointSpec, Placement, ScoreSpec, TaskSpec, Variant

__all__ = ["ASSET_NAME", "Experiment", "Parameters", "TaskExperiment", "driver_provenance", "experiment"]

ASSET_NAME = "Asset"
"""Name, and after `GAUGE/` the Gymnasium id, under which experiment files run."""

Parameters = str | Mapping[str, Any]
"""`calibrated`, the name of another parameter set of the task file, or overrides such as `{"cube.friction": 0.3}`."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One experiment, resolved: its scene, and how it is observed and scored.

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
    drivers: DriverSource = DriverSource.BUNDLED
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
    def edited(self) -> bool:
        """Whether the scene is that of an asset which differs from the calibrated one."""
        return self.asset is not None and self.asset.edited

    @property
    def model_file(self) -> Path | None:
        """File in an engine's own format that stands for the scene; None where there is none."""
        return self.asset.path if self.asset is not None and self.asset.kind is AssetKind.MODEL else None


@dataclass(frozen=True, kw_only=True)
class TaskExperiment(Experiment):
    """One variant of a task file, resolved.

    Attributes:
        variant: Which one.
        spec: Its task file.
    """

    variant: Variant
    spec: TaskSpec


@overload
def experiment(
    name: Variant,
    parameters: Parameters = "calibrated",
    *,
    drivers: str | None = None,
    asset: str | PathLike[str] | None = None,
) -> TaskExperiment: ...


@overload
def experiment(
    name: str,
    parameters: Parameters = "calibrated",
    *,
    drivers: str | None = None,
    asset: str | PathLike[str] | None = None,
) -> Experiment: ...


def experiment(
    name: str | Variant,
    parameters: Parameters = "calibrated",
    *,
    drivers: str | None = None,
    asset: str | PathLike[str] | None = None,
) -> Experiment:
    """Resolve one experiment.

    Args:
        name: Variant, its name, or its Gymnasium id; or an experiment file of the user's own, as `crate.toml`.
        parameters: `calibrated`, another parameter set of the task file, or overrides keyed `body.constant`, where a
            constant is a mass, friction, stiffness, ... or `position_m`, `euler_deg`, `hangs_from_m`, `length_m`.
        drivers: `imported` drives bodies as imported trials show, where there are some; `bundled` as the task file
            states. None takes what `gauge data use` chose, `imported` unless it was asked otherwise.
        asset: File that the scene is from: a USD layer, or a model file of an engine, as MJCF. It states constants and
            driven motion itself, so `parameters` and `drivers` are for experiments without one. For the name `Asset`
            it is an experiment file.

    Raises:
        UnknownNameError: No such variant.
        ParameterError: No such parameter set, body, constant or kind of drivers, or a value out of range; or they
            come with an asset.
        TaskFileError: The task file is wrong.
        ReferenceFileError: The imported drivers, or the band of an experiment file, are damaged.
        AssetError: The asset cannot be read, or does not fit the variant.
    """
    from gauge_envs.asset import is_experiment_file, with_asset
    from gauge_envs.experiment_file import load_experiment

    path = None if asset is None else Path(asset)
    if isinstance(name, str) and name.removeprefix("GAUGE/") == ASSET_NAME:
        if path is None:
            raise ParameterError(f"GAUGE/{ASSET_NAME} is what an experiment file states: asset='crate.toml'")
        name, path = str(path), None
    if isinstance(name, str) and is_experiment_file(Path(name)):
        if path is not None:
            raise ParameterError(f"{name} names its own USD layer; it goes without asset={str(asset)!r}")
        _check_stated(Path(name), parameters, drivers)
        return load_experiment(Path(name))
    variant = find_variant(name) if isinstance(name, str) else name
    if path is None:
        return _of_task(variant, parameters, drivers)
    _check_stated(path, parameters, drivers)
    return with_asset(_of_task(variant, "calibrated", DriverSource.BUNDLED), path)


def _check_stated(path: Path, parameters: Parameters, drivers: str | None) -> None:
    """Refuse what an asset states itself."""
    if parameters and parameters != "calibrated":
        raise ParameterError(f"parameters {parameters!r} with {path.name}: it states the constants; edit them there")
    if drivers is not None and drivers != DriverSource.BUNDLED:
        raise ParameterError(f"drivers {drivers!r} with {path.name}: the motion of driven bodies is the file's")


def _of_task(variant: Variant, parameters: Parameters, drivers: str | None) -> TaskExperiment:
    path, spec = task_path(variant.family), task_spec(variant.family)
    label, overrides = _overrides(spec, variant, parameters)
    builder = _SceneBuilder(path, spec, variant, overrides)
    scene, source = _driven(variant, builder.build(), drivers)
    subtask = spec.subtasks[variant.subtask] if variant.subtask else None
    return TaskExperiment(
        name=variant.name,
        title=spec.title if subtask is None else f"{spec.title}, {subtask.title}",
        score=spec.score,
        variant=variant,
        spec=spec,
        scene=scene,
        recorded=tuple(b.name for b in scene.bodies if spec.bodies[builder.spec_name(b.name)].recorded),
        frame_count=builder.frame_count,
        parameters=label,
        overrides=overrides,
        driver_provenance=driver_provenance(scene),
        drivers=source,
        file_sha256=task_sha256(variant.family),
    )


def driver_provenance(scene: Scene) -> str | None:
    """Where the driven motion of a scene is from; None where nothing is driven."""
    return ", ".join(sorted({driver.provenance for driver in scene.drivers})) or None


def _driven(variant: Variant, scene: Scene, asked: str | None) -> tuple[Scene, DriverSource]:
    """The scene with the drivers that were asked for, and whether any of them is imported."""
    if asked is not None and asked not in list(DriverSource):
        known = " or ".join(repr(source.value) for source in DriverSource)
        raise ParameterError(f"drivers {asked!r}: choose {known}")
    if not scene.drivers or asked == DriverSource.BUNDLED:
        return scene, DriverSource.BUNDLED
    if asked is None and chosen_drivers() is DriverSource.BUNDLED:
        return scene, DriverSource.BUNDLED
    drivers = recorded_drivers(variant.name, scene.drivers)
    if drivers == scene.drivers:
        return scene, DriverSource.BUNDLED
    return replace(scene, drivers=drivers), DriverSource.IMPORTED


def _overrides(spec: TaskSpec, variant: Variant, parameters: Parameters) -> tuple[str, dict[str, Any]]:
    if isinstance(parameters, Mapping):
        return ("custom" if parameters else "calibrated"), dict(parameters)
    if parameters == "calibrated":
        return parameters, {}
    if parameters not in spec.parameters:
        known = ", ".join(["calibrated", *spec.parameters])
        raise ParameterError(f"{variant.name} has no parameter set {parameters!r}; it has: {known}")
    values = spec.parameters[parameters].values
    return parameters, {k: v[variant.material] if isinstance(v, dict) else v for k, v in values.items()}


class _SceneBuilder:
    """Puts one variant's scene together from its task file."""

    def __init__(self, path: Path, spec: TaskSpec, variant: Variant, overrides: Mapping[str, Any]) -> None:
        self.path = path
        self.spec = spec
        self.variant = variant
        self.subtask = spec.subtasks[variant.subtask] if variant.subtask else None
        self.present = self.subtask.bodies if self.subtask and self.subtask.bodies else spec.names
        self.placements = self._placements()
        self.constants = {
            name: spec.constants_of(name, spec.owner(name).material or variant.material, variant.subtask)
            for name in self.present
            if name in spec.constants
        }
        for key, value in overrides.items():
            self._override(key, value)
        frames = self.subtask.frames if self.subtask else spec.frames
        try:
            self.frame_count = frames.get(variant.material) or frames["all"]
        except KeyError:
            raise TaskFileError(path, "frames", f"no frame count for {variant.name}") from None

    def _placements(self) -> dict[str, Placement]:
        merged: dict[str, Placement] = {}
        tables = [self.spec.initial] + ([self.subtask.initial] if self.subtask else [])
        for table in tables:
            for material in ("all", self.variant.material):
                merged.update(table.get(material, {}))
        for name in self.present:
            if name not in merged:
                raise TaskFileError(self.path, "initial", f"no start of {name!r} for {self.variant.name}")
        return merged

    def _override(self, key: str, value: Any) -> None:
        name, _, constant = key.rpartition(".")
        if name not in self.present:
            known = ", ".join(self.present)
            raise ParameterError(f"{self.variant.name}: override {key!r} names no body of the scene; bodies: {known}")
        try:
            if constant in Placement.model_fields:
                placed = self.placements[name].model_dump(exclude_none=True) | {constant: value}
                self.placements[name] = Placement.model_validate(placed)
            elif constant in self.constants.get(name, {}):
                self.constants[name] = self.constants[name] | {constant: value}
                self.spec.constants_model(name).model_validate(self.constants[name])
            else:
                known = ", ".join([*self.constants.get(name, {}), *Placement.model_fields])
                raise ParameterError(f"{self.variant.name}: {name!r} has no constant {constant!r}; it has: {known}")
        except ValidationError as error:
            reason = error.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
            raise ParameterError(f"{self.variant.name}: override {key!r} = {value!r}: {reason}") from error

    def spec_name(self, body: str) -> str:
        """Name in the task file of a scene body: counted bodies share one entry."""
        return body if body in self.spec.bodies else body.rpartition("-")[0]

    def build(self) -> Scene:
        bodies = tuple(body for name in self.present if name in self.spec.bodies for body in self._bodies(name))
        poses = {body.name: body.pose for body in bodies}
        names = [*poses, *(n for n in self.present if n not in self.spec.bodies)]
        specs = self.subtask.drivers if self.subtask and self.subtask.drivers is not None else self.spec.drivers
        drivers = tuple(
            Driver(
                body=driver.body,
                motions=tuple(motion.build(poses[driver.body]) for motion in driver.motions),
                provenance=driver.provenance
                if isinstance(driver.provenance, str)
                else driver.provenance[self.variant.material],
            )
            for driver in specs
        )
        for driver in drivers:
            motion = next(body.motion for body in bodies if body.name == driver.body)
            if motion is not Motion.KINEMATIC:
                raise TaskFileError(self.path, "drivers", f"{driver.body!r} is driven but {motion}, not kinematic")
        markers = self.spec.markers
        return Scene(
            bodies=bodies,
            deformables=tuple(self._deformable(name) for name in self.present if name not in self.spec.bodies),
            joints=tuple(self._joint(joint) for joint in self.spec.joints),
            attachments=tuple(
                Attachment(deformable=a.deformable, region=Region(**a.region.model_dump()), to=a.to)
                for a in self.spec.attachments
            ),
            contacts=tuple(self._contacts(names)),
            drivers=drivers,
            markers=None if markers is None else Markers(**markers.model_dump()),
            duration_s=(self.frame_count - 1) / FRAME_RATE_HZ,
        )

    def _bodies(self, name: str) -> Iterator[RigidBody]:
        body = self.spec.bodies[name]
        motion = self.subtask.motion.get(name, body.motion) if self.subtask else body.motion
        poses = self.placements[name].poses()
        if len(poses) != (body.count or 1):
            raise TaskFileError(self.path, f"initial.{name}", f"{len(poses)} positions for {body.count or 1} bodies")
        mass = self.constants.get(name, {}).get("mass_kg") or 0.0
        for index, pose in enumerate(poses):
            yield RigidBody(
                name=f"{name}-{index + 1}" if body.count else name,
                shape=body.shape.build(),
                motion=motion,
                pose=pose,
                mass_kg=mass,
            )

    def _deformable(self, name: str) -> Deformable:
        values: dict[str, Any] = dict(self.constants[name])
        pose = self.placements[name].poses()[0]
        for key in ("friction", "restitution", "density_kg_per_m3"):
            values.pop(key, None)
        if name in self.spec.cloths:
            return Cloth(name=name, pose=pose, size_m=self.spec.cloths[name].size_m, **values)
        if name in self.spec.soft_bodies:
            return SoftBody(name=name, pose=pose, shape=Box(size_m=self.spec.soft_bodies[name].size_m), **values)
        line, kind = (self.spec.ropes[name], Rope) if name in self.spec.ropes else (self.spec.rods[name], Rod)
        return kind(name=name, pose=pose, length_m=line.length_m, radius_m=line.radius_m, **values)

    def _joint(self, joint: JointSpec) -> Hinge | Tether:
        placement = self.placements[joint.body]
        if placement.hangs_from_m is None or placement.length_m is None:
            raise TaskFileError(self.path, "joints", f"the start of {joint.body!r} lacks hangs_from_m")
        if joint.axis is not None:
            return Hinge(body=joint.body, anchor_m=placement.hangs_from_m, axis=joint.axis)
        return Tether(body=joint.body, anchor_m=placement.hangs_from_m, length_m=placement.length_m)

    def _contacts(self, names: Sequence[str]) -> Iterator[Contact]:
        contacts = self.spec.contacts
        if self.subtask and self.subtask.contacts is not None:
            contacts = self.subtask.contacts
        for contact in contacts:
            first, second = (tuple(n for n in names if fnmatchcase(n, pattern)) for pattern in contact.bodies)
            constants = self.constants.get(contact.constants_of, {}) if contact.constants_of else {}
            friction = contact.friction if contact.friction is not None else constants.get("friction")
            restitution = contact.restitution if contact.restitution is not None else constants.get("restitution")
            if friction is None or restitution is None:
                raise TaskFileError(self.path, "contacts", f"{contact.constants_of!r} has no friction or restitution")
            yield Contact(first=first, second=second, friction=friction, restitution=restitution, mode=contact.mode)
