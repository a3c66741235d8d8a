"""Compare copies of a part, and joints of the same motor, in what they should share."""

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    limits_of,
)
from gauge_envs.tools.sanity.robot.ground_rows import geoms_of
from gauge_envs.tools.sanity.robot.joints import (
    driven_dofs,
    position_servos,
    servo_gains,
    springs,
    torque_limits,
)
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    acts_on_joints,
    once,
)

SAME = 0.01
"""Difference of two numbers over the larger one up to which they are the same."""

FEW_COPIES = 2
"""Other copies of a part that agree, from which on they say what the part should be."""

EXACT = (
    dict.fromkeys(
        ("place", "kp", "largest torque", "torque per control", "spring"), 3.0
    )
    | dict.fromkeys(("axis", "obliqueness"), 2.0)
    | {"trunk": 1.25}
)
"""Factor by which a difference counts more, of quantities that makers state more alike on both sides."""

VISIBLE = 0.3
"""What a difference counts that some makers choose: it is visible."""

SHARED = ("largest torque", "kp", "damping", "armature", "frictionloss")
"""Quantities that joints of the same motor share."""

OWN_RANGE = "limits"
"""What two joints differ in that have the same commands, and of which one has another range."""

OF_MOTOR, FEW_MOTORS, FEW_ODD = ("largest torque", "armature"), 3, 2
"""Quantities that tell motors apart, motors whose joints all agree, and odd joints of one that do not, at most."""

FEW_SERVOS, ODD_KP = 5, 0.5
"""Servos from which on all but one say what the last should be, and the difference of its kp over the larger one.

A factor of two is a choice: the first joint of a thumb.
"""

OF_LINKS = frozenset({"mass", "inertia", "collisions", "friction", "size", "softness"})
"""Quantities of links; the others are of joints."""

OF_MOTORS = frozenset(
    {"kp", "damping", "largest torque", "torque per control", "command", "filter"}
)
"""Quantities that a joint has through its motor."""


@once
def quantities(robot: Robot) -> dict[str, FloatArray]:
    """Return what two sides share, by its name: of each body, shape [nbody], or of each degree of freedom, shape [nv].

    Damping is that of the joint and of its servo. A value that is not finite is not compared.
    """
    model = robot.model
    collisions, friction = np.zeros(model.nbody), np.full(model.nbody, np.nan)
    size_m, softness_s = np.zeros(model.nbody), np.full(model.nbody, np.nan)
    touching = np.unique(robot.pairs.geoms)
    for body in robot.bodies:
        geoms = [geom for geom in geoms_of(robot, body) if geom in touching]
        if geoms:
            collisions[body] = 1.0
            has_friction = model.geom_condim[geoms] > 1
            friction[body] = (model.geom_friction[geoms, 0] * has_friction).min()
            size_m[body] = np.cbrt(model.geom_aabb[geoms, 3:].prod(axis=1).max())
            softness_s[body] = model.geom_solref[geoms, 0].max()
    is_range = model.jnt_limited[model.dof_jntid] != 0
    return {
        "mass": model.body_mass,
        "inertia": model.body_inertia.sum(axis=1),
        "collisions": collisions,
        "friction": friction,
        "size": size_m,
        "softness": softness_s,
        "range": np.ptp(model.jnt_range[model.dof_jntid], axis=1) * is_range,
        "spring": springs(model)[model.dof_jntid],
        "torque per control": _of_motors(robot, np.abs(model.actuator_gainprm[:, 0])),
        "command": _of_motors(robot, np.ptp(model.actuator_ctrlrange, axis=1)),
        "filter": _of_motors(robot, model.actuator_dynprm[:, 0]),
        "kp": servo_gains(model, 1),
        "damping": model.dof_damping + servo_gains(model, 2),
        "armature": model.dof_armature,
        "frictionloss": model.dof_frictionloss,
        "largest torque": torque_limits(model),
    }


def _of_motors(robot: Robot, values: FloatArray) -> FloatArray:
    """Return a number of the actuators, times their gears, on each degree of freedom, shape [nv]."""
    model = robot.model
    found = np.zeros(model.nv)
    is_on_joint = acts_on_joints(model)
    scaled = np.abs(model.actuator_gear[:, 0]) * values
    dofs = model.jnt_dofadr[model.actuator_trnid[is_on_joint, 0]]
    np.add.at(found, dofs, scaled[is_on_joint])
    return found


def apart(values: FloatArray) -> FloatArray:
    """Return the difference of all numbers from each other over the larger one, NaN where one is not finite."""
    sizes = np.abs(values)
    with np.errstate(invalid="ignore"):
        differences = np.abs(values[:, None] - values)
        return differences / np.maximum(np.maximum(sizes[:, None], sizes), 1e-12)


def depth_of(model: mujoco.MjModel, joint: int) -> int:
    """Return the number of joints between the world and a joint."""
    count, dof = 0, int(model.jnt_dofadr[joint])
    while dof >= 0:
        count, dof = count + 1, int(model.dof_parentid[dof])
    return count


