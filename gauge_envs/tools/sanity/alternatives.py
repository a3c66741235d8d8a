"""Find the values that a setting may be put back to: the engine's documented default and this package's presets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.tools.sanity.measure import Measurements
from gauge_envs.tools.sanity.scenario import Scenario

DOCUMENTED_PRESET = "out_of_box"
"""Preset of every backend that holds the engine's documented defaults."""

DOCUMENTED = "the engine's documented default"

GENERAL = Scenario(name="hold-wood", variant="SlopeSlider-1-wood", seconds=1.0)
"""Scene whose preset is tried in all scenes: a cube on a board."""

NOT_NUMERICAL = ("preset", "drive_interval_s", "device", "inverse_weight_scale")
"""Settings that stand for other settings, follow from them, choose a processor, or belong to the robot."""

STEP_SHARES = {0.5: "half the step", 0.25: "a quarter of the step"}
"""Steps that are tried instead of the short ones of presets, which no training affords."""

RECIPES = {"contact_solref": "sustained_solref", "contact_solimp": "sustained_solimp"}
"""Constants that a target has once for all scenes, and the part of a preset's recipe that stands for them."""

ABSENT = {
    "contact_margin_m": 0.0,
    "contact_gap_m": 0.0,
    "condim": 3,
    "contact_solreffriction": (0.0, 0.0),
    "contact_kf_n_s_per_m": -1.0,
}
"""Values with which MuJoCo, and Newton's solver of that name, run where this package's settings are None."""

NEWTON_MATERIAL = {
    "contact_solref": (0.02, 1.0),
    "contact_solimp": (0.9, 0.95, 0.001, 0.5, 2.0),
    "contact_kf_n_s_per_m": 1000.0,
}
"""Values with which Newton runs where its own material is kept: those of shapes with `ke` 2500, `kd` 100, `kf` 1000."""

MAY_BE_ABSENT = ("o_friction",)
"""Settings that are put back by leaving them out; the objects then have their own friction."""


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """Another value of a setting.

    Attributes:
        name: Name of the setting.
        value: The value to try.
        was: The value in the configuration.
        source: Origin of the value, such as `MuJoCo's documented default`.
    """

    name: str
    value: Any
    was: Any
    source: str


def alternatives(
    measurements: Measurements, scenario: Scenario, settings: Mapping[str, Any]
) -> dict[str, list[Alternative]]:
    """Return the other values of each setting, by its name.

    A setting is tried if it differs from the preset of the scene. A setting that the configuration states is tried too
    if it differs from the engine's documented default or from the preset of a cube on a board.

    Args:
        measurements: Measurements on the backend.
        scenario: Scenario whose preset counts.
        settings: The configuration's settings.
    """
    configured = measurements.in_force(scenario, settings)
    preset = measurements.in_force(scenario, {})
    references = [
        *_in_force(measurements, scenario, {"preset": DOCUMENTED_PRESET}, DOCUMENTED),
        *_in_force(measurements, GENERAL, {}, None),
        (preset_label(preset), {name: value for name, value in preset.items() if name not in RECIPES}),
    ]
    stated = set(configured) if "preset" in settings else set(settings)
    found: dict[str, list[Alternative]] = {}
    for name, was in configured.items():
        if name in NOT_NUMERICAL or name not in preset:
            continue
        if name not in stated and preset[name] == was:
            continue
        values = list(_values(name, configured, references))
        if values:
            found[name] = values
    return found


def _in_force(
    measurements: Measurements, scenario: Scenario, settings: Mapping[str, Any], label: str | None
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield a reference; nothing when the backend has no such preset or cannot build the scene."""
    try:
        force = measurements.in_force(scenario, settings)
    except DeclinedError:
        return
    yield label or preset_label(force), force


def preset_label(force: Mapping[str, Any]) -> str:
    """Return the text for the preset of settings in force."""
    return f"this package's preset {force.get('preset', 'default')}"


def _values(
    name: str, configured: Mapping[str, Any], references: Sequence[tuple[str, Mapping[str, Any]]]
) -> Iterator[Alternative]:
    """Yield each other value of a setting once."""
    was = _comparable(name, _stated(name, configured, None) if configured.get("newton_material") else configured[name])
    seen = [was]
    step_s = configured.get("timestep_s")
    for label, force in references:
        if name not in force:
            continue
        value = _comparable(name, _stated(name, force, step_s))
        is_absent = value is None and name not in MAY_BE_ABSENT
        if is_absent or value in seen or (name == "timestep_s" and label != DOCUMENTED):
            continue
        seen.append(value)
        yield Alternative(name=name, value=value, was=was, source=label)
    if name == "timestep_s":
        for share, label in STEP_SHARES.items():
            value = float(f"{share * was:.4g}")
            if min(seen) > value:
                yield Alternative(name=name, value=value, was=was, source=label)


def _stated(name: str, force: Mapping[str, Any], step_s: float | None) -> Any:
    """Return the value of a reference; for contact constants of a recipe, those of its lasting contacts."""
    value = force[name]
    if value is None and force.get("newton_material"):
        return NEWTON_MATERIAL.get(name)
    if value is None and name == "contact_solref" and "sustained_solref" in force:
        time_constant, damping_ratio = force["sustained_solref"]
        # MuJoCo raises shorter time constants to two steps.
        return (max(time_constant, 2.0 * (step_s or 0.0)), damping_ratio)
    if value is None and name == "contact_solimp" and "sustained_solimp" in force:
        return (*force["sustained_solimp"], 0.5, 2.0)
    return value


def _comparable(name: str, value: Any) -> Any:
    """Return a value in the form in which it is compared and pasted."""
    value = ABSENT.get(name) if value is None else value
    return tuple(value) if isinstance(value, list) else value
