"""Judge what is joined to what: tendons, couplings and loops, fingers, motors, sensors, axes, and objects."""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import combinations

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.copies import FEW_COPIES, SAME, copies_of
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    body_name,
    name_of,
    row,
)
from gauge_envs.tools.sanity.robot.ground_rows import limbs_of
from gauge_envs.tools.sanity.robot.joints import home_key, springs
from gauge_envs.tools.sanity.robot.maker_rows import families
from gauge_envs.tools.sanity.robot.mass_rows import size_m
from gauge_envs.tools.sanity.robot.mirror import mirror_pairs, zero_pose
from gauge_envs.tools.sanity.robot.motor_names import misread_joints
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    ancestors,
    coupled_pairs,
    couplings_of,
    ends_of,
    grasp_kinds,
    joints_of_motors,
    tendon_joints,
)
from gauge_envs.tools.sanity.robot.sides import STRAIGHT
from gauge_envs.tools.sanity.robot.stop_rows import are_twins

BEYOND = 0.02
"""Distance of a pose beyond a range over the range up to which it is at the stop."""

FAR = 2.0
"""Distance of a site from its link over the size of the robot from which on it is not on the robot."""

SIDES = (
    *("left", "right", "l", "r", "fl", "fr", "rl", "rr"),
    *("hl", "hr", "bl", "br", "lf", "rf", "lh", "rh"),
)
"""Words of two sides, in pairs."""

OTHER_SIDE = {
    case(word): case(SIDES[place ^ 1])
    for place, word in enumerate(SIDES)
    for case in (str.lower, str.upper, str.title)
}
"""Words of the sides of a robot, with those of the other side."""

SIDE = re.compile(
    "|".join(
        one if len(one) > 2 else rf"(?<![A-Za-z]){one}(?![A-Za-z])"
        for one in OTHER_SIDE
    )
)

PARTS = (int(mujoco.mjtObj.mjOBJ_JOINT), int(mujoco.mjtObj.mjOBJ_BODY))
"""Kinds of parts whose equalities are compared with those of the other side."""

QUATERNIONS = (("body_quat", 0.35, 0.7), ("body_iquat", 0.03, 0.08))
"""Arrays of quaternions, and differences of a matrix up to which links of a family are turned alike, or unlike."""

COUNTS = {"joint": "njnt", "actuator": "nu", "xbody": "nbody"}
"""Names of the model's counts that are not those of the part, as `nsite`."""

NEARLY = 0.99
"""Cosine of half of the angle between two frames from which on they are one frame."""

Wrong = tuple[str, str]
"""What is wrong, and what to change."""


@row("robot-wiring")
def _wiring(robot: Robot) -> Finding:
    several = [[*check(robot)] for check in CHECKS]
    found = [one for of_check in several for one in of_check]
    proofs = [c for c, of_check in zip(CHECKS, several, strict=True) if of_check]
    remarks = [remark for remark, _ in found]
    advices = [advice for _, advice in found]
    return Finding(
        value=float(len(found)),
        parts=dict.fromkeys(remarks, 1.0),
        remark="; ".join(remarks),
        advice="; ".join(advices),
        is_usual={*proofs} <= {*UNUSUAL},
    )


def _left_out(robot: Robot) -> Iterator[Wrong]:
    """Yield joints that nothing moves, though a motor, tendon, coupling or spring moves their copies."""
    model = robot.model
    is_tendon = model.wrap_type == int(mujoco.mjtWrap.mjWRAP_JOINT)
    several = [joints_of_motors(model), np.flatnonzero(springs(model))]
    several += [coupled_pairs(model).ravel(), model.wrap_objid[is_tendon]]
    is_moved = np.isin(np.arange(model.njnt), np.concatenate(several))
    is_own = np.isin(model.jnt_bodyid, robot.bodies)
    joints = np.flatnonzero(is_own & joints_of(model, "HINGE", "SLIDE"))
    for place, is_copy in enumerate(copies_of(robot, joints)):
        copies, name = joints[is_copy], name_of(robot, int(joints[place]))
        is_odd = is_moved[copies].all() and not is_moved[joints[place]]
        if is_odd and len(copies) >= FEW_COPIES:
            others = " and ".join(name_of(robot, int(one)) for one in copies[:2])
            remark = f"no motor, tendon or coupling moves {name}, as they move {others}"
            yield remark, f"the joint {name} in its motor, tendon or coupling"


