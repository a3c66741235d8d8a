"""Judge the robot as a whole: its size and medium, what its stops and couplings hold, and how it stands on its feet."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gauge_envs.backends.mujoco.model_settings import COLUMNS
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    NotApplicableError,
    body_name,
    by_joint,
    joint_name,
    limits_of,
    name_of,
    row,
    standing_of,
)
from gauge_envs.tools.sanity.robot.ground_rows import (
    fingers,
    geoms_of,
    limbs_of,
    pair_name,
)
from gauge_envs.tools.sanity.robot.joints import SAME_MASS, driven_dofs, start
from gauge_envs.tools.sanity.robot.legs import wrong_knees
from gauge_envs.tools.sanity.robot.mass_rows import SIGNS, box_corners, size_m
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    first_moving_body,
    geom_name,
    joints_of,
    support_m,
)
from gauge_envs.tools.sanity.robot.robot import Robot, couplings_of, joints_of_motors

UNSTATED_KG_PER_M3 = 1000.0
"""Density of a geom that states none [kg/m^3]."""

SAME_PLACE = 0.3
"""Overlap of the boxes around two sets of geoms, over the box around both, from which on they show the same part."""

VISCOUS_LENGTH_M = 0.1
"""Size of a link, by which the viscosity of a medium becomes a pressure at 1 m/s [m]."""

MOST_GIVE = 1.0
"""Largest displacement at which a stop or a coupling is tried [rad or m]."""

GIVE_STEPS = 14
"""Number of halvings in which the displacement under a load is found, to less than 0.1 mrad."""

STOP_RAD_PER_S2 = 100.0
"""Acceleration that a stop takes up at most: that of a strong motor [rad/s^2]."""

LEAST_STEPS, BOUNCING = 0.5, 0.2
"""Steps in the time constant of a stop, and its damping ratio, below which it throws back; makers have 1 and 1."""

LEAST_TIP_M = 0.0025
"""Size below which a geom is a point of a larger pad; MuJoCo's default torsional friction of 5 mm fits it [m]."""

MOST_TORSION_M = 0.1
"""Torsional or rolling friction from which on, beyond the sliding one, the three are in another order [m]."""

LYING_DEG = 90.0
"""Lean of a robot that lies [degrees]; what a knee that bends the wrong way counts."""

LYING_SHARE = 0.2
"""Height of the centre of mass over the size of a robot below which it lies; 0.5 of a standing one."""

SAME_LEG_M = 0.01
"""Distance up to which two legs part from the same place [m]."""


# --- size, mass, medium ----------------------------------------------------------------------------------------------


@row("robot-size")
def _size(robot: Robot) -> Finding:
    if not robot.bodies:
        return Finding(declined="the model has no robot")
    diagonal_m = size_m(robot)
    if not diagonal_m:
        return Finding(declined="the robot has no shape")
    unit = "millimetres" if diagonal_m > 1.0 else "kilometres"
    return Finding(
        value=diagonal_m,
        remark=f"{robot.mass_kg:.3g} kg",
        advice=f"lengths in metres, not in {unit}: `pos`, `size`, `fromto` and the `scale` of meshes",
    )


