"""Rows on conserved quantities of free motion, on the solver, and on what the file states without effect."""

from __future__ import annotations

import mujoco
import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.itself.rest_rows import name_of, objects
from gauge_envs.tools.sanity.itself.runs import (
    REST_S,
    STATE,
    finer_solver,
    has_diverged,
    refined,
    seconds,
    settled,
    start_data,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import Robot, disable_bit
from gauge_envs.tools.sanity.rows import (
    ROWS,
    Finding,
    NotApplicableError,
    row,
)

CONSERVED = 0.05
"""Change of angular momentum, over its size, that counts as none."""

FLIGHT_S, TURN_RAD_PER_S, ROBOT_RAD_PER_S = 2.0, 2.0 * np.pi, 3.0
"""Time of a flight [s], and the spin of an object, one turn in a second, and of a robot with joints [rad/s]."""


def _in_flight(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy with an exact solver, without contact, gravity and air, and without what brakes free joints."""
    flying = finer_solver(model)
    flying.opt.disableflags |= disable_bit("contact")
    flying.opt.gravity[:] = flying.opt.wind[:] = 0.0
    flying.opt.density = flying.opt.viscosity = 0.0
    is_free = joints_of(model, "FREE")
    dofs = is_free[model.dof_jntid]
    flying.dof_damping[dofs] = flying.dof_armature[dofs] = 0.0
    flying.dof_frictionloss[dofs] = 0.0
    flying.jnt_stiffness[is_free] = 0.0
    return flying


def _flight(model: mujoco.MjModel, joints: list[int]) -> tuple[FloatArray, float]:
    """Return changes of angular momentum in a flight, over its size, shape [joint_count, 3], and its time [s]."""
    data, alone = start_data(model), objects(model)
    data.qvel[:] = 0.0
    roots = model.jnt_bodyid[joints]
    for dof, root in zip(model.jnt_dofadr[joints], roots, strict=True):
        rate = TURN_RAD_PER_S if root in alone else ROBOT_RAD_PER_S
        data.qvel[dof + 3 : dof + 6] = rate / np.sqrt(3.0)

    def momenta() -> FloatArray:
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        return data.subtree_angmom[roots].copy()

    before, begin_s = momenta(), float(data.time)
    while not has_diverged(data) and data.time - begin_s < seconds(model, FLIGHT_S):
        mujoco.mj_step(model, data)
    sizes = np.linalg.norm(before, axis=-1, keepdims=True)
    return (momenta() - before) / np.maximum(sizes, 1e-12), float(data.time) - begin_s


@row(
    "model-spin",
    title="change of the angular momentum of a body in free flight in 2 s, over its size",
    unit="1",
    interval=(0.0, CONSERVED),
    source="angular momentum of a free body is conserved; air takes a few percent of the spin of a thrown object",
    consequence="What is thrown or jumps turns faster or slower in the air than momentum allows.",
)
def spin(robot: Robot) -> Finding:
    """Return the change of angular momentum of free bodies without contact, that a refined run does not show."""
    model = robot.model
    free = np.flatnonzero(joints_of(model, "FREE")).tolist()
    free = [joint for joint in free if model.body_subtreemass[model.jnt_bodyid[joint]]]
    if not free:
        raise NotApplicableError("no body of the model is free")
    flying = _in_flight(model)
    changes, flight_s = _flight(flying, free)
    text = f"after {flight_s:.3g} s of flight with a step of {model.opt.timestep:g} s"
    if flight_s < 0.99 * seconds(model, FLIGHT_S):
        if robot.finding(ROWS["robot-holds"]).value < 1.0:
            raise NotApplicableError("the state diverges")
        return Finding(value=np.inf, remark=f"the state diverges {text}")
    values = np.linalg.norm(changes, axis=-1)
    worst = int(values.argmax())
    value, place = float(values[worst]), ("body", int(model.jnt_bodyid[free[worst]]))
    if value > CONSERVED:
        finer, _ = _flight(refined(flying), free)
        if np.linalg.norm(finer[worst]) > 0.5 * value:
            raise NotApplicableError("other forces act on what is free in flight")
    return Finding(
        value=value,
        place=place,
        remark=f"angular momentum of {name_of(robot, *place)} is {100.0 * value:.3g} % off {text}",
    )


ENERGY_S = 1.0
"""Time of the free motion whose energy is read [s]."""


@row(
    "robot-energy",
    title="energy that a free motion gains in 1 s, over its largest kinetic energy",
    unit="1",
    interval=(0.0, 0.1),
    source="without contact and motors, with the damping and friction of joints and servos, energy only falls",
    consequence="The policy is paid for motions that the engine feeds.",
)
def energy(robot: Robot) -> Finding:
    """Return the growth of kinetic and potential energy from the first tenth of a free motion to the highest one."""
    model = robot.model
    if not model.nv:
        raise NotApplicableError("the model has no joint")
    bare = _in_flight(model)
    bare.opt.gravity[:] = model.opt.gravity
    for feature in ("limit", "equality"):
        bare.opt.disableflags |= disable_bit(feature)
    # MuJoCo's energy has no term for what carries a body against gravity. Of servos the damping is left.
    bare.body_gravcomp[:] = 0.0
    bare.actuator_gainprm[:], bare.actuator_biasprm[:, :2] = 0.0, 0.0
    bare.actuator_forcerange[:] = [-1e9, 1e9]
    bare.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = start_data(bare)
    is_free = joints_of(model, "FREE")[model.dof_jntid]
    rates = np.random.default_rng(0).uniform(-1.0, 1.0, model.nv)
    data.qvel[:] = np.where(is_free, 0.0, rates)
    begin_s, values = float(data.time), []
    while data.time - begin_s < seconds(bare, ENERGY_S):
        mujoco.mj_step(bare, data)
        values.append(data.energy.copy())
        if has_diverged(data):
            return Finding(
                value=np.inf,
                remark=f"a free motion of its joints diverges after {data.time - begin_s:.3g} s",
            )
    tenths = np.array_split(np.asarray(values), min(10, len(values)))
    means_j = np.array([tenth.mean(axis=0) for tenth in tenths])
    totals_j = means_j.sum(axis=1)
    gained_j = float(totals_j.max() - totals_j[0])
    largest_j = float(means_j[:, 1].max())
    return Finding(
        value=gained_j / max(largest_j, 1e-9),
        remark=f"a free motion of its joints gains {gained_j:.3g} J; its kinetic energy is at most {largest_j:.3g} J",
    )


SOLVED_STATES = 20
"""States of the run at rest in which the solver is compared."""


@row(
    "model-solver",
    title="error of constraint forces by the solver, in states of the run at rest",
    unit="1",
    interval=(0.0, 0.05),
    source="Newton's method with 1e-10 and a dense Jacobian: all solvers of MuJoCo minimize one convex function",
    consequence="Contacts and joints push with forces that the model does not state.",
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
    interval = max(
        1, round(seconds(model, REST_S) / SOLVED_STATES / model.opt.timestep)
    )
    error = size = 0.0
    for _ in range(SOLVED_STATES):
        mujoco.mj_step(model, data, interval)
        mujoco.mj_getState(model, data, state, STATE)
        for target, solved in ((model, rough), (exact, finer)):
            mujoco.mj_setState(target, solved, state, STATE)
            mujoco.mj_forward(target, solved)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(exact, finer, mass)
        difference = rough.qacc - finer.qacc
        constrained = finer.qacc - finer.qacc_smooth
        error += float(difference @ mass @ difference)
        size += float(constrained @ mass @ constrained)
    # Forces that accelerate nothing by 1 % of gravity are noise.
    least = 1e-4 * GRAVITY_M_PER_S2**2 * float(model.body_mass.sum()) * SOLVED_STATES
    value = float(np.sqrt(max(error, 0.0) / max(size, least)))
    solver_name = mujoco.mjtSolver(model.opt.solver).name.removeprefix("mjSOL_")
    jacobian = "a sparse" if mujoco.mj_isSparse(model) else "a dense"
    return Finding(
        value=value,
        remark=f"forces of {solver_name} with {model.opt.iterations} iterations and {jacobian} Jacobian are "
        f"{100.0 * value:.3g} % off",
    )


ROLLING = 1e-4
"""Rolling friction of a geom that states none [m]."""

FLAT = (int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH))
"""Types of geoms that do not roll."""

LINK_SHARE = 0.2
"""Mass of a link, over its parent's, below which its weight needs no compensation."""


@row(
    "model-stated",
    title="statements of the file without effect: rolling friction with condim below 6, weight carried for some links",
    unit="1",
    interval=(0.0, 0.5),
    source="MuJoCo: rolling friction acts with condim 6; gravcomp of a body does not reach its children",
    consequence="The model does not do what its file says.",
    is_usual=True,
)
def stated(robot: Robot) -> Finding:
    """Return how many elements state what does not act."""
    remarks = {**_idle_rolling(robot), **_half_carried(robot)}
    return Finding(
        value=float(len(remarks)),
        place=next(iter(remarks), None),
        remark="; ".join(list(remarks.values())[:3]),
    )


def _idle_rolling(robot: Robot) -> dict[tuple[str, int], str]:
    """Return round free bodies that state a rolling friction which none of their contacts has."""
    model, idle = robot.model, {}
    for body in objects(model):
        geoms = np.flatnonzero(model.geom_bodyid == body)
        if np.isin(model.geom_type[geoms], FLAT).any():
            continue
        for geom in geoms.tolist():
            rows = (robot.pairs.geoms == geom).any(axis=1)
            friction = float(model.geom_friction[geom, 2])
            condims = robot.pairs.constants[rows, 0]
            if friction > 2.0 * ROLLING and rows.any() and condims.max() < 6:
                name = name_of(robot, "geom", geom)
                idle["geom", geom] = (
                    f"rolling friction {friction:g} is stated for {name}, and condim {condims.max():g} ignores it"
                )
    return idle


def _half_carried(robot: Robot) -> dict[tuple[str, int], str]:
    """Return links whose parent is carried against gravity and that motors move without being carried."""
    model, idle = robot.model, {}
    moved = model.jnt_bodyid[model.actuator_trnid[model.actuator_trntype == 0, 0]]
    for body in np.unique(moved).tolist():
        parent = int(model.body_parentid[body])
        if (
            model.body_gravcomp[parent] > 0.0
            and not model.body_gravcomp[body]
            and model.body_mass[body] > LINK_SHARE * model.body_mass[parent]
        ):
            idle["body", body] = (
                f"gravcomp {model.body_gravcomp[parent]:g} is stated for {name_of(robot, 'body', parent)}, not for "
                f"{name_of(robot, 'body', body)} ({model.body_mass[body]:.3g} kg)"
            )
    return idle
