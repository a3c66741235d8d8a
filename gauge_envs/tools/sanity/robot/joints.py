"""What drives, brakes and loads the joints of a robot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np

from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.robot.mujoco_feet import (
    acts_on_joints,
    chain_of,
    joints_of,
)
from gauge_envs.tools.sanity.robot.robot import Robot, once, random_poses
from gauge_envs.tools.sanity.rows import Finding, Place

SERVO_ERROR_RAD = 0.5
"""Error at which a servo without a torque limit is read [rad]: a quarter of the range of a common joint."""

POSES = 64
"""Random poses in which weights are read."""


class Case(NamedTuple):
    """One part of a row.

    Attributes:
        ratio: Its value over the limit of its kind.
        place: Element of the model.
        name: Name of the part.
        text: What happens there, with its numbers.
        is_usual: Whether the limit says what is usual.
    """

    ratio: float
    place: Place
    name: str
    text: str
    is_usual: bool = False


def worst_case(cases: Iterable[Case], limit: float = 1.0) -> Finding:
    """Return the finding of the largest case, with the number of other parts beyond the limit of the row."""
    several = list(cases)
    if not several:
        return Finding(value=0.0)
    worst = max(several, key=lambda case: case.ratio)
    parts: dict[str, float] = {}
    for case in several:
        parts[case.name] = max(case.ratio, parts.get(case.name, 0.0))
    if worst.ratio <= limit:
        return Finding(value=worst.ratio, parts=parts)
    others = sum(ratio > limit for ratio in parts.values()) - 1
    return Finding(
        value=worst.ratio,
        remark=worst.text + (f"; {others} more like it" if others else ""),
        place=worst.place,
        parts=parts,
        is_usual=worst.is_usual,
    )


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A hinge or slide that an actuator moves, in N m and rad or in N and m.

    Attributes:
        robot: The robot.
        joint: Id of the joint.
        dof: Its degree of freedom.
        limit: Largest force of its actuators; infinite where none is stated.
        kp: Stiffness of its position servos; 0 without one.
        kv: Damping of its servos.
    """

    robot: Robot
    joint: int
    dof: int
    limit: float
    kp: float
    kv: float

    @property
    def name(self) -> str:
        """Name of the joint, or its number."""
        return self.robot.model.joint(self.joint).name or f"joint {self.joint}"

    @property
    def body(self) -> int:
        """Body that the joint moves."""
        return int(self.robot.model.jnt_bodyid[self.joint])

    @property
    def is_hinge(self) -> bool:
        """Whether the joint is a hinge."""
        return bool(joints_of(self.robot.model, "HINGE")[self.joint])

    @property
    def units(self) -> tuple[str, str, str]:
        """Units of its forces, angles and inertias."""
        return ("N m", "rad", "kg m^2") if self.is_hinge else ("N", "m", "kg")

    @property
    def damping(self) -> float:
        """Damping of the joint without its servo."""
        return float(np.ravel(self.robot.model.dof_damping[self.dof])[0])

    @property
    def armature(self) -> float:
        """Inertia of the rotor, as the joint feels it."""
        return float(self.robot.model.dof_armature[self.dof])

    @property
    def inertia(self) -> float:
        """Inertia about the joint where the robot starts, all others locked, with the armature."""
        return float(joint_inertias(self.robot)[self.dof])

    @property
    def push(self) -> float:
        """Largest force of the motor: its limit, or that of the servo at an error of 0.5 rad; infinite if neither."""
        if np.isfinite(self.limit) or not self.kp:
            return self.limit
        return self.kp * SERVO_ERROR_RAD * self.scale

    @property
    def scale(self) -> float:
        """1 for a hinge; 0.1 m for a slide, whose strokes are those of a lever of this length."""
        return 1.0 if self.is_hinge else 0.1

    @cached_property
    def is_leg(self) -> bool:
        """Whether the joint is between the trunk of a robot that stands and one of its feet."""
        standing, model = self.robot.standing, self.robot.model
        feet = () if standing is None else standing.feet
        return any(self.body in chain_of(model, foot) for foot in feet)

    def case(self, ratio: float, text: str, is_usual: bool = False) -> Case:
        """Return a part of a row on the joint; see `Case`."""
        return Case(ratio, ("joint", self.joint), self.name, text, is_usual)


