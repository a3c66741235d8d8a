"""Changes of lengths, masses, joints and motors that may mend rows of a robot."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import mujoco
import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.robot.behaviour import ORDER, WORSE, after_changes, step_s
from gauge_envs.tools.sanity.robot.copies import odd_motors, quantities
from gauge_envs.tools.sanity.robot.finding import limits_of, of_elements, standing_of
from gauge_envs.tools.sanity.robot.joint_rows import (
    FAIR_RAD_PER_S2,
    LEAST_RAD_PER_S2,
    MOST_RAD_PER_S2,
)
from gauge_envs.tools.sanity.robot.joints import (
    SERVO_ERROR_RAD,
    dof_of,
    driven_dofs,
    driven_joints,
    feet_above_ground_m,
    foot_load_n,
    largest_weights_nm,
    loads_nm,
    motors_of,
    one_sided,
    position_servos,
    start,
    stiffness,
)
from gauge_envs.tools.sanity.robot.legs import bent_legs_nm
from gauge_envs.tools.sanity.robot.mended_model import element_names, listed
from gauge_envs.tools.sanity.robot.mirror import SAME_PLACE_M, MirrorPair, mirror_pairs
from gauge_envs.tools.sanity.robot.remedy import (
    Remedy,
    changed_rows,
    elements_remedy,
    in_words,
    remedies_of,
    rounded,
    stated_remedy,
)
from gauge_envs.tools.sanity.robot.robot import LENGTHS, Robot, enabling, switched_off
from gauge_envs.tools.sanity.robot.rows import ROWS
from gauge_envs.tools.sanity.robot.sides import differences

UNITS_M = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "inches": 0.0254,
    "kilometres": 1e3,
}
"""Units in which lengths may be stated [m]."""

FLAT_RAD = 0.05
"""Difference of two tilts of soles that tells which one lies flat [rad]."""

TOUCHING = 0.01
"""Distance of a foot from the ground, over the height of the robot, up to which they touch: that of `robot-level`."""

ADJUSTABLE = ("armature", "frictionloss", "damping", "kp", "largest torque")
"""Quantities of two sides of which one number of a joint or its actuator is the reason."""

STRONG = 20.0
"""Largest torque, over the middle one of all joints, from which on it can be in N mm or N cm."""

PER_DEGREE = float(np.degrees(1.0))


def weights_nm(robot: Robot) -> FloatArray:
    """Return what each degree of freedom must hold of the robot's weight [Nm], shape [nv].

    On a fixed base it is the largest torque of gravity in random poses. Of a robot that stands, each foot carries the
    same share of the weight.
    """
    if not robot.is_floating:
        return largest_weights_nm(robot)
    model, data = robot.model, start(robot)
    load_n = foot_load_n(robot) * np.asarray(robot.up)
    loads_n_m = data.qfrc_bias - data.qfrc_gravcomp
    for geoms in standing_of(robot).feet.values():
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacGeom(model, data, jacobian, None, geoms[0])
        loads_n_m = loads_n_m - jacobian.T @ load_n
    return np.abs(loads_n_m)


def _from_others(
    values: Mapping[int, float], limits: Mapping[int, float], wrong: Collection[int]
) -> dict[int, float]:
    """Return for each wrong joint the value of the right one whose largest torque is nearest; empty without one."""
    right = [dof for dof in values if dof not in wrong]
    if not right:
        return {}
    return {
        dof: values[min(right, key=lambda one: abs(np.log(limits[one] / limits[dof])))]
        for dof in wrong
    }


@remedies_of("robot-size")
def _size(robot: Robot) -> Iterator[Remedy]:
    """Yield metres for the unit with which fewest rows are flagged, unless another one does as well."""
    if robot.spec is None:
        return
    flags: list[tuple[float, Remedy]] = []
    for unit, factor in UNITS_M.items():
        text = f"lengths times {factor:g}: every pos, size, fromto and scale of meshes is in {unit}"
        remedy = Remedy(text=text, changes={LENGTHS: factor})
        try:
            after = after_changes(robot, remedy.changes)
        except TargetError:
            # A body beside the robot becomes too light to compile.
            continue
        if not after.row("robot-size").is_flag:
            flags.append((sum(after.row(name).is_flag for name in ORDER), remedy))
    yield from _least(flags, 0.0)


@remedies_of("robot-range")
def _range(robot: Robot) -> Iterator[Remedy]:
    if robot.spec is None:
        return
    is_degree = bool(robot.spec.compiler.degree)
    word = "radian" if is_degree else "degree"
    yield Remedy(
        text=f'<compiler angle="{word}"/>',
        changes={"compiler_degree": not is_degree},
    )
    yield from elements_remedy(robot, dict(ROWS["robot-range"](robot).changes))


@remedies_of("robot-mirror")
def _mirror(robot: Robot) -> Iterator[Remedy]:
    """Yield the axis, then the range, of each of two sides, unless that of the other one does as well."""
    model = robot.model
    high = limits_of("robot-mirror")[1]
    pairs = [
        pair
        for pair in mirror_pairs(robot)
        if model.jnt_limited[[pair.joint, pair.other]].all()
        and pair.range_apart_rad > high
    ]
    for field in ("jnt_axis", "jnt_range"):
        sides: list[Remedy] = []
        for several in zip(*[(one.joint, one.other) for one in pairs], strict=True):
            of_side = dict(zip(several, pairs, strict=True))
            changes = {
                f"{field}[{joint}]": 0.0 - model.jnt_axis[joint]
                if field == "jnt_axis"
                else pair.range_of(joint) + model.qpos0[model.jnt_qposadr[joint]]
                for joint, pair in of_side.items()
            }
            sides.append(in_words(robot, changes))
        for one, rival in permutations(sides, 2):
            yield replace(one, rival=rival)


@remedies_of("robot-balance")
def _balance(robot: Robot) -> Iterator[Remedy]:
    """Yield the other direction of like joints of both legs with which soles lie flattest, unless others do as well."""
    turns: list[tuple[float, Remedy]] = []
    for pair in mirror_pairs(robot):
        changes = {
            f"jnt_axis[{joint}]": 0.0 - robot.model.jnt_axis[joint]
            for joint in (pair.joint, pair.other)
        }
        after = after_changes(robot, changes)
        if not after.row("robot-balance").is_flag:
            turns.append((_tilt_rad(after.robot), in_words(robot, changes)))
    # Soles lie flat on the ground.
    yield from _least(turns, FLAT_RAD)


def _least(found: Sequence[tuple[float, Remedy]], apart: float) -> Iterator[Remedy]:
    """Yield the remedy with the least number, and as its rival another one that is at most so far away."""
    for least, remedy in sorted(found, key=lambda one: one[0])[:1]:
        rivals = [one for number, one in found if number <= least + apart]
        others = [one for one in rivals if one is not remedy]
        yield replace(remedy, rival=next(iter(others), None))


def _tilt_rad(robot: Robot) -> float:
    """Return the largest angle of a foot's geoms from a face or an axis along the vertical [rad]; 0 without feet."""
    standing = robot.standing
    if standing is None:
        return 0.0
    geoms = [geom for several in standing.feet.values() for geom in several]
    upward = np.abs(standing.stance.rotations[geoms].as_matrix()[:, 2]).max(axis=1)
    return float(np.arccos(np.clip(upward.min(), 0.0, 1.0)))


