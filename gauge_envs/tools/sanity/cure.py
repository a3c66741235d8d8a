"""Find the change that corrects most flags: apply documented changes as a user would paste them, and measure again."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING, Any, NamedTuple

from gauge_envs.errors import GaugeError, ParameterError, first_names
from gauge_envs.tools.sanity.candidates import candidates_of
from gauge_envs.tools.sanity.guards import hop_mm, hops_more
from gauge_envs.tools.sanity.measure import Measurements, subject_of, worst_of
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

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.mjcf_text import TextChange
    from gauge_envs.tools.sanity.robot.robot import Robot

GROWTH = 1.0
"""Growth of a deviation that makes a flagged row worse, in half-widths of the interval of reality."""

MAX_RESTORED = 2
"""Most settings that are left out and restored one by one; after them all are restored."""

SPEED_BLOCKS, BLOCK_S = 4, 0.02
"""Number and least time [s] of the pieces in which the speed of a model is measured; the fastest one counts."""


class Outcome(NamedTuple):
    """Outcome of a row: its verdict, value, and distance from reality in half-widths of its interval."""

    verdict: Verdict
    value: float | None
    deviation: float

    @property
    def text(self) -> str:
        """The value in words."""
        return "not measured" if self.value is None else f"{self.value:.3g}"


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


class _Search:
    """Applies changes and judges them; see `find_cure` for the arguments."""

    def __init__(
        self,
        configuration: TrainingConfiguration,
        dialect: Dialect,
        measurements: Measurements,
        rows: Sequence[PhenomenonResult],
    ) -> None:
        self._configuration, self._dialect = configuration, dialect
        self._measurements = measurements
        unchanged = {*OWN_IDS} - SIMULATED_IDS
        judged = [row for row in rows if row.phenomenon not in unchanged]
        self._units = {row.phenomenon: row.unit for row in judged}
        self._before = {
            row.phenomenon: Outcome(row.verdict, row.configured, row.deviation)
            for row in judged
            if row.is_flag or row.verdict is Verdict.INSIDE
        }
        self._flags = [row.phenomenon for row in judged if row.is_flag]
        self._applied: dict[str, TrainingConfiguration] = {}
        self._known: dict[tuple[str, str], Outcome] = {}

    def run(self) -> tuple[Cure | None, tuple[str, ...], str]:
        """Return what `find_cure` does."""
        tried: list[str] = []
        best, trade = 0, ""
        quick = [name for name in self._flags if not self._is_slow(name)]
        own = self._own_change(tried)
        candidates = [own] * bool(own)
        if {*self._flags} - {*OWN_IDS}:
            general = candidates_of(self._configuration, self._dialect)
            candidates += [{**one, **own} for one in general]
        for changes, corrected in self._ranked(candidates, tried):
            text = self._dialect.paste_text(changes)
            if not corrected and changes != own:
                came = (self._came(name, changes) for name in quick)
                tried.append(f"{text}: {', '.join(came)}")
                continue
            least, harm = self._least(changes, corrected, own)
            if not harm:
                cure = self._cure(least)
                return cure, tuple(tried), trade if best > cure.mended_count else ""
            tried.append(f"{text}: {self._effect(corrected)}, but {harm}")
            if len(corrected) > best:
                best, trade = len(corrected), tried[-1]
        if tried:
            trade = f"; best: {trade}" if trade else ""
            trade = f"None of {len(tried)} changes of settings corrects a flag without harm{trade}"
        return None, tuple(tried), trade

    def _least(
        self, changes: Settings, corrected: Sequence[str], own: Settings
    ) -> tuple[Settings, str]:
        """Return the part of a change that is needed, or all of it, and the harm that it does; empty for none."""
        harm = self._harm(changes, corrected, is_slow=False)
        if harm:
            return changes, harm
        for least in (self._minimal(changes, corrected, own), changes):
            harm = self._harm(least, corrected, is_slow=True)
            if not harm:
                return least, ""
        return changes, harm

    def _own_change(self, tried: list[str]) -> dict[str, Any]:
        """Return a change that corrects flagged rows on the target's own model; drop those that no setting changes."""
        own: dict[str, Any] = {}
        for name in [one for one in self._flags if one in OWN_IDS]:
            values = {self._before[name].value}
            for one in candidates_of(self._configuration, self._dialect, name):
                changes = {**own, **one}
                with suppress(GaugeError):
                    values.add(self._outcome(changes, name).value)
                    if self._corrects(changes, name):
                        own = changes
                        break
                    came = self._came(name, changes)
                    tried.append(f"{self._dialect.paste_text(changes)}: {came}")
            if len(values) == 1:
                self._flags.remove(name)
                del self._before[name]
        return own

    # --- measurements ------------------------------------------------------------------------------------------------

    def _changed(self, changes: Settings) -> TrainingConfiguration:
        key = str(changes)
        if key not in self._applied:
            self._applied[key] = applied(self._configuration, changes)
        return self._applied[key]

    def _outcome(self, changes: Settings, name: str) -> Outcome:
        """Return the outcome of a row after changes."""
        key = _key(changes, name)
        if key not in self._known:
            self._known[key] = self._measured(self._changed(changes), name)
        return self._known[key]

    def _is_slow(self, name: str) -> bool:
        """Return whether a row is on the target's own model or on a scene of many bodies."""
        return name in OWN_IDS or phenomenon(name).has_many_bodies

    def _measured(self, changed: TrainingConfiguration, name: str) -> Outcome:
        if name in OWN_IDS:
            row = target_rows(changed, [name])[0]
            return Outcome(row.verdict, row.configured, row.deviation)
        subject = subject_of(self._measurements, changed, phenomenon(name))
        if not subject.sets:
            return Outcome(Verdict.DECLINED, None, 0.0)
        _, worst = worst_of(subject.measured())
        return Outcome(worst.verdict, worst.value, worst.deviation)

    def _corrects(self, changes: Settings, name: str) -> bool:
        return self._outcome(changes, name).verdict is Verdict.INSIDE

    def _ranked(
        self, candidates: Sequence[Settings], tried: list[str]
    ) -> Iterator[tuple[Settings, list[str]]]:
        """Yield changes and the flagged rows that they correct, those that correct most first.

        Of equal ones, those with fewer settings come first, then the order of the candidates counts. A row is measured
        only while its candidate may still correct the most; slow rows only where no others are flagged.
        """
        slow = [name for name in self._flags if name not in OWN_IDS]
        names = [name for name in slow if not self._is_slow(name)] or slow
        queue = [(0, len(one), index, 0) for index, one in enumerate(candidates)]
        heapify(queue)
        while queue:
            failed, size, index, count = heappop(queue)
            changes = candidates[index]
            if count == len(names):
                yield changes, [one for one in names if self._corrects(changes, one)]
                continue
            try:
                failed += not self._corrects(changes, names[count])
            except GaugeError as error:
                tried.append(f"{self._dialect.paste_text(changes)}: {error}")
                continue
            heappush(queue, (failed, size, index, count + 1))

    def _harm(
        self, changes: Settings, corrected: Sequence[str], *, is_slow: bool
    ) -> str:
        """Return how far a change makes a row worse, or sliding bodies hop, in words; empty when it does not.

        Args:
            changes: The change.
            corrected: Rows that it corrects.
            is_slow: Whether to measure slow rows instead of quick ones and sliding bodies.
        """
        if not is_slow and self._configuration.backend == "mujoco":
            before_mm, after_mm = (
                max(hop_mm(self._measurements, one) for one in sets.values())
                for sets in (
                    self._configuration.contact_sets,
                    self._changed(changes).contact_sets,
                )
            )
            if hops_more(before_mm, after_mm):
                return f"sliding bodies hop {before_mm:.2g} to {after_mm:.2g} mm"
        for name, before in self._before.items():
            if self._is_slow(name) is is_slow:
                after = self._outcome(changes, name)
                is_lost = name in corrected and after.verdict is not Verdict.INSIDE
                if is_lost or _is_worse(before, after):
                    return self._came(name, changes)
        return ""

    # --- the chosen change -------------------------------------------------------------------------------------------

    def _cure(self, changes: Settings) -> Cure:
        """Return a change with what each of its settings corrects alone."""
        corrected = [name for name in self._flags if self._corrects(changes, name)]
        # Scenes of many bodies take too long for each setting.
        quick = [one for one in corrected if one in OWN_IDS or not self._is_slow(one)]
        parts = []
        for name, value in changes.items():
            alone = {name: value}
            corrects = [row for row in quick if self._corrects(alone, row)]
            text = self._dialect.paste_text(alone)
            parts.append(ChangePart(text=text, corrects=tuple(corrects)))
        if len(parts) == 1:
            parts = [replace(parts[0], corrects=tuple(corrected))]
        robot = self._configuration.robot
        lines, pasted = self._lines(changes)
        return Cure(
            changes=changes,
            line=f"{pasted}: {self._effect(corrected)}",
            flag_count=len(self._flags),
            mended={name: self._outcome(changes, name).value for name in corrected},
            lines=lines,
            parts=tuple(parts),
            speed_ratio=None if robot is None else speed_ratio(robot, changes),
        )

    def _lines(self, changes: Settings) -> tuple[tuple[str, ...], str]:
        """Return a change as lines of a diff, if the target's text is known, and as text to paste."""
        pasted = self._dialect.paste_text(changes)
        if self._configuration.robot is None:
            return (), pasted
        text, hidden = written_change(self._configuration.robot, self._dialect, changes)
        lines = () if text is None else text.diff
        added = " and ".join(one[2:] for one in lines if one[0] == "+")
        also = f", also in {first_names(hidden)}" if hidden else ""
        return lines, (added or pasted) + also

    def _minimal(
        self, changes: Settings, corrected: Sequence[str], kept: Settings
    ) -> Settings:
        """Return a change without the settings that quick rows do not need, but for those that are kept."""
        quick = [name for name in corrected if not self._is_slow(name)]
        least, left_out = dict(changes), {}
        for name in [*changes, *changes]:
            fewer = {key: value for key, value in least.items() if key != name}
            if name in kept or name not in least or not fewer or not quick:
                continue
            needed = next((r for r in quick if not self._corrects(fewer, r)), None)
            if needed is None:
                left_out[name] = least.pop(name)
            else:
                # What one change needs, the next one often needs too.
                quick.remove(needed)
                quick.insert(0, needed)
        count = len(left_out)
        while left_out and self._harm(least, corrected, is_slow=False):
            if len(left_out) <= count - MAX_RESTORED:
                return changes
            name, value = left_out.popitem()
            least[name] = value
        return least

    # --- words -------------------------------------------------------------------------------------------------------

    def _came(self, name: str, changes: Settings) -> str:
        """Return how far a row came, in words."""
        before, after = self._before[name].text, self._outcome(changes, name).text
        unit = self._units[name]
        return f"{name} {before} to {after} {unit}".removesuffix(" 1")

    def _effect(self, corrected: Sequence[str]) -> str:
        """Return how many flags go, and which are left, in words."""
        if len(self._flags) == 1:
            return "the one flag goes"
        left = [name for name in self._flags if name not in corrected]
        count = f"{len(corrected)} of {len(self._flags)} flags go"
        return f"{count}; left: {', '.join(left)}" if left else count


