"""What to check: from what a user names to the numerical settings that a policy is trained with."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import mujoco
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.backends import Simulation, backend, backend_names
from gauge_envs.checks.sanity.model import TrainingConfiguration
from gauge_envs.checks.sanity.mujoco_settings import model_settings
from gauge_envs.errors import ParameterError, TargetError, first_fault
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants

__all__ = [
    "Target",
    "configuration",
]

Target: TypeAlias = str | Path | mujoco.MjModel | gymnasium.Env
"""What can be checked; see `configuration`."""

MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")
SETTINGS_SUFFIXES = (".toml", ".json")

ACCEPTED = (
    "a Gymnasium id with a MuJoCo model (HalfCheetah-v5), a model file (.xml, .mjcf, .urdf), a settings file (.toml, "
    ".json), or a backend with or without a preset (mujoco:out_of_box)"
)

TRIAL_VARIANT = "BouncingBall-rubber"
"""Settings are tried on its scene, which is built at once."""


class _SettingsFile(BaseModel):
    """A settings file: the backend, a preset of it or none, and a table of settings."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    backend: str
    preset: str | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


def configuration(
    target: Target | TrainingConfiguration, *, pair: tuple[str, str] | None = None
) -> TrainingConfiguration:
    """Read a training configuration.

    Args:
        target: One of
            a Gymnasium id (`HalfCheetah-v5`) whose environment has a `mujoco.MjModel` as `unwrapped.model`;
            an id of this suite, with its own settings;
            a model file that MuJoCo reads;
            a settings file: `backend`, optionally `preset`, and a table `settings`;
            a backend, with or without a preset (`mujoco:out_of_box`, `newton`);
            a `mujoco.MjModel` or a `gymnasium.Env`;
            a configuration, which is returned as it is.
        pair: Names of two geoms of a model whose contact constants the experiments get, instead of the most frequent
            ones of moving geoms on the ground.

    Raises:
        TargetError: The target cannot be read, or has no such pair of geoms.
        UnknownNameError: No such backend or preset.
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
    suffix = Path(target).suffix.lower()
    if suffix in MODEL_SUFFIXES:
        return _of_model_file(Path(target), pair)
    found = _of_settings_file(Path(target)) if suffix in SETTINGS_SUFFIXES else _of_backend(str(target))
    if found is None:
        return _of_id(str(target), pair)
    if pair is not None:
        raise TargetError(f"{target}: pairs of geoms are those of a MuJoCo model, and this is none")
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
    read = model_settings(model, pair=pair)
    settings = _checked("mujoco", read.settings)
    return TrainingConfiguration(
        name=name,
        source=source,
        backend="mujoco",
        settings=settings,
        origins=read.origins,
        frame_skip=frame_skip,
        contact_groups=read.groups,
        notes=read.notes,
    )


def _model_name(model: mujoco.MjModel) -> str:
    return model.names.split(b"\0", 1)[0].decode() or "unnamed model"


def _of_model_file(path: Path, pair: tuple[str, str] | None) -> TrainingConfiguration:
    if not path.is_file():
        raise TargetError(f"{path}: there is no such file")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise TargetError(f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    return _of_model(model, name=path.name, source=f"model file {path}", pair=pair)


def _of_id(name: str, pair: tuple[str, str] | None) -> TrainingConfiguration:
    own = {variant.name: variant.id for variant in variants()}
    try:
        env = gymnasium.make(own.get(name, name))
    except Exception as error:  # An environment of someone else raises anything.
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
    """TrainingConfiguration of `backend` or `backend:preset`; None where it is no backend that is named."""
    name, _, preset = text.partition(":")
    if name not in backend_names():
        return None
    settings = {"preset": preset} if preset else {}
    return TrainingConfiguration(
        name=text,
        source=f"backend {name}, {f'preset {preset}' if preset else 'default settings'}",
        backend=name,
        settings=_checked(name, settings),
        origins=dict.fromkeys(settings, "command"),
    )


def _of_settings_file(path: Path) -> TrainingConfiguration:
    try:
        text = path.read_text(encoding="utf-8")
        values = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
        file = _SettingsFile.model_validate(values)
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        key, reason = first_fault(error)
        keys = ", ".join(_SettingsFile.model_fields)
        raise TargetError(f"{path}: {key or 'the file'}: {reason}; keys: {keys}") from None
    except ValueError as error:
        raise TargetError(f"{path}: {error}") from None
    settings = file.settings | ({} if file.preset is None else {"preset": file.preset})
    try:
        checked = _checked(file.backend, settings)
    except ParameterError as error:
        raise TargetError(f"{path}: {error}") from error
    return TrainingConfiguration(
        name=path.name,
        source=f"settings file {path}",
        backend=file.backend,
        settings=checked,
        origins=dict.fromkeys(settings, path.name),
    )


def _checked(name: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings, once a backend has taken them.

    Raises:
        UnknownNameError: No such backend or preset.
        ParameterError: No such setting, or an impossible value.
    """
    given = dict(settings)
    # Each action of an environment is a whole number of steps, whatever the suite's own interval is.
    interval = {"drive_interval_s": given["timestep_s"]} if "timestep_s" in given else {}
    backend(name).build(load_experiment(TRIAL_VARIANT).scene, given | interval).close()
    return given