@remedies_of("robot-level")
def _level(robot: Robot) -> Iterator[Remedy]:
    """Yield the place of the first joint that the other leg has elsewhere, for the leg that does not meet the ground.

    Where both legs meet it, or none does, each is the rival of the other.
    """
    apart = [one for one in mirror_pairs(robot) if one.apart_m > SAME_PLACE_M]
    for pair in sorted(apart, key=lambda one: one.depth)[:1]:
        several: list[Remedy] = []
        for joint, other in permutations((pair.joint, pair.other)):
            changes = {
                f"body_pos[{robot.model.jnt_bodyid[joint]}]": _mirrored_m(
                    robot, pair, joint, other
                )
            }
            several.append(in_words(robot, changes))
        meets = [
            _meets_ground(after_changes(robot, one.changes).robot) for one in several
        ]
        if sum(meets) == 1:
            yield several[meets.index(True)]
        else:
            for one, rival in permutations(several):
                yield replace(one, rival=rival)


def _mirrored_m(robot: Robot, pair: MirrorPair, joint: int, other: int) -> FloatArray:
    """Return the place of a joint's body in its parent with which the joint mirrors the other one [m], shape [3]."""
    model, data = robot.model, mujoco.MjData(robot.model)
    mujoco.mj_kinematics(model, data)
    assert robot.standing is not None
    root, body = robot.standing.body, int(model.jnt_bodyid[joint])
    frame = data.xmat[root].reshape(3, 3)
    image_m = frame @ (pair.flip * (frame.T @ (data.xanchor[other] - data.xpos[root])))
    away_m = data.xpos[root] + image_m - data.xanchor[joint]
    parent = data.xmat[model.body_parentid[body]].reshape(3, 3)
    place_m: FloatArray = model.body_pos[body] + parent.T @ away_m
    return np.round(place_m, 6)


