"""Runs of the target's own model: at rest from its start, and the same with a tenth of the step and a finer solver.

The start is the keyframe in which the robot stands or the first one, else the model's initial pose. Actuators are at
rest: they get the controls of the keyframe, else position servos the command that holds the start, and all others 0.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from gauge_envs.scene import Vector
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.sanity.model_checks.drives import hold_position
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    disable_bit,
    once,
    standing_key,
)
from gauge_envs.tools.sanity.verdict import NotApplicableError

REST_S = 2.0
"""Time of a run at rest [s]: a body dropped by 0.1 m falls for 0.14 s, and a default contact settles in 0.1 s."""

MAX_STEPS = 4000
"""Steps after which a run of a model with a step below 0.5 ms ends."""

SAMPLES, LATE = 100, 25
"""Samples of a run, and of its end, in which motion at rest is read."""

REFINEMENT, SMALL_NV, LARGE_NV, FINE_S = 10, 60, 100, 5e-5
"""Refinement of step and solver; degrees of freedom from which on a step is refined by 4, and not at all.

The refined step is at least 50 us [s], or half of the step if that is smaller.
"""

RESOLVED_RAD = 0.2
"""Angle by which the stiffest contact with a given stiffness swings in a refined step [rad].

A semi-implicit step h holds a swing of angular frequency w up to h w = 2. Several contacts carry a body, each with a
stiffness over an impedance below 1, so that w is a few times as high.
"""

STILL_M_PER_S = 1e-3
"""Speed of a body at rest [m/s]."""

ON_PLANE = 1
"""Contact of a tree of bodies with fixed planes alone."""

SLEEP = int(mujoco.mjtEnableBit.mjENBL_SLEEP)

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""Components of the state on which a step depends."""


class Run:
    """A run at rest.

    Attributes:
        model: The model that ran.
        data: The state at the end.
        points_m: Three points of each body, at its radius of gyration, in each sample [m], shape
            [sample_count, nbody, 3, 3].
        heights_m: Height of the centre of mass of each tree of bodies at the start and in each sample [m], shape
            [1 + sample_count, ntree].
        touching: Whether each tree touches nothing, fixed planes alone (`ON_PLANE`), or more, shape as `heights_m`. A
            tree without a speed upwards starts as on a plane: in the air it falls.
        forces: Mean force of the actuators in the last quarter [N m or N], shape [nv].
        late_state: State at the start of the last quarter, of MuJoCo's kind `mjSTATE_INTEGRATION`.
        sample_s: Time between samples [s].
        diverged_s: Time at which the state diverged [s]; infinite when it did not.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        up: Vector,
        sample_s: float,
        state: FloatArray | None = None,
        samples: int = SAMPLES,
    ) -> None:
        """Run a model from its start, or some samples from a state."""
        self.model, self.data = model, start_data(model)
        data, roots = self.data, model.tree_bodyadr
        if state is not None:
            mujoco.mj_setState(model, data, state, STATE)
            data.time = 0.0
        mujoco.mj_subtreeVel(model, data)
        self.points_m = np.full((samples, model.nbody, 3, 3), np.nan)
        self.heights_m = np.zeros((1 + samples, model.ntree))
        self.touching = np.zeros(self.heights_m.shape, dtype=np.int64)
        self.heights_m[0] = data.subtree_com[roots] @ up
        self.touching[0] = np.abs(data.subtree_linvel[roots] @ up) < STILL_M_PER_S
        self.late_state = np.zeros(mujoco.mj_stateSize(model, STATE))
        self.sample_s, self.diverged_s, self.forces = (
            sample_s,
            np.inf,
            np.zeros(model.nv),
        )
        squares = model.body_inertia.max(axis=1) / np.maximum(model.body_mass, 1e-12)
        radii_m = np.sqrt(squares)[:, None, None]
        for sample in range(samples):
            until_s = (sample + 1) * sample_s - 0.5 * model.opt.timestep
            while data.time < until_s:
                mujoco.mj_step(model, data)
                if has_diverged(data):
                    self.diverged_s = max(until_s, sample_s)
                    return
            axes = data.ximat.reshape(-1, 3, 3).transpose(0, 2, 1)
            self.points_m[sample] = data.xipos[:, None] + radii_m * axes
            self.heights_m[1 + sample] = data.subtree_com[roots] @ up
            self.touching[1 + sample] = _touching(model, data)
            if sample == samples - LATE:
                mujoco.mj_getState(model, data, self.late_state, STATE)
            if sample >= samples - LATE:
                self.forces += np.abs(data.qfrc_actuator) / LATE

    @property
    def speeds_mm_per_s(self) -> FloatArray:
        """Root mean square of the speeds of the bodies in the last eighth [mm/s], shape [nbody]."""
        velocities = np.diff(self.points_m[-LATE // 2 :], axis=0) / self.sample_s
        return 1e3 * np.sqrt((velocities**2).sum(-1).mean((0, 2)))


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> IntArray:
    """Return for each tree of bodies 0, `ON_PLANE` where it touches fixed planes alone, or more, shape [ntree]."""
    touching = np.zeros(model.ntree, dtype=np.int64)
    geoms = np.asarray(data.contact.geom).reshape(-1, 2)
    trees = model.body_treeid[model.geom_bodyid[geoms]]
    is_plane = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_PLANE
    is_plane &= trees < 0
    for side in (0, 1):
        kinds = np.where(is_plane[:, 1 - side], ON_PLANE, ON_PLANE + 1)
        moves = trees[:, side] >= 0
        np.maximum.at(touching, trees[moves, side], kinds[moves])
    return touching


def seconds(model: mujoco.MjModel, maximum_s: float) -> float:
    """Return the time of a run, which is shorter with small steps [s]."""
    return min(maximum_s, MAX_STEPS * float(model.opt.timestep))


def has_diverged(data: mujoco.MjData) -> bool:
    """Return whether MuJoCo has met a position, velocity, acceleration or control that is not finite."""
    return bool(data.warning.number[int(mujoco.mjtWarning.mjWARN_BADQPOS) :].any())


def start_data(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the state from which a model starts, with its actuators at rest."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, standing_key(model))
    data.time = 0.0
    mujoco.mj_forward(model, data)
    if not data.ctrl.any():
        hold_position(model, data)
        mujoco.mj_forward(model, data)
    return data


def finer_solver(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model whose solver is exact to rounding; all solvers of MuJoCo minimize one function."""
    finer = copy.copy(model)
    option = finer.opt
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.iterations, option.ls_iterations = 1000, 500
    option.noslip_iterations *= REFINEMENT
    option.ccd_iterations *= REFINEMENT
    option.tolerance = option.ls_tolerance = option.noslip_tolerance = 1e-10
    option.ccd_tolerance = min(option.ccd_tolerance, 1e-6)
    option.enableflags &= ~SLEEP
    return finer


