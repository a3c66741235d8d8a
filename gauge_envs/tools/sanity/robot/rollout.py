"""Run the target's own robot in its own settings: held where it stands, moving freely, and joint by joint."""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
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

NO_SERVO = (
    "no servos hold the robot: its torques come from a policy, or its servos from code"
)


@dataclass(frozen=True, kw_only=True)
class HoldMotion:
    """What a robot did while its servos held the pose in which it stands.

    Attributes:
        diverged_s: Time at which the state diverged [s]; infinite when it did not.
        height_ratio: Height of its first body above the ground at the end, over that at the start.
        load_shares: Share of the weight on each of its bodies that touch the ground, late in the motion.
        saturation: Largest mean torque over its limit, late in the motion.
        saturated_joint: Joint of that torque.
        slip_mm_per_s: Mean speed of its feet along the ground, late in the motion [mm/s].
    """

    diverged_s: float = np.inf
    height_ratio: float = 0.0
    load_shares: Mapping[int, float] = field(default_factory=dict)
    saturation: float = 0.0
    saturated_joint: str = ""
    slip_mm_per_s: float = 0.0


@cache
def hold_pose(robot: Robot, slope_deg: float = 0.0) -> HoldMotion:
    """Simulate a robot whose controls hold the pose in which it stands.

    Args:
        robot: The robot, which stands.
        slope_deg: Slope of the ground along x, made by turning gravity [degrees].
    """
    standing = standing_of(robot)
    model = copy.copy(robot.model)
    data = start(robot, model)
    gravity_m_per_s2 = float(np.linalg.norm(model.opt.gravity))
    up = np.asarray(robot.up)
    if slope_deg:
        # On a slope a, gravity is g (sin(a) along - cos(a) up) in the frame of the ground.
        slope_rad = np.radians(slope_deg)
        across = [0.0, 1.0, 0.0] if abs(up[1]) < 0.5 else [1.0, 0.0, 0.0]
        along = np.cross(across, up)
        model.opt.gravity[:] = gravity_m_per_s2 * (
            np.sin(slope_rad) * along - np.cos(slope_rad) * up
        )
    ground_m = min(float(point[2]) for point in standing.support_m.values())
    start_height_m = float(data.xpos[standing.body] @ up) - ground_m
    soles = [geoms[0] for geoms in standing.feet.values()]
    soles_before_m = np.zeros(3)
    torques_nm = np.zeros(model.nv)
    loads_n: dict[int, float] = {}
    steps = max(1, round(HOLD_S / model.opt.timestep))
    first_late = max(0, steps - round(LATE_S / model.opt.timestep))
    share = 1.0 / (steps - first_late)
    for step in range(steps):
        mujoco.mj_step(model, data)
        if (
            data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
            or not np.isfinite(data.qpos).all()
        ):
            return HoldMotion(diverged_s=(step + 1) * float(model.opt.timestep))
        if step == first_late:
            soles_before_m = data.geom_xpos[soles]
        if step >= first_late:
            torques_nm += np.abs(data.qfrc_actuator) / (steps - first_late)
            for body, load_n in _ground_loads_n(robot, data):
                loads_n[body] = loads_n.get(body, 0.0) + share * load_n
    limits_nm = torque_limits(model)
    is_limited = (limits_nm > 0.0) & np.isfinite(limits_nm)
    saturations = np.divide(
        torques_nm, limits_nm, out=np.zeros(model.nv), where=is_limited
    )
    dof = int(saturations.argmax()) if model.nv else 0
    weight_n = float(model.body_mass[robot.bodies].sum()) * gravity_m_per_s2
    end_height_m = float(data.xpos[standing.body] @ up) - ground_m
    slips_m = np.linalg.norm(data.geom_xpos[soles] - soles_before_m, axis=-1)
    return HoldMotion(
        height_ratio=end_height_m / max(start_height_m, 1e-6),
        load_shares={body: load_n / weight_n for body, load_n in loads_n.items()},
        saturation=float(saturations[dof]),
        saturated_joint=model.joint(int(model.dof_jntid[dof])).name,
        slip_mm_per_s=1e3 * float(slips_m.mean()) / LATE_S,
    )


def _ground_loads_n(robot: Robot, data: mujoco.MjData) -> Iterator[tuple[int, float]]:
    """Yield the body and the normal force [N] of each contact between a robot and the ground."""
    model, force = robot.model, np.zeros(6)
    for number in range(data.ncon):
        first, second = (
            int(model.geom_bodyid[geom]) for geom in data.contact[number].geom
        )
        for body, other in ((first, second), (second, first)):
            is_ground = (
                other not in robot.bodies
                and not model.body_dofnum[first_moving_body(model, other)]
            )
            if body in robot.bodies and is_ground:
                mujoco.mj_contactForce(model, data, number, force)
                yield body, float(force[0])


