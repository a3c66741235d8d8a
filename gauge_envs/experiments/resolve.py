"""Load an experiment: a variant with the scene of its task file or of an asset."""

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from gauge_envs.errors import ParameterError, TaskFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.scene_builder import (
    Parameters,
    SceneBuilder,
    parameter_overrides,
)
from gauge_envs.experiments.scene_source import with_asset
from gauge_envs.experiments.task_files import task_sha256, task_spec
from gauge_envs.experiments.task_format import Placement
from gauge_envs.experiments.variants import Variant, find_variant, task_path
from gauge_envs.references.imported import load_imported, recorded_drivers
from gauge_envs.references.single_shot import SingleShots, single_shots
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.states import nominal_states, row_of, scene_at
from gauge_envs.validation import chosen


def load_experiment(
    variant: str | Variant,
    parameters: Parameters = "published",
    *,
    drivers: DataSource | str = DataSource.BUNDLED,
    reference: DataSource | str = DataSource.BUNDLED,
    asset: str | PathLike[str] | None = None,
) -> Experiment:
    """Load one variant with the scene of its task file or of an asset.

    Args:
        variant: Variant, its name, its Gymnasium id, or the path of a task file with one variant, as `crate.toml`.
        parameters: `published`, another parameter set of the task file, or overrides keyed `body.constant`, where a
            constant is a mass, friction, stiffness, ... or `position_m`, `euler_deg`, `hangs_from_m`, `length_m`. In a
            scene with cloth, `air.density_kg_per_m3` and the other fields of `scene.Air` add air.
        drivers: `bundled` takes driven motion from the task file, `imported` from the imported trials. With `action`
            driven bodies rest until actions move them, at most as fast as the bundled motion and its actions do.
        reference: `bundled` scores against the reference of the package, `imported` against the imported trials.
        asset: USD layer for any engine, or model file of one engine, as MJCF for MuJoCo. It has the scene with its
            constants and driven motion; observation and reference stay those of the variant.

    Returns:
        The experiment. Its `drivers` are `imported` only if the imported trials show a driven body. With single-trial
        recordings it starts as trial 0, unless overrides set an initial state.

    Raises:
        UnknownNameError: There is no such variant.
        ParameterError: There is no such parameter set, body, constant or data source, or a value is out of range. Or
            `imported` is given without imported trials of the variant.
        TaskFileError: The task file is wrong.
        AssetError: The asset cannot be read, or does not fit the variant.
        ReferenceFileError: The imported trials are damaged.

    Example:
        >>> from gauge_envs import load_experiment
        >>> experiment = load_experiment("SlopeSlider-2-wood", {"cube.friction": 0.3})
        >>> experiment.frame_count, experiment.parameters, experiment.coordinates
        (19, 'custom', ('cube.x', 'cube.y', 'cube.z'))
    """
    if isinstance(variant, str):
        variant = find_variant(variant)
    spec = task_spec(variant.family)
    label, overrides = parameter_overrides(spec, variant, parameters)
    scene, overrides = _built(variant, label, overrides)
    experiment = Experiment(
        variant=variant,
        spec=spec,
        scene=scene,
        recorded=_recorded(variant, scene),
        frame_count=spec.frame_count(variant),
        parameters=label,
        overrides=overrides,
        reference_source=_data_source(variant, "reference", reference),
        file_sha256=task_sha256(variant.family),
    )
    overrides_start = any(
        key.rpartition(".")[2] in Placement.model_fields for key in overrides
    )
    if single_shots(variant.name) is not None and not overrides_start:
        experiment = with_trial(experiment, 0)
    if asset is not None:
        _check_arguments_of_asset(Path(asset), parameters, drivers)
        return with_asset(experiment, Path(asset))
    return _driven(experiment, _data_source(variant, "drivers", drivers))


def _built(
    variant: Variant, label: str, overrides: dict[str, Any]
) -> tuple[Scene, dict[str, Any]]:
    """Return the scene of a variant with overrides, and the overrides that it uses."""
    try:
        builder = SceneBuilder(task_spec(variant.family), variant, overrides)
        scene = builder.build()
        if label == "custom":
            builder.check_read(overrides)
    except ValueError as error:
        if overrides and isinstance(error, ParameterError):
            raise ParameterError(f"{variant.name}: {error}") from error
        raise TaskFileError(task_path(variant.family), None, str(error)) from error
    # A parameter set of the file may have a constant that only some subtasks use.
    return scene, {
        key: value
        for key, value in overrides.items()
        if key in builder.read or not builder.is_constant(key)
    }


