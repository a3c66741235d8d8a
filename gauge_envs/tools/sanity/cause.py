"""Find the responsible settings, and changes of a few settings that may mend flags.

Settings are put back one at a time to the engine's documented default and this package's presets, and phenomena are
measured again. What several do together is found by the search for a cure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from gauge_envs.pages.text import with_unit
from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.tools.sanity.measure import Measured, Measurements
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    Cause,
    Settings,
    SettingTrial,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.scenario import Scenario
from gauge_envs.tools.sanity.stacks.dialect import TOML, Dialect

SEEN_DEVIATION = 0.05
"""Least change of a deviation, in half-widths of the interval, that counts as an effect of a setting."""

SAME_DEVIATION = 0.5
"""Difference of deviations, in half-widths of the interval, that no real trial can resolve."""


STEP = "timestep_s"

ADVISED_STEP_S = 0.002
"""Step that this package advises for models [s]."""


def find_cause(
    measurements: Measurements,
    phenomenon: Phenomenon,
    settings: Settings,
    configured: Measured,
    default: Measured,
    dialect: Dialect = TOML,
) -> Cause | None:
    """Find the settings that are responsible for a visible or wrong phenomenon.

    1. Each setting is put back to the engine's documented default and to this package's preset. A setting explains the
       error when this brings the phenomenon into the interval of reality, or halves the error. The setting that comes
       closest to reality is responsible. Real trials cannot resolve small differences within the interval. Of several
       settings there, the responsible one changes the preset most when it is applied alone.
    2. If no setting explains the error, several are responsible, which the search for a cure finds.

    In a scene of many bodies the first setting that brings the phenomenon into the interval is the last one tried.

    Args:
        measurements: Measurements on the backend.
        phenomenon: The phenomenon.
        settings: The configuration's settings.
        configured: Outcome in the configuration.
        default: Outcome with this package's preset.
        dialect: Dialect of the target.

    Returns:
        The cause; None when the phenomenon is inside the interval of reality, was declined, or the engine died.
    """
    nothing_to_explain = (
        configured.verdict in (Verdict.INSIDE, Verdict.DECLINED)
        or configured.engine_died
    )
    if nothing_to_explain or default.verdict is Verdict.DECLINED:
        return None
    search = _Search(measurements, phenomenon, settings, configured, default, dialect)
    return search.put_back_one() or search.unexplained()


@dataclass
class _Search:
    """Changes settings, measures one phenomenon again, and keeps a list of all trials."""

    measurements: Measurements
    phenomenon: Phenomenon
    settings: Settings
    configured: Measured
    default: Measured
    dialect: Dialect

    def __post_init__(self) -> None:
        self._others = alternatives(
            self.measurements, self.phenomenon.scenario, self.settings
        )
        self._best = {name: several[-1] for name, several in self._others.items()}
        self._is_slow = self.phenomenon.has_many_bodies
        self._tried: list[SettingTrial] = []
        self._put_back: dict[str, Measured] = {}

    def _explains(self, changed: Measured) -> bool:
        """Return whether a change brings the phenomenon into the interval of reality, or halves the error."""
        largest = max(INSIDE_WITHIN, 0.5 * self.configured.deviation)
        return math.isfinite(changed.deviation) and changed.deviation <= largest

    def _needs_no_step(self) -> bool:
        """Return whether the step is as short as advised and another setting mends the row: shorter ones cost most."""
        step_s = self.settings.get(STEP, math.inf)
        # What refsafe does depends on the step.
        others = (one for name, one in self._put_back.items() if name != "refsafe")
        mends = any(one.verdict is Verdict.INSIDE for one in others)
        return step_s <= ADVISED_STEP_S and mends

    def _order(self, name: str) -> tuple[bool, bool]:
        """Return the key by which settings are sorted: the step last, and first contacts where a rollout takes long."""
        return name == STEP, self._is_slow and not name.startswith("contact_")

    def put_back_one(self) -> Cause | None:
        """Put back each setting alone and return the one that comes closest to reality, if it explains the error."""
        for name in sorted(self._others, key=self._order):
            if name == STEP and self._needs_no_step():
                continue
            if self._is_slow and any(
                one.verdict is Verdict.INSIDE for one in self._put_back.values()
            ):
                break
            self._put_back[name], self._best[name] = self._closest(name)
        close = {
            name: self._put_back[name]
            for name in self._others
            if name in self._put_back and self._explains(self._put_back[name])
        }
        if not close:
            return None
        best = min(close, key=lambda name: close[name].deviation)
        if close[best].verdict is Verdict.INSIDE:
            alike = [
                name
                for name, one in close.items()
                if one.deviation <= close[best].deviation + SAME_DEVIATION
            ]
            best = self._strongest(alike) or best if len(alike) > 1 else best
        others = [
            f"{self._assignment(name)} alone to {self._measured_text(close[name])}"
            for name in close
            if name != best
        ]
        also = f" ({', '.join(others)})" if others else ""
        return self._cause(best, close[best], also)

    def _closest(self, name: str) -> tuple[Measured, Alternative]:
        """Return the first value of a setting that mends the row, else the one that comes closest, and its outcome."""
        found = []
        for one in self._others[name]:
            measured = self._changed({name: one.value})
            if measured.verdict is Verdict.INSIDE:
                return measured, one
            found.append((measured, one))
        return min(found, key=lambda pair: pair[0].deviation)

    def _strongest(self, names: Sequence[str]) -> str | None:
        """Return the setting that alone changes the default most towards the configuration.

        None when no setting alone has a visible effect.
        """
        shifts = {name: self._shift(self._on_default(name)) for name in names}
        best = max(shifts, key=shifts.__getitem__)
        least = SEEN_DEVIATION * self.phenomenon.reality.tolerance
        return best if shifts[best] > least else None

    def _shift(self, alone: Measured) -> float:
        default, configured = self.default.value, self.configured.value
        if alone.verdict is Verdict.DECLINED:
            return -math.inf
        if alone.value is None or default is None or configured is None:
            return alone.deviation
        return math.copysign(1.0, configured - default) * (alone.value - default)

    def unexplained(self) -> Cause:
        """Return that no setting explains the error alone, or that this package's preset has at least half of it."""
        line = f"no reset of one explains it: {', '.join(self._others)}"
        if not self._explains(self.default):
            preset = self._measured_text(self.default)
            line = f"no setting alone explains it; this package's preset: {preset}"
        return Cause(settings=(), line=line, tried=tuple(self._tried))

    # --- changes ---

    def _changed(
        self, changes: dict[str, Any], *, on_default: bool = False
    ) -> Measured:
        settings = changes if on_default else {**self.settings, **changes}
        measured = self.measurements.measure(self.phenomenon, settings)
        self._tried.append(
            SettingTrial(changes=changes, value=measured.value, on_default=on_default)
        )
        return measured

    def _on_default(self, name: str) -> Measured:
        return self._changed({name: self._best[name].was}, on_default=True)

    # --- words ---

    def _measured_text(self, measured: Measured) -> str:
        if measured.value is None:
            return measured.remark
        return with_unit(f"{measured.value:.3g}", self.phenomenon.unit)

    def _assignment(self, name: str) -> str:
        text = self.dialect.assignment(name, self._best[name].value)
        return (
            text
            if self.dialect.writes(name)
            else f"{text} (which the target has no key for)"
        )

    def _cause(self, name: str, changed: Measured, also: str) -> Cause:
        was, source = self._best[name].was, self._best[name].source
        line = (
            f"{self._assignment(name)} instead of {self.dialect.value_text(name, was)} brings "
            f"{self.phenomenon.quantity} from {self._measured_text(self.configured)} "
            f"to {self._measured_text(changed)}{also}; from {source}"
        )
        return Cause(settings=(name,), line=line, tried=tuple(self._tried))


