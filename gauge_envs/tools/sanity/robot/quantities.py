"""What a robot's model states of each link, joint and motor, by names that two models share."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.robot.finding import body_name, joint_name
from gauge_envs.tools.sanity.robot.joints import servos, start
from gauge_envs.tools.sanity.robot.mujoco_feet import joints_of
from gauge_envs.tools.sanity.robot.robot import JOINT_TRANSMISSIONS, Robot


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A quantity of the parts of a robot.

    Attributes:
        title: What it is, of which part.
        unit: Its unit; `1` for a pure number.
        least: Difference up to which two values count as the same, in its unit.
        ratio: The same relative to the larger one; 0 for lengths and angles.
    """

    title: str
    unit: str
    least: float
    ratio: float


QUANTITIES: Mapping[str, Quantity] = {
    name: Quantity(**stated) for name, stated in facts("robot_quantities").items()
}
"""Quantities by the id of their row in a comparison."""

TASK = "the task"
"""Part of what a task states of the robot as a whole."""


def quantities(robot: Robot) -> dict[str, dict[str, float]]:
    """Return the value of each part of a robot by the name of the part, for each quantity that the model states.

    Names have no prefix of a scene, as `robot/`. Values without a limit are infinite.
    """
    found: dict[str, dict[str, float]] = {name: {} for name in QUANTITIES}
    for name, part, value in (
        *_of_links(robot),
        *_of_joints(robot),
        *_of_motors(robot),
    ):
        found[name][part.rpartition("/")[2]] = float(value)
    if robot.delay_s is not None:
        found["delay"][TASK] = robot.delay_s
    if robot.action_rad is not None:
        found["action-scale"][TASK] = robot.action_rad
    return found


def _of_links(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model = robot.model
    for body in robot.bodies:
        name = body_name(robot, body)
        yield "mass", name, model.body_mass[body]
        # The order of principal axes is the compiler's choice.
        moments = np.sort(model.body_inertia[body])
        for word, value in zip(("least", "middle", "largest"), moments, strict=True):
            yield "inertia", f"{name} {word}", value
        for axis, place in enumerate("xyz"):
            yield "centre-of-mass", f"{name} {place}", model.body_ipos[body, axis]
            if model.body_parentid[body]:
                yield "link-place", f"{name} {place}", model.body_pos[body, axis]


def _of_joints(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model, data, start_data = robot.model, mujoco.MjData(robot.model), start(robot)
    mujoco.mj_kinematics(model, data)
    is_simple = joints_of(model, "HINGE", "SLIDE")
    for dof in range(model.nv):
        joint, name = int(model.dof_jntid[dof]), joint_name(robot, dof)
        if int(model.dof_bodyid[dof]) not in robot.bodies or not is_simple[joint]:
            continue
        yield "damping", name, model.dof_damping[dof]
        yield "frictionloss", name, model.dof_frictionloss[dof]
        yield "armature", name, model.dof_armature[dof]
        yield "stiffness", name, model.jnt_stiffness[joint]
        yield "pose", name, start_data.qpos[model.jnt_qposadr[joint]]
        for axis, place in enumerate("xyz"):
            yield "joint-axis", f"{name} {place}", data.xaxis[joint, axis]
        low, high = (
            model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        )
        yield "joint-range", f"{name} low", low
        yield "joint-range", f"{name} high", high


def _of_motors(robot: Robot) -> Iterator[tuple[str, str, float]]:
    model, is_servo = robot.model, servos(robot.model)
    for actuator in range(model.nu):
        name = model.actuator(actuator).name or f"motor {actuator}"
        # A motor goes by its joint, whose name models of one robot share more often.
        if model.actuator_trntype[actuator] in JOINT_TRANSMISSIONS:
            joint = int(model.actuator_trnid[actuator, 0])
            if int(model.jnt_bodyid[joint]) not in robot.bodies:
                continue
            name = joint_name(robot, int(model.jnt_dofadr[joint]))
        gear = abs(float(model.actuator_gear[actuator, 0]))
        bias = model.actuator_biasprm[actuator]
        if is_servo[actuator]:
            yield "kp", name, -bias[1] * gear**2
            yield "kv", name, -bias[2] * gear**2
        else:
            yield "motor-gain", name, model.actuator_gainprm[actuator, 0] * gear
        limit = (
            gear * np.abs(model.actuator_forcerange[actuator]).max()
            if model.actuator_forcelimited[actuator]
            else np.inf
        )
        yield "motor-limit", name, limit
        low, high = (
            model.actuator_ctrlrange[actuator]
            if model.actuator_ctrllimited[actuator]
            else (-np.inf, np.inf)
        )
        yield "control-range", f"{name} low", low
        yield "control-range", f"{name} high", high
        has_lag = int(model.actuator_dyntype[actuator]) != int(mujoco.mjtDyn.mjDYN_NONE)
        lag_s = float(model.actuator_dynprm[actuator, 0]) if has_lag else 0.0
        yield "motor-lag", name, lag_s
        for attribute in ("delay", "damping", "armature"):
            # MuJoCo 3.11 has none of them.
            several = getattr(model, f"actuator_{attribute}", np.zeros(model.nu))
            yield f"motor-{attribute}", name, several[actuator]
        yield "motor-order", name, actuator
