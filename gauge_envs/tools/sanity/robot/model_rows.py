"""Judge what the target's own model states: masses, contacts of its feet, and what drives and brakes its joints."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gauge_envs.backends.mujoco.model_settings import COLUMNS, can_move
from gauge_envs.scene import GRAVITY_M_PER_S2, Vector
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model import (
    Cause,
    PartOutcome,
    PhenomenonResult,
    Reality,
    RealityKind,
    Settings,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    SOLE_WITHIN,
    Standing,
    geom_name,
    joints_of,
    shortened,
    support_m,
)
from gauge_envs.tools.sanity.robot.robot import (
    JOINT_TRANSMISSIONS,
    Robot,
    acts_on_joints,
    couplings_of,
    enabling,
    grasp_kinds,
    joints_of_motors,
    once,
    random_poses,
    swapped_motors,
    switched_off,
)

SIGNS = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
"""Signs of the corners of a box, shape [8, 3]."""

FAR_CENTRE = 0.5
"""Distance of a centre of mass from the box around its link, over the diagonal of the box, beyond which it is wrong.

It is 0 in 36 of 38 models of makers, and 0.26 in the Tiago of robosuite.
"""

HEAVY = 9.0
"""Density of a link over the middle one of a robot beyond which it is wrong: at most 6.2 in 28 models of makers."""

WHOLE = "the robot"
"""Part of a row that judges the robot as a whole."""

NOT_STANDING = "no robot of the model stands on the ground under its own weight"

UNIT_ERRORS = {
    1e3: "a density in g/cm^3 or a mass in tonnes",
    1e-3: "a mass in grams",
    1e6: "a mass in kt",
}

MASSLESS_KG = 1e-5
"""Mass up to which a body is a frame that carries no link; makers give such frames 1e-8 to 1e-6 kg [kg]."""

UNIT_WITHIN = 35.0
"""Factor within which a density in another unit is that of water."""

SERVO_ERROR_RAD = 0.5
"""Error at which a servo without a limit asks for its largest torque [rad]."""

LEAST_RAD_PER_S2, FAIR_RAD_PER_S2 = 100.0, 1000.0
"""Acceleration that the largest torque gives to the armature alone [rad/s^2]: least and middle of makers' models."""

MOST_RAD_PER_S2 = 2e5
"""The largest one: four times that of makers' models, and more than the bare rotor of a servo motor [rad/s^2]."""

UNLIMITED_SHARE = 0.25
"""Share of joints without a largest torque up to which they are exceptions: makers state it for all, 2 of 3 or none."""

SAME_ANGLE = 0.05
"""Difference from 1 up to which a command counts as the angle of its joint."""

LOST_COMMANDS = 0.1
"""Part of the commands of a servo that must lie in the range of its joint, for the whole range to count as reached."""

LIGHT = 1e-3
"""Torque of a weight, over the largest one of the robot, up to which a joint turns about a balanced part."""

FEW_JOINTS = 3
"""Driven hinges from which on a robot as a whole is judged."""

FULL_ACTION_RAD_PER_S = 3.0
"""Speed of a joint below which a leg cannot step: half a radian in a swing of 0.2 s is 2.5 rad/s."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was found of a robot for one row.

    Attributes:
        value: The value; not finite for a motion that diverges.
        parts: Value of each part that the row judges, by its name; empty for the robot as a whole.
        remark: Parts of the model that decide it.
        advice: What to change, in the words of a model.
        changes: The same, by names that `Robot.changed` knows.
        declined: Why it does not apply; empty when it does.
        unmeasured: Why it applies and was not measured; empty when it was.
        advisory: Why it does not count; empty when it does.
    """

    value: float = 0.0
    parts: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""
    advice: str = ""
    changes: Settings = field(default_factory=dict)
    declined: str = ""
    unmeasured: str = ""
    advisory: str = ""


class NotApplicableError(Exception):
    """A row does not apply to a robot; the message is the reason."""


class NotMeasuredError(Exception):
    """A row applies to a robot and cannot be measured; the message is the reason."""


ROWS: dict[str, Callable[[Robot], Finding]] = {}
"""Function of each row, whose limits and words stand in `scoring/facts/robot_rows.toml`."""


def row(
    name: str,
) -> Callable[[Callable[[Robot], Finding]], Callable[[Robot], Finding]]:
    """Return a decorator that adds the function of a row."""

    def keep(function: Callable[[Robot], Finding]) -> Callable[[Robot], Finding]:
        def measured(robot: Robot) -> Finding:
            try:
                return function(robot)
            except NotApplicableError as reason:
                return Finding(declined=str(reason))
            except NotMeasuredError as reason:
                return Finding(unmeasured=str(reason))

        def found(robot: Robot) -> Finding:
            if name not in robot.known:
                robot.known[name] = measured(robot)
            known: Finding = robot.known[name]
            return known

        ROWS[name] = found
        return function

    return keep


def standing_of(robot: Robot) -> Standing:
    """Return the robot that stands; rows that need one do not apply to a model without."""
    if robot.standing is None:
        raise NotApplicableError(NOT_STANDING)
    return robot.standing


def limits_of(name: str) -> tuple[float, float]:
    """Return the limits of a row, in its unit."""
    low, high = facts("robot_rows")[name]["interval"]
    return low, high


