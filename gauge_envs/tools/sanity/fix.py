"""Find the fix: apply documented changes as a user would paste them, and run the checks again."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import InitVar, dataclass, replace
from heapq import heapify, heappop, heappush
from typing import Any

import mujoco

from gauge_envs.errors import GaugeError, ParameterError
from gauge_envs.names import first_names
from gauge_envs.pages.text import counted
from gauge_envs.tools.sanity.candidates import candidates_of
from gauge_envs.tools.sanity.guards import hop_mm, hops_more
from gauge_envs.tools.sanity.measure import (
    Measured,
    Measurements,
    subject_of,
    worst_of,
)
from gauge_envs.tools.sanity.model import (
    ChangePart,
    Fix,
    PhenomenonResult,
    Settings,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import phenomenon
from gauge_envs.tools.sanity.robot.fix_text import write_change
from gauge_envs.tools.sanity.robot.motion import motion_harm, speed_ratio
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.selection import SIMULATED_IDS, TARGET_IDS
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.target_checks import target_rows

UNCHANGED = {*TARGET_IDS} - SIMULATED_IDS
"""Checks that no setting changes."""

GROWTH = 1.0
"""Growth of a deviation that makes a failed check worse, in half-widths of the interval of reality."""


def find_fix(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    rows: Sequence[PhenomenonResult],
) -> tuple[Fix | None, tuple[str, ...], str]:
    """Return the smallest change that resolves most checks without harm, the other changes, and the best trade.

    The fix is None when no change resolves a check without harm. The trade is the change that resolves most checks,
    with its price; it is empty when the fix resolves as many.

    Args:
        configuration: The checked configuration.
        dialect: Dialect of the target.
        measurements: Measurements on the engine of the checks.
        rows: Results of all checks.
    """
    return _Search(configuration, dialect, measurements, rows).run()


@dataclass
class _Search:
    """Applies changes and checks them; see `find_fix` for the arguments."""

    configuration: TrainingConfiguration
    dialect: Dialect
    measurements: Measurements
    rows: InitVar[Sequence[PhenomenonResult]]

    def __post_init__(self, rows: Sequence[PhenomenonResult]) -> None:
        # Short scenes come first, the target's own model last.
        changeable = [row for row in rows if row.phenomenon not in UNCHANGED]
        self._units = {row.phenomenon: row.unit for row in changeable}
        self._before = {
            row.phenomenon: _measured(row)
            for row in sorted(changeable, key=lambda row: _seconds(row.phenomenon))
            if row.is_flag or row.verdict is Verdict.PASSED
        }
        self._flags = [row.phenomenon for row in changeable if row.is_flag]
        self._applied: dict[str, TrainingConfiguration | None] = {}
        self._known: dict[tuple[str, str], Measured] = {}
        self._tried: list[str] = []

    def run(self) -> tuple[Fix | None, tuple[str, ...], str]:
        """Return what `find_fix` does."""
        model_change = self._model_change()
        candidates = [model_change] if model_change else []
        if {*self._flags} - {*TARGET_IDS}:
            general = candidates_of(self.configuration, self.dialect)
            candidates += [{**changes, **model_change} for changes in general]
        best_count, trade = 0, ""
        for changes in self._ranked(candidates):
            resolved = self._resolved(changes)
            text = f"{self.dialect.paste_text(changes)}: {self._effect(resolved)}"
            harm = ""
            for part in (self._smallest(changes, resolved), changes) * bool(resolved):
                harm = self._harm(part)
                if not harm:
                    fix = self._fix(part)
                    is_less = best_count > len(fix.fixed)
                    return fix, tuple(self._tried), trade if is_less else ""
            self._tried.append(f"{text}, but {harm}" if harm else text)
            if len(resolved) > best_count:
                best_count, trade = len(resolved), self._tried[-1]
        if self._tried:
            trade = f"; best: {trade}" if trade else ""
            trade = f"None of {len(self._tried)} changes of settings resolves a check without harm{trade}"
        return None, tuple(self._tried), trade

    def _model_change(self) -> dict[str, Any]:
        """Return a change that resolves checks of the target's own model; drop checks that no setting changes."""
        change: dict[str, Any] = {}
        for name in [name for name in self._flags if name in TARGET_IDS]:
            values = {self._before[name].value}
            for candidate in candidates_of(self.configuration, self.dialect, name):
                changes = {**change, **candidate}
                outcome = self._outcome(changes, name)
                values.add(outcome.value)
                if outcome.verdict is Verdict.PASSED:
                    change = changes
                    break
                text = self.dialect.paste_text(changes)
                self._tried.append(f"{text}: {self._progress(name, changes)}")
            if len(values) == 1:
                self._flags.remove(name)
                del self._before[name]
        return change

    # --- measurements ------------------------------------------------------------------------------------------------

    def _changed(self, changes: Settings) -> TrainingConfiguration | None:
        """Return the configuration with changes; None where it cannot have them."""
        key = str(sorted(changes.items()))
        if key not in self._applied:
            try:
                self._applied[key] = applied(self.configuration, changes)
            except GaugeError:
                self._applied[key] = None
        return self._applied[key]

    def _outcome(self, changes: Settings, name: str) -> Measured:
        """Return the outcome of a check after changes."""
        key = str(sorted(changes.items())), name
        if key not in self._known:
            self._known[key] = self._measure(self._changed(changes), name)
        return self._known[key]

    def _measure(self, changed: TrainingConfiguration | None, name: str) -> Measured:
        if changed is not None and name in TARGET_IDS:
            return _measured(target_rows(changed, [name])[0])
        if changed is not None:
            subject = subject_of(self.measurements, changed, phenomenon(name))
            if subject.sets:
                return worst_of(subject.measured())[1]
        return Measured(verdict=Verdict.NOT_MEASURED)

    def _resolves(self, changes: Settings, name: str) -> bool:
        return self._outcome(changes, name).verdict is Verdict.PASSED

    def _resolved(self, changes: Settings) -> list[str]:
        return [name for name in self._flags if self._resolves(changes, name)]

    def _ranked(self, candidates: Sequence[Settings]) -> Iterator[Settings]:
        """Yield changes, those first that resolve most checks of measured objects.

        Of equal changes, those with fewer settings come first, then the order of the candidates counts. A check runs
        only while its candidate may still resolve the most.
        """
        flags = {*self._flags} - {*TARGET_IDS}
        names = [name for name in self._before if name in flags]
        queue = [(0, len(change), index, 0) for index, change in enumerate(candidates)]
        heapify(queue)
        while queue:
            failed, size, index, count = heappop(queue)
            if count == len(names):
                yield candidates[index]
                continue
            failed += not self._resolves(candidates[index], names[count])
            heappush(queue, (failed, size, index, count + 1))

    def _harm(self, changes: Settings) -> str:
        """Return which check a change makes worse, or whether the model or sliding bodies jump; empty if not."""
        changed = self._changed(changes)
        if changed is None:
            return "the model does not take it"
        if changed.backend == "mujoco":
            before_mm, after_mm = (
                max(hop_mm(self.measurements, settings) for settings in sets.values())
                for sets in (self.configuration.contact_sets, changed.contact_sets)
            )
            if hops_more(before_mm, after_mm):
                return f"sliding bodies hop {before_mm:.2g} to {after_mm:.2g} mm"
        if changed.robot is not None:
            harm = motion_harm(self.configuration.robot, changed.robot)
            if harm:
                return harm
        for name, before in self._before.items():
            if _is_worse(before, self._outcome(changes, name)):
                return self._progress(name, changes)
        return ""

    # --- the chosen change -------------------------------------------------------------------------------------------

    def _smallest(self, changes: Settings, resolved: Sequence[str]) -> Settings:
        """Return a change without the settings that none of its resolved checks needs."""
        smallest = dict(changes)
        for name in changes:
            fewer = {key: value for key, value in smallest.items() if key != name}
            if fewer and all(self._resolves(fewer, row) for row in resolved):
                smallest = fewer
        return smallest

    def _fix(self, changes: Settings) -> Fix:
        """Return a change with what each of its settings resolves alone."""
        resolved = self._resolved(changes)
        pasted, effect = self.dialect.paste_text(changes), self._effect(resolved)
        parts = [
            ChangePart(
                text=self.dialect.paste_text({name: value}),
                corrects=tuple(self._resolved({name: value})),
            )
            for name, value in changes.items()
        ]
        fix = Fix(
            changes=changes,
            line=f"{pasted}: {effect}",
            flag_count=len(self._flags),
            fixed={name: self._outcome(changes, name).value for name in resolved},
            parts=tuple(parts),
        )
        robot, changed = self.configuration.robot, self._changed(changes)
        if robot is None or changed is None:
            return fix
        text, hidden = write_change(robot, self.dialect, changes)
        diff = () if text is None else text.diff
        added = " and ".join(line[2:] for line in diff if line[0] == "+")
        also = f", also in {first_names(hidden)}" if hidden else ""
        return replace(
            fix,
            line=f"{added or pasted}{also}: {effect}",
            lines=() if text is None else tuple(map(text.short, diff)),
            speed_ratio=speed_ratio(robot, changed.robot),
        )

    # --- texts -------------------------------------------------------------------------------------------------------

    def _progress(self, name: str, changes: Settings) -> str:
        """Return the values of a check before and after changes, as a text."""
        before, after = (
            "not measured" if outcome.value is None else f"{outcome.value:.3g}"
            for outcome in (self._before[name], self._outcome(changes, name))
        )
        return f"{name} {before} to {after} {self._units[name]}".removesuffix(" 1")

    def _effect(self, resolved: Sequence[str]) -> str:
        """Return how many checks are resolved, and which are not, as a text."""
        text = f"resolves {counted(len(resolved), 'check')}"
        failing = [name for name in self._flags if name not in resolved]
        return f"{text}, not {', '.join(failing)}" if failing and resolved else text


