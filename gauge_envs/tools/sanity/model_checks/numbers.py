"""Check the numbers that a target gives: its gravity, and the time of one action."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.model_checks.check import Finding, TargetCheck
from gauge_envs.tools.sanity.training import Need, TrainingConfiguration
from gauge_envs.tools.sanity.verdict import NotApplicableError, Reality

TARGET = "the target"
"""Part of a check of the target as a whole."""

MAX_SLOPE_DEG = 60.0
"""Largest angle between gravity and the normal of the ground [degrees]: a tilted gravity stands for a slope."""

MAX_ACTION_MS = 350.0
"""Longest time of one action of policies that run on real robots: RT-1 acts at 3 Hz (arXiv:2212.06817) [ms]."""

MAX_FALL_SHARE = 0.5
"""Longest time of one action of a robot that stands, over the time in which its fall grows by e, sqrt(height / g)."""


def gravity_finding(configuration: TrainingConfiguration) -> Finding:
    """Return the size of gravity. Another size is a warning at worst, as it can be another planet's gravity."""
    absent = configuration.inapplicable.get(Need.GRAVITY)
    if absent is not None:
        raise NotApplicableError(absent)
    gravity = configuration.gravity_m_per_s2
    if gravity is None:
        raise NotApplicableError("the target does not give its gravity")
    size = length_of(np.asarray(gravity))
    down = -float(np.asarray(configuration.up) @ gravity)
    tilt_deg = math.degrees(math.acos(np.clip(down / size, -1.0, 1.0)))
    # A tilted gravity pushes to the side.
    size = min(size, down, key=lambda value: abs(value - GRAVITY_M_PER_S2))
    found = Finding(value=size, parts={TARGET: size}, is_usual=True)
    if tilt_deg <= MAX_SLOPE_DEG:
        return found
    remark = f"gravity and the ground's normal are {tilt_deg:.3g} degrees apart"
    return replace(found, remark=remark, is_usual=False, deviation=math.inf)


gravity = TargetCheck(
    id="gravity",
    title="size of gravity, which points to the ground",
    unit="m/s^2",
    reality=Reality(
        GRAVITY_M_PER_S2,
        tolerance=0.05,
        source="standard gravity",
        rationale="covers every place on Earth, 9.76 to 9.83 m/s^2",
    ),
    measure=gravity_finding,
    default=GRAVITY_M_PER_S2,
)


def _action_reality(limit_ms: float) -> Reality:
    return Reality(
        value=0.0,
        tolerance=limit_ms,
        source="the slowest policies of real arms act at 3 Hz; a robot that stands falls by e in sqrt(height / g)",
        rationale="an action must end before the state has changed by more than the next action can correct",
        limits=f"at most {limit_ms:.3g}",
    )


def action_finding(configuration: TrainingConfiguration) -> Finding:
    """Return the step of the engine times the steps of an action [ms]."""
    step_s, steps = configuration.settings.get("timestep_s"), configuration.frame_skip
    if step_s is None or steps is None:
        raise NotApplicableError(
            "the target does not give the number of steps of an action"
        )
    limit_ms, remark = MAX_ACTION_MS, ""
    robot = configuration.robot
    if robot is not None and robot.standing is not None:
        falling_ms = 1e3 * math.sqrt(robot.standing.height_m / GRAVITY_M_PER_S2)
        limit_ms = MAX_FALL_SHARE * falling_ms
        remark = f"a fall of the robot grows by e in {falling_ms:.3g} ms"
    action_ms = 1e3 * step_s * steps
    return Finding(
        value=action_ms,
        remark=remark,
        parts={TARGET: action_ms},
        reality=_action_reality(limit_ms),
        deviation=action_ms / limit_ms,
    )


action_time = TargetCheck(
    id="control-step",
    title="time of one action",
    unit="ms",
    reality=_action_reality(MAX_ACTION_MS),
    measure=action_finding,
)