def judged_row(name: str, found: Finding) -> PhenomenonResult:
    """Return the row of a finding: visible beyond its limits by the ratio of other rows, wrong beyond that."""
    known = facts("robot_rows")[name]
    (low, high), value = known["interval"], found.value
    verdict = Verdict.of(_ratio(value, low, high))
    missing = found.declined or found.unmeasured
    is_off = verdict is not Verdict.INSIDE and not missing
    return PhenomenonResult(
        phenomenon=name,
        title=known["title"],
        unit=known["unit"],
        reality=Reality(
            kind=RealityKind.LAW,
            value=0.5 * (low + high),
            tolerance=0.5 * (high - low),
            source=known["source"],
            rationale=known["consequence"],
            limits=known["limits"],
        ),
        configured=None if missing or not np.isfinite(value) else float(value),
        verdict=Verdict.DECLINED if missing else verdict,
        cause=Cause(settings=tuple(found.changes), line=found.advice)
        if found.advice and is_off
        else None,
        remark=missing or found.remark,
        applies=not found.declined,
        consequence=known["consequence"] if is_off else "",
        advisory=found.advisory,
        parts=()
        if missing
        else tuple(
            PartOutcome(
                name=part,
                value=float(one) if np.isfinite(one) else None,
                verdict=Verdict.of(_ratio(one, low, high)),
                deviation=_ratio(one, low, high),
            )
            for part, one in (found.parts or {WHOLE: value}).items()
        ),
    )


def _ratio(value: float, low: float, high: float) -> float:
    """Return the ratio by which a value is beyond its limits; 1 between them, infinite for another sign."""
    if value < min(low, 0.0) or not np.isfinite(value):
        return np.inf
    ratio = float(max(low / max(value, 1e-12), value / high))
    return ratio if ratio > 1.0 + 1e-9 else 1.0


def body_name(robot: Robot, body: int) -> str:
    """Return the name of a body, or its number."""
    return robot.model.body(body).name or f"body {body}"


def joint_name(robot: Robot, dof: int) -> str:
    """Return the name of a degree of freedom's joint, or its number."""
    return name_of(robot, int(robot.model.dof_jntid[dof]))


def name_of(robot: Robot, joint: int) -> str:
    """Return the name of a joint, or its number."""
    return robot.model.joint(joint).name or f"joint {joint}"


def first_joints(robot: Robot, dofs: Sequence[int]) -> str:
    """Return the names of the joints of the first degrees of freedom."""
    return ", ".join(joint_name(robot, dof) for dof in dofs[:3])


def of_elements(array: str, values: Mapping[int, Any]) -> dict[str, Any]:
    """Return the changes of rows of an array of the model, by names that `Robot.changed` knows."""
    return {f"{array}[{number}]": value for number, value in values.items()}


def by_joint(robot: Robot, values: Mapping[int, float]) -> dict[str, float]:
    """Return values of degrees of freedom by the names of their joints."""
    return {joint_name(robot, dof): float(value) for dof, value in values.items()}


# --- masses ----------------------------------------------------------------------------------------------------------


def _extent(robot: Robot, body: int) -> Vector:
    """Return the largest volume of a geom of a body, that of their hull [m^3], and the reach from its centre [m].

    Joints of the next links belong to the hull. All are NaN for a body whose shape is not known.
    """
    model, geoms = robot.model, geoms_of(robot, body)
    if not geoms:
        return (np.nan,) * 3
    largest = float(8.0 * model.geom_aabb[geoms, 3:].prod(axis=1).max())
    every = _points(robot, body)
    try:
        hull = float(ConvexHull(every).volume)
    except QhullError:
        hull = largest
    reach = np.linalg.norm(every - model.body_ipos[body], axis=1).max()
    return largest, hull, float(reach)


def box_corners(model: mujoco.MjModel, geoms: Sequence[int]) -> FloatArray:
    """Return the corners of the boxes around geoms of one body, in its frame [m], shape [8 geom_count, 3]."""
    corners = [np.zeros((0, 3))]
    for geom in geoms:
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        box = model.geom_aabb[geom, :3] + SIGNS * model.geom_aabb[geom, 3:]
        corners.append(model.geom_pos[geom] + box @ turn.reshape(3, 3).T)
    return np.vstack(corners)


@once
def _points(robot: Robot, body: int) -> FloatArray:
    """Return the corners of the boxes around the geoms of a body, its joints and those of the next bodies [m]."""
    model = robot.model
    children = [b for b in robot.bodies if int(model.body_parentid[b]) == body]
    joints = model.jnt_pos[model.jnt_bodyid == body]
    corners = box_corners(model, geoms_of(robot, body))
    return np.vstack([corners, model.body_pos[children], joints])


