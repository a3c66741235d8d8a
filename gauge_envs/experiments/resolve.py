"""Load an experiment: a variant of the package, a variant with the scene of a file, or an experiment file."""

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TypeVar

from gauge_envs.errors import ParameterError, chosen
from gauge_envs.experiments.experiment import (
    ASSET_NAME,
    Experiment,
    TaskExperiment,
    driver_provenance,
)
from gauge_envs.experiments.scene_builder import (
    Parameters,
    SceneBuilder,
    parameter_overrides,
)
from gauge_envs.experiments.scene_source import RECORDED_SUFFIX, with_asset
from gauge_envs.experiments.task_files import task_sha256, task_spec
from gauge_envs.experiments.task_format import Placement
from gauge_envs.experiments.variants import (
    Variant,
    find_subject,
    find_variant,
    task_path,
)
from gauge_envs.references.imported import load_imported, recorded_drivers
from gauge_envs.references.single_shot import SingleShots, single_shots
from gauge_envs.references.user_data import DataSource
from gauge_envs.registry import scene_files
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import vector

AnyExperiment = TypeVar("AnyExperiment", bound=Experiment)


def shots_of(experiment: Experiment) -> SingleShots | None:
    """Return the single-shot trials that an experiment starts from, or None.

    An experiment whose start was replaced, by an override or by a file, has none.
    """
    return None if experiment.trial is None else single_shots(experiment.name)


def with_trial(experiment: AnyExperiment, trial: int) -> AnyExperiment:
    """Return an experiment with the measured start of a single-shot trial.

    Args:
        experiment: An experiment with single-shot trials.
        trial: Number of the trial, from 0.
    """
    shots = single_shots(experiment.name)
    if shots is None:
        raise ParameterError(f"{experiment.id} has no single-shot trials")
    return replace(
        experiment, scene=_started(experiment.scene, shots, trial), trial=trial
    )


def _started(scene: Scene, shots: SingleShots, trial: int) -> Scene:
    shot = shots.shot(trial)
    w, x, y, z = shot.quaternions[0].tolist()
    started = replace(
        scene.body(shot.body),
        pose=Pose(position_m=vector(shot.positions_m[0]), quaternion=(w, x, y, z)),
        linear_velocity_m_per_s=vector(shot.velocity_m_per_s),
        angular_velocity_rad_per_s=vector(shot.angular_velocity_rad_per_s),
    )
    return replace(
        scene,
        bodies=tuple(started if one.name == shot.body else one for one in scene.bodies),
    )


# --- single-shot trials -----------------------------------------------------------------------------------------------


START_KEYS = set(Placement.model_fields)
"""Overrides that state the start of a body."""


def load_experiment(
    variant: str | Variant,
    parameters: Parameters = "calibrated",
    *,
    drivers: DataSource | str = DataSource.BUNDLED,
    reference: DataSource | str = DataSource.BUNDLED,
) -> TaskExperiment:
    """Load one variant from its task file.

    Args:
        variant: Variant, its name, or its Gymnasium id.
        parameters: `calibrated`, another parameter set of the task file, or overrides keyed `body.constant`, where a
            constant is a mass, friction, stiffness, ... or `position_m`, `euler_deg`, `hangs_from_m`, `length_m`. In a
            scene with cloth, `air.density_kg_per_m3` and the other fields of `scene.Air` add air.
        drivers: `bundled` takes driven motion from the task file, `imported` from the imported trials. With `action`
            driven bodies rest until actions move them, at most as fast as the bundled motion and its actions do.
        reference: `bundled` scores against the band or law of the package, `imported` against the imported trials.

    Returns:
        The experiment. Its `drivers` are `imported` only where the imported trials show a driven body. One with
        single-shot trials starts as trial 0, unless overrides state a start.

    Raises:
        UnknownNameError: There is no such variant.
        ParameterError: There is no such parameter set, body, constant or data source, a value is out of range, or
            `imported` is given and no trials of the variant were imported.
        TaskFileError: The task file is wrong.
        ReferenceFileError: The imported trials are damaged.

    Example:
        >>> from gauge_envs import load_experiment
        >>> experiment = load_experiment("SlopeSlider-2-wood", {"cube.friction": 0.3})
        >>> experiment.frame_count, experiment.parameters, experiment.coordinates
        (19, 'custom', ('cube.x', 'cube.y', 'cube.z'))
    """
    if isinstance(variant, str):
        variant = find_variant(variant)
    path, spec = task_path(variant.family), task_spec(variant.family)
    label, overrides = parameter_overrides(spec, variant, parameters)
    builder = SceneBuilder(path, spec, variant, overrides)
    if isinstance(parameters, str):
        # A set of the file may state a constant that only some subtasks read.
        read = builder.constants_read | {
            key for key in overrides if not builder.is_constant(key)
        }
        overrides = {key: value for key, value in overrides.items() if key in read}
    else:
        builder.check_read(overrides)
    scene = builder.build()
    subtask = spec.subtasks[variant.subtask] if variant.subtask else None
    experiment = TaskExperiment(
        name=variant.name,
        title=spec.title if subtask is None else f"{spec.title}, {subtask.title}",
        score=spec.score,
        variant=variant,
        spec=spec,
        scene=scene,
        recorded=tuple(
            b.name
            for b in scene.bodies
            if spec.bodies[builder.spec_name(b.name)].recorded
        ),
        frame_count=builder.frame_count,
        parameters=label,
        overrides=overrides,
        driver_provenance=driver_provenance(scene),
        reference_source=_data_source(variant, "reference", reference),
        file_sha256=task_sha256(variant.family),
        revision=spec.revision,
    )
    if (
        single_shots(variant.name) is not None
        and not {key.rpartition(".")[2] for key in overrides} & START_KEYS
    ):
        experiment = with_trial(experiment, 0)
    source = _data_source(variant, "drivers", drivers)
    if source is DataSource.BUNDLED or not scene.drivers:
        return experiment
    if source is DataSource.ACTION:
        return replace(
            experiment,
            scene=moved_by_actions(experiment.scene),
            drivers=source,
            driver_provenance="action",
        )
    recorded = recorded_drivers(variant.name, scene.drivers)
    if recorded == scene.drivers:
        return experiment
    driven = replace(scene, drivers=recorded)
    return replace(
        experiment,
        scene=driven,
        drivers=DataSource.IMPORTED,
        driver_provenance=driver_provenance(driven),
    )


