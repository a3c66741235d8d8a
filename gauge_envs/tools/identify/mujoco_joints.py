"""Joints of a model in plain MuJoCo: simulated with other numbers, and replayed with lines that were pasted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from mujoco import rollout

from gauge_envs.runs.rollout import DivergedError
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.servo_friction import Holding, holding
from gauge_envs.tools.identify.logs import Log
from gauge_envs.tools.identify.paste import JOINT, paste
from gauge_envs.tools.identify.rig import (
    BACKLASH,
    DYNAMICS,
    LIMIT,
    OFFSET,
    SERVO,
    Terms,
)

STIFF_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance of dry friction: with MuJoCo's own a joint that friction holds creeps."""
SHORT_S = 0.001
"""Time constant of dry friction [s]; MuJoCo makes it two steps at least."""
LOOP_STEPS, LOOP_GAP = 30, 1e-6
"""Most steps to close loops at a start, and the gap that is left at most [m, rad]."""
STOP_IMPEDANCE = (0.99, 0.999, 1e-4, 0.5, 2.0)
"""Impedance of the stops of a play."""
RK4 = mujoco.mjtIntegrator.mjINT_RK4
STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True, eq=False)
class ModelJoints:
    """Joints of a model, whose numbers change.

    Attributes:
        spec: The model, with these joints alone, no keyframe, and no actuator at the joints.
        joints: Names of the joints, in the order of the logs.
        signs: -1 where the log counts an angle the other way, shape [J].
        stated: Numbers that the model states, by joint.
        has_servos: Whether the logs command angles; False for torques and free swings.
    """

    spec: mujoco.MjSpec
    joints: tuple[str, ...]
    signs: FloatArray
    stated: Sequence[Terms]
    has_servos: bool
    name: str = "mujoco"

    @property
    def timestep_s(self) -> float:
        """Step of the model [s]."""
        return float(self.spec.option.timestep)

    def with_step(self, step_s: float) -> ModelJoints:
        """Return the same joints in a model of another step [s]."""
        spec = self.spec.copy()
        spec.option.timestep = step_s
        return replace(self, spec=spec)

    @cached_property
    def _motored(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """A compiled model with a motor at each joint, and its state."""
        return self._compiled(self.spec.copy())

    @cached_property
    def _played(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The same with a play behind each joint."""
        return self._compiled(with_play(self.spec.copy(), self.joints))

    def _compiled(self, spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
        for joint, numbers in zip(self.joints, self.stated, strict=True):
            motor = spec.add_actuator(name=motor_name(joint), target=joint)
            motor.trntype = JOINT
            if self.has_servos:
                motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            if limit := numbers[LIMIT]:
                motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
                motor.forcerange = [-limit, limit]
            field = spec.joint(joint)
            field.solimp_friction = STIFF_IMPEDANCE
            field.solref_friction = [SHORT_S, 1.0]
        model = spec.compile()
        if model.nv == 1:
            # One joint is one island: the search for islands takes an eighth of a step.
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        return model, mujoco.MjData(model)

    def size(self) -> tuple[float, float]:
        """Return the largest inertia about a joint [kg m^2], and the largest torque that its weight can have [N m]."""
        model, data = self._motored
        start_at(model, data, self, np.zeros(len(self.joints)))
        mujoco.mj_forward(model, data)
        sizes = []
        for joint in map(data.joint, self.joints):
            dof = int(model.joint(joint.id).dofadr[0])
            turned, momentum = np.zeros((2, model.nv))
            turned[dof] = 1.0
            mujoco.mj_mulM(model, data, momentum, turned)
            body = int(model.jnt_bodyid[joint.id])
            arm_m = length_of(data.subtree_com[body] - joint.xanchor)
            if model.jnt_type[joint.id] == mujoco.mjtJoint.mjJNT_SLIDE:
                arm_m = 1.0
            weight = float(model.body_subtreemass[body]) * arm_m
            sizes.append(
                (
                    float(momentum[dof] - model.dof_armature[dof]),
                    weight * length_of(model.opt.gravity),
                )
            )
        return max(one for one, _ in sizes), max(one for _, one in sizes)

    def angles(
        self, log: Log, terms: Sequence[Terms], start: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        """Return the angles of the joints at the times of a log [rad], shape [N, J]; see `rig.Machine`."""
        has_play = any(one.get(BACKLASH) for one in terms)
        model, data = self._played if has_play else self._motored
        self._set(model, data, terms)
        start_at(model, data, self, *start)
        if not self.has_servos and model.opt.integrator != RK4:
            # These integrators hold rates half a step before the angles; then they are of second order.
            mujoco.mj_forward(model, data)
            data.qvel -= 0.5 * self.timestep_s * data.qacc
        count = math.ceil(log.duration_s / self.timestep_s) + 2
        state = np.zeros(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, state, STATE)
        control = np.zeros((1, count, model.nu))
        driven = [model.actuator(motor_name(one)).id for one in self.joints]
        for place, motor in enumerate(driven):
            delay_s = float(
                (self.stated[place] | terms[place]).get("delay_s", 0.0)  # type: ignore[operator]
            )
            values = _controls(log, place, delay_s, count, self.timestep_s)
            values += float(terms[place].get(OFFSET, 0.0))
            control[0, :, motor] = self.signs[place] * values
        if laws := self._laws(model, terms):
            states = np.zeros((1, count, state.size))
            mujoco.mj_forward(model, data)
            for row in range(count):
                data.ctrl[:] = control[0, row]
                _step(model, data, 1, laws)
                mujoco.mj_getState(model, data, states[0, row], STATE)
        else:
            states, _ = rollout.rollout(model, data, state[None], control)
        if np.any(data.warning.number):
            raise DivergedError(f"{log.name}: plain MuJoCo diverges")
        # A state begins with its time, and the positions follow.
        positions = np.vstack([state, states[0]])[:, 1 : 1 + model.nq]
        moved = self._links(model, positions)
        return _at_times(moved, (log.times_s - log.times_s[0]) / self.timestep_s)

    def _links(self, model: mujoco.MjModel, positions: FloatArray) -> FloatArray:
        """Return the angles of the links [rad], shape [..., J], from positions of a model, shape [..., nq]."""
        rotors = [int(model.joint(one).qposadr[0]) for one in self.joints]
        angles = positions[..., rotors]
        plays = [play_name(one) for one in self.joints]
        if has_joint(model, plays[0]):
            angles = (
                angles
                + positions[..., [int(model.joint(one).qposadr[0]) for one in plays]]
            )
        return np.asarray(self.signs * angles)

    def _laws(
        self, model: mujoco.MjModel, terms: Sequence[Terms]
    ) -> dict[int, Holding]:
        """Return what friction can hold at the joints with a law of servo benches, by degree of freedom."""
        laws: dict[int, Holding] = {}
        for joint, stated, given in zip(self.joints, self.stated, terms, strict=True):
            numbers = {**stated, **given}
            if law := holding(numbers, numbers[DYNAMICS[0]]):
                laws[int(model.joint(joint).dofadr[0])] = law
        return laws

    def _set(
        self, model: mujoco.MjModel, data: mujoco.MjData, terms: Sequence[Terms]
    ) -> None:
        """Write numbers of joints into a compiled model; those that are not given are what the model states."""
        for joint, stated, given in zip(self.joints, self.stated, terms, strict=True):
            numbers = {**stated, **given}
            dof = int(model.joint(joint).dofadr[0])
            motor = model.actuator(motor_name(joint)).id
            model.dof_frictionloss[dof] = numbers[DYNAMICS[0]]
            model.dof_damping[dof, ...] = numbers[DYNAMICS[1]]
            model.dof_armature[dof] = numbers[DYNAMICS[2]]
            model.dof_dampingpoly[dof, 0] = numbers[DYNAMICS[3]]
            if self.has_servos:
                kp, kv = numbers[SERVO[0]], numbers[SERVO[1]]
                model.actuator_gainprm[motor, 0] = kp
                model.actuator_biasprm[motor, 1:3] = -kp, -kv
                if limit := given.get(LIMIT):
                    model.actuator_forcelimited[motor] = True
                    model.actuator_forcerange[motor] = -limit, limit
        _set_plays(model, self.joints, terms)
        # The softness of dry friction is in proportion to the inertia that a joint has at rest.
        mujoco.mj_setConst(model, data)

    def replayed(
        self, lines: str, terms: Sequence[Terms], logs: Sequence[Log]
    ) -> dict[str, FloatArray]:
        """Return the root mean square errors of logs in the model with pasted lines [rad], shape [J] each.

        Each log runs as a whole from its recorded angles and rates, and a command stays until the next one.

        Args:
            lines: Elements `<joint>` and `<position>`; comments are skipped.
            terms: Numbers of each joint; friction of servo benches and offsets, which no element states, are used.
            logs: The logs.
        """
        spec = paste(self.spec.copy(), lines)
        has_play = any(one.get(BACKLASH) for one in terms)
        model = (with_play(spec, self.joints) if has_play else spec).compile()
        _set_plays(model, self.joints, terms)
        laws = self._laws(model, terms)
        data = mujoco.MjData(model)
        motors = {
            model.actuator(index).id: self.joints.index(model.joint(joint).name)
            for index, joint in enumerate(model.actuator_trnid[:, 0].tolist())
            if model.actuator_trntype[index] == JOINT
            and model.joint(joint).name in self.joints
        }
        offsets_rad = np.array([one.get(OFFSET, 0.0) for one in terms])
        errors = {}
        for log in logs:
            assert log.command_rad is not None
            commands = self.signs * (log.command_rad + offsets_rad)
            start_at(model, data, self, *log.start())
            for motor, joint in motors.items():
                data.ctrl[motor] = commands[0, joint]
                if model.actuator_history[motor, 0]:
                    _fill_history(model, data, motor)
            if laws:
                mujoco.mj_forward(model, data)
            # A time in a log is no multiple of a step: the state nearest to it counts.
            steps = np.rint((log.times_s - log.times_s[0]) / model.opt.timestep)
            simulated = np.zeros_like(log.position_rad)
            for row, count in enumerate(np.diff(steps, prepend=0.0).astype(int)):
                if count:
                    _step(model, data, count, laws)
                simulated[row] = self._links(model, data.qpos)
                for motor, joint in motors.items():
                    data.ctrl[motor] = commands[row, joint]
            if any(warning.number for warning in data.warning):
                raise DivergedError(f"{log.name}: the pasted lines diverge in MuJoCo")
            errors[log.name] = np.sqrt(
                ((simulated - log.position_rad) ** 2).mean(axis=0)
            )
        return errors


def _step(
    model: mujoco.MjModel, data: mujoco.MjData, count: int, laws: Mapping[int, Holding]
) -> None:
    """Take steps, before each of which friction is set to what it can hold."""
    if not laws:
        mujoco.mj_step(model, data, nstep=count)
        return
    motors, others = data.qfrc_actuator, data.qfrc_bias
    for _ in range(count):
        for dof, law in laws.items():
            torque, load = float(motors[dof]), -float(others[dof])
            model.dof_frictionloss[dof] = law(float(data.qvel[dof]), torque, load)
        mujoco.mj_step(model, data)


def _at_times(angles: FloatArray, steps: FloatArray) -> FloatArray:
    """Return angles between steps, by cubics through the two steps before and behind, shape [N, J].

    Args:
        angles: Angles at each step [rad], shape [step_count, J].
        steps: Times over the step, shape [N].
    """
    first = np.clip(np.floor(steps).astype(int) - 1, 0, len(angles) - 4)
    place = (steps - first)[:, None]
    at = [place - node for node in range(4)]
    return np.asarray(
        -at[1] * at[2] * at[3] / 6.0 * angles[first]
        + at[0] * at[2] * at[3] / 2.0 * angles[first + 1]
        - at[0] * at[1] * at[3] / 2.0 * angles[first + 2]
        + at[0] * at[1] * at[2] / 6.0 * angles[first + 3]
    )


def with_play(spec: mujoco.MjSpec, joints: Sequence[str]) -> mujoco.MjSpec:
    """Return a model with a second hinge behind each joint, between rotor and link: it turns up to two stops."""
    for name in joints:
        joint = spec.joint(name)
        play = joint.parent.add_joint(
            name=play_name(name), type=joint.type, pos=joint.pos, axis=joint.axis
        )
        play.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        play.range = [-1.0, 1.0]
        play.solimp_limit = STOP_IMPEDANCE
        play.solref_limit = [SHORT_S, 1.0]
    return spec


def _set_plays(
    model: mujoco.MjModel, joints: Sequence[str], terms: Sequence[Terms]
) -> None:
    """Put the stops of plays at half of the backlash to either side, if the model has any."""
    for joint, numbers in zip(joints, terms, strict=True):
        if has_joint(model, play_name(joint)):
            half_rad = 0.5 * numbers[BACKLASH]
            model.joint(play_name(joint)).range = -half_rad, half_rad


def has_joint(model: mujoco.MjModel, name: str) -> bool:
    """Return whether a model has a joint of this name."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) >= 0


def play_name(joint: str) -> str:
    """Return the name of the hinge behind a joint that is its play."""
    return f"{joint}/play"


def motor_name(joint: str) -> str:
    """Return the name of the motor of a joint."""
    return f"{joint}/log"


def start_at(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    machine: ModelJoints,
    angles: FloatArray,
    rates: FloatArray | None = None,
) -> None:
    """Put the joints at angles [rad] and rates [rad/s]."""
    mujoco.mj_resetData(model, data)
    for place, name in enumerate(machine.joints):
        joint = model.joint(name)
        data.qpos[joint.qposadr] = machine.signs[place] * angles[place]
        if rates is not None:
            data.qvel[joint.dofadr] = machine.signs[place] * rates[place]
    if model.neq:
        _close_loops(model, data, machine.joints)


def _close_loops(
    model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[str]
) -> None:
    """Move the joints that no log names so that equality constraints hold: Newton's method on angles, then rates."""
    logged = {int(model.joint(one).dofadr[0]) for one in joints}
    passive = [dof for dof in range(model.nv) if dof not in logged]
    equality = mujoco.mjtConstraint.mjCNSTR_EQUALITY
    for _ in range(LOOP_STEPS):
        mujoco.mj_fwdPosition(model, data)
        rows = np.flatnonzero(data.efc_type == equality)
        jacobian = np.zeros((data.nefc, model.nv))
        if mujoco.mj_isSparse(model):
            mujoco.mju_sparse2dense(
                jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
            )  # fmt: skip
        else:
            jacobian[:] = np.reshape(data.efc_J, jacobian.shape)
        gap, slopes = data.efc_pos[rows], jacobian[rows]
        if not rows.size or np.abs(gap).max() < LOOP_GAP:
            break
        moved = np.zeros(model.nv)
        moved[passive] = -np.linalg.pinv(slopes[:, passive]) @ gap
        mujoco.mj_integratePos(model, data.qpos, moved, 1.0)
    else:
        raise DivergedError(
            f"no angles of other joints close the loops at the recorded start: {np.abs(gap).max():.3g} m or rad are "
            "left. Check zero and sign of the log's angles"
        )
    if rows.size and passive:
        data.qvel[passive] = 0.0
        data.qvel[passive] = -np.linalg.pinv(slopes[:, passive]) @ (slopes @ data.qvel)


def _controls(
    log: Log, joint: int, delay_s: float, count: int, step_s: float
) -> FloatArray:
    """Return what a motor gets in each step, shape [count].

    A commanded angle stays until the next one. Each step gets its mean over the step, which is what MuJoCo's linear
    `interp` makes of a delay that is no multiple of the step. A torque was measured, and is a line between samples.
    """
    times_s = log.times_s - log.times_s[0]
    edges_s = np.arange(count + 1) * step_s - delay_s
    if log.torque_n_m is not None:
        return np.interp(edges_s[:-1], times_s, log.torque_n_m[:, joint])
    if log.command_rad is None:
        return np.zeros(count)
    values = log.command_rad[:, joint]
    areas = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(times_s))])
    integral = np.interp(edges_s, times_s, areas)
    integral += values[0] * np.minimum(edges_s, 0.0)
    integral += values[-1] * np.maximum(edges_s - times_s[-1], 0.0)
    return np.asarray(np.diff(integral) / step_s)


def _fill_history(model: mujoco.MjModel, data: mujoco.MjData, motor: int) -> None:
    """Let the command that a motor has now be its command since long ago."""
    count = int(model.actuator_history[motor, 0])
    times_s = (np.arange(count) - count) * model.opt.timestep
    mujoco.mj_initCtrlHistory(
        model, data, motor, times_s, np.full(count, data.ctrl[motor])
    )
