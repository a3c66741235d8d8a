"""Runs of the target's own model: at rest, refined, in flight and in free motion; checks of what they conserve.

The start is the keyframe in which the robot stands or the first one, else the model's initial pose. Actuators are at
rest: they get the controls of the keyframe, else position servos the command that holds the start, and all others 0.
"""

import copy

import mujoco
import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2, Vector
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.sanity.model_checks.check import Finding, leave_to, model_check
from gauge_envs.tools.sanity.model_checks.drives import hold_position, servos
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    disable_bit,
    free_objects,
    joints_of,
    name_of,
    once,
    standing_key,
)
from gauge_envs.tools.sanity.verdict import NotApplicableError, Severity

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
def rest(robot: Robot, *, is_refined: bool = False) -> Run:
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


CONSERVED = 0.05
"""Largest relative change of angular momentum that passes."""

FLIGHT_S, OBJECT_RAD_PER_S, ROBOT_RAD_PER_S = 2.0, 2.0 * np.pi, 3.0
"""Time of a flight [s], and the spin of an object, one turn in a second, and of a robot with joints [rad/s]."""


def _in_flight(model: mujoco.MjModel, feature: str) -> mujoco.MjModel:
    """Return a copy with an exact solver, without contact, a feature and air, and without brakes of free joints."""
    flying = finer_solver(model)
    flying.opt.disableflags |= disable_bit("contact") | disable_bit(feature)
    flying.opt.density = flying.opt.viscosity = 0.0
    is_free = joints_of(model, "FREE")
    flying.jnt_stiffness[is_free] = 0.0
    for name in ("damping", "armature", "frictionloss"):
        getattr(flying, f"dof_{name}")[is_free[model.dof_jntid]] = 0.0
    return flying


def _flight(model: mujoco.MjModel, joints: list[int]) -> tuple[FloatArray, float]:
    """Return changes of angular momentum in a flight, over its size, shape [joint_count], and its time [s].

    A body turns with the spin of its keyframe, where that is faster.
    """
    data, roots = start_data(model), model.jnt_bodyid[joints]
    dofs = model.jnt_dofadr[joints, None] + [3, 4, 5]
    own = data.qvel[dofs]
    data.qvel[:] = 0.0
    is_alone = np.isin(roots, free_objects(model))
    slow = np.where(is_alone[:, None], OBJECT_RAD_PER_S, ROBOT_RAD_PER_S) / np.sqrt(3.0)
    data.qvel[dofs] = np.where(np.abs(own) > slow, own, slow)

    def momenta() -> FloatArray:
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        return data.subtree_angmom[roots].copy()

    before = momenta()
    while not has_diverged(data) and data.time < seconds(model, FLIGHT_S):
        mujoco.mj_step(model, data)
    sizes = np.maximum(np.linalg.norm(before, axis=-1), 1e-12)
    return np.linalg.norm(momenta() - before, axis=-1) / sizes, float(data.time)


@model_check(
    "model-spin",
    title="relative change of angular momentum in a flight",
    interval=(0.0, CONSERVED),
    source="angular momentum of a free body is conserved; air takes a few percent of the spin of a thrown object",
    consequence="What is thrown or jumps turns faster or slower than in reality.",
    is_simulated=True,
)
def spin(robot: Robot) -> Finding:
    """Return the change of angular momentum of free bodies without contact that a refined run does not show."""
    model = robot.model
    free = np.flatnonzero(joints_of(model, "FREE")).tolist()
    if not free:
        raise NotApplicableError("no body of the model is free")
    flying = _in_flight(model, "gravity")
    changes, flight_s = _flight(flying, free)
    text = f"{flight_s:.3g} s of free flight, with a step of {1e3 * model.opt.timestep:g} ms"
    if flight_s < 0.99 * seconds(model, FLIGHT_S):
        leave_to(holds, robot)
        return Finding(value=np.inf, remark=f"the state diverges after {text}")
    number, change = int(changes.argmax()), float(changes.max())
    body = int(model.jnt_bodyid[free[number]])
    if change > CONSERVED and _flight(refined(flying), free)[0][number] > 0.5 * change:
        raise NotApplicableError("other forces act on free bodies in flight")
    return Finding(
        value=change,
        place=("body", body),
        remark=f"the spin of {name_of(robot.model, 'body', body)} changes by {100.0 * change:.4g} % in {text}",
    )


SINE_S, SINE_SHARE, SINE_RAD = 1.0, 0.25, 0.2
"""Period of sinusoidal commands [s]; their amplitude over the range of a command, and of a servo without one [rad]."""


@model_check(
    "robot-holds",
    title="time with a finite state, over that of the run",
    interval=(1.0, np.inf),
    source="a run of the model from its keyframe or initial pose, without actions and along sines",
    consequence="Training meets NaN or is reset in each episode.",
    most=Severity.ERROR,
    is_simulated=True,
)
def holds(robot: Robot) -> Finding:
    """Return the time for which the state stays finite at rest, then while its commands follow a sine."""
    model = robot.model
    diverged_s, motion = rest(robot).diverged_s, "at rest"
    data = start_data(model)
    begin = data.ctrl.copy()
    spans = SINE_SHARE * np.ptp(model.actuator_ctrlrange, axis=1)
    # A motor without a range may have any force.
    sizes = np.where(model.actuator_ctrllimited, spans, SINE_RAD * servos(model))
    while np.isinf(diverged_s) and data.time < seconds(model, SINE_S):
        # A state that diverges is reset, with its time.
        next_s = float(data.time + model.opt.timestep)
        data.ctrl[:] = begin + sizes * np.sin(2.0 * np.pi * data.time / SINE_S)
        mujoco.mj_step(model, data)
        if has_diverged(data):
            diverged_s = next_s
            motion = "on sines of its commands"
    if np.isinf(diverged_s):
        return Finding(value=1.0)
    return Finding(
        value=min(diverged_s / REST_S, 0.3),
        remark=f"the state diverges after {diverged_s:.3g} s {motion}, with a step of {1e3 * model.opt.timestep:g} ms",
    )


