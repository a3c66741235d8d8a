"""Read a target that a user names: the numerical settings with which a policy is trained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import mujoco
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.backends import Simulation, backend, backend_names
from gauge_envs.backends.mujoco import mjcf_probe
from gauge_envs.backends.registry import is_bundled
from gauge_envs.checks.sanity.model import TrainingConfiguration
from gauge_envs.checks.sanity.mujoco_model import mujoco_configuration
from gauge_envs.checks.sanity.readers.dm_control import PREFIX as SUITE_PREFIX
from gauge_envs.checks.sanity.readers.dm_control import suite_task
from gauge_envs.errors import GaugeError, ParameterError, TargetError, first_fault
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import MEGABYTE, child_refusal, json_document, read_regular, toml_document
from gauge_envs.runs.isolation import Worker

__all__ = ["Target", "configuration"]

Target: TypeAlias = str | Path | mujoco.MjModel | gymnasium.Env
"""A target of a sanity check; see `configuration`."""

MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")
SETTINGS_SUFFIXES = (".toml", ".json")

ACCEPTED = (
    "a Gymnasium id with a MuJoCo model (HalfCheetah-v5), a task of dm_control's suite (dm_control:walker/walk), a "
    "model file (.xml, .mjcf, .urdf), a settings file (.toml, .json), or a backend with or without a preset "
    "(mujoco:out_of_box)"
)

TRIAL_VARIANT = "BouncingBall-rubber"
"""Settings are checked on the scene of this variant, which builds fast."""

TRIAL_LIMIT_S = 300.0
"""Time limit of that check in another process [s]."""

MOST_SETTINGS_BYTES = MEGABYTE
"""Largest size of a settings file."""

MOST_MODEL_BYTES = 16 * MEGABYTE
"""Largest size of a model file, without the meshes that it names."""

MODEL_CPU_S = 60
"""Limit of the processor time of loading it; meshes take their time."""


class _SettingsFile(BaseModel):
    """Contents of a settings file: the backend, optionally a preset, and a table of settings."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    backend: str
    preset: str | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


def configuration(
    target: Target | TrainingConfiguration, *, pair: tuple[str, str] | None = None
) -> TrainingConfiguration:
    """Return the training configuration of a target.

    Args:
        target: One of
            a Gymnasium id (`HalfCheetah-v5`) whose environment has a `mujoco.MjModel` as `unwrapped.model`;
            an id of this suite, with its own settings;
            a task of dm_control's suite (`dm_control:walker/walk`), whose model file is read without dm_control;
            a model file that MuJoCo reads;
            a settings file: `backend`, optionally `preset`, and a table `settings`;
            a backend, with or without a preset (`mujoco:out_of_box`, `newton`);
            a `mujoco.MjModel` or a `gymnasium.Env`;
            a configuration, which is returned unchanged.
        pair: Names of two geoms of a model whose contact constants the experiments get, instead of the most frequent
            ones of moving geoms on the ground.

    Raises:
        TargetError: The target cannot be read, or has no such pair of geoms.
        UnknownNameError: There is no such backend or preset.
        ParameterError: A setting does not exist or has an impossible value.
        MissingExtraError: The backend's engine is not installed.
    """
    if isinstance(target, TrainingConfiguration):
        return target
    if isinstance(target, mujoco.MjModel):
        return _of_model(target, name=_model_name(target), source="mujoco.MjModel", pair=pair)
    if isinstance(target, gymnasium.Env):
        return _of_env(target, name=_env_name(target), pair=pair)
    if not isinstance(target, str | Path):
        raise TargetError(f"{type(target).__name__} cannot be checked; give {ACCEPTED}, or a mujoco.MjModel or an env")
    if str(target).startswith(SUITE_PREFIX):
        return _of_suite_task(str(target), pair)
    suffix = Path(target).suffix.lower()
    if suffix in MODEL_SUFFIXES:
        return _of_model_file(Path(target), pair)
    found = _of_settings_file(Path(target)) if suffix in SETTINGS_SUFFIXES else _of_backend(str(target))
    if found is None:
        return _of_id(str(target), pair)
    if pair is not None:
        raise TargetError(f"{target}: pairs of geoms are those of a MuJoCo model, and the target has none")
    return found


# --- MuJoCo models ---------------------------------------------------------------------------------------------------


def _of_model(
    model: mujoco.MjModel,
    *,
    name: str,
    source: str,
    pair: tuple[str, str] | None,
    frame_skip: int | None = None,
) -> TrainingConfiguration:
    read = mujoco_configuration(model, name=name, source=source, pair=pair, frame_skip=frame_skip)
    _check_settings(read.backend, read.settings)
    return read


def _model_name(model: mujoco.MjModel) -> str:
    return model.names.split(b"\0", 1)[0].decode() or "unnamed model"


