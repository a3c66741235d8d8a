"""The user's robot in MuJoCo: its controls from the commands of a log, and its predictions from recorded states."""

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from gauge_envs.errors import FileError, ParameterError
from gauge_envs.names import first_names
from gauge_envs.processors import processor_count
from gauge_envs.reading import reading
from gauge_envs.tools.replay.log import (
    MIN_NOISE,
    MIN_RATE_NOISE,
    BoolArray,
    ControlMap,
    FloatArray,
    Log,
    noise_of,
)

IntArray = NDArray[np.int64]
AT_JOINT = mujoco.mjtTrn.mjTRN_JOINT.value
UNLIMITED = 1e4
"""Limit of a joint [rad or m] or an actuator [N m or N] that is none."""
MAX_GAP = 3.0
"""Interval between two samples, over the median, that a prediction may cross."""
MAX_NOISE_GROWTH = 9.0
"""Largest variance of the propagated noise, over that of a motion with the recorded velocity."""
LAW_S = 0.25
LAW_PIECES = 20
"""Length and number of the predictions that decide how a law is integrated."""
DRAWS = 8
"""Draws of the noise of the initial state."""
MAX_POSITION = 1e6
MAX_DEVIATION = 3.0
"""Deviation at which a prediction that flies off is cut [rad or m]."""


@dataclass
class Setup:
    """A model and a controller: what predicts the log. A cause is a changed deep copy of it.

    The control of an actuator is `scale * command + offset`.

    Attributes:
        model: The compiled model; each joint and actuator has a limit, which is UNLIMITED where the file has none.
        command_time_s: From when on each command holds, shape [M].
        command: Commands; angles count from the default pose, which is the offset, shape [M, nu].
        is_driven: Whether an actuator has commands, shape [nu].
        scale, offset: See above, shape [nu].
        delay_s: Time from the command to its effect, shape [1].
        zero: What is added to the angle of each joint of the log, shape [J].
    """

    model: mujoco.MjModel
    command_time_s: FloatArray
    command: FloatArray
    is_driven: BoolArray
    scale: FloatArray
    offset: FloatArray
    delay_s: FloatArray
    zero: FloatArray

    @property
    def step_s(self) -> float:
        """Physics step."""
        return float(self.model.opt.timestep)

    def controls(self, time_s: FloatArray) -> FloatArray:
        """Return the mean control of steps that begin at given times, shape [..., nu].

        Commands hold until the next one. The mean over a step makes the result a continuous function of the delay.
        """
        # Outside of its ends the integral goes on: the first command holds before its time, and the last one for ever.
        knots_s = np.append(self.command_time_s, self.command_time_s[-1] + 1.0)
        area = PPoly(self.command[None], knots_s).antiderivative()
        begin_s = time_s - self.delay_s
        mean = (area(begin_s + self.step_s) - area(begin_s)) / self.step_s
        return self.scale * mean + self.offset


