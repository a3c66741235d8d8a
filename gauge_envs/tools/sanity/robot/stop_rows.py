"""Judge what holds a robot together: the stops of its joints, and the couplings of fingers."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from gauge_envs.pages.text import vector_text
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    by_joint,
    joint_name,
    limits_of,
    name_of,
    row,
)
from gauge_envs.tools.sanity.robot.joints import SAME_MASS, driven_dofs, start
from gauge_envs.tools.sanity.robot.robot import Robot, couplings_of

MOST_GIVE = 1.0
"""Largest displacement at which a stop or a coupling is tried [rad or m]."""

GIVE_STEPS = 14
"""Number of halvings in which the displacement under a load is found, to less than 0.1 mrad."""

STOP_RAD_PER_S2 = 100.0
"""Acceleration that a stop takes up at most: that of a strong motor [rad/s^2]."""

LEAST_STEPS, BOUNCING = 0.5, 0.2
"""Steps in the time constant of a stop, and its damping ratio, below which it throws back; makers have 1 and 1."""


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


@row("robot-stops")
def _stops(robot: Robot) -> Finding:
    model = robot.without("contact", "equality", "frictionloss")
    # A disabled limit is another row.
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data, gives_mrad, changes = start(robot, model), {}, {}
    begin = data.qpos.copy()
    outside_mrad: dict[str, float] = {}
    for dof, limit_nm in driven_dofs(robot).items():
        joint = int(model.dof_jntid[dof])
        low, high = model.jnt_range[joint]
        if not model.jnt_limited[joint] or not low < high:
            continue
        place = int(model.jnt_qposadr[joint])

        def beyond(angle: float, place: int = place, high: float = high) -> None:
            data.qpos[:] = begin
            data.qpos[place] = high + angle

        begins_rad = float(begin[place])
        outside_rad = max(float(low) - begins_rad, begins_rad - float(high), 0.0)
        outside_mrad[f"{joint_name(robot, dof)} where it starts"] = 1e3 * outside_rad
        load_nm = STOP_RAD_PER_S2 / max(float(model.dof_invweight0[dof]), 1e-9)
        gives_mrad[dof] = 1e3 * give(model, data, beyond, dof, min(load_nm, limit_nm))
        time_constant_s, damping_ratio = model.jnt_solref[joint]
        shortest_s = LEAST_STEPS * model.opt.timestep
        if 0.0 < time_constant_s < shortest_s or 0.0 < damping_ratio < BOUNCING:
            gives_mrad[dof] = np.inf
        if gives_mrad[dof] > limits_of("robot-stops")[1]:
            changes[f"jnt_solref[{joint}]"] = np.array([0.02, 1.0])
            changes[f"jnt_solimp[{joint}]"] = np.array([0.9, 0.95, 0.001, 0.5, 2.0])
    if not gives_mrad:
        return Finding(declined="no driven hinge has a limit")
    dof = max(gives_mrad, key=gives_mrad.__getitem__)
    farthest = max(outside_mrad, key=outside_mrad.__getitem__)
    if outside_mrad[farthest] > gives_mrad[dof]:
        return Finding(
            value=outside_mrad[farthest],
            parts=by_joint(robot, gives_mrad) | outside_mrad,
            remark=farthest,
            advice=f"a range, or a pose, with {farthest} inside",
            # Without a keyframe code states where it starts.
            is_usual=not model.nkey,
        )
    name, joint = joint_name(robot, dof), int(model.dof_jntid[dof])
    return Finding(
        value=gives_mrad[dof],
        parts=by_joint(robot, gives_mrad),
        remark=f"{name}: solreflimit {vector_text(model.jnt_solref[joint])}, "
        f"solimplimit {vector_text(model.jnt_solimp[joint])}",
        advice=f'solreflimit="0.02 1" solimplimit="0.9 0.95 0.001" for {name} and joints like it',
        changes=changes,
        is_usual=bool(np.isfinite(gives_mrad[dof])),
    )


ZERO_ADVICE = (
    "a zero of the coupling (`polycoef`, `offset` of a mimic) with which both joints are in their "
    "ranges, and together where the robot starts"
)

TURNED = 0.01
"""Distance from its range, over it, up to which a joint would be in it with the other sign of its coupling."""


def are_twins(model: mujoco.MjModel, joint: int, other: int) -> bool:
    """Return whether two joints carry like fingers: on one body, of the same mass, and with ranges of the same size."""
    bodies = model.jnt_bodyid[[joint, other]]
    parents = model.body_parentid[bodies]
    masses_kg = model.body_subtreemass[bodies]
    spans = np.ptp(model.jnt_range[[joint, other]], axis=1)
    is_same_mass = bool(np.ptp(masses_kg) <= SAME_MASS * masses_kg.max())
    is_same_span = bool(np.ptp(spans) <= SAME_MASS * spans.max())
    return bool(parents[0] == parents[1] and is_same_mass and is_same_span)


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
    changes: dict[str, Any] = {}
    begin, forces = data.qpos.copy(), _motor_forces(model, data)
    zeros: dict[str, float] = {}
    advices: dict[str, str] = {}
    zero_changes: dict[str, FloatArray] = {}
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
            changes[f"eq_active0[{number}]"] = 1
            continue
        coupled = _coupled(model, number, float(begin[lead]))

        def apart(distance: float, place: int = place, at: float = coupled) -> None:
            data.qpos[:] = begin
            data.qpos[place] = at + distance

        span = float(np.ptp(model.jnt_range[joint])) or 1.0
        gives[name] = give(model, data, apart, dofs[0], load) / span
        if gives[name] > largest:
            changes[f"eq_solref[{number}]"] = np.array([0.005, 1.0])
            changes[f"eq_solimp[{number}]"] = np.array([0.95, 0.99, 0.001, 0.5, 2.0])
        off = _off(model, number, float(begin[place]), float(begin[lead]))
        part = f"{name} from its coupled place"
        if abs(off) / span > largest:
            mended, advices[part] = _mended_coupling(model, number, off, begin)
            zeros[part] = abs(off) / span
            zero_changes[f"eq_data[{number}]"] = mended
        if are_twins(model, joint, other):
            ratio = abs(float(model.eq_data[number, 1]))
            both = f"{name} and {name_of(robot, other)}"
            part = f"ratio of {both}"
            zeros[part] = 1.0 - min(ratio, 1.0 / max(ratio, 1e-12))
            advices[part] = f"a ratio of 1 or -1: {both} are two like fingers"
    part = max(zeros, key=zeros.__getitem__, default="")
    if part and zeros[part] > largest:
        return Finding(
            value=zeros[part],
            parts=gives | zeros,
            remark=part,
            advice=advices[part],
            changes=zero_changes,
            is_usual=part.startswith("ratio"),
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
        advice=f'solref="0.005 1" solimp="0.95 0.99 0.001" for the equality of {name}',
        changes=changes,
        is_usual=True,
    )


def _mended_coupling(
    model: mujoco.MjModel, number: int, off: float, begin: FloatArray
) -> tuple[FloatArray, str]:
    """Return the numbers of a coupling, and an advice, with which its joint is in its range.

    Args:
        model: The model.
        number: The equality.
        off: Distance of the joint from its coupled place [rad or m].
        begin: Where the robot starts, shape [nq].
    """
    joint, other = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
    place, lead = begin[model.jnt_qposadr[[joint, other]]].tolist()
    mended: FloatArray = np.array(model.eq_data[number])
    model.eq_data[number, 1] *= -1.0
    turned = _off(model, number, place, lead)
    model.eq_data[number, 1] *= -1.0
    if abs(turned) < TURNED * float(np.ptp(model.jnt_range[joint])):
        mended[1] *= -1.0
        name = model.joint(joint).name or f"joint {joint}"
        return mended, f"the other sign of the coupling of {name}"
    mended[0] -= off
    return mended, ZERO_ADVICE


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
