"""Rows on the model at rest: overlap, constraints that open, sleep, motion that a finer run does not show, cloth."""

from __future__ import annotations

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.itself.runs import (
    LATE,
    REST_S,
    SAMPLES,
    SLEEP,
    has_diverged,
    refined_rest,
    rest,
    rest_from_refined,
    seconds,
    settled,
    start_data,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.rows import (
    Finding,
    NotApplicableError,
    Place,
    row,
)


def name_of(robot: Robot, kind: str, number: int) -> str:
    """Return the name of an element; of a body without a name that of its first geom; else kind and number."""
    element = getattr(robot.model, kind)(number)
    name: str = element.name
    if kind == "body" and not name and element.geomnum[0]:
        name = robot.model.geom(element.geomadr[0]).name
    return name or f"{kind} {number}"


def body_size_m(model: mujoco.MjModel, body: int) -> float:
    """Return the edge of the cube whose bounding sphere is that of a body [m]; infinite for one without bounds."""
    geoms = np.flatnonzero(model.geom_bodyid == body)
    geoms = geoms[model.geom_contype[geoms] | model.geom_conaffinity[geoms] != 0]
    if not len(geoms) or not model.geom_rbound[geoms].all():
        return np.inf
    offsets_m = np.linalg.norm(model.geom_pos[geoms] - model.body_ipos[body], axis=-1)
    radius_m = (offsets_m + model.geom_rbound[geoms]).max()
    return float(2.0 * radius_m / np.sqrt(3.0))


def objects(model: mujoco.MjModel) -> list[int]:
    """Return bodies that move freely, and alone."""
    bodies = model.jnt_bodyid[joints_of(model, "FREE")]
    is_alone = model.body_subtreemass[bodies] == model.body_mass[bodies]
    alone: list[int] = bodies[is_alone].tolist()
    return alone


TOWER = 20.0
"""Load of a contact over the weight of its lighter side, up to which softness is a setting of all contacts.

The lowest of twenty equal blocks carries as much. The row on the sink at rest judges the setting itself.
"""


@row(
    "model-overlap",
    title="depth by which a heavy body crushes a light one at rest, over the light one's size",
    unit="1",
    interval=(0.0, 0.01),
    source="solids yield at strains of 0.2 % (steel) to 2 % (plastics); MuJoCo softens a contact as its lighter body",
    consequence="Stacks sink into each other, and what stands on them is lower than in reality.",
)
def overlap(robot: Robot) -> Finding:
    """Return the largest depth of contacts whose load is many times what their lighter body weighs.

    A contact of MuJoCo with impedance d and stiffness k carries the force m d k r / (1 - d) at a depth r, with the
    mass m that it accelerates ("Computation", constraint model): d k r / (1 - d) over gravity is load over weight.
    """
    run = settled(robot)
    model, data = run.model, run.data
    free, speeds = objects(model), 1e3 * run.speeds_m_per_s
    gravity = float(np.linalg.norm(model.opt.gravity)) or np.inf
    finding = Finding(value=0.0)
    for contact in data.contact[: data.ncon]:
        if min(contact.geom) < 0 or contact.efc_address < 0:
            continue
        sizes_m = {
            body: body_size_m(model, body)
            for body in model.geom_bodyid[contact.geom].tolist()
        }
        small, large = sorted(sizes_m, key=lambda body: (sizes_m[body], body))
        stiffness, _, impedance, _ = data.efc_KBIP[contact.efc_address]
        depth_m = -float(contact.dist)
        load = impedance * stiffness * depth_m / max(1.0 - impedance, 1e-9)
        ratio = depth_m / sizes_m[small]
        if (
            small not in free
            or speeds[small] > RESTING_MM_PER_S
            or load < TOWER * gravity
            or ratio < finding.value
        ):
            continue
        names = [
            f"{name_of(robot, 'body', body)} ({model.body_mass[body]:.3g} kg)"
            for body in (small, large)
        ]
        finding = Finding(
            value=ratio,
            place=("body", small),
            remark=f"{names[0]} overlaps {names[1]} by {1e3 * depth_m:.3g} mm of its {1e3 * sizes_m[small]:.3g}",
        )
    return finding


EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
LIMIT_JOINT = int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT)
LIMIT_TENDON = int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON)

