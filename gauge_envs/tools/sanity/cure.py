"""Find the change that corrects most flags: apply documented changes as a user would paste them, and measure again."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING, NamedTuple

from gauge_envs.errors import GaugeError
from gauge_envs.tools.sanity.candidates import candidates_of
from gauge_envs.tools.sanity.guards import hop_mm, hops_more
from gauge_envs.tools.sanity.measure import (
    SEVERITY,
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
from gauge_envs.tools.sanity.phenomena import STATED_IDS, phenomenon
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.target_checks import target_rows

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.mended_model import WrittenChange
    from gauge_envs.tools.sanity.robot.robot import Robot

CHANGED_ROBOT_IDS = frozenset(
    f"robot-{name}" for name in ("holds", "energy", "slip", "servo", "lag")
)
"""Rows on the robot that settings of the engine change; others are left out of the judgement."""

GROWTH = 1.0
"""Growth of a deviation that makes a flagged row worse, in half-widths of the interval of reality."""

SPEED_BLOCKS, BLOCK_S = 5, 0.02
"""Number and least time [s] of the pieces in which the speed of a model is measured; the fastest one counts."""


class Outcome(NamedTuple):
    """Outcome of a row: its verdict, value, and distance from reality in half-widths of its interval."""

    verdict: Verdict
    value: float | None
    deviation: float

    @property
    def text(self) -> str:
        """The value, or the verdict where nothing was measured."""
        return str(self.verdict) if self.value is None else f"{self.value:.3g}"


def find_cure(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    rows: Sequence[PhenomenonResult],
) -> tuple[Cure | None, tuple[str, ...], str]:
    """Return the smallest change that corrects most flags and harms no row, what else was tried, and the best trade.

    The change is None when none corrects a flag without harm. The trade is then the change that corrects most, with
    its price; it is empty when no change corrects a flag.

    Args:
        configuration: The checked configuration.
        dialect: Dialect of the target.
        measurements: Measurements on the engine of the rows.
        rows: All rows.
    """
    return _Search(configuration, dialect, measurements, rows).run()


def _is_changed(name: str) -> bool:
    """Return whether settings of the engine change a row."""
    return (
        name not in STATED_IDS or name.startswith("model-") or name in CHANGED_ROBOT_IDS
    )


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
        judged = [row for row in rows if _is_changed(row.phenomenon)]
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
        trade = ""
        if not self._flags:
            return None, (), ""
        candidates = candidates_of(self._configuration, self._dialect, self._flags)
        for changes, corrected in self._ranked(candidates, tried):
            pasted = self._pasted(changes)
            if not corrected:
                came = (self._came(name, changes) for name in self._flags)
                tried.append(f"{pasted}: {', '.join(came)}")
                continue
            effect = self._effect(corrected)
            if harm := self._harm(changes, corrected):
                tried.append(f"{pasted}: {effect}, but {', '.join(harm)}")
                trade = trade or tried[-1]
                continue
            return self._cure(changes, corrected), tuple(tried), ""
        return None, tuple(tried), trade

    # --- measurements ------------------------------------------------------------------------------------------------

    def _changed(self, changes: Settings) -> TrainingConfiguration:
        key = str(changes)
        if key not in self._applied:
            self._applied[key] = applied(self._configuration, changes)
        return self._applied[key]

    def _outcome(self, changes: Settings, name: str) -> Outcome:
        """Return the outcome of a row after changes."""
        key = str(sorted(changes.items())), name
        if key not in self._known:
            self._known[key] = self._measured(self._changed(changes), name)
        return self._known[key]

    def _measured(self, changed: TrainingConfiguration, name: str) -> Outcome:
        if name in STATED_IDS:
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
        only while its candidate may still correct the most, and rows on scenes of many bodies last.
        """
        slow = [
            name
            for name in self._flags
            if name in STATED_IDS or phenomenon(name).has_many_bodies
        ]
        names = sorted(self._flags, key=lambda name: name in slow)
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

    def _harm(self, changes: Settings, corrected: Sequence[str]) -> list[str]:
        """Return rows that a change makes worse, and how far bodies that slide hop after it, in words."""
        worse = [
            self._came(name, changes)
            for name, before in self._before.items()
            if name not in corrected and _is_worse(before, self._outcome(changes, name))
        ]
        if self._configuration.backend == "mujoco":
            hops_mm = [
                max(
                    hop_mm(self._measurements, settings)
                    for settings in one.contact_sets.values()
                )
                for one in (self._configuration, self._changed(changes))
            ]
            if hops_more(*hops_mm):
                worse.append(
                    f"sliding bodies hop {hops_mm[0]:.2g} to {hops_mm[1]:.2g} mm"
                )
        return worse

    # --- the chosen change -------------------------------------------------------------------------------------------

    def _cure(self, changes: Settings, corrected: Sequence[str]) -> Cure:
        """Return a change without the settings that it does not need, and what each of the others corrects alone."""
        for name in [*changes]:
            fewer = {key: value for key, value in changes.items() if key != name}
            if (
                fewer
                and all(self._corrects(fewer, row) for row in corrected)
                and not self._harm(fewer, corrected)
            ):
                changes = fewer
        parts = []
        for name, value in changes.items():
            alone = {name: value}
            corrects = [row for row in corrected if self._corrects(alone, row)]
            parts.append(
                ChangePart(
                    text=self._dialect.paste_text(alone), corrects=tuple(corrects)
                )
            )
        robot, written = self._configuration.robot, self._written(changes)
        return Cure(
            changes=changes,
            line=f"{self._pasted(changes)}: {self._effect(corrected)}",
            flag_count=len(self._flags),
            mended={name: self._outcome(changes, name).value for name in corrected},
            lines=() if written is None else written.lines,
            parts=tuple(parts),
            speed_ratio=None if robot is None else speed_ratio(robot, changes),
        )

    def _written(self, changes: Settings) -> WrittenChange | None:
        """Return a change in the text of the target's model; None without a model."""
        if self._configuration.robot is None:
            return None
        return written_change(self._configuration.robot, self._dialect, changes)

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

    def _pasted(self, changes: Settings) -> str:
        """Return a change as text to paste: the default of all, and what it does not reach."""
        written = self._written(changes)
        if written is None:
            return self._dialect.paste_text(changes)
        default = {name: changes[name] for name in written.in_default}
        pasted = self._dialect.paste_text(default) if default else ""
        return " and ".join(filter(None, [pasted, *written.elsewhere]))


