"""Settings of this package: a settings file, or a backend with or without a preset; changes are lines of TOML."""

from pathlib import Path
from typing import Any

from gauge_envs.backends import backend, backend_names
from gauge_envs.backends.settings import with_drive_interval
from gauge_envs.errors import GaugeError, ParameterError, TargetError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.tools.sanity.readers.dialect import NestedTable, SettingOrigins
from gauge_envs.tools.sanity.training import Need, Settings, TrainingConfiguration

TRIAL_VARIANT = "BouncingBall-rubber"
"""Variant whose scene settings are tried on, which builds fast."""


KEYS = ("backend", "preset", "settings")


def check_settings(engine: str, settings: Settings) -> None:
    """Build a scene with settings of a backend.

    Raises:
        GaugeError: The backend rejects them.
        TargetError: The engine raises an error of another kind.
    """
    # An action of an environment takes a whole number of steps, so the step serves as the interval of the suite.
    scene = load_experiment(TRIAL_VARIANT).scene
    try:
        backend(engine).build(scene, with_drive_interval(settings, 0.0)).close()
    except GaugeError:
        raise
    except Exception as error:
        kind = type(error).__name__
        raise TargetError(f"backend {engine!r}: {kind}: {error}") from error


def checked_configuration(
    name: str,
    engine: str,
    origins: SettingOrigins,
    *,
    inapplicable: dict[Need, str] | None = None,
    **attributes: Any,
) -> TrainingConfiguration:
    """Return a configuration after a trial of its settings.

    Args:
        name: Name of the configuration.
        engine: Name of the backend.
        origins: Settings of the backend, with their origins.
        inapplicable: Needs of checks that the target does not meet, except gravity, with the reason.
        attributes: Further attributes of the configuration.

    Raises:
        TargetError: A setting does not exist or has an impossible value.
    """
    settings = {key: value for key, (value, _) in origins.items()}
    try:
        check_settings(engine, settings)
    except ParameterError as error:
        places = [
            at
            for key, (value, at) in origins.items()
            if _is_rejected(engine, key, value)
        ]
        place = ": ".join(dict.fromkeys((name, *places)))
        raise TargetError(f"{place}: {error}") from error
    reasons = inapplicable or {}
    if not any(attributes.get("gravity_m_per_s2") or (1.0,)):
        reasons[Need.GRAVITY] = "the target has no gravity"
    return TrainingConfiguration(
        name=name,
        backend=engine,
        settings=settings,
        origins={key: at for key, (_, at) in origins.items()},
        inapplicable=reasons,
        **attributes,
    )


def _is_rejected(engine: str, key: str, value: Any) -> bool:
    """Return whether a backend rejects a setting alone."""
    try:
        check_settings(engine, {key: value})
    except GaugeError:
        return True
    return False


def read_settings(path: Path, values: Any) -> TrainingConfiguration:
    """Return the configuration of the values of a settings file: the backend, optionally a preset, and settings."""
    table = NestedTable(values, source=str(path))
    faults = [f"{key}: unknown key" for key in values if key not in KEYS]
    if "backend" not in values:
        faults.append("backend: missing key")
    if faults:
        raise TargetError(f"{path}: {faults[0]}; keys: {', '.join(KEYS)}")
    settings = dict(table.part("settings").values)
    if preset := table.value("preset"):
        settings["preset"] = preset
    origins = {key: (value, path.name) for key, value in settings.items()}
    source = f"settings file {path}"
    return checked_configuration(path.name, values["backend"], origins, source=source)


def read_backend(target: str) -> TrainingConfiguration | None:
    """Return the configuration of `backend` or `backend:preset`; None for any other text."""
    name, _, preset = target.partition(":")
    if name not in backend_names():
        return None
    origins = {"preset": (preset, target)} if preset else {}
    source = f"backend {name}, {f'preset {preset}' if preset else 'default settings'}"
    return checked_configuration(target, name, origins, source=source)