def _meets_ground(robot: Robot) -> bool:
    """Return whether the lowest foot touches the ground in the pose in which the robot starts."""
    if robot.standing is None:
        return False
    return abs(feet_above_ground_m(robot)) < TOUCHING * robot.standing.height_m


@remedies_of("robot-command")
def _command(robot: Robot) -> Iterator[Remedy]:
    """Yield what the row states; of a gain and a bias that differ, the smaller one for both too."""
    changes, model = dict(ROWS["robot-command"](robot).changes), robot.model
    yield from elements_remedy(robot, changes)
    smaller = {
        a: model.actuator_gainprm[a].copy()
        for a in changed_rows(changes, "actuator_biasprm")
    }
    for actuator, gain in smaller.items():
        gain[0] = -model.actuator_biasprm[actuator, 1]
    yield from elements_remedy(robot, of_elements("actuator_gainprm", smaller))


@remedies_of("robot-sides")
def _sides(robot: Robot) -> Iterator[Remedy]:
    """Yield the values of the right side for the wrong one, where most joints behind as many others say which it is."""
    high = limits_of("robot-sides")[1]
    pairs, known = mirror_pairs(robot), quantities(robot)
    changes: dict[str, Any] = {}
    words: list[str] = []
    fair_s = 0.0
    for pair in pairs:
        alike = [one for one in pairs if one.depth == pair.depth]
        joints = [joint for one in alike for joint in (one.joint, one.other)]
        for quantity, difference in differences(robot, pair):
            if difference <= high or quantity not in ADJUSTABLE:
                continue
            values = known[quantity][robot.model.jnt_dofadr]
            middle = float(np.median(values[joints]))
            both = (pair.joint, pair.other)
            wrong = max(both, key=lambda joint: abs(values[joint] - middle))
            (right,) = {*both} - {wrong}
            if len(alike) < 2 or not np.isclose(values[right], middle, rtol=0.05):
                continue
            dofs = robot.model.jnt_dofadr[[wrong, right]]
            changes |= _adjusted(robot, quantity, int(dofs[0]), middle, changes)
            whole = " of joint and servo together" if quantity == "damping" else ""
            name = robot.model.joint(wrong).name
            words.append(f"{quantity}{whole} {middle:.3g} for {name}")
            fair_s = max(fair_s, _fair_step_s(robot, [int(dofs[1])]))
    if changes:
        yield Remedy(text=" and ".join(words), changes=changes, fair_step_s=fair_s)


def _fair_step_s(robot: Robot, dofs: Collection[int]) -> float:
    """Return the time in which the slowest servo on degrees of freedom covers half of a step [s]; 0 without one."""
    servos_on = [a for a in position_servos(robot) if dof_of(robot, a) in dofs]
    times_s = [step_s(robot, actuator) for actuator in servos_on]
    return max((one for one in times_s if np.isfinite(one)), default=0.0)


def _adjusted(
    robot: Robot, quantity: str, dof: int, value: float, known: Settings
) -> dict[str, Any]:
    """Return the changes that give a quantity of `quantities` another value on a degree of freedom.

    Args:
        robot: The robot.
        quantity: Its name.
        dof: The degree of freedom.
        value: The value.
        known: Changes that are made already.
    """
    model = robot.model
    if quantity in ("armature", "frictionloss"):
        return {f"dof_{quantity}[{dof}]": value}
    motors = [a for a in motors_of(robot) if dof_of(robot, a) == dof]
    if len(motors) != 1:
        return {}
    (motor,) = motors
    gear = abs(float(model.actuator_gear[motor, 0]))
    if quantity == "largest torque":
        limit_nm = value / gear
        return {f"actuator_forcerange[{motor}]": np.array([-limit_nm, limit_nm])}
    stated = known.get(f"actuator_biasprm[{motor}]", model.actuator_biasprm[motor])
    bias, scaled = np.array(stated), model.actuator_gainprm[motor].copy()
    if quantity == "damping":
        bias[2] = -(value - float(model.dof_damping[dof])) / gear**2
        return {f"actuator_biasprm[{motor}]": bias}
    factor = value / stiffness(model, dof)
    scaled[0] *= factor
    bias[1] *= factor
    return {f"actuator_gainprm[{motor}]": scaled, f"actuator_biasprm[{motor}]": bias}


