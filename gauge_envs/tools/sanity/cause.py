"""Find the responsible settings: change settings one at a time and measure again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

from gauge_envs.tools.sanity.alternatives import Alternative, alternatives, preset_label
from gauge_envs.tools.sanity.measure import Measured, Measurements
from gauge_envs.tools.sanity.model import INSIDE_WITHIN, Cause, SettingTrial, Verdict
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.stacks.dialect import TOML, Dialect

LARGEST_GROUP = 3
"""Largest number of settings that are responsible together; beyond it, the whole configuration is."""

SEEN_DEVIATION = 0.05
"""Least change of a deviation, in half-widths of the interval, that counts as an effect of a setting."""

SAME_DEVIATION = 0.5
"""Difference of deviations, in half-widths of the interval, that no real trial can resolve."""


def find_cause(
    measurements: Measurements,
    phenomenon: Phenomenon,
    settings: Mapping[str, Any],
    configured: Measured,
    default: Measured,
    dialect: Dialect = TOML,
) -> Cause | None:
    """Find the settings that are responsible for a visible or wrong phenomenon.

    1. Each setting is put back to the engine's documented default and to this package's preset. A setting explains the
       error when this brings the phenomenon into the interval of reality, or halves the error. The setting that comes
       closest to reality is responsible. Real trials cannot resolve small differences within the interval. Of several
       settings there, the responsible one changes the preset most when it is applied alone.
    2. If no setting explains the error, each setting is applied alone to the preset, since several may each cause it.
    3. If that fails too, pairs of settings are put back, and then the best pair with a third setting.

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
    nothing_to_explain = configured.verdict in (Verdict.INSIDE, Verdict.DECLINED) or configured.engine_died
    if nothing_to_explain or default.verdict is Verdict.DECLINED:
        return None
    search = _Search(measurements, phenomenon, settings, configured, default, dialect)
    return search.put_back_one() or search.default_is_no_better() or search.each_alone() or search.together()


