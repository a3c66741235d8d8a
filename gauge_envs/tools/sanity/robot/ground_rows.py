"""Judge the contacts of feet and fingers that a model states, its ground, and contacts of its parts with each other."""

import copy
from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.pages.text import vector_text
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.bench.model_settings import COLUMNS, can_move
from gauge_envs.tools.sanity.robot.finding import (
    NOT_STANDING,
    Finding,
    body_name,
    limits_of,
    row,
    standing_of,
)
from gauge_envs.tools.sanity.robot.joints import start
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    SOLE_WITHIN,
    geom_name,
    joints_of,
    shortened,
    support_m,
)
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    disable_bit,
    grasp_kinds,
    joints_of_motors,
    once,
    random_poses,
    switched_off,
)

WEIGHTLESS = 0.01
"""Gravity over that of the earth below which no ground carries anything."""

LEAST_TIP_M = 0.0025
"""Size below which a geom is a point of a larger pad; MuJoCo's default torsional friction of 5 mm fits it [m]."""

MOST_TORSION_M = 0.1
"""Torsional or rolling friction from which on, beyond the sliding one, the three are in another order [m]."""

TRIED = 32
"""Random poses in which the overlap of two parts is tried."""


def limbs_of(robot: Robot) -> list[list[int]]:
    """Return the bodies of each limb: those behind a body from which at least two limbs part.

    A rod whose end an equality holds closes a chain, and is no limb.
    """
    model = robot.model
    is_body = model.eq_objtype == int(mujoco.mjtObj.mjOBJ_BODY)
    tied = {*model.eq_obj1id[is_body].tolist(), *model.eq_obj2id[is_body].tolist()}
    children = {
        body: [b for b in robot.bodies if int(model.body_parentid[b]) == body]
        for body in robot.bodies
    }
    parting = {body for body, several in children.items() if len(several) > 1}
    limbs = []
    for leaf in (body for body, several in children.items() if not several):
        if leaf in tied:
            continue
        chain = [leaf]
        while (
            parent := int(model.body_parentid[chain[-1]])
        ) in children and parent not in parting:
            chain.append(parent)
        limbs.append(chain)
    return limbs


def _untouched_plane(robot: Robot) -> int | None:
    """Return the plane of the world that no geom of a robot with a free joint can touch; None without one."""
    model = robot.model
    is_plane = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    planes = np.flatnonzero(is_plane & (model.geom_bodyid == 0)).tolist()
    is_free = joints_of(model, "FREE") & np.isin(model.jnt_bodyid, robot.bodies)
    has_motors = bool(len(joints_of_motors(model)))
    if not (planes and is_free.any() and has_motors):
        return None
    touching = set(np.unique(robot.pairs.geoms).tolist())
    return None if touching & set(planes) else planes[0]


@row("robot-feet")
def _feet(robot: Robot) -> Finding:
    if (plane := _untouched_plane(robot)) is not None:
        name = geom_name(robot.model, plane)
        own = np.isin(robot.model.geom_bodyid, robot.bodies)
        if not (robot.model.geom_contype | robot.model.geom_conaffinity)[own].any():
            return Finding(
                value=1.0,
                remark=f"no shape of the robot can touch anything, so that it falls through {name}",
            )
        return Finding(
            value=1.0,
            remark=f"{name}: the robot falls through it",
        )
    model, standing = robot.model, standing_of(robot)
    within = SOLE_WITHIN * standing.height_m
    geoms = [geom for body in robot.bodies for geom in geoms_of(robot, body)]
    lows = {geom: float(support_m(model, standing.stance, geom)[2]) for geom in geoms}
    touching = {geom: low for geom, low in lows.items() if geom in standing.support_m}
    lowest, ground = min(lows.values()), min(touching.values())
    lame = []
    for limb in limbs_of(robot):
        geoms = [geom for body in limb for geom in geoms_of(robot, body)]
        reach = min((lows[geom] for geom in geoms), default=np.inf)
        if (
            reach <= lowest + within
            and min(touching.get(geom, np.inf) for geom in geoms) > ground + within
        ):
            lame += [geom for geom in geoms if lows[geom] <= reach + within]
    if not lame and ground > lowest + within:
        lame = [geom for geom, low in lows.items() if low <= lowest + within]
    names = ", ".join(shortened([geom_name(robot.model, geom) for geom in lame]))
    return Finding(
        value=float(len(lame)),
        parts={geom_name(model, geom): 1.0 for geom in lame},
        remark=f"{names}: no partner on the ground" if lame else "",
        is_usual=True,
    )


