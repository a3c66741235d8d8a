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

LOADED_POSES = 64

STEP_RAD, STEP_S, FAIR_S = 0.3, 0.2, 0.0075
"""Step of a servo's command, the time for which it is watched, and the time of its half with changed gains."""

FROZEN_KG_M2 = 1e6
"""Armature of joints that stay while one moves."""


@cache
def _weights(robot: Robot) -> NDArray[np.float64]:
    """Return the largest torque of gravity on each degree of freedom in random poses [Nm], shape [nv]."""
    poses = random_poses(robot.model, LOADED_POSES)
    return np.asarray(np.max([np.abs(data.qfrc_bias - data.qfrc_gravcomp) for data in poses], axis=0))


@row("robot-dry")
def _dry(robot: Robot) -> Finding:
    bare = without(robot.model, "contact", "gravity", "limit", "equality", "actuation")
    bare.opt.density = bare.opt.viscosity = 0.0
    data, loads, shares, changes = start(robot, bare), _weights(robot), {}, {}

    def brake(dof: int, rate: float) -> float:
        """Return the torque that turns a joint at a rate [rad/s]; terms that do not change sign with it cancel."""
        torques = []
        for signed in (rate, -rate):
            data.qvel[:], data.qacc[:] = signed * (np.arange(bare.nv) == dof), 0.0
            mujoco.mj_inverse(bare, data)
            torques.append(float(data.qfrc_inverse[dof]))
        return 0.5 * (torques[0] - torques[1])

    for dof, _ in driven_dofs(robot):
        slow, fast = brake(dof, 3.0), brake(dof, 6.0)
        dry, viscous = max(2.0 * slow - fast, 0.0), max((fast - slow) / 3.0, 0.0)
        shares[dof] = dry / max(dry + viscous, 1e-12)
        if shares[dof] < 0.01:
            # The least of measured joints: 5 % beside viscous friction, and 0.26 % of the weight of a bare bearing.
            least = viscous / 19.0 + 0.0026 * max(loads[dof], 0.1 * loads.max(), 0.01)
            changes[f"dof_frictionloss[{dof}]"] = float(f"{least:.2g}")
    if not shares:
        return Finding(declined="no hinge of the robot is driven")
    worst = min(shares, key=lambda dof: shares[dof])
    least = f'frictionloss="{changes.get(f"dof_frictionloss[{worst}]", 0.0):.2g}" for {joint_name(robot, worst)}'
    return Finding(
        value=shares[worst],
        remark=f"{joint_name(robot, worst)}, and {len(changes) - 1} more of {len(shares)}" if len(changes) > 1 else "",
        advice=f"at least {least} and joints like it; `gauge recipe joint` fits it to a log",
        changes=changes,
    )


@row("robot-lag")
def _lag(robot: Robot) -> Finding:
    model, found, changes = robot.model, Finding(declined=f"{NO_SERVO}, or have no room for a step"), {}
    stiff = {dof for dof, _ in driven_dofs(robot) if stiffness(model, dof) > 0.0}
    for actuator in np.flatnonzero(servos(model) & (model.actuator_gainprm[:, 0] != 0.0)):
        dof = int(model.jnt_dofadr[model.actuator_trnid[actuator, 0]])
        if dof not in stiff:
            continue
        taken_s = _half_step_s(robot, int(actuator), dof)
        if taken_s is not None and taken_s < FAIR_S:
            scale = taken_s / FAIR_S
            gains = {"gainprm": (scale**2, 1.0, 1.0), "biasprm": (1.0, scale**2, scale)}
            for name, factors in gains.items():
                values = getattr(model, f"actuator_{name}")[actuator].copy()
                values[:3] *= factors
                changes[f"actuator_{name}[{actuator}]"] = values
        if taken_s is not None and (found.declined or 1e3 * taken_s < found.value):
            scale, name = min(taken_s / FAIR_S, 1.0), joint_name(robot, dof)
            advice = f"kp times {scale**2:.2g} and kv times {scale:.2g} for {name} and servos like it"
            found = Finding(value=1e3 * taken_s, remark=name, advice=f"{advice}, or their forcerange")
    return replace(found, changes=changes)


def _half_step_s(robot: Robot, actuator: int, dof: int) -> float | None:
    """Return the time in which a servo covers half of a step while all else stays [s]; None without room for it."""
    alone = without(robot.model, "contact", "gravity", "limit")
    alone.dof_armature[np.arange(alone.nv) != dof] = FROZEN_KG_M2
    data, place = start(robot, alone), int(alone.jnt_qposadr[alone.dof_jntid[dof]])
    gain, bias = alone.actuator_gainprm[actuator, 0], alone.actuator_biasprm[actuator, 1]
    size, before = abs(STEP_RAD * alone.actuator_gear[actuator, 0] * bias / gain), float(data.ctrl[actuator])
    low, high = alone.actuator_ctrlrange[actuator] if alone.actuator_ctrllimited[actuator] else (-np.inf, np.inf)
    if size > max(high - before, before - low):
        return None
    data.ctrl[actuator] += size if high - before >= size else -size
    begin, moved = float(data.qpos[place]), 0.0
    for count in range(1, max(2, round(STEP_S / alone.opt.timestep))):
        mujoco.mj_step(alone, data)
        last, moved = moved, abs(float(data.qpos[place]) - begin)
        if moved >= 0.5 * STEP_RAD:
            return float((count - (moved - 0.5 * STEP_RAD) / (moved - last)) * alone.opt.timestep)
    return STEP_S


@row("robot-sag")
def _sag(robot: Robot) -> Finding:
    weights, gains = _weights(robot), {dof: stiffness(robot.model, dof) for dof, _ in driven_dofs(robot)}
    sags = {dof: float(weights[dof]) / gain for dof, gain in gains.items() if gain > 0.0 and weights[dof] > 0.0}
    if not sags:
        return Finding(declined=f"{NO_SERVO}, or carry no weight")
    dof = max(sags, key=lambda one: sags[one])
    return Finding(
        value=1e3 * sags[dof],
        remark=f"{joint_name(robot, dof)}: {weights[dof]:.3g} Nm with {gains[dof]:.3g} Nm/rad",
        advisory="a controller with an integral part, or one that knows its load, does not sag",
    )
