"""Checks of the model at rest: overlap, constraints that open, sleep, motion that a finer run does not show, cloth."""

from __future__ import annotations

from operator import attrgetter

import mujoco
import numpy as np

from gauge_envs.tools.sanity.model_checks.check import Finding, leave_to, model_check
from gauge_envs.tools.sanity.model_checks.free_motion import solver
from gauge_envs.tools.sanity.model_checks.runs import LATE, Run, settled
from gauge_envs.tools.sanity.robot.robot import Robot, joints_of, name_of
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


TOWER = 20.0
"""Load of a contact over the weight of its lighter side, up to which softness is a setting of all contacts.

The lowest of twenty equal blocks carries as much. The check rest-height covers the setting itself.
"""


@model_check(
    "model-overlap",
    title="depth of a crushed body at rest, over its size",
    interval=(0.0, 0.01),
    source="solids yield at strains of 0.2 % (steel) to 2 % (plastics); MuJoCo softens a contact as its lighter body",
    consequence="Stacks sink into each other and are lower than in reality.",
    is_usual=True,
    is_simulated=True,
)
def overlap(robot: Robot) -> Finding:
    """Return the largest depth of contacts whose load is many times the weight of their lighter body.

    A contact of MuJoCo with impedance d and stiffness k carries the force m d k r / (1 - d) at a depth r. It moves
    the mass m, so that d k r / (1 - d) over gravity is load over weight ("Computation", constraint model).
    """
    run, findings = settled(robot), []
    model, data = run.model, run.data
    trees, speeds = model.body_treeid, run.speeds_mm_per_s
    # Loose bodies move alone and without a motor: free bodies, and bodies on a single slide or hinge.
    is_loose = (trees >= 0) & (model.tree_bodynum[trees] == 1)
    is_loose &= ~np.isin(trees, list(robot.driven_trees))
    gravity = float(np.linalg.norm(model.opt.gravity)) or np.inf
    for contact in data.contact[: data.ncon]:
        if min(contact.geom) < 0 or contact.efc_address < 0:
            continue
        bodies = model.geom_bodyid[contact.geom].tolist()
        small, large = sorted(bodies, key=lambda body: body_size_m(model, body))
        stiffness, _, impedance, _ = data.efc_KBIP[contact.efc_address]
        depth_m, size_m = -float(contact.dist), body_size_m(model, small)
        load = impedance * stiffness * depth_m / max(1.0 - impedance, 1e-9) / gravity
        if is_loose[small] and speeds[small] <= RESTING_MM_PER_S and load >= TOWER:
            mass = f" ({model.body_mass[large]:.3g} kg)" if large else ""
            findings.append(
                Finding(
                    value=depth_m / size_m,
                    place=("body", small),
                    remark=f"{name_of(robot.model, 'body', small)} ({model.body_mass[small]:.3g} kg) overlaps "
                    f"{name_of(robot.model, 'body', large)}{mass} by {1e3 * depth_m:.3g} mm of its {1e3 * size_m:.3g}",
                )
            )
    return worst(findings)


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

SOFT_S, HARD = 0.02, 0.9
"""Default time constant [s] and impedance of constraints.

A longer time constant, a stiffness or a smaller impedance may mean a spring.
"""


@model_check(
    "model-constraints",
    title="opening of a joined part or stop, over its size",
    interval=(0.0, 0.05),
    source="bearings and stops of machines yield by less than 1 %; MuJoCo's limits by up to 0.02 rad under a robot",
    consequence="Joined parts come apart under load, as on a rubber band.",
    is_usual=True,
    is_simulated=True,
)
def constraints(robot: Robot) -> Finding:
    """Return the largest residual of connections, welds, tendons, couplings without motors and limits at rest."""
    data, model, openings = settled(robot).data, robot.model, []
    times_s = model.eq_solref[:, 0]
    is_soft = (times_s <= 0.0) | (times_s > SOFT_S) | (model.eq_solimp[:, 1] < HARD)
    for kind, number in sorted(set(zip(data.efc_type, data.efc_id, strict=True))):
        is_limit, (noun, ends) = kind != EQUALITY, _part(model, kind, number)
        if not noun:
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
                is_usual=bool(not is_limit and is_soft[number]),
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
        size, text = max(filter(np.isfinite, sizes_m), default=0.0), "apart"
    elif noun == "tendon":
        size = model.tendon_length0[first]
    elif joints_of(model, "SLIDE")[first]:
        size = np.ptp(model.jnt_range[first])
    else:
        size, units = 1.0, ("rad", "N m")
    names = " and ".join(name_of(robot.model, noun, end) for end in ends)
    remark = f"{names}: {residual:.3g} {units[0]} {text} under {force:.3g} {units[1]}"
    return residual / float(size or model.stat.meansize), remark


STILL_MM_PER_S, RESTING_MM_PER_S = 1.0, 10.0
"""Speeds at rest [mm/s]: of each body of a tree in the refined run, and of a body in the run of the model."""


@model_check(
    "model-creep",
    title="speed of a body that rests in a refined run",
    unit="mm/s",
    interval=(0.0, 2.0),
    source="the same model with a tenth of the step and an exact solver; 1 mm in a stance of 0.5 s",
    consequence="What rests creeps or hops, so that stances and grasps drift.",
    is_usual=True,
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
    run = Run(model, finer.sample_s, finer.late_state, LATE)
    speeds = np.where(rests, np.nan_to_num(run.speeds_mm_per_s, nan=np.inf), -1.0)
    body = int(np.argmax(speeds))
    return Finding(
        value=float(speeds[body]),
        place=("body", body),
        remark=f"{name_of(robot.model, 'body', body)} moves at {speeds[body]:.3g} mm/s; with a finer step it rests "
        f"({still[body]:.2g} mm/s)",
    )
