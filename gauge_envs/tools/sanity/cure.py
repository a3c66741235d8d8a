"""Find the change that mends most flags: apply proposed changes as a user would paste them, and measure again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from gauge_envs.errors import GaugeError
from gauge_envs.tools.sanity.candidates import key_of
from gauge_envs.tools.sanity.measure import Measurements, subject_of
from gauge_envs.tools.sanity.model import (
    Cure,
    PhenomenonResult,
    Settings,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import (
    CAPACITY_ID,
    GRASP,
    RIGID,
    STATED_IDS,
    phenomenon,
)
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.target_checks import target_fixes, target_rows

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.remedies import Remedies
    from gauge_envs.tools.sanity.robot.robot import Robot

WARP_S = 1.1
"""Longest scene that is run on mujoco_warp on a CPU [s], which takes a second for each."""

LIMITS = ("njmax", "naconmax")
"""Changes that belong to the memory for contacts, not to the model."""


def find_cure(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    proposed: Sequence[Settings],
    rows: Sequence[PhenomenonResult],
) -> tuple[Cure | None, tuple[str, ...]]:
    """Return the change that mends most flags and harms nothing, as measured, and how far other changes came.

    It is None when none mends a flag, or each that does makes another row or the robot worse.

    Args:
        configuration: The checked configuration.
        dialect: Dialect of the target.
        measurements: Measurements on the engine of the rows.
        proposed: Changes of settings, the preferred ones first, as `candidates_of` gives them.
        rows: All rows.
    """
    counted = {
        row.phenomenon: row.is_flag
        for row in rows
        if row.is_flag or row.verdict is Verdict.INSIDE
    }
    fixes = target_fixes(
        configuration, dialect, [name for name in counted if counted[name]]
    )
    # What belongs to every candidate and is no setting, in words that can be pasted.
    texts = dict.fromkeys(
        text for name, (text, _) in fixes.items() if name != CAPACITY_ID
    )
    fixed = {
        key: value for _, several in fixes.values() for key, value in several.items()
    }
    tried: list[str] = []
    harm_of: _Judge = lambda _cured, _changes: ""  # noqa: E731
    apply: Callable[[Settings], Applied] = partial(applied, configuration)
    if configuration.robot is not None and configuration.backend == "mujoco":
        remedied, apply, harm_of = _remedied(configuration, fixed, counted)
        fixed |= remedied.changes
        texts |= dict.fromkeys(remedied.texts)
        tried += [one.line for one in remedied.attempts if one.refusal]
        tried += [f"{name}: {reason}" for name, reason in remedied.unmended.items()]
    candidates = [{**one, **fixed} for one in proposed]
    if fixed:
        candidates.append(fixed)
    candidates = list({key_of(one): one for one in candidates}.values())
    if not candidates:
        return None, tuple(tried)
    outcome_of, engine = _training_outcomes(
        configuration, dialect, measurements, counted
    )
    before = {
        name: outcome_of(configuration, name) for name in counted if counted[name]
    }
    flags = [name for name, one in before.items() if one[0] is not Verdict.INSIDE]

    def refused(changes: Settings, error: GaugeError) -> None:
        tried.append(f"{dialect.paste_text(changes)}: {error}")

    for changes, cured, geoms_by_setting, after in _ranked(
        candidates, flags, apply, outcome_of, refused, harm_of
    ):
        pasted = _pasted(configuration, dialect, changes, geoms_by_setting, [*texts])
        mended = [name for name, one in after.items() if one[0] is Verdict.INSIDE]
        if not mended:
            came = (_came(name, before[name][1], one[1]) for name, one in after.items())
            tried.append(f"{pasted}: {', '.join(came)}")
            continue
        cure = Cure(
            changes=changes,
            line=f"{pasted}: {_effect([*after], mended, engine)}",
            flag_count=len(flags),
            mended={name: after[name][1] for name in mended},
        )
        harm = harm_of(cured, cure.changes)
        if not harm:
            new_flags = [
                name
                for name, is_flag in counted.items()
                if not is_flag
                and name != "robot-maker"
                and outcome_of(cured, name)[0].is_off
            ]
            harm = ", ".join(f"{name} is flagged" for name in new_flags)
        if not harm:
            return cure, tuple(tried)
        tried.append(f"{cure.line}, but {harm}")
    return None, tuple(tried)


Applied = tuple[TrainingConfiguration, dict[str, list[str]]]
"""What `applied` returns."""

_Judge = Callable[[TrainingConfiguration, Settings], str]
"""Function of a changed configuration and all its changes that says what is worse; empty when nothing is."""


def _remedied(
    configuration: TrainingConfiguration,
    fixed: Settings,
    counted: Mapping[str, bool],
) -> tuple[Remedies, Callable[[Settings], Applied], _Judge]:
    """Return remedies of the target's own robot, `applied` that keeps rows, and a judge of further changes."""
    from gauge_envs.tools.sanity.robot.behaviour import (
        Behaviour,
        harm,
        keep_unconcerned,
    )
    from gauge_envs.tools.sanity.robot.remedies import find_remedies
    from gauge_envs.tools.sanity.robot.remedy import Remedy

    robot = configuration.robot
    assert robot is not None
    upright = {name: value for name, value in fixed.items() if name not in LIMITS}
    if upright:
        robot = replace(robot, model=robot.changed(upright)[0], changes=upright)
    found = find_remedies(robot, [name for name in counted if counted[name]])
    before = Behaviour(found.robot)
    known = set(fixed) | set(found.changes)

    def apply(changes: Settings) -> Applied:
        cured, geoms = applied(configuration, changes)
        further = {key: changes[key] for key in set(changes) - known - set(LIMITS)}
        if cured.robot is not None:
            keep_unconcerned(found.robot, cured.robot, further)
        return cured, geoms

    def harm_of(cured: TrainingConfiguration, changes: Settings) -> str:
        if set(changes) <= known or cured.robot is None:
            return ""
        return harm(before, Behaviour(cured.robot), Remedy(text="", changes=changes))

    return found, apply, harm_of


