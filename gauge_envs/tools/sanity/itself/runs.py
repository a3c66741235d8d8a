"""Runs of the target's own model: at rest from its start, and the same with a tenth of the step and a finer solver.

The start is the keyframe `home` or the first one, else the model's initial pose. Actuators are at rest: they get the
controls of the keyframe, else position servos the command that holds the start, and all others 0.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.robot.joints import servos
from gauge_envs.tools.sanity.robot.robot import Robot, disable_bit, once
from gauge_envs.tools.sanity.rows import NotApplicableError

REST_S = 2.0
"""Time of a run at rest [s]: a body dropped by 0.1 m falls for 0.14 s, and a default contact settles in 0.1 s."""

MAX_STEPS = 4000
"""Steps after which a run of a model with a step below 0.5 ms ends."""

SAMPLES, LATE = 100, 25
"""Samples of a run, and of its end, in which what is at rest is judged."""

REFINEMENT, SMALL_NV, LARGE_NV, FINE_S = 10, 60, 100, 5e-5
"""Refinement of step and solver; degrees of freedom from which on a step is refined by 4, and not at all.

A step is refined by no more than down to 50 us [s], but by two.
"""

SLEEP = int(mujoco.mjtEnableBit.mjENBL_SLEEP)

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""All that a step depends on."""

