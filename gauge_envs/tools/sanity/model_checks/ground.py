"""Check the contacts of a robot with the ground, with objects and with itself, and how it stands under servos."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.pages.text import digits_text
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.check import (
    Fault,
    Finding,
    model_check,
    rule,
    unit_text,
)
from gauge_envs.tools.sanity.model_checks.drives import drives, loads, servos, start
from gauge_envs.tools.sanity.model_checks.runs import settled
from gauge_envs.tools.sanity.pair_bench import bench, touch_of, touching
from gauge_envs.tools.sanity.robot.robot import (
    SOLE_WITHIN,
    Robot,
    Standing,
    chain_of,
    geom_name,
    grasping_pairs,
    support_m,
    switched_off,
)
from gauge_envs.tools.sanity.verdict import NotApplicableError, Severity


@model_check(
    "gravity",
    title="size of gravity, which points to the ground",
    unit="m/s^2",
    interval=(9.76, 9.86),
    source="standard gravity; places on Earth have 9.76 to 9.83 m/s^2",
    consequence="Bodies fall as on another planet.",
    most=Severity.ERROR,
)
def gravity(robot: Robot) -> Finding:
    """Return the size of gravity. Another size is advice, as another planet has it, unless the ratio names a unit."""
    vector = robot.model.opt.gravity
    if switched_off(robot.model, "gravity") or not vector.any():
        raise NotApplicableError("the model has no gravity")
    size, down = float(np.linalg.norm(vector)), -float(np.asarray(robot.up) @ vector)
    # A tilted gravity pushes to the side, as on a slope. Beyond 60 degrees, the plane may be a wall.
    if down > 0.5 * size:
        down = min(size, down, key=lambda value: abs(value - GRAVITY_M_PER_S2))
    if down >= 0.0:
        return Finding(
            value=down,
            most=Severity.WARNING
            if unit_text(down / GRAVITY_M_PER_S2)
            else Severity.ADVICE,
        )
    remark = f"gravity of {-down:.3g} m/s^2 pulls off the ground"
    return Finding(value=down, remark=remark)


def standing_of(robot: Robot) -> Standing:
    """Return the robot that stands; checks that need one do not apply to a model without."""
    if robot.standing is None:
        raise NotApplicableError(
            "no robot of the model stands on the ground under its own weight"
        )
    return robot.standing


def floor_m(robot: Robot) -> float:
    """Return the height of the highest plane under the feet [m]; over other ground the height of the lowest foot."""
    touched = np.unique(robot.pairs.geoms[robot.foot_rows])
    is_plane = robot.model.geom_type[touched] == mujoco.mjtGeom.mjGEOM_PLANE
    heights_m = robot.stance.positions_m[touched[is_plane], 2]
    return float(max(heights_m, default=standing_of(robot).ground_m))


@model_check(
    "robot-feet",
    title="limbs in the ground that cannot touch it",
    interval=(0.0, 0.5),
    source="contype, conaffinity and pairs of the model; the lowest geoms in the pose in which it stands",
    consequence="The limb passes through the ground: walking does without it.",
    most=Severity.ADVICE,
)
def feet(robot: Robot) -> Finding:
    """Return the number of limbs that reach the ground and cannot touch it."""
    model = robot.model
    standing = standing_of(robot)
    lows = standing.support_m
    within_m = SOLE_WITHIN * standing.height_m
    carrying = {
        body for geom in lows for body in chain_of(model, int(model.geom_bodyid[geom]))
    }
    is_solid = (model.geom_contype | model.geom_conaffinity) != 0
    lame = {}
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, robot.bodies)).tolist():
        limb = chain_of(model, int(model.geom_bodyid[geom]))
        low = support_m(robot, geom)
        near = [lows[sole] for sole in lows if model.geom_bodyid[sole] in limb[:2]]
        # Drawn geoms of a limb that touches are no fault; colliding geoms below its contact are.
        is_apart = limb[0] not in carrying and low <= standing.ground_m + within_m
        if near:
            is_apart = bool(is_solid[geom]) and low < min(near) - within_m
        if geom not in lows and is_apart:
            lame[limb[0]] = geom
    names = [geom_name(model, geom) for geom in lame.values()]
    if not lame:
        return Finding(value=0.0)
    return Finding(
        value=float(len(lame)),
        remark=f"{', '.join(names[:3])} cannot touch the ground",
        place=("geom", next(iter(lame.values()))),
        parts=dict.fromkeys(names, 1.0),
    )


MIN_GAP_MM = 10.0
"""Height of feet above or in the ground that a remark names [mm]: soft contacts of a standing robot sink by less."""


# --- standing --------------------------------------------------------------------------------------------------------

FELL, ROSE = 0.7, 1.3
"""Ratios of the heights of the centre of mass at the end and at the start: a robot below fell, a robot above rose."""

SATURATED = 0.99
"""Share of its limit from which on a motor is saturated, so that the load is larger."""

MIN_FEET = 3
"""Smallest number of feet on which a robot stands without a policy."""


def hold_pose(robot: Robot) -> tuple[float, FloatArray]:
    """Return how a robot ends whose servos hold the pose in which it stands.

    Returns:
        The ratio of the heights of its centre of mass at the end and at the start, and the mean late force of the
        actuators in each degree of freedom [N m or N], shape [nv].

    Raises:
        NotApplicableError: It does not stand on three feet or more, not all of its legs have servos, or the state
            diverges.
    """
    standing, model = standing_of(robot), robot.model
    if len(standing.feet) < MIN_FEET:
        raise NotApplicableError(
            "a robot with one foot or two balances with a policy alone"
        )
    servo = servos(model) & (model.actuator_gainprm[:, 0] != 0.0)
    if not all(drive.kp for drive in drives(robot) if drive.is_leg) or not servo.any():
        raise NotApplicableError("no servos hold the legs")
    run = settled(robot)
    heights_m = run.heights_m[:, model.body_treeid[standing.body]] - floor_m(robot)
    return float(heights_m[-1] / max(heights_m[0], 1e-6)), run.forces


@rule(
    "robot-torque",
    title="force that holds a joint, over that of its motor",
    source="inverse dynamics at rest in the pose of the keyframe; of a robot on feet, the mean torque as it falls",
    consequence="The motors do not hold the robot's own weight.",
    is_simulated=True,
)
def holding_force(robot: Robot) -> Iterator[Fault]:
    """Yield joints whose motor is too weak where the robot rests."""
    model = robot.model
    is_standing = robot.standing is not None
    limits = {
        drive: min(drive.limit, drive.reach if is_standing else np.inf)
        for drive in drives(robot)
    }
    limited = [drive for drive in limits if np.isfinite(limits[drive])]
    if not limited:
        raise NotApplicableError("no motor of a joint has a torque limit")
    if is_standing:
        height_ratio, forces = hold_pose(robot)
        needed = forces / SATURATED * (height_ratio <= FELL)
        verb = "the robot falls while"
    else:
        kinds = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
        if np.isin(model.eq_type, kinds).any():
            raise NotApplicableError("closed chains share the weight")
        data = start(robot)
        carried = data.qfrc_bias - data.qfrc_passive - data.qfrc_constraint
        needed = np.minimum(loads(model, data), np.abs(carried))
        limited = [drive for drive in limited if model.nkey or drive.kp]
        verb = "at rest"
    for drive in limited:
        force, limit, unit = needed[drive.dof], limits[drive], drive.units[0]
        text = f"{verb} {drive.name} takes {force:.4g} {unit}; its motor makes {limit:.4g} {unit}"
        if limit < drive.limit:
            text += f" within its range, with kp {drive.kp:.4g}"
        yield from drive.faults(force / limit, text)


@model_check(
    "robot-stands",
    title="height after 2 s under servos, over the first",
    interval=(FELL, ROSE),
    source="the robot's own rollout: its pose, its controls and its settings, on three feet or more",
    consequence="Episodes begin with a fall or jump that the policy has to undo.",
    is_simulated=True,
)
def stands(robot: Robot) -> Finding:
    """Return the height of a robot that its servos hold, over that at the start."""
    if not robot.model.nkey:
        raise NotApplicableError("the model has no keyframe")
    (ratio, _), standing = hold_pose(robot), standing_of(robot)
    gap_mm = 1e3 * (standing.ground_m - floor_m(robot))
    text = ""
    if not FELL <= ratio <= ROSE:
        text = f"the robot {'falls' if ratio < 1.0 else 'rises'} to {ratio:.0%} of its height"
        if abs(gap_mm) > MIN_GAP_MM:
            text += f": its feet start {abs(gap_mm):.3g} mm {'above' if gap_mm > 0.0 else 'in'} the ground"
    return Finding(value=ratio, remark=text, place=("body", standing.body))


SHARE = 0.7
"""Push over the limit of friction: that of gravity on the published wooden cube, which rests on 10 degrees."""

MAX_CREEP_MM_PER_S = 1.4
"""Fastest creep that the published scores of this cube allow [mm/s]; see `object_checks.friction`."""

ROUND = [kind for kind in range(2, 8) if kind != mujoco.mjtGeom.mjGEOM_BOX]
"""Types of geoms that roll, meshes among them."""

MAX_PAIRS = 6
"""Largest number of pairs of geoms with different contacts that are measured."""

CREEP_SOURCE = (
    "Coulomb: v = 0 below the limit; published trials of a wooden cube, at 0.7 of its limit, allow 1.4 mm/s "
    "(paper, Table 5)"
)


@model_check(
    "foot-creep",
    title=f"creep of a foot at {SHARE:g} of its friction limit",
    unit="mm/s",
    interval=(0.0, MAX_CREEP_MM_PER_S),
    source=CREEP_SOURCE,
    consequence="A robot that stands drifts.",
    most=Severity.ADVICE,
    is_simulated=True,
)
def foot_creep(robot: Robot) -> Finding:
    """Return the fastest creep of a geom of a foot that carries its share of the robot's weight."""
    standing, model = standing_of(robot), robot.model
    weight_n = float(model.body_subtreemass[standing.body]) * GRAVITY_M_PER_S2
    count = sum(map(len, standing.feet.values()))
    load_n = np.array([weight_n / count, 0.0])
    geoms, first = (
        robot.pairs.geoms[robot.foot_rows],
        model.body_jntadr[model.geom_bodyid],
    )
    away_m = np.linalg.norm(model.jnt_pos[first] - model.geom_pos, axis=1)
    # A round geom that turns about its centre is a wheel.
    wheels = np.isin(model.geom_type, ROUND) & (first >= 0)
    wheels &= away_m < 0.1 * model.geom_rbound
    rows = np.array(robot.foot_rows)[~wheels[geoms].any(axis=1)].tolist()
    return _creep(robot, rows, load_n)


