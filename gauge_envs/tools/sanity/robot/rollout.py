"""Judge how a robot stands under its own servos, and how its feet hold on a slope."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.robot.ground_rows import NOT_STANDING, standing_of
from gauge_envs.tools.sanity.robot.joints import drives, servos, start
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import Robot, once
from gauge_envs.tools.sanity.rows import (
    Finding,
    NotApplicableError,
    NotMeasuredError,
    row,
)

HOLD_S, LATE_S = 2.0, 0.5
"""Time for which the robot is held [s], and its end, in which speeds and torques are read."""

SLOPE_DEG, SLOPE_PUSH = 10.0, 0.7
"""Slope on which feet stand [degrees], and the largest push, over what their friction holds."""

FELL, ROSE = 0.7, 1.3
"""Height of the centre of mass over that at the start of a robot that fell, and of one that rose."""

LEAN_RAD = 0.3
"""Angle by which a robot that still stands may turn [rad]."""

LEAST_GAP_MM = 10.0
"""Height of feet above or in the ground that is named [mm]."""

LEAST_FEET = 3
"""Feet on which a robot stands without a policy."""


@dataclass(frozen=True, kw_only=True)
class HoldMotion:
    """What a robot did while its servos held the pose in which it stands.

    Attributes:
        height_ratio: Height of its centre of mass at the end, over that at the start.
        lean_rad: Angle by which its trunk turned [rad].
        saturations: Mean force over its limit of each drive, by degree of freedom, late in the motion.
        slip_mm_per_s: Mean speed of its feet along the ground, late in the motion [mm/s].
    """

    height_ratio: float
    lean_rad: float
    saturations: Mapping[int, float] = field(default_factory=dict)
    slip_mm_per_s: float = 0.0


@once
def hold_pose(robot: Robot, slope_deg: float = 0.0) -> HoldMotion:
    """Simulate a robot whose servos hold the pose in which it stands.

    Args:
        robot: The robot.
        slope_deg: Slope of the ground, made by turning gravity [degrees].

    Raises:
        NotApplicableError: It does not stand on three feet or more, or not all of its legs have servos.
        NotMeasuredError: The state diverges.
    """
    standing = standing_of(robot)
    if len(standing.feet) < LEAST_FEET:
        raise NotApplicableError(
            "a robot with one foot or two balances with a policy alone"
        )
    if (
        not all(drive.kp for drive in drives(robot) if drive.is_leg)
        or not servos(robot.model).any()
    ):
        raise NotApplicableError("no servos hold the legs")
    model, up = robot.without(), np.asarray(robot.up)
    data, begin = start(robot, model), start(robot)
    slope_rad = np.radians(slope_deg)
    along = np.cross([0.0, 1.0, 0.0] if abs(up[1]) < 0.5 else [1.0, 0.0, 0.0], up)
    # On a slope a, gravity is g (sin(a) along - cos(a) up) in the frame of the ground.
    g = length_of(model.opt.gravity)
    model.opt.gravity[:] = g * (np.sin(slope_rad) * along - np.cos(slope_rad) * up)
    soles = [geoms[0] for geoms in standing.feet.values()]
    ground_m = floor_m(robot)
    start_m = float(data.subtree_com[standing.body] @ up) - ground_m
    before_m, forces = np.zeros((len(soles), 3)), np.zeros(model.nv)
    steps, late = (
        max(1, round(time_s / model.opt.timestep)) for time_s in (HOLD_S, LATE_S)
    )
    for step in range(steps):
        mujoco.mj_step(model, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise NotMeasuredError(
                f"the state diverges at {(step + 1) * model.opt.timestep:.3g} s"
            )
        if step == steps - late:
            before_m = data.geom_xpos[soles]
        if step >= steps - late:
            forces += np.abs(data.qfrc_actuator) / late
    turn = np.zeros(3)
    mujoco.mju_subQuat(turn, data.xquat[standing.body], begin.xquat[standing.body])
    slips_m = np.linalg.norm(data.geom_xpos[soles] - before_m, axis=-1)
    limited = [drive for drive in drives(robot) if np.isfinite(drive.limit)]
    return HoldMotion(
        lean_rad=length_of(turn),
        height_ratio=(float(data.subtree_com[standing.body] @ up) - ground_m)
        / max(start_m, 1e-6),
        saturations={
            drive.dof: float(forces[drive.dof]) / drive.limit for drive in limited
        },
        slip_mm_per_s=1e3 * float(slips_m.mean()) / LATE_S,
    )


def floor_m(robot: Robot) -> float:
    """Return the height of the highest plane under the feet [m]; that of the lowest foot over other ground."""
    standing, model = standing_of(robot), robot.model
    touched = np.unique(robot.pairs.geoms[robot.foot_rows])
    planes = touched[model.geom_type[touched] == int(mujoco.mjtGeom.mjGEOM_PLANE)]
    heights_m = standing.stance.positions_m[planes, 2]
    return float(
        max(heights_m, default=min(point[2] for point in standing.support_m.values()))
    )


def fallen_saturations(robot: Robot) -> dict[int, float]:
    """Return the force that each drive gives while a robot sinks on its feet [N m or N]; empty where it stands."""
    motion = hold_pose(robot)
    if motion.height_ratio > FELL:
        return {}
    limits = {drive.dof: drive.limit for drive in drives(robot)}
    # A motor at 99 % of its limit gives all that it has: the load is larger.
    return {
        dof: share * limits[dof] / 0.99 for dof, share in motion.saturations.items()
    }


@row(
    "robot-stands",
    title="height of the robot after 2 s under its servos, over that at the start",
    unit="1",
    interval=(FELL, ROSE),
    source="the robot's own rollout: its pose, its controls and its settings, on three feet or more",
    consequence="The episode starts with a fall or a jump, so that the policy first learns to undo it.",
    is_usual=True,
)
def stands(robot: Robot) -> Finding:
    """Return the height of a robot that its servos hold, over that at the start."""
    if not robot.model.nkey:
        raise NotApplicableError("no keyframe states where the robot starts")
    ratio, standing = hold_pose(robot).height_ratio, standing_of(robot)
    gap_mm = 1e3 * (
        min(float(point[2]) for point in standing.support_m.values()) - floor_m(robot)
    )
    text = ""
    if not FELL <= ratio <= ROSE:
        text = f"the robot is at {ratio:.2g} of its height after {HOLD_S:g} s under its servos"
        if abs(gap_mm) > LEAST_GAP_MM:
            text += f": its feet start {abs(gap_mm):.3g} mm {'above' if gap_mm > 0.0 else 'in'} the ground"
    return Finding(value=ratio, remark=text, place=("body", standing.body))


@row(
    "robot-slip",
    title="slip of the feet of the standing robot on a slope of 10 degrees or less",
    unit="mm/s",
    interval=(0.0, 5.0),
    source="Coulomb: a foot in its friction cone rests; 5 mm/s are 1 mm in a stance of 0.2 s",
    consequence="Feet creep while they stand, so that the policy walks on ground that moves.",
    is_usual=True,
)
def slip(robot: Robot) -> Finding:
    """Return the speed at which the feet of a robot creep on a slope within their friction cone."""
    if not robot.foot_rows:
        raise NotApplicableError(NOT_STANDING)
    model = robot.model
    free_wheels = joints_of(model, "HINGE") & (model.jnt_limited == 0)
    if np.isin(list(standing_of(robot).feet), model.jnt_bodyid[free_wheels]).any():
        raise NotApplicableError("wheels roll on a slope")
    constants = robot.pairs.constants[robot.foot_rows]
    friction = float(np.where(constants[:, 0] > 1, constants[:, 1], 0.0).min())
    if not friction:
        raise NotApplicableError("the feet have no friction")
    slope_deg = min(SLOPE_DEG, float(np.degrees(np.arctan(SLOPE_PUSH * friction))))
    motion = hold_pose(robot, slope_deg)
    if not FELL < motion.height_ratio < ROSE or motion.lean_rad > LEAN_RAD:
        raise NotMeasuredError("the robot falls on the slope")
    cone_deg = float(np.degrees(np.arctan(friction)))
    speed = motion.slip_mm_per_s
    return Finding(
        value=speed,
        remark=f"feet slip by {speed:.3g} mm/s on {slope_deg:.3g} degrees; their friction of {friction:.3g} holds "
        f"up to {cone_deg:.3g}",
        place=("body", next(iter(standing_of(robot).feet))),
    )