def pair_name(robot: Robot, number: int) -> str:
    """Return the names of the two geoms of a row of `pairs`."""
    geoms = robot.pairs.geoms[number].tolist()
    return " with ".join(geom_name(robot.model, geom) for geom in geoms)


def geoms_of(robot: Robot, body: int) -> list[int]:
    """Return the geoms of a body."""
    first = int(robot.model.body_geomadr[body])
    return list(range(first, first + int(robot.model.body_geomnum[body])))


def fingers(robot: Robot) -> list[int]:
    """Return the bodies of the fingers of a robot: the last ones of limbs that part from one body.

    Limbs that part from a floating body are legs.
    """
    if robot.standing is not None:
        return []
    model = robot.model
    floating = {*model.jnt_bodyid[joints_of(model, "FREE")].tolist()}
    limbs = limbs_of(robot)
    origins = [int(model.body_parentid[limb[-1]]) for limb in limbs]
    return [
        limb[0]
        for limb, origin in zip(limbs, origins, strict=True)
        if origins.count(origin) > 1 and origin not in floating
    ]


def _finger_friction(robot: Robot) -> Finding:
    """Return the least friction that a finger meets on what it can hold, or states where the model has no such body."""
    model, tips = robot.model, {g for b in fingers(robot) for g in geoms_of(robot, b)}
    if not tips:
        return Finding(declined=f"{NOT_STANDING}, and none has fingers")
    grips: dict[int, float] = {}
    for number in np.flatnonzero(grasp_kinds(model, robot.pairs)).tolist():
        condim, friction = robot.pairs.constants[number, :2]
        for geom in tips & set(robot.pairs.geoms[number].tolist()):
            met = float(friction) if condim > 1 else 0.0
            grips[geom] = min(met, grips.get(geom, np.inf))
    touching = tips & set(robot.pairs.geoms.ravel().tolist())
    has_friction = model.geom_condim > 1
    grips = grips or {
        geom: float(model.geom_friction[geom, 0] * has_friction[geom])
        for geom in touching
    }
    if not grips:
        return Finding(declined="no finger can touch anything")
    slipperiest = min(grips, key=grips.__getitem__)
    name = geom_name(model, slipperiest)

    return Finding(
        value=grips[slipperiest],
        parts={geom_name(model, geom): grip for geom, grip in grips.items()},
        remark=f"{name}, a finger",
    )


@row("robot-friction")
def _friction(robot: Robot) -> Finding:
    if not robot.foot_rows:
        return _finger_friction(robot)
    constants = robot.pairs.constants
    grips = {
        row: 0.0 if constants[row, 0] == 1 else constants[row, 1]
        for row in robot.foot_rows
    }
    row = min(
        grips, key=lambda one: grips[one] if min(grips.values()) < 0.1 else -grips[one]
    )
    slippery = [one for one, grip in grips.items() if not 0.1 <= grip <= 2.0]
    names = pair_name(robot, row)
    rule = (
        f"condim {constants[row, 0]:.0f}"
        if constants[row, 0] == 1
        else "max of both, priority or explicit pair"
    )
    return Finding(
        value=float(grips[row]),
        parts={pair_name(robot, one): float(grip) for one, grip in grips.items()},
        remark=f"{names}: {rule}"
        + (f", and {len(slippery) - 1} more pairs" if len(slippery) > 1 else ""),
    )