def _sides(robot: Robot) -> Iterator[Wrong]:
    """Yield couplings and loops that the other side has not, or has with another ratio."""
    model, is_joint = robot.model, couplings_of(robot.model)
    pairs = mirror_pairs(robot)
    signs = {frozenset((o.joint, o.other)): np.sign(o.cosine) for o in pairs}
    ends = np.column_stack([model.eq_obj1id, model.eq_obj2id]).tolist()
    for number, two in enumerate(ends):
        kind, names = ends_of(model, number)
        if kind not in PARTS or len(names) < 2:
            continue
        others = [_other_side(name) for name in names]
        imaged = [mujoco.mj_name2id(model, kind, name) for name in others]
        if min(imaged) < 0 or {*imaged} == {*two}:
            continue
        text, other = " and ".join(names), " and ".join(others)
        is_joined = np.isin(imaged, ends).all()
        if imaged not in ends and imaged[::-1] not in ends and not is_joined:
            yield (
                f"an equality joins {text}, and none {other}",
                f"the same equality for {other}",
            )
        elif imaged in ends[number:]:
            both = [number, ends.index(imaged)]
            # A part in the middle, or a name that says another image, tells no sign.
            sign = np.prod(
                [signs.get(frozenset(e), 0.0) for e in zip(two, imaged, strict=True)]
            )
            first, second = model.eq_data[both, 1]
            if sign == 0.0:
                first, second = abs(first), abs(second)
            else:
                second *= sign
            if is_joint[number] and not np.isclose(first, second, rtol=SAME):
                advice = f"polycoef of {text} and of {other}: which is the wrong one?"
                yield (
                    f"the equalities of {text} and of {other} are no mirror images",
                    advice,
                )


def _other_side(name: str) -> str:
    """Return the name of the same part of the other side; the name itself where it says no side."""
    return SIDE.sub(lambda found: OTHER_SIDE[found[0]], name)


def _excluded(robot: Robot) -> Iterator[Wrong]:
    """Yield links that touch nothing of each other though those of the other side do, where most sides agree."""
    model = robot.model
    known = {model.body(body).name for body in range(model.nbody)}
    stated = {
        frozenset(model.body(one).name for one in (pair >> 16, pair & 0xFFFF))
        for pair in model.exclude_signature.tolist()
    }
    imaged = {two: frozenset(map(_other_side, two)) for two in stated}
    aside = [two for two in stated if imaged[two] != two and imaged[two] <= known]
    odd = [two for two in aside if imaged[two] not in stated]
    if odd and 2 * len(odd) <= len(aside):
        text, other = (
            ", ".join(sorted(" and ".join(sorted(one)) for one in several))
            for several in (odd, [imaged[two] for two in odd])
        )
        yield (
            f"contacts of {text} are excluded, and not those of {other}",
            f"excludes of both sides that agree: {text}, {other}",
        )


def _carried(robot: Robot) -> Iterator[Wrong]:
    """Yield a limb without gravcomp beside two others or more of its palm, all of whose links have it."""
    model, limbs = robot.model, limbs_of(robot)
    roots = np.array([limb[-1] for limb in limbs], int)
    palms = model.body_parentid[roots]
    is_carried = np.array([model.body_gravcomp[limb].all() for limb in limbs], bool)
    for palm in np.unique(palms).tolist():
        odd = roots[(palms == palm) & ~is_carried].tolist()
        if len(odd) == 1 and (palms == palm).sum() > FEW_COPIES:
            name = body_name(robot, odd[0])
            yield (
                f"{name} has no gravcomp, or what it carries, and all limbs beside it do",
                f"gravcomp of {name} and what it carries",
            )


def _turned_base(robot: Robot) -> Iterator[Wrong]:
    """Yield free bodies that a keyframe turns, and not with their quaternion in the order x y z w."""
    model = robot.model
    for joint in np.flatnonzero(joints_of(model, "FREE")).tolist():
        first = int(model.jnt_qposadr[joint]) + 3
        stated = model.qpos0[first : first + 4]
        for key in range(model.nkey):
            turned = model.key_qpos[key, first : first + 4]
            near, read = abs(turned @ stated), abs(np.roll(turned, 1) @ stated)
            if near < 0.5 and read > NEARLY:
                name = body_name(robot, int(model.jnt_bodyid[joint]))
                yield (
                    f"the keyframe {model.key(key).name or key} turns {name} unlike the model, and like it with its "
                    "quaternion in the order x y z w",
                    f"the quaternion of {name} in the keyframe in the order w x y z",
                )