def _box(robot: Robot, body: int) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper corner of the box around a link, in its frame [m], shape [3] each."""
    points = _points(robot, body)
    return points.min(axis=0), points.max(axis=0)


@row("robot-density")
def _density(robot: Robot) -> Finding:
    model, worst = robot.model, 0.0
    found = Finding(declined="the shape of no link is known")
    changes: dict[str, Any] = {}
    densities: dict[str, float] = {}
    low, high = limits_of("robot-density")
    for body in robot.bodies:
        mass_kg = float(model.body_mass[body])
        geom_m3, hull_m3, _ = _extent(robot, body)
        if not (mass_kg > MASSLESS_KG and geom_m3 > 0.0):
            continue
        # The largest density that its largest geom allows, and the least one in the room around all of them [kg/m^3].
        dense, thin = mass_kg / geom_m3, mass_kg / max(hull_m3, geom_m3)
        density = dense if dense < low else max(thin, low)
        name = body_name(robot, body)
        densities[name] = density
        ratio = max(low / dense, thin / high)
        factor = min(UNIT_ERRORS, key=lambda one: abs(np.log(1000.0 / density / one)))
        remark = f"{name} with {mass_kg:.3g} kg of {robot.mass_kg:.3g} kg"
        is_unit = abs(np.log(1000.0 / density / factor)) < np.log(UNIT_WITHIN)
        if ratio > 1.0 and is_unit:
            remark += f": {UNIT_ERRORS[factor]}?"
            changes[f"body_mass[{body}]"] = model.body_mass[body] * factor
            changes[f"body_inertia[{body}]"] = model.body_inertia[body] * factor
        if found.declined or ratio > worst:
            worst = ratio
            links = f"{name} and links like it"
            advice = f"give {links} the mass and inertia of the real part"
            if is_unit:
                advice = f"multiply mass and inertia, or the density, of {links} by {factor:g}"
            if density < low:
                geom = max(geoms_of(robot, body), key=lambda g: model.geom_rbound[g])
                advice += f", or give {geom_name(model, geom)} its size"
            found = Finding(value=density, remark=remark, advice=advice)
    if worst <= 1.0 and densities:
        name = max(densities, key=densities.__getitem__)
        ratio = densities[name] / float(np.median(list(densities.values())))
        if ratio > HEAVY:
            densities[name] = np.inf
            found = Finding(
                value=np.inf,
                remark=f"{name} is {ratio:.2g} times as dense as the middle one of the links",
                advice=f"give {name} the mass and inertia of the real part",
            )
    return replace(found, changes=changes, parts=densities)


@row("robot-bound")
def _bound(robot: Robot) -> Finding:
    spec = robot.spec
    if spec is None or not (spec.compiler.boundmass or spec.compiler.boundinertia):
        return Finding(declined="the model states neither boundmass nor boundinertia")
    bare = spec.copy()
    bare.compiler.boundmass = bare.compiler.boundinertia = 0.0
    try:
        model = bare.compile()
    except ValueError:
        return Finding(declined="without them a body has no mass: MuJoCo needs them")
    stated_kg = model.body_mass[robot.bodies]
    total_kg = float(stated_kg.sum())
    inertias = robot.model.body_inertia[robot.bodies].max(axis=1)
    stated_inertias = model.body_inertia[robot.bodies].max(axis=1)
    is_raised = inertias > 1.02 * stated_inertias
    raised = np.asarray(robot.bodies)[is_raised].tolist()
    weight = float(stated_kg[is_raised].sum()) / total_kg
    names = ", ".join(body_name(robot, body) for body in raised[:3])
    remark = f"{len(raised)} links have more inertia than their geoms or their inertial element state: {names}"
    return Finding(
        value=max(robot.mass_kg / total_kg - 1.0, weight),
        parts={body_name(robot, body): 1.0 for body in raised},
        remark=remark if raised else "",
        advice='<compiler boundmass="0" boundinertia="0"/>',
        changes={"compiler_boundmass": 0.0, "compiler_boundinertia": 0.0},
    )


@row("robot-gravcomp")
def _gravcomp(robot: Robot) -> Finding:
    model = robot.model
    lifted = [body for body in robot.bodies if model.body_gravcomp[body]]
    heavy = [body for body in robot.bodies if model.body_mass[body] > MASSLESS_KG]
    if not robot.is_floating and len(lifted) in (0, len(heavy)):
        return Finding(declined="a controller of a fixed base may carry all its links")
    share = float(
        (model.body_gravcomp * model.body_mass)[robot.bodies].sum() / robot.mass_kg
    )
    names = ", ".join(body_name(robot, body) for body in lifted)
    return Finding(
        value=abs(share),
        parts={
            body_name(robot, body): abs(float(model.body_gravcomp[body]))
            for body in lifted
        },
        remark=names,
        advice=f'gravcomp="0" for {names}',
        changes={f"body_gravcomp[{body}]": 0.0 for body in lifted},
    )


@row("robot-inertia")
def _inertia(robot: Robot) -> Finding:
    low, high = limits_of("robot-inertia")
    found, worst, changes = Finding(declined="the shape of no link is known"), 0.0, {}
    shares: dict[str, float] = {}
    far: list[tuple[float, str]] = []
    # Of a screen or a frame beside it nothing depends.
    least_kg = 1e-5 * robot.mass_kg
    for body in robot.bodies:
        mass_kg, reach_m = float(robot.model.body_mass[body]), _extent(robot, body)[2]
        if not (mass_kg > max(MASSLESS_KG, least_kg) and reach_m > 0.0):
            continue
        low_m, high_m = _box(robot, body)
        centre_m, size_m = robot.model.body_ipos[body], high_m - low_m
        beyond_m = np.maximum(np.maximum(low_m - centre_m, centre_m - high_m), 0.0)
        away = float(np.linalg.norm(beyond_m)) / max(
            float(np.linalg.norm(size_m)), 1e-9
        )
        name = body_name(robot, body)
        if away > FAR_CENTRE:
            far.append((away, name))
        inertia = robot.model.body_inertia[body]
        # The sum of the principal moments is twice the mass times the square of the polar radius of gyration.
        radius_m = float(np.sqrt(0.5 * inertia.sum() / mass_kg))
        shares[name] = radius_m / reach_m
        share = (0.5 * reach_m / max(radius_m, 1e-9)) ** 2
        ratio = max(low * reach_m / max(radius_m, 1e-12), radius_m / reach_m / high)
        if ratio > 1.0:
            changes[f"body_inertia[{body}]"] = inertia * share
        if ratio > worst:
            worst = ratio
            found = Finding(
                value=radius_m / reach_m,
                remark=f"{name} of {mass_kg:.3g} kg: {radius_m:.3g} m of {reach_m:.3g} m",
                advice=f"give {name} the inertia of its geoms, about {share:.2g} of the stated one",
            )
    if far:
        away, name = max(far)
        return Finding(
            value=np.inf,
            parts=shares | {f"centre of mass of {one}": np.inf for _, one in far},
            remark=f"the centre of mass of {name} is outside of its shape, by {away:.2g} of its size",
            advice=f"the centre of mass of {name} in the frame of its body, in metres",
        )
    return replace(found, changes=changes, parts=shares)


# --- feet on the ground ----------------------------------------------------------------------------------------------


def limbs_of(robot: Robot) -> list[list[int]]:
    """Return the bodies of each limb: those behind a body from which at least two limbs part.

    A rod whose end an equality holds closes a chain, and is no limb.
    """
    model = robot.model
    is_body = model.eq_objtype == int(mujoco.mjtObj.mjOBJ_BODY)
    held = {*model.eq_obj1id[is_body].tolist(), *model.eq_obj2id[is_body].tolist()}
    children = {
        body: [b for b in robot.bodies if int(model.body_parentid[b]) == body]
        for body in robot.bodies
    }
    parting = {body for body, several in children.items() if len(several) > 1}
    limbs = []
    for leaf in (body for body, several in children.items() if not several):
        if leaf in held:
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
    """Return the bodies of the fingers of a robot on a fixed base: the last ones of limbs that part from one body."""
    if robot.standing is not None:
        return []
    limbs = limbs_of(robot)
    origins = [int(robot.model.body_parentid[limb[-1]]) for limb in limbs]
    return [
        limb[0]
        for limb, origin in zip(limbs, origins, strict=True)
        if origins.count(origin) > 1
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
    return Finding(
        value=grips[slipperiest],
        parts={geom_name(model, geom): grip for geom, grip in grips.items()},
        remark=f"{name}, a finger",
        advice=f'condim="4" friction="1 0.005 0.0001" priority="1" for {name} and pads like it',
        changes={
            f"geom_{key}[{geom}]": value
            for geom in slippery
            for key, value in (
                ("condim", 4),
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
    _, most = limits_of("robot-floor-friction")
    # What a geom takes from the default of all is no statement about it.
    common = 1.0 if robot.spec is None else float(robot.spec.default.geom.friction[0])
    explicit = {
        tuple(sorted(p))
        for p in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    }
    for row in robot.foot_rows:
        pair = tuple(robot.pairs.geoms[row].tolist())
        stated = [float(model.geom_friction[geom, 0]) for geom in pair]
        alike = model.geom_priority[pair[0]] == model.geom_priority[pair[1]]
        met, least = (
            float(robot.pairs.constants[row, COLUMNS["friction"].start]),
            max(min(stated), 1e-3),
        )
        is_stated = abs(min(stated) - common) > 1e-9
        if pair in explicit or not alike or not is_stated:
            continue
        ratios[pair_name(robot, row)] = met / least
        geom = pair[int(np.argmin(stated))]
        # With its priority, its condim counts too.
        condim = int(robot.pairs.constants[row, 0])
        has_condim = int(model.geom_condim[geom]) >= condim
        if met / least > most:
            changes[f"geom_priority[{geom}]"] = 1
            if not has_condim:
                changes[f"geom_condim[{geom}]"] = condim
        if met / least > found.value:
            found = Finding(
                value=met / least,
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
    if not planes or not gravity.any():
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


# --- joints ----------------------------------------------------------------------------------------------------------


def start(robot: Robot, model: mujoco.MjModel | None = None) -> mujoco.MjData:
    """Return the pose in which the robot works, with the controls that hold it there.

    It is the pose in which it stands; of a fixed base the keyframe `home` or the first one, else that of the model.
    Joints that the model puts outside their ranges are in the middle of these.
    """
    model = robot.model if model is None else model
    data = mujoco.MjData(model)
    if robot.standing is not None:
        data.qpos[:] = robot.standing.stance.qpos
    elif model.nkey:
        home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
        data.qpos[:] = model.key_qpos[max(home, 0)]
    else:
        positions = data.qpos[model.jnt_qposadr]
        low, high = model.jnt_range.T
        is_outside = (positions < low) | (positions > high)
        is_outside &= joints_of(model, "HINGE", "SLIDE") & (model.jnt_limited != 0)
        data.qpos[model.jnt_qposadr[is_outside]] = (0.5 * (low + high))[is_outside]
    mujoco.mj_forward(model, data)
    # A servo's force is gain * control + bias[0] + bias[1] * length: here it is 0.
    servo = servos(model) & (model.actuator_gainprm[:, 0] != 0.0)
    bias = model.actuator_biasprm[servo]
    forces = bias[:, 0] + bias[:, 1] * data.actuator_length[servo]
    data.ctrl[servo] = -forces / model.actuator_gainprm[servo, 0]
    if robot.standing is not None and robot.standing.stance.ctrl is not None:
        data.ctrl[:] = robot.standing.stance.ctrl
    mujoco.mj_forward(model, data)
    return data


def servos(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return which actuators hold a position, shape [nu]."""
    affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    return affine & (model.actuator_biasprm[:, 1] < 0.0)