def moved_by_actions(scene: Scene) -> Scene:
    """Return a scene whose driven bodies rest until actions move them.

    An action of 1 is the largest rate of the recorded motion and its actions together, so that every recorded motion
    is a sequence of actions.
    """
    drivers = []
    for driver in scene.drivers:
        motions = tuple(
            replace(motion, residual_rate=motion.largest_rate, profiles=())
            for motion in driver.motions
        )
        drivers.append(replace(driver, motions=motions, provenance="action"))
    return replace(scene, drivers=tuple(drivers))


def load_experiment_from_asset(
    variant: str | Variant,
    asset: str | PathLike[str],
    *,
    reference: DataSource | str = DataSource.BUNDLED,
) -> TaskExperiment:
    """Load one variant with the scene of a file; the file states constants and driven motion.

    Args:
        variant: Variant, its name, or its Gymnasium id: what is observed, and what it is scored against.
        asset: USD layer for any engine, or model file of one engine, as MJCF for MuJoCo.
        reference: As for `load_experiment`.

    Raises:
        UnknownNameError: There is no such variant.
        ParameterError: There is no such data source, or no trials of the variant were imported.
        AssetError: The file cannot be read, or does not fit the variant.
    """
    return with_asset(load_experiment(variant, reference=reference), Path(asset))


def resolve_experiment(
    subject: str | Variant,
    parameters: Parameters = "calibrated",
    *,
    drivers: DataSource | str = DataSource.BUNDLED,
    reference: DataSource | str = DataSource.BUNDLED,
    asset: str | PathLike[str] | None = None,
) -> Experiment:
    """Load the experiment that arguments of `gymnasium.make` or of the command line name.

    Args:
        subject: Variant, name or id; `GAUGE/Asset`; or the path of an experiment file, as `crate.toml`, or of a task
            file with one variant.
        parameters: As for `load_experiment`.
        drivers: As for `load_experiment`.
        reference: As for `load_experiment`.
        asset: File of `load_experiment_from_asset`; or, for `GAUGE/Asset`, an experiment file.
    """
    path = None if asset is None else Path(asset)
    if isinstance(subject, str) and subject.removeprefix("GAUGE/") == ASSET_NAME:
        if path is None:
            raise ParameterError(
                f"GAUGE/{ASSET_NAME} needs an experiment file, as asset='crate.toml'"
            )
        subject, path = str(path), None
    if isinstance(subject, str):
        subject = find_subject(subject)
    if isinstance(subject, str):
        if path is not None:
            raise ParameterError(
                f"{subject} names its own USD layer; remove asset={str(asset)!r}"
            )
        _check_stated(Path(subject), parameters, drivers)
        if chosen(DataSource, reference, "reference") is not DataSource.BUNDLED:
            raise ParameterError(
                f"reference {str(reference)!r} with {subject}: the file states its own band"
            )
        return scene_files(RECORDED_SUFFIX).load_experiment_file(subject)
    if path is None:
        return load_experiment(
            subject, parameters, drivers=drivers, reference=reference
        )
    _check_stated(path, parameters, drivers)
    return load_experiment_from_asset(subject, path, reference=reference)


def _check_stated(
    path: Path, parameters: Parameters, drivers: DataSource | str
) -> None:
    """Raise an error for arguments about content that an asset states."""
    if parameters and parameters != "calibrated":
        raise ParameterError(
            f"parameters {parameters!r} with {path.name}: the file states the constants; edit them there"
        )
    if chosen(DataSource, drivers, "drivers") is not DataSource.BUNDLED:
        raise ParameterError(
            f"drivers {str(drivers)!r} with {path.name}: the file states the motion of driven bodies"
        )


def _data_source(variant: Variant, name: str, value: DataSource | str) -> DataSource:
    if name == "reference" and value not in (DataSource.BUNDLED, DataSource.IMPORTED):
        raise ParameterError(
            f"reference {str(value)!r}: choose 'bundled' or 'imported'"
        )
    source = chosen(DataSource, value, name)
    if source is DataSource.IMPORTED and load_imported(variant.name) is None:
        raise ParameterError(
            f"{variant.name}: {name}='imported', but no trials of it were imported; "
            f"run `gauge data import DIR`, or use {name}='bundled'"
        )
    return source
