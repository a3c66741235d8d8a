"""Checks of the model at rest: overlap, constraints that open, slip, motion that a finer run does not show."""

from operator import attrgetter

import mujoco
import numpy as np

from gauge_envs.pages.text import digits_text
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.check import Finding, leave_to, model_check
from gauge_envs.tools.sanity.model_checks.runs import (
    LATE,
    ON_PLANE,
    Run,
    settled,
    solver,
)
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    geom_name,
    joints_of,
    name_of,
    reaches_m,
    unheld,
)
from gauge_envs.tools.sanity.verdict import NotApplicableError

NOTHING = Finding(value=0.0)
"""Finding of a model without a fault."""


def worst(findings: list[Finding]) -> Finding:
    """Return the finding with the largest value."""
    return max([NOTHING, *findings], key=attrgetter("value"))


def body_size_m(model: mujoco.MjModel, body: int) -> float:
    """Return the edge of the cube with the bounding sphere of a body [m]; infinite for a body without bounds."""
    collides = model.geom_contype | model.geom_conaffinity != 0
    radii_m = np.where(model.geom_rbound, model.geom_rbound, np.inf)
    radii_m += np.linalg.norm(model.geom_pos - model.body_ipos[body], axis=-1)
    body_radii_m = radii_m[collides & (model.geom_bodyid == body)]
    return float(2.0 / np.sqrt(3.0) * max(body_radii_m, default=np.inf))


SOFT_S, HARD = 0.02, 0.9
"""Default time constant [s] and impedance of constraints."""


def is_spring(solref: FloatArray, solimp: FloatArray) -> bool:
    """Return whether constants may mean a spring: a longer time, a stiffness, or a smaller impedance."""
    return bool(not 0.0 < solref[0] <= SOFT_S or min(solimp[:2]) < HARD)


@model_check(
    "model-overlap",
    title="depth of a crushed body at rest, over its size",
    interval=(0.0, 0.05),
    source="solids yield at strains of 0.2 % (steel) to 2 % (plastics)",
    consequence="Stacks and grasped objects sink into each other.",
    is_simulated=True,
)
def overlap(robot: Robot) -> Finding:
    """Return the largest depth of contacts of bodies at rest, without contacts that are springs."""
    run, findings = settled(robot), []
    model, speeds = run.model, run.speeds_mm_per_s
    for contact in _contacts(run):
        geoms = sorted(
            contact.geom.tolist(),
            key=lambda geom: body_size_m(model, int(model.geom_bodyid[geom])),
        )
        small = int(model.geom_bodyid[geoms[0]])
        depth_m, size_m = -float(contact.dist), body_size_m(model, small)
        is_soft = is_spring(contact.solref, contact.solimp)
        if speeds[small] <= RESTING_MM_PER_S and not is_soft:
            names = [geom_name(robot.model, geom) for geom in geoms]
            place, share = ("geom", geoms[0]), depth_m / size_m
            remark = f"{names[0]} sinks {1e3 * depth_m:.3g} mm into {names[1]}, {share:.0%} of its size"
            findings.append(Finding(value=share, place=place, remark=remark))
    return worst(findings)


def _contacts(run: Run) -> list[mujoco._structs.MjContact]:
    """Return the contacts of geoms with a force at the end of a run."""
    return [
        contact
        for contact in run.data.contact
        if min(contact.geom) >= 0 and contact.efc_address >= 0
    ]


CONE = 0.9995
"""Share of the friction of a contact or joint from which on it slips."""

FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)


@model_check(
    "model-slip",
    title="speed of a contact or joint that friction holds",
    unit="mm/s",
    interval=(0.0, 1.0),
    source="Coulomb: a contact with a force inside its cone of friction does not slip, nor a joint with a force below "
    "its frictionloss; 1 mm/s drifts 1 cm in 10 s",
    consequence="What friction should hold creeps.",
    is_simulated=True,
)
def slip(robot: Robot) -> Finding:
    """Return the fastest slip without motors: of a contact inside of its cone, or of a joint below its frictionloss."""
    run, findings = settled(robot), _joint_slips(robot)
    model, data, slow = run.model, run.data, run.speeds_mm_per_s < RESTING_MM_PER_S
    counted = {*range(model.ntree)} - robot.driven_trees
    is_elliptic = model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    for contact in _contacts(run):
        bodies = model.geom_bodyid[contact.geom].tolist()
        trees = {*model.body_treeid[bodies].tolist()}
        if contact.dim < 3 or not (slow[bodies].all() and trees & counted):
            continue
        rows = slice(contact.efc_address, contact.efc_address + 4)
        forces, rates = data.efc_force[rows], data.efc_vel[rows]
        friction = np.maximum(contact.friction[:2], 1e-9)
        normal, pull, speeds = forces[0], forces[1:3], rates[1:3]
        if not is_elliptic:
            # Rows of a pyramid are its edges: normal + friction * tangent, and normal - friction * tangent.
            normal, pull = forces.sum(), friction * (forces[[0, 2]] - forces[[1, 3]])
            speeds = (rates[[0, 2]] - rates[[1, 3]]) / (2.0 * friction)
        order = 2 if is_elliptic else 1
        share = np.linalg.norm(pull / friction, order) / max(normal, 1e-9)
        if share < CONE:
            body = max(bodies, key=lambda number: int(model.body_treeid[number]))
            speed = 1e3 * float(np.linalg.norm(speeds))
            name = name_of(robot.model, "body", body)
            text = f"{name} slips at {digits_text(speed)} mm/s under {share:.3g} of the friction that holds it"
            findings.append(Finding(value=speed, place=("body", body), remark=text))
    return worst(findings)