def torque_limits(model: mujoco.MjModel) -> FloatArray:
    """Return the largest force of the actuators on each degree of freedom [N or Nm], shape [nv].

    It is infinite where no limit is stated, and 0 where nothing acts.
    """
    limits = np.zeros(model.nv)
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        if (
            int(model.actuator_trntype[actuator]) not in JOINT_TRANSMISSIONS
            or joint < 0
        ):
            continue
        largest = np.inf
        if model.actuator_forcelimited[actuator]:
            largest = float(np.abs(model.actuator_forcerange[actuator]).max())
        elif (
            model.actuator_ctrllimited[actuator]
            and not model.actuator_biasprm[actuator].any()
        ):
            largest = float(
                abs(model.actuator_gainprm[actuator, 0])
                * np.abs(model.actuator_ctrlrange[actuator]).max()
            )
        dof = int(model.jnt_dofadr[joint])
        limits[dof] += abs(float(model.actuator_gear[actuator, 0])) * largest
        if model.jnt_actfrclimited[joint]:
            limits[dof] = min(
                limits[dof], float(np.abs(model.jnt_actfrcrange[joint]).max())
            )
    return limits


def driven_dofs(robot: Robot) -> dict[int, float]:
    """Return the limits of hinges of a robot that an actuator drives, by degree of freedom [Nm]."""
    model = robot.model
    is_hinge = joints_of(model, "HINGE")[model.dof_jntid]
    is_driven = is_hinge & np.isin(model.dof_bodyid, robot.bodies)
    limits = enumerate(torque_limits(model).tolist())
    return {dof: limit for dof, limit in limits if limit and is_driven[dof]}