DIVERGED = [
    int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{name}"))
    for name in ("QPOS", "QVEL", "QACC")
]


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run at rest.

    Attributes:
        model: The model that ran.
        data: The state at the end.
        points_m: Three points of each body, at its radius of gyration, in each sample [m], shape
            [sample_count, nbody, 3, 3].
        is_awake: Whether each body was awake, shape [sample_count, nbody].
        stretches: Largest strain of the inextensible edges of each flex, shape [sample_count, nflex].
        sinks_m: Largest depth of each flex in what it touches [m], shape [sample_count, nflex].
        late_state: State at the start of the last quarter, of MuJoCo's kind `mjSTATE_INTEGRATION`.
        sample_s: Time between samples [s].
        diverged_s: Time at which the state diverged [s]; infinite when it did not.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    points_m: FloatArray
    is_awake: BoolArray
    stretches: FloatArray
    sinks_m: FloatArray
    late_state: FloatArray
    sample_s: float
    diverged_s: float = np.inf

    @property
    def speeds_m_per_s(self) -> FloatArray:
        """Root mean square of the speeds of the bodies in the last eighth [m/s], shape [nbody]."""
        velocities = np.diff(self.points_m[-LATE // 2 :], axis=0) / self.sample_s
        return np.asarray(np.sqrt((velocities**2).sum(-1).mean((0, 2))))


def seconds(model: mujoco.MjModel, longest_s: float) -> float:
    """Return the time of a run: shorter with small steps [s]."""
    return min(longest_s, MAX_STEPS * float(model.opt.timestep))


def has_diverged(data: mujoco.MjData) -> bool:
    """Return whether a state is not finite, or MuJoCo has reset it."""
    is_bad = any(data.warning[number].number for number in DIVERGED)
    return is_bad or not np.isfinite(data.qpos).all()


def start_data(model: mujoco.MjModel) -> mujoco.MjData:
    """Return the state from which a model starts, with its actuators at rest."""
    data = mujoco.MjData(model)
    if model.nkey:
        home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
        mujoco.mj_resetDataKeyframe(model, data, max(home, 0))
    mujoco.mj_forward(model, data)
    if data.ctrl.any():
        return data
    # A servo's force is gain * control + bias[0] + bias[1] * length: here it is 0.
    servo = servos(model) & (model.actuator_gainprm[:, 0] != 0.0)
    bias = model.actuator_biasprm[servo]
    forces = bias[:, 0] + bias[:, 1] * data.actuator_length[servo]
    data.ctrl[servo] = -forces / model.actuator_gainprm[servo, 0]
    mujoco.mj_forward(model, data)
    return data


def finer_solver(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model whose solver is exact to rounding; all solvers of MuJoCo minimize one function."""
    finer = copy.copy(model)
    option = finer.opt
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    for name in ("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"):
        setattr(option, name, REFINEMENT * getattr(option, name))
    option.iterations = max(option.iterations, 100)
    option.ls_iterations = max(option.ls_iterations, 50)
    option.tolerance = option.ls_tolerance = option.noslip_tolerance = 1e-10
    option.ccd_tolerance = min(option.ccd_tolerance, 1e-6)
    option.enableflags &= ~SLEEP
    return finer


def refined(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model with a tenth of the step and an exact solver, and the same constants of constraints.

    MuJoCo raises time constants of constraints to two steps, unless `refsafe` is off: they stay as the step of the
    model raises them.
    """
    if model.nv > LARGE_NV:
        raise NotApplicableError(
            f"a refined run of {model.nv} degrees of freedom takes long"
        )
    finer, step_s = finer_solver(model), float(model.opt.timestep)
    factor = REFINEMENT if model.nv <= SMALL_NV else 4
    finer.opt.timestep = step_s / np.clip(round(step_s / FINE_S), 2, factor)
    if not model.opt.disableflags & disable_bit("refsafe"):
        arrays = [getattr(finer, name) for name in dir(finer) if "solref" in name]
        for array in [*arrays, finer.opt.o_solref]:
            constants_s = array.reshape(-1, 2)[:, 0]
            is_short = (constants_s > 0.0) & (constants_s < 2.0 * step_s)
            constants_s[is_short] = 2.0 * step_s
    return finer


@once
def rest_from_refined(robot: Robot) -> Run:
    """Return the last quarter of the run of the model as it is, from the state of the refined run."""
    late_s = 0.25 * seconds(robot.model, REST_S)
    return _run(robot.model, late_s, refined_rest(robot).late_state, LATE)


@once
def rest(robot: Robot) -> Run:
    """Return the run of the model as it is."""
    return _run(robot.model, seconds(robot.model, REST_S))


@once
def refined_rest(robot: Robot) -> Run:
    """Return the run of the refined model from the same start."""
    return _run(refined(robot.model), seconds(robot.model, REST_S))


def settled(robot: Robot) -> Run:
    """Return the run of the model as it is; rows on rest do not apply to one without joints or that diverges."""
    if not robot.model.nv:
        raise NotApplicableError("the model has no joint")
    run = rest(robot)
    if np.isfinite(run.diverged_s):
        raise NotApplicableError(f"the state diverges at {run.diverged_s:.3g} s")
    return run


def _run(
    model: mujoco.MjModel,
    rest_s: float,
    state: FloatArray | None = None,
    samples: int = SAMPLES,
) -> Run:
    """Return a run from the model's start, or from a state."""
    data = start_data(model)
    if state is not None:
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_forward(model, data)
    run = Run(
        model=model,
        data=data,
        points_m=np.full((samples, model.nbody, 3, 3), np.nan),
        is_awake=np.ones((samples, model.nbody), bool),
        stretches=np.zeros((samples, model.nflex)),
        sinks_m=np.zeros((samples, model.nflex)),
        late_state=np.zeros(mujoco.mj_stateSize(model, STATE)),
        sample_s=rest_s / samples,
    )
    masses_kg = np.maximum(model.body_mass, 1e-12)
    radii_m = np.sqrt(model.body_inertia.max(axis=1) / masses_kg)[:, None, None]
    begin_s = float(data.time)
    for sample in range(samples):
        until_s = begin_s + (sample + 1) * run.sample_s - 0.5 * model.opt.timestep
        while data.time < until_s:
            mujoco.mj_step(model, data)
            if has_diverged(data):
                return replace(run, diverged_s=max(until_s - begin_s, run.sample_s))
        axes = data.ximat.reshape(-1, 3, 3).transpose(0, 2, 1)
        run.points_m[sample] = data.xipos[:, None] + radii_m * axes
        if model.opt.enableflags & SLEEP:
            run.is_awake[sample] = data.body_awake != 0
        if model.nflex:
            _add_flexes(run, sample)
        if sample == samples - LATE:
            mujoco.mj_getState(model, data, run.late_state, STATE)
    return run


def _add_flexes(run: Run, sample: int) -> None:
    """Add strain and depth of the flexes to a run."""
    model, data = run.model, run.data
    for flex in range(model.nflex):
        begin = int(model.flex_edgeadr[flex])
        edges = slice(begin, begin + int(model.flex_edgenum[flex]))
        if model.flex_edgeequality[flex] and not model.flex_rigid[flex]:
            lengths_m = model.flexedge_length0[edges]
            strains = np.abs(data.flexedge_length[edges] / lengths_m - 1.0)
            run.stretches[sample, flex] = strains.max()
    for contact in data.contact[: data.ncon]:
        flex = int(max(contact.flex))
        if flex >= 0 and contact.exclude == 0 and min(contact.flex) < 0:
            depth_m = max(run.sinks_m[sample, flex], -contact.dist)
            run.sinks_m[sample, flex] = depth_m