@remedies_of("robot-coupling")
def _coupling(robot: Robot) -> Iterator[Remedy]:
    """Yield what the row states: another zero, or a stiffer coupling; then the other direction."""
    changes = dict(ROWS["robot-coupling"](robot).changes)
    yield from elements_remedy(robot, changes)
    turned = {
        n: robot.model.eq_data[n].copy() for n in changed_rows(changes, "eq_data")
    }
    for one in turned.values():
        one[1] *= -1.0
    yield from elements_remedy(robot, of_elements("eq_data", turned))


@remedies_of("robot-unlimited")
def _unlimited(robot: Robot) -> Iterator[Remedy]:
    model = robot.model
    yield from stated_remedy("robot-unlimited")(robot)
    joints = driven_joints(robot)
    stated = [
        j for j in joints if not model.jnt_limited[j] and np.ptp(model.jnt_range[j])
    ]
    if stated:
        yield Remedy(
            text=f'limited="true" for {listed(element_names(robot, "joint", stated))}, which state a range',
            changes={f"jnt_limited[{joint}]": 1 for joint in stated},
        )


@remedies_of("robot-torque")
def _torque(robot: Robot) -> Iterator[Remedy]:
    model = robot.model
    both = {}
    for actuator in one_sided(robot).values():
        limit_nm = np.abs(model.actuator_forcerange[actuator]).max()
        signs = np.array([-1.0, 1.0])
        both[actuator] = signs * limit_nm
    yield from elements_remedy(robot, of_elements("actuator_forcerange", both))
    yield from gear_remedies(robot)
    limited = [a for a in motors_of(robot) if model.actuator_forcelimited[a]]
    weights, limits = weights_nm(robot), driven_dofs(robot)
    # In kN m, servos would ask for their largest torque at errors that joints have.
    if all(
        1e3 * limits[dof] <= SERVO_ERROR_RAD * stiffness(model, dof)
        for dof in {dof_of(robot, actuator) for actuator in limited}
    ):
        ranges = {a: 1e3 * model.actuator_forcerange[a] for a in limited}
        yield from elements_remedy(robot, of_elements("actuator_forcerange", ranges))
    changes = {}
    if robot.is_floating:
        weights = np.maximum(weights, bent_legs_nm(robot))
    for actuator in limited:
        dof = dof_of(robot, actuator)
        loss_nm, drag_nm = (
            float(model.dof_frictionloss[dof]),
            6.0 * float(model.dof_damping[dof]),
        )
        fair_nm = 2.0 * float(weights[dof]) + max(10.0 * loss_nm, drag_nm)
        fair_nm = rounded(fair_nm)
        if fair_nm > limits[dof]:
            fair = fair_nm / abs(float(model.actuator_gear[actuator, 0]) or 1.0)
            changes[f"actuator_forcerange[{actuator}]"] = np.array([-fair, fair])
    yield from elements_remedy(robot, changes)


def gear_remedies(robot: Robot) -> Iterator[Remedy]:
    """Yield the gear ratio 1 for actuators that state less, which makes a motor weaker."""
    gears = {a: float(robot.model.actuator_gear[a, 0]) for a in motors_of(robot)}
    ones = {
        a: np.sign(g) * np.eye(6)[0] for a, g in gears.items() if 0.0 < abs(g) < 1.0
    }
    yield from elements_remedy(robot, of_elements("actuator_gear", ones))


@remedies_of("robot-rotor")
def rotor_remedies(robot: Robot) -> Iterator[Remedy]:
    """Yield other units of torques that are too large, then armatures: of other joints, or by a fair acceleration."""
    limits = loads_nm(robot)
    armatures = {dof: float(robot.model.dof_armature[dof]) for dof in limits}
    bare = [dof for dof in limits if MOST_RAD_PER_S2 * armatures[dof] < limits[dof]]
    strong = [d for d in bare if limits[d] > STRONG * np.median(list(limits.values()))]
    motors = [a for a in motors_of(robot) if dof_of(robot, a) in strong]
    for unit in (1e3, 100.0):
        ranges = {a: robot.model.actuator_forcerange[a] / unit for a in motors}
        yield from elements_remedy(robot, of_elements("actuator_forcerange", ranges))
    found = _from_others(armatures, limits, bare)
    right = set(limits) - set(bare)
    for one in elements_remedy(robot, of_elements("dof_armature", found)):
        yield replace(one, fair_step_s=WORSE * _fair_step_s(robot, right))
    yield from _rotors(robot)


