"""Run the target's own robot in its own settings: held where it stands, moving freely, and joint by joint."""

from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    NOT_STANDING,
    Finding,
    NotApplicableError,
    NotMeasuredError,
    by_joint,
    joint_name,
    limits_of,
    row,
    standing_of,
)
from gauge_envs.tools.sanity.robot.ground_rows import overlaps
from gauge_envs.tools.sanity.robot.joints import (
    dof_of,
    driven_dofs,
    feet_above_ground_m,
    floor_m,
    joint_inertias,
    largest_weights_nm,
    loads_nm,
    position_servos,
    servo_gains,
    servos,
    springs,
    start,
    stiffness,
)
from gauge_envs.tools.sanity.robot.motions import (
    HoldMotion,
    hold_pose,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    acts_on_joints,
    coupled_joints,
    joints_of_motors,
    loop_joints,
    once,
    switched_off,
)

SLOPE_DEG, SLOPE_PUSH = 10.0, 0.7
"""Slope on which feet stand [degrees], and the largest push, over what their friction holds."""

CARRIED_SHARE = 0.9
"""Share of the weight on the feet of a robot that stands on a slope."""

MOST_DROP_MM = 10.0
"""Height of feet above the ground from which on a robot falls before it stands [mm]."""

LEAST_FEET = 3
"""Feet on which a robot stands without a policy."""

NO_SERVO = (
    "no servos hold the robot: its torques come from a policy, or its servos from code"
)


def _finite_hold(robot: Robot, slope_deg: float = 0.0) -> HoldMotion:
    """Return the motion of a robot that its servos hold; it does not apply without servos."""
    if not servos(robot.model).any():
        raise NotApplicableError(NO_SERVO)
    pushes_n = sum(push_n for _, push_n in overlaps(robot).values())
    if pushes_n > robot.mass_kg * GRAVITY_M_PER_S2:
        raise NotMeasuredError(
            f"its parts push each other apart with {pushes_n:.3g} N where it starts"
        )
    motion = hold_pose(robot, slope_deg)
    if np.isfinite(motion.diverged_s):
        raise NotMeasuredError(f"the state diverges at {motion.diverged_s:.3g} s")
    return motion


def _advisory(robot: Robot) -> str:
    if robot.standing is None or len(robot.standing.feet) >= LEAST_FEET:
        return ""
    return f"a robot with {len(robot.standing.feet)} feet balances with a policy alone"


@row("robot-stands")
def _stands(robot: Robot) -> Finding:
    body, above_m = standing_of(robot).body, feet_above_ground_m(robot)
    ratio = max(_finite_hold(robot).height_ratio, 1e-3)
    # Out of the ground, its centre of mass is higher by the depth of its feet.
    centre_m = float(start(robot).subtree_com[body] @ np.asarray(robot.up))
    on_ground = 1.0 - above_m / max(centre_m - floor_m(robot), 1e-3)
    if on_ground > limits_of("robot-stands")[1]:
        ratio = max(ratio, on_ground)
    if ratio < 1.0:
        drop_mm = 1e3 * above_m
        is_above = ratio < limits_of("robot-stands")[0] and drop_mm > MOST_DROP_MM
        return Finding(
            value=ratio,
            remark=f"its feet start {drop_mm:.3g} mm above the ground"
            if is_above
            else "",
            advisory=_advisory(robot),
            is_usual=True,
        )
    # Without a policy a biped falls, and does not rise.
    rises = ratio > limits_of("robot-stands")[1]
    return Finding(
        value=ratio,
        remark="it rises: it starts in the ground, or in a spring" if rises else "",
    )


@row("robot-saturation")
def _saturation(robot: Robot) -> Finding:
    saturations = by_joint(robot, _finite_hold(robot).saturations)
    if not saturations:
        return Finding(declined="no joint states the limit of its torque")
    joint = max(saturations, key=saturations.__getitem__)
    return Finding(
        value=saturations[joint],
        parts=saturations,
        remark=joint,
        advisory=_advisory(robot),
    )


def _rolls(robot: Robot, body: int) -> bool:
    """Return whether a body turns on a hinge without limits that no servo holds, as a wheel does."""
    model = robot.model
    first = int(model.body_jntadr[body])
    joints = range(first, first + int(model.body_jntnum[body]))
    held = {*model.actuator_trnid[servos(model), 0].tolist()}
    is_hinge = joints_of(model, "HINGE")
    return any(
        is_hinge[joint] and not model.jnt_limited[joint] and joint not in held
        for joint in joints
    )