@row("robot-visual-mass")
def _visual_mass(robot: Robot) -> Finding:
    spec, model = robot.spec, robot.model
    if spec is None or not robot.bodies:
        return Finding(declined="the geoms that give a body its mass are not known")
    can_collide = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    in_pairs = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    bare = spec.copy()
    drawn: dict[int, list[int]] = {}
    for body in robot.bodies:
        geoms = geoms_of(robot, body)
        solid = [geom for geom in geoms if can_collide[geom] or geom in in_pairs]
        visual = [geom for geom in geoms if geom not in solid]
        if solid and visual and _overlap(model, solid, visual) > SAME_PLACE:
            drawn[body] = visual
    numbers = {geom for geoms in drawn.values() for geom in geoms}
    for geom, original in zip(bare.geoms, spec.geoms, strict=True):
        if original.id in numbers:
            geom.mass = 0.0
    try:
        with warnings.catch_warnings():
            # What the compiler warns of was said as the model was read.
            warnings.simplefilter("ignore")
            masses = bare.compile().body_mass
    except ValueError:
        return Finding(declined="bodies have the mass of their visual geoms alone")
    extra_kg = {
        body: float(model.body_mass[body] - masses[body])
        for body in drawn
        if model.body_mass[body] - masses[body] > 1e-6 and masses[body] > 0.0
    }
    counted = {geom for body in extra_kg for geom in drawn[body]}
    total_kg = robot.mass_kg
    names = ", ".join(body_name(robot, body) for body in list(extra_kg)[:3])
    stated_kg = total_kg - sum(extra_kg.values())
    return Finding(
        value=sum(extra_kg.values()) / stated_kg,
        parts={body_name(robot, body): kg / stated_kg for body, kg in extra_kg.items()},
        remark=f"{total_kg:.3g} kg for {stated_kg:.3g} kg, in {names}"
        if extra_kg
        else "",
        advice='mass="0" for visual geoms, or <compiler inertiagrouprange> of the others',
        changes={f"geom_mass[{geom}]": 0.0 for geom in counted},
        is_usual=all(_is_meant(geom) for geom in spec.geoms if geom.id in counted),
    )


def _is_meant(geom: mujoco.MjsGeom) -> bool:
    """Return whether a drawn geom can be a part with its own mass: it states one, or a density, or is no mesh."""
    is_stated = np.isfinite(geom.mass) or geom.density != UNSTATED_KG_PER_M3
    return bool(is_stated or geom.type != mujoco.mjtGeom.mjGEOM_MESH)


def _overlap(model: mujoco.MjModel, first: list[int], second: list[int]) -> float:
    """Return the volume that the boxes around two sets of geoms of a body share, over that of the box around both."""
    corners, others = box_corners(model, first), box_corners(model, second)
    low, high = corners.min(axis=0), corners.max(axis=0)
    other_low, other_high = others.min(axis=0), others.max(axis=0)
    shared = np.clip(np.minimum(high, other_high) - np.maximum(low, other_low), 0, None)
    around = np.maximum(high, other_high) - np.minimum(low, other_low)
    return float(shared.prod() / max(around.prod(), 1e-18))


@row("robot-medium")
def _medium(robot: Robot) -> Finding:
    model, option = robot.model, robot.model.opt
    wind = float(np.linalg.norm(option.wind))
    pressure_pa = 0.5 * float(option.density) * (1.0 + wind) ** 2
    pressure_pa += float(option.viscosity) / VISCOUS_LENGTH_M
    root = first_moving_body(model, robot.bodies[0]) if robot.bodies else 0
    first = int(model.body_jntadr[root])
    joints = set(range(first, first + int(model.body_jntnum[root])))
    is_fixed = bool(joints & set(joints_of_motors(model).tolist()))
    swims = robot.standing is None and not is_fixed
    medium = f"density {option.density:g} kg/m^3, viscosity {option.viscosity:g} Pa s"
    return Finding(
        value=pressure_pa,
        remark=f"{medium}, wind {wind:g} m/s" if pressure_pa else "",
        advice='<option density="0" viscosity="0" wind="0 0 0"/>, or those of air: 1.2 and 0.000018',
        changes={"density": 0.0, "viscosity": 0.0, "wind": np.zeros(3)},
        advisory="a robot that neither stands nor is driven from a fixed base swims or flies"
        if swims
        else "",
    )


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
            remark=f"{several[0]}: friction {_numbers(friction[turned[0]])}, as in another order",
            advice=f"friction (sliding, torsional, rolling) of {', '.join(several[:3])}",
        )
    rows = robot.foot_rows
    if not rows:
        tips = {geom for body in fingers(robot) for geom in geoms_of(robot, body)}
        touching = [bool(tips & set(two)) for two in pairs.geoms.tolist()]
        rows = np.flatnonzero(touching).tolist()
    if not rows:
        return Finding(declined="no foot and no finger of the robot can touch")
    levers: dict[str, float] = {}
    changes: dict[str, FloatArray] = {}
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
        if lever > largest:
            # The larger friction of two geoms counts.
            fair = np.array([friction[0], 0.005, 0.0001])
            changes |= {f"geom_friction[{geom}]": fair for geom in two}
        if lever > worst:
            worst = lever
            kind = "torsional" if torsion_m >= rolling_m else "rolling"
            found = Finding(
                value=lever,
                parts=levers,
                remark=f"{names}: {kind} friction {max(torsion_m, rolling_m):g} m on {1e3 * reach_m:.3g} mm",
                advice=f'friction="{friction[0]:g} 0.005 0.0001" for {names}'
                + (" and pairs like it" if len(rows) > 1 else ""),
            )
    return replace(found, changes=changes)


