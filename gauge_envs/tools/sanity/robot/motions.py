"""Motions of a robot in its own settings: held where it works, pushed there, and along sines."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from gauge_envs.scene.geometry import length_of
from gauge_envs.tools.sanity.robot.joints import (
    floor_m,
    joint_inertias,
    motors_of,
    servos,
    start,
    torque_limits,
)
from gauge_envs.tools.sanity.robot.mujoco_feet import first_moving_body
from gauge_envs.tools.sanity.robot.robot import Robot, once

HOLD_S, LATE_S = 2.0, 0.5
"""Time for which the robot is held [s], and its end, in which loads and torques are read."""

FREE_S = 1.0
"""Time in which energy is read [s]."""

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""All that a step depends on."""


@dataclass(frozen=True, kw_only=True)
class HoldMotion:
    """What a robot did while its servos held the pose in which it stands.

    Attributes:
        diverged_s: Time at which the state diverged [s]; infinite when it did not.
        height_ratio: Height of its centre of mass at the end, over that at the start; NaN on a fixed base.
        load_shares: Share of the weight on each of its bodies that touch the ground, late in the motion.
        saturations: Mean torque over its limit of each driven degree of freedom, late in the motion.
        slip_mm_per_s: Mean speed of its feet along the ground, late in the motion [mm/s].
    """

    diverged_s: float = np.inf
    height_ratio: float = 0.0
    load_shares: Mapping[int, float] = field(default_factory=dict)
    saturations: Mapping[int, float] = field(default_factory=dict)
    slip_mm_per_s: float = 0.0


@once
def hold_pose(robot: Robot, slope_deg: float = 0.0) -> HoldMotion:
    """Simulate a robot whose controls hold the pose in which it works.

    Args:
        robot: The robot.
        slope_deg: Slope of the ground along x, made by turning gravity [degrees].
    """
    standing = robot.standing
    model = robot.without()
    data = start(robot, model)
    gravity_m_per_s2 = length_of(model.opt.gravity)
    up = np.asarray(robot.up)
    if slope_deg:
        # On a slope a, gravity is g (sin(a) along - cos(a) up) in the frame of the ground.
        slope_rad = np.radians(slope_deg)
        across = [0.0, 1.0, 0.0] if abs(up[1]) < 0.5 else [1.0, 0.0, 0.0]
        along = np.cross(across, up)
        model.opt.gravity[:] = gravity_m_per_s2 * (
            np.sin(slope_rad) * along - np.cos(slope_rad) * up
        )
    soles: list[int] = []
    ground_m, start_height_m = 0.0, np.nan
    if standing is not None:
        soles = [geoms[0] for geoms in standing.feet.values()]
        ground_m = floor_m(robot)
        start_height_m = float(data.subtree_com[standing.body] @ up) - ground_m
    soles_before_m = np.zeros((len(soles), 3))
    torques_nm = np.zeros(model.nv)
    loads_n: dict[int, float] = {}
    steps = max(1, round(HOLD_S / model.opt.timestep))
    first_late = max(0, steps - round(LATE_S / model.opt.timestep))
    share = 1.0 / (steps - first_late)
    for step in range(steps):
        mujoco.mj_step(model, data)
        if _has_diverged(data):
            return HoldMotion(diverged_s=(step + 1) * float(model.opt.timestep))
        if step == first_late:
            soles_before_m = data.geom_xpos[soles]
        if step >= first_late:
            torques_nm += np.abs(data.qfrc_actuator) / (steps - first_late)
            for body, load_n in _ground_loads_n(robot, data):
                loads_n[body] = loads_n.get(body, 0.0) + share * load_n
    limits_nm = torque_limits(model)
    is_limited = (limits_nm > 0.0) & np.isfinite(limits_nm)
    saturations = {
        int(dof): float(torques_nm[dof] / limits_nm[dof])
        for dof in np.flatnonzero(is_limited)
    }
    # Without gravity nothing carries a share of the weight.
    weight_n = robot.mass_kg * gravity_m_per_s2 or np.inf
    height_ratio, slip_m = np.nan, 0.0
    if standing is not None:
        end_height_m = float(data.subtree_com[standing.body] @ up) - ground_m
        height_ratio = end_height_m / max(start_height_m, 1e-6)
        slips_m = np.linalg.norm(data.geom_xpos[soles] - soles_before_m, axis=-1)
        slip_m = float(slips_m.mean())
    return HoldMotion(
        height_ratio=height_ratio,
        load_shares={body: load_n / weight_n for body, load_n in loads_n.items()},
        saturations=saturations,
        slip_mm_per_s=1e3 * slip_m / LATE_S,
    )


SINE_RAD, SINES_HZ, SERVO_HZ = 0.2, (0.7, 1.6), 3.0
"""Amplitude of the sines that joints follow, first and last frequency, and the servo that motors get for it.

The middle servo of makers' models has 1.6 to 31 Hz.
"""

FEW_STEPS = 500
"""Steps in which a motion shows that it grows."""


def follow_sines(robot: Robot) -> float:
    """Return the time at which a robot diverges while its joints follow sines without contact [s]; infinite if not."""
    model = robot.without("contact", "gravity")
    data = start(robot, model)
    motors = motors_of(robot)
    joints = model.actuator_trnid[motors, 0]
    places, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    gains, gears = model.actuator_gainprm[motors, 0], model.actuator_gear[motors, 0]
    per_nm = 1.0 / np.where(gains * gears, gains * gears, np.inf)
    stiffness_nm = -model.actuator_biasprm[motors, 1] * gears**2
    is_servo = servos(model)[motors]
    begin_rad, begin_ctrl = data.qpos[places], data.ctrl[motors]
    rate_per_s = 2.0 * np.pi * SERVO_HZ
    phases_per_s = 2.0 * np.pi * np.linspace(*SINES_HZ, len(motors))
    step_s = float(model.opt.timestep)
    for step in range(max(FEW_STEPS, round(FREE_S / step_s))):
        sines_rad = SINE_RAD * np.sin(phases_per_s * data.time)
        errors_rad = begin_rad + sines_rad - data.qpos[places]
        damped = rate_per_s * errors_rad - 1.4 * data.qvel[dofs]
        torques_nm = joint_inertias(robot)[dofs] * rate_per_s * damped
        servo_ctrl = begin_ctrl + stiffness_nm * sines_rad * per_nm
        data.ctrl[motors] = np.where(is_servo, servo_ctrl, torques_nm * per_nm)
        mujoco.mj_step(model, data)
        if _has_diverged(data):
            return (step + 1) * step_s
    return np.inf


def _has_diverged(data: mujoco.MjData) -> bool:
    is_bad = data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number > 0
    return is_bad or not np.isfinite(data.qpos).all()


def _ground_loads_n(robot: Robot, data: mujoco.MjData) -> Iterator[tuple[int, float]]:
    """Yield the body and the normal force [N] of each contact between a robot and the ground."""
    model, force = robot.model, np.zeros(6)
    for number in range(data.ncon):
        first, second = (
            int(model.geom_bodyid[geom]) for geom in data.contact[number].geom
        )
        for body, other in ((first, second), (second, first)):
            is_ground = (
                other not in robot.bodies
                and not model.body_dofnum[first_moving_body(model, other)]
            )
            if body in robot.bodies and is_ground:
                mujoco.mj_contactForce(model, data, number, force)
                yield body, float(force[0])