JOINED = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
COUPLED = int(mujoco.mjtEq.mjEQ_JOINT)

SOFT_S = 0.02
"""Time constant of constraints by default [s]: who states a longer one, or a stiffness, may mean a spring."""


@row(
    "model-constraints",
    title="opening of a connection or stop of the model under its load, over the size of what it joins, or in radians",
    unit="1",
    interval=(0.0, 0.05),
    source="bearings and stops of machines yield by less than 1 %; MuJoCo's limits by up to 0.02 rad under a robot",
    consequence="Parts that are joined come apart under load, so that forces and motions are those of a rubber band.",
)
def constraints(robot: Robot) -> Finding:
    """Return the largest residual of connections, welds, tendons, couplings without motors and limits at rest."""
    run = settled(robot)
    model, finding = run.model, Finding(value=0.0)
    judged = [_is_judged(model, number) for number in range(model.neq)]
    is_led = any(
        int(kind) in JOINED and not is_judged
        for kind, is_judged in zip(model.eq_type, judged, strict=True)
    )
    begin, end = _residuals(model, start_data(model)), _residuals(model, run.data)
    for (kind, number), (values, force) in end.items():
        # A body that code places leads the rest into its limits.
        if is_led if kind != EQUALITY else not judged[number]:
            continue
        # What is open from the start and does not open further is no matter of load.
        first, _ = begin.get((kind, number), (np.zeros(len(values)), 0.0))
        before, *_ = _opening(robot, kind, number, first, force)
        after, place, remark = _opening(robot, kind, number, values, force)
        if after - before > finding.value:
            finding = Finding(
                value=after - before,
                place=place,
                remark=remark,
                is_usual=kind == EQUALITY and _is_soft(model, number),
            )
    return finding


def _residuals(
    model: mujoco.MjModel, data: mujoco.MjData
) -> dict[tuple[int, int], tuple[FloatArray, float]]:
    """Return residuals [m or rad] and force [N or N m] of each equality and limit, by type and id."""
    residuals = {}
    for kind in (EQUALITY, LIMIT_JOINT, LIMIT_TENDON):
        for number in np.unique(data.efc_id[data.efc_type == kind]).tolist():
            rows = (data.efc_type == kind) & (data.efc_id == number)
            force = float(np.linalg.norm(data.efc_force[rows]))
            residuals[kind, number] = (data.efc_pos[rows], force)
    return residuals


def _is_judged(model: mujoco.MjModel, number: int) -> bool:
    """Return whether an equality is a part of the machine: no weld to a mocap body, no coupling of a motor, no flex."""
    kind = int(model.eq_type[number])
    ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
    if kind in JOINED:
        return not any(model.body_mocapid[body] >= 0 for body in _bodies(model, number))
    if kind == COUPLED:
        return not np.isin(model.actuator_trnid[:, 0], ends).any()
    return kind == int(mujoco.mjtEq.mjEQ_TENDON)


def _bodies(model: mujoco.MjModel, number: int) -> list[int]:
    """Return the bodies of a connection or weld."""
    ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
    if int(model.eq_objtype[number]) == int(mujoco.mjtObj.mjOBJ_SITE):
        ends = [int(model.site_bodyid[site]) for site in ends]
    return ends


def _is_soft(model: mujoco.MjModel, number: int) -> bool:
    """Return whether an equality states constants that are softer than MuJoCo's default."""
    constant = float(model.eq_solref[number, 0])
    return not 0.0 < constant <= SOFT_S or model.eq_solimp[number, 1] < 0.9