# --- stops and couplings ---------------------------------------------------------------------------------------------


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
        remark=f"{name}: solreflimit {_numbers(model.jnt_solref[joint])}, "
        f"solimplimit {_numbers(model.jnt_solimp[joint])}",
        advice=f'solreflimit="0.02 1" solimplimit="0.9 0.95 0.001" for {name} and joints like it',
        changes=changes,
        is_usual=bool(np.isfinite(gives_mrad[dof])),
    )


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:g}" for value in values)


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


# --- statics of two feet ---------------------------------------------------------------------------------------------


def _two_feet(robot: Robot) -> list[list[int]]:
    """Return the limbs of a robot that stands on two feet, each from its foot upwards; one that lost its foot has two.

    The limbs have as many bodies and part from the same body, side by side along the axis of a joint of theirs.
    """
    standing = standing_of(robot)
    limbs = limbs_of(robot)
    feet = [limb for limb in limbs if set(limb) & set(standing.feet)]
    if len(feet) > 2 or not feet:
        raise NotApplicableError("the robot does not stand on two feet")

    def origin(limb: list[int]) -> tuple[int, int]:
        return int(robot.model.body_parentid[limb[-1]]), len(limb)

    alike = [limb for limb in limbs if origin(limb) == origin(feet[0])]
    if len(alike) != 2:
        raise NotApplicableError("the robot does not stand on two like legs")
    data = start(robot)
    places = data.xpos[[int(limb[-1]) for limb in alike]]
    apart_m = places[1] - places[0]
    distance_m = float(np.linalg.norm(apart_m))
    on_limb = np.isin(robot.model.jnt_bodyid, alike[0]) & joints_of(
        robot.model, "HINGE"
    )
    along_m = np.abs(data.xaxis[on_limb] @ apart_m).max(initial=0.0)
    if distance_m > SAME_LEG_M and along_m < 0.5 * distance_m:
        raise NotApplicableError("one of the two legs stands behind the other")
    ground_m = min(float(point[2]) for point in standing.support_m.values())
    if standing_centre(robot, data)[2] - ground_m < LYING_SHARE * size_m(robot):
        raise NotApplicableError("the robot lies in its initial pose")
    return alike


@row("robot-level")
def _level(robot: Robot) -> Finding:
    model, standing = robot.model, standing_of(robot)
    heights_mm = {}
    for limb in _two_feet(robot):
        geoms = [geom for body in limb for geom in geoms_of(robot, body)]
        touching = [geom for geom in geoms if geom in standing.support_m]
        lows = [float(support_m(model, standing.stance, geom)[2]) for geom in touching]
        if not lows:
            return Finding(declined="a foot cannot touch the ground")
        heights_mm[limb[0]] = 1e3 * min(lows)
    lower, upper = sorted(heights_mm, key=heights_mm.__getitem__)
    apart_mm = heights_mm[upper] - heights_mm[lower]
    names = f"{body_name(robot, upper)} above {body_name(robot, lower)}"
    data = start(robot)
    links_mm = 1e3 * abs(float((data.xpos[upper] - data.xpos[lower]) @ robot.up))
    unlike = "lengths, axes and angles"
    if links_mm < 0.5 * apart_mm:
        unlike = "pos and size of the geoms that touch"
    return Finding(
        value=apart_mm / (1e3 * standing.height_m),
        remark=f"{names} by {apart_mm:.3g} mm in the {standing.stance.label}",
        advice=f"the same {unlike} in both legs: {names}",
    )