@model_check(
    "grasp-creep",
    title=f"creep of a finger on an object at {SHARE:g} of its friction limit",
    unit="mm/s",
    interval=(0.0, MAX_CREEP_MM_PER_S),
    source=CREEP_SOURCE,
    consequence="What a hand holds slips out of it.",
    most=Severity.ADVICE,
    is_simulated=True,
)
def grasp_creep(robot: Robot) -> Finding:
    """Return the fastest creep of a driven part on a free body that it touches in the run."""
    held = touching(robot)
    rows = [
        row
        for row in np.flatnonzero(grasping_pairs(robot.model, robot.pairs)).tolist()
        if tuple(robot.pairs.geoms[row].tolist()) in held
    ]
    if robot.standing is not None or not rows:
        raise NotApplicableError("no arm of the model touches a free body in its run")
    return _creep(robot, rows)


def _creep(
    robot: Robot, rows: Sequence[int], forces_n: FloatArray | None = None
) -> Finding:
    """Return the pair that creeps fastest, of rows of `pairs` with friction and different contacts."""
    model, speeds, worst = robot.model, dict[str, float](), Finding(value=0.0)
    pairs: dict[str, int] = {}
    for row in rows:
        links = model.geom_bodyid[robot.pairs.geoms[row]]
        weights = model.body_invweight0[links, 0].round(3)
        if robot.pairs.constants[row, 0] >= 3:
            key = str([robot.pairs.constants[row].tolist(), weights.tolist()])
            pairs.setdefault(key, row)
    for row in [*pairs.values()][:MAX_PAIRS]:
        first, second = robot.pairs.geoms[row].tolist()
        touch = touch_of(robot, (first, second), forces_n)
        try:
            measured = bench(robot, touch, robot.pairs.constants[row])
        except TargetError:
            continue
        speed = 1e-3 * measured.creep_um_per_s(SHARE)
        if np.isnan(speed):
            continue
        name, on = (geom_name(model, geom) for geom in (touch.moving, touch.fixed))
        speeds[name] = max(speed, speeds.get(name, 0.0))
        if speed > worst.value:
            text = f"{name} creeps on {on} at {digits_text(speed)} mm/s, pushed with {SHARE:g} of its friction limit"
            worst = Finding(value=speed, place=("geom", touch.moving), remark=text)
    return replace(worst, parts=speeds)
