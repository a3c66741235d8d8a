"""Judge what drives and brakes the joints of a robot."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.joints import (
    Case,
    Drive,
    drags,
    drives,
    joint_inertias,
    largest_loads,
    loads,
    reaches_m,
    root_of,
    servos,
    start,
    worst_case,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    LIQUID_KG_PER_M3,
    acts_on_joints,
    joints_of,
)
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.rows import ROWS, Finding, NotApplicableError, row

# --- friction, damping and armature ----------------------------------------------------------------------------------

SLOW_PER_S, SLOW_PER_S2 = 0.1, 0.5
"""Speed and acceleration that any joint reaches: 60 degrees in 10 s, from rest in 0.2 s [rad/s, rad/s^2]."""

STEP_PER_S, STEP_PER_S2 = 3.0, 30.0
"""Speed and acceleration of a leg that steps: half a radian in a swing of 0.2 s, from rest in 0.1 s."""

FALL_PER_S = 1.0
"""Speed at which a leg without power gives way under the whole robot [rad/s]: 1 m falls with 3 rad/s."""


@row(
    "robot-joint",
    title="friction, damping and armature of a joint, over what moves it",
    unit="1",
    interval=(0.0, 1.0),
    source="force balance of a slow motion: 0.1 rad/s from rest in 0.2 s, in a leg 3 rad/s in 0.1 s; a leg without "
    "power gives way to the whole robot; a rotor has no more inertia than the whole robot where no torque moves it",
    consequence="The joint does not move as any real joint does, so that the policy learns torques that no motor has.",
)
def joint_brakes(robot: Robot) -> Finding:
    """Return the joint whose friction, damping or armature is farthest beyond what moves it."""
    if not drives(robot):
        raise NotApplicableError("no motor acts on a joint")
    return worst_case(case for drive in drives(robot) for case in _brakes(drive))


def _brakes(drive: Drive) -> Iterator[Case]:
    model, (force, angle, inertia) = drive.robot.model, drive.units
    root, reaches = root_of(model, drive.body), reaches_m(drive.robot)
    robot_kg, robot_m = float(model.body_subtreemass[root]), float(reaches[root])
    dry = float(model.dof_frictionloss[drive.dof])
    if min(drive.damping, dry, drive.armature) < 0.0:
        text = f"{drive.name} has a negative damping, friction or armature, which feeds its motion"
        yield drive.case(np.inf, text)
    numbers = (
        f"friction {dry:.3g} {force}, damping {drive.damping:.3g} {force} s/{angle} and armature {drive.armature:.3g} "
        f"{inertia}"
    )
    speed, acceleration = (
        (STEP_PER_S, STEP_PER_S2) if drive.is_leg else (SLOW_PER_S, SLOW_PER_S2)
    )
    brake = (
        float(drags(drive.robot, speed)[drive.dof])
        + drive.armature * acceleration * drive.scale
    )
    yield drive.case(
        brake / drive.push,
        f"{drive.name} takes {brake:.3g} {force} at {speed * drive.scale:g} {angle}/s: {numbers}; its motor makes "
        f"{drive.push:.3g} {force}",
    )
    g = length_of(model.opt.gravity)
    limb = float(model.body_subtreemass[drive.body]) * g * float(reaches[drive.body])
    acting = float(drags(drive.robot, FALL_PER_S)[drive.dof])
    if np.isfinite(drive.push) and drive.is_hinge:
        text = f"{drive.name} states a friction of {dry:.3g} N m; "
        text += f"its motor makes {drive.push:.3g} N m and gravity {limb:.2g}"
        if acting < drive.push:
            text += f"; MuJoCo makes a drag of it, {acting:.2g} N m at 1 rad/s, as the link is light"
        yield drive.case(
            dry / (drive.push + limb),
            text,
            acting < drive.push,
        )
    weight = robot_kg * g * float(reaches[drive.body])
    if drive.is_leg and drive.is_hinge and weight:
        fall = dry + drive.damping * FALL_PER_S
        yield drive.case(
            fall / weight,
            f"{drive.name} takes {fall:.3g} N m to turn by {FALL_PER_S:g} rad/s: {numbers}; the whole robot of "
            f"{robot_kg:.3g} kg makes {weight:.2g} N m there, its limb {largest_loads(drive.robot)[drive.dof]:.2g} N m",
        )
    if not np.isfinite(drive.limit):
        whole = robot_kg * (robot_m**2 if drive.is_hinge else 1.0)
        text = f"{drive.name} has an armature of {drive.armature:.3g} {inertia}, the robot of {robot_kg:.3g} kg "
        text += (
            f"stretched to {robot_m:.2g} m {whole:.2g} {inertia}"
            if drive.is_hinge
            else "less"
        )
        yield drive.case(
            drive.armature / whole,
            f"{text}; no torque limit is given",
        )


# --- servos ----------------------------------------------------------------------------------------------------------

LEAST_ERROR_RAD = 0.005
"""Error from which on a servo may give all its torque [rad].

