"""Predictions of a log from its own recorded states."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError
from gauge_envs.files import processors
from gauge_envs.tools.replay.log import (
    MIN_NOISE,
    MIN_RATE_NOISE,
    FloatArray,
    Log,
    noise_of,
)
from gauge_envs.tools.replay.model import IntArray, Setup, find_places

MAX_GAP = 3.0
"""Interval between two samples, over the median, that a prediction may cross."""
MAX_DEVIATION = 3.0
"""Deviation at which a prediction that flies off is cut [rad or m]."""


class Replayer:
    """Predict a log from its own states.

    Degrees of freedom D are the joints of the log; position [m] and rotation vector [rad] of a free base stand first.

    Args:
        log: The log.
        model: The model that the log belongs to.

    Attributes:
        qpos, qvel: States of all samples, shapes [N, nq] and [N, nv]; joints that are not logged rest.
        dofs: Addresses of the degrees of freedom in `qvel`, shape [D].
        noise: Noise of the degrees of freedom and then of their rates, shape [2 D].
        is_joint: Whether a degree of freedom is a joint, shape [D].
    """

    def __init__(self, log: Log, model: mujoco.MjModel) -> None:
        self.log, self.places = log, find_places(model, log)
        self._datas = [mujoco.MjData(model) for _ in range(processors())]
        self._pool = rollout.Rollout(nthread=len(self._datas))
        places = self.places
        self.qpos = np.tile(model.qpos0, (len(log.time_s), 1))
        self.qvel = np.zeros((len(log.time_s), model.nv))
        self.qpos[:, places.qpos] = log.position
        self.qvel[:, places.dof] = log.velocity
        self.dofs = np.concatenate([places.base_dof, places.dof])
        self.is_joint = np.arange(len(self.dofs)) >= len(places.base_dof)
        pose_noise, twist_noise = np.zeros((2, 0))
        if len(places.base_dof):
            self.qpos[:, places.base_qpos] = log.base_pose
            self.qvel[:, places.base_dof] = log.base_twist
            pose_noise = noise_of(log.time_s, log.base_pose, log.valid)
            # A rotation is twice the change of the quaternion.
            pose_noise = np.append(pose_noise[:3], [2.0 * pose_noise[3:].max()] * 3)
            twist_noise = noise_of(log.time_s, log.base_twist, log.valid)
        self.noise = np.concatenate(
            [
                np.maximum(pose_noise, MIN_NOISE),
                log.position_noise,
                np.maximum(twist_noise, MIN_RATE_NOISE),
                log.velocity_noise,
            ]
        )

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
        is_broken = ~log.valid
        is_broken[1:] |= np.diff(log.time_s) > MAX_GAP * log.interval_s
        breaks = np.cumsum(is_broken)
        is_whole = breaks[length:] == breaks[:-length]
        start = np.flatnonzero(is_whole & log.valid[:-length])
        if not len(start):
            raise ParameterError(f"{log.name}: no {horizon_s:g} s without lost samples")
        chosen = np.unique(np.linspace(0, len(start) - 1, count).round().astype(int))
        return start[chosen, None] + steps

    def elapsed_s(self, pieces: IntArray) -> FloatArray:
        """Return the time from the start of each piece to its samples, shape [P, T]."""
        time_s = self.log.time_s[pieces]
        return time_s[:, 1:] - time_s[:, :1]

    def predict(
        self, setup: Setup, pieces: IntArray, tangent: FloatArray | None = None
    ) -> FloatArray:
        """Return predicted minus recorded degrees of freedom, shape [P, T, D].

        Args:
            setup: What predicts.
            pieces: What is predicted.
            tangent: Change of the initial positions and rates, shape [2 nv].
        """
        model, log = setup.model, self.log
        step_s = model.opt.timestep
        elapsed_s = self.elapsed_s(pieces)
        count = max(1, int(np.ceil(elapsed_s.max() / step_s - 1e-9)))
        times_s = log.time_s[pieces[:, :1]] + step_s * np.arange(count)
        controls = setup.controls(times_s, step_s)
        qpos, qvel = self.qpos[pieces[:, 0]], self.qvel[pieces[:, 0]]
        if tangent is not None:
            qvel += tangent[model.nv :]
            for row in qpos:
                mujoco.mj_integratePos(model, row, tangent[: model.nv], 1.0)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        state = np.zeros((len(qpos), size))
        end = 1 + model.nq + model.nv
        state[:, 1:end] = np.hstack([qpos, qvel])
        is_filtered = model.actuator_actadr >= 0
        state[:, end + model.actuator_actadr[is_filtered]] = controls[:, 0, is_filtered]
        states, _ = self._pool.rollout(model, self._datas, state, controls)
        motion = np.concatenate([qpos[:, None], states[:, :, 1 : 1 + model.nq]], axis=1)
        # Samples between two steps are interpolated.
        place = np.clip(elapsed_s / step_s, 0.0, count)
        left = np.minimum(place.astype(int), count - 1)
        part = (place - left)[..., None]
        rows = np.arange(len(qpos))[:, None]
        predicted = (1.0 - part) * motion[rows, left] + part * motion[rows, left + 1]
        recorded = self.qpos[pieces[:, 1:]]
        difference = np.zeros((*place.shape, model.nv))
        for index in np.ndindex(place.shape):
            mujoco.mj_differentiatePos(
                model, difference[index], 1.0, recorded[index], predicted[index]
            )
        deviation = np.nan_to_num(difference[..., self.dofs], nan=MAX_DEVIATION)
        return np.clip(deviation, -MAX_DEVIATION, MAX_DEVIATION)

    def covariance(self, setup: Setup, pieces: IntArray) -> FloatArray:
        """Return the covariance of the predictions that noise alone gives, shape [P, T D, T D].

        The noise of the initial state is propagated by its sensitivities, by finite differences: C = N S0 N^T + S.
        """
        plain = self.predict(setup, pieces)
        recorded = np.tile(self.noise[: len(self.dofs)] ** 2, plain.shape[1])
        columns = []
        units = np.eye(2 * setup.model.nv)[[*self.dofs, *setup.model.nv + self.dofs]]
        for tangent in self.noise[:, None] * units:
            change = self.predict(setup, pieces, tangent) - plain
            columns.append(change.reshape(len(pieces), -1))
        sensitivity = np.stack(columns, axis=-1)
        return sensitivity @ sensitivity.transpose(0, 2, 1) + np.diag(recorded)

    def conditions(
        self, setup: Setup, samples: IntArray
    ) -> tuple[NDArray[np.str_], FloatArray]:
        """Return the condition of each joint at samples, shape [S, J], and its torque in the model, shape [S, J].

        The torque of a joint without an actuator is that of gravity and inertia.
        """
        model, places, data, log = setup.model, self.places, self._datas[0], self.log
        controls = setup.controls(log.time_s[samples], model.opt.timestep)
        conditions = np.full((len(samples), len(places.joint)), "free", dtype="<U10")
        torques = np.zeros(conditions.shape)
        for place, row in enumerate(samples):
            data.qpos[:], data.qvel[:] = self.qpos[row], self.qvel[row]
            data.ctrl[:] = controls[place]
            mujoco.mj_forward(model, data)
            torque = np.where(data.qfrc_actuator, data.qfrc_actuator, data.qfrc_bias)
            torques[place] = torque[places.dof]
            if data.ncon:
                conditions[place] = "contact"
        lower, upper = model.jnt_range[places.joint].T
        near = 3.0 * log.position_noise
        angle = log.position[samples]
        conditions[(angle < lower + near) | (angle > upper - near)] = "limit"
        effort = model.actuator_forcerange[:, 1] * np.abs(model.actuator_gear[:, 0])
        # A joint without an actuator has the place -1: the last entry.
        limits = np.append(effort, np.inf)[places.actuator]
        conditions[np.abs(torques) > 0.999 * limits] = "saturation"
        return conditions, torques
