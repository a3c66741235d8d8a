"""Apply changes to a copy of the target as a user would paste them, read it back, and measure what they mend.

Changes are tried where the target trains: a robot that trains on mujoco_warp is cured there, on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from gauge_envs.errors import GaugeError
from gauge_envs.tools.sanity.measure import Measurements
from gauge_envs.tools.sanity.model import ContactCapacity, Cure, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.phenomena import RIGID, phenomenon
from gauge_envs.tools.sanity.stacks.dialect import Dialect
from gauge_envs.tools.sanity.stated import stated_rows
from gauge_envs.tools.sanity.subject import subject_of, worst_of

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.robot import Robot

WARP_S = 1.1
"""Longest scene that is run on mujoco_warp on a CPU [s], which takes a second for each."""

LIMITS = ("njmax", "naconmax")
"""Changes that belong to the memory for contacts, not to the model."""

OFF = (Verdict.VISIBLE, Verdict.WRONG)


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Changes that may mend flags.

    Attributes:
        changes: New values by name of the setting, and rows of arrays of the model.
        texts: Changes that are no settings, in words that can be pasted.
    """

    changes: Mapping[str, Any]
    texts: tuple[str, ...] = ()


def applied(
    configuration: TrainingConfiguration, changes: Mapping[str, Any]
) -> tuple[TrainingConfiguration, dict[str, list[str]]]:
    """Return the configuration that is read back with changes, and geoms that state a changed attribute themselves.

    Args:
        configuration: The configuration.
        changes: New values, as `Robot.changed` takes them, with the limits of the memory for contacts.
    """
    limits = {name: value for name, value in changes.items() if name in LIMITS}
    others = {name: value for name, value in changes.items() if name not in LIMITS}
    robot, own = configuration.robot, {}
    if robot is None or configuration.backend != "mujoco":
        gravity = {"gravity_m_per_s2": others.pop("gravity")} if "gravity" in others else {}
        groups = tuple(replace(g, settings={**g.settings, **others}) for g in configuration.contact_groups)
        settings = {**configuration.settings, **others}
        read = replace(configuration, settings=settings, contact_groups=groups, **gravity)
    else:
        from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration

        model, geoms = robot.changed(others)
        own = {name: [robot.geom_name(geom) for geom in several] for name, several in geoms.items()}
        read = mujoco_configuration(
            model,
            name=configuration.name,
            source=configuration.source,
            spec=robot.spec,
            unknown=robot.unknown,
            pair=robot.pair,
        )
        read = replace(
            read, language=configuration.language, trains_on=configuration.trains_on, capacity=configuration.capacity
        )
    if limits and read.capacity is not None:
        read = replace(read, capacity=_larger(read.capacity, limits))
    return read, own


def _larger(capacity: ContactCapacity, limits: Mapping[str, Any]) -> ContactCapacity:
    return replace(capacity, limits=replace(capacity.limits, **limits))


def find_cure(
    configuration: TrainingConfiguration,
    dialect: Dialect,
    measurements: Measurements,
    candidates: Sequence[Candidate],
    rows: Mapping[str, bool],
) -> Cure | None:
    """Return the candidate that mends most flags, as measured after it was applied; None when none mends one.

    Args:
        configuration: The checked configuration.
        dialect: Dialect of the target.
        measurements: Measurements on the engine of the rows.
        candidates: Changes, the preferred ones first.
        rows: Ids of the rows that count, and whether they are flagged.
    """
    verdicts, engine = _where_it_trains(configuration, dialect, measurements, rows)
    flags = [name for name, is_flag in rows.items() if is_flag and verdicts(configuration, name) is not Verdict.INSIDE]
    best: tuple[tuple[float, ...], Cure] | None = None
    for candidate in candidates:
        try:
            cured, own = applied(configuration, candidate.changes)
        except GaugeError:
            continue
        mended = [name for name in flags if verdicts(cured, name) is Verdict.INSIDE]
        new = tuple(n for n, was in rows.items() if not was and verdicts(cured, n) in OFF) if mended else ()
        if len(mended) <= len(new):
            continue
        count = f"{len(mended)} of {len(flags)} flags go" if len(flags) > 1 else "the one flag goes"
        left = [name for name in flags if name not in mended]
        parts = [f"{_text(dialect, candidate, own, configuration.robot)}: {count}{engine}"]
        parts += [f"left: {', '.join(left)}"] * bool(left) + [f"new flags: {', '.join(new)}"] * bool(new)
        cure = Cure(
            changes=candidate.changes,
            line="; ".join(parts),
            flag_count=len(flags),
            mended_count=len(mended),
            new_flags=new,
        )
        worth = (float(len(mended) - len(new)), -float(len(candidate.changes)))
        if best is None or worth > best[0]:
            best = worth, cure
        if not left and not new:
            break
    return None if best is None else best[1]


def _text(dialect: Dialect, candidate: Candidate, own: Mapping[str, Sequence[str]], robot: Robot | None) -> str:
    """Return a change as it is pasted; geoms that state an attribute themselves are named."""
    settings = {n: v for n, v in candidate.changes.items() if "[" not in n and n != "gravity"}
    default = {n: v for n, v in settings.items() if n not in own or robot is None or robot.needs_default(n, v)}
    parts = [dialect.paste_text(default)] if default else []
    for name, geoms in own.items():
        shown = ", ".join(geoms[:3]) + (f" and {len(geoms) - 3} more" if len(geoms) > 3 else "")
        parts.append(f"{dialect.assignment(name, settings[name])} in {shown}, which the default does not reach")
    return " and ".join([*parts, *candidate.texts])


def _where_it_trains(
    configuration: TrainingConfiguration, dialect: Dialect, measurements: Measurements, rows: Mapping[str, bool]
) -> tuple[Callable[[TrainingConfiguration, str], Verdict], str]:
    """Return a function from a configuration and a row to its verdict, and the engine of training in words.

    Rows that are flagged are measured on the engine of training, others on that of the rows.
    """
    there, engine = measurements, ""
    flagged = [phenomenon(name) for name, is_flag in rows.items() if is_flag and name in RIGID]
    runs_there = any(one.scenario.seconds <= WARP_S for one in flagged)
    if configuration.trains_on == "mujoco_warp" and runs_there:
        try:
            from gauge_envs.tools.sanity.mujoco_warp_run import BackendMuJoCoWarp

            there, engine = Measurements(BackendMuJoCoWarp()), " on mujoco_warp, where it trains"
        except GaugeError:
            engine = " on MuJoCo's C engine; mujoco_warp, on which it trains, is not installed"

    def verdict(cured: TrainingConfiguration, name: str) -> Verdict:
        stated = stated_rows(cured, dialect, [name])
        if stated:
            return stated[0].verdict
        one = phenomenon(name)
        is_there = rows[name] and one.scenario.seconds <= WARP_S
        subject = subject_of(there if is_there else measurements, cured, one)
        if not subject.sets:
            return Verdict.DECLINED
        return worst_of(subject.measured())[1].verdict

    return verdict, engine