def _recorded(variant: Variant, scene: Scene) -> tuple[str, ...]:
    """Return the names of the recorded bodies, which forces move."""
    spec, path = task_spec(variant.family), task_path(variant.family)
    recorded = [
        body for body in scene.bodies if spec.bodies[spec.entry(body.name)].recorded
    ]
    for body in recorded:
        if body.motion is not Motion.DYNAMIC:
            raise TaskFileError(
                path,
                f"bodies.{body.name}",
                f"its motion is {body.motion}, but recorded bodies are dynamic",
            )
    if not recorded and scene.markers is None:
        raise TaskFileError(
            path,
            "bodies",
            "no body is recorded: add recorded = true to a dynamic body",
        )
    return tuple(body.name for body in recorded)


def _check_arguments_of_asset(
    asset: Path, parameters: Parameters, drivers: DataSource | str
) -> None:
    """Raise an error for arguments that contradict the content of an asset."""
    if parameters and parameters != "published":
        raise ParameterError(
            f"parameters {parameters!r} with {asset.name}: the file has the constants; edit them there"
        )
    if drivers != DataSource.BUNDLED:
        raise ParameterError(
            f"drivers {str(drivers)!r} with {asset.name}: the file has the motion of driven bodies; edit it there"
        )


def _data_source(variant: Variant, name: str, value: DataSource | str) -> DataSource:
    if name == "reference" and value not in (DataSource.BUNDLED, DataSource.IMPORTED):
        raise ParameterError(
            f"reference {str(value)!r}: choose 'bundled' or 'imported'"
        )
    source = chosen(DataSource, value, name)
    if source is DataSource.IMPORTED and load_imported(variant.name) is None:
        raise ParameterError(
            f"{variant.name}: {name}='imported', but it has no imported trials; "
            f"run `gauge data import DIR`, or use {name}='bundled'"
        )
    return source


# --- driven motion ---------------------------------------------------------------------------------------------------


def _driven(experiment: Experiment, source: DataSource) -> Experiment:
    """Return an experiment with the driven motion of a source."""
    scene = experiment.scene
    if source is DataSource.BUNDLED or not scene.drivers:
        return experiment
    if source is DataSource.ACTION:
        return replace(experiment, scene=moved_by_actions(scene), drivers=source)
    recorded = recorded_drivers(experiment.name, scene.drivers)
    if recorded == scene.drivers:
        return experiment
    driven = replace(scene, drivers=recorded)
    return replace(experiment, scene=driven, drivers=source)


def moved_by_actions(scene: Scene) -> Scene:
    """Return a scene whose driven bodies rest until actions move them.

    An action of 1 is the largest rate of the recorded motion plus that of its actions. So every recorded motion is a
    sequence of actions.
    """
    drivers = []
    for driver in scene.drivers:
        motions = tuple(
            replace(motion, residual_rate=motion.largest_rate, profiles=())
            for motion in driver.motions
        )
        drivers.append(replace(driver, motions=motions, provenance="action"))
    return replace(scene, drivers=tuple(drivers))


# --- single-trial recordings -----------------------------------------------------------------------------------------


def shots_of(experiment: Experiment) -> SingleShots | None:
    """Return the single-trial recordings from which an experiment starts, or None.

    An experiment has none if an override or a file replaced its initial state.
    """
    return None if experiment.trial is None else single_shots(experiment.name)


def with_trial(experiment: Experiment, trial: int) -> Experiment:
    """Return an experiment with the measured initial state of a single-trial recording.

    Args:
        experiment: An experiment with single-trial recordings.
        trial: Number of the trial, from 0.
    """
    shots = single_shots(experiment.name)
    if shots is None:
        raise ParameterError(f"{experiment.id} has no single-trial recordings")
    shot, scene = shots.shot(trial), experiment.scene
    states = nominal_states(scene)
    states[row_of(scene, shot.body)] = shot.start
    return replace(experiment, scene=scene_at(scene, states), trial=trial)
