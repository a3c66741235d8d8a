"""A scene in Rapier: initial states, driven bodies, steps and states."""

import os
from collections.abc import Mapping, Sequence

import numpy as np
import rapier3d as rapier

from gauge_envs.backends.rapier.model import MASS_UNIT_KG, build_world
from gauge_envs.backends.rapier.settings import SettingsRapier
from gauge_envs.backends.shared.rigid import (
    SingleWorldSimulation,
    hinge_angle,
    later_targets,
    motion_steps,
)
from gauge_envs.scene import RigidBody, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.states import nominal_states

CALLING_THREAD_BODIES = 16
"""Largest number of bodies with which Rapier steps on the calling thread, whatever the size of its thread pool.

A pool of one thread gives the same bits, and costs 10 us a step: half the step of a pendulum.
"""

PROCESS = os.getpid()
"""The process that imported this module. A fork of it would wait forever for threads of the shared pool."""


class SimulationRapier(SingleWorldSimulation):
    """A scene in Rapier."""

    def __init__(self, scene: Scene, settings: SettingsRapier) -> None:
        super().__init__(scene, settings)
        self._threads = settings.threads
        world, self._layout = build_world(scene, settings)
        self._use_world(world)
        self._write(nominal_states(scene))
        self._snapshot = world.snapshot()
        self.reset()

    def _use_world(self, world: rapier.PhysicsWorld) -> None:
        """Replace the world that this simulation reads and drives."""
        self._world = world
        bodies = world.rigid_bodies
        self._bodies = {
            name: bodies[placed.handle] for name, placed in self._layout.items()
        }

    def start(self, states: FloatArray | None) -> None:
        """Restore the world of the nominal start, and write given initial states to it."""
        world = rapier.PhysicsWorld.restore(self._snapshot)
        is_large = len(self._layout) > CALLING_THREAD_BODIES
        is_forked = os.getpid() != PROCESS
        if self._threads > 1 or is_large or is_forked:
            world.set_num_threads(self._threads)
        self._use_world(world)
        if states is not None:
            self._write(states)

    def _write(self, states: FloatArray) -> None:
        """Write states, shape [body_count, 13], to a world before its first step."""
        for body, state in zip(self.scene.bodies, states, strict=False):
            name = body.name
            if name not in self._layout:
                continue
            self._place(name, state)
            velocity = state[7:].copy()
            velocity[:3] += self._centre_speed(name, velocity[3:])
            self._set_velocity(name, velocity)
            if name in self.scene.hinges:
                self._turn_hinge(body, state)

    def _turn_hinge(self, body: RigidBody, state: FloatArray) -> None:
        """Write the state of a hinged body to the reduced coordinates of its joint, if it has any."""
        joints = self._world.multibody_joints
        link = joints.rigid_body_link(self._layout[body.name].handle)
        if link is None:
            return
        chain = joints.get_multibody(link.multibody)
        hinge = self.scene.hinges[body.name]
        angle_rad = hinge_angle(hinge, body.pose, state)
        # The coordinates of the anchor come first.
        still = [0.0] * (chain.ndofs - 1)
        chain.apply_displacements([*still, angle_rad])
        chain.set_generalized_velocity([*still, float(state[10:] @ hinge.axis)])

    def _place(self, name: str, state: FloatArray) -> None:
        """Move a body to the pose of a state, in which the quaternion is w, x, y, z."""
        x, y, z, qw, qx, qy, qz = state[:7].tolist()
        self._bodies[name].position = rapier.Isometry3((x, y, z), (qx, qy, qz, qw))

    def _set_velocity(self, name: str, velocity: FloatArray) -> None:
        """Give a body a velocity of its centre of mass [m/s] and an angular velocity [rad/s]."""
        body = self._bodies[name]
        body.linvel = tuple(velocity[:3].tolist())
        body.angvel = tuple(velocity[3:].tolist())

    def _centre_speed(self, name: str, spin: FloatArray) -> FloatArray:
        """Return the velocity of the centre of mass relative to the body origin [m/s].

        Args:
            name: Name of the body.
            spin: Its angular velocity [rad/s], shape [3].
        """
        centre_m = self._layout[name].centre_m
        if not any(centre_m):
            return np.zeros(3)
        arm_m = self._bodies[name].rotation.transform_vector(centre_m).to_tuple()
        return np.cross(spin, arm_m)

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe a kinematic body, which each step moves by the mean velocity of the step."""
        super().drive(body, targets)
        self._place(body, targets[0])
        self._set_velocity(body, targets[0, 7:13])

    def advance(self, seconds: float) -> None:
        """Step the world. Afterwards, driven bodies have the velocity at the end of the interval."""
        count = round(seconds / self.step_s)
        velocities = {
            name: motion_steps(motion, self.step_s, count)[1]
            for name, motion in self.motions.items()
        }
        for step in range(count):
            for name, of_steps in velocities.items():
                self._set_velocity(name, of_steps[step])
            self._world.step()
        for name, motion in self.motions.items():
            self._set_velocity(name, later_targets(motion[None], seconds)[0, 7:13])
        self.motions = {}

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force through the centre of mass [N] and a torque [N m] to a dynamic body."""
        rigid_body = self._bodies[body]
        rigid_body.reset_forces()
        rigid_body.reset_torques()
        rigid_body.add_force(tuple(wrenches[0, :3] / MASS_UNIT_KG))
        rigid_body.add_torque(tuple(wrenches[0, 3:] / MASS_UNIT_KG))

    def diverged(self) -> Mapping[int, str]:
        """Return the body that Rapier disabled since the last reset, if there is one."""
        for name, body in self._bodies.items():
            if not body.is_enabled:
                return {
                    0: f"Rapier found that the state of {name!r} is not finite, and disabled the body"
                }
        return {}

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return states in single precision, shape [1, len(names), 13]."""
        return np.array([[self._state(name) for name in names]])

    def _state(self, name: str) -> FloatArray:
        body = self._bodies[name]
        place_m, speed, spin = body.translation, body.linvel, body.angvel
        x, y, z, w = body.rotation.quaternion
        state = np.array(
            [*place_m.to_tuple(), w, x, y, z, *speed.to_tuple(), *spin.to_tuple()]
        )
        state[7:10] -= self._centre_speed(name, state[10:])
        return state

    def close(self) -> None:
        """Free the world."""
        self._bodies = {}
        self._world = rapier.PhysicsWorld()
