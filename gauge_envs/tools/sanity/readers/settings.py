"""Settings of this package: a settings file, or a backend with or without a preset; changes are lines of TOML."""

from pathlib import Path
from typing import Any

from gauge_envs.backends import backend, backend_names
from gauge_envs.backends.settings import with_drive_interval
from gauge_envs.errors import GaugeError, ParameterError, TargetError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.tools.sanity.verdict import Settings, TrainingConfiguration

TRIAL_VARIANT = "BouncingBall-rubber"
"""Variant whose scene settings are tried on, which builds fast."""


KEYS = ("backend", "preset", "settings")


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
    """Return the configuration of the values of a settings file: the backend, optionally a preset, and settings."""
    if not isinstance(values, dict):
        raise TargetError(f"{path}: is {values!r:.80}, and a table is expected")
    faults = [f"{key}: unknown key" for key in values if key not in KEYS]
    if "backend" not in values:
        faults.append("backend: missing key")
    faults += [
        f"{key}: {values[key]!r:.80}, and a text is expected"
        for key in ("backend", "preset")
        if not isinstance(values.get(key, ""), str)
    ]
    if faults:
        raise TargetError(f"{path}: {faults[0]}; keys: {', '.join(KEYS)}")
    settings = values.get("settings") or {}
    if not isinstance(settings, dict):
        raise TargetError(
            f"{path}: settings is {settings!r:.80}, and a table is expected"
        )
    if preset := values.get("preset"):
        settings = {**settings, "preset": preset}
    source = f"settings file {path}"
    return _checked(path.name, values["backend"], settings, source)


def read_backend(target: str) -> TrainingConfiguration | None:
    """Return the configuration of `backend` or `backend:preset`; None for any other text."""
    name, _, preset = target.partition(":")
    if name not in backend_names():
        return None
    settings = {"preset": preset} if preset else {}
    source = f"backend {name}, {f'preset {preset}' if preset else 'default settings'}"
    return _checked(target, name, settings, source)