def load_model(file: Path, control: ControlMap | None = None) -> mujoco.MjModel:
    """Return a compiled model without the meshes that nothing touches.

    Args:
        file: MJCF or URDF.
        control: The controller outside of the model. If it has a kp and the model no actuator, as a URDF, each hinge
            and slide gets a motor.

    Raises:
        FileError: MuJoCo cannot read the file.
    """
    with reading(file, FileError, "a model that MuJoCo can load"):
        spec = mujoco.MjSpec.from_file(str(file))
        spec.compiler.discardvisual = True
        for body in spec.bodies:
            # A cause may move the centre of a link, which a simple body forbids; MuJoCo 3 has no such switch.
            if hasattr(body, "simple"):
                body.simple = 0
        model = spec.compile()
        if control is None or control.kp is None or model.nu:
            return model
        for name in joint_names(model):
            motor = spec.add_actuator(target=name)
            motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        return spec.compile()


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of the hinges and slides in the order of the model."""
    return tuple(
        model.joint(index).name
        for index, kind in enumerate(model.jnt_type)
        if kind >= mujoco.mjtJoint.mjJNT_SLIDE.value
    )


def build_setup(model: mujoco.MjModel, log: Log) -> Setup:
    """Return the setup that states what the user gave: the model, the gains and the scale of actions.

    Raises:
        FileError: Commands name no joint or actuator.
        ParameterError: The log has position targets, but neither model nor map has a gain for them.
    """
    kind, count, drives = log.command_kind, model.nu, _drives(model)
    control = log.mapped.control
    setup = Setup(
        model=copy.copy(model),
        command_time_s=log.command_time_s,
        command=np.zeros((len(log.command), count)),
        is_driven=np.zeros(count, bool),
        scale=np.ones(count),
        offset=np.zeros(count),
        delay_s=np.array([control.delay_s]),
        zero=np.zeros(len(log.joints)),
    )
    _use_joint_units(setup.model)
    for name, command in zip(log.command_names, log.command.T, strict=True):
        if name not in drives:
            known = first_names([*drives])
            reason = f"no actuator of the model drives it; it has {known}: name it in --map, or add actuators"
            raise FileError(log.name, f"{kind} {name}", reason)
        index = drives[name]
        drive = setup.model.actuator(index)
        joint = model.joint(drive.trnid[0])
        given = control.of(joint.name)
        is_motor = drive.biasprm[1] == 0.0
        is_angle = kind in ("target", "action") and (given["kp"] or not is_motor)
        if kind == "target" and not is_angle:
            reason = (
                "the log has targets, but the model a motor; add kp and kd to --map"
            )
            raise ParameterError(f"{name}: {reason}")
        if kind == "tau":
            _set_law(drive, 0.0, 0.0)
        elif is_angle and is_motor:
            _set_law(drive, given["kp"], given["kd"])
        if kind == "action":
            setup.scale[index] = given["action_scale"]
        if is_angle:
            pose = default_angle(model, log, joint.name)
            setup.offset[index] = pose
            command = command - pose if kind == "target" else command
        elif kind == "ctrl" and not is_motor:
            command = command / model.actuator_gear[index, 0]
        setup.command[:, index] = command
        setup.is_driven[index] = True
    return setup


def default_angle(model: mujoco.MjModel, log: Log, joint: str) -> float:
    """Return the angle of a joint in the default pose: of the map, else of the first keyframe or the zero."""
    given: float | None = log.mapped.control.of(joint)["default_rad"]
    home = model.key_qpos[0] if model.nkey else model.qpos0
    return home[model.joint(joint).qposadr[0]] if given is None else given


def _drives(model: mujoco.MjModel) -> dict[str, int]:
    """Return the actuators by the names that commands have: of joints and actuators, or numbers."""
    drives = {str(index): index for index in range(model.nu)}
    drives |= {model.actuator(index).name: index for index in range(model.nu)}
    for index in np.flatnonzero(model.actuator_trntype == AT_JOINT).tolist():
        drives[model.joint(model.actuator_trnid[index, 0]).name] = index
    return drives


def _use_joint_units(model: mujoco.MjModel) -> None:
    """Give each joint and actuator a limit, and the actuators of joints a gear of 1.

    With a gear g, an actuator of force k u + b0 + b1 g q + b2 g dq gives a torque of g times this force. The control u
    of a servo becomes the angle u / g. The actuators of a joint take over its limit of effort.
    """
    model.jnt_range[model.jnt_limited == 0] = -UNLIMITED, UNLIMITED
    model.jnt_limited[:] = 1
    model.actuator_forcerange[model.actuator_forcelimited == 0] = -UNLIMITED, UNLIMITED
    model.actuator_forcelimited[:] = 1
    at_joint = np.flatnonzero(model.actuator_trntype == AT_JOINT)
    for index in at_joint:
        drive = model.actuator(index)
        joint, gear = drive.trnid[0], drive.gear[0]
        unit = gear if drive.biasprm[1] else 1.0
        drive.gear[0] = 1.0
        drive.gainprm[0] *= gear * unit
        drive.biasprm[:3] *= gear, gear**2, gear**2
        drive.ctrlrange[:] = np.sort(drive.ctrlrange / unit)
        drive.forcerange *= abs(gear)
        if model.jnt_actfrclimited[joint]:
            lower, upper = model.jnt_actfrcrange[joint]
            drive.forcerange[:] = np.clip(drive.forcerange, lower, upper)
    model.jnt_actfrclimited[model.actuator_trnid[at_joint, 0]] = 0


def _set_law(drive: Any, stiffness: float, damping: float) -> None:
    """Give an actuator a PD law of its joint; with zeros, its control is a torque.

    The range of the control of a motor limits its torque.
    """
    if stiffness and drive.ctrllimited[0]:
        lower, upper = drive.gainprm[0] * drive.ctrlrange
        drive.forcerange[:] = np.clip(drive.forcerange, lower, upper)
    drive.ctrllimited[:] = 0
    drive.biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE.value
    drive.gainprm[:3] = stiffness or 1.0, 0.0, 0.0
    drive.biasprm[:3] = 0.0, -stiffness, -damping


class Replayer:
    """Predict a log from its own states.

    Degrees of freedom D are the joints of the log; position [m] and rotation vector [rad] of a free base stand first.

    Args:
        log: The log.
        model: The model that the log belongs to.

    Attributes:
        model: The model.
        qpos, qvel: States of all samples, shapes [N, nq] and [N, nv]; joints that are not logged rest.
        joint, dof: Id of each joint of the log, and its address in `qvel`, shape [J].
        actuator: Actuator that drives each joint, -1 for none, shape [J].
        dofs: Addresses of the degrees of freedom in `qvel`, shape [D].
        noise: Noise of the degrees of freedom and then of their rates, shape [2 D].
        left_out: Pieces that no prediction crosses, shape [K, 1 + T].
        noise_predictions: Number of predictions that `covariance` makes.
        is_joint: Whether a degree of freedom is a joint, shape [D].

    Raises:
        FileError: The model lacks a joint of the log, or has a free base whose pose the log lacks.
    """

    def __init__(self, log: Log, model: mujoco.MjModel) -> None:
        known, drives = joint_names(model), _drives(model)
        for name in log.joints:
            if name not in known:
                reason = (
                    f"the model has no such joint; it has {first_names(known)}: "
                    "name it, or each column by `order`, in --map"
                )
                raise FileError(log.name, name, reason)
        base = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value)[:1]
        if len(base) and log.base_pose.shape[1] != 7:
            reason = "the base of the model is free; log its position and quaternion, or fix the base of the model"
            raise FileError(log.name, "base_pos, base_quat", reason)
        self.log = log
        self.model = model
        self._datas = [mujoco.MjData(model) for _ in range(processor_count())]
        # An actuator with a filter begins at its control.
        self._is_filtered = model.actuator_actadr >= 0
        self._filters = model.actuator_actadr[self._is_filtered]
        self.joint = np.array([model.joint(name).id for name in log.joints])
        self.dof = model.jnt_dofadr[self.joint]
        self.actuator = np.array([drives.get(name, -1) for name in log.joints])
        base_place = model.jnt_qposadr[base] + np.arange(7 * len(base))
        base_dof = model.jnt_dofadr[base] + np.arange(6 * len(base))
        pose = log.base_pose[:, : len(base_place)]
        twist = log.base_twist[:, : len(base_dof)]
        self._places = model.jnt_qposadr[self.joint]
        places = np.append(base_place, self._places)
        self.dofs = np.append(base_dof, self.dof)
        self.is_joint = np.isin(self.dofs, self.dof)
        self.qpos = np.tile(model.qpos0, (len(log.time_s), 1))
        self.qvel = np.zeros((len(log.time_s), model.nv))
        self.qpos[:, places] = np.hstack([pose, log.position])
        self.qvel[:, self.dofs] = np.hstack([twist, log.velocity])
        noise = noise_of(log.time_s, pose)
        # A rotation is twice the change of the quaternion.
        noise[3:6] = 2.0 * noise[3:].max(initial=0.0)
        gaps_s = np.diff(log.time_s, prepend=log.time_s[0])
        self._breaks: IntArray = np.cumsum(gaps_s > MAX_GAP * log.interval_s)
        self.left_out = np.zeros((0, 0), int)
        self.noise_predictions = 2 * len(self.dofs) + DRAWS + 1
        self.noise = np.concatenate(
            [
                np.maximum(noise[:6], MIN_NOISE),
                log.position_noise,
                np.maximum(noise_of(log.time_s, twist), MIN_RATE_NOISE),
                log.velocity_noise,
            ]
        )

    def leave_out(self, pieces: IntArray) -> None:
        """Let no prediction cross some pieces, shape [K, 1 + T]."""
        self.left_out = pieces
        for first, *_, last in pieces.tolist():
            self._breaks[first + 1 :] += 1
            self._breaks[first + 1 : last + 1] += np.arange(last - first)
            self._breaks[last + 1 :] += last - first

    def longest_s(self) -> float:
        """Return the length of the longest run of good samples."""
        return float(np.bincount(self._breaks).max() * self.log.interval_s)

    def pieces(self, horizon_s: float, count: int, outputs: int = 8) -> IntArray:
        """Return samples of pieces that are spread over the log, shape [P, 1 + T]; a prediction begins at the first.

        Args:
            horizon_s: Length of each; at least one sample.
            count: Number of pieces at most.
            outputs: Number of samples of each that are compared.

        Raises:
            ParameterError: The log has no run of good samples of this length.
        """
        log = self.log
        length = max(1, round(horizon_s / log.interval_s))
        steps = np.unique(np.linspace(0, length, outputs + 1).round().astype(int))
        start = np.flatnonzero(self._breaks[length:] == self._breaks[:-length])
        if not len(start):
            reason = f"no {horizon_s:g} s without lost samples; record longer runs"
            raise ParameterError(f"{log.name}: {reason}")
        chosen = np.unique(np.linspace(0, len(start) - 1, count).round().astype(int))
        return start[chosen, None] + steps

    def predict(
        self, setup: Setup, pieces: IntArray, tangent: FloatArray | None = None
    ) -> FloatArray:
        """Return predicted minus recorded degrees of freedom, shape [P, T, D].

        Args:
            setup: What predicts.
            pieces: Samples from `pieces`; each row begins with the recorded state.
            tangent: Change of the initial positions and rates, shape [2 nv] or [P, 2 nv].
        """
        model, log = setup.model, self.log
        step_s = setup.step_s
        elapsed_s = log.time_s[pieces[:, 1:]] - log.time_s[pieces[:, :1]]
        count = int(elapsed_s.max() / step_s) + 1
        times_s = log.time_s[pieces[:, :1]] + step_s * np.arange(count)
        controls = setup.controls(times_s)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        state = np.zeros((len(pieces), size))
        ends = np.cumsum([1, model.nq, model.nv])
        _, qpos, qvel, activation = np.split(state, ends, axis=1)
        qpos[:], qvel[:] = self.qpos[pieces[:, 0]], self.qvel[pieces[:, 0]]
        qpos[:, self._places] += setup.zero
        if tangent is not None:
            turn, change = np.split(tangent, 2, axis=-1)
            qvel += change
            for row, each in zip(qpos, np.broadcast_to(turn, qvel.shape), strict=True):
                mujoco.mj_integratePos(model, row, each, 1.0)
        activation[:, self._filters] = controls[:, 0, self._is_filtered]
        states, _ = rollout.rollout(
            model, self._datas, state, controls, persistent_pool=True
        )
        motion = np.hstack([state[:, None], states])[..., 1 : 1 + model.nq]
        # A simulation that flies off ends in infinity.
        motion = np.nan_to_num(motion, nan=MAX_POSITION).clip(
            -MAX_POSITION, MAX_POSITION
        )
        # Samples between two steps are interpolated.
        place = elapsed_s / step_s
        left = place.astype(int)
        part = (place - left)[..., None]
        rows = np.arange(len(pieces))[:, None]
        predicted = (1.0 - part) * motion[rows, left] + part * motion[rows, left + 1]
        predicted[..., self._places] -= setup.zero
        return self._deviation(pieces, predicted)

    def keep_velocity(self, pieces: IntArray) -> FloatArray:
        """Return the deviation of a motion with the recorded velocity from the recorded one, shape [P, T, D]."""
        time_s = self.log.time_s
        predicted = np.repeat(self.qpos[pieces[:, :1]], pieces.shape[1] - 1, axis=1)
        for piece, output in np.ndindex(predicted.shape[:2]):
            start, end = pieces[piece, 0], pieces[piece, 1 + output]
            row, elapsed_s = predicted[piece, output], time_s[end] - time_s[start]
            mujoco.mj_integratePos(self.model, row, self.qvel[start], elapsed_s)
        return self._deviation(pieces, predicted)

    def _deviation(self, pieces: IntArray, predicted: FloatArray) -> FloatArray:
        model = self.model
        recorded = self.qpos[pieces[:, 1:]]
        difference = np.zeros((*recorded.shape[:2], model.nv))
        for index in np.ndindex(recorded.shape[:2]):
            mujoco.mj_differentiatePos(
                model, difference[index], 1.0, recorded[index], predicted[index]
            )
        return np.clip(difference[..., self.dofs], -MAX_DEVIATION, MAX_DEVIATION)

    def covariance(self, setup: Setup, pieces: IntArray) -> FloatArray:
        """Return the covariance of the predictions that noise alone gives, shape [P, T D, T D].

        The noise of the initial state is propagated by its sensitivities, by finite differences: C = N S0 N^T + S.
        Contacts amplify it further. Random initial states measure by how much, and C of a piece grows with it. A model
        that flies off amplifies it too: C of most pieces stays below what the motion with the recorded velocity misses.
        """
        plain = self.predict(setup, pieces)

        def spread(tangents: FloatArray) -> FloatArray:
            moved = [self.predict(setup, pieces, each) - plain for each in tangents]
            columns = np.stack(moved, axis=-1).reshape(len(pieces), -1, len(moved))
            return columns @ columns.transpose(0, 2, 1)

        units = np.eye(2 * setup.model.nv)[[*self.dofs, *setup.model.nv + self.dofs]]
        units *= self.noise[:, None]
        draws = np.random.default_rng(0).normal(size=(DRAWS, len(pieces), len(units)))
        recorded = np.tile(self.noise[: len(self.dofs)], plain.shape[1])
        covariance = spread(units) + np.diag(recorded**2)
        drawn = spread(draws @ units) / DRAWS + np.diag(recorded**2)
        ratio = np.linalg.solve(covariance, drawn)
        growth = np.trace(ratio, axis1=1, axis2=2) / len(recorded)
        covariance *= np.maximum(growth, 1.0)[:, None, None]
        missed = self.keep_velocity(pieces)
        most = missed**2 + MAX_NOISE_GROWTH * self.spread(pieces) ** 2
        excess = np.trace(covariance, axis1=1, axis2=2) / most.sum(axis=(1, 2))
        return covariance / max(np.median(excess), 1.0)

    def spread(self, pieces: IntArray) -> FloatArray:
        """Return the noise of a motion with the recorded velocity over the mean piece, shape [D]."""
        position, rate = np.split(self.noise, 2)
        elapsed_s = np.ptp(self.log.time_s[pieces[:, [0, -1]]], axis=1)
        return np.hypot(position, rate * elapsed_s.mean())

    def baseline(self, pieces: IntArray) -> FloatArray:
        """Return the error of constant velocity or of no motion, whichever is less, shape [D]."""
        start = np.repeat(self.qpos[pieces[:, :1]], pieces.shape[1] - 1, axis=1)
        deviations = self.keep_velocity(pieces), self._deviation(pieces, start)
        return np.minimum(*(self._error(each, pieces) for each in deviations))

    def misfit(self, setup: Setup, pieces: IntArray) -> FloatArray:
        """Return the logarithm of the error over that of constant velocity or no motion, shape [D].

        Its unit has no part in the result.
        """
        error = self._error(self.predict(setup, pieces), pieces)
        return np.log(error / self.baseline(pieces))

    def _error(self, deviation: FloatArray, pieces: IntArray) -> FloatArray:
        """Return the median error over the pieces, and the noise of the states, shape [D]."""
        median = np.median(np.abs(deviation), axis=(0, 1))
        return np.hypot(median, self.spread(pieces))

    def torques(self, setup: Setup, samples: IntArray) -> tuple[FloatArray, bool]:
        """Return the torque of each joint in the model at samples, shape [S, J], and whether anything is in contact.

        For a joint without an actuator, the torque is the sum of gravity, Coriolis and centrifugal torques.
        """
        model, data, is_touching = setup.model, self._datas[0], False
        controls = setup.controls(self.log.time_s[samples])
        torques = np.zeros((len(samples), len(self.joint)))
        for place, row in enumerate(samples):
            data.qpos[:], data.qvel[:] = self.qpos[row], self.qvel[row]
            data.qpos[self._places] += setup.zero
            data.ctrl[:] = controls[place]
            data.act[self._filters] = controls[place, self._is_filtered]
            mujoco.mj_forward(model, data)
            torque = np.where(data.qfrc_actuator, data.qfrc_actuator, data.qfrc_bias)
            torques[place] = torque[self.dof]
            is_touching = is_touching or bool(data.ncon)
        return torques, is_touching


def law_setups(replayer: Replayer) -> list[Setup]:
    """Return the setups that state what the user gave, the one that predicts best first.

    A law outside of the model may be computed in the user's own loop, from the state before each step, or inside of
    an implicit integrator.
    """
    setup = build_setup(replayer.model, replayer.log)
    euler = mujoco.mjtIntegrator.mjINT_EULER.value
    if replayer.log.mapped.control.kp is None or setup.model.opt.integrator == euler:
        return [setup]
    explicit = copy.deepcopy(setup)
    explicit.model.opt.integrator = euler
    pieces = replayer.pieces(LAW_S, LAW_PIECES)

    def error(each: Setup) -> float:
        return float(np.median(np.abs(replayer.predict(each, pieces))))

    return sorted((setup, explicit), key=error)
