"""Judge whether parts of a model fit: links meet, contacts settle, keyframes hold, bases are free."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    body_name,
    joint_name,
    limits_of,
    name_of,
    row,
)
from gauge_envs.tools.sanity.robot.joints import (
    dof_of,
    home_key,
    joint_inertias,
    position_servos,
)
from gauge_envs.tools.sanity.robot.mass_rows import size_m
from gauge_envs.tools.sanity.robot.mujoco_feet import geom_name, joints_of
from gauge_envs.tools.sanity.robot.robot import Robot

SAME_PLACE_RAD, TURNED_FROM_RAD, TURNED_RAD = 0.001, 0.1, 1.0
"""Difference of a command and the other sign of a joint up to which they agree, least distance, and what it counts."""

OBJECT_RATE_PER_S = 1.0
"""Share of its speed that a free object may lose in 1 s."""

Indices = NDArray[np.int_]

WIDE = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
"""Geoms of the ground."""


def _gap_m(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Indices, others: Indices
) -> float:
    """Return the least distance between the hulls of two sets of geoms [m]; 0 where they touch."""
    least_m, ends = np.inf, np.zeros(6)
    for geom in geoms.tolist():
        apart_m = np.linalg.norm(data.geom_xpos[others] - data.geom_xpos[geom], axis=1)
        bounds_m = apart_m - model.geom_rbound[others] - model.geom_rbound[geom]
        for other in others[np.argsort(bounds_m)][np.sort(bounds_m) < least_m].tolist():
            away_m = mujoco.mj_geomDistance(model, data, geom, other, 10.0, ends)
            least_m = min(least_m, float(away_m))
            if least_m <= 0.0:
                return 0.0
    return least_m


@row("robot-joined")
def _joined(robot: Robot) -> Finding:
    model, robot_m = robot.model, size_m(robot)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    links = model.body_weldid[model.geom_bodyid]
    links[np.isin(model.geom_type, WIDE)] = -1
    # Parts of another tree that stand in the world belong to no robot.
    roots = model.body_rootid[model.geom_bodyid]
    is_free = joints_of(model, "FREE")
    parts: dict[str, float] = {}
    for body in robot.bodies:
        first = int(model.body_jntadr[body])
        geoms = np.flatnonzero(links == body)
        if first < 0 or is_free[first] or not len(geoms):
            continue
        is_here = roots == model.body_rootid[body]
        parent = body
        others: Indices = np.zeros(0, int)
        while parent and not len(others):
            parent = int(model.body_parentid[parent])
            link = model.body_weldid[parent]
            others = np.flatnonzero((links == link) & is_here)
        if len(others):
            gap_m = _gap_m(model, data, geoms, others)
            parts[f"{body_name(robot, body)} from {body_name(robot, parent)}"] = (
                gap_m / robot_m
            )
    if not parts:
        return Finding(declined="no joint joins two links whose shapes are known")
    worst = max(parts, key=parts.__getitem__)
    name = worst.partition(" from ")[0]
    return Finding(
        value=parts[worst],
        parts=parts,
        remark=f"{1e3 * robot_m * parts[worst]:.3g} mm lie between {worst.replace(' from ', ' and ')}"
        if parts[worst]
        else "",
        advice=f"pos and quat (w x y z) of {name}, or the place and the scale of its geoms",
    )


def _damping_ratio(solref: FloatArray) -> float:
    """Return the damping ratio of constraints, of either form of `solref`."""
    first, second = (float(number) for number in solref)
    if first > 0.0:
        return second
    return -second / (2.0 * max(np.sqrt(-first), 1e-9))


@row("robot-solref")
def _solref(robot: Robot) -> Finding:
    model = robot.model
    stated: dict[str, FloatArray] = {}
    for geom in np.unique(robot.pairs.geoms).tolist():
        stated[f"contacts of {geom_name(model, geom)}"] = model.geom_solref[geom]
    for number, solref in enumerate(model.pair_solref):
        stated[f"contacts of pair {model.pair(number).name or number}"] = solref
    for joint in np.flatnonzero(model.jnt_limited).tolist():
        stated[f"the limit of {name_of(robot, joint)}"] = model.jnt_solref[joint]
    for number, solref in enumerate(model.eq_solref):
        stated[f"equality {model.eq(number).name or number}"] = solref
    parts = {name: _damping_ratio(solref) for name, solref in stated.items()}
    if not parts:
        return Finding(
            declined="no contact, limit or equality of the model has a solref"
        )
    worst = max(parts, key=lambda name: abs(np.log(max(parts[name], 1e-9))))
    does = "throw back what they stop" if parts[worst] < 1.0 else "give way slowly"
    same = sum(value == parts[worst] for value in parts.values())
    return Finding(
        value=parts[worst],
        parts=parts,
        remark=f"{worst}: a damping ratio of {parts[worst]:.3g}, so that constraints {does}; {same} like it"
        if parts[worst] != 1.0
        else "",
        advice=f"solref (time constant, damping ratio) of {worst}: a damping ratio of 1",
    )


@row("robot-keyframe")
def _keyframe(robot: Robot) -> Finding:
    model, data = robot.model, mujoco.MjData(robot.model)
    parts: dict[str, float] = {}
    key, turned = home_key(model), list[str]()
    # Without commands a keyframe states a pose alone.
    if model.nkey and model.key_ctrl[key].any():
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_fwdPosition(model, data)
        for actuator in position_servos(robot):
            bias = model.actuator_biasprm[actuator]
            force = model.actuator_gainprm[actuator, 0] * data.ctrl[actuator] + bias[0]
            gear = float(model.actuator_gear[actuator, 0]) or 1.0
            commanded = -force / bias[1]
            away = commanded - data.actuator_length[actuator]
            name = joint_name(robot, dof_of(robot, actuator))
            parts[name] = abs(float(away / gear))
            is_turned = abs(away - 2.0 * commanded) < SAME_PLACE_RAD
            if is_turned and parts[name] > TURNED_FROM_RAD:
                turned.append(name)
                parts[name] += TURNED_RAD
    if not parts:
        return Finding(
            declined="the first keyframe states no commands of servos on hinges"
        )
    worst = max(parts, key=parts.__getitem__)
    remark = f"{worst} is commanded {parts[worst]:.3g} rad away from where it is"
    if worst in turned:
        remark = f"{worst} is commanded to where it is with the other sign, {parts[worst] - TURNED_RAD:.3g} rad away"
    return Finding(
        value=parts[worst],
        parts=parts,
        remark=remark if parts[worst] > 1e-3 else "",
        advice=f"qpos and ctrl of the keyframe that agree: {worst}",
    )


@row("robot-free")
def _free(robot: Robot) -> Finding:
    model = robot.model
    inertia = joint_inertias(robot) - model.dof_armature
    parts: dict[str, float] = {}
    stated: dict[str, str] = {}
    # Objects that are braked, and a base that a spring holds.
    on_purpose: set[str] = set()
    for joint in np.flatnonzero(joints_of(model, "FREE")).tolist():
        first = int(model.jnt_dofadr[joint])
        six = slice(first, first + 6)
        body = int(model.jnt_bodyid[joint])
        if body not in robot.bodies:
            rate_per_s = float(model.dof_damping[first] / model.body_subtreemass[body])
            name = f"{name_of(robot, joint)} of {body_name(robot, body)}"
            on_purpose.add(name)
            # An object may be braked to keep it from rolling.
            parts[name] = limits_of("robot-free")[1] * rate_per_s / OBJECT_RATE_PER_S
            stated[name] = (
                f"damping {model.dof_damping[first]:g} for {model.body_subtreemass[body]:.3g} kg"
            )
            continue
        # What a speed of 1 m/s or 1 rad/s loses in 1 s, and what the inertia has too much.
        shares = model.dof_damping[six] + model.dof_frictionloss[six]
        shares = np.maximum(shares, model.dof_armature[six]) / inertia[six]
        name = name_of(robot, joint)
        parts[name] = float(shares.max())
        if model.jnt_stiffness[joint] > 0.0:
            on_purpose.add(name)
        numbers = (model.dof_damping, model.dof_frictionloss, model.dof_armature)
        damping, dry, armature = (float(one[first]) for one in numbers)
        stated[name] = (
            f"damping {damping:g}, frictionloss {dry:g} and armature {armature:g}"
        )
    if not parts:
        return Finding(declined="the model has no free joint")
    worst = max(parts, key=parts.__getitem__)
    return Finding(
        value=parts[worst],
        parts=parts,
        remark=f"the free joint {worst} has {stated[worst]}, as by a default of other joints"
        if parts[worst]
        else "",
        advice=f'<freejoint/>, or damping="0" frictionloss="0" armature="0" for {worst}',
        is_usual=worst in on_purpose,
    )
