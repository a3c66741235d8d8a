"""Judge what drives and brakes the joints of a model."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    by_joint,
    first_joints,
    joint_name,
    limits_of,
    name_of,
    of_elements,
    row,
)
from gauge_envs.tools.sanity.robot.joints import (
    FEW_JOINTS,
    drags_nm,
    driven_dofs,
    driven_joints,
    growth,
    joint_inertias,
    largest_weights_nm,
    loads_nm,
    motor_limits,
    one_sided,
    servo_gains,
    servos,
    start,
    stiffness,
    undriven,
)
from gauge_envs.tools.sanity.robot.legs import bent_legs_nm
from gauge_envs.tools.sanity.robot.mass_rows import size_m
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    coupled_pairs,
    enabling,
    switched_off,
)

LEAST_RAD_PER_S2, FAIR_RAD_PER_S2 = 100.0, 1000.0
"""Acceleration that the largest torque gives to the armature alone [rad/s^2]: least and middle of makers' models."""

MOST_RAD_PER_S2 = 1e5
"""The largest one: twice that of makers' models, and that of the bare rotor of a servo motor [rad/s^2]."""

LEAST_ROTOR = 0.0025
"""Armature over the inertia that it turns with, below which a gear is lost: a quarter of the least of makers."""

MOST_TIMES = 10.0
"""Torque of a motor over the weight of its robot at its size, or over the joint's own limit: makers' are up to 4.2."""

EXCEPTIONS_SHARE = 0.25
"""Share of joints without a largest torque or a rotor up to which they are exceptions: makers leave it out in more."""

FULL_ACTION_RAD_PER_S = 3.0
"""Speed of a joint below which a leg cannot step: half a radian in a swing of 0.2 s is 2.5 rad/s."""


@row("robot-servo")
def _servo(robot: Robot) -> Finding:
    model = robot.model
    if not model.nv or not (
        servos(model).any() or model.dof_damping.any() or model.jnt_stiffness.any()
    ):
        return Finding(declined="no joint has a servo, damping or stiffness")
    value = growth(robot)
    if value <= limits_of("robot-servo")[1]:
        return Finding(value=value)
    is_explicit = model.opt.integrator != mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option = '<option integrator="implicitfast"/>, ' if is_explicit else ""
    return Finding(
        value=value,
        remark=f"step {model.opt.timestep:g} s",
        advice=f"the armature of rotors and gears, {option}a shorter step, or smaller gains",
    )


@row("robot-torque")
def _torque(robot: Robot) -> Finding:
    driven = driven_dofs(robot)
    limits_nm = {dof: limit for dof, limit in driven.items() if np.isfinite(limit)}
    if not driven:
        return Finding(declined="no hinge of the robot is driven")
    if idle := undriven(robot):
        names = first_joints(robot, idle)
        several = f"{names}: {len(idle)} of {len(driven) + len(idle)} joints"
        return Finding(
            parts=by_joint(robot, dict.fromkeys(idle, 0.0)),
            remark=f"{several} have no actuator",
            # A finger without one has a twin that a motor moves; a hinge can be passive on purpose.
            is_usual=not joints_of(robot.model, "SLIDE")[
                robot.model.dof_jntid[idle]
            ].any(),
            advice=f"an actuator for {names}",
        )
    if single := one_sided(robot):
        names = first_joints(robot, list(single))
        return Finding(
            parts=by_joint(robot, dict.fromkeys(single, 0.0)),
            remark=f"{names}: {len(single)} motors turn one way only",
            is_usual=True,
            advice=f"a forcerange of both signs for {names}",
        )
    if strong := _too_strong(robot, limits_nm):
        return strong
    at_start = robot.is_floating
    bias_nm = np.abs(start(robot).qfrc_bias) if at_start else largest_weights_nm(robot)
    if at_start:
        bias_nm = np.maximum(bias_nm, bent_legs_nm(robot))
    weights_nm = {dof: float(bias_nm[dof]) for dof in limits_nm}
    ratios = {
        dof: min(limit / max(weights_nm[dof], 1e-3), 1e6)
        for dof, limit in limits_nm.items()
    }
    unlimited = [dof for dof in driven if dof not in limits_nm]
    if unlimited and min(ratios.values(), default=1.0) >= 1.0:
        names = first_joints(robot, unlimited)
        is_common = len(unlimited) > EXCEPTIONS_SHARE * len(driven)
        return Finding(
            value=np.inf,
            parts=by_joint(robot, ratios | dict.fromkeys(unlimited, np.inf)),
            remark=f"{names}: {len(unlimited)} of {len(driven)} driven joints state no largest torque",
            is_usual=True,
            advice=f"the forcerange of {names}, from the data sheet of the motor and gear",
            advisory="joints of the model state no limit of their torque"
            if is_common
            else "",
        )
    weakest = min(ratios, key=ratios.__getitem__)
    fair_nm = 2.0 * weights_nm[weakest]
    joint = joint_name(robot, weakest)
    return Finding(
        value=ratios[weakest],
        parts=by_joint(robot, ratios),
        remark=f"{joint}: {limits_nm[weakest]:.3g} Nm against {weights_nm[weakest]:.3g} Nm",
        advice=f"a forcerange of {joint} and joints like it from {fair_nm:.2g} Nm on",
        # A robot on the ground carries its weight; one on a base need never be in its heaviest pose.
        is_usual=not at_start,
    )


