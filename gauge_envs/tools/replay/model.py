"""The user's robot in MuJoCo, and how the commands of a log become its controls."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import FileError, ParameterError, first_names
from gauge_envs.tools.replay.log import ControlMap, FloatArray, Log

IntArray = NDArray[np.int64]
FOREVER_S = 1e3


@dataclass(frozen=True)
class Setup:
    """A model and a controller: what predicts the log. A cause is a changed copy of it.

    The control of actuator a is `(sign * scale * (command[source] - origin) + offset) / divisor`.

    Attributes:
        model: The compiled model.
        source: Column of the commands of each actuator, -1 for none, shape [nu].
        sign, scale, origin, offset: See above; the origin of a target is its default pose, which the offset adds
            again, shape [nu].
        divisor: The gear for a torque, one over it for an angle, shape [nu].
        delay_s: Time from the command to its effect.
        repeat, phase: The controller takes only each n-th change of the command, from this one on.
        clock: Seconds of physics in a second of the log.
    """

    model: mujoco.MjModel
    source: IntArray
    sign: FloatArray
    scale: FloatArray
    origin: FloatArray
    offset: FloatArray
    divisor: FloatArray
    delay_s: float = 0.0
    repeat: int = 1
    phase: int = 0
    clock: float = 1.0

    def with_model(self) -> Setup:
        """Return a copy whose model can be changed in place."""
        return replace(self, model=copy.copy(self.model))

    def controls(self, log: Log, time_s: FloatArray, step_s: float) -> FloatArray:
        """Return the mean control of steps that begin at given times, shape [..., nu].

        Commands hold until the next one. The mean over a step makes the result a continuous function of the delay.
        """
        controls = np.zeros((*time_s.shape, self.model.nu))
        if not log.command_kind:
            return controls
        rows = np.arange(len(log.command))
        if self.repeat > 1:
            is_new = np.diff(log.command, axis=0, prepend=np.nan).any(axis=1)
            rows = np.flatnonzero(is_new)[self.phase :: self.repeat]
        begins_s = log.command_time_s[rows]
        # The first command also holds before its time.
        knots_s = np.array(
            [begins_s[0] - FOREVER_S, *begins_s[1:], begins_s[-1] + FOREVER_S]
        )
        areas = np.cumsum(log.command[rows] * np.diff(knots_s)[:, None], axis=0)
        areas = np.vstack([0.0 * areas[:1], areas])
        begin_s = time_s - self.delay_s
        for actuator in np.flatnonzero(self.source >= 0):
            area = areas[:, self.source[actuator]]
            ends = (
                np.interp(begin_s + step_s, knots_s, area),
                np.interp(begin_s, knots_s, area),
            )
            mean = (ends[0] - ends[1]) / step_s
            gain = self.sign[actuator] * self.scale[actuator]
            value = gain * (mean - self.origin[actuator]) + self.offset[actuator]
            controls[..., actuator] = value / self.divisor[actuator]
        return controls


@dataclass(frozen=True)
class Places:
    """Where the joints of a log are in the state of a model.

    Attributes:
        qpos, dof, joint: Addresses of each joint of the log in `qpos` and `qvel`, and its id, shape [J].
        actuator: Actuator that drives each joint, -1 for none, shape [J].
        base: Address of the free joint in `qpos`, which is first in `qvel` too; -1 without one.
    """

    qpos: IntArray
    dof: IntArray
    joint: IntArray
    actuator: IntArray
    base: int


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
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value)
    if len(free) and not {"position", "quaternion"} <= log.base.keys():
        reason = (
            "the base of the model is free; log its pose, or fix the base of the model"
        )
        raise FileError(log.name, "base_pos, base_quat", reason)
    is_at_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT.value
    driven = {
        int(model.actuator_trnid[a, 0]): int(a) for a in np.flatnonzero(is_at_joint)
    }
    actuators = np.array([driven.get(int(joint), -1) for joint in ids])
    base = int(model.jnt_qposadr[free[0]]) if len(free) else -1
    return Places(model.jnt_qposadr[ids], model.jnt_dofadr[ids], ids, actuators, base)


def build_setup(model: mujoco.MjModel, log: Log, control: ControlMap) -> Setup:
    """Return the setup that states what the user gave: the model, the gains and the scale of actions.

    Raises:
        FileError: Commands name no joint or actuator.
        ParameterError: The log has position targets, but neither model nor map has a gain for them.
    """
    places = find_places(model, log)
    model = copy.copy(model)
    kind, count = log.command_kind, model.nu
    source = np.full(count, -1)
    scale, offset, divisor = np.ones(count), np.zeros(count), np.ones(count)
    home = model.key_qpos[0] if model.nkey else model.qpos0
    for column, name in enumerate(log.command_names):
        actuator = _driven(model, places, log, name)
        joint = int(model.actuator_trnid[actuator, 0])
        gear = float(model.actuator_gear[actuator, 0])
        source[actuator] = column
        stiffness = control.of("kp", model.joint(joint).name)
        if kind == "tau":
            _set_law(model, actuator, 1.0, 0.0, 0.0)
            divisor[actuator] = gear
        elif (
            kind in ("target", "action")
            and model.actuator_biasprm[actuator, 1] == 0.0
            and stiffness
        ):
            damping = control.of("kd", model.joint(joint).name)
            _set_law(
                model,
                actuator,
                stiffness / gear**2,
                stiffness / gear**2,
                damping / gear**2,
            )
        elif kind == "target" and model.actuator_biasprm[actuator, 1] == 0.0:
            raise ParameterError(
                f"{name}: the log has targets, but the model a motor; add kp and kd to --map"
            )
        if kind in ("target", "action") and model.actuator_biasprm[actuator, 1] != 0.0:
            divisor[actuator] = 1.0 / gear
            default = control.of("default_rad", model.joint(joint).name)
            offset[actuator] = (
                home[model.jnt_qposadr[joint]] if default is None else default
            )
        if kind == "action":
            scale[actuator] = control.of("action_scale", model.joint(joint).name)
    # An action counts from the default pose, a target from zero.
    origin = offset if kind == "target" else np.zeros(count)
    return Setup(model, source, np.ones(count), scale, origin, offset, divisor)


def _driven(model: mujoco.MjModel, places: Places, log: Log, name: str) -> int:
    """Return the actuator of a command, which names a joint or an actuator."""
    if name in log.joints and places.actuator[log.joints.index(name)] >= 0:
        return int(places.actuator[log.joints.index(name)])
    is_number = name.isdecimal() and len(log.command_names) == model.nu
    index = (
        int(name)
        if is_number
        else mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    )
    if index < 0:
        raise FileError(
            log.name,
            f"{log.command_kind} {name}",
            "no actuator of the model drives it; map its name",
        )
    return int(index)


def _set_law(
    model: mujoco.MjModel, actuator: int, gain: Any, stiffness: float, damping: float
) -> None:
    """Give an actuator a PD law, whose limit of effort is the range of its control, or with zeros its torque."""
    if (
        stiffness
        and model.actuator_ctrllimited[actuator]
        and not model.actuator_forcelimited[actuator]
    ):
        model.actuator_forcerange[actuator] = model.actuator_ctrlrange[actuator]
        model.actuator_forcelimited[actuator] = 1
    model.actuator_ctrllimited[actuator] = 0
    model.actuator_gaintype[actuator] = mujoco.mjtGain.mjGAIN_FIXED.value
    model.actuator_biastype[actuator] = mujoco.mjtBias.mjBIAS_AFFINE.value
    model.actuator_gainprm[actuator, :3] = gain, 0.0, 0.0
    model.actuator_biasprm[actuator, :3] = 0.0, -stiffness, -damping


def effort_limits(model: mujoco.MjModel) -> FloatArray:
    """Return the largest torque [N m] of each actuator at its joint; infinite without a limit."""
    joints = model.actuator_trnid[:, 0]
    gear = np.abs(model.actuator_gear[:, 0])
    own = np.abs(model.actuator_forcerange).max(axis=1) * gear
    of_joint = np.abs(model.jnt_actfrcrange[joints]).max(axis=1)
    own[model.actuator_forcelimited == 0] = np.inf
    of_joint[model.jnt_actfrclimited[joints] == 0] = np.inf
    return np.minimum(own, of_joint)
