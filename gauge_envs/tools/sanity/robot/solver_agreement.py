"""Compare the model's constraint solver with other solutions of the same equations, on states that the model visits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    NotMeasuredError,
    body_name,
    row,
)
from gauge_envs.tools.sanity.robot.joints import start
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.versions import imbalance, is_discrete

MOTION_S, MOST_STEPS = 1.0, 400
"""Length of each motion: from the pose in which the robot works, and after a push [s], and its most steps."""

PUSH_M_PER_S = 0.5
"""Standard deviation of the velocities of the push [m/s or rad/s]."""

BALANCED = 1e-6
"""Imbalance of forces up to which a state is not solved again in the other layout."""

COMPARED_STATES = 24
"""States of each motion, evenly spaced, in which other solvers solve the same equations."""

TO_THE_END = {"iterations": 1000, "tolerance": 1e-14, "ls_iterations": 200}
"""Settings with which a solver goes on until nothing changes."""

MOST_ROWS = 300
"""Constraints up to which PGS is compared: its matrix has their square."""

LIMIT = 1e-3
"""Difference of accelerations, over the larger one, that is no rounding."""

AT_REST = 0.01
"""Accelerations below which a robot rests, and solvers stop [m/s^2 or rad/s^2]."""

RESOLVED = 1e-5
"""Difference below which two solutions are the same: both may stop at an imbalance of 1e-6."""

FULL = [
    int(mujoco.mjtWarning.mjWARN_CONTACTFULL),
    int(mujoco.mjtWarning.mjWARN_CNSTRFULL),
]
NO_MEMORY = (
    "the model's memory is too small for dense matrices of its constraints: state a larger "
    '<size memory="..."/>'
)

INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION
"""All that a step depends on, with the solver's warm start."""


@row("robot-solver")
def _solver(robot: Robot) -> Finding:
    model = robot.model
    data, agreement = start(robot), Agreement(model)
    begin = data.qpos.copy()
    push = np.random.default_rng(0).normal(0.0, PUSH_M_PER_S, model.nv)
    steps = min(MOST_STEPS, max(1, round(MOTION_S / model.opt.timestep)))
    for velocity in (np.zeros(model.nv), push):
        data.qpos[:], data.qvel[:] = begin, velocity
        agreement.follow(data, steps)
    return _finding(robot, agreement, 2 * steps)


class Agreement:
    """How far other solutions of the same equations are from that of a model.

    Args:
        model: The model.

    Attributes:
        layout: The other layout of matrices.
        solvers: Other solvers, and two threads.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self.layout, self.solvers = _Layout(model), _Solvers(model)

    @property
    def largest(self) -> dict[str, float]:
        """Largest difference of accelerations of each pair of solutions, over the larger one."""
        return {"sparse and dense": self.layout.largest, **self.solvers.largest}

    def follow(self, data: mujoco.MjData, steps: int) -> None:
        """Step the model, and compare solutions in the states that it visits.

        Raises:
            NotMeasuredError: The state diverges, or the model's memory is too small.
        """
        model = self._model
        state = np.empty(mujoco.mj_stateSize(model, INTEGRATION))
        for step in range(steps):
            mujoco.mj_getState(model, data, state, INTEGRATION)
            mujoco.mj_forward(model, data)
            is_chosen = step % max(1, steps // COMPARED_STATES) == 0
            self.layout.compare(data, state, is_chosen=is_chosen)
            if is_chosen:
                self.solvers.compare(data, state)
            # The solver has replaced its warm start.
            mujoco.mj_setState(model, data, state, INTEGRATION)
            mujoco.mj_step(model, data)
        if not np.isfinite(data.qpos).all():
            raise NotMeasuredError("the state diverges")


def _finding(robot: Robot, agreement: Agreement, count: int) -> Finding:
    """Return what was found in a number of states."""
    model, layout, solvers = robot.model, agreement.layout, agreement.solvers
    value = max(agreement.largest.values())
    remark = f"{count} states"
    if value > LIMIT:
        remark = f"MuJoCo {mujoco.__version__}, {remark}"
    if layout.differing:
        body = body_name(robot, int(model.dof_bodyid[layout.worst_dof]))
        left = f"{100.0 * layout.imbalance:.2g} %"
        remark = f"{remark}: {layout.differing} differ, most at {body}; {left} of the forces is not balanced"
    for pair, found in solvers.largest.items():
        if found > LIMIT:
            remark += f"; {pair} part by {found:.2g}"
    if solvers.unfinished > LIMIT:
        left = f"{100.0 * solvers.unfinished:.2g} %"
        remark += f"; {model.opt.iterations} iterations leave up to {left}"
    if value <= LIMIT:
        return Finding(value=value if value > RESOLVED else 0.0, remark=remark)
    advice = "another release of MuJoCo"
    if layout.largest > LIMIT and mujoco.mj_isSparse(model):
        advice = f'<option jacobian="dense"/>, or {advice}'
    return Finding(value=value, remark=remark, advice=advice)


def solver_differences(mjcf: str, steps: int) -> tuple[dict[str, float], float]:
    """Return by how much solutions of an MJCF model part on the way from its start, by pair.

    Args:
        mjcf: Text of the model.
        steps: Steps from its start.

    Returns:
        Largest difference of accelerations, over the larger one; and the largest share of the forces that the model's
        own solution leaves unbalanced.
    """
    model = mujoco.MjModel.from_xml_string(mjcf)
    agreement = Agreement(model)
    agreement.follow(mujoco.MjData(model), steps)
    return agreement.largest, agreement.layout.imbalance


class _Other:
    """The same equations under other settings.

    Args:
        model: The model.
        settings: Options that differ.

    Attributes:
        data: State of the model with these settings.
    """

    def __init__(self, model: mujoco.MjModel, **settings: float) -> None:
        self._model, self._settings = model, settings
        self.data = mujoco.MjData(model)

    def solve(self, state: FloatArray) -> FloatArray:
        """Return the accelerations at a state.

        Raises:
            NotMeasuredError: The memory of the model is too small for these settings.
        """
        mujoco.mj_setState(self._model, self.data, state, INTEGRATION)
        self.data.warning.number[:] = 0
        try:
            with self._set():
                mujoco.mj_forward(self._model, self.data)
        except mujoco.FatalError as error:
            raise NotMeasuredError(" ".join(str(error).split())) from error
        # Constraints are left out where memory ends.
        if self.data.warning.number[FULL].any():
            raise NotMeasuredError(NO_MEMORY)
        return np.array(self.data.qacc)

    def is_solved(self) -> bool:
        """Return whether the last solution is at its end: its forces are balanced."""
        with self._set() as option:
            left = imbalance(self._model, self.data)
            # Forces of PGS are balanced at each iteration, and the integrator `discrete` has another balance.
            if np.isnan(left) or option.solver == mujoco.mjtSolver.mjSOL_PGS:
                iterations = np.max(self.data.solver_niter, initial=0)
                return bool(iterations < option.iterations)
            return left <= BALANCED

    @contextmanager
    def _set(self) -> Iterator[Any]:
        """Give the model the settings for a while: meshes make copies of it slow."""
        option = self._model.opt
        before = {name: getattr(option, name) for name in self._settings}
        for name, value in self._settings.items():
            setattr(option, name, value)
        try:
            yield option
        finally:
            for name, value in before.items():
                setattr(option, name, value)


class _Layout:
    """Whether the other layout of matrices gives other accelerations: it stores the same numbers.

    Attributes:
        largest: Largest difference, over the larger acceleration.
        imbalance: Largest imbalance of the model's own solution; 0 where it has none.
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
        self.imbalance = 0.0

    def compare(
        self, data: mujoco.MjData, state: FloatArray, *, is_chosen: bool
    ) -> None:
        left = imbalance(self._model, data)
        self.imbalance = max(self.imbalance, float(np.nan_to_num(left)))
        # A state whose forces are balanced is solved, whatever the other layout says.
        if left <= BALANCED or (np.isnan(left) and not is_chosen):
            return
        other = self._other.solve(state)
        change, found = data.qacc - other, _relative(data.qacc, other, data)
        self.differing += found > LIMIT
        if found > self.largest:
            self.largest, self.worst_dof = found, int(np.argmax(abs(change)))


