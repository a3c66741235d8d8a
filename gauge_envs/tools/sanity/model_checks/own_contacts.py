"""Checks of the contacts of a robot's own feet and fingers, each measured alone on the bench of two geoms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.model_checks.check import Finding, model_check
from gauge_envs.tools.sanity.model_checks.ground import standing_of
from gauge_envs.tools.sanity.pair_bench import bench, can_measure, touch_of, touching
from gauge_envs.tools.sanity.robot.robot import Robot, geom_name, grasping_pairs
from gauge_envs.tools.sanity.verdict import NotApplicableError

SHARE = 0.7
"""Push over the limit of friction: that of gravity on the published wooden cube, which rests on 10 degrees."""

MAX_CREEP_MM_PER_S = 1.4
"""Fastest creep that the published scores of this cube allow [mm/s]; see `object_checks.friction`."""

MAX_PAIRS = 6
"""Largest number of pairs of geoms with different contacts that are measured."""

CREEP_SOURCE = (
    "Coulomb: v = 0 below the limit; published trials of a wooden cube, at 0.7 of its limit, allow 1.4 mm/s "
    "(paper, Table 5)"
)

Pair = tuple[int, int]


@model_check(
    "foot-creep",
    title=f"creep of a foot at {SHARE:g} of its friction limit",
    unit="mm/s",
    interval=(0.0, MAX_CREEP_MM_PER_S),
    source=CREEP_SOURCE,
    consequence="A robot that stands drifts.",
    is_usual=True,
    is_simulated=True,
)
def foot_creep(robot: Robot) -> Finding:
    """Return the fastest creep of a foot that carries its share of the robot's weight."""
    standing, model = standing_of(robot), robot.model
    weight_n = float(model.body_subtreemass[standing.body]) * GRAVITY_M_PER_S2
    load_n = np.array([weight_n / len(standing.feet), 0.0])
    pairs = _pairs(robot, robot.foot_rows)
    return _creep(robot, pairs, dict.fromkeys(pairs, load_n))


@model_check(
    "grasp-creep",
    title=f"creep of a finger on an object at {SHARE:g} of its friction limit",
    unit="mm/s",
    interval=(0.0, MAX_CREEP_MM_PER_S),
    source=CREEP_SOURCE,
    consequence="What a hand holds slips out of it.",
    is_usual=True,
    is_simulated=True,
)
def grasp_creep(robot: Robot) -> Finding:
    """Return the fastest creep of a driven part on a free body, with the load of the run, or the body's weight."""
    rows = np.flatnonzero(grasping_pairs(robot.model, robot.pairs)).tolist()
    if robot.standing is not None or not rows:
        raise NotApplicableError("no arm of the model can grasp a free body")
    pairs, model = _pairs(robot, rows), robot.model
    forces_n = {}
    for pair in pairs:
        trees = model.body_treeid[model.geom_bodyid[list(pair)]].tolist()
        free = next(tree for tree in trees if tree not in robot.driven_trees)
        weight_n = model.body_subtreemass[model.tree_bodyadr[free]] * GRAVITY_M_PER_S2
        forces_n[pair] = touching(robot).get(pair, np.array([weight_n, 0.0]))
    return _creep(robot, pairs, forces_n)


def _pairs(robot: Robot, rows: Sequence[int]) -> dict[Pair, FloatArray]:
    """Return the constants of pairs with friction and different contacts, shape [17], by their geoms."""
    found: dict[str, tuple[Pair, FloatArray]] = {}
    for row in rows:
        first, second = robot.pairs.geoms[row].tolist()
        constants = robot.pairs.constants[row]
        links = robot.model.geom_bodyid[[first, second]]
        weights = robot.model.body_invweight0[links, 0].round(3)
        if constants[0] >= 3 and can_measure(robot.model, first, second):
            key = str([*constants.tolist(), *weights.tolist()])
            found.setdefault(key, ((first, second), constants))
    return dict([*found.values()][:MAX_PAIRS])


def _creep(
    robot: Robot,
    pairs: Mapping[Pair, FloatArray],
    forces_n: Mapping[Pair, FloatArray],
) -> Finding:
    """Return the pair that creeps fastest."""
    speeds: dict[str, float] = {}
    worst = Finding(value=0.0)
    for pair, constants in pairs.items():
        touch = touch_of(robot, pair, forces_n[pair])
        speed = 1e-3 * bench(robot, touch, constants).creep_um_per_s(SHARE)
        name, on = (geom_name(robot.model, g) for g in (touch.moving, touch.fixed))
        speeds[name] = max(speed, speeds.get(name, 0.0))
        if speed > worst.value:
            text = f"{name} creeps at {speed:.3g} mm/s on {on}, at {SHARE:g} of its friction limit"
            worst = Finding(value=speed, place=("geom", touch.moving), remark=text)
    return replace(worst, parts=speeds)