ENERGY_S, UNDAMPED_S = 1.0, 20.0
"""Time of the free motion whose energy is read, and of a motion without damping [s]."""


@model_check(
    "robot-energy",
    title="energy that a free motion gains, or loses without damping",
    interval=(0.0, 0.1),
    source="without contact and motors, with the damping and friction of joints and servos, energy only falls; without "
    "them it stays",
    consequence="The policy is paid for motions that the engine feeds or brakes.",
    most=Severity.ADVICE,
    is_simulated=True,
)
def energy(robot: Robot) -> Finding:
    """Return the change of energy from the first tenth of a free motion to the farthest one, over the kinetic."""
    leave_to(holds, robot)
    if (robot.model.actuator_plugin >= 0).any():
        raise NotApplicableError("plugins drive the joints")
    bare = _in_flight(robot.model, "limit")
    bare.eq_active0[bare.eq_type != mujoco.mjtEq.mjEQ_JOINT] = 0
    # MuJoCo's energy has no term for gravity compensation. Servos keep damping.
    bare.body_gravcomp[:] = 0.0
    bare.actuator_gainprm[:], bare.actuator_biasprm[:, :2] = 0.0, 0.0
    bare.actuator_forcerange[:] = [-1e9, 1e9]
    bare.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    brakes = (
        bare.dof_damping,
        bare.dof_frictionloss,
        bare.actuator_biasprm[:, 2],
        bare.tendon_damping,
        bare.eq_active0,
    )
    is_undamped = not any(map(np.any, brakes))
    time_s = seconds(bare, UNDAMPED_S if is_undamped else ENERGY_S)
    data, values = start_data(bare), []
    is_free = joints_of(bare, "FREE")[bare.dof_jntid]
    rates = np.random.default_rng(0).uniform(-1.0, 1.0, bare.nv)
    data.qvel[:] = np.where(is_free, 0.0, rates)
    while data.time < time_s and not has_diverged(data):
        mujoco.mj_step(bare, data)
        values.append(data.energy.copy())
    tenths = np.array_split(values, min(10, len(values)))
    energies_j = np.array([tenth.mean(axis=0) for tenth in tenths])
    totals_j, largest_j = energies_j.sum(axis=1), float(energies_j[:, 1].max())
    if has_diverged(data):
        return Finding(value=np.inf, remark="a free motion of its joints diverges")
    gained_j = float(totals_j.max() - totals_j[0])
    lost_j = float(totals_j[0] - totals_j.min()) if is_undamped else 0.0
    change_j, word = max((gained_j, "gain"), (lost_j, "have no damping and lose"))
    return Finding(
        value=change_j / max(largest_j, 1e-9),
        remark=f"its joints {word} {change_j:.4g} of {largest_j:.4g} J in {data.time:.3g} s of free motion",
    )


SOLVED_STATES = 20
"""States of the run at rest in which the solver is compared."""


@model_check(
    "model-solver",
    title="error of the solver's forces in the run at rest",
    interval=(0.0, 0.05),
    source="Newton's method with 1e-10 and a dense Jacobian: all solvers of MuJoCo minimize one convex function",
    consequence="Contacts and joints push with forces that no model states.",
    is_simulated=True,
)
def solver(robot: Robot) -> Finding:
    """Return the error of constraint forces over their size, in the norm of the inverse mass matrix.

    Both solvers get the same states and the same forces of the step before, so that no chaos counts.
    """
    model = robot.model
    settled(robot)
    exact = finer_solver(model)
    data, rough, finer = start_data(model), mujoco.MjData(model), mujoco.MjData(exact)
    state = np.zeros(mujoco.mj_stateSize(model, STATE))
    steps = round(seconds(model, REST_S) / SOLVED_STATES / model.opt.timestep)
    squares, mass = np.zeros(2), np.zeros((model.nv, model.nv))
    for _ in range(SOLVED_STATES):
        mujoco.mj_step(model, data, max(1, steps))
        mujoco.mj_getState(model, data, state, STATE)
        for target, solved in ((model, rough), (exact, finer)):
            mujoco.mj_setState(target, solved, state, STATE)
            mujoco.mj_forward(target, solved)
        mujoco.mj_fullM(exact, finer, mass)
        vectors = finer.qacc - [rough.qacc, finer.qacc_smooth]
        squares += np.einsum("ni,ij,nj->n", vectors, mass, vectors)
    # Forces that accelerate nothing by 1 % of gravity are noise.
    minimum = 1e-4 * GRAVITY_M_PER_S2**2 * float(model.body_mass.sum()) * SOLVED_STATES
    value = float(np.sqrt(max(squares[0], 0.0) / max(squares[1], minimum)))
    name = mujoco.mjtSolver(model.opt.solver).name.removeprefix("mjSOL_")
    return Finding(
        value=value,
        remark=f"forces of {name} with {model.opt.iterations} iterations and a "
        f"{'sparse' if mujoco.mj_isSparse(model) else 'dense'} Jacobian are {100.0 * value:.4g} % off",
    )
