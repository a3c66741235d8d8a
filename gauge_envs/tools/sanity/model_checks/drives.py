"""Read what drives, brakes and loads the joints of a robot."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.sanity.model_checks.check import Change, Fault
from gauge_envs.tools.sanity.robot.robot import (
    Robot,
    acts_on_joints,
    chain_of,
    joints_of,
    name_of,
    once,
    random_poses,
)
from gauge_envs.tools.sanity.verdict import MAX_WARNING

SERVO_ERROR_RAD = 0.5
"""Error at which a servo without a torque limit is read [rad]: a quarter of the range of a common joint."""

POSES = 64
"""Random poses in which weights are read."""


class Drive(NamedTuple):
    """A hinge or slide that an actuator moves, in N m and rad or in N and m.

    Attributes:
        robot: The robot.
        joint: Id of the joint.
        dof: Its degree of freedom.
        body: Body that the joint moves.
        is_hinge: Whether the joint is a hinge.
        is_leg: Whether the joint is between the trunk of a robot that stands and one of its feet.
        limit: Largest force of its actuators; infinite without a limit.
        kp: Stiffness of its position servos; 0 without one.
        kv: Damping of its servos.
        damping: Damping of the joint without its servo.
        dry: Dry friction of the joint in the model.
        armature: Inertia of the rotor, as the joint feels it.
    """

    robot: Robot
    joint: int
    dof: int
    body: int
    is_hinge: bool
    is_leg: bool
    limit: float
    kp: float
    kv: float
    damping: float
    dry: float
    armature: float

    @property
    def name(self) -> str:
        """Name of the joint, or its number."""
        return name_of(self.robot.model, "joint", self.joint)

    @property
    def units(self) -> tuple[str, str]:
        """Units of its forces and angles."""
        return ("N m", "rad") if self.is_hinge else ("N", "m")

    @property
    def scale(self) -> float:
        """1 for a hinge; 0.1 m for a slide, which moves like the end of a lever of this length."""
        return 1.0 if self.is_hinge else 0.1

    @property
    def push(self) -> float:
        """Largest force of the motor: its limit, or that of the servo at an error of 0.5 rad; infinite if neither."""
        if np.isfinite(self.limit) or not self.kp:
            return self.limit
        return self.kp * SERVO_ERROR_RAD * self.scale

    @property
    def reach(self) -> float:
        """Force of its servo where the joint is at its farther stop; infinite without servo or stops."""
        model = self.robot.model
        travel = (
            model.jnt_range[self.joint]
            - self.robot.stance.qpos[model.jnt_qposadr[self.joint]]
        )
        is_stopped = model.jnt_limited[self.joint] and self.kp
        return self.kp * float(np.abs(travel).max()) if is_stopped else np.inf

    def faults(
        self,
        ratio: float,
        text: str,
        is_usual: bool = False,
        changes: Sequence[Change | None] = (None,),
    ) -> Iterator[Fault]:
        """Yield a fault of the joint where a value exceeds its limit; see `Fault`.

        Args:
            ratio: The value over the limit.
            text: What is wrong.
            is_usual: Whether the limit says what is usual: a tenth beyond it passes, and more is advice.
            changes: Attributes that correct it.
        """
        is_error = not is_usual and ratio > MAX_WARNING
        for change in changes if ratio > 1.0 + 0.1 * is_usual else ():
            yield Fault(
                ("joint", self.joint),
                self.name,
                text,
                ratio,
                is_error,
                change,
                is_usual=is_usual,
            )


@once
def drives(robot: Robot) -> list[Drive]:
    """Return the joints of a robot that actuators move."""
    model = robot.model
    feet = () if robot.standing is None else robot.standing.feet
    legs = {body for foot in feet for body in chain_of(model, foot)}
    limits, kp, kv = np.zeros((3, model.njnt))
    acting = np.flatnonzero(acts_on_joints(model) & (model.actuator_gear[:, 0] != 0.0))
    joints, gears = (
        model.actuator_trnid[acting, 0],
        np.abs(model.actuator_gear[acting, 0]),
    )
    affine = model.actuator_biastype[acting] == mujoco.mjtBias.mjBIAS_AFFINE
    bias = -model.actuator_biasprm[acting] * affine[:, None]
    np.add.at(limits, joints, gears * _largest_forces(model)[acting])
    np.add.at(kp, joints, gears**2 * np.maximum(bias[:, 1], 0.0))
    np.add.at(kv, joints, gears**2 * bias[:, 2])
    is_capped = model.jnt_actfrclimited != 0
    capped = np.abs(model.jnt_actfrcrange).max(axis=1, initial=0.0)
    limits[is_capped] = np.minimum(limits, capped)[is_capped]
    is_driven = (limits > 0.0) & joints_of(model, "HINGE", "SLIDE")
    is_driven &= np.isin(model.jnt_bodyid, robot.bodies)
    dofs, bodies = model.jnt_dofadr, model.jnt_bodyid
    columns = (
        *(np.arange(model.njnt), dofs, bodies),
        *(joints_of(model, "HINGE"), np.isin(bodies, list(legs)), limits, kp, kv),
        np.atleast_2d(model.dof_damping.T)[0, dofs],
        *(model.dof_frictionloss[dofs], model.dof_armature[dofs]),
    )
    rows = zip(*(column[is_driven].tolist() for column in columns), strict=True)
    return [Drive(robot, *row) for row in rows]


def _largest_forces(model: mujoco.MjModel) -> FloatArray:
    """Return the largest force of each actuator before its gear; infinite without a limit, shape [nu]."""
    largest = np.abs(model.actuator_forcerange).max(axis=1, initial=0.0)
    largest[model.actuator_forcelimited == 0] = np.inf
    is_plain = ~model.actuator_biasprm.any(axis=1) & (model.actuator_ctrllimited != 0)
    is_plain &= model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    spans = np.abs(model.actuator_ctrlrange).max(axis=1, initial=0.0)
    spans *= np.abs(model.actuator_gainprm[:, 0])
    return np.where(is_plain, np.minimum(largest, spans), largest)


def servos(model: mujoco.MjModel) -> BoolArray:
    """Return which actuators hold a position, shape [nu]."""
    affine: BoolArray = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    return affine & (model.actuator_biasprm[:, 1] < 0.0)


def hold_position(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Set the controls of position servos so that their forces are 0.

    The force of a servo is gain * control + bias[0] + bias[1] * length.
    """
    servo = servos(model) & (model.actuator_gainprm[:, 0] != 0.0)
    bias = model.actuator_biasprm[servo]
    forces = bias[:, 0] + bias[:, 1] * data.actuator_length[servo]
    data.ctrl[servo] = -forces / model.actuator_gainprm[servo, 0]


def start(robot: Robot, model: mujoco.MjModel | None = None) -> mujoco.MjData:
    """Return the pose in which a robot starts, without controls; see `Robot.stance`."""
    model = model or robot.model
    data = mujoco.MjData(model)
    data.qpos[:] = robot.stance.qpos
    mujoco.mj_forward(model, data)
    return data


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
def drags(robot: Robot, speed: float) -> FloatArray:
    """Return the force that turns each drive of a robot at a speed without power, in the engine, shape [nv].

    Where a link is light, the dry friction of the file acts as a drag in the engine.

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