@row("robot-floor-friction")
def _floor_friction(robot: Robot) -> Finding:
    if not robot.foot_rows:
        return Finding(declined=NOT_STANDING)
    model, found = robot.model, Finding(value=1.0)
    ratios: dict[str, float] = {}
    # What a geom takes from the default of all is no statement about it.
    common = 1.0 if robot.spec is None else float(robot.spec.default.geom.friction[0])
    explicit = {
        tuple(sorted(p))
        for p in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    }
    for contact in robot.foot_rows:
        pair = tuple(robot.pairs.geoms[contact].tolist())
        stated = [float(model.geom_friction[geom, 0]) for geom in pair]
        alike = model.geom_priority[pair[0]] == model.geom_priority[pair[1]]
        met, smallest = (
            float(robot.pairs.constants[contact, COLUMNS["friction"].start]),
            max(min(stated), 1e-3),
        )
        is_stated = abs(min(stated) - common) > 1e-9
        if pair in explicit or not alike or not is_stated:
            continue
        ratios[pair_name(robot, contact)] = met / smallest
        geom = pair[int(np.argmin(stated))]
        if met / smallest > found.value:
            found = Finding(
                value=met / smallest,
                remark=f"{geom_name(robot.model, geom)} states {min(stated):g}, and the foot meets {met:g}",
            )
    return replace(found, parts=ratios)


@row("robot-torsion")
def _torsion(robot: Robot) -> Finding:
    model, pairs = robot.model, robot.pairs
    _, largest = limits_of("robot-torsion")
    friction = model.geom_friction
    is_turned = friction[:, 1:].max(axis=1) > np.maximum(friction[:, 0], MOST_TORSION_M)
    is_turned &= np.isin(model.geom_bodyid, robot.bodies)
    turned = [g for g in np.unique(pairs.geoms).tolist() if is_turned[g]]
    if turned:
        several = [geom_name(model, geom) for geom in turned]
        return Finding(
            value=2.0 * largest,
            parts=dict.fromkeys(several, 2.0 * largest),
            remark=f"{several[0]}: friction {vector_text(friction[turned[0]])}, as in another order",
        )
    rows = robot.foot_rows
    if not rows:
        tips = {geom for body in fingers(robot) for geom in geoms_of(robot, body)}
        touching = [bool(tips & set(two)) for two in pairs.geoms.tolist()]
        rows = np.flatnonzero(touching).tolist()
    if not rows:
        return Finding(declined="no foot and no finger of the robot can touch")
    levers: dict[str, float] = {}
    worst, found = -1.0, Finding()
    for number in rows:
        condim = int(pairs.constants[number, 0])
        friction = pairs.constants[number, COLUMNS["friction"]]
        torsion_m = float(friction[2]) if condim >= 4 else 0.0
        rolling_m = float(friction[3:].max()) if condim >= 6 else 0.0
        two = pairs.geoms[number].tolist()
        parts = [geom for geom in two if int(model.geom_bodyid[geom]) in robot.bodies]
        reach_m = min(float(model.geom_rbound[geom]) or np.inf for geom in parts or two)
        reach_m = max(reach_m, LEAST_TIP_M)
        lever = max(torsion_m, rolling_m) / max(reach_m, 1e-6)
        names = pair_name(robot, number)
        levers[names] = lever
        if lever > worst:
            worst = lever
            kind = "torsional" if torsion_m >= rolling_m else "rolling"
            found = Finding(
                value=lever,
                parts=levers,
                remark=f"{names}: {kind} friction {max(torsion_m, rolling_m):g} m on {1e3 * reach_m:.3g} mm",
            )
    return found


