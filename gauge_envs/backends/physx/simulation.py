"""A PhysX simulation: driving, stepping and reading of its state."""

from collections.abc import Sequence

import numpy as np

from gauge_envs.backends.physx.model import ModelPhysX, physx_pose
from gauge_envs.backends.physx.settings import SettingsPhysX
from gauge_envs.backends.shared.rigid import SingleWorldSimulation, later_targets
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import (
    FloatArray,
    pose_distance,
    rotation_matrices,
    unit_quaternions,
)
from gauge_envs.scene.states import bodies_at

SAME_POSE = 1e-5
"""Distance [m, rad] within which a driven body already has the initial pose of its interval."""


class SimulationPhysX(SingleWorldSimulation):
    """A scene in PhysX. A reset rebuilds it, since PhysX cannot forget its contacts."""

    def __init__(self, scene: Scene, settings: SettingsPhysX) -> None:
        super().__init__(scene, settings)
        self._chosen = settings
        self.reset()

    def _open(self) -> ModelPhysX:
        if self._model is None:
            raise BackendError("the PhysX simulation is closed: build another one")
        return self._model

    def start(self, states: FloatArray | None) -> None:
        """Build the scene at its start."""
        bodies = self.scene.bodies
        if states is not None:
            bodies = bodies_at(self.scene, states)
        self._model: ModelPhysX | None = ModelPhysX(self.scene, bodies, self._chosen)

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe a kinematic body; PhysX moves it to its exact pose at the end of each step."""
        start = Pose.of_state(targets[0])
        current = Pose.of_state(self.body_states([body])[0, 0])
        if pose_distance(current, start) > SAME_POSE:
            component = self._open().parts[body].component
            component.entity.set_pose(physx_pose(start))
        super().drive(body, targets)
        # Valid until the next step, which moves the body; after it, the state comes from PhysX.
        self.placed[body] = targets[0, :13].copy()

    def advance(self, seconds: float) -> None:
        """Step the scene."""
        model = self._open()
        for step in range(1, round(seconds / self.step_s) + 1):
            for name, motion in self.motions.items():
                later = later_targets(motion[None], step * self.step_s)[0]
                target = physx_pose(Pose.of_state(later))
                model.parts[name].component.set_kinematic_target(target)
            for name, wrench in self.wrenches.items():
                model.parts[name].component.add_force_torque(wrench[:3], wrench[3:])
            model.system.step()
        for name in self.motions:
            self.placed.pop(name, None)

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities of dynamic and driven bodies in single precision, shape [1, len(names), 13]."""
        states = np.empty((len(names), 13))
        for state, name in zip(states, names, strict=True):
            part = self._open().parts[name]
            pose = part.component.entity_pose
            state[:3] = pose.p
            state[3:7] = unit_quaternions(pose.q.astype(np.float64))
            state[7:10] = part.component.linear_velocity
            state[10:] = part.component.angular_velocity
            if part.centre_m.any():
                # PhysX's linear velocity refers to the centre of mass.
                arm_m = rotation_matrices(state[3:7]) @ part.centre_m
                state[7:10] -= np.cross(state[10:], arm_m)
        return states[None]

    def close(self) -> None:
        """Free the scene. A second call does nothing."""
        self._model = None