def refined(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model with a tenth of the step or less, an exact solver, and the constants of constraints.

    MuJoCo raises time constants of constraints to two steps, unless `refsafe` is off: they stay as the step of the
    model raises them. A negative constant is a stiffness in 1/s^2, the square of an angular frequency.
    """
    if model.nv > LARGE_NV:
        raise NotApplicableError(
            f"a refined run of {model.nv} degrees of freedom takes long"
        )
    finer, step_s = finer_solver(model), float(model.opt.timestep)
    arrays = [getattr(finer, name) for name in dir(finer) if "solref" in name]
    constants_s = [array.reshape(-1, 2)[:, 0] for array in arrays]
    factor = REFINEMENT if model.nv <= SMALL_NV else 4
    stiffness = -min(array.min(initial=0.0) for array in constants_s)
    factor = max(factor, step_s * np.sqrt(stiffness) / RESOLVED_RAD)
    finer.opt.timestep = step_s / np.clip(round(step_s / FINE_S), 2, factor)
    if not model.opt.disableflags & disable_bit("refsafe"):
        for times_s in [*constants_s, finer.opt.o_solref[:1]]:
            times_s[(times_s > 0.0) & (times_s < 2.0 * step_s)] = 2.0 * step_s
    return finer


@once
def rest(robot: Robot, *, is_refined: bool) -> Run:
    """Return the run of the model as it is, or of the refined model from the same start."""
    if not robot.model.nv:
        raise NotApplicableError("the model has no joint")
    model = refined(robot.model) if is_refined else robot.model
    return Run(model, robot.up, seconds(robot.model, REST_S) / SAMPLES)


def settled(robot: Robot, *, is_refined: bool = False) -> Run:
    """Return such a run; checks at rest do not apply where it diverges."""
    run = rest(robot, is_refined=is_refined)
    if np.isfinite(run.diverged_s):
        raise NotApplicableError(
            f"the state diverges at {run.diverged_s:.3g} s with a step of {run.model.opt.timestep:g} s"
        )
    return run
