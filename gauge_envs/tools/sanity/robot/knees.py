"""Tell by feet and ranges which way a knee should bend."""

from collections.abc import Iterator

import numpy as np

from gauge_envs.tools.sanity.robot.finding import standing_of
from gauge_envs.tools.sanity.robot.ground_rows import geoms_of
from gauge_envs.tools.sanity.robot.joints import start
from gauge_envs.tools.sanity.robot.mass_rows import box_corners
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import Robot

ACROSS = 0.9
"""Cosine of an axis with the line through both hips from which on a joint bends the leg forwards or backwards."""

LONGER = 1.3
"""Reach of the toes over that of the heel from which on a foot shows where ahead is."""

SHIN_SHARE = 0.1
"""Distance of a knee from the ankle over the height of a robot, at least."""

ONE_SIDED = 0.7
"""Difference of the two ends of a range over the range from which on a joint bends one way."""


def wrong_knees(robot: Robot, limb: list[int], limbs: list[list[int]]) -> Iterator[int]:
    """Yield the joint of a leg that its range bends so that the foot moves towards its toes; knees do not.

    Args:
        robot: A robot on two feet.
        limb: Bodies of the leg, from its foot upwards.
        limbs: Those of both legs.
    """
    model, data, foot = robot.model, start(robot), limb[0]
    hips_m = data.xpos[[one[-1] for one in limbs]]
    apart_m = hips_m[1] - hips_m[0]
    aside = apart_m / max(float(np.linalg.norm(apart_m)), 1e-9)
    ahead = np.cross(aside, np.asarray(robot.up))
    of_foot = np.flatnonzero(model.jnt_bodyid == foot)
    if not len(of_foot):
        return
    ankle_m = data.xanchor[of_foot[-1]]
    corners_m = box_corners(model, geoms_of(robot, foot))
    places_m = corners_m @ data.xmat[foot].reshape(3, 3).T + data.xpos[foot]
    reach_m = (places_m - ankle_m) @ ahead
    first_m, last_m = float(-reach_m.min()), float(reach_m.max())
    heel_m, toes_m = sorted((first_m, last_m))
    if toes_m < LONGER * heel_m:
        return
    to_toes = ahead if last_m > first_m else -ahead
    least_m = SHIN_SHARE * standing_of(robot).height_m
    is_limited = (model.jnt_limited != 0) & joints_of(model, "HINGE")
    is_across = np.abs(data.xaxis @ aside) > ACROSS
    on_limb = np.isin(model.jnt_bodyid, limb)
    for joint in np.flatnonzero(on_limb & is_across & is_limited).tolist():
        low_rad, high_rad = (
            model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]
        )
        shin_m = ankle_m - data.xanchor[joint]
        bent_rad = low_rad + high_rad
        is_knee = abs(bent_rad) > ONE_SIDED * (high_rad - low_rad)
        if is_knee and float(np.linalg.norm(shin_m)) > least_m:
            turn = data.xaxis[joint] * np.sign(bent_rad)
            if float(np.cross(turn, shin_m) @ to_toes) > 0.0:
                yield joint