def _finite_hold(robot: Robot, slope_deg: float = 0.0) -> HoldMotion:
    """Return the motion of a robot that its servos hold; it does not apply without servos, or where it diverges."""
    standing_of(robot)
    if not servos(robot.model).any():
        raise NotApplicableError(NO_SERVO)
    motion = hold_pose(robot, slope_deg)
    if np.isfinite(motion.diverged_s):
        raise NotApplicableError(f"the state diverges at {motion.diverged_s:.3g} s")
    return motion


def _advisory(robot: Robot) -> str:
    count = 0 if robot.standing is None else len(robot.standing.feet)
    return (
        ""
        if count >= LEAST_FEET
        else f"a robot with {count} feet balances with a policy alone"
    )


@row("robot-holds")
def _finite(robot: Robot) -> Finding:
    diverged_s = hold_pose(robot).diverged_s
    if np.isinf(diverged_s):
        return Finding(value=1.0)
    return Finding(value=diverged_s / HOLD_S, remark=f"diverges at {diverged_s:.3g} s")


@row("robot-stands")
def _stands(robot: Robot) -> Finding:
    return Finding(
        value=max(_finite_hold(robot).height_ratio, 1e-3), advisory=_advisory(robot)
    )


@row("robot-loads")
def _loads(robot: Robot) -> Finding:
    shares, feet = _finite_hold(robot).load_shares, set(standing_of(robot).feet)
    idle = [body for body in feet if shares.get(body, 0.0) < 0.01]
    others = [
        body for body, share in shares.items() if body not in feet and share > 0.1
    ]
    text = ", ".join(
        f"{body_name(robot, body)} {share:.0%}"
        for body, share in sorted(shares.items())
    )
    return Finding(
        value=float(len(idle) + len(others)), remark=text, advisory=_advisory(robot)
    )


@row("robot-saturation")
def _saturation(robot: Robot) -> Finding:
    motion = _finite_hold(robot)
    return Finding(
        value=motion.saturation,
        remark=motion.saturated_joint,
        advisory=_advisory(robot),
    )


@row("robot-slip")
def _slip(robot: Robot) -> Finding:
    if not robot.foot_rows or _advisory(robot):
        return Finding(declined=_advisory(robot) or NOT_STANDING)
    friction = float(robot.pairs.constants[robot.foot_rows, 1].min())
    slope_deg = min(SLOPE_DEG, float(np.degrees(np.arctan(SLOPE_PUSH * friction))))
    motion = _finite_hold(robot, slope_deg)
    if not 0.7 < motion.height_ratio < 1.3:
        return Finding(declined="the robot falls on the slope")
    return Finding(
        value=motion.slip_mm_per_s,
        remark=f"{slope_deg:.3g} degrees, friction {friction:.3g}",
    )


@row("robot-overlap")
def _overlap(robot: Robot) -> Finding:
    standing_of(robot)
    model, data = robot.model, start(robot)
    deepest_m, names = 0.0, ""
    for number in range(data.ncon):
        contact = data.contact[number]
        pair = [int(model.geom_bodyid[geom]) for geom in contact.geom]
        if (
            set(pair) <= set(robot.bodies)
            and contact.exclude == 0
            and -contact.dist > deepest_m
        ):
            deepest_m = -float(contact.dist)
            names = " and ".join(body_name(robot, body) for body in pair)
    advice = f"exclude the pair {names}, or make its geoms smaller" if names else ""
    return Finding(value=1e3 * deepest_m, remark=names, advice=advice)


@row("robot-energy")
def _energy(robot: Robot) -> Finding:
    standing_of(robot)
    bare = without(
        robot.model,
        "contact",
        "actuation",
        "limit",
        "frictionloss",
        "damper",
        "equality",
    )
    bare.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data, values = start(robot, bare), []
    moving = slice(6 if robot.is_floating else 0, None)
    data.qvel[moving] = np.random.default_rng(0).uniform(-1.0, 1.0, len(data.qvel))[
        moving
    ]
    for _ in range(max(1, round(FREE_S / bare.opt.timestep))):
        mujoco.mj_step(bare, data)
        values.append(data.energy.copy())
    energies = np.asarray(values)
    largest = float(energies[:, 1].max())
    gained = float((energies.sum(axis=1) - energies[0].sum()).max())
    return Finding(
        value=gained / max(largest, 1e-9) if np.isfinite(energies).all() else np.inf
    )


# --- joint by joint --------------------------------------------------------------------------------------------------

STEP_RAD, STEP_S, FAIR_S = 0.3, 0.2, 0.0075
"""Step of a servo's command, the time for which it is watched, and the time of its half with changed gains."""


@cache
def _weights(robot: Robot) -> FloatArray:
    """Return the largest torque of gravity on each degree of freedom in random poses [Nm], shape [nv]."""
    poses = random_poses(robot.model, 64)
    return np.max(
        [np.abs(data.qfrc_bias - data.qfrc_gravcomp) for data in poses], axis=0
    )