def _came(name: str, before: float | None, after: float | None) -> str:
    """Return how far a row came."""
    was, now = ("none" if one is None else f"{one:.3g}" for one in (before, after))
    return f"{name} {was} to {now}"


def applied(configuration: TrainingConfiguration, changes: Settings) -> Applied:
    """Return the configuration that is read back with changes, and what the default of all does not reach, in words.

    Args:
        configuration: The configuration.
        changes: New values, as `Robot.changed` takes them, with the limits of the memory for contacts.
    """
    limits = {name: changes[name] for name in LIMITS if name in changes}
    others = {name: value for name, value in changes.items() if name not in LIMITS}
    robot, geoms_by_setting = configuration.robot, {}
    if robot is None or configuration.backend != "mujoco":
        gravity = others.pop("gravity", configuration.gravity_m_per_s2)
        groups = tuple(
            replace(group, settings={**group.settings, **others})
            for group in configuration.contact_groups
        )
        read = replace(
            configuration,
            settings={**configuration.settings, **others},
            contact_groups=groups,
            gravity_m_per_s2=gravity,
        )
    else:
        from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

        model, geoms = robot.changed(others)
        geoms_by_setting = _stated_elsewhere(robot, others, geoms)
        read = mujoco_configuration(
            model,
            name=configuration.name,
            source=configuration.source,
            spec=robot.spec_after(others),
            pair=robot.pair,
        )
        read = replace(
            read,
            language=configuration.language,
            trains_on=configuration.trains_on,
            capacity=configuration.capacity,
        )
    if limits and read.capacity is not None:
        larger = replace(read.capacity.limits, **limits)
        read = replace(read, capacity=replace(read.capacity, limits=larger))
    return read, geoms_by_setting


Outcome = tuple[Verdict, float | None]
"""Verdict and value of a row."""


