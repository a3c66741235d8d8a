"""Find the change that corrects most flags: apply documented changes as a user would paste them, and measure again."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from gauge_envs.errors import GaugeError
from gauge_envs.tools.sanity.candidates import candidates_of
from gauge_envs.tools.sanity.measure import Measurements, subject_of, worst_of
from gauge_envs.tools.sanity.model import (
    Cure,
    PhenomenonResult,
    Settings,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import (
    GRAVITY_ID,
    STATED_IDS,
    UNCHANGED_IDS,
    phenomenon,
)
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.target_checks import target_rows, upright_gravity

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.robot import Robot

Outcome = tuple[Verdict, float | None]
"""Verdict and value of a row."""

OutcomeOf = Callable[[TrainingConfiguration, str], Outcome]
"""Function from a configuration and the id of a row to its outcome."""

Applied = tuple[TrainingConfiguration, dict[str, list[str]]]
"""A configuration with changes, and for each setting what the default of all does not reach, in words."""


def find_cure(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    rows: Sequence[PhenomenonResult],
) -> tuple[Cure | None, tuple[str, ...]]:
    """Return the change that corrects most flags and flags nothing new, as measured, and how far other changes came.

    It is None when none corrects a flag, or each that does flags another row.

    Args:
        configuration: The checked configuration.
        dialect: Dialect of the target.
        measurements: Measurements on the engine of the rows.
        rows: All rows.
    """
    inside = [
        row.phenomenon
        for row in rows
        if row.verdict is Verdict.INSIDE and row.phenomenon not in UNCHANGED_IDS
    ]
    before = {
        row.phenomenon: (row.verdict, row.configured) for row in rows if row.is_flag
    }
    candidates = _candidates(configuration, dialect, before)
    tried: list[str] = []

    def outcome_of(changed: TrainingConfiguration, name: str) -> Outcome:
        if name in UNCHANGED_IDS and name in before:
            return before[name]
        checked = target_rows(changed, [name])
        if checked:
            return checked[0].verdict, checked[0].configured
        subject = subject_of(measurements, changed, phenomenon(name))
        if not subject.sets:
            return Verdict.DECLINED, None
        _, worst = worst_of(subject.measured())
        return worst.verdict, worst.value

    def refused(changes: Settings, error: GaugeError) -> None:
        tried.append(f"{dialect.paste_text(changes)}: {error}")

    for changes, (changed, elsewhere), after in _ranked(
        configuration, candidates, [*before], outcome_of, refused
    ):
        pasted = _pasted(configuration, dialect, changes, elsewhere)
        mended = [name for name, one in after.items() if one[0] is Verdict.INSIDE]
        if not mended:
            came = (_came(name, before[name][1], one[1]) for name, one in after.items())
            tried.append(f"{pasted}: {', '.join(came)}")
            continue
        line = f"{pasted}: {_effect([*after], mended)}"
        harmed = [name for name in inside if outcome_of(changed, name)[0].is_off]
        if harmed:
            tried.append(f"{line}, but {', '.join(harmed)} are flagged")
            continue
        cure = Cure(
            changes=changes,
            line=line,
            flag_count=len(after),
            mended={name: after[name][1] for name in mended},
        )
        return cure, tuple(tried)
    return None, tuple(tried)


def _candidates(
    configuration: TrainingConfiguration, dialect: Dialect, flags: Collection[str]
) -> list[Settings]:
    """Return the changes to try: upright gravity where it is flagged, alone and with each documented change."""
    fixed: Settings = {}
    if GRAVITY_ID in flags:
        fixed = {GRAVITY_ID: upright_gravity(configuration)}
    candidates = [fixed] if fixed else []
    if {*flags} - {GRAVITY_ID} - UNCHANGED_IDS:
        documented = candidates_of(configuration, dialect)
        candidates += [{**one, **fixed} for one in documented]
    return candidates


def _came(name: str, before: float | None, after: float | None) -> str:
    """Return how far a row came."""
    was, now = ("none" if one is None else f"{one:.3g}" for one in (before, after))
    return f"{name} {was} to {now}"


def applied(configuration: TrainingConfiguration, changes: Settings) -> Applied:
    """Return the configuration that is read back with changes, and what the default of all does not reach, in words.

    Args:
        configuration: The configuration.
        changes: New values, as `Robot.changed` takes them.
    """
    robot = configuration.robot
    if robot is None:
        others = {name: value for name, value in changes.items() if name != GRAVITY_ID}
        groups = tuple(
            replace(group, settings={**group.settings, **others})
            for group in configuration.contact_groups
        )
        changed = replace(
            configuration,
            settings={**configuration.settings, **others},
            contact_groups=groups,
            gravity_m_per_s2=changes.get(GRAVITY_ID, configuration.gravity_m_per_s2),
        )
        return changed, {}
    from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

    model, geoms = robot.changed(changes)
    read = mujoco_configuration(
        model,
        name=configuration.name,
        source=configuration.source,
        spec=robot.spec,
        pair=robot.pair,
        file=robot.file,
    )
    return read, _stated_elsewhere(robot, changes, geoms)


def _ranked(
    configuration: TrainingConfiguration,
    candidates: Sequence[Settings],
    flags: Sequence[str],
    outcome_of: OutcomeOf,
    refused: Callable[[Settings, GaugeError], None],
) -> Iterator[tuple[Settings, Applied, dict[str, Outcome]]]:
    """Yield changes that correct most flags first, with what `applied` returns and the outcomes of the flagged rows.

    Of equal ones, those with fewer changes come first, then the order of the candidates counts. A row is measured only
    while its candidate may still correct the most, and rows on scenes of many bodies last.
    """
    slow = [
        name
        for name in flags
        if name not in STATED_IDS and phenomenon(name).has_many_bodies
    ]
    names = sorted(flags, key=lambda name: name in slow)
    queue: list[tuple[int, int, int]] = []
    found: dict[int, tuple[Applied, dict[str, Outcome]]] = {}
    for index, changes in enumerate(candidates):
        try:
            found[index] = applied(configuration, changes), {}
        except GaugeError as error:
            refused(changes, error)
            continue
        heappush(queue, (-len(names), len(changes), index))
    while queue:
        _, size, index = heappop(queue)
        changed, after = found[index]
        left = names[len(after) :]
        if not left:
            yield candidates[index], changed, after
            continue
        for name in left if left[0] in slow else left[:1]:
            after[name] = outcome_of(changed[0], name)
        left_count = sum(one is not Verdict.INSIDE for one, _ in after.values())
        heappush(queue, (left_count - len(names), size, index))


def _stated_elsewhere(
    robot: Robot, changes: Settings, geoms: Mapping[str, Sequence[int]]
) -> dict[str, list[str]]:
    """Return for each setting what classes, geoms and explicit pairs that state it themselves are to state."""
    from gauge_envs.tools.sanity.robot.mended_model import element_words
    from gauge_envs.tools.sanity.robot.robot import GEOM_FIELDS, PAIRED

    found: dict[str, list[str]] = {}
    for name, value in changes.items():
        if name not in GEOM_FIELDS:
            continue
        field, several = GEOM_FIELDS[name], geoms.get(name, [])
        texts = element_words(robot, "geom", field, value, several)
        if name in PAIRED:
            pairs = robot.explicit_ground_pairs
            texts += element_words(robot, "pair", field, value, pairs)
        if texts:
            found[name] = texts
    return found


# --- words -----------------------------------------------------------------------------------------------------------


def _effect(flags: Sequence[str], mended: Sequence[str]) -> str:
    """Return what a change does to the flags, in words."""
    count = "the one flag goes"
    if len(flags) > 1:
        count = f"{len(mended)} of {len(flags)} flags go"
    left = [name for name in flags if name not in mended]
    return f"{count}; left: {', '.join(left)}" if left else count


def _pasted(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    changes: Settings,
    elsewhere: Mapping[str, Sequence[str]],
) -> str:
    """Return changes as text to paste: the default of all, what it does not reach, and gravity."""
    robot = configuration.robot
    default = {
        name: value
        for name, value in changes.items()
        if name != GRAVITY_ID
        and (robot is None or name not in elsewhere or robot.needs_default(name, value))
    }
    parts = [dialect.paste_text(default)] if default else []
    parts += [text for several in elsewhere.values() for text in several]
    if GRAVITY_ID in changes:
        parts.append(dialect.gravity_text(changes[GRAVITY_ID]))
    return " and ".join(parts)
