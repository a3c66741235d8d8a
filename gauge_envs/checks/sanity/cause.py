"""Find the responsible settings: change settings one at a time and measure again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from gauge_envs.checks.sanity.measure import Measured, Measurements
from gauge_envs.checks.sanity.model import INSIDE_WITHIN, Cause, SettingTrial, Verdict
from gauge_envs.checks.sanity.phenomena import Phenomenon
from gauge_envs.checks.sanity.scenario import Scenario

__all__ = ["differing_settings", "find_cause"]

LARGEST_GROUP = 3
"""Largest number of settings that are responsible together; beyond it, the whole configuration is."""

SEEN_DEVIATION = 0.1
"""Least change of a deviation, in standard deviations, that counts as an effect of a setting."""

SAME_DEVIATION = 1.0
"""Difference of deviations, in standard deviations, that no real trial can resolve."""

NOT_NUMERICAL = ("preset", "drive_interval_s")
"""Settings that stand for other settings or follow from them."""


def differing_settings(
    measurements: Measurements, scenario: Scenario, settings: Mapping[str, Any]
) -> dict[str, tuple[Any, Any]]:
    """Return settings in force that differ from the backend's default: name to configured and default value.

    Raises:
        DeclinedError: The backend cannot build the scene, or refuses the settings for it.
    """
    default, configured = measurements.in_force(scenario, {}), measurements.in_force(scenario, settings)
    return {
        name: (value, default[name])
        for name, value in configured.items()
        if name not in NOT_NUMERICAL and name in default and default[name] != value
    }


def find_cause(
    measurements: Measurements,
    phenomenon: Phenomenon,
    settings: Mapping[str, Any],
    configured: Measured,
    default: Measured,
) -> Cause | None:
    """Find the settings that are responsible for a visible or wrong phenomenon.

    1. Each setting is put back to the backend's default. A setting explains the error when this brings the phenomenon
       into reality's scatter, or halves the error. The setting that comes closest to reality is responsible. Real
       trials cannot resolve small differences within the scatter. Of several settings there, the responsible one
       changes the default most when it is applied alone.
    2. If no setting explains the error, each setting is applied alone to the default, since several may each cause it.
    3. If that fails too, pairs of settings are put back, and then the best pair with a third setting.

    Args:
        measurements: Measurements on the backend.
        phenomenon: The phenomenon.
        settings: The configuration's settings.
        configured: Outcome in the configuration.
        default: Outcome with the backend's default.

    Returns:
        The cause; None when the phenomenon is inside reality's scatter, was declined, or the engine died.
    """
    nothing_to_explain = configured.verdict in (Verdict.INSIDE, Verdict.DECLINED) or configured.engine_died
    if nothing_to_explain or default.verdict is Verdict.DECLINED:
        return None
    search = _Search(measurements, phenomenon, settings, configured, default)
    if not search.explains(default):
        return search.default_is_no_better()
    return search.put_back_one() or search.each_alone() or search.together() or search.unexplained()


class _Search:
    """Changes settings, measures one phenomenon again, and keeps a list of all trials."""

    def __init__(
        self,
        measurements: Measurements,
        phenomenon: Phenomenon,
        settings: Mapping[str, Any],
        configured: Measured,
        default: Measured,
    ) -> None:
        self._measurements = measurements
        self._phenomenon = phenomenon
        self._settings = settings
        self._configured = configured
        self._default = default
        self._differing = differing_settings(measurements, phenomenon.scenario, settings)
        self._tried: list[SettingTrial] = []
        self._put_back: dict[str, Measured] = {}
        self._alone: dict[str, Measured] = {}

    def explains(self, changed: Measured) -> bool:
        """Return whether a change brings the phenomenon into reality's scatter, or halves the error."""
        return math.isfinite(changed.deviation) and changed.deviation <= max(
            INSIDE_WITHIN, 0.5 * self._configured.deviation
        )

    def put_back_one(self) -> Cause | None:
        """Put back each setting alone and return the one that comes closest to reality, if it explains the error."""
        self._put_back = {name: self._with_put_back((name,)) for name in self._differing}
        close = {name: changed for name, changed in self._put_back.items() if self.explains(changed)}
        if not close:
            return None
        best = min(close, key=lambda name: close[name].deviation)
        if close[best].verdict is Verdict.INSIDE:
            alike = [name for name, one in close.items() if one.deviation <= close[best].deviation + SAME_DEVIATION]
            best = self._strongest(alike) or best if len(alike) > 1 else best
        others = [f"{name} alone to {self._measured_text(close[name])}" for name in close if name != best]
        if close[best].verdict is not Verdict.INSIDE:
            others += self._completed(best)
        return self._cause((best,), close[best], also=f" ({', '.join(others)})" if others else "")

    def _strongest(self, names: Sequence[str]) -> str | None:
        """Return the setting that alone changes the default most towards the configuration.

        None when no setting alone has a visible effect.
        """
        self._alone |= {name: self._on_default(name) for name in names}
        best = max(names, key=lambda name: self._shift(self._alone[name]))
        return best if self._shift(self._alone[best]) > SEEN_DEVIATION * self._phenomenon.reality.scatter else None

    def _shift(self, alone: Measured) -> float:
        default, configured = self._default.value, self._configured.value
        if alone.verdict is Verdict.DECLINED:
            return -math.inf
        if alone.value is None or default is None or configured is None:
            return alone.deviation
        return math.copysign(1.0, configured - default) * (alone.value - default)

    def _completed(self, name: str) -> list[str]:
        """Return text about a second setting that completes the change into the scatter; empty when there is none."""
        pairs = {other: self._with_put_back((name, other)) for other in self._differing if other != name}
        best = min(pairs, key=lambda other: pairs[other].deviation, default=None)
        if best is None or pairs[best].verdict is not Verdict.INSIDE:
            return []
        return [f"with {best} too to {self._measured_text(pairs[best])}"]

    def each_alone(self) -> Cause | None:
        """Apply each setting alone to the default and return those that suffice, if putting them all back helps."""
        self._alone |= {name: self._on_default(name) for name in self._differing if name not in self._alone}
        suffice = tuple(
            name for name, one in self._alone.items() if one.verdict is not Verdict.DECLINED and not self.explains(one)
        )
        if not suffice:
            return None
        changed = self._with_put_back(suffice)
        if not self.explains(changed):
            return None
        alone = ", ".join(f"{name} {self._measured_text(self._alone[name])}" for name in suffice)
        return self._cause(suffice, changed, also=f" (each alone on the default: {alone})")

    def together(self) -> Cause | None:
        """Put back pairs, then the best pair with a third setting; return the first group that explains the error."""
        matter = [name for name in self._differing if self._matters(name)]
        group: tuple[str, ...] = ()
        for size in range(2, LARGEST_GROUP + 1):
            groups = [g for g in combinations(matter, size) if set(group) <= set(g)]
            if not groups:
                return None
            measured = {g: self._with_put_back(g) for g in groups}
            group = min(measured, key=lambda g: measured[g].deviation)
            if self.explains(measured[group]):
                return self._cause(group, measured[group])
        return None

    def unexplained(self) -> Cause:
        """Return that only the whole configuration explains the error."""
        line = f"no {LARGEST_GROUP} settings put back together explain it: " + ", ".join(self._differing)
        return Cause(settings=(), line=line, tried=tuple(self._tried))

    def default_is_no_better(self) -> Cause:
        """Return that the backend's default has at least half of the error."""
        return Cause(settings=(), line=f"also the backend's default: {self._measured_text(self._default)}")

    # --- changes ---

    def _with_put_back(self, names: tuple[str, ...]) -> Measured:
        changes = {name: self._differing[name][1] for name in names}
        measured = self._measurements.measure(self._phenomenon, {**self._settings, **changes})
        self._tried.append(SettingTrial(changes=changes, value=measured.value))
        return measured

    def _on_default(self, name: str) -> Measured:
        changes = {name: self._differing[name][0]}
        measured = self._measurements.measure(self._phenomenon, changes)
        self._tried.append(SettingTrial(changes=changes, value=measured.value, on_default=True))
        return measured

    def _matters(self, name: str) -> bool:
        """Return whether a setting has a visible effect, put back or alone; only such settings are tried in pairs."""
        return _is_seen(self._configured, self._put_back[name]) or _is_seen(self._default, self._alone[name])

    # --- words ---

    def _measured_text(self, measured: Measured) -> str:
        if measured.value is None:
            return measured.remark
        unit = "" if self._phenomenon.unit == "1" else f" {self._phenomenon.unit}"
        return f"{measured.value:.3g}{unit}"

    def _cause(self, names: tuple[str, ...], changed: Measured, also: str = "") -> Cause:
        was, instead = ([_value_text(self._differing[name][side]) for name in names] for side in (0, 1))
        subject = " and ".join(names) + (" together" if len(names) > 1 and not also else "")
        verb = "brings" if len(names) == 1 else "bring"
        line = (
            f"{subject}: {', '.join(instead)} instead of {', '.join(was)} {verb} {self._phenomenon.quantity} "
            f"from {self._measured_text(self._configured)} to {self._measured_text(changed)}{also}"
        )
        return Cause(settings=names, line=line, tried=tuple(self._tried))


def _is_seen(before: Measured, after: Measured) -> bool:
    if before.value is None or after.value is None:
        return before.value is not after.value
    return abs(after.deviation - before.deviation) > SEEN_DEVIATION


def _value_text(value: Any) -> str:
    if value is None:
        return "the preset's default"
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"({', '.join(map(_value_text, value))})" if isinstance(value, list | tuple) else str(value)
