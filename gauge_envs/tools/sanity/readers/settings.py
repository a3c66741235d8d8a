"""Settings of this package: a settings file, or a backend with or without a preset; changes are lines of TOML."""

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from gauge_envs.backends import backend, backend_names
from gauge_envs.backends.settings import with_drive_interval
from gauge_envs.errors import GaugeError, ParameterError, TargetError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.reading import faults_of
from gauge_envs.tools.sanity.verdict import Settings, TrainingConfiguration

TRIAL_VARIANT = "BouncingBall-rubber"
"""Variant whose scene settings are tried on, which builds fast."""


class SettingsFile(BaseModel):
    """The backend, optionally a preset of it, and settings that replace those of the preset."""

    model_config = ConfigDict(extra="forbid", strict=True)

    backend: str
    preset: str = ""
    settings: dict[str, Any] = {}


def _checked(
    name: str, engine: str, settings: Settings, source: str
) -> TrainingConfiguration:
    """Return a configuration after a trial of its settings.

    Raises:
        TargetError: A setting does not exist or has an impossible value.
    """
    # An action of an environment takes a whole number of steps, so the step serves as the interval of the suite.
    given = with_drive_interval(settings, 0.0)
    try:
        backend(engine).build(load_experiment(TRIAL_VARIANT).scene, given).close()
    except ParameterError as error:
        raise TargetError(f"{name}: {error}") from error
    except GaugeError:
        raise
    except Exception as error:
        kind = type(error).__name__
        raise TargetError(f"backend {engine!r}: {kind}: {error}") from error
    return TrainingConfiguration(
        name=name, source=source, backend=engine, settings=settings
    )


def read_settings(path: Path, values: Any) -> TrainingConfiguration:
    """Return the configuration of the values of a settings file."""
    with faults_of(path, TargetError, hint="keys: backend, preset, settings"):
        file = SettingsFile.model_validate(values)
    settings = file.settings | ({"preset": file.preset} if file.preset else {})
    return _checked(path.name, file.backend, settings, f"settings file {path}")


def read_backend(target: str) -> TrainingConfiguration | None:
    """Return the configuration of `backend` or `backend:preset`; None for any other text."""
    name, _, preset = target.partition(":")
    if name not in backend_names():
        return None
    settings = {"preset": preset} if preset else {}
    source = f"backend {name}, {f'preset {preset}' if preset else 'default settings'}"
    return _checked(target, name, settings, source)