def _too_strong(robot: Robot, limits_nm: Mapping[int, float]) -> Finding | None:
    """Return the motors that are far stronger than their robot or their joint needs; None without any."""
    motors_nm = motor_limits(robot.model)
    # A robot without a shape has no size to compare with.
    lifts_nm = robot.mass_kg * GRAVITY_M_PER_S2 * size_m(robot) or np.inf
    times: dict[int, float] = {}
    for dof, limit_nm in limits_nm.items():
        ratio = float(motors_nm[dof]) / min(lifts_nm, limit_nm)
        if MOST_TIMES < ratio < np.inf:
            times[dof] = ratio
    if not times:
        return None
    worst = max(times, key=times.__getitem__)
    needed = "what lifts the robot by an arm of its size"
    if limits_nm[worst] < lifts_nm:
        needed = "the torque that the joint allows"
    names = first_joints(robot, list(times))
    return Finding(
        value=np.inf,
        parts=by_joint(robot, dict.fromkeys(times, np.inf)),
        remark=f"{names}: motors of {len(times)} of {len(driven_dofs(robot))} driven joints have up to "
        f"{times[worst]:.2g} times {needed}, {motors_nm[worst]:.3g} Nm",
        advice=f"the gear and the forcerange of {names} in Nm",
        is_usual=True,
    )


@row("robot-stiffness")
def _stiffness(robot: Robot) -> Finding:
    errors_mrad = {
        dof: 1e3 * limit_nm / stiffness(robot.model, dof)
        for dof, limit_nm in driven_dofs(robot).items()
        if np.isfinite(limit_nm) and stiffness(robot.model, dof) > 0.0
    }
    if not errors_mrad:
        return Finding(
            declined="no joint has a servo and states the limit of its torque"
        )
    dof = min(errors_mrad, key=errors_mrad.__getitem__)
    name, gain = joint_name(robot, dof), stiffness(robot.model, dof)
    return Finding(
        value=errors_mrad[dof],
        parts=by_joint(robot, errors_mrad),
        remark=f"{name}: kp {gain:.3g} Nm/rad",
        advice=f"kp of {name} and joints like it in Nm/rad, not per degree or in N mm: "
        f"at most {gain * errors_mrad[dof] / 20.0:.3g}",
    )


