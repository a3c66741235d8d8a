"""Judge what a target states, which needs none of the experiments: gravity, memory for contacts, its own robot."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.pages.text import vector_text
from gauge_envs.scene import GRAVITY_M_PER_S2, Vector
from gauge_envs.scene.geometry import length_of, vector
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    Cause,
    ContactCapacity,
    Need,
    PhenomenonResult,
    Reality,
    RealityKind,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import (
    CAPACITY_ID,
    CONTROL_ID,
    FRICTION_RANGE_ID,
    GRAVITY_ID,
    ROBOT_IDS,
)
from gauge_envs.tools.sanity.stacks.dialect import Dialect

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.robot.robot import Robot

GRAVITY_ROW = PhenomenonResult(
    phenomenon=GRAVITY_ID,
    title="gravity: size and direction",
    unit="m/s^2",
    reality=Reality.law(
        GRAVITY_M_PER_S2,
        tolerance=0.05,
        source="standard gravity, perpendicular to the ground",
        rationale="covers every place on Earth, 9.76 to 9.83 m/s^2, and a tilt of 0.3 degrees",
    ),
    default=GRAVITY_M_PER_S2,
    verdict=Verdict.INSIDE,
    default_verdict=Verdict.INSIDE,
)
"""Gravity on Earth. A deviation is the length of the difference of the two vectors."""

CAPACITY_ROW = PhenomenonResult(
    phenomenon=CAPACITY_ID,
    title="contact capacity: constraint rows and contacts that find no place in the engine's memory",
    unit="1",
    reality=Reality.law(
        0.0,
        tolerance=0.5,
        source="no contact and no joint limit of the target's own model may be left out",
        rationale="rows are whole numbers",
    ),
    verdict=Verdict.INSIDE,
)
"""Rows of a world and contacts of a world that do not fit."""

LONGEST_CONTROL_MS = 350.0
"""Longest time of one action of policies that run on real robots: RT-1 acts at 3 Hz (arXiv:2212.06817) [ms]."""

FALLING_SHARE = 0.5
"""Longest time of one action of a robot that stands, in the time in which its fall grows by e, sqrt(height / g)."""

CONTROL_ROW = PhenomenonResult(
    phenomenon=CONTROL_ID,
    title="time of one action: the step of the engine times the steps of an action",
    unit="ms",
    reality=Reality(
        kind=RealityKind.LAW,
        value=0.0,
        tolerance=LONGEST_CONTROL_MS,
        source="the slowest policies of real arms act at 3 Hz; a robot that stands falls by e in sqrt(height / g)",
        rationale="an action must end before the state has changed by more than the next one can mend",
        limits=f"at most {LONGEST_CONTROL_MS:g}",
    ),
    verdict=Verdict.INSIDE,
)
"""Time of one action of the policy."""

LEAST_FRICTION, LARGEST_FRICTION = 0.08, 0.808698
"""Smallest and largest friction of the measured pairs of materials."""

PAIR_COUNT = 37
"""Number of these pairs: 9 calibrated ones (tasks), and tables (scoring/facts/friction_tables.csv)."""

LEAST_SCATTER = 0.0376
"""Half-width over centre of the friction of single slides, of the measured pair that scatters least."""

LEAST_PAIR = "wood on wood, n = 20"
"""That pair, and the number of its slides."""

RANGE_ROW = PhenomenonResult(
    phenomenon=FRICTION_RANGE_ID,
    title="range from which training draws the friction of a foot",
    unit="1",
    reality=Reality(
        kind=RealityKind.MEASURED,
        value=0.5 * (LEAST_FRICTION + LARGEST_FRICTION),
        tolerance=0.5 * (LARGEST_FRICTION - LEAST_FRICTION),
        source=f"n = {PAIR_COUNT}: 9 calibrated pairs (tasks), and tables (scoring/facts/friction_tables.csv); least "
        f"width: {LEAST_PAIR}, single slides (scoring/facts/slope_slider_30deg_summary.toml)",
        rationale="no pair outside was measured, and single slides of one pair scatter by the least width",
        limits=f"in {LEAST_FRICTION:.2g} to {LARGEST_FRICTION:.2g}, {100 * LEAST_SCATTER:.1f} % or more to each side",
    ),
    verdict=Verdict.INSIDE,
)
"""Ends of the range against the pairs of materials that were measured; its width against the scatter of one pair."""

TARGET_ROWS = (GRAVITY_ROW, CAPACITY_ROW, CONTROL_ROW, RANGE_ROW)

LEAST_TILT_DEG = 0.1
"""Smallest tilt that is reported [degrees]."""

SPARE = 1.25
"""Ratio of recommended limits and the counted need, since other motions may need more."""


def target_rows(
    configuration: TrainingConfiguration, dialect: Dialect, chosen: Sequence[str]
) -> list[PhenomenonResult]:
    """Return the chosen rows on what a target states, and on its robot; those that do not apply have a reason."""
    rows = [gravity_row(configuration, dialect)] if GRAVITY_ID in chosen else []
    if CAPACITY_ID in chosen:
        rows.append(capacity_row(configuration, dialect))
    if CONTROL_ID in chosen:
        rows.append(control_row(configuration))
    if FRICTION_RANGE_ID in chosen:
        rows.append(friction_range_row(configuration))
    named = [name for name in ROBOT_IDS if name in chosen]
    return rows + [robot_row(name, configuration.robot) for name in named]


def robot_row(name: str, robot: Robot | None) -> PhenomenonResult:
    """Return a row on the target's own model; one that is not measured without a model."""
    from gauge_envs.tools.sanity.robot.finding import Finding, judged_row
    from gauge_envs.tools.sanity.robot.rows import ROWS

    return judged_row(
        name,
        Finding(declined="the target's own model is not read")
        if robot is None
        else ROWS[name](robot),
    )


