"""Check how a robot stands under its own servos, and whether its motors hold its weight."""

from __future__ import annotations

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.check import (
    Finding,
    NotMeasuredError,
    model_check,
    worst_case,
)
from gauge_envs.tools.sanity.model_checks.drives import (
    drives,
    hold_position,
    loads,
    servos,
    start,
)
from gauge_envs.tools.sanity.model_checks.ground import MIN_GAP_MM, floor_m, standing_of
from gauge_envs.tools.sanity.model_checks.masses import is_overweight
from gauge_envs.tools.sanity.robot.robot import Robot, once
from gauge_envs.tools.sanity.verdict import NotApplicableError

HOLD_S, LATE_S = 2.0, 0.5
"""Time for which servos hold the robot [s], and the end of this time, in which torques are read."""

FELL, ROSE = 0.7, 1.3
"""Ratios of the heights of the centre of mass at the end and at the start: a robot below fell, a robot above rose."""

SATURATED = 0.99
"""Share of its limit from which on a motor is saturated, so that the load is larger."""

MIN_FEET = 3
"""Smallest number of feet on which a robot stands without a policy."""


@once
def hold_pose(robot: Robot) -> tuple[float, FloatArray]:
    """Simulate a robot whose servos hold the pose in which it stands.

    Returns:
        The ratio of the heights of its centre of mass at the end and at the start, and the mean late force of the
        actuators in each degree of freedom [N m or N], shape [nv].

    Raises:
        NotApplicableError: It does not stand on three feet or more, or not all of its legs have servos.
        NotMeasuredError: The state diverges.
    """
    standing, model = standing_of(robot), robot.model
    if len(standing.feet) < MIN_FEET:
        raise NotApplicableError(
            "a robot with one foot or two balances with a policy alone"
        )
    servo = servos(model) & (model.actuator_gainprm[:, 0] != 0.0)
    if not all(drive.kp for drive in drives(robot) if drive.is_leg) or not servo.any():
        raise NotApplicableError("no servos hold the legs")
    data = start(robot)
    data.ctrl[:] = robot.stance.ctrl
    if not data.ctrl.any():
        hold_position(model, data)
    steps, late = (
        max(1, round(time_s / model.opt.timestep)) for time_s in (HOLD_S, LATE_S)
    )
    ground_m, up = floor_m(robot), np.asarray(robot.up)
    first_m = data.subtree_com[standing.body] @ up - ground_m
    forces = np.zeros(model.nv)
    for step in range(steps):
        mujoco.mj_step(model, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise NotMeasuredError(
                f"the state diverges at {(step + 1) * model.opt.timestep:.3g} s"
            )
        if step >= steps - late:
            forces += np.abs(data.qfrc_actuator) / late
    last_m = data.subtree_com[standing.body] @ up - ground_m
    return float(last_m / max(first_m, 1e-6)), forces


@model_check(
    "robot-torque",
    title="force that holds a joint, over that of its motor",
    interval=(0.0, 1.0),
    source="inverse dynamics at rest in the pose of the keyframe; of a robot on feet, the mean torque as it falls",
    consequence="The motors do not hold the robot's own weight.",
    is_simulated=True,
)
def holding_force(robot: Robot) -> Finding:
    """Return the joint whose motor is weakest where the robot rests."""
    model = robot.model
    limited = [
        drive
        for drive in drives(robot)
        if np.isfinite(drive.limit) and not is_overweight(robot, drive.body)
    ]
    if not limited:
        raise NotApplicableError("no motor of a joint has a torque limit")
    if robot.standing is not None:
        height_ratio, forces = hold_pose(robot)
        needed = forces / SATURATED * (height_ratio <= FELL)
        verb = "the robot falls while"
    else:
        kinds = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
        if np.isin(model.eq_type, kinds).any():
            raise NotApplicableError("closed chains share the weight")
        data = start(robot)
        carried = data.qfrc_bias - data.qfrc_passive - data.qfrc_constraint
        needed = np.minimum(loads(model, data), np.abs(carried))
        limited = [drive for drive in limited if model.nkey or drive.kp]
        verb = "at rest"
    return worst_case(
        drive.case(
            needed[drive.dof] / drive.limit,
            f"{verb} {drive.name} takes {needed[drive.dof]:.3g} {drive.units[0]}; its motor makes {drive.limit:.3g}",
        )
        for drive in limited
    )


@model_check(
    "robot-stands",
    title="height after 2 s under servos, over the first",
    interval=(FELL, ROSE),
    source="the robot's own rollout: its pose, its controls and its settings, on three feet or more",
    consequence="Episodes begin with a fall or jump that the policy has to undo.",
    is_usual=True,
    is_simulated=True,
)
def stands(robot: Robot) -> Finding:
    """Return the height of a robot that its servos hold, over that at the start."""
    if not robot.model.nkey:
        raise NotApplicableError("the model has no keyframe")
    (ratio, _), standing = hold_pose(robot), standing_of(robot)
    gap_mm = 1e3 * (standing.ground_m - floor_m(robot))
    text = ""
    if not FELL <= ratio <= ROSE:
        text = f"the robot is at {ratio:.2g} of its height"
        if abs(gap_mm) > MIN_GAP_MM:
            text += f": its feet start {abs(gap_mm):.3g} mm {'above' if gap_mm > 0.0 else 'in'} the ground"
    return Finding(value=ratio, remark=text, place=("body", standing.body))
