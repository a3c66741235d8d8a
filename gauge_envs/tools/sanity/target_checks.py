"""Judge what a target states, which needs none of the experiments: gravity, memory for contacts, its own robot."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2, Vector
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    VISIBLE_WITHIN,
    Cause,
    ContactCapacity,
    Need,
    PhenomenonResult,
    Reality,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import CAPACITY_ID, GRAVITY_ID, ROBOT_IDS
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

TARGET_ROWS = (GRAVITY_ROW, CAPACITY_ROW)

LEAST_TILT_DEG = 0.1
"""Smallest tilt that is reported [degrees]."""

EFFECTS = {
    "robot-torque": ("robot-damping", "robot-frictionloss"),
    "robot-damping": ("robot-dry",),
    "robot-density": ("robot-armature", "robot-inertia"),
    "robot-bound": ("robot-inertia",),
}
"""Rows that show the fault of another row, which is mended alone."""

SPARE = 1.25
"""Ratio of recommended limits and the counted need, since other motions may need more."""


def target_rows(
    configuration: TrainingConfiguration, dialect: Dialect, chosen: Sequence[str]
) -> list[PhenomenonResult]:
    """Return the chosen rows on what a target states, and on its robot.

    A row on the memory for contacts or on the robot is left out where the target states nothing of it, unless it is the
    only one.
    """
    rows = [gravity_row(configuration, dialect)] if GRAVITY_ID in chosen else []
    if CAPACITY_ID in chosen and (
        configuration.capacity is not None or len(chosen) == 1
    ):
        rows.append(capacity_row(configuration, dialect))
    named = [name for name in ROBOT_IDS if name in chosen]
    for name in named:
        row = robot_row(name, configuration.robot)
        if row.verdict is not Verdict.DECLINED or len(chosen) == 1:
            rows.append(row)
    return rows


def robot_row(name: str, robot: Robot | None) -> PhenomenonResult:
    """Return a row on the target's own model; one that is not measured without a model."""
    from gauge_envs.tools.sanity.robot import rollout
    from gauge_envs.tools.sanity.robot.model_rows import ROWS, Finding, judged_row

    assert rollout, "its rows are added as it is imported"
    return judged_row(
        name,
        Finding(declined="the target's own model is not read")
        if robot is None
        else ROWS[name](robot),
    )


def target_fixes(
    configuration: TrainingConfiguration, dialect: Dialect, flags: Collection[str]
) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the change that mends each flagged row, as text to paste and as settings."""
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
    if configuration.robot is not None:
        from gauge_envs.tools.sanity.robot.model_rows import ROWS

        effects = {
            name
            for cause, several in EFFECTS.items()
            if cause in flags
            for name in several
        }
        for name in sorted(set(flags) & set(ROWS) - effects):
            if (found := ROWS[name](configuration.robot)).changes:
                fixes[name] = (found.advice, dict(found.changes))
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
    size = float(np.linalg.norm(vector))
    deviation = float(np.linalg.norm(vector - down)) / GRAVITY_ROW.reality.tolerance
    if deviation <= INSIDE_WITHIN:
        return replace(GRAVITY_ROW, configured=size)
    cosine = float(vector @ down) / (size * GRAVITY_M_PER_S2)
    tilt = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    was = " ".join(f"{component:g}" for component in gravity)
    return replace(
        GRAVITY_ROW,
        configured=size,
        verdict=Verdict.VISIBLE if deviation <= VISIBLE_WITHIN else Verdict.WRONG,
        remark=f"tilted by {tilt:.2g} degrees" if tilt > LEAST_TILT_DEG else "",
        cause=Cause(
            settings=(GRAVITY_ID,),
            line=f"{dialect.gravity_text(upright)} instead of {was}",
        ),
    )


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