def target_fixes(
    configuration: TrainingConfiguration, dialect: Dialect, flags: Collection[str]
) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the change that mends each flagged row on gravity or memory, as text to paste and as settings."""
    upright = _upright_gravity(configuration)
    limits = (
        {}
        if configuration.capacity is None
        else _capacity_changes(configuration.capacity)
    )
    fixes: dict[str, tuple[str, dict[str, Any]]] = {
        GRAVITY_ID: (dialect.gravity_text(upright), {GRAVITY_ID: upright}),
        CAPACITY_ID: (dialect.paste_text(limits), limits),
    }
    return {name: fix for name, fix in fixes.items() if name in flags}


def _declined(row: PhenomenonResult, remark: str) -> PhenomenonResult:
    return replace(
        row, default=None, verdict=Verdict.DECLINED, remark=remark, applies=False
    )


# --- gravity ---------------------------------------------------------------------------------------------------------


def _upright_gravity(
    configuration: TrainingConfiguration,
) -> Vector:
    """Return standard gravity against the direction away from the ground [m/s^2]."""
    return vector(-GRAVITY_M_PER_S2 * np.asarray(configuration.up))


def gravity_row(
    configuration: TrainingConfiguration, dialect: Dialect
) -> PhenomenonResult:
    """Return the row on the gravity of a configuration; declined when the target states none or switches it off."""
    gravity = configuration.gravity_m_per_s2
    absent = configuration.inapplicable.get(Need.GRAVITY)
    if gravity is None or absent is not None:
        return _declined(
            GRAVITY_ROW,
            absent or "the target states no gravity; the experiments have their own",
        )
    upright = _upright_gravity(configuration)
    vector, down = np.asarray(gravity), np.asarray(upright)
    size = length_of(vector)
    deviation = length_of(vector - down) / GRAVITY_ROW.reality.tolerance
    if deviation <= INSIDE_WITHIN:
        return replace(GRAVITY_ROW, configured=size)
    cosine = float(vector @ down) / (size * GRAVITY_M_PER_S2)
    tilt = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    was = vector_text(gravity)
    return replace(
        GRAVITY_ROW,
        configured=size,
        verdict=Verdict.of(deviation),
        remark=f"tilted by {tilt:.2g} degrees" if tilt > LEAST_TILT_DEG else "",
        cause=Cause(
            settings=(GRAVITY_ID,),
            line=f"{dialect.gravity_text(upright)} instead of {was}",
        ),
    )


# --- time of one action ---------------------------------------------------------------------------------------------


def control_s(configuration: TrainingConfiguration) -> float | None:
    """Return the time of one action [s]; None where the target does not state its step or the steps of an action."""
    step_s = configuration.settings.get("timestep_s")
    if step_s is None or configuration.frame_skip is None:
        return None
    return float(step_s) * configuration.frame_skip


def control_row(configuration: TrainingConfiguration) -> PhenomenonResult:
    """Return the row on the time of one action; it does not apply where the target does not state it."""
    action_s = control_s(configuration)
    if action_s is None:
        return _declined(
            CONTROL_ROW, "the target does not state how many steps an action takes"
        )
    longest_ms, remark = LONGEST_CONTROL_MS, ""
    standing = None if configuration.robot is None else configuration.robot.standing
    if standing is not None:
        falling_ms = 1e3 * math.sqrt(standing.height_m / GRAVITY_M_PER_S2)
        longest_ms = FALLING_SHARE * falling_ms
        remark = f"a fall of the robot grows by e in {falling_ms:.3g} ms"
    deviation = 1e3 * action_s / longest_ms
    verdict = Verdict.of(deviation)
    steps = configuration.frame_skip or 1
    fair = max(1, math.floor(steps / deviation))
    advice = f"at most {fair} steps for an action instead of {steps} (decimation, frame_skip)"
    return replace(
        CONTROL_ROW,
        reality=replace(
            CONTROL_ROW.reality,
            tolerance=longest_ms,
            limits=f"at most {longest_ms:.3g}",
        ),
        configured=1e3 * action_s,
        verdict=verdict,
        remark="; ".join(filter(None, (remark, advice if verdict.is_off else ""))),
        consequence="The policy sees the robot too seldom to balance or to stop it."
        if verdict.is_off
        else "",
    )


# --- range of friction -----------------------------------------------------------------------------------------------


def friction_range_row(configuration: TrainingConfiguration) -> PhenomenonResult:
    """Return the row on the range of a foot's friction; it does not apply where training draws none."""
    foot = configuration.foot_contact
    drawn = [
        (low, high)
        for low, high in (() if foot is None else (foot.static_friction, foot.friction))
        if low < high
    ]
    if not drawn:
        return _declined(RANGE_ROW, "the target draws no friction from a range")
    findings = [(*_range_finding(low, high), low, high) for low, high in drawn]
    verdict, remark, low, high = max(findings, key=lambda one: one[0].is_off)
    return replace(
        RANGE_ROW,
        configured=0.5 * (low + high),
        verdict=verdict,
        remark=remark,
        consequence="The policy trains for floors that nobody measured, or for one alone."
        if verdict.is_off
        else "",
    )