@row("floor-tilt")
def _floor_tilt(robot: Robot) -> Finding:
    model, gravity = robot.model, robot.model.opt.gravity
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    is_colliding = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    is_plane = (
        is_colliding
        & (model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE))
        & ~can_move(model)
    )
    planes = np.flatnonzero(is_plane).tolist()
    if not planes or np.linalg.norm(gravity) < WEIGHTLESS * GRAVITY_M_PER_S2:
        return Finding(declined="the model has no plane, or no gravity")
    cosines = {}
    for plane in planes:
        normal = data.geom_xmat[plane].reshape(3, 3)[:, 2]
        cosines[plane] = float(-normal @ gravity / np.linalg.norm(gravity))
    # Walls and ramps beside a floor are no fault.
    geom = max(cosines, key=cosines.__getitem__)
    angle = float(np.degrees(np.arccos(np.clip(cosines[geom], -1.0, 1.0))))
    return Finding(
        value=angle if angle > 1e-4 else 0.0,
        remark=geom_name(robot.model, geom),
    )


@once
def overlaps(robot: Robot) -> dict[tuple[int, int], tuple[float, float]]:
    """Return depth [m] and normal force [N] of contacts between bodies of a robot in the pose in which it starts."""
    return _overlaps(robot, start(robot))


def _overlaps(
    robot: Robot, data: mujoco.MjData
) -> dict[tuple[int, int], tuple[float, float]]:
    model, force = robot.model, np.zeros(6)
    found: dict[tuple[int, int], tuple[float, float]] = {}
    for number in range(data.ncon):
        contact = data.contact[number]
        first, second = sorted(int(model.geom_bodyid[geom]) for geom in contact.geom)
        is_inside = contact.dist < 0.0 and contact.exclude == 0
        if not {first, second} <= set(robot.bodies) or not is_inside:
            continue
        mujoco.mj_contactForce(model, data, number, force)
        depth_m, push_n = found.get((first, second), (0.0, 0.0))
        found[first, second] = (
            max(depth_m, -float(contact.dist)),
            push_n + float(force[0]),
        )
    return found


def _without_contacts(robot: Robot) -> Finding:
    """Return how deep parts pass through each other in random poses, since contacts are switched off."""
    model = copy.copy(robot.model)
    model.opt.disableflags &= ~disable_bit("contact")
    parts: dict[str, float] = {}
    count = 0
    for data in random_poses(model, TRIED):
        found = _overlaps(robot, data)
        count += bool(found)
        for pair, (depth_m, _) in found.items():
            name = " and ".join(body_name(robot, body) for body in pair)
            parts[name] = max(parts.get(name, 0.0), 1e3 * depth_m)
    if not parts:
        return Finding()
    worst = max(parts, key=parts.__getitem__)
    return Finding(
        value=parts[worst],
        parts=parts,
        remark=f"contacts are switched off: {worst} pass through each other, parts do in {count} of "
        f"{TRIED} random poses",
        is_usual=True,
    )


@row("robot-overlap")
def _overlap(robot: Robot) -> Finding:
    if switched_off(robot.model, "contact"):
        return _without_contacts(robot)
    found = overlaps(robot)
    names = {
        pair: " and ".join(body_name(robot, body) for body in pair) for pair in found
    }
    parts = {names[pair]: 1e3 * depth_m for pair, (depth_m, _) in found.items()}
    if not found:
        return Finding()
    worst = max(found, key=lambda pair: found[pair][0])
    depth_m, _ = found[worst]
    push_n = sum(one for _, one in found.values())
    advisory = ""
    if not robot.model.nkey and 1e3 * depth_m > limits_of("robot-overlap")[1]:
        # A pose of zeros is rarely the one in which code starts.
        poses = [_overlaps(robot, one) for one in random_poses(robot.model, TRIED)]
        often = max(sum(pair in one for one in poses) for pair in found)
        if often < 0.5 * TRIED:
            advisory = (
                "no keyframe states where it starts, and no two of these parts overlap in more than "
                f"{often} of {TRIED} random poses"
            )
    return Finding(
        value=1e3 * depth_m,
        parts=parts,
        remark=f"{names[worst]}; {push_n:.3g} N push parts apart at the first step",
        advisory=advisory,
    )
