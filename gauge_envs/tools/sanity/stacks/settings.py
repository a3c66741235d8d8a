"""Settings of this package: a settings file, or a backend with or without a preset; changes are lines of TOML."""

from pathlib import Path
from typing import Any

from gauge_envs.backends import backend_names
from gauge_envs.errors import ParameterError, TargetError
from gauge_envs.tools.sanity.model import Need, TrainingConfiguration
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.dialect import SettingOrigins, Table

KEYS = ("backend", "preset", "settings")


def checked_configuration(
    name: str,
    backend: str,
    origins: SettingOrigins,
    *,
    inapplicable: dict[Need, str] | None = None,
    **attributes: Any,
) -> TrainingConfiguration:
    """Return a configuration after a trial of its settings.

    Args:
        name: Name of the configuration.
        backend: Name of the backend.
        origins: Settings of the backend, with their origins.
        inapplicable: Needs of phenomena that the target does not meet, except gravity, with the reason.
        attributes: Further attributes of the configuration.

    Raises:
        TargetError: A setting does not exist or has an impossible value.
    """
    settings = {key: value for key, (value, _) in origins.items()}
    try:
        check_settings(backend, settings)
    except ParameterError as error:
        places = [at for key, (_, at) in origins.items() if f"'{key}'" in str(error)]
        place = ": ".join(dict.fromkeys((name, *places)))
        raise TargetError(f"{place}: {error}") from error
    reasons = inapplicable or {}
    if not any(attributes.get("gravity_m_per_s2") or (1.0,)):
        reasons[Need.GRAVITY] = "the target has no gravity"
    return TrainingConfiguration(
        name=name,
        backend=backend,
        settings=settings,
        origins={key: at for key, (_, at) in origins.items()},
        inapplicable=reasons,
        **attributes,
    )


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
