"""Compare the model's constraint solver with the same equations in another layout, on states that the model visits."""

import copy

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.model_rows import (
    Finding,
    NotMeasuredError,
    body_name,
    row,
    start,
)
from gauge_envs.tools.sanity.robot.robot import Robot

MOTION_S, MOST_STEPS = 1.0, 400
"""Length of each motion: from the pose in which the robot works, and after a push [s], and its most steps."""

PUSH_M_PER_S = 0.5
"""Standard deviation of the velocities of the push [m/s or rad/s]."""

BALANCED = 1e-6
"""Imbalance of forces up to which a state is not solved again in the other layout."""


def imbalance(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return by how much `M a = smooth forces + constraint forces` fails, over the largest of the three."""
    inertial = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, inertial, data.qacc)
    left = inertial - data.qfrc_smooth - data.qfrc_constraint
    terms = (inertial, data.qfrc_smooth, data.qfrc_constraint)
    largest = max(float(np.linalg.norm(term)) for term in terms)
    return float(np.linalg.norm(left)) / max(largest, 1e-12)


@row("robot-solver")
def _solver(robot: Robot) -> Finding:
    model = robot.model
    if not mujoco.mj_isSparse(model):
        return Finding(declined="the model's constraint solver is dense")
    dense = copy.copy(model)
    dense.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    # Layouts store the same numbers: the accelerations may differ by rounding alone.
    found, worst, flagged, count = 0.0, 0, 0, 0
    data, other = start(robot), mujoco.MjData(dense)
    begin = data.qpos.copy()
    push = np.random.default_rng(0).normal(0.0, PUSH_M_PER_S, model.nv)
    steps = min(MOST_STEPS, max(1, round(MOTION_S / model.opt.timestep)))
    for velocity in (np.zeros(model.nv), push):
        data.qpos[:], data.qvel[:] = begin, velocity
        for _ in range(steps):
            gap, dof = _difference(model, data, dense, other)
            flagged += gap > 1e-3
            if gap > found:
                found, worst = gap, dof
            mujoco.mj_step(model, data)
        count += steps
        if not np.isfinite(data.qpos).all():
            raise NotMeasuredError("the state diverges")
    remark = f"MuJoCo {mujoco.__version__}, {count} states"
    if flagged:
        body = body_name(robot, int(model.dof_bodyid[worst]))
        remark = f"{remark}: {flagged} differ, most at {body}"
    return Finding(
        value=found,
        remark=remark,
        advice='<option jacobian="dense"/>, or another release of MuJoCo',
    )


def _difference(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    dense: mujoco.MjModel,
    other: mujoco.MjData,
) -> tuple[float, int]:
    """Return the difference of the accelerations of two layouts over the larger one, and where it is largest.

    A state whose forces are balanced is solved, whatever the other layout says.
    """
    warm: FloatArray = data.qacc_warmstart.copy()
    mujoco.mj_forward(model, data)
    data.qacc_warmstart[:] = warm
    if imbalance(model, data) <= BALANCED:
        return 0.0, 0
    for name in ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "userdata"):
        getattr(other, name)[:] = getattr(data, name)
    other.qacc_warmstart[:] = warm
    mujoco.mj_forward(dense, other)
    change = data.qacc - other.qacc
    sizes = (data.qacc, other.qacc, other.qacc_smooth)
    size = max(float(np.linalg.norm(one)) for one in sizes)
    return float(np.linalg.norm(change)) / max(size, 1e-12), int(np.argmax(abs(change)))