def _is_worse(before: Outcome, after: Outcome) -> bool:
    """Return whether a row has a worse verdict, or is farther from reality by half the width of its interval."""
    if before.verdict is Verdict.INSIDE:
        return after.verdict.is_off
    severity = SEVERITY.index(after.verdict) - SEVERITY.index(before.verdict)
    return severity > 0 or after.deviation > before.deviation + GROWTH


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
    from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

    return mujoco_configuration(
        robot.changed(changes)[0],
        name=configuration.name,
        source=configuration.source,
        spec=robot.spec,
        pair=robot.pair,
        file=robot.file,
    )


def written_change(robot: Robot, dialect: Dialect, changes: Settings) -> WrittenChange:
    """Return a change in the text of a model.

    Args:
        robot: The robot before the change.
        dialect: Dialect of the model.
        changes: The change.
    """
    from gauge_envs.tools.sanity.robot.mended_model import write_change

    assignments = {}
    for name, value in changes.items():
        one = dialect.setting(name, value)
        text = "disable" if value is None else (one.kind.text or dialect.text)(value)
        assignments[name] = (one.place, one.key, text)
    return write_change(robot, changes, assignments)


def speed_ratio(robot: Robot, changes: Settings) -> float:
    """Return the simulated time of a model in a second of the processor with changes, over that without."""
    import mujoco

    models = [robot.model, robot.changed(changes)[0]]
    runs = [(model, mujoco.MjData(model)) for model in models]
    best = [0.0, 0.0]
    for _ in range(SPEED_BLOCKS):
        for place, (model, data) in enumerate(runs):
            started, before_s, spent_s = time.process_time(), data.time, 0.0
            while spent_s < BLOCK_S:
                mujoco.mj_step(model, data, nstep=10)
                spent_s = time.process_time() - started
            best[place] = max(best[place], (data.time - before_s) / spent_s)
    return best[1] / best[0]