def _rotors(robot: Robot) -> Iterator[Remedy]:
    """Yield armatures for all joints that state none: what the motor accelerates by 1000 and by 300 rad/s^2."""
    limits = loads_nm(robot)
    for rate in (FAIR_RAD_PER_S2, 300.0):
        found = {
            dof: rounded(limit_nm / rate)
            for dof, limit_nm in limits.items()
            if robot.model.dof_armature[dof] <= 0.0
        }
        yield from elements_remedy(robot, of_elements("dof_armature", found))


@remedies_of("robot-armature")
def _armature(robot: Robot) -> Iterator[Remedy]:
    limits, changes = loads_nm(robot), dict(ROWS["robot-armature"](robot).changes)
    wrong = [dof for dof in limits if dof in changed_rows(changes, "dof_armature")]
    armatures = {dof: float(robot.model.dof_armature[dof]) for dof in limits}
    others = _from_others(
        {d: a for d, a in armatures.items() if a > 0.0 or d in wrong}, limits, wrong
    )
    yield from elements_remedy(robot, of_elements("dof_armature", others))
    small = {dof: 1e-4 * armatures[dof] for dof in limits}
    rates = [limits[dof] / small[dof] for dof in wrong]
    if rates and LEAST_RAD_PER_S2 < np.median(rates) < 3.0 * FAIR_RAD_PER_S2:
        # Catalogues of motors state kg cm^2.
        yield from elements_remedy(robot, of_elements("dof_armature", small))
    yield from elements_remedy(
        robot, {name: rounded(float(value)) for name, value in changes.items()}
    )


@remedies_of("robot-damping")
def _damping(robot: Robot) -> Iterator[Remedy]:
    if (robot.model.dof_damping < 0.0).any():
        turned = dict(ROWS["robot-damping"](robot).changes)
        for one in (turned, dict.fromkeys(turned, 0.0)):
            yield from elements_remedy(robot, one)
        return
    yield from drag_remedies(robot, "damping", (PER_DEGREE, 1e3))


@remedies_of("robot-frictionloss")
def _frictionloss(robot: Robot) -> Iterator[Remedy]:
    several = list(drag_remedies(robot, "frictionloss", (100.0, 1e3)))
    yield from several
    # Without a rotor, a joint with less friction can be too fast.
    for rotor in _rotors(robot):
        for one in several:
            changes = {**one.changes, **rotor.changes}
            yield Remedy(text=f"{one.text} and {rotor.text}", changes=changes)


def drag_remedies(robot: Robot, name: str, units: Sequence[float]) -> Iterator[Remedy]:
    """Yield less drag: that of like joints, the share that others lose, another unit, or what the row states."""
    row, limits = f"robot-{name}", loads_nm(robot)
    values, dofs = getattr(robot.model, f"dof_{name}"), robot.model.jnt_dofadr
    usual = {
        int(dofs[joint]): float(values[dofs[other]])
        for joint, (quantity, other) in odd_motors(robot).items()
        if quantity == name
    }
    yield from elements_remedy(robot, of_elements(f"dof_{name}", usual))
    changes = dict(ROWS[row](robot).changes)
    wrong = [dof for dof in limits if dof in changed_rows(changes, f"dof_{name}")]
    shares = {dof: float(values[dof]) / limits[dof] for dof in limits}
    right = [shares[dof] for dof in limits if dof not in wrong and shares[dof] > 0.0]
    if right and wrong:
        # Where the engine makes other joints' dry friction a drag, it can be larger.
        share = min(float(np.median(right)), *(shares[dof] for dof in wrong))
        larger = [dof for dof in wrong if shares[dof] > share]
        found = {dof: rounded(share * limits[dof]) for dof in larger}
        yield from elements_remedy(robot, of_elements(f"dof_{name}", found))
    for unit in units:
        found = {dof: rounded(values[dof] / unit) for dof in wrong}
        yield from elements_remedy(robot, of_elements(f"dof_{name}", found))
    yield from elements_remedy(
        robot, {key: rounded(float(value)) for key, value in changes.items()}
    )


@remedies_of("robot-dry")
def _dry(robot: Robot) -> Iterator[Remedy]:
    off = switched_off(robot.model, "constraint", "frictionloss")
    switched = dict.fromkeys(off, True)
    if off:
        yield Remedy(text=enabling(off), changes=switched)
    yield from rotor_remedies(robot)
    for one in elements_remedy(robot, dict(ROWS["robot-dry"](robot).changes)):
        text = f"{enabling(off)} and {one.text}" if off else one.text
        yield replace(one, text=text, changes=switched | dict(one.changes))
