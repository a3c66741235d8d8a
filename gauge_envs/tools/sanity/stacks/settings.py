"""This package's own settings: a settings file, or a backend with or without a preset; changes are lines of TOML."""

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.backends import backend_names
from gauge_envs.errors import ParameterError, TargetError, first_fault
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.documents import file_value


class _SettingsFile(BaseModel):
    """Contents of a settings file: the backend, optionally a preset, and a table of settings."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    backend: str
    preset: str | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


def read_file(path: Path, pair: object = None) -> TrainingConfiguration:
    """Return the configuration of a settings file in TOML."""
    import tomllib

    return read_settings(path, file_value(path, tomllib.loads))


def read_settings(path: Path, values: Any) -> TrainingConfiguration:
    """Return the configuration of the values of a settings file."""
    try:
        file = _SettingsFile.model_validate(values)
        settings = file.settings | ({"preset": file.preset} if file.preset else {})
        check_settings(file.backend, settings)
    except ValidationError as error:
        key, reason = first_fault(error)
        keys = ", ".join(_SettingsFile.model_fields)
        raise TargetError(
            f"{path}: {key or 'the file'}: {reason}; keys: {keys}"
        ) from None
    except ParameterError as error:
        raise TargetError(f"{path}: {error}") from error
    return _configuration(
        path.name, f"settings file {path}", file.backend, settings, path.name
    )


def read_backend(target: str) -> TrainingConfiguration | None:
    """Return the configuration of `backend` or `backend:preset`; None for any other text."""
    name, _, preset = target.partition(":")
    if name not in backend_names():
        return None
    settings = {"preset": preset} if preset else {}
    check_settings(name, settings)
    source = f"backend {name}, {f'preset {preset}' if preset else 'default settings'}"
    return _configuration(target, source, name, settings, "command")


def _configuration(
    name: str, source: str, backend: str, settings: dict[str, Any], origin: str
) -> TrainingConfiguration:
    return TrainingConfiguration(
        name=name,
        source=source,
        backend=backend,
        settings=settings,
        origins=dict.fromkeys(settings, origin),
    )