@row("robot-slip")
def _slip(robot: Robot) -> Finding:
    if not robot.foot_rows or _advisory(robot):
        return Finding(declined=_advisory(robot) or NOT_STANDING)
    if any(_rolls(robot, body) for body in standing_of(robot).feet):
        raise NotApplicableError("wheels roll on a slope")
    friction = float(robot.pairs.constants[robot.foot_rows, 1].min())
    slope_deg = min(SLOPE_DEG, float(np.degrees(np.arctan(SLOPE_PUSH * friction))))
    motion = _finite_hold(robot, slope_deg)
    feet_share = sum(motion.load_shares.get(b, 0.0) for b in standing_of(robot).feet)
    if not (0.7 < motion.height_ratio < 1.3 and feet_share > CARRIED_SHARE):
        raise NotMeasuredError("the robot falls on the slope")
    held_deg = np.degrees(np.arctan(friction))
    return Finding(
        value=motion.slip_mm_per_s,
        remark=f"{slope_deg:.3g} degrees, and friction {friction:.3g} holds up to {held_deg:.3g}",
    )


# --- joint by joint --------------------------------------------------------------------------------------------------

SWING_RAD = 0.1
"""Swing of a joint for which dry friction counts as damping [rad]."""

SOFT_MRAD = 1146.0
"""Sag up to which soft gains may be meant [mrad]."""

NO_ROTOR = "no driven joint of the model states the inertia of its rotor"

STEP_RAD, STEP_S = 0.3, 1.0
"""Step of a servo's command, and the time for which it is watched."""


@row("robot-lag")
def _lag(robot: Robot) -> Finding:
    low_ms, high_ms = limits_of("robot-lag")
    found, worst = Finding(declined=f"{NO_SERVO}, or have no room for a step"), 0.0
    armatures = robot.model.dof_armature[list(driven_dofs(robot))]
    limits_nm, inertias = loads_nm(robot), joint_inertias(robot)
    halves_ms: dict[int, float] = {}
    for actuator in position_servos(robot):
        dof = dof_of(robot, actuator)
        half_ms = 1e3 * lone_half_step_s(robot, actuator, dof)
        if not np.isfinite(half_ms):
            continue
        response = servo_responses(robot).get(dof)
        if response is None:
            # A gear of 0 leaves a servo without stiffness, which is a row of its own.
            continue
        halves_ms[dof] = half_ms
        ratio = max(low_ms / max(half_ms, 1e-9), half_ms / high_ms)
        is_bare = half_ms < low_ms and not armatures.any()
        if is_bare:
            # Advice hides no servo that is too slow.
            ratio = 1.0
        if ratio <= worst:
            continue
        worst, name = ratio, joint_name(robot, dof)
        text = response_text(*response)
        if half_ms < low_ms:
            text = f"{limits_nm[dof]:.3g} Nm turn {inertias[dof]:.2g} kg m^2"
        found = Finding(
            value=half_ms,
            remark=f"{name}: {text}",
            advisory=NO_ROTOR if is_bare else "",
        )
    return replace(found, parts=by_joint(robot, halves_ms))


@once
def servo_responses(robot: Robot) -> dict[int, tuple[float, float]]:
    """Return the damping ratio and the bandwidth [Hz] of the servos on each driven hinge, all others locked.

    Dry friction counts by the energy that it takes from a swing of 0.1 rad. The bandwidth is that of the angle at
    -3 dB, in closed form for a linear loop of second order.
    """
    model, inertias = robot.model, joint_inertias(robot)
    rates = model.dof_damping + servo_gains(model, 2)
    found = {}
    for dof in driven_dofs(robot):
        kp = stiffness(model, dof)
        if kp <= 0.0:
            continue
        natural_per_s = np.sqrt(kp / inertias[dof])
        dry = 2.0 * float(model.dof_frictionloss[dof]) / (np.pi * kp * SWING_RAD)
        ratio = 0.5 * float(rates[dof]) * natural_per_s / kp + dry
        flat = 1.0 - 2.0 * ratio**2
        band_hz = natural_per_s / (2.0 * np.pi) * np.sqrt(flat + np.hypot(flat, 1.0))
        found[dof] = (float(ratio), float(band_hz))
    return found


def response_text(ratio: float, band_hz: float) -> str:
    """Return a damping ratio and a bandwidth in words."""
    return f"damping ratio {ratio:.2g}, bandwidth {band_hz:.2g} Hz"


@row("robot-ringing")
def _ringing(robot: Robot) -> Finding:
    responses = servo_responses(robot)
    ratios = {dof: ratio for dof, (ratio, _) in responses.items()}
    if not ratios:
        return Finding(declined=NO_SERVO)
    dof = min(ratios, key=ratios.__getitem__)
    name = joint_name(robot, dof)
    return Finding(
        value=ratios[dof],
        parts=by_joint(robot, ratios),
        remark=f"{name}: {response_text(*responses[dof])}",
    )