@once
def drives(robot: Robot) -> list[Drive]:
    """Return the joints of a robot that actuators move."""
    model = robot.model
    limits, kp, kv = (np.zeros(model.njnt) for _ in range(3))
    for actuator in np.flatnonzero(acts_on_joints(model)).tolist():
        joint = int(model.actuator_trnid[actuator, 0])
        gear = abs(float(model.actuator_gear[actuator, 0]))
        bias = model.actuator_biasprm[actuator]
        limits[joint] += gear * _largest(model, actuator)
        if model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_AFFINE):
            kp[joint] += gear**2 * max(-float(bias[1]), 0.0)
            kv[joint] -= gear**2 * float(bias[2])
    is_capped = model.jnt_actfrclimited != 0
    capped = np.abs(model.jnt_actfrcrange).max(axis=1, initial=0.0)
    limits[is_capped] = np.minimum(limits, capped)[is_capped]
    is_driven = (limits > 0.0) & joints_of(model, "HINGE", "SLIDE")
    is_driven &= np.isin(model.jnt_bodyid, robot.bodies)
    return [
        Drive(
            robot=robot,
            joint=joint,
            dof=int(model.jnt_dofadr[joint]),
            limit=float(limits[joint]),
            kp=float(kp[joint]),
            kv=float(kv[joint]),
        )
        for joint in np.flatnonzero(is_driven).tolist()
    ]


def _largest(model: mujoco.MjModel, actuator: int) -> float:
    """Return the largest force of an actuator that its model states, before its gear; infinite where it states none."""
    largest = np.inf
    if model.actuator_forcelimited[actuator]:
        largest = float(np.abs(model.actuator_forcerange[actuator]).max())
    is_plain = not model.actuator_biasprm[actuator].any()
    is_plain &= model.actuator_gaintype[actuator] == int(mujoco.mjtGain.mjGAIN_FIXED)
    if model.actuator_ctrllimited[actuator] and is_plain:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        span = float(np.abs(model.actuator_ctrlrange[actuator]).max())
        largest = min(largest, gain * span)
    return largest


def servos(model: mujoco.MjModel) -> BoolArray:
    """Return which actuators hold a position, shape [nu]."""
    affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    return affine & (model.actuator_biasprm[:, 1] < 0.0)


def start(robot: Robot, model: mujoco.MjModel | None = None) -> mujoco.MjData:
    """Return the pose in which a robot starts, with the controls that hold it there.

    It is the pose in which it stands; of a fixed base the keyframe `home` or the first one, else that of the model.
    Joints that the model puts outside their ranges are in the middle of these.
    """
    model = robot.model if model is None else model
    data = mujoco.MjData(model)
    if robot.standing is not None:
        data.qpos[:] = robot.standing.stance.qpos
    elif model.nkey:
        home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
        data.qpos[:] = model.key_qpos[max(home, 0)]
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


@once
def joint_inertias(robot: Robot) -> FloatArray:
    """Return the inertia about each degree of freedom where the robot starts, all others locked, shape [nv]."""
    full = np.zeros((robot.model.nv, robot.model.nv))
    mujoco.mj_fullM(robot.model, start(robot), full)
    return np.diag(full).copy()


def loads(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return the force that holds each degree of freedom at rest against gravity and springs, shape [nv]."""
    passive = data.qfrc_passive + data.qfrc_gravcomp * (
        model.jnt_actgravcomp[model.dof_jntid] != 0
    )
    return np.abs(data.qfrc_bias - passive)


@once
def largest_loads(robot: Robot) -> FloatArray:
    """Return the largest of these forces in random poses, shape [nv]."""
    poses = random_poses(robot.model, POSES)
    return np.max([loads(robot.model, data) for data in poses], axis=0)


@once
def reaches_m(robot: Robot) -> FloatArray:
    """Return the length of the limb from each body on, stretched, shape [nbody]: no pose reaches farther."""
    model = robot.model
    reaches = np.zeros(model.nbody)
    ends = np.linalg.norm(model.geom_pos, axis=1) + model.geom_rbound
    np.maximum.at(reaches, model.geom_bodyid, ends)
    for body in range(model.nbody - 1, 0, -1):
        parent = int(model.body_parentid[body])
        arm = float(np.linalg.norm(model.body_pos[body])) + reaches[body]
        reaches[parent] = max(reaches[parent], arm)
    return reaches


@once
def drags(robot: Robot, speed: float) -> FloatArray:
    """Return the force that turns each drive of a robot at a speed without power, in the engine, shape [nv].

    Where a link is light, the engine makes a drag of its dry friction, so that what the file states does not act.

    Args:
        robot: The robot.
        speed: Speed of hinges [rad/s]; slides have a tenth of it in m/s.
    """
    bare = robot.without(
        "contact", "gravity", "limit", "equality", "actuation", "spring"
    )
    bare.opt.density = bare.opt.viscosity = 0.0
    data, forces = start(robot, bare), np.zeros(bare.nv)
    data.qacc[:] = 0.0
    for drive in drives(robot):
        data.qvel[:] = speed * drive.scale * (np.arange(bare.nv) == drive.dof)
        mujoco.mj_inverse(bare, data)
        forces[drive.dof] = data.qfrc_inverse[drive.dof]
    return forces


def root_of(model: mujoco.MjModel, body: int) -> int:
    """Return the first body of the tree of bodies of which a body is part."""
    return int(model.tree_bodyadr[model.body_treeid[body]])