def _of_model_file(path: Path, pair: tuple[str, str] | None) -> TrainingConfiguration:
    try:
        read_regular(path, MOST_MODEL_BYTES)
    except FileNotFoundError:
        raise TargetError(f"{path}: there is no such file") from None
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    refusal = child_refusal(Path(mjcf_probe.__file__), str(path), cpu_s=MODEL_CPU_S)
    if refusal is not None:
        raise TargetError(f"{path}: {refusal}: simplify the model")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise TargetError(f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    return _of_model(model, name=path.name, source=f"model file {path}", pair=pair)


def _of_suite_task(name: str, pair: tuple[str, str] | None) -> TrainingConfiguration:
    task = suite_task(name)
    read = _of_model_file(task.model, pair)
    return replace(read, name=name, source=task.source, notes=(*task.notes, *read.notes))


def _of_id(name: str, pair: tuple[str, str] | None) -> TrainingConfiguration:
    own = {variant.name: variant.id for variant in variants()}
    try:
        env = gymnasium.make(own.get(name, name))
    except Exception as error:  # Other environments raise exceptions of any kind.
        cause = " ".join(str(error).split())
        raise TargetError(
            f"{name!r}: gymnasium.make fails: {cause} ({type(error).__name__}); give {ACCEPTED}"
        ) from error
    try:
        return _of_env(env, name=name, pair=pair)
    finally:
        env.close()


def _env_name(env: gymnasium.Env) -> str:
    return type(env.unwrapped).__name__ if env.spec is None else env.spec.id


def _of_env(env: gymnasium.Env, *, name: str, pair: tuple[str, str] | None) -> TrainingConfiguration:
    inner: Any = env.unwrapped
    simulation = getattr(inner, "simulation", None)
    if isinstance(simulation, Simulation):
        if pair is not None:
            raise TargetError(f"{name}: an environment of this suite has no geoms to choose from")
        settings = {key: value for key, value in simulation.settings.items() if key != "drive_interval_s"}
        return TrainingConfiguration(
            name=name,
            source="environment of this suite",
            backend=inner.backend_name,
            settings=settings,
            origins=dict.fromkeys(settings, f"settings of {name}"),
        )
    model = getattr(inner, "model", None)
    if not isinstance(model, mujoco.MjModel):
        kind = f"{type(inner).__module__}.{type(inner).__qualname__}"
        raise TargetError(f"{name} is {kind}, which has no MuJoCo model; give {ACCEPTED}")
    source = f"Gymnasium environment, model {_model_name(model)!r}, MuJoCo {mujoco.__version__}"
    return _of_model(model, name=name, source=source, pair=pair, frame_skip=getattr(inner, "frame_skip", None))


# --- settings --------------------------------------------------------------------------------------------------------


def _of_backend(text: str) -> TrainingConfiguration | None:
    """Return the configuration of `backend` or `backend:preset`; None when there is no such backend."""
    name, _, preset = text.partition(":")
    if name not in backend_names():
        return None
    settings = {"preset": preset} if preset else {}
    _check_settings(name, settings)
    return TrainingConfiguration(
        name=text,
        source=f"backend {name}, {f'preset {preset}' if preset else 'default settings'}",
        backend=name,
        settings=settings,
        origins=dict.fromkeys(settings, "command"),
    )


def _of_settings_file(path: Path) -> TrainingConfiguration:
    try:
        content = read_regular(path, MOST_SETTINGS_BYTES)
        values = toml_document(content) if path.suffix.lower() == ".toml" else json_document(content)
        file = _SettingsFile.model_validate(values)
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        key, reason = first_fault(error)
        keys = ", ".join(_SettingsFile.model_fields)
        raise TargetError(f"{path}: {key or 'the file'}: {reason}; keys: {keys}") from None
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None
    settings = file.settings | ({} if file.preset is None else {"preset": file.preset})
    try:
        _check_settings(file.backend, settings)
    except ParameterError as error:
        raise TargetError(f"{path}: {error}") from error
    return TrainingConfiguration(
        name=path.name,
        source=f"settings file {path}",
        backend=file.backend,
        settings=settings,
        origins=dict.fromkeys(settings, path.name),
    )


def _check_settings(name: str, settings: Mapping[str, Any]) -> None:
    """Build a scene with settings of a backend.

    Raises:
        UnknownNameError: There is no such backend or preset.
        ParameterError: There is no such setting, or a value is impossible.
        TargetError: A backend of another package raises an error, or its process dies.
    """
    if name not in backend_names() or is_bundled(name):
        _build_once(name, settings)
        return
    with Worker(TRIAL_LIMIT_S) as worker:
        try:
            worker.call(_build_once, name, settings)
        except GaugeError as error:
            raise TargetError(f"backend {name!r}: {error}") from None


def _build_once(name: str, settings: Mapping[str, Any]) -> None:
    # An action of an environment takes a whole number of steps, so the step serves as the interval of the suite.
    interval = {"drive_interval_s": settings["timestep_s"]} if "timestep_s" in settings else {}
    backend(name).build(load_experiment(TRIAL_VARIANT).scene, {**settings, **interval}).close()
