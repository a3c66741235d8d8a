"""Check the target itself: its gravity, the time of one action, and its own model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.model import (
    MAX_PASSED,
    Need,
    PartOutcome,
    PhenomenonResult,
    Reality,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.rows import ROWS, row_result
from gauge_envs.tools.sanity.selection import CONTROL_ID, GRAVITY_ID

GRAVITY_ROW = PhenomenonResult(
    phenomenon=GRAVITY_ID,
    title="size of gravity, which points to the ground",
    unit="m/s^2",
    reality=Reality(
        GRAVITY_M_PER_S2,
        tolerance=0.05,
        source="standard gravity",
        rationale="covers every place on Earth, 9.76 to 9.83 m/s^2",
    ),
    default=GRAVITY_M_PER_S2,
    verdict=Verdict.PASSED,
    default_verdict=Verdict.PASSED,
)
"""Gravity on Earth."""

MAX_SLOPE_DEG = 60.0
"""Largest angle between gravity and the normal of the ground [degrees]: a tilted gravity stands for a slope."""

MAX_ACTION_MS = 350.0
"""Longest time of one action of policies that run on real robots: RT-1 acts at 3 Hz (arXiv:2212.06817) [ms]."""

MAX_FALL_SHARE = 0.5
"""Longest time of one action of a robot that stands, over the time in which its fall grows by e, sqrt(height / g)."""

CONTROL_ROW = PhenomenonResult(
    phenomenon=CONTROL_ID,
    title="time of one action",
    unit="ms",
    reality=Reality(
        value=0.0,
        tolerance=MAX_ACTION_MS,
        source="the slowest policies of real arms act at 3 Hz; a robot that stands falls by e in sqrt(height / g)",
        rationale="an action must end before the state has changed by more than the next action can correct",
        limits=f"at most {MAX_ACTION_MS:g}",
    ),
    verdict=Verdict.PASSED,
)
"""Time of one action of the policy: the step of the engine times the steps of an action."""

NUMBER_ROWS = (GRAVITY_ROW, CONTROL_ROW)


def target_rows(
    configuration: TrainingConfiguration,
    chosen: Sequence[str],
    notify: Callable[[PhenomenonResult], None] | None = None,
) -> list[PhenomenonResult]:
    """Return the chosen checks of the target itself; those that do not apply have a reason.

    Args:
        configuration: The target.
        chosen: Ids of checks; other ids are left out.
        notify: Function that is called with each result as soon as it is complete.
    """
    rows: list[PhenomenonResult] = []
    for name in chosen:
        if name in ROWS:
            rows.append(row_result(ROWS[name], configuration.robot))
        elif name in NUMBER_CHECKS:
            rows.append(NUMBER_CHECKS[name](configuration))
        else:
            continue
        if notify is not None:
            notify(rows[-1])
    return rows


def _inapplicable(row: PhenomenonResult, reason: str) -> PhenomenonResult:
    return replace(
        row, default=None, verdict=Verdict.NOT_MEASURED, remark=reason, applies=False
    )


def _judged(
    row: PhenomenonResult, value: float, deviation: float, verdict: Verdict, remark: str
) -> PhenomenonResult:
    """Return a result with a value, its deviation in half-widths and its verdict."""
    part = PartOutcome(
        name="the target", value=value, verdict=verdict, deviation=deviation
    )
    return replace(row, configured=value, verdict=verdict, remark=remark, parts=(part,))


def gravity_row(configuration: TrainingConfiguration) -> PhenomenonResult:
    """Return the check of gravity. Another size is a warning at worst, as it can be another planet's gravity."""
    gravity = configuration.gravity_m_per_s2
    absent = configuration.inapplicable.get(Need.GRAVITY)
    if gravity is None or absent is not None:
        return _inapplicable(
            GRAVITY_ROW, absent or "the target does not give its gravity"
        )
    size = length_of(np.asarray(gravity))
    cosine = -float(np.asarray(configuration.up) @ gravity) / size
    tilt_deg = math.degrees(math.acos(np.clip(cosine, -1.0, 1.0)))
    if tilt_deg > MAX_SLOPE_DEG:
        remark = f"gravity and the ground's normal are {tilt_deg:.3g} degrees apart"
        return _judged(GRAVITY_ROW, size, math.inf, Verdict.FAILED, remark)
    deviation = abs(size - GRAVITY_M_PER_S2) / GRAVITY_ROW.reality.tolerance
    verdict = Verdict.PASSED if deviation <= MAX_PASSED else Verdict.WARNING
    return _judged(GRAVITY_ROW, size, deviation, verdict, "")


def control_row(configuration: TrainingConfiguration) -> PhenomenonResult:
    """Return the check of the time of one action; it does not apply where the target does not give it."""
    step_s, steps = configuration.settings.get("timestep_s"), configuration.frame_skip
    if step_s is None or steps is None:
        return _inapplicable(
            CONTROL_ROW, "the target does not give the number of steps of an action"
        )
    limit_ms, remark = MAX_ACTION_MS, ""
    standing = None if configuration.robot is None else configuration.robot.standing
    if standing is not None:
        falling_ms = 1e3 * math.sqrt(standing.height_m / GRAVITY_M_PER_S2)
        limit_ms = MAX_FALL_SHARE * falling_ms
        remark = f"a fall of the robot grows by e in {falling_ms:.3g} ms"
    reality = replace(
        CONTROL_ROW.reality, tolerance=limit_ms, limits=f"at most {limit_ms:.3g}"
    )
    action_ms = 1e3 * step_s * steps
    deviation = action_ms / limit_ms
    row = replace(CONTROL_ROW, reality=reality)
    return _judged(row, action_ms, deviation, Verdict.of(deviation), remark)


NUMBER_CHECKS = {GRAVITY_ID: gravity_row, CONTROL_ID: control_row}
"""Functions that check the numbers of a target, by the id of the check."""