def _tendons(robot: Robot) -> Iterator[Wrong]:
    """Yield fixed tendons whose coefficients are not those of the mirror image, or of the tendons of like fingers."""
    model = robot.model
    images = {one.joint: one.other for one in mirror_pairs(robot)}
    images |= {other: joint for joint, other in images.items()}
    several = {
        tendon: dict(zip(joints.tolist(), np.abs(sizes), strict=True))
        for tendon in range(model.ntendon)
        for joints, sizes in [tendon_joints(model, tendon)]
        if len(joints) > 1
    }
    for (one, first), (other, second) in combinations(several.items(), 2):
        partners = [images.get(joint, -1) for joint in first]
        if {*partners} != {*second}:
            continue
        sizes = np.array([[*first.values()], [second[joint] for joint in partners]])
        if not np.allclose(sizes[0], sizes[1], rtol=SAME):
            both = f"{model.tendon(one).name} and {model.tendon(other).name}"
            text = " and ".join(str(one) for one in sizes.tolist())
            yield (
                f"the coefficients of the tendons {both} are no mirror images: {text}",
                f"the coef of {both}: which is the wrong one?",
            )


def _fingers(robot: Robot) -> Iterator[Wrong]:
    """Yield two like fingers on slides of the same range that move the same way: they close on nothing."""
    model, axes = robot.model, zero_pose(robot).xaxis
    is_slide = joints_of(model, "SLIDE") & (model.jnt_limited != 0)
    is_slide &= np.isin(model.jnt_bodyid, robot.bodies)
    slides = np.flatnonzero(is_slide).tolist()
    twins = [both for both in combinations(slides, 2) if are_twins(model, *both)]
    counts = Counter(joint for both in twins for joint in both)
    # Springs of four wheels are like each other, and no fingers.
    for joint, other in (both for both in twins if counts[both[0]] == 1):
        first, second = model.jnt_range[[joint, other]]
        is_same, is_turned = (
            np.allclose(first, second),
            np.allclose(first, -second[::-1]),
        )
        if is_same == is_turned:
            continue
        sign = 1.0 if is_same else -1.0
        if sign * float(axes[joint] @ axes[other]) > 1.0 - SAME:
            names = f"{name_of(robot, joint)} and {name_of(robot, other)}"
            yield (
                f"the fingers {names} slide the same way",
                f"the axis or the range of {names}",
            )


def _sensors(robot: Robot) -> Iterator[Wrong]:
    """Yield sensors that read another part than their name says, and sites far away."""
    model, data = robot.model, zero_pose(robot)
    sites = [model.site(site).name for site in range(model.nsite)]
    kinds = np.column_stack([model.sensor_type, model.sensor_objtype])
    for of_type, kind in np.unique(kinds, axis=0).tolist():
        what = mujoco.mjtObj(kind).name.removeprefix("mjOBJ_").lower()
        count = getattr(model, COUNTS.get(what, f"n{what}"), 0)
        names = [mujoco.mj_id2name(model, kind, one) or "" for one in range(count)]
        sensors = np.flatnonzero((kinds == (of_type, kind)).all(axis=1)).tolist()
        if not count:
            continue
        said = [model.sensor(sensor).name for sensor in sensors]
        read = [names[model.sensor_objid[sensor]] for sensor in sensors]
        for place, meant in misread_joints(said, read, names).items():
            # Only joints and motors have names of one kind; of others, one that two sensors of a type read was copied.
            if what not in ("joint", "actuator") and read.count(read[place]) < 2:
                continue
            yield (
                f"sensor {said[place]} reads {read[place]}",
                f"{what} {meant} for the sensor {said[place]}",
            )
    for site in np.flatnonzero(np.isin(model.site_bodyid, robot.bodies)).tolist():
        away_m = np.linalg.norm(
            data.site_xpos[site] - data.xipos[model.site_bodyid[site]]
        )
        if away_m > FAR * size_m(robot):
            yield (
                f"site {sites[site]} lies {away_m:.3g} m away from its link",
                f"pos of the site {sites[site]} in metres",
            )


def _ghosts(robot: Robot) -> Iterator[Wrong]:
    """Yield a jaw or fingertip of a fixed base none of whose shapes touch anything, though those of the others do.

    Where there are no others, those of the link that carries it.
    """
    if robot.is_floating:
        return
    model = robot.model
    is_solid = (model.geom_contype | model.geom_conaffinity) != 0
    carriers = {int(model.body_weldid[model.body_parentid[b]]) for b in robot.bodies}
    lasts = [
        body
        for body in robot.bodies
        if model.body_dofnum[body] and body not in carriers
    ]
    touching = {}
    for body in {*lasts, *carriers}:
        geoms = np.flatnonzero(model.body_weldid[model.geom_bodyid] == body)
        if len(geoms):
            touching[body] = bool(is_solid[geoms].any())
    for body in lasts:
        carrier = int(model.body_weldid[model.body_parentid[body]])
        others = [touching[one] for one in lasts if one != body and one in touching]
        compared = others or [touching.get(carrier, False)]
        if not touching.get(body, True) and all(compared):
            name = body_name(robot, body)
            yield (
                f"no shape of {name} can touch anything",
                f"contype and conaffinity of a shape of {name}",
            )