def driven_joints(robot: Robot) -> list[int]:
    """Return the joints of these hinges."""
    joints: list[int] = robot.model.dof_jntid[list(driven_dofs(robot))].tolist()
    return joints


def growth(robot: Robot) -> float:
    """Return the largest ratio by which a small motion about the pose grows in one step, without contact and gravity.

    It is the spectral radius of the engine's own step: gains, damping, inertia, step and integrator together.
    """
    free = robot.without("contact", "gravity", "limit", "frictionloss")
    data, nv = start(robot, free), free.nv
    base, ctrl, matrix = data.qpos.copy(), data.ctrl.copy(), np.zeros((2 * nv, 2 * nv))

    def stepped(change: FloatArray) -> FloatArray:
        mujoco.mj_resetData(free, data)
        data.qpos[:], data.ctrl[:] = base, ctrl
        mujoco.mj_integratePos(free, data.qpos, change[:nv], 1.0)
        data.qvel[:] = change[nv:]
        mujoco.mj_step(free, data)
        moved = np.zeros(nv)
        mujoco.mj_differentiatePos(free, moved, 1.0, base, data.qpos)
        return np.concatenate([moved, data.qvel])

    for column, change in enumerate(1e-5 * np.eye(2 * nv)):
        matrix[:, column] = (stepped(change) - stepped(-change)) / 2e-5
    return (
        float(np.abs(np.linalg.eigvals(matrix)).max())
        if np.isfinite(matrix).all()
        else np.inf
    )


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


@once
def largest_weights_nm(robot: Robot) -> FloatArray:
    """Return the largest torque of gravity on each degree of freedom in random poses [Nm], shape [nv]."""
    poses = random_poses(robot.model, 64)
    return np.max(
        [np.abs(data.qfrc_bias - data.qfrc_gravcomp) for data in poses], axis=0
    )


def undriven(robot: Robot) -> list[int]:
    """Return hinges of a driven robot that carry a weight and that nothing drives, springs or couples."""
    model = robot.model
    drives_joints = acts_on_joints(model).all()
    is_joint = couplings_of(model)
    is_linkage = model.ntendon or not drives_joints or not is_joint.all()
    if is_linkage or len(driven_dofs(robot)) < FEW_JOINTS:
        return []
    moved = {*joints_of_motors(model).tolist()}
    moved |= {*model.eq_obj1id.tolist(), *model.eq_obj2id.tolist()}
    moved |= {*np.flatnonzero(springs(model)).tolist()}
    weights_nm = largest_weights_nm(robot)
    is_hinge = joints_of(model, "HINGE")
    return [
        dof
        for dof, joint in enumerate(model.dof_jntid.tolist())
        if is_hinge[joint]
        and joint not in moved
        and int(model.dof_bodyid[dof]) in robot.bodies
        # Joints of the first body place the robot in the world.
        and model.body_parentid[model.dof_bodyid[dof]]
        and weights_nm[dof] > LIGHT * weights_nm.max()
    ]


