"""MuJoCo behind the backend contract."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Backend, Simulation, Support
from gauge_envs.backends.mujoco.model import build_model
from gauge_envs.backends.mujoco.settings import SettingsMuJoCo, settings_for
from gauge_envs.scene import Motion, Pose, Scene

__all__ = ["BackendMuJoCo", "SimulationMuJoCo"]


class BackendMuJoCo(Backend):
    """MuJoCo 4 on the CPU: rigid bodies, hinges, strings and driven bodies."""

    name = "mujoco"

    def versions(self) -> dict[str, str]:
        """Version of the engine."""
        return {"mujoco": mujoco.__version__}

    def supports(self, scene: Scene) -> Support:
        """Rigid scenes of any size; deformable bodies are declined by name."""
        return Support(
            tuple(f"{type(body).__name__.lower()} {body.name!r} is a deformable body" for body in scene.deformables)
        )

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> SimulationMuJoCo:
        """Build a rigid scene; settings are the fields of `SettingsMuJoCo`."""
        return SimulationMuJoCo(scene, settings_for(scene, settings))


class SimulationMuJoCo(Simulation):
    """A rigid scene in MuJoCo.

    Attributes:
        spec: The editable model, for export and inspection.
        model: The compiled model.
        data: Its state.
    """

    def __init__(self, scene: Scene, settings: SettingsMuJoCo) -> None:
        self.settings = settings.model_dump(mode="json")
        self.spec, self.model = build_model(scene, settings)
        self.data = mujoco.MjData(self.model)
        self._steps_per_second = round(1.0 / settings.timestep_s)
        self._state_size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._scene = scene
        # A free body's state is read straight from qpos and qvel; of a fixed one nothing changes.
        self._free: dict[str, tuple[int, int]] = {}
        self._fixed: dict[str, NDArray[np.float64]] = {}
        self._body_ids = {body.name: self.model.body(body.name).id for body in scene.bodies}
        for body in scene.bodies:
            if body.motion is Motion.FIXED:
                self._fixed[body.name] = np.concatenate([body.pose.position_m, body.pose.quaternion, np.zeros(6)])
                continue
            joint = self.model.joint(body.name)
            if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE:
                self._free[body.name] = (int(joint.qposadr[0]), int(joint.dofadr[0]))
        self._addresses: dict[tuple[str, ...], tuple[NDArray[np.intp], NDArray[np.intp]] | None] = {}

    def reset(self, seed: int) -> None:
        """Return to the scene's start; MuJoCo draws no random numbers, so the seed changes nothing."""
        mujoco.mj_resetData(self.model, self.data)

    def drive(
        self, body: str, pose: Pose, linear_m_per_s: NDArray[np.float64], angular_rad_per_s: NDArray[np.float64]
    ) -> None:
        """Write the body's pose and velocity; its huge mass keeps the velocity constant until the next call."""
        position, velocity = self._free[body]
        self.data.qpos[position : position + 3] = pose.position_m
        self.data.qpos[position + 3 : position + 7] = pose.quaternion
        self.data.qvel[velocity : velocity + 3] = linear_m_per_s
        # MuJoCo keeps a free joint's angular velocity in the body frame.
        self.data.qvel[velocity + 3 : velocity + 6] = pose.rotation.apply(angular_rad_per_s, inverse=True)

    def advance(self, seconds: float) -> None:
        """Step the model."""
        mujoco.mj_step(self.model, self.data, nstep=round(seconds * self._steps_per_second))

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Poses and velocities of bodies, shape [len(names), 13]; see `Simulation.body_states`."""
        key = tuple(names)
        if key not in self._addresses:
            free = all(name in self._free for name in key)
            self._addresses[key] = (
                (
                    np.array([np.arange(7) + self._free[name][0] for name in key]),
                    np.array([np.arange(6) + self._free[name][1] for name in key]),
                )
                if free
                else None
            )
        addresses = self._addresses[key]
        if addresses is None:
            return self._mixed_states(key)
        states = np.empty((len(key), 13))
        states[:, :7] = self.data.qpos[addresses[0]]
        states[:, 7:] = self.data.qvel[addresses[1]]
        for state in states:
            mujoco.mju_rotVecQuat(state[10:], state[10:].copy(), state[3:7])
        return states

    def _mixed_states(self, names: tuple[str, ...]) -> NDArray[np.float64]:
        """States of bodies that are not all free: a hinged body's pose follows from its angle."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_comVel(self.model, self.data)
        states = np.empty((len(names), 13))
        velocity = np.empty(6)
        for state, name in zip(states, names, strict=True):
            if name in self._fixed:
                state[:] = self._fixed[name]
                continue
            index = self._body_ids[name]
            state[:3] = self.data.xpos[index]
            state[3:7] = self.data.xquat[index]
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, index, velocity, 0)
            state[7:10] = velocity[3:]
            state[10:] = velocity[:3]
        return states

    def state(self) -> NDArray[np.float64]:
        """Integration state, shape [state_size]."""
        state = np.empty(self._state_size)
        mujoco.mj_getState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return state

    def restore(self, state: NDArray[np.float64]) -> None:
        """Go back to an integration state."""
        mujoco.mj_setState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)

    def close(self) -> None:
        """Nothing is held outside memory."""