def _opening(
    robot: Robot, kind: int, number: int, values: FloatArray, force: float
) -> tuple[float, Place, str]:
    """Return the opening of a constraint as a ratio, the element, and what happens there."""
    model, is_equality = robot.model, kind == EQUALITY
    eq_type = int(model.eq_type[number]) if is_equality else -1
    if eq_type in JOINED:
        bodies = _bodies(model, number)
        sizes_m = [body_size_m(model, body) for body in bodies if body]
        size_m = max(filter(np.isfinite, sizes_m), default=float(model.stat.meansize))
        gap_m = float(np.linalg.norm(values[:3]))
        names = " and ".join(name_of(robot, "body", body) for body in bodies)
        text = f"{names} are {1e3 * gap_m:.3g} mm apart under {force:.3g} N"
        return gap_m / size_m, ("equality", number), text
    element = int(model.eq_obj1id[number]) if is_equality else number
    noun = "joint" if kind == LIMIT_JOINT or eq_type == COUPLED else "tendon"
    # The distance to a limit is negative beyond it.
    residual = abs(float(values[0])) if is_equality else max(-float(values[0]), 0.0)
    scale, unit = 1.0, "rad"
    if noun == "tendon":
        scale, unit = float(model.tendon_length0[element]), "m"
    elif joints_of(model, "SLIDE")[element]:
        scale, unit = float(np.ptp(model.jnt_range[element])), "m"
    text = "off its coupling" if is_equality else "beyond its range"
    load = f"{force:.3g} {'N' if unit == 'm' else 'N m'}"
    name = name_of(robot, noun, element)
    ratio = residual / (scale or float(model.stat.meansize))
    return (
        ratio,
        (noun, element),
        f"{name} is {residual:.3g} {unit} {text} under {load}",
    )


@row(
    "model-sleep",
    title="speed of a body that sleeps and should move",
    unit="mm/s",
    interval=(0.0, 1.0),
    source="the same model without sleep; 1 mm/s is MuJoCo's default tolerance of sleep",
    consequence="What should drift, tip or slide stands still, so that the policy counts on it.",
)
def sleeping(robot: Robot) -> Finding:
    """Return the largest mean speed in the refined run of a body that sleeps in the target's run."""
    if not robot.model.opt.enableflags & SLEEP:
        raise NotApplicableError("the model does not let bodies sleep")
    run, finer = settled(robot), refined_rest(robot)
    finding = Finding(value=0.0)
    for body in np.flatnonzero(~run.is_awake[-1]).tolist():
        begin = int(np.flatnonzero(run.is_awake[:, body]).max(initial=-1)) + 1
        paths = finer.points_m[:, body]
        # Where the two runs differ before the body sleeps, chaos parted them.
        gap_m = np.abs(paths[begin] - run.points_m[begin, body]).max()
        moved_m = float(np.linalg.norm(paths[-1] - paths[begin], axis=-1).max())
        speed = 1e3 * moved_m / (run.sample_s * max(SAMPLES - 1 - begin, LATE))
        if speed > finding.value and gap_m < SAME_M:
            finding = Finding(
                value=speed,
                place=("body", body),
                remark=f"{name_of(robot, 'body', body)} sleeps; awake it moves at {speed:.3g} mm/s",
            )
    return finding


SAME_M = 1e-3
"""Distance up to which two runs are in one place [m]."""

STILL_MM_PER_S, RESTING_MM_PER_S = 1.0, 10.0
"""Speeds below which all of a tree counts as at rest in the refined run, and a body in the run of the model [mm/s]."""


@row(
    "model-creep",
    title="speed at rest of a body that rests in the same model with a tenth of the step and an exact solver",
    unit="mm/s",
    interval=(0.0, 2.0),
    source="the refined run rests; a foot that moves by 1 mm in a stance of 0.5 s",
    consequence="What rests creeps or hops, so that stances and grasps drift.",
)
def creep(robot: Robot) -> Finding:
    """Return the largest speed of a body that rests in the refined run, from whose state the run of the model goes on.

    The common state leaves out that piles and falls end differently with each step.
    """
    settled(robot)
    finer = refined_rest(robot)
    if np.isfinite(finer.diverged_s):
        raise NotApplicableError("the refined run diverges")
    run = rest_from_refined(robot)
    speeds, still = 1e3 * run.speeds_m_per_s, 1e3 * finer.speeds_m_per_s
    roots = robot.model.body_rootid
    busiest = np.zeros(len(roots))
    np.maximum.at(busiest, roots, still)
    rests = (busiest[roots] < STILL_MM_PER_S) & (robot.model.body_dofnum > 0)
    if not rests.any():
        raise NotApplicableError("nothing rests after 2 s without actions")
    body = int(np.argmax(np.where(rests, speeds, -1.0)))
    return Finding(
        value=float(speeds[body]),
        place=("body", body),
        remark=f"{name_of(robot, 'body', body)} moves at {speeds[body]:.3g} mm/s; with a finer step it rests "
        f"({still[body]:.2g} mm/s)",
    )


