"""Compare the model's constraint solver with other solutions of the same equations, on states that the model visits."""

from __future__ import annotations

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


COMPARED_STATES = 24
"""States of each motion, evenly spaced, in which other solvers solve the same equations."""

TO_THE_END = {"iterations": 1000, "tolerance": 1e-14, "ls_iterations": 200}
"""Settings with which a solver goes on until nothing changes."""

LIMIT = 1e-3
"""Difference of accelerations, over the larger one, that is no rounding."""


RESOLVED = 1e-5
"""Difference below which two solutions are the same: both may stop at an imbalance of 1e-6."""


@row("robot-solver")
def _solver(robot: Robot) -> Finding:
    model = robot.model
    data, layout, solvers = start(robot), _Layout(model), _Solvers(model)
    begin = data.qpos.copy()
    push = np.random.default_rng(0).normal(0.0, PUSH_M_PER_S, model.nv)
    steps = min(MOST_STEPS, max(1, round(MOTION_S / model.opt.timestep)))
    for velocity in (np.zeros(model.nv), push):
        data.qpos[:], data.qvel[:] = begin, velocity
        for step in range(steps):
            warm = _forward(model, data)
            layout.compare(data, warm)
            if step % max(1, steps // COMPARED_STATES) == 0:
                solvers.compare(data, warm)
            mujoco.mj_step(model, data)
        if not np.isfinite(data.qpos).all():
            raise NotMeasuredError("the state diverges")
    return _finding(robot, layout, solvers, 2 * steps)


def _finding(robot: Robot, layout: _Layout, solvers: _Solvers, count: int) -> Finding:
    """Return what was found in a number of states."""
    model = robot.model
    value = max(layout.largest, solvers.largest)
    remark = f"{count} states"
    if value > LIMIT:
        remark = f"MuJoCo {mujoco.__version__}, {remark}"
    if layout.differing:
        body = body_name(robot, int(model.dof_bodyid[layout.worst_dof]))
        remark = f"{remark}: {layout.differing} differ, most at {body}"
    if solvers.largest > LIMIT:
        remark += f"; Newton and CG part by {solvers.largest:.2g}"
    if solvers.unfinished > LIMIT:
        left = f"{100.0 * solvers.unfinished:.2g} %"
        remark += f"; {model.opt.iterations} iterations leave up to {left}"
    if value <= LIMIT:
        return Finding(value=value if value > RESOLVED else 0.0, remark=remark)
    advice = "another release of MuJoCo"
    if layout.largest > LIMIT and mujoco.mj_isSparse(model):
        advice = f'<option jacobian="dense"/>, or {advice}'
    return Finding(value=value, remark=remark, advice=advice)


def _forward(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Solve a state; return its warm start, which the solver replaces."""
    warm: FloatArray = data.qacc_warmstart.copy()
    mujoco.mj_forward(model, data)
    data.qacc_warmstart[:] = warm
    return warm


class _Other:
    """The same equations under other settings.

    Args:
        model: The model.
        settings: Options that differ.
    """

    def __init__(self, model: mujoco.MjModel, **settings: float) -> None:
        self._model = copy.copy(model)
        for name, value in settings.items():
            setattr(self._model.opt, name, value)
        self._data = mujoco.MjData(self._model)

    def solve(self, data: mujoco.MjData, warm: FloatArray) -> FloatArray:
        """Return the accelerations at the state of some data."""
        for name in STATE:
            getattr(self._data, name)[:] = getattr(data, name)
        self._data.qacc_warmstart[:] = warm
        mujoco.mj_forward(self._model, self._data)
        return np.array(self._data.qacc)

    def imbalance(self) -> float:
        """Return the imbalance of the forces of the last solution."""
        return imbalance(self._model, self._data)


STATE = (
    *("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "userdata"),
    *("eq_active", "xfrc_applied", "qfrc_applied"),
)


class _Layout:
    """Whether the other layout of matrices gives other accelerations: it stores the same numbers.

    Attributes:
        largest: Largest difference, over the larger acceleration.
        differing: States that differ.
        worst_dof: Degree of freedom that differs most.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        kinds = mujoco.mjtJacobian
        is_sparse = mujoco.mj_isSparse(model)
        other = kinds.mjJAC_DENSE if is_sparse else kinds.mjJAC_SPARSE
        self._other = _Other(model, jacobian=other)
        self.largest, self.differing, self.worst_dof = 0.0, 0, 0

    def compare(self, data: mujoco.MjData, warm: FloatArray) -> None:
        # A state whose forces are balanced is solved, whatever the other layout says.
        if imbalance(self._model, data) <= BALANCED:
            return
        other = self._other.solve(data, warm)
        change, found = data.qacc - other, _relative(data.qacc, other, data)
        self.differing += found > LIMIT
        if found > self.largest:
            self.largest, self.worst_dof = found, int(np.argmax(abs(change)))


class _Solvers:
    """Whether Newton and CG, both to the end, agree: the problem is convex. And what the model's iterations leave.

    Attributes:
        largest: Largest difference between both, over the larger acceleration.
        solved: States in which both reach the end.
        unfinished: Largest difference of the model's own solution from the end.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        dense = {"jacobian": mujoco.mjtJacobian.mjJAC_DENSE, **TO_THE_END}
        self._newton = _Other(model, solver=mujoco.mjtSolver.mjSOL_NEWTON, **dense)
        self._cg = _Other(model, solver=mujoco.mjtSolver.mjSOL_CG, **TO_THE_END)
        self.largest, self.solved, self.unfinished = 0.0, 0, 0.0

    def compare(self, data: mujoco.MjData, warm: FloatArray) -> None:
        if not data.nefc:
            return
        solution = self._newton.solve(data, warm)
        if self._newton.imbalance() > BALANCED:
            return
        left = _relative(data.qacc, solution, data)
        self.unfinished = max(self.unfinished, left)
        other = self._cg.solve(data, warm)
        if self._cg.imbalance() <= BALANCED:
            self.solved += 1
            self.largest = max(self.largest, _relative(other, solution, data))


def _relative(one: FloatArray, two: FloatArray, data: mujoco.MjData) -> float:
    """Return the difference of two accelerations over the larger one; at rest, over that without constraints."""
    size = max(float(np.linalg.norm(each)) for each in (one, two, data.qacc_smooth))
    return float(np.linalg.norm(one - two)) / max(size, 1e-12)
