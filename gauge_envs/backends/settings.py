"""Numerical settings of a backend: named presets, and a user's changes to them, checked in one place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.errors import ParameterError, UnknownNameError, first_fault
from gauge_envs.scene.timing import DRIVE_INTERVAL_S

__all__ = [
    "SteppedSettings",
    "check_drive_interval",
    "resolve_settings",
]


class SteppedSettings(BaseModel):
    """What the settings of every engine have; subclass it and add the engine's own, a default and a reason each.

    Attributes:
        preset: Name of the preset that these started from.
        timestep_s: Step of the integrator; `drive_interval_s` must be a multiple of it.
        drive_interval_s: Interval by which whoever runs the simulation drives and advances it. Environments need
            1/180 s; another one is for those that step the backend themselves, as with a step that does not divide it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    preset: str
    timestep_s: float = Field(gt=0.0)
    drive_interval_s: float = Field(default=DRIVE_INTERVAL_S, gt=0.0)


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
        ParameterError: No such setting, an impossible value, or a step that does not divide the drive interval.
    """
    values = dict(changes or {})
    name = values.pop("preset", None) or preset
    if name not in presets:
        raise UnknownNameError(f"{engine} preset", str(name), presets)
    start = presets[name]
    try:
        settings = type(start).model_validate(start.model_dump() | values)
    except ValidationError as error:
        key, reason = first_fault(error, noun="setting")
        known = ", ".join(type(start).model_fields)
        raise ParameterError(f"{engine} setting {key!r} in preset {name!r}: {reason}; settings: {known}") from error
    interval = settings.drive_interval_s
    steps = interval / settings.timestep_s
    if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
        told = f"1/{1.0 / interval:.6g}" if interval < 1.0 else f"{interval:.6g}"
        raise ParameterError(
            f"{engine} setting 'timestep_s': drive_interval_s, {told} s, is {steps:.6g} steps, not a whole number"
        )
    return settings


def check_drive_interval(settings: Mapping[str, Any]) -> None:
    """Refuse settings that were resolved for another interval than that of the environments.

    Args:
        settings: `World.settings`; those of engines with free steps may have no interval.

    Raises:
        ParameterError: Their interval is another.
    """
    interval = settings.get("drive_interval_s", DRIVE_INTERVAL_S)
    if abs(interval - DRIVE_INTERVAL_S) > 1e-9:
        raise ParameterError(
            f"setting 'drive_interval_s' is {interval:.6g} s, and environments drive in intervals of 1/180 s: "
            "set it, and a timestep_s that divides it"
        )