def _seconds(name: str) -> float:
    """Return the simulated time of a check; infinite on the target's own model."""
    return math.inf if name in TARGET_IDS else phenomenon(name).scenario.seconds


def _measured(row: PhenomenonResult) -> Measured:
    return Measured(value=row.configured, deviation=row.deviation, verdict=row.verdict)


def _is_worse(before: Measured, after: Measured) -> bool:
    """Return whether a check cannot be measured any more, has a worse verdict, or is farther from reality.

    A check cannot be measured, for example, where a robot that stood at rest falls.
    """
    if after.verdict is Verdict.NOT_MEASURED:
        return True
    if before.verdict is Verdict.PASSED:
        return after.verdict.is_off
    is_failed = after.verdict is Verdict.FAILED and before.verdict is Verdict.WARNING
    return is_failed or after.deviation > before.deviation + GROWTH


def applied(
    configuration: TrainingConfiguration, changes: Settings
) -> TrainingConfiguration:
    """Return a configuration with changes.

    Args:
        configuration: The configuration.
        changes: New values, as `Robot.changed` takes them.
    """
    robot = configuration.robot
    if robot is None:
        groups = tuple(
            replace(group, settings={**group.settings, **changes})
            for group in configuration.contact_groups
        )
        settings = {**configuration.settings, **changes}
        return replace(configuration, settings=settings, contact_groups=groups)
    model, _ = robot.changed(changes)
    try:
        mujoco.mj_forward(model, mujoco.MjData(model))
    except mujoco.FatalError as error:
        raise ParameterError(str(error)) from None
    return mujoco_configuration(
        model,
        name=configuration.name,
        source=configuration.source,
        spec=robot.spec,
        pair=robot.pair,
        file=robot.file,
    )
