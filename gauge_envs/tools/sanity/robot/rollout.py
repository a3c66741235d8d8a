"""Run the target's own robot in its own settings: held where it stands, moving freely, and joint by joint."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.sanity.robot.model_rows import (
    NOT_STANDING,
    Finding,
    NotApplicableError,
    body_name,
    driven_dofs,
    joint_name,
    row,
    servos,
    standing_of,
    start,
    stiffness,
    torque_limits,
    without,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import first_moving_body
from gauge_envs.tools.sanity.robot.robot import Robot, random_poses

HOLD_S, LATE_S = 2.0, 0.5
"""Time for which the robot is held [s], and its end, in which loads and torques are read."""

FREE_S = 1.0
"""Time in which energy is read [s]."""

SLOPE_DEG, SLOPE_PUSH = 10.0, 0.7
"""Slope on which feet stand [degrees], and the largest push, over what their friction holds."""

LEAST_FEET = 3
"""Feet on which a robot stands without a policy."""

NO_SERVO = "no servos hold the robot: its torques come from a policy, or its servos from code"


@dataclass(frozen=True, kw_only=True)
class Held:
    """What a robot did while its servos held it.

    Attributes:
        diverged_s: Time at which the state diverged [s]; infinite when it did not.
        height: Height of its first body above the ground at the end, over that at the start.
        loads: Share of the weight on each of its bodies that touch the ground, late in the motion.
        saturation: Largest torque over its limit, late in the motion, and its joint.
        slip_mm_per_s: Mean speed of its feet along the ground, late in the motion [mm/s].
    """

    diverged_s: float
    height: float = 0.0
    loads: Mapping[int, float] = field(default_factory=dict)
    saturation: tuple[float, str] = (0.0, "")
    slip_mm_per_s: float = 0.0


@cache
def held(robot: Robot, slope_deg: float = 0.0) -> Held:
    """Return what a robot does while the controls of its pose hold it.

    Args:
        robot: The robot, which stands.
        slope_deg: Slope of the ground along x, made by turning gravity [degrees].
    """
    model, data, standing = robot.model, start(robot), standing_of(robot)
    gravity, body = model.opt.gravity.copy(), standing.body
    slope, size = np.radians(slope_deg), float(np.linalg.norm(gravity))
    up, bodies = np.asarray(robot.up), set(robot.bodies)
    along = np.cross([0.0, 1.0, 0.0] if abs(up[1]) < 0.5 else [1.0, 0.0, 0.0], up)
    model.opt.gravity[:] = size * (np.sin(slope) * along - np.cos(slope) * up) if slope_deg else gravity
    # The height of the soles.
    ground = min(float(point[2]) for point in standing.support_m.values())
    first = float(data.xpos[body] @ up) - ground
    steps, limits = max(1, round(HOLD_S / model.opt.timestep)), torque_limits(model)
    late = max(0, steps - round(LATE_S / model.opt.timestep))
    loads: dict[int, float] = {}
    torques, before = np.zeros(model.nv), np.zeros(3)
    soles = [geoms[0] for geoms in standing.feet.values()]
    try:
        for step in range(steps):
            mujoco.mj_step(model, data)
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
                return Held(diverged_s=(step + 1) * float(model.opt.timestep))
            if step == late:
                before = data.geom_xpos[soles]
            if step >= late:
                torques += np.abs(data.qfrc_actuator) / (steps - late)
                _add_loads(robot, data, loads, bodies, 1.0 / (steps - late))
    finally:
        model.opt.gravity[:] = gravity
    ratio = np.divide(torques, limits, out=np.zeros(model.nv), where=(limits > 0.0) & np.isfinite(limits))
    dof = int(ratio.argmax()) if model.nv else 0
    weight = float(model.body_mass[robot.bodies].sum()) * size
    return Held(
        diverged_s=np.inf,
        height=(float(data.xpos[body] @ up) - ground) / max(first, 1e-6),
        loads={one: load / weight for one, load in loads.items()},
        saturation=(float(ratio[dof]), model.joint(int(model.dof_jntid[dof])).name),
        slip_mm_per_s=1e3 * float(np.linalg.norm(data.geom_xpos[soles] - before, axis=-1).mean()) / LATE_S,
    )


def _add_loads(robot: Robot, data: mujoco.MjData, loads: dict[int, float], bodies: set[int], share: float) -> None:
    """Add the normal forces of the ground on the bodies of a robot [N], times a share."""
    model, force = robot.model, np.zeros(6)
    for number in range(data.ncon):
        pair = [int(model.geom_bodyid[geom]) for geom in data.contact[number].geom]
        own = [body for body in pair if body in bodies]
        if len(own) == 1 and not model.body_dofnum[first_moving_body(model, sum(pair) - own[0])]:
            mujoco.mj_contactForce(model, data, number, force)
            loads[own[0]] = loads.get(own[0], 0.0) + share * float(force[0])


def _held(robot: Robot, slope_deg: float = 0.0) -> Held:
    """Return the motion of a robot that its servos hold."""
    standing_of(robot)
    if not servos(robot.model).any():
        raise NotApplicableError(NO_SERVO)
    found = held(robot, slope_deg)
    if np.isfinite(found.diverged_s):
        raise NotApplicableError(f"the state diverges at {found.diverged_s:.3g} s")
    return found


def _advisory(robot: Robot) -> str:
    count = 0 if robot.standing is None else len(robot.standing.feet)
    return "" if count >= LEAST_FEET else f"a robot with {count} feet balances with a policy alone"


@row("robot-holds")
def _finite(robot: Robot) -> Finding:
    until = held(robot).diverged_s
    if np.isinf(until):
        return Finding(value=1.0)
    return Finding(value=until / HOLD_S, remark=f"diverges at {until:.3g} s")


@row("robot-stands")
def _stands(robot: Robot) -> Finding:
    return Finding(value=max(_held(robot).height, 1e-3), advisory=_advisory(robot))


@row("robot-loads")
def _loads(robot: Robot) -> Finding:
    loads, feet = _held(robot).loads, set(standing_of(robot).feet)
    idle = [body for body in feet if loads.get(body, 0.0) < 0.01]
    other = {body: load for body, load in loads.items() if body not in feet and load > 0.1}
    shares = ", ".join(f"{body_name(robot, body)} {load:.0%}" for body, load in sorted(loads.items()))
    return Finding(value=float(len(idle) + len(other)), remark=shares, advisory=_advisory(robot))


@row("robot-saturation")
def _saturation(robot: Robot) -> Finding:
    value, joint = _held(robot).saturation
    return Finding(value=value, remark=joint, advisory=_advisory(robot))


@row("robot-slip")
def _slip(robot: Robot) -> Finding:
    if not robot.foot_rows or _advisory(robot):
        return Finding(declined=_advisory(robot) or NOT_STANDING)
    friction = float(robot.pairs.constants[robot.foot_rows, 1].min())
    slope = min(SLOPE_DEG, float(np.degrees(np.arctan(SLOPE_PUSH * friction))))
    found = _held(robot, slope)
    if not 0.7 < found.height < 1.3:
        return Finding(declined="the robot falls on the slope")
    return Finding(value=found.slip_mm_per_s, remark=f"{slope:.3g} degrees, friction {friction:.3g}")


@row("robot-overlap")
def _overlap(robot: Robot) -> Finding:
    standing_of(robot)
    model, data, bodies = robot.model, start(robot), set(robot.bodies)
    deepest, names = 0.0, ""
    for number in range(data.ncon):
        contact = data.contact[number]
        pair = [int(model.geom_bodyid[geom]) for geom in contact.geom]
        if set(pair) <= bodies and contact.exclude == 0 and -contact.dist > deepest:
            deepest, names = -float(contact.dist), " and ".join(body_name(robot, body) for body in pair)
    return Finding(
        value=1e3 * deepest,
        remark=names,
        advice=f"exclude the pair {names}, or make its geoms smaller" if names else "",
    )


@row("robot-energy")
def _energy(robot: Robot) -> Finding:
    standing_of(robot)
    bare = without(robot.model, "contact", "actuation", "limit", "frictionloss", "damper", "equality")
    bare.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data, values = start(robot, bare), []
    moving = slice(6 if robot.is_floating else 0, None)
    data.qvel[moving] = np.random.default_rng(0).uniform(-1.0, 1.0, len(data.qvel))[moving]
    for _ in range(max(1, round(FREE_S / bare.opt.timestep))):
        mujoco.mj_step(bare, data)
        values.append(data.energy.copy())
    energies = np.asarray(values)
    largest = float(energies[:, 1].max())
    gained = float((energies.sum(axis=1) - energies[0].sum()).max())
    return Finding(value=gained / max(largest, 1e-9) if np.isfinite(energies).all() else np.inf)


# --- joint by joint --------------------------------------------------------------------------------------------------

STEP_RAD, STEP_S, FAIR_S = 0.3, 0.2, 0.0075
"""Step of a servo's command, the time for which it is watched, and the time of its half with changed gains."""