class _Search:
    """Changes settings, measures one phenomenon again, and keeps a list of all trials."""

    def __init__(
        self,
        measurements: Measurements,
        phenomenon: Phenomenon,
        settings: Mapping[str, Any],
        configured: Measured,
        default: Measured,
        dialect: Dialect,
    ) -> None:
        self._measurements, self._phenomenon, self._settings = measurements, phenomenon, settings
        self._configured, self._default, self._dialect = configured, default, dialect
        self._others = alternatives(measurements, phenomenon.scenario, settings)
        self._best = {name: several[-1] for name, several in self._others.items()}
        self._tried: list[SettingTrial] = []
        self._put_back: dict[str, Measured] = {}
        self._alone: dict[str, Measured] = {}

    def _explains(self, changed: Measured) -> bool:
        """Return whether a change brings the phenomenon into the interval of reality, or halves the error."""
        return math.isfinite(changed.deviation) and changed.deviation <= max(
            INSIDE_WITHIN, 0.5 * self._configured.deviation
        )

    def put_back_one(self) -> Cause | None:
        """Put back each setting alone and return the one that comes closest to reality, if it explains the error."""
        for name, several in self._others.items():
            measured = [(self._changed({name: one.value}), one) for one in several]
            # Of several values that mend the row, the first is taken: the engine's documented default.
            self._put_back[name], self._best[name] = min(
                measured, key=lambda pair: 0.0 if pair[0].verdict is Verdict.INSIDE else pair[0].deviation
            )
        close = {name: changed for name, changed in self._put_back.items() if self._explains(changed)}
        if not close:
            return None
        best = min(close, key=lambda name: close[name].deviation)
        if close[best].verdict is Verdict.INSIDE:
            alike = [name for name, one in close.items() if one.deviation <= close[best].deviation + SAME_DEVIATION]
            best = self._strongest(alike) or best if len(alike) > 1 else best
        others = [
            f"{self._assignment(name)} alone to {self._measured_text(close[name])}" for name in close if name != best
        ]
        if close[best].verdict is not Verdict.INSIDE:
            others += self._completed(best)
        return self._cause((best,), close[best], also=f" ({', '.join(others)})" if others else "")

    def _strongest(self, names: Sequence[str]) -> str | None:
        """Return the setting that alone changes the default most towards the configuration.

        None when no setting alone has a visible effect.
        """
        self._alone |= {name: self._on_default(name) for name in names}
        best = max(names, key=lambda name: self._shift(self._alone[name]))
        return best if self._shift(self._alone[best]) > SEEN_DEVIATION * self._phenomenon.reality.tolerance else None

    def _shift(self, alone: Measured) -> float:
        default, configured = self._default.value, self._configured.value
        if alone.verdict is Verdict.DECLINED:
            return -math.inf
        if alone.value is None or default is None or configured is None:
            return alone.deviation
        return math.copysign(1.0, configured - default) * (alone.value - default)

    def _completed(self, name: str) -> list[str]:
        """Return text about a second setting that completes the change; empty when there is none."""
        pairs = {other: self._with_put_back((name, other)) for other in self._others if other != name}
        best = min(pairs, key=lambda other: pairs[other].deviation, default=None)
        if best is None or pairs[best].verdict is not Verdict.INSIDE:
            return []
        return [f"with {self._assignment(best)} too to {self._measured_text(pairs[best])}"]

    def each_alone(self) -> Cause | None:
        """Apply each setting alone to the default and return those that suffice, if putting them all back helps."""
        self._alone |= {name: self._on_default(name) for name in self._others if name not in self._alone}
        suffice = tuple(
            name for name, one in self._alone.items() if one.verdict is not Verdict.DECLINED and not self._explains(one)
        )
        if not suffice:
            return None
        changed = self._with_put_back(suffice)
        if not self._explains(changed):
            # Training may not afford the preset's own step, but it shows what is responsible.
            found, self._best = self._best, self._best | {name: self._of_preset(name) for name in suffice}
            changed = self._with_put_back(suffice)
            if not self._explains(changed):
                self._best = found
                return None
        alone = ", ".join(f"{name} {self._measured_text(self._alone[name])}" for name in suffice)
        return self._cause(suffice, changed, also=f" (each alone on this package's preset: {alone})")

    def together(self) -> Cause:
        """Put back pairs, then the best pair with a third setting; return the first group that explains the error.

        Without such a group, only the whole configuration explains it.
        """
        # A setting matters if it has a visible effect, put back or alone.
        matter = [
            name
            for name in self._others
            if _is_seen(self._configured, self._put_back[name]) or _is_seen(self._default, self._alone[name])
        ]
        group: tuple[str, ...] = ()
        for size in range(2, LARGEST_GROUP + 1):
            groups = [g for g in combinations(matter, size) if set(group) <= set(g)]
            if not groups:
                break
            measured = {g: self._with_put_back(g) for g in groups}
            group = min(measured, key=lambda g: measured[g].deviation)
            if self._explains(measured[group]):
                return self._cause(group, measured[group])
        return self._unexplained(f"no reset of up to {LARGEST_GROUP} settings explains it: " + ", ".join(self._others))

    def default_is_no_better(self) -> Cause | None:
        """Return that this package's preset has at least half of the error, if it has."""
        if self._explains(self._default):
            return None
        text = self._measured_text(self._default)
        return self._unexplained(f"no setting alone explains it; this package's preset: {text}")

    def _unexplained(self, line: str) -> Cause:
        return Cause(settings=(), line=line, tried=tuple(self._tried))

    def _of_preset(self, name: str) -> Alternative:
        """Return the value of a setting in this package's preset of the scene."""
        preset = self._measurements.in_force(self._phenomenon.scenario, {})
        return replace(self._best[name], value=preset[name], source=preset_label(preset))

    # --- changes ---

    def _with_put_back(self, names: tuple[str, ...]) -> Measured:
        return self._changed({name: self._best[name].value for name in names})

    def _changed(self, changes: dict[str, Any], *, on_default: bool = False) -> Measured:
        settings = changes if on_default else {**self._settings, **changes}
        measured = self._measurements.measure(self._phenomenon, settings)
        self._tried.append(SettingTrial(changes=changes, value=measured.value, on_default=on_default))
        return measured

    def _on_default(self, name: str) -> Measured:
        return self._changed({name: self._best[name].was}, on_default=True)

    # --- words ---

    def _measured_text(self, measured: Measured) -> str:
        if measured.value is None:
            return measured.remark
        unit = "" if self._phenomenon.unit == "1" else f" {self._phenomenon.unit}"
        return f"{measured.value:.3g}{unit}"

    def _assignment(self, name: str) -> str:
        text = self._dialect.assignment(name, self._best[name].value)
        return text if self._dialect.writes(name) else f"{text} (which the target has no key for)"

    def _cause(self, names: tuple[str, ...], changed: Measured, also: str = "") -> Cause:
        chosen = [self._best[name] for name in names]
        subject = " and ".join(
            f"{self._assignment(one.name)} instead of {self._dialect.value_text(one.name, one.was)}" for one in chosen
        )
        together = " together" if len(names) > 1 and not also else ""
        sources = " and ".join(dict.fromkeys(one.source for one in chosen))
        verb = "brings" if len(names) == 1 else "bring"
        line = (
            f"{subject}{together} {verb} {self._phenomenon.quantity} from {self._measured_text(self._configured)} "
            f"to {self._measured_text(changed)}{also}; from {sources}"
        )
        return Cause(settings=names, line=line, tried=tuple(self._tried))


def _is_seen(before: Measured, after: Measured) -> bool:
    if before.value is None or after.value is None:
        return before.value is not after.value
    return abs(after.deviation - before.deviation) > SEEN_DEVIATION