def _joint_slips(robot: Robot) -> list[Finding]:
    """Return the joints that turn at rest below their frictionloss; a hinge has the speed of the end of its limb."""
    data, model, findings = settled(robot).data, robot.model, list[Finding]()
    for row in np.flatnonzero(data.efc_type == FRICTION).tolist():
        dof = data.efc_id[row]
        joint, body = int(model.dof_jntid[dof]), model.dof_bodyid[dof]
        if model.body_treeid[body] in robot.driven_trees:
            continue
        share = abs(data.efc_force[row]) / model.dof_frictionloss[dof]
        arm_m = reaches_m(robot)[body] if joints_of(model, "HINGE")[joint] else 1.0
        speed = 1e3 * float(arm_m * abs(data.efc_vel[row]))
        if share < CONE:
            name, place = name_of(model, "joint", joint), ("joint", joint)
            text = f"{name} moves its limb at {digits_text(speed)} mm/s under {share:.2g} of its dry friction"
            findings.append(Finding(value=speed, place=place, remark=text))
    return findings


EQUALITY = int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)

PARTS = {
    "mjEQ_CONNECT": "body",
    "mjEQ_WELD": "body",
    "mjEQ_JOINT": "joint",
    "mjEQ_TENDON": "tendon",
    "mjCNSTR_LIMIT_JOINT": "joint",
    "mjCNSTR_LIMIT_TENDON": "tendon",
}
"""Elements that equalities join and limits stop, by MuJoCo's name of their type."""


MAX_OPENING, MIN_OPENING_M = 0.05, 0.001
"""Opening over the size of a part that passes, and play of a common bearing [m], which passes too."""


@model_check(
    "model-constraints",
    title="opening of a joined part or stop, over its size",
    interval=(0.0, MAX_OPENING),
    source="bearings and stops of machines yield by less than 1 %; MuJoCo's limits by up to 0.02 rad under a robot",
    consequence="Joined parts come apart under load, as on a rubber band.",
    is_simulated=True,
)
def constraints(robot: Robot) -> Finding:
    """Return the largest residual of rigid connections, welds, tendons, couplings without motors and limits."""
    data, model, openings = settled(robot).data, robot.model, []
    for kind, number in sorted(set(zip(data.efc_type, data.efc_id, strict=True))):
        is_limit, (noun, ends) = kind != EQUALITY, _part(model, kind, number)
        if not noun or (
            not is_limit and is_spring(model.eq_solref[number], model.eq_solimp[number])
        ):
            continue
        rows = (data.efc_type == kind) & (data.efc_id == number)
        force, values = float(np.linalg.norm(data.efc_force[rows])), data.efc_pos[rows]
        # The distance to a limit is negative beyond it. A weld has angles behind its three lengths.
        residual = max(-values[0], 0.0) if is_limit else np.linalg.norm(values[:3])
        ratio, remark = _opening(robot, noun, ends, float(residual), force)
        openings.append(
            Finding(
                value=ratio,
                place=("equality", int(number)) if noun == "body" else (noun, ends[0]),
                remark=remark,
            )
        )
    return worst(openings)


def _part(model: mujoco.MjModel, kind: int, number: int) -> tuple[str, list[int]]:
    """Return the kind of element that a constraint joins or stops, and the ids; no kind for one outside the machine.

    A body that code places may lead parts into limits. Couplings of a motor have another check.
    """
    if kind != EQUALITY:
        name = mujoco.mjtConstraint(kind).name
        return "" if model.nmocap else PARTS.get(name, ""), [int(number)]
    noun = PARTS.get(mujoco.mjtEq(model.eq_type[number]).name, "")
    ends = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
    if noun == "joint" and np.isin(model.actuator_trnid[:, 0], ends).any():
        return "", ends
    if noun != "body":
        return noun, ends[:1]
    if int(model.eq_objtype[number]) == int(mujoco.mjtObj.mjOBJ_SITE):
        ends = model.site_bodyid[ends].tolist()
    return "" if model.body_mocapid[ends].max() >= 0 else noun, ends