@once
def lone_half_step_s(robot: Robot, actuator: int, dof: int) -> float:
    """Return the time in which a servo covers half of a step alone [s], at most 1 s; NaN without room."""
    alone = robot.without("contact", "gravity", "limit")
    # What a linkage couples to the joint moves with it.
    joint = int(alone.dof_jntid[dof])
    joints = coupled_joints(robot.model, joint)
    motors = {*joints_of_motors(robot.model).tolist()}
    passive = [one for one in loop_joints(robot.model, joint) if one not in motors]
    moves = np.isin(alone.dof_jntid, [*joints, *passive])
    alone.dof_armature[:] = np.where(moves, robot.model.dof_armature, 1e6)
    # Another servo of these joints would hold its own command.
    others = acts_on_joints(alone) & np.isin(alone.actuator_trnid[:, 0], joints)
    others[actuator] = False
    alone.actuator_gainprm[others] = alone.actuator_biasprm[others] = 0.0
    data = start(robot, alone)
    gain = float(alone.actuator_gainprm[actuator, 0])
    bias = alone.actuator_biasprm[actuator]
    if gain:
        # A keyframe may command another angle than the one it states.
        force = bias[0] + bias[1] * data.actuator_length[actuator]
        data.ctrl[actuator] = -force / gain
    return min(half_step_s(alone, data, actuator), STEP_S)


def half_step_s(model: mujoco.MjModel, data: mujoco.MjData, actuator: int) -> float:
    """Return the time in which a servo covers half of a step of 0.3 rad while the others hold [s].

    It is infinite where the servo does not get there in 1 s, and NaN where its joint or its command has no room.
    """
    joint = int(model.actuator_trnid[actuator, 0])
    place = int(model.jnt_qposadr[joint])
    gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator]
    gear = float(model.actuator_gear[actuator, 0])
    per_rad = -float(bias[1]) * gear / float(gain or np.nan)
    begin, command = float(data.qpos[place]), float(data.ctrl[actuator])
    is_free = not model.jnt_limited[joint] or switched_off(model, "limit")
    for sign in (1.0, -1.0):
        goal, ctrl = begin + sign * STEP_RAD, command + sign * STEP_RAD * per_rad
        low, high = model.jnt_range[joint]
        has_room = is_free or low <= goal <= high
        low, high = model.actuator_ctrlrange[actuator]
        if (
            has_room
            and np.isfinite(ctrl)
            and (not model.actuator_ctrllimited[actuator] or low <= ctrl <= high)
        ):
            break
    else:
        return np.nan
    data.ctrl[actuator] = ctrl
    moved = last = 0.0
    while data.time < STEP_S:
        mujoco.mj_step(model, data)
        last, moved = moved, sign * (float(data.qpos[place]) - begin)
        if moved >= 0.5 * STEP_RAD:
            over = (moved - 0.5 * STEP_RAD) / (moved - last)
            return float(data.time - over * model.opt.timestep)
    return np.inf


def deflecting_nm(robot: Robot) -> FloatArray:
    """Return the larger one of weight and spring that deflect the servo of each degree of freedom [Nm], shape [nv]."""
    model, loads = robot.model, largest_weights_nm(robot).copy()
    for dof in driven_dofs(robot):
        joint = int(model.dof_jntid[dof])
        ends = np.array([-1.0, 1.0])
        if model.jnt_limited[joint]:
            ends = model.jnt_range[joint] - model.qpos_spring[model.jnt_qposadr[joint]]
        spring_nm = float(springs(model)[joint] * np.abs(ends).max())
        loads[dof] = max(loads[dof], spring_nm)
    return loads


@row("robot-sag")
def _sag(robot: Robot) -> Finding:
    weights, gains = deflecting_nm(robot), servo_gains(robot.model, 1)
    sags = {
        dof: 1e3 * float(weights[dof] / gains[dof])
        for dof in driven_dofs(robot)
        if gains[dof] > 0.0 and weights[dof] > 0.0
    }
    if not sags:
        return Finding(declined=f"{NO_SERVO}, or carry no weight")
    dof = max(sags, key=sags.__getitem__)
    remark = (
        f"{joint_name(robot, dof)}: {weights[dof]:.3g} Nm with {gains[dof]:.3g} Nm/rad"
    )
    spring = float(springs(robot.model)[robot.model.dof_jntid[dof]])
    if weights[dof] > largest_weights_nm(robot)[dof]:
        return Finding(
            value=sags[dof],
            parts=by_joint(robot, sags),
            remark=f"{remark}, from a spring of {spring:.3g} Nm/rad",
        )
    low_mrad, high_mrad = limits_of("robot-sag")
    advisory = ""
    if sags[dof] < low_mrad:
        advisory = "a controller that knows its load does not sag"
    if sags[dof] > high_mrad:
        remark += f": a command must be {1e-3 * sags[dof]:.2g} rad beyond the pose that it holds"
        if robot.is_floating and sags[dof] < SOFT_MRAD:
            advisory = "soft gains of a robot that stands freely may be meant: its policy carries the weight"
    return Finding(
        value=sags[dof],
        parts=by_joint(robot, sags),
        remark=remark,
        advisory=advisory,
    )
