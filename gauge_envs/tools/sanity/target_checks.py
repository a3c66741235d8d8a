"""Judge what a target states, which needs none of the experiments: gravity, the time of one action, its own robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2, Vector
from gauge_envs.scene.geometry import length_of, vector
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    Need,
    PhenomenonResult,
    Reality,
    RealityKind,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena import (
    CONTROL_ID,
    GRAVITY_ID,
    ROBOT_IDS,
)

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

TARGET_ROWS = (GRAVITY_ROW, CONTROL_ROW)

LEAST_TILT_DEG = 0.1
"""Smallest tilt that is reported [degrees]."""


def target_rows(
    configuration: TrainingConfiguration, chosen: Sequence[str]
) -> list[PhenomenonResult]:
    """Return the chosen rows on what a target states, and on its robot; those that do not apply have a reason."""
    rows = [gravity_row(configuration)] if GRAVITY_ID in chosen else []
    if CONTROL_ID in chosen:
        rows.append(control_row(configuration))
    named = [name for name in ROBOT_IDS if name in chosen]
    return rows + [robot_row(name, configuration.robot) for name in named]


def robot_row(name: str, robot: Robot | None) -> PhenomenonResult:
    """Return a row on the target's own model; one that is not measured without a model."""
    from gauge_envs.tools.sanity.own_rows import ROWS
    from gauge_envs.tools.sanity.rows import row_result

    return row_result(ROWS[name], robot)


def _declined(row: PhenomenonResult, remark: str) -> PhenomenonResult:
    return replace(
        row, default=None, verdict=Verdict.DECLINED, remark=remark, applies=False
    )


# --- gravity ---------------------------------------------------------------------------------------------------------


def upright_gravity(configuration: TrainingConfiguration) -> Vector:
    """Return standard gravity against the direction away from the ground [m/s^2]."""
    return vector(-GRAVITY_M_PER_S2 * np.asarray(configuration.up))


def gravity_row(configuration: TrainingConfiguration) -> PhenomenonResult:
    """Return the row on the gravity of a configuration; declined when the target states none or switches it off."""
    gravity = configuration.gravity_m_per_s2
    absent = configuration.inapplicable.get(Need.GRAVITY)
    if gravity is None or absent is not None:
        return _declined(
            GRAVITY_ROW,
            absent or "the target states no gravity; the experiments have their own",
        )
    vector, down = np.asarray(gravity), np.asarray(upright_gravity(configuration))
    size = length_of(vector)
    deviation = length_of(vector - down) / GRAVITY_ROW.reality.tolerance
    if deviation <= INSIDE_WITHIN:
        return replace(GRAVITY_ROW, configured=size)
    cosine = float(vector @ down) / (size * GRAVITY_M_PER_S2)
    tilt = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return replace(
        GRAVITY_ROW,
        configured=size,
        verdict=Verdict.of(deviation),
        remark=f"tilted by {tilt:.2g} degrees" if tilt > LEAST_TILT_DEG else "",
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
    return replace(
        CONTROL_ROW,
        reality=replace(
            CONTROL_ROW.reality,
            tolerance=longest_ms,
            limits=f"at most {longest_ms:.3g}",
        ),
        configured=1e3 * action_s,
        verdict=verdict,
        remark=remark,
        consequence="The policy sees the robot too seldom to balance or to stop it."
        if verdict.is_off
        else "",
    )