@row("robot-balance")
def _balance(robot: Robot) -> Finding:
    standing = standing_of(robot)
    limbs = _two_feet(robot)
    data = start(robot)
    if knees := [knee for limb in limbs for knee in wrong_knees(robot, limb, limbs)]:
        names = " and ".join(name_of(robot, knee) for knee in knees)
        return Finding(
            # Two of them are worse than one.
            value=LYING_DEG * len(knees),
            parts=dict.fromkeys((name_of(robot, knee) for knee in knees), LYING_DEG),
            remark=f"towards the toes bends {names}",
            advice=f"the axis and the signs of the range of {names}",
        )
    points = []
    ground = min(float(point[2]) for point in standing.support_m.values())
    for geoms in standing.feet.values():
        for geom in geoms:
            points.append(_sole_points(robot, geom, ground))
    centre = standing_centre(robot, data)
    soles = np.vstack(points)[:, :2]
    outside_m = outside(soles, centre[:2])
    height_m = max(float(centre[2]) - ground, 1e-3)
    return Finding(
        value=float(np.degrees(np.arctan2(outside_m, height_m))),
        remark=f"centre of mass {1e3 * outside_m:.3g} mm outside the feet, {1e3 * height_m:.3g} mm above the ground",
        advice=f"knees that bend the right way, and a pose ({standing.stance.label}) over the feet",
    )


def standing_centre(robot: Robot, data: mujoco.MjData) -> FloatArray:
    """Return the centre of mass of a robot in the frame with z up in which it stands [m], shape [3]."""
    standing = standing_of(robot)
    mass = robot.model.body_mass[robot.bodies]
    centre = mass @ data.xipos[robot.bodies] / mass.sum()
    geom = next(iter(standing.support_m))
    here = standing.stance.positions_m[geom]
    turn = standing.stance.rotations[geom].as_matrix()
    local = data.geom_xmat[geom].reshape(3, 3).T @ (centre - data.geom_xpos[geom])
    return np.asarray(here + turn @ local)


def _sole_points(robot: Robot, geom: int, ground_m: float) -> FloatArray:
    """Return corners of the box of a geom that lie low, in the frame with z up [m], shape [count, 3]."""
    model, stance = robot.model, standing_of(robot).stance
    box = model.geom_aabb[geom, :3] + SIGNS * model.geom_aabb[geom, 3:]
    corners = stance.positions_m[geom] + stance.rotations[geom].apply(box)
    low = corners[:, 2] <= ground_m + 0.05 * standing_of(robot).height_m
    points: FloatArray = corners[low] if low.any() else corners
    return points


def outside(points: FloatArray, place: FloatArray) -> float:
    """Return the distance of a place from the hull of points in a plane [m]; 0 inside.

    Args:
        points: The points [m], shape [count, 2].
        place: The place [m], shape [2].
    """
    try:
        hull = ConvexHull(points)
    except QhullError:
        return float(np.linalg.norm(points - place, axis=1).min())
    if (hull.equations[:, :2] @ place + hull.equations[:, 2] <= 0.0).all():
        return 0.0
    first, second = points[hull.simplices[:, 0]], points[hull.simplices[:, 1]]
    along = second - first
    share = ((place - first) * along).sum(axis=1) / (along**2).sum(axis=1)
    nearest = first + np.clip(share, 0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(nearest - place, axis=1).min())