@cache
def _weights(robot: Robot) -> NDArray[np.float64]:
    """Return the largest torque of gravity on each degree of freedom in random poses [Nm], shape [nv]."""
    poses = random_poses(robot.model, 64)
    return np.asarray(np.max([np.abs(data.qfrc_bias - data.qfrc_gravcomp) for data in poses], axis=0))


@row("robot-dry")
def _dry(robot: Robot) -> Finding:
    bare = without(robot.model, "contact", "gravity", "limit", "equality", "actuation", "spring")
    bare.opt.density = bare.opt.viscosity = 0.0
    data, loads, shares, losses = start(robot, bare), _weights(robot), {}, {}
    data.qacc[:] = 0.0
    for dof, _ in driven_dofs(robot):
        torques = []
        for rate in (3.0, 6.0):
            data.qvel[:] = rate * (np.arange(bare.nv) == dof)
            mujoco.mj_inverse(bare, data)
            torques.append(float(data.qfrc_inverse[dof]))
        dry, viscous = max(2.0 * torques[0] - torques[1], 0.0), max((torques[1] - torques[0]) / 3.0, 0.0)
        shares[dof] = dry / max(dry + viscous, 1e-12)
        # The least of measured joints: 5 % beside viscous friction, and 0.26 % of the weight of a bare bearing.
        losses[dof] = viscous / 19.0 + 0.0026 * max(loads[dof], 0.1 * loads.max(), 0.01)
    if not shares:
        return Finding(declined="no hinge of the robot is driven")
    worst, few = min(shares, key=lambda dof: shares[dof]), [dof for dof in shares if shares[dof] < 0.01]
    name = joint_name(robot, worst)
    bits = {
        "constraint": mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
        "frictionloss": mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS,
    }
    off = "".join(f'<flag {key}="enable"/> and ' for key, bit in bits.items() if robot.model.opt.disableflags & bit)
    return Finding(
        value=shares[worst],
        remark=f"{name} and {len(few) - 1} more of {len(shares)}" if few else name,
        advice=f'{off}frictionloss="{losses[worst]:.2g}" or more for {name} and joints like it: `gauge recipe joint`',
        changes={f"dof_frictionloss[{dof}]": losses[dof] for dof in few},
    )


