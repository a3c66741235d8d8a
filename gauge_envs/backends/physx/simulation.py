"""A PhysX simulation: driving, stepping and reading of its state."""

from collections.abc import Sequence

import numpy as np

from gauge_envs.backends.physx.model import ModelPhysX, physx_pose
from gauge_envs.backends.physx.settings import SettingsPhysX
from gauge_envs.backends.shared.rigid import (
    PlacedSimulation,
    later_targets,
    placed_states,
)
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, RigidBody, Scene
from gauge_envs.scene.geometry import (
    BoolArray,
    FloatArray,
    pose_distance,
    rotation_matrices,
    unit_quaternions,
)
from gauge_envs.scene.states import bodies_at

SAME_POSE = 1e-5
"""Distance [m, rad] within which a driven body already has the initial pose of its interval."""


class SimulationPhysX(PlacedSimulation):
    """A scene in PhysX. A reset rebuilds it, since PhysX cannot forget its contacts."""

    def __init__(self, scene: Scene, settings: SettingsPhysX) -> None:
        self.settings = settings.model_dump(mode="json")
        self._scene = scene
        self._chosen = settings
        self._start(scene.bodies)

    def _start(self, bodies: Sequence[RigidBody]) -> None:
        self._model: ModelPhysX | None = ModelPhysX(self._scene, bodies, self._chosen)
        self._wrenches: dict[str, FloatArray] = {}
        self._driven: dict[str, FloatArray] = {}
        self.placed = placed_states(self._scene)

    def _open(self) -> ModelPhysX:
        if self._model is None:
            raise BackendError("the PhysX simulation is closed: build another one")
        return self._model

    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Build the scene at its start. PhysX draws no random numbers, so the seed has no effect."""
        bodies = self._scene.bodies
        if starts is not None:
            bodies = bodies_at(self._scene, starts[0])
        self._start(bodies)

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe a kinematic body; PhysX moves it to its exact pose at the end of each step."""
        start = Pose.of_state(targets[0])
        current = Pose.of_state(self.body_states([body])[0, 0])
        if pose_distance(current, start) > SAME_POSE:
            component = self._open().parts[body].component
            component.entity.set_pose(physx_pose(start))
        self._driven[body] = targets[0].copy()
        # Valid until the next step, which moves the body; after it, the state comes from PhysX.
        self.placed[body] = targets[0, :13].copy()

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `Simulation.apply_wrench`."""
        self._wrenches[body] = wrenches[0].copy()

    def advance(self, seconds: float) -> None:
        """Step the scene."""
        model = self._open()
        step_s = self._chosen.timestep_s
        for step in range(1, round(seconds / step_s) + 1):
            for name, motion in self._driven.items():
                later = later_targets(motion[None], step * step_s)[0]
                target = physx_pose(Pose.of_state(later))
                model.parts[name].component.set_kinematic_target(target)
            for name, wrench in self._wrenches.items():
                model.parts[name].component.add_force_torque(wrench[:3], wrench[3:])
            model.system.step()
        for name in self._driven:
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
