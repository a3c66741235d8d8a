"""Numerical settings of a backend: named presets, and a user's changes to them, checked in one place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import ParameterError, UnknownNameError

__all__ = ["SteppedSettings", "resolve_settings"]

DRIVE_RATE_HZ = 180
"""Prescribed motion comes in intervals of 1/180 s, so a step must divide them."""


class SteppedSettings(BaseModel):
    """What the settings of every engine have; subclass it and add the engine's own, a default and a reason each.

    Attributes:
        preset: Name of the preset that these started from.
        timestep_s: Step of the integrator; driver intervals (1/180 s) must be multiples of it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    preset: str
    timestep_s: float = Field(gt=0.0, le=1.0 / DRIVE_RATE_HZ)


Settings = TypeVar("Settings", bound=SteppedSettings)


def resolve_settings(
    engine: str, presets: Mapping[str, Settings], *, preset: str, changes: Mapping[str, Any] | None
) -> Settings:
    """Settings of a preset with a user's changes put in.

    Args:
        engine: Name of the engine, for messages.
        presets: Settings by name.
        preset: Name of the preset that the scene asks for; `changes["preset"]` goes before it.
        changes: Settings that replace those of the preset.

    Raises:
        UnknownNameError: No such preset.
        ParameterError: No such setting, an impossible value, or a step that does not divide 1/180 s.
    """
    values = dict(changes or {})
    name = values.pop("preset", None) or preset
    if name not in presets:
        raise UnknownNameError(f"{engine} preset", str(name), presets)
    start = presets[name]
    try:
        settings = type(start).model_validate(start.model_dump() | values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        known = ", ".join(type(start).model_fields)
        reason = "there is no such setting" if first["type"] == "extra_forbidden" else first["msg"]
        raise ParameterError(
            f"{engine} setting {first['loc'][0]!r} in preset {name!r}: {reason}; settings: {known}"
        ) from error
    steps = 1.0 / DRIVE_RATE_HZ / settings.timestep_s
    if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
        raise ParameterError(
            f"{engine} setting 'timestep_s': 1/{DRIVE_RATE_HZ} s is {steps:.6g} steps, not a whole number"
        )
    return settings