def flex_name(model: mujoco.MjModel, flex: int) -> str:
    """Return the name of a flex, or its number."""
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, flex)
    return name or f"flex {flex}"


def _worst_flex(robot: Robot, values: FloatArray) -> tuple[float, int]:
    """Return the largest value that a flex has for a tenth of the run, and the flex."""
    often = np.quantile(values, 0.9, axis=0)
    flex = int(often.argmax())
    return float(often[flex]), flex


@row(
    "model-cloth",
    title="stretch of edges that the model holds at their length, at rest under gravity",
    unit="1",
    interval=(0.0, 0.05),
    source="an edge with an equality has no elasticity; woven cloth stretches by less than 5 % under its weight",
    consequence="Cloth or rope flows like rubber, so that a grasp lifts a part of it.",
)
def cloth(robot: Robot) -> Finding:
    """Return the strain of the edges of flexes whose length an equality holds."""
    run = settled(robot)
    if not robot.model.nflex or not robot.model.flex_edgeequality.any():
        raise NotApplicableError("the model has no flex whose edges keep their length")
    strain, flex = _worst_flex(robot, run.stretches)
    name = flex_name(robot.model, flex)
    return Finding(
        value=strain,
        remark=f"edges of {name} stretch by {100.0 * strain:.3g} % under gravity",
    )


@row(
    "model-cloth-sink",
    title="depth of the model's cloth in what carries it, over its thickness",
    unit="1",
    interval=(0.0, 1.0),
    source="two solids do not share a place; MuJoCo's flex is as thick as twice its radius",
    consequence="Cloth passes into or through what it lies on.",
)
def cloth_sink(robot: Robot) -> Finding:
    """Return the depth of flexes in rigid bodies."""
    run = settled(robot)
    if not robot.model.nflex:
        raise NotApplicableError("the model has no flex")
    thicknesses_m = 2.0 * np.maximum(robot.model.flex_radius, 1e-3)
    ratio, flex = _worst_flex(robot, run.sinks_m / thicknesses_m)
    name = flex_name(robot.model, flex)
    return Finding(
        value=ratio,
        remark=f"{name} is {1e3 * ratio * thicknesses_m[flex]:.3g} mm inside what carries it",
    )


SINE_HZ, SINE_S, SINE_SHARE = 1.0, 1.0, 0.25
"""Frequency and time of sines of the commands, and their amplitude over the range of a command."""

SINE_RAD = 0.2
"""Amplitude of a command without a range."""


def _diverged_on_sines_s(robot: Robot) -> float:
    """Return the time at which the state diverges while the commands follow sines [s]; infinite if it does not."""
    model, data = robot.model, start_data(robot.model)
    begin, begin_s = data.ctrl.copy(), float(data.time)
    low, high = model.actuator_ctrlrange.T
    is_limited = model.actuator_ctrllimited.astype(bool)
    sizes = np.where(is_limited, SINE_SHARE * (high - low), SINE_RAD)
    phases = np.arange(model.nu)
    while data.time - begin_s < seconds(model, SINE_S):
        turn = 2.0 * np.pi * SINE_HZ * (data.time - begin_s)
        data.ctrl[:] = begin + sizes * (np.sin(turn + phases) - np.sin(phases))
        mujoco.mj_step(model, data)
        if has_diverged(data):
            return max(float(data.time) - begin_s, float(model.opt.timestep))
    return np.inf


@row(
    "robot-holds",
    title="time for which the state stays finite at rest, over 2 s, then while its commands follow sines",
    unit="1",
    interval=(1.0, np.inf),
    source="a run of the model from its keyframe or initial pose, without actions and along sines",
    consequence="Training meets NaN or is reset in each episode.",
)
def holds(robot: Robot) -> Finding:
    """Return the time for which the state stays finite, over that of the run."""
    if not robot.model.nv:
        raise NotApplicableError("the model has no joint")
    diverged_s, motion = rest(robot).diverged_s, "at rest"
    if np.isinf(diverged_s):
        diverged_s, motion = (
            _diverged_on_sines_s(robot),
            "while its commands follow sines",
        )
    if np.isinf(diverged_s):
        return Finding(value=1.0)
    return Finding(
        value=min(diverged_s / REST_S, 0.3),
        remark=f"the state diverges after {diverged_s:.3g} s {motion}, with a step of {robot.model.opt.timestep:g} s",
    )
