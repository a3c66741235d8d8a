"""The user's robot in MuJoCo, and how the commands of a log become its controls."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from gauge_envs.errors import FileError, ParameterError, first_names
from gauge_envs.tools.replay.log import BoolArray, ControlMap, FloatArray, Log

IntArray = NDArray[np.int64]
FOREVER_S = 1e3
UNLIMITED = 1e4
"""Limit of a joint [rad or m] or an actuator [N m or N] that is none."""


@dataclass
class Setup:
    """A model and a controller: what predicts the log. A cause is a changed deep copy of it.

    The control of an actuator is `(scale * command + offset) / divisor`.

    Attributes:
        model: The compiled model; each joint and actuator has a limit, which is UNLIMITED where the file has none.
        command_time_s: From when on each command holds, shape [M].
        command: Commands; angles count from the default pose, which is the offset, shape [M, nu].
        is_driven: Whether an actuator has commands, shape [nu].
        scale, offset: See above, shape [nu].
        divisor: The gear for a torque, one over it for an angle, shape [nu].
        delay_s: Time from the command to its effect, shape [1].
        repeat, phase: The controller takes only each n-th change of the command, from this one on.
    """

    model: mujoco.MjModel
    command_time_s: FloatArray
    command: FloatArray
    is_driven: BoolArray
    scale: FloatArray
    offset: FloatArray
    divisor: FloatArray
    delay_s: FloatArray
    repeat: int = 1
    phase: int = 0

    def controls(self, time_s: FloatArray, step_s: float) -> FloatArray:
        """Return the mean control of steps that begin at given times, shape [..., nu].

        Commands hold until the next one. The mean over a step makes the result a continuous function of the delay.
        """
        rows = np.arange(len(self.command))
        if self.repeat > 1:
            is_new = np.diff(self.command, axis=0, prepend=np.nan).any(axis=1)
            rows = np.flatnonzero(is_new)[self.phase :: self.repeat]
        # The first command also holds before its time, and the last one for ever.
        starts_s = self.command_time_s[rows]
        knots_s = np.append(starts_s, starts_s[-1] + FOREVER_S)
        knots_s[0] -= FOREVER_S
        areas = np.cumsum(self.command[rows] * np.diff(knots_s)[:, None], axis=0)
        area = make_interp_spline(knots_s, np.vstack([0.0 * areas[:1], areas]), k=1)
        begin_s = time_s - self.delay_s
        mean = (area(begin_s + step_s) - area(begin_s)) / step_s
        return (self.scale * mean + self.offset) / self.divisor


@dataclass(frozen=True)
class Places:
    """Where the joints of a log are in the state of a model.

    Attributes:
        qpos, dof, joint: Addresses of each joint of the log in `qpos` and `qvel`, and its id, shape [J].
        actuator: Actuator that drives each joint, -1 for none, shape [J].
        base_qpos, base_dof: Addresses of a free base in `qpos` and `qvel`, shapes [7] and [6]; empty without one.
    """

    qpos: IntArray
    dof: IntArray
    joint: IntArray
    actuator: IntArray
    base_qpos: IntArray
    base_dof: IntArray


def load_model(file: Path) -> mujoco.MjModel:
    """Return a compiled model without the meshes that nothing touches.

    Raises:
        FileError: MuJoCo cannot read the file.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        spec.compiler.discardvisual = True
        return spec.compile()
    except (ValueError, OSError) as error:
        raise FileError(file, None, f"MuJoCo cannot read the model: {error}") from error


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of the hinges and slides in the order of the model."""
    is_single = model.jnt_type >= mujoco.mjtJoint.mjJNT_SLIDE.value
    return tuple(model.joint(int(index)).name for index in np.flatnonzero(is_single))


def find_places(model: mujoco.MjModel, log: Log) -> Places:
    """Return where the joints of a log are in a model.

    Raises:
        FileError: The log names a joint that the model lacks, or has no pose of a free base.
    """
    known = joint_names(model)
    unknown = next((name for name in log.joints if name not in known), None)
    if unknown is not None:
        reason = f"the model has no such joint; it has {first_names(known)}: name it in --map"
        raise FileError(log.name, unknown, reason)
    ids = np.array([model.joint(name).id for name in log.joints])
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value)[:1]
    if len(free) and log.base_pose.shape[1] != 7:
        reason = (
            "the base of the model is free; log its pose, or fix the base of the model"
        )
        raise FileError(log.name, "base_pos, base_quat", reason)
    drives = _drives(model)
    return Places(
        qpos=model.jnt_qposadr[ids],
        dof=model.jnt_dofadr[ids],
        joint=ids,
        actuator=np.array([drives.get(name, -1) for name in log.joints]),
        base_qpos=(model.jnt_qposadr[free][:, None] + np.arange(7)).ravel(),
        base_dof=(model.jnt_dofadr[free][:, None] + np.arange(6)).ravel(),
    )


def build_setup(model: mujoco.MjModel, log: Log, control: ControlMap) -> Setup:
    """Return the setup that states what the user gave: the model, the gains and the scale of actions.

    Raises:
        FileError: Commands name no joint or actuator.
        ParameterError: The log has position targets, but neither model nor map has a gain for them.
    """
    model, drives = copy.copy(model), _drives(model)
    kind, count = log.command_kind, model.nu
    command, is_driven = np.zeros((len(log.command), count)), np.zeros(count, bool)
    scale, offset, divisor = np.ones(count), np.zeros(count), np.ones(count)
    home = model.key_qpos[0] if model.nkey else model.qpos0
    for column, name in enumerate(log.command_names):
        if name not in drives:
            reason = "no actuator of the model drives it; map its name"
            raise FileError(log.name, f"{kind} {name}", reason)
        actuator = drives[name]
        joint = int(model.actuator_trnid[actuator, 0])
        gear = float(model.actuator_gear[actuator, 0])

        def given(field: str, joint: str = model.joint(joint).name) -> Any:
            return control.of(field, joint)

        command[:, actuator], is_driven[actuator] = log.command[:, column], True
        is_motor = model.actuator_biasprm[actuator, 1] == 0.0
        if kind == "tau":
            _set_law(model, actuator, 1.0, 0.0, 0.0)
            divisor[actuator] = gear
        elif kind in ("target", "action") and is_motor and given("kp"):
            stiffness, damping = given("kp") / gear**2, given("kd") / gear**2
            _set_law(model, actuator, stiffness, stiffness, damping)
        elif kind == "target" and is_motor:
            reason = (
                "the log has targets, but the model a motor; add kp and kd to --map"
            )
            raise ParameterError(f"{name}: {reason}")
        if kind in ("target", "action") and model.actuator_biasprm[actuator, 1] != 0.0:
            divisor[actuator] = 1.0 / gear
            default = given("default_rad")
            pose = home[model.jnt_qposadr[joint]] if default is None else default
            offset[actuator] = pose
            # An action counts from the default pose, a target from zero.
            command[:, actuator] -= pose * (kind == "target")
        if kind == "action":
            scale[actuator] = given("action_scale")
    _set_limits(model)
    return Setup(
        model,
        log.command_time_s,
        command,
        is_driven,
        scale,
        offset,
        divisor,
        delay_s=np.zeros(1),
    )


def _drives(model: mujoco.MjModel) -> dict[str, int]:
    """Return the actuators by the names that commands have: of joints and actuators, or numbers."""
    drives = {str(index): index for index in range(model.nu)}
    drives |= {model.actuator(index).name: index for index in range(model.nu)}
    is_at_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT.value
    for index in np.flatnonzero(is_at_joint).tolist():
        drives[model.joint(model.actuator_trnid[index, 0]).name] = index
    return drives


def _set_law(
    model: mujoco.MjModel, actuator: int, gain: float, stiffness: float, damping: float
) -> None:
    """Give an actuator a PD law, whose limit of effort is the range of its control, or with zeros its torque."""
    is_limited = bool(model.actuator_ctrllimited[actuator])
    if stiffness and is_limited and not model.actuator_forcelimited[actuator]:
        model.actuator_forcerange[actuator] = model.actuator_ctrlrange[actuator]
        model.actuator_forcelimited[actuator] = 1
    model.actuator_ctrllimited[actuator] = 0
    model.actuator_gaintype[actuator] = mujoco.mjtGain.mjGAIN_FIXED.value
    model.actuator_biastype[actuator] = mujoco.mjtBias.mjBIAS_AFFINE.value
    model.actuator_gainprm[actuator, :3] = gain, 0.0, 0.0
    model.actuator_biasprm[actuator, :3] = 0.0, -stiffness, -damping


def _set_limits(model: mujoco.MjModel) -> None:
    """Give each joint and actuator a limit, and the limit of effort of a joint to its actuator."""
    model.jnt_range[model.jnt_limited == 0] = -UNLIMITED, UNLIMITED
    model.jnt_limited[model.jnt_type >= mujoco.mjtJoint.mjJNT_SLIDE.value] = 1
    model.actuator_forcerange[model.actuator_forcelimited == 0] = -UNLIMITED, UNLIMITED
    model.actuator_forcelimited[:] = 1
    joints, gear = model.actuator_trnid[:, 0], np.abs(model.actuator_gear[:, :1])
    is_at_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT.value
    limited = np.flatnonzero(is_at_joint & (model.jnt_actfrclimited[joints] == 1))
    lower, upper = (model.jnt_actfrcrange[joints] / gear)[limited].T[..., None]
    limits = np.clip(model.actuator_forcerange[limited], lower, upper)
    model.actuator_forcerange[limited] = limits
    model.jnt_actfrclimited[joints[limited]] = 0
