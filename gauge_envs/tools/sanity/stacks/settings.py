"""This package's own settings: a settings file, or a backend with or without a preset; changes are lines of TOML."""

from pathlib import Path
from typing import Any

from gauge_envs.backends import backend_names
from gauge_envs.errors import ParameterError, TargetError
from gauge_envs.tools.sanity.model import TrainingConfiguration
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.dialect import Table
from gauge_envs.tools.sanity.stacks.documents import file_value

KEYS = ("backend", "preset", "settings")


def read_file(path: Path, pair: object = None) -> TrainingConfiguration:
    """Return the configuration of a settings file in TOML."""
    import tomllib

    return read_settings(path, file_value(path, tomllib.loads))


def read_settings(path: Path, values: Any) -> TrainingConfiguration:
    """Return the configuration of the values of a settings file: the backend, optionally a preset, and settings."""
    table = Table(values, source=str(path))
    faults = [f"{key}: unknown key" for key in values if key not in KEYS]
    if "backend" not in values:
        faults.append("backend: missing key")
    if faults:
        raise TargetError(f"{path}: {faults[0]}; keys: {', '.join(KEYS)}")
    settings = dict(table.part("settings").values)
    if preset := table.value("preset"):
        settings["preset"] = preset
    source = f"settings file {path}"
    try:
        return _configuration(path.name, source, values["backend"], settings, path.name)
    except ParameterError as error:
        raise TargetError(f"{path}: {error}") from error


def read_backend(target: str) -> TrainingConfiguration | None:
    """Return the configuration of `backend` or `backend:preset`; None for any other text."""
    name, _, preset = target.partition(":")
    if name not in backend_names():
        return None
    settings = {"preset": preset} if preset else {}
    source = f"backend {name}, {f'preset {preset}' if preset else 'default settings'}"
    return _configuration(target, source, name, settings, "command")


def _configuration(
    name: str, source: str, backend: str, settings: dict[str, Any], origin: str
) -> TrainingConfiguration:
    check_settings(backend, settings)
    return TrainingConfiguration(
        name=name,
        source=source,
        backend=backend,
        settings=settings,
        origins=dict.fromkeys(settings, origin),
    )
