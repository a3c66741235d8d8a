"""Say in which number a joint differs from its mirror image, or from joints of the same motor."""

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from gauge_envs.tools.sanity.robot.copies import SHARED, odd_motors, quantities
from gauge_envs.tools.sanity.robot.finding import Finding, limits_of, name_of
from gauge_envs.tools.sanity.robot.mirror import mirror_pairs
from gauge_envs.tools.sanity.robot.mujoco_feet import geom_name
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.robot.sides import SHAPES, differences

Row = Callable[[Robot], Finding]


def advised(name: str, row: Row) -> Row:
    """Return a row whose advice for joints, or their links, is the number in which they differ from like ones."""

    def found(robot: Robot) -> Finding:
        known, (low, high) = row(robot), limits_of(name)
        off = [part for part, one in known.parts.items() if not low <= one <= high]
        instead = unlike_others(robot, off) if known.advice else ""
        return replace(known, advice=instead, changes={}) if instead else known

    return found


def unlike_others(robot: Robot, names: Collection[str]) -> str:
    """Return the number in which each of some joints differs from like ones, as an advice; empty where one does not.

    Args:
        robot: The robot.
        names: Names of joints, or of geoms of the links that they move.
    """
    model, advice = robot.model, ""
    joints = {
        geom_name(model, g): int(model.body_jntadr[b])
        for g, b in enumerate(model.geom_bodyid)
    }
    joints |= {name_of(robot, joint): joint for joint in range(model.njnt)}
    for name in names:
        joint = joints.get(name, -1)
        quantity, other, apart = _farthest(robot, joint)
        if apart <= limits_of("robot-sides")[1]:
            return ""
        advice = f"the same for both: {quantity} of {name_of(robot, joint)} and {name_of(robot, other)}"
        if quantity in SHARED:
            values = quantities(robot)[quantity][model.jnt_dofadr[[joint, other]]]
            advice += f", {values[0]:.3g} and {values[1]:.3g}"
    return advice


def _farthest(robot: Robot, joint: int) -> tuple[str, int, float]:
    """Return the number in which a joint differs most from a like one, that one, and the difference; 0 without one."""
    if joint in odd_motors(robot):
        return *odd_motors(robot)[joint], np.inf
    found = [("", joint, 0.0)]
    for pair in mirror_pairs(robot):
        if joint in (pair.joint, pair.other):
            (other,) = {pair.joint, pair.other} - {joint}
            several = differences(robot, pair)
            found += [(n, other, off) for n, off in several if n in {*SHARED, SHAPES}]
    return max(found, key=lambda one: one[2])