@row("robot-lag")
def _lag(robot: Robot) -> Finding:
    model, found, changes = robot.model, Finding(declined=f"{NO_SERVO}, or have no room for a step"), {}
    for dof, _ in driven_dofs(robot):
        for actuator in np.flatnonzero(servos(model) & (model.actuator_trnid[:, 0] == model.dof_jntid[dof])):
            half_s = _half_step_s(robot, int(actuator), dof)
            scale = half_s / FAIR_S
            if scale < 1.0:
                changes[f"actuator_gainprm[{actuator}]"] = model.actuator_gainprm[actuator] * scale**2
                powers = np.array([0, 2, 1] + [0] * 7)
                changes[f"actuator_biasprm[{actuator}]"] = model.actuator_biasprm[actuator] * scale**powers
            if 1e3 * half_s < (np.inf if found.declined else found.value):
                gains, name = f"kp times {scale**2:.2g} and kv times {scale:.2g}", joint_name(robot, dof)
                advice = f"{gains} for {name} and servos like it, or their forcerange"
                found = Finding(value=1e3 * half_s, remark=name, advice=advice)
    return replace(found, changes=changes)


def _half_step_s(robot: Robot, actuator: int, dof: int) -> float:
    """Return the time in which a servo covers half of a step while all else stays [s]; infinite without room for it."""
    alone = without(robot.model, "contact", "gravity", "limit")
    alone.dof_armature[np.arange(alone.nv) != dof] = 1e6
    data, place = start(robot, alone), int(alone.jnt_qposadr[alone.dof_jntid[dof]])
    ratio = float(alone.actuator_biasprm[actuator, 1]) / float(alone.actuator_gainprm[actuator, 0] or np.nan)
    size, before = abs(STEP_RAD * float(alone.actuator_gear[actuator, 0]) * ratio), float(data.ctrl[actuator])
    low, high = alone.actuator_ctrlrange[actuator] if alone.actuator_ctrllimited[actuator] else (-np.inf, np.inf)
    if not size <= max(high - before, before - low):
        return np.inf
    data.ctrl[actuator] += size if high - before >= size else -size
    begin, moved, last = float(data.qpos[place]), 0.0, 0.0
    while moved < 0.5 * STEP_RAD and data.time < STEP_S:
        mujoco.mj_step(alone, data)
        last, moved = moved, abs(float(data.qpos[place]) - begin)
    over = max(moved - 0.5 * STEP_RAD, 0.0) / max(moved - last, 1e-12)
    return float(data.time - over * alone.opt.timestep)


@row("robot-sag")
def _sag(robot: Robot) -> Finding:
    weights, gains = _weights(robot), {dof: stiffness(robot.model, dof) for dof, _ in driven_dofs(robot)}
    sags = {dof: 1e3 * float(weights[dof]) / gain for dof, gain in gains.items() if gain > 0.0 and weights[dof] > 0.0}
    if not sags:
        return Finding(declined=f"{NO_SERVO}, or carry no weight")
    dof = max(sags, key=lambda one: sags[one])
    remark = f"{joint_name(robot, dof)}: {weights[dof]:.3g} Nm with {gains[dof]:.3g} Nm/rad"
    return Finding(value=sags[dof], remark=remark, advisory="a controller that knows its load does not sag")
