"""Judge what a command does to the joint of a motor."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    joint_name,
    limits_of,
    name_of,
    row,
)
from gauge_envs.tools.sanity.robot.joints import placed_bodies, servos, speed_servos
from gauge_envs.tools.sanity.robot.motor_names import swapped_motors
from gauge_envs.tools.sanity.robot.robot import Robot, acts_on_joints, tendon_joints

SAME_ANGLE = 0.05
"""Difference from 1 up to which a command counts as the angle of its joint."""

LOST_COMMANDS = 0.1
"""Part of the commands of a servo that must lie in the range of its joint, for the whole range to count as reached."""

MAYBE_SHARE = 0.4
"""What a joint counts that has two servos, or turns against its command: visible, as it can be so on purpose."""

UNEVEN, MIRRORED_REACH = 0.1, 0.9
"""Sum of the ends of a range over the range, and share of it that is reached, from which on commands mirror it."""


@row("robot-command")
def _command(robot: Robot) -> Finding:
    model = robot.model
    joints = model.actuator_trnid[:, 0]
    found: dict[str, Finding] = {}
    moved = set(robot.bodies) - set(placed_bodies(model))
    has_gain = model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED)
    for actuator in np.flatnonzero(acts_on_joints(model) & has_gain).tolist():
        joint = int(joints[actuator])
        if int(model.jnt_bodyid[joint]) in moved:
            name = joint_name(robot, int(model.jnt_dofadr[joint]))
            found.update((name, one) for one in _commands(robot, actuator, name))
    for actuator in _tendon_servos(robot):
        name = model.actuator(actuator).name or f"actuator {actuator}"
        found[name] = _pulled(robot, actuator, name)
    swapped, is_named = swapped_motors(model)
    for motor, joint in swapped.items():
        name = model.actuator(motor).name
        found[name] = Finding(
            # Another order than that of the joints can be on purpose.
            value=0.0 if is_named else MAYBE_SHARE,
            remark=f"{name} turns {name_of(robot, int(joints[motor]))}",
            advice=f"joint {name_of(robot, joint)} for {name}",
        )
    for motor in speed_servos(robot):
        name = name_of(robot, int(joints[motor]))
        found[name] = Finding(
            value=MAYBE_SHARE,
            remark=f"the servo of {name} takes a speed, and is commanded an angle",
            advice=f"a servo of position for {name}: -kp and -kv in biasprm",
        )
    if not found:
        return Finding(
            declined="no motor of the robot turns a joint, and no servo a fixed tendon"
        )
    worst = min(found.values(), key=lambda one: one.value)
    changes: dict[str, Any] = {}
    for one in found.values():
        changes |= one.changes
    parts = {name: one.value for name, one in found.items()}
    return replace(worst, parts=parts, changes=changes)


def _commands(robot: Robot, actuator: int, name: str) -> Iterator[Finding]:
    """Yield what a command does to the joint of an actuator; nothing for a motor with a gain."""
    model = robot.model
    gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator]
    kind = int(model.actuator_biastype[actuator])
    affine = int(mujoco.mjtBias.mjBIAS_AFFINE)
    is_servo = (model.actuator_biasprm[:, 1] < 0.0) & acts_on_joints(model)
    is_here = model.actuator_trnid[:, 0] == model.actuator_trnid[actuator, 0]
    others = np.flatnonzero(is_servo & is_here).tolist()
    per_control = float(gain * model.actuator_gear[actuator, 0])
    # Where no motor is a servo, one without stiffness is a motor, or its voltage.
    is_alone = not is_servo.any()
    away = np.array(bias)
    away[1] = -gain
    if len(others) > 1 and is_servo[actuator]:
        names = [model.actuator(one).name or f"actuator {one}" for one in others]
        yield Finding(
            value=MAYBE_SHARE,
            remark=f"{name} has {len(others)} servos: {', '.join(names)}",
            advice=f"one servo for each joint, unless two motors turn {name}",
        )
    elif kind == int(mujoco.mjtBias.mjBIAS_NONE) and bias[1] < 0.0:
        yield Finding(
            remark=f"the servo of {name} does not read its biasprm",
            advice=f'biastype="affine" for {name}',
            changes={f"actuator_biastype[{actuator}]": affine},
        )
    elif kind == affine and (bias[1] > 0.0 or (bias[1] == 0.0 and gain != -bias[2])):
        yield Finding(
            value=-np.inf if bias[1] else float(is_alone) * MAYBE_SHARE,
            remark=f"the servo of {name} does not pull it to its command",
            advice=f"-kp in biasprm of {name}",
            changes={f"actuator_biasprm[{actuator}]": away},
        )
    elif per_control == 0.0:
        yield Finding(
            remark=f"the motor of {name} has a gain or a gear of 0",
            advice=f"the gain and the gear of the motor of {name}",
        )
    elif per_control < 0.0:
        changes: dict[str, Any] = {}
        for attribute in ("gear", "gainprm"):
            numbers = np.array(getattr(model, f"actuator_{attribute}")[actuator])
            if numbers[0] < 0.0:
                numbers[0] *= -1.0
                changes[f"actuator_{attribute}[{actuator}]"] = numbers
        found = _reached(robot, actuator, name) if is_servo[actuator] else Finding()
        if _is_mirrored(robot, actuator, found.value):
            yield found
            return
        # A servo that is stable, or a motor, may be mounted the other way round.
        yield Finding(
            value=MAYBE_SHARE,
            remark=f"{name} turns against its command, with a gear and gain of {per_control:g}",
            advice=f"a positive gear and gain for {name}, unless its motor is mounted the other way round",
            changes=changes,
        )
    elif is_servo[actuator]:
        yield _reached(robot, actuator, name)
    else:
        yield Finding(value=1.0, remark=name)


def _is_mirrored(robot: Robot, actuator: int, share: float) -> bool:
    """Return whether the commands of a servo of the other sign have the mirror image of the range of its joint."""
    model = robot.model
    joint = int(model.actuator_trnid[actuator, 0])
    low, high = model.jnt_range[joint]
    is_limited = model.jnt_limited[joint] and model.actuator_ctrllimited[actuator]
    is_uneven = abs(low + high) > UNEVEN * (high - low)
    return bool(is_limited and is_uneven and share > MIRRORED_REACH)


def _reached(robot: Robot, actuator: int, name: str) -> Finding:
    """Return the part of a joint's range that the commands of its servo reach, infinite for none."""
    model = robot.model
    joint = int(model.actuator_trnid[actuator, 0])
    gain = float(model.actuator_gainprm[actuator, 0])
    bias = model.actuator_biasprm[actuator]
    gear = float(model.actuator_gear[actuator, 0])
    # Without load, gain * control + bias[0] + bias[1] * gear * angle is 0.
    per_control = -gain / (float(bias[1]) * gear)
    is_angle = abs(per_control - 1.0) < SAME_ANGLE
    zero = -float(bias[0]) / (float(bias[1]) * gear)
    if model.actuator_ctrllimited[actuator] and model.jnt_limited[joint]:
        ends = np.sort(zero + per_control * model.actuator_ctrlrange[actuator])
        low, high = model.jnt_range[joint]
        reached_rad = float(min(ends[1], high) - max(ends[0], low))
        # Of a range of commands that is far wider than the joint's, nearly all are lost.
        used = LOST_COMMANDS if is_angle else 1.0
        share = reached_rad / max(high - low, used * float(np.ptp(ends)))
        is_inside = reached_rad >= (1.0 - SAME_ANGLE) * float(np.ptp(ends)) > 0.0
    else:
        # Without limits of its command, a servo takes an angle.
        share = 1.0 if is_angle else min(per_control, 1.0 / per_control)
        is_inside = True
    if is_inside:
        # A part of the range, or another scale of commands, can be a choice.
        share = max(share, MAYBE_SHARE)
    found = Finding(value=share if share >= 0.0 else -np.inf, remark=name)
    if share >= limits_of("robot-command")[0]:
        return found
    if is_angle or zero != 0.0:
        ends = (model.jnt_range[joint] - zero) / per_control
        return replace(
            found,
            advice=f"the ctrlrange of {name} in the unit of its joint, or inheritrange",
            changes={f"actuator_ctrlrange[{actuator}]": ends},
        )
    key, advice = "biasprm", f"{gain:g} and {-gain:g} in gainprm and biasprm of {name}"
    row = np.array(bias)
    row[1] = -gain
    if abs(gear) != 1.0:
        key, advice = "gear", f"gear 1 for {name}, which its command passes too"
        row = np.sign(gear) * np.eye(6)[0]
    return replace(
        found,
        remark=f"a command of 1 turns {name} by {per_control:.3g} rad",
        advice=advice,
        changes={f"actuator_{key}[{actuator}]": row},
    )