def _beyond(robot: Robot) -> Iterator[Wrong]:
    """Yield joints that the first keyframe places beyond their range."""
    model = robot.model
    if not model.nkey:
        return
    pose = model.key_qpos[home_key(model)]
    is_own = np.isin(model.jnt_bodyid, robot.bodies) & (model.jnt_limited != 0)
    for joint in np.flatnonzero(is_own & joints_of(model, "HINGE", "SLIDE")).tolist():
        low, high = model.jnt_range[joint]
        place = float(pose[model.jnt_qposadr[joint]])
        if not low - BEYOND * (high - low) <= place <= high + BEYOND * (high - low):
            name = name_of(robot, joint)
            yield (
                f"the keyframe places {name} at {place:.3g}, beyond its range of {low:.3g} to {high:.3g}",
                f"the range of {name}, or its place in the keyframe",
            )


def _quaternions(robot: Robot) -> Iterator[Wrong]:
    """Yield links whose quaternion turns them unlike all of their family, and like them in the order x y z w."""
    model, data = robot.model, zero_pose(robot)
    bodies = {body_name(robot, body): body for body in robot.bodies}
    several = families(bodies)
    depths = {body: len(ancestors(model, body)) for body in robot.bodies}
    for array, near, far in QUATERNIONS:
        is_of_link = array == "body_quat"
        stated, read = (
            {body: _turned(model, data, body, array, roll) for body in bodies.values()}
            for roll in (0, 1)
        )
        turning = {
            n: b
            for n, b in bodies.items()
            if abs(getattr(model, array)[b, 0]) < STRAIGHT
        }
        for name, body in turning.items():
            moments = np.sort(model.body_inertia[body])
            for family in several.get(name, ()):
                others = [
                    bodies[one]
                    for one in family - {name}
                    if depths[bodies[one]] == depths[body]
                    and (
                        is_of_link
                        or np.allclose(
                            np.sort(model.body_inertia[bodies[one]]), moments, rtol=SAME
                        )
                    )
                ]
                # One of three fingers may be turned by half on purpose, as an identity in another order is.
                is_half_turn = abs(model.body_quat[body, 0]) < SAME
                if len(others) < (FEW_COPIES + is_half_turn if is_of_link else 1):
                    continue
                places = np.array([stated[one] for one in others])
                is_family = np.abs(places - places[0]).max() < near
                off = np.abs(places - stated[body]).max(axis=(1, 2)).min()
                if is_family and off > far and np.abs(places - read[body]).max() < near:
                    what = "" if is_of_link else "inertial "
                    yield (
                        f"{name} is turned unlike {body_name(robot, others[0])}, and like it with its {what}quat "
                        "in the order x y z w",
                        f"the {what}quat of {name} in the order w x y z",
                    )
                    break


def _turned(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, array: str, roll: int
) -> FloatArray:
    """Return how a quaternion turns a link in the world, or the sizes of its inertia over their trace, shape [3, 3].

    Args:
        model: The model.
        data: Its pose.
        body: The link.
        array: Array of the quaternion.
        roll: 1 for the quaternion taken in the order x y z w, 0 for the order of the engine.
    """
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.roll(getattr(model, array)[body], roll))
    axes = matrix.reshape(3, 3)
    if array == "body_quat":
        turned: FloatArray = data.xmat[model.body_parentid[body]].reshape(3, 3) @ axes
        return turned
    inertia = model.body_inertia[body]
    sizes: FloatArray = np.abs((axes * inertia) @ axes.T) / max(inertia.sum(), 1e-12)
    return sizes


def _objects(robot: Robot) -> Iterator[Wrong]:
    """Yield free objects that touch something, and that no part of a robot on a fixed base can touch."""
    model, pairs = robot.model, robot.pairs
    if robot.standing is not None or not len(joints_of_motors(model)):
        return
    bodies = model.geom_bodyid[pairs.geoms]
    grasping = {*bodies[grasp_kinds(model, pairs) > 0].ravel().tolist()}
    free = {*model.jnt_bodyid[joints_of(model, "FREE")].tolist()} - {*robot.bodies}
    for body in sorted(free & {*bodies.ravel().tolist()} - grasping):
        name = body_name(robot, body)
        yield (
            f"no part of the robot can touch {name}, and others can",
            f"contype and conaffinity of the robot's geoms and of {name} that match",
        )


CHECKS: tuple[Callable[[Robot], Iterator[Wrong]], ...] = (
    _objects,
    _sides,
    _excluded,
    _carried,
    _turned_base,
    _tendons,
    _left_out,
    _fingers,
    _sensors,
    _quaternions,
    _ghosts,
    _beyond,
)
"""What is tried, causes before their effects."""

UNUSUAL = (_objects, _excluded, _carried, _turned_base, _left_out, _ghosts)
"""What some robots have on purpose."""
