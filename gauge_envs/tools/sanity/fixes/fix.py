"""Find the fix: apply documented changes as a user would paste them, and run the checks again."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from heapq import heapify, heappop, heappush
from typing import Any

from gauge_envs.errors import GaugeError
from gauge_envs.names import first_names
from gauge_envs.tools.sanity.fixes.candidates import candidates_of
from gauge_envs.tools.sanity.fixes.change import applied
from gauge_envs.tools.sanity.fixes.harm import contact_harm, motion_harm, speed_ratio
from gauge_envs.tools.sanity.fixes.text_change import paste_text, write_change
from gauge_envs.tools.sanity.object_checks.measure import Measurements
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS, check_result
from gauge_envs.tools.sanity.verdict import (
    WORSE_BY,
    Fix,
    PartOutcome,
    Report,
    SanityResult,
    SanityVerdict,
    Settings,
    TrainingConfiguration,
)


class FixSearch:
    """Searches the smallest change of settings that resolves most checks without harm, by trial.

    Args:
        report: Report of all checks of a model.
        robot: The model.
        measurements: Measurements on the engine of the checks.
    """

    def __init__(
        self, report: Report, robot: Robot, measurements: Measurements
    ) -> None:
        self.report, self.robot, self.measurements = report, robot, measurements
        self.configuration = report.configuration
        changeable = [
            result
            for result in report.checks
            if result.id not in TARGET_CHECKS or TARGET_CHECKS[result.id].is_simulated
        ]
        # The target's own model comes last.
        self._before = {
            result.id: _outcome_of(result)
            for result in sorted(
                changeable, key=lambda result: result.id in TARGET_CHECKS
            )
            if result.is_flag or result.verdict is SanityVerdict.PASSED
        }
        self._flags = [result.id for result in changeable if result.is_flag]
        self._applied: dict[str, TrainingConfiguration | None] = {}
        self._known: dict[tuple[str, str], PartOutcome] = {}

    def run(self) -> Report:
        """Return the report with the fix, or with the number of changes that were tried."""
        tried = 0
        for changes in self._ranked(self._candidates()):
            tried += 1
            resolved = self._resolved(changes)
            parts = (self._smallest(changes, resolved), changes) if resolved else ()
            for part in parts:
                if not self._harms(part):
                    return replace(self.report, fix=self._fix(part))
        trade = f"No safe fix of the settings found ({tried} tried)." if tried else ""
        return replace(self.report, trade=trade)

    def _candidates(self) -> list[dict[str, Any]]:
        """Return the changes that may resolve checks."""
        model_change = self._model_change()
        candidates = [model_change] if model_change else []
        if any(map(_is_general, self._flags)):
            general = candidates_of(self.configuration)
            candidates += [{**changes, **model_change} for changes in general]
        return candidates

    def _model_change(self) -> dict[str, Any]:
        """Return a change that resolves checks of the target's own model; drop checks that no setting changes."""
        change: dict[str, Any] = {}
        # Wrong forces of the solver may explain all other findings.
        for name in sorted(self._flags, key="model-solver".__ne__):
            if _is_general(name):
                continue
            values = {self._before[name].value}
            candidates = candidates_of(self.configuration, name)
            for candidate in [{}, *candidates] if change else candidates:
                changes = {**change, **candidate}
                outcome = self._outcome(changes, name)
                values.add(outcome.value)
                if outcome.verdict is SanityVerdict.PASSED:
                    change = changes
                    break
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

    def _outcome(self, changes: Settings, name: str) -> PartOutcome:
        """Return the outcome of a check after changes."""
        key = str(sorted(changes.items())), name
        if key not in self._known:
            changed = self._changed(changes)
            self._known[key] = PartOutcome(verdict=SanityVerdict.NOT_MEASURED)
            if changed is not None:
                result = check_result(self.measurements, changed, name)
                self._known[key] = _outcome_of(result)
        return self._known[key]

    def _resolves(self, changes: Settings, name: str) -> bool:
        return self._outcome(changes, name).verdict is SanityVerdict.PASSED

    def _resolved(self, changes: Settings) -> list[str]:
        return [name for name in self._flags if self._resolves(changes, name)]

    def _ranked(self, candidates: Sequence[Settings]) -> Iterator[Settings]:
        """Yield changes, those first that resolve most checks of measured objects.

        Of equal changes, those with fewer settings come first, then the order of the candidates counts. A check runs
        only while its candidate may still resolve the most.
        """
        objects = [*filter(_is_general, self._flags)]
        names = [name for name in self._before if name in objects]
        queue = [(0, len(change), index, 0) for index, change in enumerate(candidates)]
        heapify(queue)
        while queue:
            failed, size, index, count = heappop(queue)
            if count == len(names):
                yield candidates[index]
                continue
            failed += not self._resolves(candidates[index], names[count])
            heappush(queue, (failed, size, index, count + 1))

    def _harms(self, changes: Settings) -> bool:
        """Return whether a change makes a check worse, or the model or sliding bodies jump."""
        changed = self._changed(changes)
        if changed is None or contact_harm(self.configuration, changed):
            return True
        assert changed.robot is not None, "a model stays one"
        return motion_harm(self.robot, changed.robot) or any(
            _is_worse(before, self._outcome(changes, name))
            for name, before in self._before.items()
        )

    # --- the chosen change -------------------------------------------------------------------------------------------

    def _smallest(self, changes: Settings, resolved: Sequence[str]) -> Settings:
        """Return a change without the settings that none of its resolved checks needs."""
        smallest = dict(changes)
        # A dense Jacobian changes no physics: it goes last.
        for name in sorted(changes, key="jacobian".__eq__):
            fewer = {key: value for key, value in smallest.items() if key != name}
            if fewer and all(self._resolves(fewer, check) for check in resolved):
                smallest = fewer
        return smallest

    def _fix(self, changes: Settings) -> Fix:
        """Return a change as text, with what it resolves."""
        changed, resolved = self._changed(changes), self._resolved(changes)
        assert changed is not None and changed.robot is not None, "it was applied"
        text, hidden = write_change(self.robot, changes)
        lines = [] if text is None else text.diff
        added = [line[2:] for line in lines if line.startswith("+")]
        also = f", also in {first_names(hidden)}" if hidden else ""
        return Fix(
            changes=changes,
            line=f"{' and '.join(added) or paste_text(changes)}{also}",
            fixed={name: self._outcome(changes, name).value for name in resolved},
            lines=tuple(lines),
            speed_ratio=speed_ratio(self.robot, changed.robot),
        )


OWN_CONTACTS = ("foot-creep", "grasp-creep")
"""Checks of contacts of the target, which the changes for measured objects may resolve."""


def _is_general(name: str) -> bool:
    """Return whether the changes for measured objects may resolve a check."""
    return name not in TARGET_CHECKS or name in OWN_CONTACTS


def _outcome_of(result: SanityResult) -> PartOutcome:
    return PartOutcome(
        value=result.configured, deviation=result.deviation, verdict=result.verdict
    )


def _is_worse(before: PartOutcome, after: PartOutcome) -> bool:
    """Return whether a check cannot be measured any more, has a worse verdict, or is farther from reality.

    A check cannot be measured, for example, where a robot that stood at rest falls.
    """
    if after.verdict is SanityVerdict.NOT_MEASURED:
        return True
    if before.verdict is SanityVerdict.PASSED:
        return after.verdict.is_off
    is_failed = (
        after.verdict is SanityVerdict.FAILED
        and before.verdict is SanityVerdict.WARNING
    )
    return is_failed or after.deviation > before.deviation + WORSE_BY
