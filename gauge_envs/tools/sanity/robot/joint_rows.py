"""Judge what drives and brakes the joints of a model."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    body_name,
    by_joint,
    joint_name,
    limits_of,
    name_of,
    row,
)
from gauge_envs.tools.sanity.robot.joints import (
    drags_nm,
    driven_dofs,
    growth,
    joint_inertias,
    largest_weights_nm,
    loads_nm,
    servo_gains,
    servos,
    start,
    stiffness,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import Robot, couplings_of

LEAST_RAD_PER_S2 = 100.0
"""Least acceleration that the largest torque gives to the armature alone [rad/s^2]."""

FULL_ACTION_RAD_PER_S = 3.0
"""Speed of a joint below which a leg cannot step: half a radian in a swing of 0.2 s is 2.5 rad/s."""


MOST_GIVE = 1.0
"""Largest displacement at which a stop or a coupling is tried [rad or m]."""

GIVE_STEPS = 14
"""Number of halvings in which the displacement under a load is found, to less than 0.1 mrad."""

OBJECT_RATE_PER_S = 1.0
"""Share of its speed that a free object may lose in 1 s."""


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
    return Finding(
        value=value,
        remark=f"step {model.opt.timestep:g} s",
    )


@row("robot-torque")
def _torque(robot: Robot) -> Finding:
    driven = driven_dofs(robot)
    limits_nm = {dof: limit for dof, limit in driven.items() if np.isfinite(limit)}
    if not limits_nm:
        return Finding(declined="no driven hinge states the limit of its torque")
    at_start = robot.is_floating
    bias_nm = np.abs(start(robot).qfrc_bias) if at_start else largest_weights_nm(robot)
    weights_nm = {dof: float(bias_nm[dof]) for dof in limits_nm}
    ratios = {
        dof: min(limit / max(weights_nm[dof], 1e-3), 1e6)
        for dof, limit in limits_nm.items()
    }
    weakest = min(ratios, key=ratios.__getitem__)
    joint = joint_name(robot, weakest)
    return Finding(
        value=ratios[weakest],
        parts=by_joint(robot, ratios),
        remark=f"{joint}: {limits_nm[weakest]:.3g} Nm against {weights_nm[weakest]:.3g} Nm",
        # A robot on the ground carries its weight; one on a base need never be in its heaviest pose.
        is_usual=not at_start,
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
    )


def _drag(robot: Robot, name: str, share: Callable[[int, float], float]) -> Finding:
    """Return the driven joint with the largest share of its torque."""
    model, values = robot.model, getattr(robot.model, f"dof_{name}")
    is_own = np.isin(model.dof_bodyid, robot.bodies)
    feeding = np.flatnonzero(is_own & (values < 0.0)).tolist()
    if feeding:
        least = min(feeding, key=lambda dof: float(values[dof]))
        return Finding(
            value=float(values[least]),
            parts=by_joint(robot, {dof: values[dof] for dof in feeding}),
            remark=f"negative {name} {values[least]:.3g} of {joint_name(robot, least)} feeds the motion",
        )
    limits = loads_nm(robot)
    if not limits:
        return Finding(
            declined="no joint states the limit of its torque, or has a servo"
        )
    shares = {dof: share(dof, limit) for dof, limit in limits.items()}
    worst = max(shares, key=shares.__getitem__)
    remark = f"{joint_name(robot, worst)}: {name} {values[worst]:.3g} with {limits[worst]:.3g} Nm"
    if name == "damping" and values[worst] > 0.0:
        fastest_rad_per_s = limits[worst] / float(values[worst])
        remark += f", which turn it by at most {fastest_rad_per_s:.2g} rad/s"
    return Finding(
        value=shares[worst],
        parts=by_joint(robot, shares),
        remark=remark,
        # Of dry friction at the largest torque nothing moves; how fast a joint should turn is another matter.
        is_usual=name == "damping" or shares[worst] < 1.0,
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
        )
    return _drag(
        robot,
        "damping",
        lambda dof, limit: FULL_ACTION_RAD_PER_S * float(damping[dof]) / limit,
    )


@row("robot-frictionloss")
def _frictionloss(robot: Robot) -> Finding:
    drags = drags_nm(robot)
    return _drag(robot, "frictionloss", lambda dof, limit: drags[dof][0] / limit)


@row("robot-armature")
def _armature(robot: Robot) -> Finding:
    model, found = robot.model, Finding()
    ratios: dict[int, float] = {}
    inertias = joint_inertias(robot)
    loads = loads_nm(robot)
    for dof in driven_dofs(robot):
        armature, limit_nm = float(model.dof_armature[dof]), loads.get(dof, 0.0)
        limb = max(float(inertias[dof]) - armature, 1e-9)
        # Turned about its own axis a wrist has next to no inertia: what counts there is that its motor can turn it.
        if armature * LEAST_RAD_PER_S2 <= limit_nm:
            continue
        ratio = armature / limb
        if limit_nm:
            turned = f"{limit_nm:.3g} Nm turn it by {limit_nm / armature:.2g} rad/s^2"
        else:
            turned = "no torque is stated"
        ratios[dof] = ratio
        if ratio > found.value:
            found = Finding(
                value=ratio,
                remark=f"{joint_name(robot, dof)}: {armature:.3g} kg m^2 with a limb of {limb:.2g}; {turned}",
            )
    return replace(found, parts=by_joint(robot, ratios))


# --- couplings and free joints ---------------------------------------------------------------------------------------


def give(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    moved: Callable[[float], None],
    dof: int,
    load: float,
) -> float:
    """Return the displacement at which the constraints of a model at rest hold a load, at most 1 rad or m.

    Args:
        model: The model.
        data: Its data, whose positions change.
        moved: Sets the positions to a displacement [rad or m].
        dof: Degree of freedom on which the load acts.
        load: The load [Nm or N].
    """
    low, high = 0.0, MOST_GIVE
    for _ in range(GIVE_STEPS):
        middle = 0.5 * (low + high)
        moved(middle)
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        mujoco.mj_inverse(model, data)
        is_held = abs(float(data.qfrc_constraint[dof])) >= load
        low, high = (low, middle) if is_held else (middle, high)
    return high


@row("robot-coupling")
def _coupling(robot: Robot) -> Finding:
    model = robot.without("contact", "limit", "frictionloss")
    is_joint = couplings_of(model)
    couplings = [
        number
        for number in np.flatnonzero(is_joint).tolist()
        if model.eq_obj2id[number] >= 0
        and int(model.jnt_bodyid[model.eq_obj1id[number]]) in robot.bodies
    ]
    data, gives = start(robot, model), {}
    begin, forces = data.qpos.copy(), _motor_forces(model, data)
    zeros: dict[str, float] = {}
    largest = limits_of("robot-coupling")[1]
    for number in couplings:
        joint, other = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        dofs = [int(model.jnt_dofadr[one]) for one in (joint, other)]
        load = max(float(forces[dof]) for dof in dofs)
        place, lead = int(model.jnt_qposadr[joint]), int(model.jnt_qposadr[other])
        name = joint_name(robot, dofs[0])
        if load <= 0.0:
            continue
        if not data.eq_active[number]:
            gives[name] = 1.0
            continue
        coupled = _coupled(model, number, float(begin[lead]))

        def apart(distance: float, place: int = place, at: float = coupled) -> None:
            data.qpos[:] = begin
            data.qpos[place] = at + distance

        span = float(np.ptp(model.jnt_range[joint])) or 1.0
        gives[name] = give(model, data, apart, dofs[0], load) / span
        off = _off(model, number, float(begin[place]), float(begin[lead]))
        if abs(off) / span > largest:
            zeros[f"{name} from its coupled place"] = abs(off) / span
    if zeros:
        part = max(zeros, key=zeros.__getitem__)
        return Finding(
            value=zeros[part],
            parts=gives | zeros,
            remark=part,
        )
    if not gives:
        return Finding(
            declined="no equality couples a joint to one that a motor drives"
        )
    name = max(gives, key=gives.__getitem__)
    return Finding(
        value=gives[name],
        parts=gives,
        remark=name,
        is_usual=True,
    )


def _coupled(model: mujoco.MjModel, number: int, lead: float) -> float:
    """Return the place to which an equality couples a joint while the other one is at a place [rad or m]."""
    joint, other = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
    zero, lead_zero = model.qpos0[model.jnt_qposadr[[joint, other]]]
    coefficients = model.eq_data[number, :5]
    return float(zero + np.polyval(coefficients[::-1], lead - lead_zero))


def _off(model: mujoco.MjModel, number: int, place: float, lead: float) -> float:
    """Return the distance of a coupling from the place of its joint, or by how far it leaves the joint's range.

    Args:
        model: The model.
        number: The equality.
        place: Place of the coupled joint at the start [rad or m].
        lead: Place of the joint that it follows [rad or m].

    Returns:
        The larger one [rad or m].
    """
    joint, other = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
    apart = _coupled(model, number, lead) - place
    if not (model.jnt_limited[joint] and model.jnt_limited[other]):
        return apart
    low, high = model.jnt_range[joint]
    ends = [_coupled(model, number, float(end)) for end in model.jnt_range[other]]
    # A joint that leaves its range on one side, and does not reach the other side, has another zero.
    beyond = [max(ends) - high, min(ends) - low]
    is_one_side = beyond[0] * beyond[1] > 0.0
    # A coupling of another ratio leaves it on both sides, by more than the range itself.
    is_far = min(beyond[0], -beyond[1]) > high - low
    shift = min(beyond, key=abs) if is_one_side or is_far else 0.0
    return max(apart, shift, key=abs)


def _motor_forces(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return the largest force of all motors on each degree of freedom, through joints and tendons [Nm or N]."""
    mujoco.mj_forward(model, data)
    moments = np.zeros((model.nu, model.nv))
    rows = (data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    if model.nu:
        mujoco.mju_sparse2dense(moments, data.actuator_moment.ravel(), *rows)
    largest = np.abs(model.actuator_forcerange).max(axis=1, initial=0.0)
    spans = np.abs(model.actuator_ctrlrange).max(axis=1, initial=0.0)
    unlimited = np.abs(model.actuator_gainprm[:, 0]) * np.where(spans, spans, 1.0)
    is_limited = model.actuator_forcelimited != 0
    return np.abs(moments).T @ np.where(is_limited, largest, unlimited)


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
        is_usual=worst in on_purpose,
    )
