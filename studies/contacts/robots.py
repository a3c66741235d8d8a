"""Compare the friction in force of published robots with `contact.friction` of plain MuJoCo.

    python -m studies.contacts.robots FILE ...

Feet are pushed into the floor and joints take random poses, until pairs touch in `mj_forward`. Each row: the file, its
pairs of a foot or finger that touched, those whose friction differs from either side's stated one, and differences.
"""

import sys
from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.errors import GaugeError
from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.robot.robot import Robot, grasping_pairs, random_poses

PUSHES_M = np.linspace(0.1, -0.2, 61)
"""Heights of free bodies over those of the keyframe [m]."""


def states(robot: Robot) -> Iterator[mujoco.MjData]:
    """Yield the model with its free bodies lowered, then in random poses."""
    model, data = robot.model, mujoco.MjData(robot.model)
    free = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    for push_m in PUSHES_M:
        data.qpos[:] = robot.stance.qpos
        data.qpos[free + 2] += push_m
        mujoco.mj_forward(model, data)
        yield data
    yield from random_poses(model, poses=300)


def compared(robot: Robot) -> tuple[int, int, int]:
    """Return the numbers of pairs of feet and fingers that touched, of those with another friction, of differences."""
    model, pairs = robot.model, robot.pairs
    wanted = set(robot.foot_rows) | set(np.flatnonzero(grasping_pairs(model, pairs)))
    wanted = wanted or set(range(len(pairs.geoms)))
    rows = {tuple(sorted(pairs.geoms[row])): row for row in wanted}
    seen: dict[tuple[int, int], float] = {}
    for data in states(robot):
        for contact in data.contact:
            seen[tuple(sorted(contact.geom.tolist()))] = float(contact.friction[0])
    touched = {pair: friction for pair, friction in seen.items() if pair in rows}
    mixed = sum(
        len({*model.geom_friction[list(pair), 0].tolist()}) > 1 for pair in touched
    )
    wrong = sum(
        pairs.constants[rows[pair], 1] != friction for pair, friction in touched.items()
    )
    return len(touched), mixed, int(wrong)


if __name__ == "__main__":
    for file in sys.argv[1:]:
        try:
            robot = configuration(file).robot
            assert robot is not None
            count, mixed, wrong = compared(robot)
        except GaugeError as error:
            print(f"{file}: {str(error)[:150]}", file=sys.stderr)
            continue
        if count:
            print(
                f"{file}: {count} pairs touched, {mixed} of unlike materials, {wrong} differ",
                flush=True,
            )
