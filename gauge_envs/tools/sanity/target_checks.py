"""Judge what a target itself is: its gravity, the time of one action, and its own model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.model import (
    INSIDE_WITHIN,
    Need,
    PartOutcome,
    PhenomenonResult,
    Reality,
    RealityKind,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.own_rows import ROWS
from gauge_envs.tools.sanity.rows import row_result
from gauge_envs.tools.sanity.selection import CONTROL_ID, GRAVITY_ID

GRAVITY_ROW = PhenomenonResult(
    phenomenon=GRAVITY_ID,
    title="size of gravity, which points to the ground",
    unit="m/s^2",
    reality=Reality.law(
        GRAVITY_M_PER_S2,
        tolerance=0.05,
        source="standard gravity",
        rationale="covers every place on Earth, 9.76 to 9.83 m/s^2",
    ),
    default=GRAVITY_M_PER_S2,
    verdict=Verdict.INSIDE,
    default_verdict=Verdict.INSIDE,
)
"""Gravity on Earth."""

STEEPEST_DEG = 60.0
"""Largest angle between gravity and the normal of the ground [degrees]: a tilted gravity stands for a slope."""

LONGEST_ACTION_MS = 350.0
"""Longest time of one action of policies that run on real robots: RT-1 acts at 3 Hz (arXiv:2212.06817) [ms]."""

FALLING_SHARE = 0.5
"""Longest time of one action of a robot that stands, in the time in which its fall grows by e, sqrt(height / g)."""

CONTROL_ROW = PhenomenonResult(
    phenomenon=CONTROL_ID,
    title="time of one action",
    unit="ms",
    reality=Reality(
        kind=RealityKind.LAW,
        value=0.0,
        tolerance=LONGEST_ACTION_MS,
        source="the slowest policies of real arms act at 3 Hz; a robot that stands falls by e in sqrt(height / g)",
        rationale="an action must end before the state has changed by more than the next action can correct",
        limits=f"at most {LONGEST_ACTION_MS:g}",
    ),
    verdict=Verdict.INSIDE,
)
"""Time of one action of the policy: the step of the engine times the steps of an action."""

STATED_ROWS = (GRAVITY_ROW, CONTROL_ROW)


def target_rows(
    configuration: TrainingConfiguration,
    chosen: Sequence[str],
    notify: Callable[[PhenomenonResult], None] | None = None,
) -> list[PhenomenonResult]:
    """Return the chosen rows on the target itself; those that do not apply have a reason.

    Args:
        configuration: The target.
        chosen: Ids of rows; others are left out.
        notify: Function that is called with each row as soon as it is complete.
    """
    rows: list[PhenomenonResult] = []
    for name in chosen:
        if name in ROWS:
            rows.append(row_result(ROWS[name], configuration.robot))
        elif name == GRAVITY_ID:
            rows.append(gravity_row(configuration))
        elif name == CONTROL_ID:
            rows.append(control_row(configuration))
        else:
            continue
        if notify is not None:
            notify(rows[-1])
    return rows


def _inapplicable(row: PhenomenonResult, reason: str) -> PhenomenonResult:
    return replace(
        row, default=None, verdict=Verdict.DECLINED, remark=reason, applies=False
    )


def _judged(
    row: PhenomenonResult, value: float, deviation: float, verdict: Verdict, remark: str
) -> PhenomenonResult:
    """Return a row with a value, its deviation in half-widths and its verdict."""
    part = PartOutcome(
        name="the target", value=value, verdict=verdict, deviation=deviation
    )
    return replace(row, configured=value, verdict=verdict, remark=remark, parts=(part,))


def gravity_row(configuration: TrainingConfiguration) -> PhenomenonResult:
    """Return the row on gravity. Another size is visible at most, as it can be that of another planet."""
    gravity = configuration.gravity_m_per_s2
    absent = configuration.inapplicable.get(Need.GRAVITY)
    if gravity is None or absent is not None:
        return _inapplicable(
            GRAVITY_ROW, absent or "the target does not give its gravity"
        )
    size = length_of(np.asarray(gravity))
    cosine = -float(np.asarray(configuration.up) @ gravity) / size
    tilt_deg = math.degrees(math.acos(np.clip(cosine, -1.0, 1.0)))
    if tilt_deg > STEEPEST_DEG:
        remark = f"gravity and the ground's normal are {tilt_deg:.3g} degrees apart"
        return _judged(GRAVITY_ROW, size, math.inf, Verdict.WRONG, remark)
    deviation = abs(size - GRAVITY_M_PER_S2) / GRAVITY_ROW.reality.tolerance
    verdict = Verdict.INSIDE if deviation <= INSIDE_WITHIN else Verdict.VISIBLE
    return _judged(GRAVITY_ROW, size, deviation, verdict, "")


def control_row(configuration: TrainingConfiguration) -> PhenomenonResult:
    """Return the row on the time of one action; it does not apply where the target does not give it."""
    step_s, steps = configuration.settings.get("timestep_s"), configuration.frame_skip
    if step_s is None or steps is None:
        return _inapplicable(
            CONTROL_ROW, "the target does not give the number of steps of an action"
        )
    longest_ms, remark = LONGEST_ACTION_MS, ""
    standing = None if configuration.robot is None else configuration.robot.standing
    if standing is not None:
        falling_ms = 1e3 * math.sqrt(standing.height_m / GRAVITY_M_PER_S2)
        longest_ms = FALLING_SHARE * falling_ms
        remark = f"a fall of the robot grows by e in {falling_ms:.3g} ms"
    reality = replace(
        CONTROL_ROW.reality, tolerance=longest_ms, limits=f"at most {longest_ms:.3g}"
    )
    action_ms = 1e3 * step_s * steps
    deviation = action_ms / longest_ms
    row = replace(CONTROL_ROW, reality=reality)
    return _judged(row, action_ms, deviation, Verdict.of(deviation), remark)