@row("robot-action")
def _action(robot: Robot) -> Finding:
    scale, model = robot.action_rad, robot.model
    if scale is None:
        return Finding(declined="the task states no scale of its actions")
    shares = {
        dof: scale * stiffness(model, dof) / limit
        for dof, limit in driven_dofs(robot).items()
        if np.isfinite(limit)
    }
    if not any(shares.values()):
        return Finding(
            declined="no servo of a robot that stands states the limit of its torque"
        )
    # A scale in other units moves all joints; single ones, such as necks, have weak motors.
    dof = sorted(shares, key=shares.__getitem__)[len(shares) // 2]
    return Finding(
        value=shares[dof],
        remark=f"{joint_name(robot, dof)}: {scale:g} rad with {stiffness(model, dof):.3g} Nm/rad",
        advice=f"an action scale of about {0.5 * scale / shares[dof]:.2g} rad, which asks for half of the torque",
    )


@row("robot-delay")
def _delay(robot: Robot) -> Finding:
    model = robot.model
    filters = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
    filtered = np.flatnonzero(np.isin(model.actuator_dyntype, filters)).tolist()
    filters_s = {
        model.actuator(one).name or f"actuator {one}": float(
            model.actuator_dynprm[one, 0]
        )
        for one in filtered
    }
    if robot.delay_s is None and not filters_s:
        return Finding(declined="neither the task nor an actuator states a delay")
    slowest = max(filters_s, key=filters_s.__getitem__, default="")
    filter_s = filters_s.get(slowest, 0.0)
    return Finding(
        value=1e3 * ((robot.delay_s or 0.0) + filter_s),
        parts={name: 1e3 * one for name, one in filters_s.items()},
        remark=f"{slowest}: a filter with a time constant of {filter_s:.3g} s"
        if filter_s
        else "",
        advice="delays of at most 50 ms from the observation to the torque",
    )


def _drag(
    robot: Robot, name: str, share: Callable[[int, float], float], spare: float
) -> Finding:
    """Return the driven joint with the largest share of its torque; the advice leaves a part of the limit to spare."""
    model, values = robot.model, getattr(robot.model, f"dof_{name}")
    is_own = np.isin(model.dof_bodyid, robot.bodies)
    feeding = np.flatnonzero(is_own & (values < 0.0)).tolist()
    if feeding:
        least = min(feeding, key=lambda dof: float(values[dof]))
        several = f"{joint_name(robot, least)} and {len(feeding) - 1} more"
        return Finding(
            value=float(values[least]),
            parts=by_joint(robot, {dof: values[dof] for dof in feeding}),
            remark=f"negative {name} {values[least]:.3g} of {several}: it feeds the motion that it should brake",
            advice=f"positive {name} for {several}",
            changes=of_elements(f"dof_{name}", {d: -float(values[d]) for d in feeding}),
        )
    limits = loads_nm(robot)
    if not limits:
        return Finding(
            declined="no joint states the limit of its torque, or has a servo"
        )
    shares = {dof: share(dof, limit) for dof, limit in limits.items()}
    fair = {d: float(values[d]) / max(spare * shares[d], 1.0) for d in limits}
    worst = max(shares, key=shares.__getitem__)
    remark = f"{joint_name(robot, worst)}: {name} {values[worst]:.3g} with {limits[worst]:.3g} Nm"
    if name == "damping" and values[worst] > 0.0:
        fastest_rad_per_s = limits[worst] / float(values[worst])
        remark += f", which turn it by at most {fastest_rad_per_s:.2g} rad/s"
    is_stated = np.isfinite(driven_dofs(robot)[worst])
    strength = "largest torque in Nm" if is_stated else "kp, which its torque follows"
    return Finding(
        value=shares[worst],
        parts=by_joint(robot, shares),
        remark=remark,
        advice=f'{name}="{fair[worst]:.2g}" for {joint_name(robot, worst)} and joints like it, '
        f"or its {strength}",
        # Of dry friction at the largest torque nothing moves; how fast a joint should turn is another matter.
        is_usual=name == "damping" or shares[worst] < 1.0,
        changes=of_elements(
            f"dof_{name}", {dof: one for dof, one in fair.items() if one < values[dof]}
        ),
    )


@row("robot-damping")
def _damping(robot: Robot) -> Finding:
    damping = robot.model.dof_damping
    rates = {
        dof: float(damping[dof] + servo_gains(robot.model, 2)[dof])
        for dof in driven_dofs(robot)
    }
    feeding = {dof: one for dof, one in rates.items() if one < 0.0 <= damping[dof]}
    if feeding:
        worst = min(feeding, key=feeding.__getitem__)
        name = joint_name(robot, worst)
        return Finding(
            value=feeding[worst],
            parts=by_joint(robot, feeding),
            remark=f"the servo of {name} feeds the motion that it should brake, by {feeding[worst]:.3g} Nm s",
            advice=f"a positive kv for {name}",
        )
    return _drag(
        robot,
        "damping",
        lambda dof, limit: FULL_ACTION_RAD_PER_S * float(damping[dof]) / limit,
        4.0,
    )


@row("robot-frictionloss")
def _frictionloss(robot: Robot) -> Finding:
    drags = drags_nm(robot)
    return _drag(robot, "frictionloss", lambda dof, limit: drags[dof][0] / limit, 20.0)


@row("robot-armature")
def _armature(robot: Robot) -> Finding:
    model, found, changes = robot.model, Finding(), {}
    ratios: dict[int, float] = {}
    inertias = joint_inertias(robot)
    loads = loads_nm(robot)
    rates = [
        load / model.dof_armature[dof]
        for dof, load in loads.items()
        if model.dof_armature[dof] > 0.0
    ]
    middle_rad_per_s2 = float(np.median(rates)) if rates else 0.0
    for dof in driven_dofs(robot):
        armature, limit_nm = float(model.dof_armature[dof]), loads.get(dof, 0.0)
        limb = max(float(inertias[dof]) - armature, 1e-9)
        # Turned about its own axis a wrist has next to no inertia: what counts there is that its motor can turn it.
        if armature * LEAST_RAD_PER_S2 <= limit_nm:
            continue
        ratio, fair = armature / limb, max(limb, limit_nm / FAIR_RAD_PER_S2)
        if limit_nm:
            turned = f"{limit_nm:.3g} Nm turn it by {limit_nm / armature:.2g} rad/s^2"
            # Beside a heavy limb, a rotor is too large that turns far slower than those of the other joints.
            slower = middle_rad_per_s2 * armature / limit_nm
            if slower > ratio:
                ratio, fair = slower, limit_nm / middle_rad_per_s2
        else:
            turned = "no torque is stated"
        ratios[dof] = ratio
        if ratio > limits_of("robot-armature")[1]:
            changes[f"dof_armature[{dof}]"] = fair
        if ratio > found.value:
            found = Finding(
                value=ratio,
                remark=f"{joint_name(robot, dof)}: {armature:.3g} kg m^2 with a limb of {limb:.2g}; {turned}",
                advice=f'armature="{fair:.2g}" for {joint_name(robot, dof)} and joints like it',
            )
    return replace(found, changes=changes, parts=by_joint(robot, ratios))


@row("robot-rotor")
def _rotor(robot: Robot) -> Finding:
    armatures = {
        dof: float(robot.model.dof_armature[dof]) for dof in driven_dofs(robot)
    }
    if not armatures:
        return Finding(declined="no hinge of the robot is driven")
    limits_nm = driven_dofs(robot)
    fast: list[int] = []
    light: list[int] = []
    for dof, armature in armatures.items():
        is_fast = MOST_RAD_PER_S2 * armature < limits_nm[dof] < np.inf
        is_light = armature < LEAST_ROTOR * joint_inertias(robot)[dof]
        if armature > 0.0 and (is_fast or is_light):
            (fast if is_fast else light).append(dof)
    is_constant = len(armatures) > FEW_JOINTS and len({*armatures.values()}) == 1
    is_choice = is_constant and not fast
    fast += light
    without_rotor = [dof for dof, armature in armatures.items() if armature <= 0.0]
    without_rotor += fast
    if not without_rotor:
        return Finding(remark="all driven joints state one")
    # No joint gets a smaller one than it has.
    largest = max(armatures[dof] for dof in without_rotor)
    stated = sorted(armature for armature in armatures.values() if armature > largest)
    names = first_joints(robot, without_rotor)
    several = f"{names}: {len(without_rotor)} of {len(armatures)} driven joints"
    for dof in fast[:1]:
        several += f"; {joint_name(robot, dof)} has {armatures[dof]:.3g} kg m^2 of the "
        several += (
            f"{joint_inertias(robot)[dof]:.3g} that turn, with {limits_nm[dof]:.3g} Nm"
        )
    share = len(without_rotor) / len(armatures)
    parts = by_joint(robot, dict.fromkeys(without_rotor, 1.0))
    if share > EXCEPTIONS_SHARE and not fast:
        # Half of the makers' models state none at all.
        return Finding(
            value=share,
            parts=parts,
            remark=several,
            advisory="joints of the model state no inertia of their rotor",
        )
    if is_choice or not stated:
        return Finding(
            value=share,
            parts=parts,
            remark=several,
            advice="armature in kg m^2, forcerange in Nm",
            advisory="one armature of all joints can be a constant for stability"
            if is_choice
            else "",
        )
    least = stated[0]
    return Finding(
        value=share,
        parts=parts,
        remark=several,
        advice=f'armature="{least:.2g}" for {names}, as other joints state it: rotor inertia times gear ratio squared'
        + (", or a forcerange in Nm" if fast else ""),
        changes={f"dof_armature[{dof}]": least for dof in without_rotor},
    )


ENDLESS_RAD = 1e4
"""Range from which on a joint turns without end, as a wheel [rad]."""


@row("robot-range")
def _range(robot: Robot) -> Finding:
    model = robot.model
    joints = driven_joints(robot)
    ranges_rad = {
        name_of(robot, joint): float(np.ptp(model.jnt_range[joint]))
        for joint in joints
        if model.jnt_limited[joint] and np.ptp(model.jnt_range[joint]) < ENDLESS_RAD
    }
    if not ranges_rad:
        return Finding(declined="no driven hinge has limits")
    low_rad, high_rad = limits_of("robot-range")
    off = [n for n, rad in ranges_rad.items() if not low_rad <= rad <= high_rad]
    name = max(
        ranges_rad, key=lambda n: max(low_rad / ranges_rad[n], ranges_rad[n] / high_rad)
    )
    is_small = ranges_rad[name] < 1.0
    factor = np.degrees(1.0) if is_small else np.radians(1.0)
    changes = {
        f"jnt_range[{joint}]": factor * model.jnt_range[joint]
        for joint in joints
        if name_of(robot, joint) in off
    }
    unit = "radians read as degrees" if is_small else "degrees read as radians"
    advice = f"the range of {', '.join(off[:3])} in the unit of the compiler's angles"
    if 2 * len(off) > len(ranges_rad):
        advice = f'<compiler angle="{"radian" if is_small else "degree"}"/>'
    return Finding(
        value=ranges_rad[name],
        parts=ranges_rad,
        remark=f"{name}, {len(off)} of {len(ranges_rad)}: {unit}?" if off else "",
        advice=advice,
        changes=changes,
        # A joint on gears can turn many times, and none with a motor by two degrees alone.
        is_usual=not is_small,
    )


@row("robot-unlimited")
def _unlimited(robot: Robot) -> Finding:
    model = robot.model
    joints = driven_joints(robot)
    is_stated = np.ptp(model.jnt_range, axis=1) > 0.0
    stated = [j for j in joints if is_stated[j] and not model.jnt_limited[j]]
    has_wheels = robot.foot_rows and not (model.jnt_limited.any() or stated)
    if len(joints) < FEW_JOINTS or has_wheels:
        return Finding(declined=f"fewer than {FEW_JOINTS} driven hinges, or wheels")
    off = switched_off(model, "constraint", "limit")
    free = [joint for joint in joints if off or not model.jnt_limited[joint]]
    # What a linkage couples to another joint cannot turn without end, and a range is stated to be kept.
    coupled = {*coupled_pairs(model).ravel().tolist()}
    free.sort(key=lambda joint: joint not in coupled)
    names = ", ".join(name_of(robot, joint) for joint in free[:3])
    is_certain = bool(stated or coupled & set(free))
    return Finding(
        value=1.0 if is_certain else len(free) / len(joints),
        parts={name_of(robot, joint): 1.0 for joint in free},
        remark=f"{names}: {len(free)} of {len(joints)} driven hinges" if free else "",
        changes=dict.fromkeys(off, True),
        advice=enabling(off)
        if off
        else f'the ranges of {names} and joints like it; a `range` counts with autolimits, or with limited="true"',
    )
