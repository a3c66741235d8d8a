"""Numerical settings of a backend: named presets and validated changes to them."""

import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from gauge_envs.errors import BackendError, ParameterError, UnknownNameError
from gauge_envs.files import json_ready
from gauge_envs.names import nearest
from gauge_envs.scene.timing import DRIVE_INTERVAL_S
from gauge_envs.validation import first_fault

INTEGER_LIMIT = 2**31 - 1
"""Largest integer setting; engines hold integers in 32 bits."""

STACK_BODY_COUNT = 20
"""Smallest number of dynamic bodies for which presets named `stack` are used."""


class SteppedSettings(BaseModel):
    """Settings that every engine has. An engine subclasses it and gives each of its settings a default and a rationale.

    Numbers are finite, unless a field has `allow_inf_nan=True`. Integers have 32 bits.

    Attributes:
        preset: Name of the preset that supplied the other values.
        timestep_s: Time step of the integrator [s], at least 1e-8; `drive_interval_s` must be a multiple of it.
        drive_interval_s: Interval by which the caller drives and advances the simulation [s], at most 60 s.
            Environments use 1/180 s. If the step does not divide 1/180 s, set this to the step;
            `gauge_envs.backends.shared.resampled.ResampledSimulation` then interpolates between steps.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True
    )

    preset: str
    timestep_s: float = Field(ge=1e-8)
    drive_interval_s: float = Field(default=DRIVE_INTERVAL_S, gt=0.0, le=60.0)

    @field_validator("*")
    @classmethod
    def _in_32_bits(cls, value: Any) -> Any:
        if isinstance(value, int) and abs(value) > INTEGER_LIMIT:
            raise ValueError(f"must be at most {INTEGER_LIMIT}")
        return value


Settings = TypeVar("Settings", bound=SteppedSettings)


def read_presets(module: str, group: str = "presets") -> dict[str, dict[str, Any]]:
    """Return the settings of each preset in the `presets.toml` next to an engine's module, by name of the preset.

    A preset is a table, whose comment has the reasons for its numbers. `steps_per_s` is one over `timestep_s`, `like`
    names a preset above whose values it takes, and `unset` lists settings that are None.

    Args:
        module: Path of the module.
        group: First part of the names of the tables.
    """
    presets: dict[str, dict[str, Any]] = {}
    text = Path(module).with_name("presets.toml").read_text(encoding="utf-8")
    for name, values in tomllib.loads(text)[group].items():
        if "steps_per_s" in values:
            values["timestep_s"] = 1 / values.pop("steps_per_s")
        unset = dict.fromkeys(values.pop("unset", ()))
        base = presets[values.pop("like")] if "like" in values else {}
        presets[name] = base | values | unset
    return presets


def load_presets(settings: type[Settings], module: str) -> dict[str, Settings]:
    """Return the presets in the `presets.toml` next to an engine's module as instances of its settings, by name."""
    return {
        name: settings(preset=name, **values)
        for name, values in read_presets(module).items()
    }


def resolve_settings(
    engine: str,
    presets: Mapping[str, Settings],
    *,
    preset: str,
    changes: Mapping[str, Any] | None,
) -> Settings:
    """Return the settings of a preset with a user's changes.

    Args:
        engine: Name of the engine, for messages.
        presets: Settings of each preset, by name.
        preset: Name of the preset for the scene; `changes["preset"]` overrides it.
        changes: Settings that replace those of the preset.
    """
    if not isinstance(changes, Mapping | None):
        raise ParameterError(
            f"{engine} settings {changes!r}: expected a mapping, as {{'timestep_s': 1 / 1800}}"
        )
    values = dict(changes or {})
    name = values.pop("preset", None) or preset
    if not isinstance(name, str) or name not in presets:
        raise UnknownNameError(f"{engine} preset", str(name), presets)
    start = presets[name]
    try:
        settings = type(start).model_validate(start.model_dump() | values)
    except ValidationError as error:
        key, reason = first_fault(error, noun="setting")
        hint = (
            f"; {nearest(key, type(start).model_fields)}"
            if reason == "unknown setting"
            else ""
        )
        raise ParameterError(
            f"{engine} setting {key!r} in preset {name!r}: {reason}{hint}"
        ) from error
    interval = settings.drive_interval_s
    steps = interval / settings.timestep_s
    if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
        text = f"1/{1.0 / interval:.6g}" if interval < 1.0 else f"{interval:.6g}"
        nearest_rate_hz = math.ceil(steps) / interval
        raise ParameterError(
            f"{engine} setting 'timestep_s': drive_interval_s, {text} s, is {steps:.6g} steps, not a whole number: "
            f"choose a timestep_s that divides it, as 1/{nearest_rate_hz:.6g}, or set drive_interval_s to the step"
        )
    return settings


def with_drive_interval(
    settings: Mapping[str, Any], longest_s: float
) -> dict[str, Any]:
    """Return settings whose drive interval is the longest multiple of their step up to a length [s].

    It is at least one step. Settings without a valid step are unchanged.
    """
    step_s = settings.get("timestep_s")
    if not isinstance(step_s, int | float) or not 1e-8 <= step_s <= 60.0:
        return dict(settings)
    steps = max(1, math.floor(longest_s / step_s + 1e-6))
    return {**settings, "drive_interval_s": step_s * steps}


def settings_record(backend: str | None, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the effective settings as JSON-ready values."""
    record: dict[str, Any] = {}
    for name, value in settings.items():
        record[str(name)] = json_ready(value)
        try:
            json.dumps(record[str(name)])
        except (TypeError, ValueError, RecursionError) as error:
            raise BackendError(
                f"backend {backend!r}: setting {name!r} is a {type(value).__name__}, which JSON cannot hold. "
                "Simulation.settings must hold numbers, texts, booleans, None, lists and mappings."
            ) from error
    return record
