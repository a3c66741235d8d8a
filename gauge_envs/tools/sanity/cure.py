"""Find the change that corrects most flags: apply documented changes as a user would paste them, and measure again."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import InitVar, dataclass, replace
from heapq import heapify, heappop, heappush
from typing import Any

from gauge_envs.errors import GaugeError, ParameterError, first_names
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
    Cure,
    PhenomenonResult,
    Settings,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import phenomenon
from gauge_envs.tools.sanity.selection import OWN_IDS, SIMULATED_IDS
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.target_checks import target_rows

UNCHANGED = {*OWN_IDS} - SIMULATED_IDS
"""Rows that no setting changes."""

GROWTH = 1.0
"""Growth of a deviation that makes a flagged row worse, in half-widths of the interval of reality."""


def find_cure(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    rows: Sequence[PhenomenonResult],
) -> tuple[Cure | None, tuple[str, ...], str]:
    """Return the smallest change that corrects most flags and harms no row, what else was tried, and the best trade.

    The change is None when none corrects a flag without harm. The trade is the change that corrects most, with its
    price; it is empty when the change without harm corrects as many flags.

    Args:
        configuration: The checked configuration.
        dialect: Dialect of the target.
        measurements: Measurements on the engine of the rows.
        rows: All rows.
    """
    return _Search(configuration, dialect, measurements, rows).run()


@dataclass
class _Search:
    """Applies changes and judges them; see `find_cure` for the arguments."""

    configuration: TrainingConfiguration
    dialect: Dialect
    measurements: Measurements
    rows: InitVar[Sequence[PhenomenonResult]]

    def __post_init__(self, rows: Sequence[PhenomenonResult]) -> None:
        # Short scenes come first, the target's own model last.
        judged = [row for row in rows if row.phenomenon not in UNCHANGED]
        self._units = {row.phenomenon: row.unit for row in judged}
        self._before = {
            row.phenomenon: _measured(row)
            for row in sorted(judged, key=lambda row: _seconds(row.phenomenon))
            if row.is_flag or row.verdict is Verdict.INSIDE
        }
        self._flags = [row.phenomenon for row in judged if row.is_flag]
        self._applied: dict[str, TrainingConfiguration | None] = {}
        self._known: dict[tuple[str, str], Measured] = {}
        self._tried: list[str] = []

    def run(self) -> tuple[Cure | None, tuple[str, ...], str]:
        """Return what `find_cure` does."""
        own = self._own_change()
        candidates = [own] if own else []
        if {*self._flags} - {*OWN_IDS}:
            general = candidates_of(self.configuration, self.dialect)
            candidates += [{**one, **own} for one in general]
        most, trade = 0, ""
        for changes in self._ranked(candidates):
            corrected = self._corrected(changes)
            text = f"{self.dialect.paste_text(changes)}: {self._effect(corrected)}"
            harm = ""
            for part in (self._least(changes, corrected), changes) * bool(corrected):
                harm = self._harm(part)
                if not harm:
                    cure = self._cure(part)
                    is_less = most > cure.mended_count
                    return cure, tuple(self._tried), trade if is_less else ""
            self._tried.append(f"{text}, but {harm}" if harm else text)
            if len(corrected) > most:
                most, trade = len(corrected), self._tried[-1]
        if self._tried:
            trade = f"; best: {trade}" if trade else ""
            trade = f"None of {len(self._tried)} changes of settings corrects a flag without harm{trade}"
        return None, tuple(self._tried), trade

    def _own_change(self) -> dict[str, Any]:
        """Return a change that corrects flagged rows on the target's own model; drop those that no setting changes."""
        own: dict[str, Any] = {}
        for name in [one for one in self._flags if one in OWN_IDS]:
            values = {self._before[name].value}
            for one in candidates_of(self.configuration, self.dialect, name):
                changes = {**own, **one}
                outcome = self._outcome(changes, name)
                values.add(outcome.value)
                if outcome.verdict is Verdict.INSIDE:
                    own = changes
                    break
                text = self.dialect.paste_text(changes)
                self._tried.append(f"{text}: {self._came(name, changes)}")
            if len(values) == 1:
                self._flags.remove(name)
                del self._before[name]
        return own

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
        """Return the outcome of a row after changes."""
        key = str(sorted(changes.items())), name
        if key not in self._known:
            self._known[key] = self._measure(self._changed(changes), name)
        return self._known[key]

    def _measure(self, changed: TrainingConfiguration | None, name: str) -> Measured:
        if changed is not None and name in OWN_IDS:
            return _measured(target_rows(changed, [name])[0])
        if changed is not None:
            subject = subject_of(self.measurements, changed, phenomenon(name))
            if subject.sets:
                return worst_of(subject.measured())[1]
        return Measured(verdict=Verdict.DECLINED)

    def _corrects(self, changes: Settings, name: str) -> bool:
        return self._outcome(changes, name).verdict is Verdict.INSIDE

    def _corrected(self, changes: Settings) -> list[str]:
        return [name for name in self._flags if self._corrects(changes, name)]

    def _ranked(self, candidates: Sequence[Settings]) -> Iterator[Settings]:
        """Yield changes, those first that correct most flagged rows on measured objects.

        Of equal ones, those with fewer settings come first, then the order of the candidates counts. A row is measured
        only while its candidate may still correct the most.
        """
        flags = {*self._flags} - {*OWN_IDS}
        names = [name for name in self._before if name in flags]
        queue = [(0, len(one), index, 0) for index, one in enumerate(candidates)]
        heapify(queue)
        while queue:
            failed, size, index, count = heappop(queue)
            if count == len(names):
                yield candidates[index]
                continue
            failed += not self._corrects(candidates[index], names[count])
            heappush(queue, (failed, size, index, count + 1))

    def _harm(self, changes: Settings) -> str:
        """Return how far a change makes a row worse, or the model or sliding bodies jump, in words; empty if not."""
        changed = self._changed(changes)
        if changed is None:
            return "the model does not take it"
        if changed.backend == "mujoco":
            before_mm, after_mm = (
                max(hop_mm(self.measurements, one) for one in sets.values())
                for sets in (self.configuration.contact_sets, changed.contact_sets)
            )
            if hops_more(before_mm, after_mm):
                return f"sliding bodies hop {before_mm:.2g} to {after_mm:.2g} mm"
        if changed.robot is not None:
            from gauge_envs.tools.sanity.robot.motion import motion_harm

            harm = motion_harm(self.configuration.robot, changed.robot)
            if harm:
                return harm
        for name, before in self._before.items():
            if _is_worse(before, self._outcome(changes, name)):
                return self._came(name, changes)
        return ""

    # --- the chosen change -------------------------------------------------------------------------------------------

    def _least(self, changes: Settings, corrected: Sequence[str]) -> Settings:
        """Return a change without the settings that no row needs which it corrects."""
        least = dict(changes)
        for name in changes:
            fewer = {key: value for key, value in least.items() if key != name}
            if fewer and all(self._corrects(fewer, row) for row in corrected):
                least = fewer
        return least

    def _cure(self, changes: Settings) -> Cure:
        """Return a change with what each of its settings corrects alone."""
        corrected = self._corrected(changes)
        parts = [
            ChangePart(
                text=self.dialect.paste_text({name: value}),
                corrects=tuple(self._corrected({name: value})),
            )
            for name, value in changes.items()
        ]
        cure = Cure(
            changes=changes,
            line=f"{self.dialect.paste_text(changes)}: {self._effect(corrected)}",
            flag_count=len(self._flags),
            mended={name: self._outcome(changes, name).value for name in corrected},
            parts=tuple(parts),
        )
        before, changed = self.configuration.robot, self._changed(changes)
        if before is None or changed is None:
            return cure
        from gauge_envs.tools.sanity.robot.mended_model import write_change
        from gauge_envs.tools.sanity.robot.motion import speed_ratio

        text, hidden = write_change(before, self.dialect, changes)
        pasted = self.dialect.paste_text(changes)
        lines = () if text is None else text.diff
        shown = () if text is None else tuple(map(text.short, lines))
        added = " and ".join(one[2:] for one in lines if one[0] == "+")
        also = f", also in {first_names(hidden)}" if hidden else ""
        return replace(
            cure,
            line=f"{added or pasted}{also}: {self._effect(corrected)}",
            lines=shown,
            speed_ratio=speed_ratio(before, changed.robot),
        )

    # --- words -------------------------------------------------------------------------------------------------------

    def _came(self, name: str, changes: Settings) -> str:
        """Return how far a row came, in words."""
        before, after = (
            "not measured" if one.value is None else f"{one.value:.3g}"
            for one in (self._before[name], self._outcome(changes, name))
        )
        return f"{name} {before} to {after} {self._units[name]}".removesuffix(" 1")

    def _effect(self, corrected: Sequence[str]) -> str:
        """Return how many flags go, and which are left, in words."""
        count = f"{len(corrected)} of {len(self._flags)} flags go"
        left = [name for name in self._flags if name not in corrected]
        return f"{count}; left: {', '.join(left)}" if left and corrected else count


def _seconds(name: str) -> float:
    """Return the simulated time of a row; infinite on the target's own model."""
    return math.inf if name in OWN_IDS else phenomenon(name).scenario.seconds


def _measured(row: PhenomenonResult) -> Measured:
    return Measured(value=row.configured, deviation=row.deviation, verdict=row.verdict)


def _is_worse(before: Measured, after: Measured) -> bool:
    """Return whether a row cannot be measured any more, has a worse verdict, or is farther from reality.

    What cannot be measured is, for example, a robot that stood at rest and falls.
    """
    if after.verdict is Verdict.DECLINED:
        return True
    if before.verdict is Verdict.INSIDE:
        return after.verdict.is_off
    is_wrong = after.verdict is Verdict.WRONG and before.verdict is Verdict.VISIBLE
    return is_wrong or after.deviation > before.deviation + GROWTH


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
    import mujoco

    from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

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