def _opening(
    robot: Robot, noun: str, ends: list[int], residual: float, force: float
) -> tuple[float, str]:
    """Return a residual over the size of the larger body, the length of a tendon or the range of a slide.

    The residual of a hinge is in radians.
    """
    model, first = robot.model, ends[0]
    units, text = ("m", "N"), "off its range or coupling"
    if noun == "body":
        sizes_m = [body_size_m(model, body) for body in ends if body]
        size, text = (
            max(filter(np.isfinite, sizes_m), default=model.stat.meansize),
            "apart",
        )
    elif noun == "tendon":
        size = model.tendon_length0[first]
    elif joints_of(model, "SLIDE")[first]:
        size = np.ptp(model.jnt_range[first])
    else:
        size, units = 1.0, ("rad", "N m")
    size = max(size, MIN_OPENING_M / MAX_OPENING)
    names = " and ".join(name_of(robot.model, noun, end) for end in ends)
    verb = "are" if noun == "body" else "is"
    remark = f"{names} {verb} {residual:.3g} {units[0]} {text} under {digits_text(force)} {units[1]}"
    return residual / float(size), remark


STILL_MM_PER_S, RESTING_MM_PER_S = 1.0, 10.0
"""Speeds at rest [mm/s]: of each body of a tree in the refined run, and of a body in the run of the model."""

LASTING, FLAT_M = 5, 0.001
"""Samples for which a body lies on a plane before it hops, and the change of its height in them [m]."""


@model_check(
    "model-hop",
    title="height by which a body leaves the plane on which it slides",
    unit="mm",
    interval=(0.0, 1.0),
    source="Coulomb: friction acts along a plane, so that nothing lifts a body which slides, rolls or lies on it",
    consequence="What slides or rolls leaves the ground.",
    is_simulated=True,
)
def hop(robot: Robot) -> Finding:
    """Return the largest rise of a body without motors that lay flat on a plane before."""
    run, findings = settled(robot), []
    model = robot.model
    for body in unheld(model):
        tree = int(model.body_treeid[body])
        if tree in robot.driven_trees or model.body_gravcomp[body]:
            continue
        heights_m, touching = run.heights_m[:, tree], run.touching[:, tree]
        for lift in np.flatnonzero(touching[1:] == 0) + 1:
            before = slice(max(0, lift - LASTING), lift)
            is_flat = np.ptp(heights_m[before]) < FLAT_M
            if not (is_flat and (touching[before] == ON_PLANE).all()):
                continue
            flight = (touching[lift:] != 0).argmax() or len(touching)
            rise = 1e3 * float(
                heights_m[lift:][:flight].max() - heights_m[before].min()
            )
            text = f"{name_of(model, 'body', body)} hops {digits_text(rise)} mm off its plane"
            findings.append(Finding(value=rise, place=("body", body), remark=text))
    return worst(findings)


@model_check(
    "model-creep",
    title="speed of a body that rests in a refined run",
    unit="mm/s",
    interval=(0.0, 2.0),
    source="the same model with a tenth of the step and an exact solver; 1 mm in a stance of 0.5 s",
    consequence="What rests creeps or hops, so that stances and grasps drift.",
    is_simulated=True,
)
def creep(robot: Robot) -> Finding:
    """Return the largest speed of a body that rests in the refined run.

    The run of the model starts from the late state of the refined run: piles and falls end differently with each step.
    """
    leave_to(solver, robot)
    finer, model = settled(robot, is_refined=True), robot.model
    still = finer.speeds_mm_per_s
    busiest = np.zeros(model.nbody)
    np.maximum.at(busiest, model.body_rootid, still)
    rests = (busiest[model.body_rootid] < STILL_MM_PER_S) & (model.body_dofnum > 0)
    if not rests.any():
        raise NotApplicableError("nothing rests after 2 s without actions")
    run = Run(model, robot.up, finer.sample_s, finer.late_state, LATE)
    speeds = np.where(rests, np.nan_to_num(run.speeds_mm_per_s, nan=np.inf), -1.0)
    body = int(np.argmax(speeds))
    return Finding(
        value=float(speeds[body]),
        place=("body", body),
        remark=f"{name_of(robot.model, 'body', body)} moves at {speeds[body]:.3g} mm/s; with a finer step it rests "
        f"({still[body]:.2g} mm/s)",
    )