class _Solvers:
    """Whether solvers of the convex problem agree at their end, and one thread with two; what iterations leave.

    Attributes:
        largest: Largest difference of each pair, over the larger acceleration.
        unfinished: Largest difference of the model's own solution from the end.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        kinds = mujoco.mjtSolver
        dense = {"jacobian": mujoco.mjtJacobian.mjJAC_DENSE, **TO_THE_END}
        self._newton = _Other(model, solver=kinds.mjSOL_NEWTON, **dense)
        self._others = {
            "Newton and CG": _Other(model, solver=kinds.mjSOL_CG, **TO_THE_END)
        }
        # PGS may stop before the end of an elliptic problem, and MuJoCo does not combine it with `discrete`.
        if model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL and not is_discrete(model):
            pgs = _Other(model, solver=kinds.mjSOL_PGS, **TO_THE_END)
            self._others["Newton and PGS"] = pgs
        self._threads = _Other(model)
        # Before MuJoCo 4 Python has no threads of one simulation: both run in one.
        if hasattr(mujoco, "mju_threadpool"):
            mujoco.mju_threadpool(self._threads.data, 2)
        self.largest = dict.fromkeys((*self._others, THREADS), 0.0)
        self.unfinished = 0.0

    def compare(self, data: mujoco.MjData, state: FloatArray) -> None:
        if not data.nefc:
            return
        self._part(THREADS, self._threads.solve(state), np.array(data.qacc), data)
        solution = self._newton.solve(state)
        if not self._newton.is_solved():
            return
        self.unfinished = max(self.unfinished, _relative(data.qacc, solution, data))
        for pair, other in self._others.items():
            if pair.endswith("PGS") and data.nefc > MOST_ROWS:
                continue
            found = other.solve(state)
            if other.is_solved():
                self._part(pair, found, solution, data)

    def _part(
        self, pair: str, one: FloatArray, two: FloatArray, data: mujoco.MjData
    ) -> None:
        self.largest[pair] = max(self.largest[pair], _relative(one, two, data))


THREADS = "one thread and two"


def _relative(one: FloatArray, two: FloatArray, data: mujoco.MjData) -> float:
    """Return the difference of two accelerations over the larger one; at rest, over that without constraints."""
    size = max(length_of(each) for each in (one, two, data.qacc_smooth))
    return length_of(one - two) / max(size, AT_REST)