It is 6 mrad and more in models of makers; gears and encoders of hobby servos play by 2 to 15 mrad.
"""

RINGING, RINGING_S, ENDLESS_S = 0.05, 1.0, 60.0
"""Damping ratio and decay times of a servo that rings: at 0.05 a step overshoots by 85 %; makers have 0.089."""

SLOW_S = 2.0
"""Time in which any servo covers half of a small step [s]: 10 times that of the slowest hobby servo."""

SAG_RAD = 0.6
"""Error at which a servo carries its limb [rad]: twice that of the softest model of a maker, TALOS with 0.296."""

COMMANDS, COMMANDS_RAD = 30.0, 20.0
"""Range of commands over that of the joint, and the range itself: degrees are 57 times too large."""

GROWTH, GROWTH_STEPS, KICK = 3.0, 400, 0.1
"""Growth of a slow motion [rad/s or m/s] in some steps: a loop that is stable has none."""


@row(
    "robot-drive",
    title="response of a servo, over the limit of a drive that works",
    unit="1",
    interval=(0.0, 1.0),
    source="a slow motion without gravity and contact never grows; closed forms of a loop of second order for ringing, "
    "lag and sag; the error at which a servo saturates; commands in degrees",
    consequence="The joint does not do what the policy commands, so that the policy learns to work against its servo.",
)
def servo_response(robot: Robot) -> Finding:
    """Return the servo farthest beyond the limit of its kind."""
    several = [drive for drive in drives(robot) if drive.kp > 0.0]
    if not several and not servos(robot.model).any():
        raise NotApplicableError("no servo holds a position")
    # Friction, damping or armature beyond all measure is one cause, which robot-joint names.
    braked = (
        {
            name
            for name, ratio in robot.finding(ROWS["robot-joint"]).parts.items()
            if ratio > 1.0 and several
        }
        if several
        else set()
    )
    several = [drive for drive in several if drive.name not in braked]
    return worst_case(
        [
            *_growth(robot),
            *_switches(several),
            *(case for drive in several for case in _response(drive)),
        ]
    )


def _growth(robot: Robot) -> Iterator[Case]:
    """Yield the growth of a slow motion from the start, where all servos are at rest."""
    model = robot.without("contact", "gravity", "limit", "spring", "equality")
    is_affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    is_muscle = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_MUSCLE)
    if is_muscle.any() or not drives(robot):
        return
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data, speeds = start(robot, model), list[float]()
    low, high = model.actuator_ctrlrange.T
    data.ctrl[:] = np.where(
        model.actuator_ctrllimited != 0, np.clip(0.0, low, high), 0.0
    )
    forces = (
        model.actuator_gainprm[:, 0] * data.ctrl
        + model.actuator_biasprm[:, 1] * data.actuator_length
    )
    model.actuator_biasprm[is_affine, 0] = -forces[is_affine]
    dofs = [drive.dof for drive in drives(robot)]
    data.qvel[dofs] = KICK * np.random.default_rng(0).choice([-1.0, 1.0], len(dofs))
    while len(speeds) < GROWTH_STEPS and max(speeds, default=0.0) < np.inf:
        last = data.qvel.copy()
        mujoco.mj_step(model, data)
        is_bad = data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
        speeds.append(np.inf if is_bad else float(np.sqrt(data.energy[1])))
    growth = max(speeds[len(speeds) // 2 :]) / max(speeds[0], 1e-300)
    number = int(model.dof_jntid[np.argmax(np.abs(last))])
    name = model.joint(number).name or f"joint {number}"
    text = (
        f"a motion of {name} grows {growth:.2g}-fold in {len(speeds) * model.opt.timestep:.2g} s with a step of "
        f"{1e3 * model.opt.timestep:g} ms"
    )
    yield Case(growth / GROWTH, ("joint", number), name, text)


def _switches(several: list[Drive]) -> Iterator[Case]:
    """Yield servos that give all their torque from a tiny error on, where at least half of them do.

    A stiff gripper whose force is limited grips with this force: it is right.
    """
    hinges = [drive for drive in several if drive.is_hinge and np.isfinite(drive.limit)]
    errors = [drive.limit / drive.kp for drive in hinges]
    if not errors or np.median(errors) >= LEAST_ERROR_RAD:
        return
    for drive, error in zip(hinges, errors, strict=True):
        text = (
            f"{drive.name}: with kp {drive.kp:.4g} N m/rad its {drive.limit:.3g} N m are reached "
            f"{1e3 * error:.2g} mrad "
            "beside the command, so that it works like a switch"
        )
        yield drive.case(LEAST_ERROR_RAD / error, text, True)


def _response(drive: Drive) -> Iterator[Case]:
    model, (force, angle, _) = drive.robot.model, drive.units
    damping = drive.damping + drive.kv
    # The damping that acts on a swing: with dry friction, as the engine makes it.
    acting = float(drags(drive.robot, 1.0)[drive.dof]) / drive.scale + drive.kv
    ratio = max(acting, 1e-9) / (2.0 * np.sqrt(drive.kp * drive.inertia))
    decay_s = 2.0 * drive.inertia / max(acting, 1e-9)
    swing = f"for {decay_s:.2g} s" if decay_s < ENDLESS_S else "without end"
    yield drive.case(
        min(RINGING / ratio, decay_s / RINGING_S),
        f"{drive.name} swings about each command {swing}: kp {drive.kp:.3g} {force}/{angle} with a damping of "
        f"{acting:.2g} {force} s/{angle}",
        True,
    )
    # Overdamped, a servo covers half of a step in ln(2) damping / kp.
    half_s = float(np.log(2.0)) * damping / drive.kp
    limit_s, standing = SLOW_S, drive.robot.standing
    if drive.is_leg and standing is not None:
        limit_s = float(np.sqrt(standing.height_m / GRAVITY_M_PER_S2))
    text = f"{drive.name} covers half of a small step in {half_s:.2g} s: "
    text += f"damping {damping:.3g} {force} s/{angle} and kp {drive.kp:.3g}"
    if drive.is_leg:
        text += f"; the robot falls in {limit_s:.2g} s"
    yield drive.case(half_s / limit_s, text, True)
    weight = float(largest_loads(drive.robot)[drive.dof])
    sag = weight / drive.kp
    root = model.body_dofnum[root_of(model, drive.body)]
    if drive.is_hinge and (root < 6 or drive.kp == 1.0) and not _is_overweight(drive):
        text = f"{drive.name} sags by {sag:.2g} rad: kp {drive.kp:.3g} N m/rad carries {weight:.3g} N m"
        if drive.kp == 1.0:
            text += ", and 1 is MuJoCo's kp where none is given"
        yield drive.case(sag / SAG_RAD, text, True)
    yield from _commands(drive)


def _commands(drive: Drive) -> Iterator[Case]:
    """Yield the range of commands of a servo over that of its joint."""
    model = drive.robot.model
    is_its = (
        acts_on_joints(model)
        & (model.actuator_trnid[:, 0] == drive.joint)
        & servos(model)
    )
    for actuator in np.flatnonzero(is_its & (model.actuator_ctrllimited != 0)).tolist():
        gain, bias = (
            float(model.actuator_gainprm[actuator, 0]),
            model.actuator_biasprm[actuator],
        )
        gear = float(model.actuator_gear[actuator, 0])
        if not (model.jnt_limited[drive.joint] and drive.is_hinge and gain * gear):
            continue
        ends = (gain * model.actuator_ctrlrange[actuator] + bias[0]) / (-bias[1] * gear)
        low, high = model.jnt_range[drive.joint]
        text = (
            f"commands of {drive.name} go from {ends.min():.3g} to {ends.max():.3g} {drive.units[1]}, the joint from "
            f"{low:.3g} to {high:.3g}"
        )
        yield drive.case(
            float(np.ptp(ends) / (high - low)) / COMMANDS,
            text,
            True,
        )


# --- weight ----------------------------------------------------------------------------------------------------------


@row(
    "robot-torque",
    title="force that holds a joint at rest, over that of its motor",
    unit="1",
    interval=(0.0, 1.0),
    source="inverse dynamics at rest in the pose of the keyframe; of a robot on feet, the mean torque as it falls",
    consequence="The motors do not hold the robot's own weight, so that the policy drags it.",
)
def holding_force(robot: Robot) -> Finding:
    """Return the joint whose motor is weakest where the robot rests."""
    from gauge_envs.tools.sanity.robot.rollout import fallen_saturations

    model = robot.model
    several = [
        drive
        for drive in drives(robot)
        if np.isfinite(drive.limit) and not _is_overweight(drive)
    ]
    if not several:
        raise NotApplicableError("no motor of a joint states the limit of its torque")
    if robot.standing is not None:
        needed = fallen_saturations(robot)
        verb = "the robot falls while"
    else:
        if np.isin(
            model.eq_type, [int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)]
        ).any():
            raise NotApplicableError("closed chains share the weight")
        data = start(robot)
        rest = np.minimum(
            loads(model, data),
            np.abs(data.qfrc_bias - data.qfrc_passive - data.qfrc_constraint),
        )
        several = [drive for drive in several if model.nkey or drive.kp]
        needed = {drive.dof: float(rest[drive.dof]) for drive in several}
        verb = "at rest"
    return worst_case(
        drive.case(
            needed.get(drive.dof, 0.0) / drive.limit,
            f"{verb} {drive.name} takes {needed.get(drive.dof, 0.0):.3g} {drive.units[0]}, its motor "
            f"makes {drive.limit:.3g}; "
            f"{_heaviest(drive)}",
        )
        for drive in several
    )


def _carried(drive: Drive) -> list[int]:
    """Return the bodies that a joint carries."""
    parents, carried = drive.robot.model.body_parentid.tolist(), [drive.body]
    for body in range(drive.body + 1, len(parents)):
        if parents[body] in carried:
            carried.append(body)
    return carried


def _is_overweight(drive: Drive) -> bool:
    """Return whether a joint carries a body whose mass is wrong, which robot-mass names."""
    model, masses = drive.robot.model, drive.robot.finding(ROWS["robot-mass"]).parts
    return any(
        masses.get(model.body(body).name or f"body {body}", 0.0) > 1.0
        for body in _carried(drive)
    )


def _heaviest(drive: Drive) -> str:
    """Return the heaviest body that a joint carries, with its mass."""
    model = drive.robot.model
    body = max(_carried(drive), key=lambda number: float(model.body_mass[number]))
    return f"{model.body(body).name or f'body {body}'} weighs {model.body_mass[body]:.3g} kg"


# --- couplings and free joints ---------------------------------------------------------------------------------------

YIELD_SHARE = 0.3
"""Part of its range by which a coupling may yield."""

LARGEST_GIVE, HALVINGS = 1.0, 14
"""Largest displacement at which a coupling is tried [rad or m], and the halvings that find it to 0.1 mrad."""


@row(
    "robot-coupling",
    title="part of its range by which a coupled joint yields",
    unit="1",
    interval=(0.0, YIELD_SHARE),
    source="0.001 to 0.02 in grippers of makers whose linkage is stiff, 0.14 to 0.23 with MuJoCo's default solref",
    consequence="One finger closes and the other gives way, so that a grasp holds less than the real one.",
)
def coupling_yield(robot: Robot) -> Finding:
    """Return the coupling between joints that yields farthest to the force of a motor."""
    model = robot.without("contact", "limit", "frictionloss")
    data, cases = start(robot, model), []
    begin = data.qpos.copy()
    pushes = np.zeros(model.nv)
    for drive in drives(robot):
        pushes[drive.dof] = drive.push if np.isfinite(drive.push) else 0.0
    for number in np.flatnonzero(
        model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
    ).tolist():
        joints = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        if joints[1] < 0 or not model.eq_active0[number]:
            continue
        dofs, places = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
        load = float(pushes[dofs].max())
        lead = float(begin[places[1]] - model.qpos0[places[1]])
        coupled = float(
            model.qpos0[places[0]] + np.polyval(model.eq_data[number, 4::-1], lead)
        )
        span = float(np.ptp(model.jnt_range[joints[0]])) or 1.0
        name = model.joint(joints[0]).name or f"joint {joints[0]}"
        follows = f"{name}, which follows {model.joint(joints[1]).name or f'joint {joints[1]}'},"
        place = ("equality", number)
        if load > 0.0:
            give = _give(
                model, data, begin, (int(places[0]), int(dofs[0])), coupled, load
            )
            text = f"{follows} yields by {give:.2g} of a range of {span:.3g} under {load:.3g} of the motor"
            cases.append(Case(give / span, place, name, text, True))
        off = abs(coupled - float(begin[places[0]]))
        text = f"{follows} begins {off:.2g} beside its coupling"
        cases.append(Case(off / span, place, name, text))
    if not cases:
        raise NotApplicableError("no equality couples joints")
    return worst_case(cases, limit=YIELD_SHARE)


def _give(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    begin: FloatArray,
    address: tuple[int, int],
    coupled: float,
    load: float,
) -> float:
    """Return the displacement at which the constraints of a model at rest hold a load [rad or m].

    Args:
        model: The model.
        data: Its data, whose positions change.
        begin: Positions at the start, shape [nq].
        address: Place of the joint in the positions, and its degree of freedom.
        coupled: Position to which it is coupled.
        load: The load [N m or N].
    """
    low, high = 0.0, LARGEST_GIVE
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        data.qpos[:] = begin
        data.qpos[address[0]] = coupled + middle
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        mujoco.mj_inverse(model, data)
        is_enough = abs(float(data.qfrc_constraint[address[1]])) >= load
        low, high = (low, middle) if is_enough else (middle, high)
    return high


FREE_SHARE = 0.05
"""Share of its speed that a free base may lose in 1 s: air takes less from anything heavier than a balloon."""


@row(
    "robot-free",
    title="share of its speed that a free joint takes from a body in 1 s",
    unit="1",
    interval=(0.0, FREE_SHARE),
    source='nothing holds a base in the air; defaults of joints apply to <joint type="free"> and not to <freejoint>',
    consequence="The base is braked in the air, so that the policy learns to turn and to fall slower than the robot.",
)
def free_joint_drag(robot: Robot) -> Finding:
    """Return the free joint with the largest friction, damping or armature."""
    model = robot.model
    frees = np.flatnonzero(joints_of(model, "FREE")).tolist()
    if not frees or model.opt.density > LIQUID_KG_PER_M3:
        raise NotApplicableError("no joint is free in air")
    inertia = joint_inertias(robot) - model.dof_armature
    legged = {root_of(model, drive.body) for drive in drives(robot)}
    cases = []
    for number in frees:
        body, first = int(model.jnt_bodyid[number]), int(model.jnt_dofadr[number])
        six = slice(first, first + 6)
        damping, dry, armature = (
            np.reshape(array, (model.nv, -1))[six, 0]
            for array in (model.dof_damping, model.dof_frictionloss, model.dof_armature)
        )
        is_robot = body in legged
        # A ball may be braked to keep it from rolling: of a body counts what slows its fall to a crawl within 1 s.
        share = float(np.max(np.maximum(damping + dry, armature) / inertia[six]))
        if not is_robot:
            share = FREE_SHARE * float(damping[0] / model.body_subtreemass[body])
        name = model.joint(number).name or model.body(body).name or f"joint {number}"
        text = (
            f"the free joint of {model.body(body).name or f'body {body}'} has damping {damping[0]:g}, frictionloss "
            f"{dry[0]:g} and armature {armature[0]:g}, which brake it in the air"
        )
        cases.append(Case(share, ("joint", number), name, text, not is_robot))
    return worst_case(cases, limit=FREE_SHARE)