def one_sided(robot: Robot) -> dict[int, int]:
    """Return actuators without muscles whose forces have one sign, by the hinge that each turns."""
    model = robot.model
    low, high = model.actuator_forcerange.T
    is_muscle = model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_MUSCLE)
    is_one = model.actuator_forcelimited.astype(bool) & (low * high >= 0.0)
    is_one &= acts_on_joints(model) & ~is_muscle
    driven = set(driven_dofs(robot))
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    return {
        int(dofs[a]): a for a in np.flatnonzero(is_one).tolist() if dofs[a] in driven
    }


def springs(model: mujoco.MjModel) -> FloatArray:
    """Return the stiffness of the spring of each joint [N/m or Nm/rad], shape [njnt]."""
    # MuJoCo 4 has coefficients of a polynomial, earlier versions one number.
    linear: FloatArray = model.jnt_stiffness.reshape(model.njnt, -1)[:, 0]
    return linear


@row("robot-torque")
def _torque(robot: Robot) -> Finding:
    driven = driven_dofs(robot)
    limits_nm = {dof: limit for dof, limit in driven.items() if np.isfinite(limit)}
    if not driven:
        return Finding(declined="no hinge of the robot is driven")
    if idle := undriven(robot):
        names = first_joints(robot, idle)
        several = f"{names}: {len(idle)} of {len(driven) + len(idle)} hinges"
        return Finding(
            parts=by_joint(robot, dict.fromkeys(idle, 0.0)),
            remark=f"{several} have no actuator",
            advice=f"an actuator for {names}",
        )
    if single := one_sided(robot):
        names = first_joints(robot, list(single))
        return Finding(
            parts=by_joint(robot, dict.fromkeys(single, 0.0)),
            remark=f"{names}: {len(single)} motors turn one way only",
            advice=f"a forcerange of both signs for {names}",
        )
    at_start = robot.is_floating
    bias_nm = np.abs(start(robot).qfrc_bias) if at_start else largest_weights_nm(robot)
    weights_nm = {dof: float(bias_nm[dof]) for dof in limits_nm}
    ratios = {
        dof: min(limit / max(weights_nm[dof], 1e-3), 1e6)
        for dof, limit in limits_nm.items()
    }
    unlimited = [dof for dof in driven if dof not in limits_nm]
    if unlimited and min(ratios.values(), default=1.0) >= 1.0:
        names = first_joints(robot, unlimited)
        is_common = len(unlimited) > UNLIMITED_SHARE * len(driven)
        return Finding(
            value=np.inf,
            parts=by_joint(robot, ratios | dict.fromkeys(unlimited, np.inf)),
            remark=f"{names}: {len(unlimited)} of {len(driven)} driven joints state no largest torque",
            advice=f"the forcerange of {names}, from the data sheet of the motor and gear",
            advisory="joints of the model state no limit of their torque"
            if is_common
            else "",
        )
    weakest = min(ratios, key=ratios.__getitem__)
    fair_nm = 2.0 * weights_nm[weakest]
    if robot.is_floating:
        fair_nm = leg_nm(robot)
    joint = joint_name(robot, weakest)
    return Finding(
        value=ratios[weakest],
        parts=by_joint(robot, ratios),
        remark=f"{joint}: {limits_nm[weakest]:.3g} Nm against {weights_nm[weakest]:.3g} Nm",
        advice=f"a forcerange of {joint} and joints like it from {fair_nm:.2g} Nm on",
    )


def foot_load_n(robot: Robot) -> float:
    """Return what each foot of a robot carries of its weight [N]."""
    return robot.mass_kg * GRAVITY_M_PER_S2 / len(standing_of(robot).feet)


def leg_nm(robot: Robot) -> float:
    """Return twice the torque of the load of a foot at the height of a robot that stands [Nm]."""
    return 2.0 * foot_load_n(robot) * standing_of(robot).height_m


def dof_of(robot: Robot, actuator: int) -> int:
    """Return the degree of freedom on which an actuator acts."""
    return int(robot.model.jnt_dofadr[robot.model.actuator_trnid[actuator, 0]])


def motors_of(robot: Robot) -> list[int]:
    """Return actuators on hinges that count as driven."""
    joints = robot.model.actuator_trnid[:, 0]
    return np.flatnonzero(np.isin(joints, driven_joints(robot))).tolist()


def position_servos(robot: Robot) -> list[int]:
    """Return servos on hinges of the robot."""
    is_servo = servos(robot.model)
    return [actuator for actuator in motors_of(robot) if is_servo[actuator]]


def servo_gains(model: mujoco.MjModel, column: int) -> FloatArray:
    """Return a gain of the servos on each degree of freedom, shape [nv].

    Args:
        model: The model.
        column: 1 for the stiffness [Nm/rad], 2 for the damping [Nm s/rad].
    """
    gains = np.zeros(model.nv)
    actuators = servos(model) & acts_on_joints(model)
    gears = model.actuator_gear[actuators, 0]
    dofs = model.jnt_dofadr[model.actuator_trnid[actuators, 0]]
    np.subtract.at(gains, dofs, gears**2 * model.actuator_biasprm[actuators, column])
    return gains