@row("robot-dry")
def _dry(robot: Robot) -> Finding:
    bare = without(
        robot.model, "contact", "gravity", "limit", "equality", "actuation", "spring"
    )
    bare.opt.density = bare.opt.viscosity = 0.0
    data, loads, shares, losses = start(robot, bare), _weights(robot), {}, {}
    data.qacc[:] = 0.0
    for dof, _ in driven_dofs(robot):
        torques = []
        for rate in (3.0, 6.0):
            data.qvel[:] = rate * (np.arange(bare.nv) == dof)
            mujoco.mj_inverse(bare, data)
            torques.append(float(data.qfrc_inverse[dof]))
        dry, viscous = (
            max(2.0 * torques[0] - torques[1], 0.0),
            max((torques[1] - torques[0]) / 3.0, 0.0),
        )
        shares[dof] = dry / max(dry + viscous, 1e-12)
        # The least of measured joints: 5 % beside viscous friction, and 0.26 % of the weight of a bare bearing.
        losses[dof] = viscous / 19.0 + 0.0026 * max(loads[dof], 0.1 * loads.max(), 0.01)
    if not shares:
        return Finding(declined="no hinge of the robot is driven")
    worst, few = (
        min(shares, key=lambda dof: shares[dof]),
        [dof for dof in shares if shares[dof] < 0.01],
    )
    name = joint_name(robot, worst)
    bits = {
        "constraint": mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
        "frictionloss": mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS,
    }
    off = "".join(
        f'<flag {key}="enable"/> and '
        for key, bit in bits.items()
        if robot.model.opt.disableflags & bit
    )
    return Finding(
        value=shares[worst],
        remark=f"{name} and {len(few) - 1} more of {len(shares)}" if few else name,
        advice=f'{off}frictionloss="{losses[worst]:.2g}" or more for {name} and joints like it: `gauge recipe joint`',
        changes={f"dof_frictionloss[{dof}]": losses[dof] for dof in few},
    )


@row("robot-lag")
def _lag(robot: Robot) -> Finding:
    model, found, changes = (
        robot.model,
        Finding(declined=f"{NO_SERVO}, or have no room for a step"),
        {},
    )
    for dof, _ in driven_dofs(robot):
        for actuator in np.flatnonzero(
            servos(model) & (model.actuator_trnid[:, 0] == model.dof_jntid[dof])
        ):
            half_s = _half_step_s(robot, int(actuator), dof)
            scale = half_s / FAIR_S
            if scale < 1.0:
                changes[f"actuator_gainprm[{actuator}]"] = (
                    model.actuator_gainprm[actuator] * scale**2
                )
                powers = np.array([0, 2, 1] + [0] * 7)
                changes[f"actuator_biasprm[{actuator}]"] = (
                    model.actuator_biasprm[actuator] * scale**powers
                )
            if 1e3 * half_s < (np.inf if found.declined else found.value):
                gains, name = (
                    f"kp times {scale**2:.2g} and kv times {scale:.2g}",
                    joint_name(robot, dof),
                )
                advice = f"{gains} for {name} and servos like it, or their forcerange"
                found = Finding(value=1e3 * half_s, remark=name, advice=advice)
    return replace(found, changes=changes)


def _half_step_s(robot: Robot, actuator: int, dof: int) -> float:
    """Return the time in which a servo covers half of a step while all else stays [s]; infinite without room for it."""
    alone = without(robot.model, "contact", "gravity", "limit")
    alone.dof_armature[np.arange(alone.nv) != dof] = 1e6
    data, place = start(robot, alone), int(alone.jnt_qposadr[alone.dof_jntid[dof]])
    ratio = float(alone.actuator_biasprm[actuator, 1]) / float(
        alone.actuator_gainprm[actuator, 0] or np.nan
    )
    size, before = (
        abs(STEP_RAD * float(alone.actuator_gear[actuator, 0]) * ratio),
        float(data.ctrl[actuator]),
    )
    low, high = (
        alone.actuator_ctrlrange[actuator]
        if alone.actuator_ctrllimited[actuator]
        else (-np.inf, np.inf)
    )
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
    weights, gains = (
        _weights(robot),
        {dof: stiffness(robot.model, dof) for dof, _ in driven_dofs(robot)},
    )
    sags = {
        dof: 1e3 * float(weights[dof]) / gain
        for dof, gain in gains.items()
        if gain > 0.0 and weights[dof] > 0.0
    }
    if not sags:
        return Finding(declined=f"{NO_SERVO}, or carry no weight")
    dof = max(sags, key=lambda one: sags[one])
    remark = (
        f"{joint_name(robot, dof)}: {weights[dof]:.3g} Nm with {gains[dof]:.3g} Nm/rad"
    )
    return Finding(
        value=sags[dof],
        remark=remark,
        advisory="a controller that knows its load does not sag",
    )