def _range_finding(low: float, high: float) -> tuple[Verdict, str]:
    """Return the verdict on a range of friction, and why."""
    smallest, largest = LEAST_FRICTION, LARGEST_FRICTION
    shown, known = f"{low:.3g} to {high:.3g}", f"{smallest:.2g} to {largest:.2g}"
    center = 0.5 * (low + high)
    pairs = f"{known} of {PAIR_COUNT} measured pairs"
    if not smallest <= center <= largest:
        deviation = abs(center - RANGE_ROW.reality.value) / RANGE_ROW.reality.tolerance
        return (
            Verdict.of(deviation),
            f"{shown} is off centre: {center:.3g} is outside {pairs}",
        )
    if low < smallest or high > largest:
        return Verdict.VISIBLE, f"{shown} is too wide: it leaves {pairs}"
    if 0.5 * (high - low) < LEAST_SCATTER * center:
        return Verdict.VISIBLE, (
            f"{shown} is too narrow: single slides of one pair scatter by {100 * LEAST_SCATTER:.1f} % to each side "
            f"({LEAST_PAIR})"
        )
    return Verdict.INSIDE, f"{shown}, inside {pairs}"


# --- memory for contacts ---------------------------------------------------------------------------------------------


def capacity_row(
    configuration: TrainingConfiguration, dialect: Dialect
) -> PhenomenonResult:
    """Return the row on the memory for contacts; declined when the target states no limit."""
    capacity = configuration.capacity
    if capacity is None:
        return _declined(
            CAPACITY_ROW, "the target states no limit of its memory for contacts"
        )
    if capacity.need is None:
        return _declined(CAPACITY_ROW, capacity.reason)
    missing, need = (
        capacity.missing_rows + math.ceil(capacity.missing_contacts),
        _need_text(capacity),
    )
    if not missing:
        return replace(CAPACITY_ROW, configured=0.0, remark=need)
    changes = _capacity_changes(capacity)
    cause = Cause(
        settings=tuple(changes), line=f"{dialect.paste_text(changes)}: {need}"
    )
    return replace(
        CAPACITY_ROW, configured=float(missing), verdict=Verdict.WRONG, cause=cause
    )


def _capacity_changes(capacity: ContactCapacity) -> dict[str, Any]:
    """Return the limits that the target's own model needs, with a quarter to spare; empty when all fits."""
    need, limits, changes = capacity.need, capacity.limits, {}
    if need is not None and capacity.missing_rows:
        changes["njmax"] = math.ceil(SPARE * need.rows)
    if need is not None and capacity.missing_contacts and limits.worlds is not None:
        changes["naconmax"] = math.ceil(SPARE * need.mean_contacts) * limits.worlds
    return changes


def _need_text(capacity: ContactCapacity) -> str:
    """Return what the target's own model needs, and its limits."""
    need, limits, parts = capacity.need, capacity.limits, []
    assert need is not None, "only a counted need is described"
    if limits.njmax is not None:
        place = f"in {need.situation}" if need.rows else "at most"
        parts.append(
            f"its model needs {need.rows} constraint rows {place}, and njmax is {limits.njmax}"
        )
    if limits.naconmax is not None and limits.worlds:
        share = limits.naconmax / limits.worlds
        parts.append(
            f"it needs {need.mean_contacts:.3g} contacts in the mean of all worlds, and has {share:.3g}"
        )
    return "; ".join(parts)