def stiffness(model: mujoco.MjModel, dof: int) -> float:
    """Return the stiffness of the servos on a degree of freedom [Nm/rad]."""
    return float(servo_gains(model, 1)[dof])


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


def loads_nm(robot: Robot) -> dict[int, float]:
    """Return the largest torque of the motor of each driven hinge; without a limit that of its servo [Nm]."""
    loads: dict[int, float] = {}
    for dof, limit_nm in driven_dofs(robot).items():
        if not np.isfinite(limit_nm):
            limit_nm = SERVO_ERROR_RAD * stiffness(robot.model, dof)
        if limit_nm > 0.0:
            loads[dof] = limit_nm
    return loads


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
    return Finding(
        value=shares[worst],
        parts=by_joint(robot, shares),
        remark=f"{joint_name(robot, worst)}: {name} {values[worst]:.3g} with {limits[worst]:.3g} Nm",
        advice=f'{name}="{fair[worst]:.2g}" for {joint_name(robot, worst)} and joints like it, '
        "or its largest torque in Nm",
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
    loss = robot.model.dof_frictionloss
    return _drag(
        robot, "frictionloss", lambda dof, limit: float(loss[dof]) / limit, 20.0
    )


@row("robot-armature")
def _armature(robot: Robot) -> Finding:
    model, data, found, changes = robot.model, start(robot), Finding(), {}
    ratios: dict[int, float] = {}
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    loads = loads_nm(robot)
    for dof in driven_dofs(robot):
        armature, limit_nm = float(model.dof_armature[dof]), loads.get(dof, 0.0)
        limb = max(float(full[dof, dof]) - armature, 1e-9)
        # Turned about its own axis a wrist has next to no inertia: what counts there is that its motor can turn it.
        if armature * LEAST_RAD_PER_S2 <= limit_nm:
            continue
        ratios[dof] = armature / limb
        fair = max(limb, limit_nm / FAIR_RAD_PER_S2)
        if armature / limb > limits_of("robot-armature")[1]:
            changes[f"dof_armature[{dof}]"] = fair
        if armature / limb > found.value:
            found = Finding(
                value=armature / limb,
                remark=f"{joint_name(robot, dof)}: {armature:.3g} with a limb of {limb:.3g} kg m^2, {limit_nm:.3g} Nm",
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
    fast = [
        dof
        for dof, armature in armatures.items()
        if armature > 0.0 and MOST_RAD_PER_S2 * armature < limits_nm[dof] < np.inf
    ]
    without_rotor = [dof for dof, armature in armatures.items() if armature <= 0.0]
    without_rotor += fast
    stated = sorted(armatures[dof] for dof in armatures if dof not in without_rotor)
    if not without_rotor:
        return Finding(remark="all driven joints state one")
    names = first_joints(robot, without_rotor)
    several = f"{names}: {len(without_rotor)} of {len(armatures)} driven joints"
    for dof in fast[:1]:
        several += f"; {limits_nm[dof]:.3g} Nm would turn the {armatures[dof]:.3g} kg m^2 of {joint_name(robot, dof)} "
        several += f"by {limits_nm[dof] / armatures[dof]:.2g} rad/s^2"
    share = len(without_rotor) / len(armatures)
    parts = by_joint(robot, dict.fromkeys(without_rotor, 1.0))
    if not stated and not fast:
        # Half of the makers' models state none at all.
        return Finding(
            value=share,
            parts=parts,
            remark=several,
            advisory="no joint of the model states the inertia of its rotor",
        )
    if not stated:
        return Finding(
            value=share,
            parts=parts,
            remark=several,
            advice="armature in kg m^2, forcerange in Nm",
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


@row("robot-range")
def _range(robot: Robot) -> Finding:
    model = robot.model
    joints = driven_joints(robot)
    ranges_rad = {
        name_of(robot, joint): float(np.ptp(model.jnt_range[joint]))
        for joint in joints
        if model.jnt_limited[joint]
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
    )


@row("robot-command")
def _command(robot: Robot) -> Finding:
    model = robot.model
    is_on_joint = acts_on_joints(model)
    has_no_bias = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_NONE)
    is_unread = has_no_bias & (model.actuator_biasprm[:, 1] < 0.0)
    joints = model.actuator_trnid[:, 0]
    is_servo = is_on_joint & (servos(model) | is_unread)
    found: dict[str, Finding] = {}
    for actuator in np.flatnonzero(is_servo).tolist():
        joint = int(joints[actuator])
        gain = float(model.actuator_gainprm[actuator, 0])
        gear = float(model.actuator_gear[actuator, 0])
        if int(model.jnt_bodyid[joint]) not in robot.bodies or not gain * gear:
            continue
        name = joint_name(robot, int(model.jnt_dofadr[joint]))
        others = np.flatnonzero(is_servo & (joints == joint)).tolist()
        if len(others) > 1:
            names = [model.actuator(one).name or f"actuator {one}" for one in others]
            remark = f"{name} has {len(others)} servos: {', '.join(names)}"
            found[name] = Finding(remark=remark, advice="one servo for each joint")
        elif is_unread[actuator]:
            affine = int(mujoco.mjtBias.mjBIAS_AFFINE)
            found[name] = Finding(
                remark=f"the servo of {name} does not read its biasprm",
                advice=f'biastype="affine" for {name}',
                changes={f"actuator_biastype[{actuator}]": affine},
            )
        else:
            found[name] = _reached(robot, actuator, name)
    for motor, joint in swapped_motors(model).items():
        name = model.actuator(motor).name
        found[name] = Finding(
            remark=f"{name} turns {name_of(robot, int(joints[motor]))}",
            advice=f"joint {name_of(robot, joint)} for {name}",
        )
    for motor in speed_servos(robot):
        name = name_of(robot, int(joints[motor]))
        found[name] = Finding(
            remark=f"the servo of {name} takes a speed, and is commanded an angle",
            advice=f"a servo of position for {name}: -kp and -kv in biasprm",
        )
    if not found:
        return Finding(declined="no servo of the robot takes a position")
    worst = min(found.values(), key=lambda one: one.value)
    changes: dict[str, Any] = {}
    for one in found.values():
        changes |= one.changes
    parts = {name: one.value for name, one in found.items()}
    return replace(worst, parts=parts, changes=changes)


def speed_servos(robot: Robot) -> list[int]:
    """Return servos that take a speed on joints with limits, though other servos take an angle."""
    model = robot.model
    gains, (_, angle, rate) = model.actuator_gainprm[:, 0], model.actuator_biasprm.T[:3]
    is_speed = acts_on_joints(model) & (angle == 0.0) & servos(model).any()
    is_speed &= (rate < 0.0) & np.isclose(gains, -rate)
    is_speed &= model.jnt_limited[model.actuator_trnid[:, 0]] > 0
    return np.flatnonzero(is_speed).tolist()


def _reached(robot: Robot, actuator: int, name: str) -> Finding:
    """Return the part of a joint's range that the commands of its servo reach, infinite against its direction."""
    model = robot.model
    joint = int(model.actuator_trnid[actuator, 0])
    gain = float(model.actuator_gainprm[actuator, 0])
    bias = model.actuator_biasprm[actuator]
    gear = float(model.actuator_gear[actuator, 0])
    # Without load, gain * control + bias[0] + bias[1] * gear * angle is 0.
    per_control = -gain / (float(bias[1]) * gear)
    if per_control < 0.0:
        return Finding(
            value=-np.inf,
            remark=f"{name} turns against its command",
            advice=f"a positive gear and gain for {name}",
            changes={
                f"actuator_gear[{actuator}]": np.abs(model.actuator_gear[actuator])
            },
        )
    if not (model.actuator_ctrllimited[actuator] and model.jnt_limited[joint]):
        return Finding(value=1.0, remark=name)
    zero = -float(bias[0]) / (float(bias[1]) * gear)
    ends = zero + per_control * model.actuator_ctrlrange[actuator]
    low, high = model.jnt_range[joint]
    reached_rad = float(min(ends[1], high) - max(ends[0], low))
    # Of a range of commands that is far wider than the joint's, nearly all are lost.
    is_angle = abs(per_control - 1.0) < SAME_ANGLE
    used = LOST_COMMANDS if is_angle else 1.0
    share = reached_rad / max(high - low, used * float(np.ptp(ends)))
    found = Finding(value=share if share >= 0.0 else -np.inf, remark=name)
    if share >= limits_of("robot-command")[0]:
        return found
    if is_angle or zero != 0.0:
        ends = (model.jnt_range[joint] - zero) / per_control
        return replace(
            found,
            advice=f"the ctrlrange of {name} in the unit of its joint, or inheritrange",
            changes={f"actuator_ctrlrange[{actuator}]": ends},
        )
    key, advice = "biasprm", f"{gain:g} and {-gain:g} in gainprm and biasprm of {name}"
    row = np.array(bias)
    row[1] = -gain
    if abs(gear) != 1.0:
        key, advice = "gear", f"gear 1 for {name}, which its command passes too"
        row = np.sign(gear) * np.eye(6)[0]
    return replace(
        found,
        remark=f"a command of 1 turns {name} by {per_control:.3g} rad",
        advice=advice,
        changes={f"actuator_{key}[{actuator}]": row},
    )


@row("robot-unlimited")
def _unlimited(robot: Robot) -> Finding:
    model = robot.model
    joints = driven_joints(robot)
    if len(joints) < FEW_JOINTS or (robot.foot_rows and not model.jnt_limited.any()):
        return Finding(declined=f"fewer than {FEW_JOINTS} driven hinges, or wheels")
    off = switched_off(model, "constraint", "limit")
    free = [joint for joint in joints if off or not model.jnt_limited[joint]]
    # What a linkage couples to another joint cannot turn without end.
    of_joints = couplings_of(model)
    coupled = {
        *model.eq_obj1id[of_joints].tolist(),
        *model.eq_obj2id[of_joints].tolist(),
    }
    free.sort(key=lambda joint: joint not in coupled)
    names = ", ".join(name_of(robot, joint) for joint in free[:3])
    return Finding(
        value=1.0 if coupled & set(free) else len(free) / len(joints),
        parts={name_of(robot, joint): 1.0 for joint in free},
        remark=f"{names}: {len(free)} of {len(joints)} driven hinges" if free else "",
        changes=dict.fromkeys(off, True),
        advice=enabling(off)
        if off
        else f'the ranges of {names} and joints like it; a `range` counts with autolimits, or with limited="true"',
    )
