"""A PhysX simulation: driving, stepping and reading of its state."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends.physx.model import Model, build_model, physx_pose
from gauge_envs.backends.physx.settings import SettingsPhysX
from gauge_envs.backends.shared.rigid import (
    DrivenMotion,
    PlacedWorld,
    body_state,
    placed_states,
)
from gauge_envs.backends.world import Simulation
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import FloatArray, pose_distance

SAME_POSE = 1e-5
"""Distance [m, rad] within which a driven body already is where its interval starts."""


class SimulationPhysX(PlacedWorld, Simulation):
    """A scene in PhysX. A reset builds it anew, since PhysX cannot forget its contacts."""

    def __init__(self, scene: Scene, settings: SettingsPhysX) -> None:
        self.settings = settings.model_dump(mode="json")
        self._scene = scene
        self._chosen = settings
        self._start()

    def _start(self) -> None:
        self._model: Model | None = None
        self._model = build_model(self._scene, self._chosen)
        self._is_new = True
        self._wrenches: dict[str, FloatArray] = {}
        self._driven: dict[str, DrivenMotion] = {}
        self.placed = placed_states(self._scene)

    def _open(self) -> Model:
        if self._model is None:
            raise BackendError("the PhysX simulation is closed: build another one")
        return self._model

    def reset(self, seed: int) -> None:
        """Return to the scene's start. PhysX draws no random numbers, so the seed has no effect."""
        self._open()
        if not self._is_new:
            self._start()

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Prescribe a kinematic body; PhysX moves it to its exact pose at the end of each step."""
        component = self._open().parts[body].component
        self._is_new = False
        before = self.body_states([body])[0]
        known = Pose(position_m=tuple(before[:3]), quaternion=tuple(before[3:7]))
        if pose_distance(known, pose) > SAME_POSE:
            component.entity.set_pose(physx_pose(pose))
        self._driven[body] = DrivenMotion.copied(pose, velocity, acceleration)
        # Until the next step, which takes the body along: then the engine is asked.
        self.placed[body] = body_state(pose, velocity)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        self._open()
        self._is_new = False
        self._wrenches[body] = np.array(wrench)

    def advance(self, seconds: float) -> None:
        """Step the scene."""
        model = self._open()
        self._is_new = False
        step_s = self._chosen.timestep_s
        for step in range(1, round(seconds / step_s) + 1):
            for name, motion in self._driven.items():
                model.parts[name].component.set_kinematic_target(
                    physx_pose(motion.pose(step * step_s))
                )
            for name, wrench in self._wrenches.items():
                model.parts[name].component.add_force_torque(wrench[:3], wrench[3:])
            model.system.step()
        for name in self._driven:
            self.placed.pop(name, None)

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities, in single precision for moving bodies; see `World.body_states`."""
        self._open()
        return super().body_states(names)

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities of dynamic and driven bodies in PhysX, shape [len(names), 13]."""
        states = np.empty((len(names), 13))
        for state, name in zip(states, names, strict=True):
            part = self._open().parts[name]
            pose = part.component.entity_pose
            state[:3] = pose.p
            state[3:7] = pose.q
            state[3:7] /= np.linalg.norm(state[3:7])
            state[7:10] = part.component.linear_velocity
            state[10:] = part.component.angular_velocity
            if part.centre_m.any():
                # PhysX's linear velocity is that of the centre of mass.
                arm_m = Rotation.from_quat(state[3:7], scalar_first=True).apply(
                    part.centre_m
                )
                state[7:10] -= np.cross(state[10:], arm_m)
        return states

    def close(self) -> None:
        """Free the scene."""
        self._model = None
