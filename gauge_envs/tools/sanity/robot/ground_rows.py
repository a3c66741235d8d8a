"""Judge the contacts of feet and fingers that a model states, its ground, and contacts of its parts with each other."""

import copy
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.model_settings import COLUMNS, can_move
from gauge_envs.scene import GRAVITY_M_PER_S2
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
    ancestors,
    disable_bit,
    enabling,
    grasp_kinds,
    joints_of_motors,
    once,
    random_poses,
    switched_off,
)

MOST_BETWEEN = 4
"""Links of a chain whose parts overlap, of which one may be misplaced."""

WEIGHTLESS = 0.01
"""Gravity over that of the earth below which no ground carries anything."""

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
        keys = ("geom_contype", "geom_conaffinity")
        own = np.isin(robot.model.geom_bodyid, robot.bodies)
        if not (robot.model.geom_contype | robot.model.geom_conaffinity)[own].any():
            return Finding(
                value=1.0,
                remark=f"no shape of the robot can touch anything, so that it falls through {name}",
                advice="contype and conaffinity of the class of its shapes that touch",
            )
        return Finding(
            value=1.0,
            remark=f"{name}: the robot falls through it",
            advice=f'contype="1" conaffinity="1" for {name}',
            changes={f"{key}[{plane}]": 1 for key in keys},
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
    floor = int(next(g for g in robot.pairs.geoms[robot.foot_rows[0]] if g not in lows))
    offers = {
        "geom_contype": model.geom_conaffinity,
        "geom_conaffinity": model.geom_contype,
    }
    changes = {
        f"{key}[{geom}]": int(other[floor]) or 1
        for geom in lame
        for key, other in offers.items()
    }
    names = ", ".join(shortened([geom_name(robot.model, geom) for geom in lame]))
    return Finding(
        value=float(len(lame)),
        parts={geom_name(model, geom): 1.0 for geom in lame},
        remark=f"{names}: no partner on the ground" if lame else "",
        advice=f"contype and conaffinity of {names} that match the ground's",
        changes=changes,
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
    slippery = [geom for geom, grip in grips.items() if grip < 0.1]
    name = geom_name(model, slipperiest)

    def condim_of(geom: int) -> int:
        # Of a pad without friction, nothing says that it holds no torque.
        return int(model.geom_condim[geom]) if has_friction[geom] else 4

    return Finding(
        value=grips[slipperiest],
        parts={geom_name(model, geom): grip for geom, grip in grips.items()},
        remark=f"{name}, a finger",
        advice=f'condim="{condim_of(slipperiest)}" friction="1 0.005 0.0001" priority="1" for {name} and pads like it',
        changes={
            f"geom_{key}[{geom}]": value
            for geom in slippery
            for key, value in (
                ("condim", condim_of(geom)),
                ("priority", 1),
                ("friction", np.array([1.0, 0.005, 0.0001])),
            )
        },
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
    changes: dict[str, Any] = {}
    for one in slippery:
        for geom in robot.pairs.geoms[one].tolist():
            changes |= {
                f"geom_condim[{geom}]": 3,
                f"geom_friction[{geom}]": np.array([0.8, 0.005, 0.0001]),
            }
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
        advice=f'condim="3" friction="0.8 0.005 0.0001" for {names}',
        changes=changes,
    )


@row("robot-floor-friction")
def _floor_friction(robot: Robot) -> Finding:
    if not robot.foot_rows:
        return Finding(declined=NOT_STANDING)
    model, found = robot.model, Finding(value=1.0)
    ratios: dict[str, float] = {}
    changes: dict[str, Any] = {}
    _, largest = limits_of("robot-floor-friction")
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
        # With its priority, its condim counts too.
        condim = int(robot.pairs.constants[contact, 0])
        has_condim = int(model.geom_condim[geom]) >= condim
        if met / smallest > largest:
            changes[f"geom_priority[{geom}]"] = 1
            if not has_condim:
                changes[f"geom_condim[{geom}]"] = condim
        if met / smallest > found.value:
            found = Finding(
                value=met / smallest,
                remark=f"{geom_name(robot.model, geom)} states {min(stated):g}, and the foot meets {met:g}",
                advice='priority="1"'
                + ("" if has_condim else f' condim="{condim}"')
                + f" for {geom_name(robot.model, geom)}",
            )
    geoms = sum(name.startswith("geom_priority") for name in changes)
    several = f" and {geoms - 1} more" if geoms > 1 else ""
    return replace(
        found, parts=ratios, changes=changes, advice=f"{found.advice}{several}"
    )


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
        advice=f'zaxis="0 0 1" for {geom_name(robot.model, geom)}',
        changes={f"geom_quat[{geom}]": np.array([1.0, 0.0, 0.0, 0.0])}
        if not model.geom_bodyid[geom]
        else {},
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
        advice=enabling(["contact"]),
        changes={"contact": True},
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
        advice=_apart(robot, worst, names[worst]),
        advisory=advisory,
    )


def _apart(robot: Robot, pair: tuple[int, int], names: str) -> str:
    """Return what keeps two parts apart: what places the links of the chain between them, or their pair."""
    first, second = (ancestors(robot.model, body) for body in pair)
    between = sorted(first ^ second)
    advice = f"exclude the pair {names}, make its geoms smaller, or state a keyframe with them apart"
    if len(between) > MOST_BETWEEN:
        return advice
    links = ", ".join(body_name(robot, body) for body in between)
    return f"pos and quat (w x y z) of {links}; where they are right, {advice}"
