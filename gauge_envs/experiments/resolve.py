"""One experiment, experiment: task file + parameters, or an asset -> scene, and how it is observed and scored."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import overload

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.experiment import (
    ASSET_NAME,
    Experiment,
    TaskExperiment,
    driver_provenance,
)
from gauge_envs.experiments.scene_builder import Parameters, SceneBuilder, parameter_overrides
from gauge_envs.experiments.task_files import find_variant, task_path, task_sha256, task_spec
from gauge_envs.experiments.task_format import Variant
from gauge_envs.references.imported import DriverSource, chosen_drivers, recorded_drivers
from gauge_envs.scene import (
    Scene,
)

__all__ = [
    "load_experiment",
]


@overload
def load_experiment(
    name: Variant,
    parameters: Parameters = "calibrated",
    *,
    drivers: str | None = None,
    asset: str | PathLike[str] | None = None,
) -> TaskExperiment: ...


@overload
def load_experiment(
    name: str,
    parameters: Parameters = "calibrated",
    *,
    drivers: str | None = None,
    asset: str | PathLike[str] | None = None,
) -> Experiment: ...


def load_experiment(
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
    from gauge_envs.experiments.scene_source import is_experiment_file, with_asset
    from gauge_envs.experiments.user_file import load_experiment_file

    path = None if asset is None else Path(asset)
    if isinstance(name, str) and name.removeprefix("GAUGE/") == ASSET_NAME:
        if path is None:
            raise ParameterError(f"GAUGE/{ASSET_NAME} is what an experiment file states: asset='crate.toml'")
        name, path = str(path), None
    if isinstance(name, str) and is_experiment_file(Path(name)):
        if path is not None:
            raise ParameterError(f"{name} names its own USD layer; it goes without asset={str(asset)!r}")
        _check_stated(Path(name), parameters, drivers)
        return load_experiment_file(Path(name))
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
    label, overrides = parameter_overrides(spec, variant, parameters)
    builder = SceneBuilder(path, spec, variant, overrides)
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