def copies_of(robot: Robot, joints: NDArray[np.int_]) -> BoolArray:
    """Return which joints carry copies of a link: as deep, of the same mass, inertia and distance of its centre.

    Args:
        robot: The robot.
        joints: The joints, shape [count].

    Returns:
        Whether one is a copy of another one, shape [count, count].
    """
    model = robot.model
    bodies = model.jnt_bodyid[joints]
    known = quantities(robot)
    centres_m = np.linalg.norm(model.body_ipos[bodies] - model.jnt_pos[joints], axis=1)
    # A link of another place that weighs the same by chance is no copy.
    depths = np.array([depth_of(model, int(joint)) for joint in joints], float)
    links = (known["mass"][bodies], known["inertia"][bodies], centres_m, depths)
    is_copy = np.all([apart(one) <= SAME for one in links], axis=0)
    np.fill_diagonal(is_copy, False)
    copies: BoolArray = is_copy
    return copies


def _odd_ones(
    values: FloatArray, is_like: BoolArray, within: float
) -> Iterator[tuple[int, int, float]]:
    """Yield a place, that of a like one, and the difference of their values, where at least two like ones agree."""
    off = apart(values)
    for place in np.flatnonzero(is_like.sum(axis=1) >= FEW_COPIES).tolist():
        like = np.flatnonzero(is_like[place])
        difference = float(off[place, like[0]])
        if (off[np.ix_(like, like)] <= within).all() and np.isfinite(difference):
            yield place, int(like[0]), difference


def odd_copies(robot: Robot) -> Iterator[tuple[int, int, str, float]]:
    """Yield a joint, a copy, a quantity in which its copies agree, and the difference over the larger one."""
    model = robot.model
    dofs = list(driven_dofs(robot))
    joints = model.dof_jntid[dofs]
    is_copy = copies_of(robot, joints)
    driven = {n: one[dofs] for n, one in quantities(robot).items() if n not in OF_LINKS}
    along = np.abs(model.jnt_axis[joints]).max(axis=1)
    driven["obliqueness"] = np.sqrt(np.maximum(1.0 - along**2, 0.0))
    for quantity, values in driven.items():
        for place, other, difference in _odd_ones(values, is_copy, SAME):
            counts = EXACT.get(quantity, 1.0) * difference
            yield int(joints[place]), int(joints[other]), quantity, counts


def odd_servos(robot: Robot) -> Iterator[tuple[int, int, str, float]]:
    """Yield a joint, another one, and the quantity in which its servo alone contradicts all the others; visible.

    It is a kp beside the kv of all, or limits that are not those of its commands, of which another joint has one.
    """
    model = robot.model
    motors = [one for one in position_servos(robot) if model.actuator_gear[one, 0]]
    if len(motors) < FEW_SERVOS:
        return
    joints = model.actuator_trnid[motors, 0]
    kp = quantities(robot)["kp"][model.jnt_dofadr]
    for joint, (quantity, other) in odd_motors(robot).items():
        if quantity == "kp" and apart(kp[[joint, other]])[0, 1] > ODD_KP:
            yield joint, other, "kp", VISIBLE
    commands, ranges = model.actuator_ctrlrange[motors], model.jnt_range[joints]
    gaps = np.abs(commands - ranges).max(axis=1)
    is_odd = gaps > SAME * np.ptp(ranges, axis=1)
    if is_odd.sum() != 1:
        return
    odd = int(is_odd.argmax())
    for several in (commands, ranges):
        off = np.abs(several - several[odd]).max(axis=1)
        copies = np.flatnonzero((off <= SAME * gaps[odd]) & ~is_odd)
        if len(copies):
            yield int(joints[odd]), int(joints[copies[0]]), OWN_RANGE, VISIBLE
            return


def odd_gains(robot: Robot) -> Iterator[tuple[int, int, str, float]]:
    """Yield joints whose gain alone is not that of its motor, by which all other gains were chosen; visible."""
    known, model = quantities(robot), robot.model
    dofs = model.jnt_dofadr[model.actuator_trnid[position_servos(robot), 0]]
    for source in OF_MOTOR:
        motors = [
            dofs[known[source][dofs] == one] for one in np.unique(known[source][dofs])
        ]
        for quantity in ("kp", "damping"):
            several = [known[quantity][motor] for motor in motors if len(motor) > 1]
            even = [one for one in several if (apart(one) <= SAME).all()]
            # The same joints left and right say nothing of their motor.
            gains = {one[0] for one in even if len(one) > 2}
            if len(even) != len(several) - 1 or len(gains) < FEW_MOTORS:
                continue
            motor = next(m for m in motors if (apart(known[quantity][m]) > SAME).any())
            is_like = apart(known[quantity][motor]) <= SAME
            usual = int(is_like.sum(axis=1).argmax())
            odd = motor[~is_like[usual]]
            if len(odd) <= min(FEW_ODD, is_like[usual].sum() - 1):
                other = int(model.dof_jntid[motor[usual]])
                for joint in model.dof_jntid[odd].tolist():
                    yield joint, other, quantity, VISIBLE


@once
def odd_motors(robot: Robot) -> dict[int, tuple[str, int]]:
    """Return joints that differ in one number alone from at least two like others: the number, and another joint."""
    dofs = list(driven_dofs(robot))
    joints, found = robot.model.dof_jntid[dofs], {}
    known = {name: quantities(robot)[name][dofs] for name in SHARED}
    high = limits_of("robot-sides")[1]
    unlike = {name: apart(values) > high for name, values in known.items()}
    for name in SHARED:
        others = [unlike[other] for other in SHARED if other != name]
        is_like = ~np.any(others, axis=0)
        np.fill_diagonal(is_like, False)
        # One that a like joint shares is no exception.
        is_like[(is_like & ~unlike[name]).any(axis=1)] = False
        for place, other, _ in _odd_ones(known[name], is_like, high):
            found[int(joints[place])] = name, int(joints[other])
    return found
