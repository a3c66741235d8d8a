"""Joints of a robot: what drives, brakes and loads each of them."""

import mujoco
import numpy as np

from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.robot.finding import standing_of
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import (
    JOINT_TRANSMISSIONS,
    Robot,
    acts_on_joints,
    once,
    random_poses,
)

SERVO_ERROR_RAD = 0.5
"""Error at which a servo without a limit asks for its largest torque [rad]."""


def start(robot: Robot, model: mujoco.MjModel | None = None) -> mujoco.MjData:
    """Return the pose in which the robot works, with the controls that hold it there.

    It is the pose in which it stands; of a fixed base the keyframe `home` or the first one, else that of the model.
    Joints that the model puts outside their ranges are in the middle of these.
    """
    model = robot.model if model is None else model
    data = mujoco.MjData(model)
    if robot.standing is not None:
        data.qpos[:] = robot.standing.stance.qpos
    elif model.nkey:
        data.qpos[:] = model.key_qpos[home_key(model)]
    else:
        positions = data.qpos[model.jnt_qposadr]
        low, high = model.jnt_range.T
        is_outside = (positions < low) | (positions > high)
        is_outside &= joints_of(model, "HINGE", "SLIDE") & (model.jnt_limited != 0)
        data.qpos[model.jnt_qposadr[is_outside]] = (0.5 * (low + high))[is_outside]
    mujoco.mj_forward(model, data)
    # A servo's force is gain * control + bias[0] + bias[1] * length: here it is 0.
    servo = servos(model) & (model.actuator_gainprm[:, 0] != 0.0)
    bias = model.actuator_biasprm[servo]
    forces = bias[:, 0] + bias[:, 1] * data.actuator_length[servo]
    data.ctrl[servo] = -forces / model.actuator_gainprm[servo, 0]
    if robot.standing is not None and robot.standing.stance.ctrl is not None:
        data.ctrl[:] = robot.standing.stance.ctrl
    mujoco.mj_forward(model, data)
    return data


