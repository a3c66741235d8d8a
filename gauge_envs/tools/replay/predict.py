"""Predictions of a log from its own recorded states."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ParameterError
from gauge_envs.files import processors
from gauge_envs.tools.replay.log import FloatArray, Log
from gauge_envs.tools.replay.model import IntArray, Setup, effort_limits, find_places

BASE_DOFS = 6
MAX_GAP = 3.0
"""Interval between two samples, over the median, that a prediction may cross."""
MAX_DEVIATION = 3.0
"""Deviation at which a prediction that flies off is cut [rad or m]."""


@dataclass(frozen=True)
class Pieces:
    """Predictions of the same length, each from a recorded state.

    Attributes:
        start: Sample at which each begins, shape [P].
        sample: Samples that it predicts, shape [P, T].
    """

    start: IntArray
    sample: IntArray


class Replayer:
    """Predict a log from its own states.

    Degrees of freedom D are the joints of the log; position [m] and rotation vector [rad] of a free base stand first.

    Args:
        log: The log.
        model: The model that the log belongs to.

    Attributes:
        qpos, qvel: States of all samples, shapes [N, nq] and [N, nv]; joints that are not logged rest.
        noise, velocity_noise: Noise of each degree of freedom, shape [D].
    """

    def __init__(self, log: Log, model: mujoco.MjModel) -> None:
        self.log, self.places = log, find_places(model, log)
        self.evaluations = 0
        self._datas = [mujoco.MjData(model) for _ in range(processors())]
        self._pool = rollout.Rollout(nthread=len(self._datas))
        self.qpos = np.tile(model.qpos0, (len(log.time_s), 1))
        self.qvel = np.zeros((len(log.time_s), model.nv))
        self.qpos[:, self.places.qpos] = log.position
        self.qvel[:, self.places.dof] = log.velocity
        self.noise, self.velocity_noise = log.position_noise, log.velocity_noise
        if self.has_base:
            base, at = log.base, self.places.base
            self.qpos[:, at : at + 7] = np.hstack(
                [base["position"], base["quaternion"]]
            )
            self.qvel[:, :BASE_DOFS] = np.hstack(
                [base["linear_velocity"], base["angular_velocity"]]
            )
            noise, velocity_noise = log.base_noise()
            self.noise = np.concatenate([noise, self.noise])
            self.velocity_noise = np.concatenate([velocity_noise, self.velocity_noise])

    @property
    def has_base(self) -> bool:
        """Whether the base is free."""
        return self.places.base >= 0

    @property
    def base_dofs(self) -> int:
        """Number of degrees of freedom before the joints."""
        return BASE_DOFS if self.has_base else 0

    def pieces(self, horizon_s: float, count: int, outputs: int = 8) -> Pieces:
        """Return pieces that are spread over the log.

        Args:
            horizon_s: Length of each; at least one sample.
            count: Number of pieces at most.
            outputs: Number of samples of each that are compared.

        Raises:
            ParameterError: The log has no run of good samples of this length.
        """
        log = self.log
        length = max(1, round(horizon_s / log.interval_s))
        steps = np.unique(np.linspace(0, length, outputs + 1).round().astype(int))[1:]
        broken = ~log.valid
        broken[1:] |= np.diff(log.time_s) > MAX_GAP * log.interval_s
        before = np.concatenate([[0], np.cumsum(broken)])
        start = np.arange(len(log.time_s) - length)
        start = start[
            (before[start + length + 1] == before[start + 1]) & log.valid[start]
        ]
        if not len(start):
            raise ParameterError(f"{log.name}: no {horizon_s:g} s without lost samples")
        chosen = np.unique(np.linspace(0, len(start) - 1, count).round().astype(int))
        return Pieces(start[chosen], start[chosen, None] + steps)

    def elapsed_s(self, pieces: Pieces) -> FloatArray:
        """Return the time from the start of each piece to its samples, shape [P, T]."""
        return self.log.time_s[pieces.sample] - self.log.time_s[pieces.start][:, None]

    def predict(
        self,
        setup: Setup,
        pieces: Pieces,
        initial: tuple[FloatArray, FloatArray] | None = None,
    ) -> FloatArray:
        """Return predicted minus recorded degrees of freedom, shape [P, T, D].

        Args:
            setup: What predicts.
            pieces: What is predicted.
            initial: Initial positions [P, nq] and velocities [P, nv] in place of the recorded ones.
        """
        model, log = setup.model, self.log
        step_s = model.opt.timestep
        elapsed_s = self.elapsed_s(pieces) * setup.clock
        count = int(np.ceil(elapsed_s.max() / step_s - 1e-9))
        logged_step_s = step_s / setup.clock
        times_s = log.time_s[pieces.start][:, None] + np.arange(count) * logged_step_s
        controls = setup.controls(log, times_s, logged_step_s)
        qpos, qvel = initial or (self.qpos[pieces.start], self.qvel[pieces.start])
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        state = np.zeros((len(qpos), size))
        end = 1 + model.nq + model.nv
        state[:, 1:end] = np.hstack([qpos, qvel])
        is_filtered = model.actuator_actadr >= 0
        state[:, end + model.actuator_actadr[is_filtered]] = controls[:, 0, is_filtered]
        states, _ = self._pool.rollout(model, self._datas, state, controls)
        self.evaluations += 1
        motion = np.concatenate([qpos[:, None], states[:, :, 1 : 1 + model.nq]], axis=1)
        place = np.clip(elapsed_s / step_s, 0.0, count)
        left = np.minimum(place.astype(int), count - 1)
        part = (place - left)[..., None]
        rows = np.arange(len(qpos))[:, None]
        predicted = (1.0 - part) * motion[rows, left] + part * motion[rows, left + 1]
        return self._difference(predicted, self.qpos[pieces.sample])

    def _difference(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the difference of positions [P, T, nq] in degrees of freedom [P, T, D]."""
        at = self.places.base
        joints = first[..., self.places.qpos] - second[..., self.places.qpos]
        parts = [joints]
        if self.has_base:
            before, after = (
                _rotation(each[..., at + 3 : at + 7]) for each in (second, first)
            )
            turned = (before.inv() * after).as_rotvec().reshape(*first.shape[:-1], 3)
            parts = [first[..., at : at + 3] - second[..., at : at + 3], turned, joints]
        joined = np.nan_to_num(np.concatenate(parts, axis=-1), nan=MAX_DEVIATION)
        return np.clip(joined, -MAX_DEVIATION, MAX_DEVIATION)

    def covariance(self, setup: Setup, pieces: Pieces) -> FloatArray:
        """Return the covariance of the predictions that noise alone gives, shape [P, T D, T D].

        The noise of the initial state is propagated by its sensitivities, by finite differences: C = N S0 N^T + S.
        """
        size = pieces.sample.shape[1] * len(self.noise)
        plain = self.predict(setup, pieces).reshape(-1, size)
        columns = []
        for index, scale in enumerate(
            np.concatenate([self.noise, self.velocity_noise])
        ):
            moved = self.predict(setup, pieces, self._perturbed(pieces, index, scale))
            columns.append(moved.reshape(-1, size) - plain)
        sensitivity = np.stack(columns, axis=-1)
        recorded = np.tile(self.noise**2, pieces.sample.shape[1])
        return sensitivity @ sensitivity.transpose(0, 2, 1) + np.diag(recorded)

    def _perturbed(
        self, pieces: Pieces, index: int, scale: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return initial states with one position or velocity changed by a number."""
        places, at = self.places, self.places.base
        qpos, qvel = self.qpos[pieces.start], self.qvel[pieces.start]
        dof = index % len(self.noise)
        joint = dof - self.base_dofs
        if index >= len(self.noise):
            qvel[:, places.dof[joint] if joint >= 0 else dof] += scale
        elif joint >= 0:
            qpos[:, places.qpos[joint]] += scale
        elif dof < 3:
            qpos[:, at + dof] += scale
        else:
            turn = Rotation.from_rotvec(scale * np.eye(3)[dof - 3])
            turned = _rotation(qpos[:, at + 3 : at + 7]) * turn
            qpos[:, at + 3 : at + 7] = turned.as_quat(scalar_first=True)
        return qpos, qvel

    def conditions(
        self, setup: Setup, samples: IntArray
    ) -> tuple[NDArray[np.str_], FloatArray]:
        """Return the condition of each joint at samples, shape [S, J], and the torques of the actuators [S, nu]."""
        model, places, data, log = setup.model, self.places, self._datas[0], self.log
        controls = setup.controls(log, log.time_s[samples], model.opt.timestep)
        found = np.full((len(samples), len(places.joint)), "free", dtype="<U10")
        torques = np.zeros((len(samples), model.nu))
        for place, row in enumerate(samples):
            data.qpos[:], data.qvel[:], data.ctrl[:] = (
                self.qpos[row],
                self.qvel[row],
                controls[place],
            )
            mujoco.mj_forward(model, data)
            torques[place] = data.actuator_force * model.actuator_gear[:, 0]
            if data.ncon:
                found[place] = "contact"
        ranges, near = model.jnt_range[places.joint], 3.0 * log.position_noise
        angle = log.position[samples]
        at_limit = (angle < ranges[:, 0] + near) | (angle > ranges[:, 1] - near)
        found[at_limit & (model.jnt_limited[places.joint] == 1)] = "limit"
        driven = np.flatnonzero(places.actuator >= 0)
        ids = places.actuator[driven]
        saturated = np.zeros(found.shape, bool)
        saturated[:, driven] = (
            np.abs(torques[:, ids]) > 0.999 * effort_limits(model)[ids]
        )
        found[saturated] = "saturation"
        return found, torques

    def held_velocity(self, pieces: Pieces) -> FloatArray:
        """Return the error of the baseline that keeps the recorded velocity, shape [P, T, J]."""
        log = self.log
        moved = self.elapsed_s(pieces)[..., None] * log.velocity[pieces.start][:, None]
        return log.position[pieces.start][:, None] + moved - log.position[pieces.sample]


def _rotation(quaternion: FloatArray) -> Rotation:
    return Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True)
