"""Tell which way a knee should bend, and what each joint of a bent leg must hold."""

from collections.abc import Iterator

import mujoco
import numpy as np

from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.finding import standing_of
from gauge_envs.tools.sanity.robot.ground_rows import geoms_of, limbs_of
from gauge_envs.tools.sanity.robot.joints import foot_load_n, start
from gauge_envs.tools.sanity.robot.mass_rows import box_corners
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import Robot, once, random_poses

ACROSS = 0.9
"""Cosine of an axis with the line through both hips from which on a joint bends the leg forwards or backwards."""

LONGER = 1.3
"""Reach of the toes over that of the heel from which on a foot shows where ahead is."""

SHIN_SHARE = 0.1
"""Distance of a knee from the ankle over the height of a robot, at least."""

BENT, LEG_POSES, FEW_POSES = 0.8, 400, 20
"""Height of a bent leg over its longest one, random poses that are tried, and how many of them count."""

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
    aside = apart_m / max(length_of(apart_m), 1e-9)
    ahead = np.cross(aside, np.asarray(robot.up))
    of_foot = np.flatnonzero(model.jnt_bodyid == foot)
    if not len(of_foot) or not geoms_of(robot, foot):
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
        if is_knee and length_of(shin_m) > least_m:
            turn = data.xaxis[joint] * np.sign(bent_rad)
            if float(np.cross(turn, shin_m) @ to_toes) > 0.0:
                yield joint


@once
def bent_legs_nm(robot: Robot) -> FloatArray:
    """Return what each joint must hold of the load of its foot where the leg is bent [Nm], shape [nv].

    Of random poses these are the ones whose foot is nearest to the place below the hip at `BENT` of the longest leg.
    The load is at a quarter of the sole ahead of its middle or behind it, whichever needs more; the middle pose counts.
    """
    model, standing = robot.model, standing_of(robot)
    load_n = foot_load_n(robot) * np.asarray(robot.up)
    legs = {}
    for limb in limbs_of(robot):
        for foot in set(limb) & set(standing.feet):
            corners_m = box_corners(model, standing.feet[foot])
            ahead_m = np.eye(3)[np.ptp(corners_m, axis=0).argmax()]
            ahead_m = 0.25 * np.ptp(corners_m, axis=0).max() * ahead_m
            middle_m = 0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0))
            legs[foot] = limb, [middle_m + ahead_m, middle_m - ahead_m]
    places_m = np.zeros((LEG_POSES, len(legs), 3))
    needed_nm = np.zeros((LEG_POSES, len(legs), model.nv))
    jacobian = np.zeros((3, model.nv))
    for pose, data in enumerate(random_poses(model, LEG_POSES, with_contact=False)):
        for leg, (foot, (limb, points_m)) in enumerate(legs.items()):
            turn = data.xmat[foot].reshape(3, 3)
            for point_m in points_m:
                place_m = data.xpos[foot] + turn @ point_m
                mujoco.mj_jac(model, data, jacobian, None, place_m, foot)
                torques_nm = np.abs(jacobian.T @ load_n)
                needed_nm[pose, leg] = np.maximum(needed_nm[pose, leg], torques_nm)
            places_m[pose, leg] = data.xpos[foot] - data.xpos[limb[-1]]
    below_m = BENT * np.linalg.norm(places_m, axis=-1).max(axis=0)
    wanted_m = -below_m[:, None] * np.asarray(robot.up)
    off_m = np.linalg.norm(places_m - wanted_m, axis=-1)
    nearest = np.argsort(off_m, axis=0)[:FEW_POSES]
    weights_nm = np.zeros(model.nv)
    for poses, leg, (limb, _) in zip(
        nearest.T, range(len(legs)), legs.values(), strict=True
    ):
        # Joints of the trunk, as a waist, carry no foot.
        is_leg = np.isin(model.dof_bodyid, limb)
        middle_nm = np.median(needed_nm[poses, leg], axis=0) * is_leg
        weights_nm = np.maximum(weights_nm, middle_nm)
    return weights_nm