def home_key(model: mujoco.MjModel) -> int:
    """Return the keyframe `home`, or the first one."""
    return max(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home"), 0)


def servos(model: mujoco.MjModel) -> BoolArray:
    """Return which actuators hold a position, shape [nu]."""
    affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    return affine & (model.actuator_biasprm[:, 1] < 0.0)


def torque_limits(model: mujoco.MjModel) -> FloatArray:
    """Return the largest force of actuators and joint on each degree of freedom [N or Nm], as `motor_limits` does."""
    limits = motor_limits(model)
    for joint in np.flatnonzero(model.jnt_actfrclimited).tolist():
        dof = int(model.jnt_dofadr[joint])
        limits[dof] = min(limits[dof], np.abs(model.jnt_actfrcrange[joint]).max())
    return limits


def motor_limits(model: mujoco.MjModel) -> FloatArray:
    """Return the largest force of the actuators on each degree of freedom [N or Nm], shape [nv].

    It is infinite where no limit is stated, and 0 where nothing acts.
    """
    limits = np.zeros(model.nv)
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        if (
            int(model.actuator_trntype[actuator]) not in JOINT_TRANSMISSIONS
            or joint < 0
        ):
            continue
        largest = np.inf
        if model.actuator_forcelimited[actuator]:
            largest = float(np.abs(model.actuator_forcerange[actuator]).max())
        elif (
            model.actuator_ctrllimited[actuator]
            and not model.actuator_biasprm[actuator].any()
        ):
            largest = float(
                abs(model.actuator_gainprm[actuator, 0])
                * np.abs(model.actuator_ctrlrange[actuator]).max()
            )
        dof = int(model.jnt_dofadr[joint])
        limits[dof] += abs(float(model.actuator_gear[actuator, 0])) * largest
    return limits


def driven_dofs(robot: Robot) -> dict[int, float]:
    """Return the limits of hinges of a robot that an actuator drives, by degree of freedom [Nm].

    Joints that place the robot in the world are none of its motors.
    """
    model = robot.model
    is_hinge = joints_of(model, "HINGE")[model.dof_jntid]
    is_driven = is_hinge & np.isin(model.dof_bodyid, robot.bodies)
    is_driven &= ~np.isin(model.dof_bodyid, placed_bodies(model))
    limits = enumerate(torque_limits(model).tolist())
    return {dof: limit for dof, limit in limits if limit and is_driven[dof]}


def placed_bodies(model: mujoco.MjModel) -> list[int]:
    """Return bodies that slides and hinges place in the world: no part lies between, and at least two slides move them.

    They stand for wheels, or for an arm that is not there.
    """
    is_slide = joints_of(model, "SLIDE")
    slides = np.zeros(model.nbody, int)
    np.add.at(slides, model.jnt_bodyid[is_slide], 1)
    is_bare = np.ones(model.nbody, bool)
    found = []
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        if not is_bare[parent]:
            is_bare[body] = False
            continue
        slides[body] += slides[parent]
        is_bare[body] = model.body_geomnum[body] == 0
        if slides[body] >= 2 and model.body_jntnum[body]:
            found.append(body)
    return found


@once
def joint_inertias(robot: Robot) -> FloatArray:
    """Return the inertia about each degree of freedom where the robot works, all others locked, shape [nv]."""
    full = np.zeros((robot.model.nv, robot.model.nv))
    mujoco.mj_fullM(robot.model, start(robot), full)
    return np.diag(full).copy()


def driven_joints(robot: Robot) -> list[int]:
    """Return the joints of these hinges."""
    joints: list[int] = robot.model.dof_jntid[list(driven_dofs(robot))].tolist()
    return joints


def growth(robot: Robot) -> float:
    """Return the largest ratio by which a small motion about the pose grows in one step, without contact and gravity.

    It is the spectral radius of the engine's own step: gains, damping, inertia, step and integrator together.
    """
    free = robot.without("contact", "gravity", "limit", "frictionloss")
    data, nv = start(robot, free), free.nv
    base, ctrl, matrix = data.qpos.copy(), data.ctrl.copy(), np.zeros((2 * nv, 2 * nv))

    def stepped(change: FloatArray) -> FloatArray:
        mujoco.mj_resetData(free, data)
        data.qpos[:], data.ctrl[:] = base, ctrl
        mujoco.mj_integratePos(free, data.qpos, change[:nv], 1.0)
        data.qvel[:] = change[nv:]
        mujoco.mj_step(free, data)
        moved = np.zeros(nv)
        mujoco.mj_differentiatePos(free, moved, 1.0, base, data.qpos)
        return np.concatenate([moved, data.qvel])

    for column, change in enumerate(1e-5 * np.eye(2 * nv)):
        matrix[:, column] = (stepped(change) - stepped(-change)) / 2e-5
    return (
        float(np.abs(np.linalg.eigvals(matrix)).max())
        if np.isfinite(matrix).all()
        else np.inf
    )


@once
def drags_nm(robot: Robot) -> dict[int, tuple[float, float]]:
    """Return the dry and the viscous part of the torque that turns each driven hinge without power, in the engine.

    The viscous part is that at 1 rad/s [Nm]. Where a link is light, the engine makes its dry friction a drag.
    """
    bare = robot.without(
        "contact", "gravity", "limit", "equality", "actuation", "spring"
    )
    bare.opt.density = bare.opt.viscosity = 0.0
    data, found = start(robot, bare), {}
    data.qacc[:] = 0.0
    for dof in driven_dofs(robot):
        torques_nm = []
        for rate_rad_per_s in (3.0, 6.0):
            data.qvel[:] = rate_rad_per_s * (np.arange(bare.nv) == dof)
            mujoco.mj_inverse(bare, data)
            torques_nm.append(float(data.qfrc_inverse[dof]))
        slow_nm, fast_nm = torques_nm
        stated_nm = float(bare.dof_frictionloss[dof])
        dry_nm = max(min(2.0 * slow_nm - fast_nm, stated_nm), 0.0)
        found[dof] = dry_nm, max((fast_nm - slow_nm) / 3.0, 0.0)
    return found


@once
def largest_weights_nm(robot: Robot) -> FloatArray:
    """Return the largest torque of gravity on each degree of freedom in random poses [Nm], shape [nv]."""
    poses = random_poses(robot.model, 64)
    return np.max(
        [np.abs(data.qfrc_bias - data.qfrc_gravcomp) for data in poses], axis=0
    )


def springs(model: mujoco.MjModel) -> FloatArray:
    """Return the stiffness of the spring of each joint [N/m or Nm/rad], shape [njnt]."""
    # MuJoCo 4 has coefficients of a polynomial, earlier versions one number.
    linear: FloatArray = model.jnt_stiffness.reshape(model.njnt, -1)[:, 0]
    return linear


def floor_m(robot: Robot) -> float:
    """Return the height of the highest plane under the feet [m]; that of the lowest foot over other ground."""
    standing, model = standing_of(robot), robot.model
    is_plane = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    touched = np.unique(robot.pairs.geoms[robot.foot_rows])
    heights_m = standing.stance.positions_m[touched[is_plane[touched]], 2]
    lowest_m = min(float(point[2]) for point in standing.support_m.values())
    return float(heights_m.max()) if len(heights_m) else lowest_m


def feet_above_ground_m(robot: Robot) -> float:
    """Return the height of the lowest foot above the ground in the pose in which a robot starts [m]."""
    support_m = standing_of(robot).support_m
    return min(float(point[2]) for point in support_m.values()) - floor_m(robot)


def dof_of(robot: Robot, actuator: int) -> int:
    """Return the degree of freedom on which an actuator acts."""
    return int(robot.model.jnt_dofadr[robot.model.actuator_trnid[actuator, 0]])


def motors_of(robot: Robot) -> list[int]:
    """Return actuators on hinges that count as driven."""
    model = robot.model
    is_driven = np.isin(model.actuator_trnid[:, 0], driven_joints(robot))
    return np.flatnonzero(is_driven & acts_on_joints(model)).tolist()


def position_servos(robot: Robot) -> list[int]:
    """Return servos on hinges of the robot."""
    is_servo = servos(robot.model)
    return [actuator for actuator in motors_of(robot) if is_servo[actuator]]


def servo_gains(model: mujoco.MjModel, column: int) -> FloatArray:
    """Return a gain of the servos on each degree of freedom, shape [nv].

    Args:
        model: The model.
        column: 1 for the stiffness [Nm/rad], 2 for the damping [Nm s/rad].
    """
    gains = np.zeros(model.nv)
    actuators = servos(model) & acts_on_joints(model)
    gears = model.actuator_gear[actuators, 0]
    dofs = model.jnt_dofadr[model.actuator_trnid[actuators, 0]]
    np.subtract.at(gains, dofs, gears**2 * model.actuator_biasprm[actuators, column])
    return gains


def stiffness(model: mujoco.MjModel, dof: int) -> float:
    """Return the stiffness of the servos on a degree of freedom [Nm/rad]."""
    return float(servo_gains(model, 1)[dof])


def loads_nm(robot: Robot) -> dict[int, float]:
    """Return the largest torque of the motor of each driven hinge; without a limit that of its servo [Nm]."""
    loads: dict[int, float] = {}
    for dof, limit_nm in driven_dofs(robot).items():
        if not np.isfinite(limit_nm):
            limit_nm = SERVO_ERROR_RAD * stiffness(robot.model, dof)
        if limit_nm > 0.0:
            loads[dof] = limit_nm
    return loads
