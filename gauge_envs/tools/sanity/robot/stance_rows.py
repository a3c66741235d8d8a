"""Judge how a robot stands on two feet: level, and in balance."""

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    NotApplicableError,
    body_name,
    name_of,
    row,
    standing_of,
)
from gauge_envs.tools.sanity.robot.ground_rows import (
    geoms_of,
    limbs_of,
)
from gauge_envs.tools.sanity.robot.joints import start
from gauge_envs.tools.sanity.robot.legs import wrong_knees
from gauge_envs.tools.sanity.robot.mass_rows import SIGNS, size_m
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    joints_of,
    support_m,
)
from gauge_envs.tools.sanity.robot.robot import Robot

LYING_DEG = 90.0
"""Lean of a robot that lies [degrees]; what a knee that bends the wrong way counts."""

LYING_SHARE = 0.2
"""Height of the centre of mass over the size of a robot below which it lies; 0.5 of a standing one."""

SAME_LEG_M = 0.01
"""Distance up to which two legs part from the same place [m]."""


def _two_feet(robot: Robot) -> list[list[int]]:
    """Return the limbs of a robot that stands on two feet, each from its foot upwards; one that lost its foot has two.

    The limbs have as many bodies and part from the same body, side by side along the axis of a joint of theirs.
    """
    standing = standing_of(robot)
    limbs = limbs_of(robot)
    feet = [limb for limb in limbs if set(limb) & set(standing.feet)]
    if len(feet) > 2 or not feet:
        raise NotApplicableError("the robot does not stand on two feet")

    def origin(limb: list[int]) -> tuple[int, int]:
        return int(robot.model.body_parentid[limb[-1]]), len(limb)

    alike = [limb for limb in limbs if origin(limb) == origin(feet[0])]
    if len(alike) != 2:
        raise NotApplicableError("the robot does not stand on two like legs")
    data = start(robot)
    places = data.xpos[[int(limb[-1]) for limb in alike]]
    apart_m = places[1] - places[0]
    distance_m = length_of(apart_m)
    on_limb = np.isin(robot.model.jnt_bodyid, alike[0]) & joints_of(
        robot.model, "HINGE"
    )
    along_m = np.abs(data.xaxis[on_limb] @ apart_m).max(initial=0.0)
    if distance_m > SAME_LEG_M and along_m < 0.5 * distance_m:
        raise NotApplicableError("one of the two legs stands behind the other")
    ground_m = min(float(point[2]) for point in standing.support_m.values())
    if standing_centre(robot, data)[2] - ground_m < LYING_SHARE * size_m(robot):
        raise NotApplicableError("the robot lies in its initial pose")
    return alike


@row("robot-level")
def _level(robot: Robot) -> Finding:
    model, standing = robot.model, standing_of(robot)
    heights_mm = {}
    for limb in _two_feet(robot):
        geoms = [geom for body in limb for geom in geoms_of(robot, body)]
        touching = [geom for geom in geoms if geom in standing.support_m]
        lows = [float(support_m(model, standing.stance, geom)[2]) for geom in touching]
        if not lows:
            return Finding(declined="a foot cannot touch the ground")
        heights_mm[limb[0]] = 1e3 * min(lows)
    lower, upper = sorted(heights_mm, key=heights_mm.__getitem__)
    apart_mm = heights_mm[upper] - heights_mm[lower]
    names = f"{body_name(robot, upper)} above {body_name(robot, lower)}"
    data = start(robot)
    links_mm = 1e3 * abs(float((data.xpos[upper] - data.xpos[lower]) @ robot.up))
    unlike = "lengths, axes and angles"
    if links_mm < 0.5 * apart_mm:
        unlike = "pos and size of the geoms that touch"
    return Finding(
        value=apart_mm / (1e3 * standing.height_m),
        remark=f"{names} by {apart_mm:.3g} mm in the {standing.stance.label}",
        advice=f"the same {unlike} in both legs: {names}",
    )


@row("robot-balance")
def _balance(robot: Robot) -> Finding:
    standing = standing_of(robot)
    limbs = _two_feet(robot)
    data = start(robot)
    if knees := [knee for limb in limbs for knee in wrong_knees(robot, limb, limbs)]:
        names = " and ".join(name_of(robot, knee) for knee in knees)
        return Finding(
            # Two of them are worse than one.
            value=LYING_DEG * len(knees),
            parts=dict.fromkeys((name_of(robot, knee) for knee in knees), LYING_DEG),
            remark=f"towards the toes bends {names}",
            advice=f"the axis and the signs of the range of {names}",
        )
    points = []
    ground = min(float(point[2]) for point in standing.support_m.values())
    for geoms in standing.feet.values():
        for geom in geoms:
            points.append(_sole_points(robot, geom, ground))
    centre = standing_centre(robot, data)
    soles = np.vstack(points)[:, :2]
    outside_m = outside(soles, centre[:2])
    height_m = max(float(centre[2]) - ground, 1e-3)
    return Finding(
        value=float(np.degrees(np.arctan2(outside_m, height_m))),
        remark=f"centre of mass {1e3 * outside_m:.3g} mm outside the feet, {1e3 * height_m:.3g} mm above the ground",
        advice=f"knees that bend the right way, and a pose ({standing.stance.label}) over the feet",
    )


def standing_centre(robot: Robot, data: mujoco.MjData) -> FloatArray:
    """Return the centre of mass of a robot in the frame with z up in which it stands [m], shape [3]."""
    standing = standing_of(robot)
    mass = robot.model.body_mass[robot.bodies]
    centre = mass @ data.xipos[robot.bodies] / mass.sum()
    geom = next(iter(standing.support_m))
    here = standing.stance.positions_m[geom]
    turn = standing.stance.rotations[geom].as_matrix()
    local = data.geom_xmat[geom].reshape(3, 3).T @ (centre - data.geom_xpos[geom])
    return np.asarray(here + turn @ local)


def _sole_points(robot: Robot, geom: int, ground_m: float) -> FloatArray:
    """Return corners of the box of a geom that lie low, in the frame with z up [m], shape [count, 3]."""
    model, stance = robot.model, standing_of(robot).stance
    box = model.geom_aabb[geom, :3] + SIGNS * model.geom_aabb[geom, 3:]
    corners = stance.positions_m[geom] + stance.rotations[geom].apply(box)
    low = corners[:, 2] <= ground_m + 0.05 * standing_of(robot).height_m
    points: FloatArray = corners[low] if low.any() else corners
    return points


def outside(points: FloatArray, place: FloatArray) -> float:
    """Return the distance of a place from the hull of points in a plane [m]; 0 inside.

    Args:
        points: The points [m], shape [count, 2].
        place: The place [m], shape [2].
    """
    try:
        hull = ConvexHull(points)
    except QhullError:
        return float(np.linalg.norm(points - place, axis=1).min())
    if (hull.equations[:, :2] @ place + hull.equations[:, 2] <= 0.0).all():
        return 0.0
    first, second = points[hull.simplices[:, 0]], points[hull.simplices[:, 1]]
    along = second - first
    share = ((place - first) * along).sum(axis=1) / (along**2).sum(axis=1)
    nearest = first + np.clip(share, 0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(nearest - place, axis=1).min())
