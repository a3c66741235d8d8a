"""Run the target's own model with a change: whether it jumps or falls, and how fast it runs."""

from __future__ import annotations

import math
import time

import mujoco
import numpy as np

from gauge_envs.tools.sanity.fixes.guards import hops_more
from gauge_envs.tools.sanity.model_checks.standing import FELL, HOLD_S
from gauge_envs.tools.sanity.robot.robot import Robot, once

SPEED_BLOCKS, BLOCK_S = 4, 0.02
"""Number and shortest time [s] of the blocks in which the speed of a model is measured; the fastest one counts."""


def motion_harm(before: Robot, after: Robot) -> str:
    """Return how a change throws a model up from its start, or lets its robot fall; empty if it does not."""
    rise_mm, stands = _motion(before)
    new_rise_mm, stands_then = _motion(after)
    if hops_more(rise_mm, new_rise_mm):
        return f"the model jumps {new_rise_mm:.3g} mm from its start"
    if stands and not stands_then:
        return "the robot falls within 2 s, before it stands"
    return ""


@once
def _motion(robot: Robot) -> tuple[float, bool]:
    """Simulate 2 s from the start, with the controls of its keyframe.

    Returns:
        The largest rise of the centre of mass of a tree of bodies [mm], and whether the robot stands at the end.
        The rise is at least the depth of the overlap at the start, and infinite for a state that diverges.
    """
    model, standing, up = robot.model, robot.standing, np.asarray(robot.up)
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = robot.stance.qpos, robot.stance.ctrl
    mujoco.mj_forward(model, data)
    _, roots = np.unique(model.body_treeid, return_index=True)
    first_m = data.subtree_com @ up
    rise_m = -float(data.contact.dist.min(initial=0.0))
    for _ in range(round(HOLD_S / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            return math.inf, False
        rise_m = max(rise_m, float((data.subtree_com @ up - first_m)[roots].max()))
    stands = False
    if standing is not None:
        last = float(data.subtree_com[standing.body] @ up) - standing.ground_m
        first = float(first_m[standing.body]) - standing.ground_m
        stands = last > FELL * first
    return 1e3 * rise_m, stands


def speed_ratio(before: Robot, after: Robot) -> float:
    """Return the simulated time of a model in a second of the processor with a change, over that without."""
    models = before.model, after.model
    runs = [(model, mujoco.MjData(model), list[float]()) for model in models]
    for _ in range(SPEED_BLOCKS):
        for model, data, speeds in runs:
            started, before_s, spent_s = time.process_time(), data.time, 0.0
            while spent_s < BLOCK_S:
                mujoco.mj_step(model, data, nstep=10)
                spent_s = time.process_time() - started
            speeds.append((data.time - before_s) / spent_s)
    slow, fast = (max(speeds) for _, _, speeds in runs)
    return fast / slow
