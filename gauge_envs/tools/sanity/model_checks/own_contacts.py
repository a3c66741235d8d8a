"""Checks of the contacts of a robot's own feet and fingers, each measured alone on the bench of two geoms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.pages.text import digits_text
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.check import Finding, model_check
from gauge_envs.tools.sanity.model_checks.ground import standing_of
from gauge_envs.tools.sanity.pair_bench import bench, touch_of, touching
from gauge_envs.tools.sanity.robot.robot import Robot, geom_name, grasping_pairs
from gauge_envs.tools.sanity.verdict import NotApplicableError, Severity

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