def _ranked(
    candidates: Sequence[Settings],
    flags: Sequence[str],
    apply: Callable[[Settings], Applied],
    outcome_of: Callable[[TrainingConfiguration, str], Outcome],
    refused: Callable[[Settings, GaugeError], None],
    harm_of: _Judge,
) -> Iterator[
    tuple[Settings, TrainingConfiguration, dict[str, list[str]], dict[str, Outcome]]
]:
    """Yield changes that mend most flags first, with what `applied` returns and the outcomes of the flagged rows.

    Of equal ones, those with fewer changes come first, then the order of the candidates counts. A row is measured only
    while its candidate may still mend the most, and rows on scenes of many bodies last.
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
            found[index] = apply(changes), {}
        except GaugeError as error:
            refused(changes, error)
            continue
        heappush(queue, (-len(names), len(changes), index))
    while queue:
        _, size, index = heappop(queue)
        (cured, geoms_by_setting), after = found[index]
        left = names[len(after) :]
        is_slow = bool(left) and left[0] in slow
        if not left or (is_slow and harm_of(cured, candidates[index])):
            yield candidates[index], cured, geoms_by_setting, after
            continue
        for name in left if is_slow else left[:1]:
            after[name] = outcome_of(cured, name)
        unmended_count = sum(one is not Verdict.INSIDE for one, _ in after.values())
        heappush(queue, (unmended_count - len(names), size, index))


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


def _training_outcomes(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    rows: Mapping[str, bool],
) -> tuple[Callable[[TrainingConfiguration, str], Outcome], str]:
    """Return a function from a configuration and a row to its outcome, and the engine of training in words.

    Rows that are flagged are measured on the engine of training, others on that of the rows.
    """
    training, engine = measurements, ""
    is_short = any(
        is_flag
        and name in (*RIGID, *GRASP)
        and phenomenon(name).scenario.seconds <= WARP_S
        for name, is_flag in rows.items()
    )
    if configuration.trains_on == "mujoco_warp" and is_short:
        try:
            from gauge_envs.tools.sanity.mujoco_warp_run import BackendMuJoCoWarp

            training = Measurements(BackendMuJoCoWarp())
            engine = " on mujoco_warp, where it trains"
        except GaugeError:
            engine = " on MuJoCo's C engine; mujoco_warp, on which it trains, is not installed"

    def outcome_of(cured: TrainingConfiguration, name: str) -> Outcome:
        checked = target_rows(cured, dialect, [name])
        if checked:
            return checked[0].verdict, checked[0].configured
        one = phenomenon(name)
        is_training = rows[name] and one.scenario.seconds <= WARP_S
        subject = subject_of(training if is_training else measurements, cured, one)
        if not subject.sets:
            return Verdict.DECLINED, None
        worst = subject.worst()
        return worst.verdict, worst.value

    return outcome_of, engine


# --- words -----------------------------------------------------------------------------------------------------------


def _effect(flags: Sequence[str], mended: Sequence[str], engine: str) -> str:
    """Return what a change does to the flags, in words."""
    count = "the one flag goes"
    if len(flags) > 1:
        count = f"{len(mended)} of {len(flags)} flags go"
    parts = [count + engine]
    left = [name for name in flags if name not in mended]
    if left:
        parts.append(f"left: {', '.join(left)}")
    return "; ".join(parts)


def _pasted(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    changes: Settings,
    geoms_by_setting: Mapping[str, Sequence[str]],
    texts: Sequence[str],
) -> str:
    """Return changes as text to paste: the default of all, what it does not reach, and further texts."""
    robot, default = configuration.robot, {}
    for name, value in changes.items():
        is_of_dialect = robot is None or dialect.setting(name, value).place
        if name == "gravity" or not is_of_dialect:
            # Gravity, a row of an array, the compiler or the medium: the texts say it.
            continue
        if name in geoms_by_setting:
            is_default = robot is None or robot.needs_default(name, value)
        else:
            is_default = dialect.assignment(name, value) not in " ".join(texts)
        if is_default:
            default[name] = value
    parts = [dialect.paste_text(default)] if default else []
    parts += [text for several in geoms_by_setting.values() for text in several]
    return " and ".join([*parts, *texts])