def _tendon_servos(robot: Robot) -> list[int]:
    """Return servos with limits of their command on fixed tendons, all of whose joints have limits."""
    model = robot.model
    is_tendon = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)
    has_gain = model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED)
    is_servo = is_tendon & has_gain & servos(model) & (model.actuator_ctrllimited != 0)
    found = []
    for actuator in np.flatnonzero(is_servo).tolist():
        joints, _ = tendon_joints(model, int(model.actuator_trnid[actuator, 0]))
        is_own = np.isin(model.jnt_bodyid[joints], robot.bodies)
        if len(joints) and is_own.all() and model.jnt_limited[joints].all():
            found.append(actuator)
    return found


def _pulled(robot: Robot, actuator: int, name: str) -> Finding:
    """Return the part of the range of the joints of a fixed tendon that the commands of its servo reach."""
    model = robot.model
    joints, coefficients = tendon_joints(model, int(model.actuator_trnid[actuator, 0]))
    gear = float(model.actuator_gear[actuator, 0])
    gain = float(model.actuator_gainprm[actuator, 0])
    bias = model.actuator_biasprm[actuator]
    # Without load, gain * control + bias[0] + bias[1] * length is 0.
    commands = model.actuator_ctrlrange[actuator]
    lengths = np.sort(-(gain * commands + bias[0]) / bias[1])
    ends = gear * coefficients[:, None] * model.jnt_range[joints]
    share = _shared(ends, lengths)
    if share >= limits_of("robot-command")[0]:
        return Finding(value=share, remark=name)
    remark = f"the commands of {name} reach {100.0 * share:.3g} % of the range of the joints of its tendon"
    for place, joint in enumerate(joints.tolist()):
        turned = ends.copy()
        turned[place] *= -1.0
        if _shared(turned, lengths) >= MIRRORED_REACH:
            return Finding(
                value=share,
                remark=remark,
                advice=f"the other sign of the coefficient of {name_of(robot, joint)} in the tendon of {name}",
            )
    low, high = np.sort(ends, axis=1).sum(axis=0)
    changes: dict[str, Any] = {}
    if gain:
        reaching = -(bias[0] + bias[1] * np.array([low, high])) / gain
        # The sum makes 0 of -0.
        changes[f"actuator_ctrlrange[{actuator}]"] = np.sort(reaching) + 0.0
    return Finding(
        value=share,
        remark=remark,
        advice=f"a ctrlrange of {name} that fits its gain, or the gain that fits its ctrlrange",
        changes=changes,
    )


def _shared(ends: FloatArray, lengths: FloatArray) -> float:
    """Return the part of the range of a tendon, from the ends of its joints, shape [count, 2], that lengths reach."""
    low, high = np.sort(ends, axis=1).sum(axis=0)
    reached = float(min(lengths[1], high) - max(lengths[0], low))
    span = float(np.ptp(lengths))
    share = max(reached, 0.0) / max(high - low, LOST_COMMANDS * span, 1e-12)
    return max(share, MAYBE_SHARE) if reached >= span > 0.0 else share