def _key(changes: Settings, name: str) -> tuple[str, str]:
    return str(sorted(changes.items())), name


def _is_worse(before: Outcome, after: Outcome) -> bool:
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


def written_change(
    robot: Robot, dialect: Dialect, changes: Settings
) -> tuple[TextChange | None, list[str]]:
    """Return a change in the text of a model, and elements whose attributes the text does not show, in words.

    Args:
        robot: The robot before the change.
        dialect: Dialect of the model.
        changes: The change.
    """
    from gauge_envs.tools.sanity.robot.mended_model import write_change

    assignments = {
        one.name: (one.place, one.key, (one.text or dialect.text)(changes[one.name]))
        for one in dialect.settings
        if one.name in changes
    }
    return write_change(robot, changes, assignments)


def speed_ratio(robot: Robot, changes: Settings) -> float:
    """Return the simulated time of a model in a second of the processor with changes, over that without."""
    import mujoco

    runs: list[tuple[mujoco.MjModel, mujoco.MjData, list[float]]] = [
        (model, mujoco.MjData(model), [])
        for model in (robot.model, robot.changed(changes)[0])
    ]
    for _ in range(SPEED_BLOCKS):
        for model, data, speeds in runs:
            started, before_s, spent_s = time.process_time(), data.time, 0.0
            while spent_s < BLOCK_S:
                mujoco.mj_step(model, data, nstep=10)
                spent_s = time.process_time() - started
            speeds.append((data.time - before_s) / spent_s)
    before, after = (max(speeds) for _, _, speeds in runs)
    return after / before