# --- other values of settings ----------------------------------------------------------------------------------------

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
    measurements: Measurements, scenario: Scenario, settings: Settings
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
        (
            preset_label(preset),
            {name: value for name, value in preset.items() if name not in RECIPES},
        ),
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
    measurements: Measurements,
    scenario: Scenario,
    settings: Settings,
    label: str | None,
) -> Iterator[tuple[str, Settings]]:
    """Yield a reference; nothing when the backend has no such preset or cannot build the scene."""
    try:
        force = measurements.in_force(scenario, settings)
    except DeclinedError:
        return
    yield label or preset_label(force), force


def preset_label(force: Settings) -> str:
    """Return the text for the preset of settings in force."""
    return f"this package's preset {force.get('preset', 'default')}"


def _values(
    name: str,
    configured: Settings,
    references: Sequence[tuple[str, Settings]],
) -> Iterator[Alternative]:
    """Yield each other value of a setting once."""
    was = _comparable(
        name,
        _reference_value(name, configured, None)
        if configured.get("newton_material")
        else configured[name],
    )
    seen = [was]
    step_s = configured.get("timestep_s")
    for label, force in references:
        if name not in force:
            continue
        value = _comparable(name, _reference_value(name, force, step_s))
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


def _reference_value(name: str, force: Settings, step_s: float | None) -> Any:
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
