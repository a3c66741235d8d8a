"""This package's own settings: a settings file, or a backend with or without a preset; changes are lines of TOML."""

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.backends import backend_names
from gauge_envs.errors import ParameterError, TargetError, first_fault
from gauge_envs.files import json_document, toml_document
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.dialect import TOML
from gauge_envs.tools.sanity.stacks.documents import file_value
from gauge_envs.tools.sanity.stacks.reader import Reader, has_suffix


class _SettingsFile(BaseModel):
    """Contents of a settings file: the backend, optionally a preset, and a table of settings."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    backend: str
    preset: str | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


def _read_file(target: Any) -> TrainingConfiguration:
    path = Path(target)
    values = file_value(
        path, toml_document if path.suffix.lower() == ".toml" else json_document
    )
    try:
        file = _SettingsFile.model_validate(values)
    except ValidationError as error:
        key, reason = first_fault(error)
        keys = ", ".join(_SettingsFile.model_fields)
        raise TargetError(
            f"{path}: {key or 'the file'}: {reason}; keys: {keys}"
        ) from None
    settings = file.settings | ({} if file.preset is None else {"preset": file.preset})
    try:
        check_settings(file.backend, settings)
    except ParameterError as error:
        raise TargetError(f"{path}: {error}") from error
    return TrainingConfiguration(
        name=path.name,
        source=f"settings file {path}",
        backend=file.backend,
        settings=settings,
        origins=dict.fromkeys(settings, path.name),
    )


def _read_backend(target: Any) -> TrainingConfiguration:
    """Return the configuration of `backend` or `backend:preset`."""
    name, _, preset = str(target).partition(":")
    settings = {"preset": preset} if preset else {}
    check_settings(name, settings)
    return TrainingConfiguration(
        name=str(target),
        source=f"backend {name}, {f'preset {preset}' if preset else 'default settings'}",
        backend=name,
        settings=settings,
        origins=dict.fromkeys(settings, "command"),
    )


DIALECTS = (TOML,)

READERS = (
    Reader(
        "a settings file (.toml, .json)",
        has_suffix(".toml", ".json"),
        _read_file,
        has_geoms=False,
    ),
    Reader(
        "a backend with or without a preset (mujoco:out_of_box)",
        lambda target: (
            isinstance(target, str | Path)
            and str(target).partition(":")[0] in backend_names()
        ),
        _read_backend,
        has_geoms=False,
    ),
)
