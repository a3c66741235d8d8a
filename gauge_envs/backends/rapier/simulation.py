"""A Rapier simulation: driving, stepping and reading of its state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rapier3d as rapier
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation
from gauge_envs.backends.rapier.model import MASS_UNIT_KG, build_world, isometry
from gauge_envs.backends.rapier.settings import SettingsRapier
from gauge_envs.backends.shared.driven_motion import DrivenMotion
from gauge_envs.scene import Motion, Pose, Scene

__all__ = ["SimulationRapier", "StateRapier"]


@dataclass(frozen=True)
class StateRapier:
    """A state of a simulation.

    Attributes:
        world: Snapshot of the Rapier world.
        motions: Motions of driven bodies in the next interval, by name.
    """

    world: bytes
    motions: dict[str, DrivenMotion]


class SimulationRapier(Simulation):
    """A scene in Rapier.

    Args:
        scene: The scene.
        settings: Numerical settings.
    """

    def __init__(self, scene: Scene, settings: SettingsRapier) -> None:
        self.settings = settings.model_dump(mode="json")
        self._timestep_s = settings.timestep_s
        self._threads = settings.threads
        self._fixed = {
            body.name: np.array([*body.pose.position_m, *body.pose.quaternion, *np.zeros(6)])
            for body in scene.bodies
            if body.motion is Motion.FIXED
        }
        world, self._layouts = build_world(scene, settings)
        self._start = world.snapshot()
        self._motions: dict[str, DrivenMotion] = {}
        self._hold(world)

    def _hold(self, world: rapier.PhysicsWorld) -> None:
        """Use a world from now on."""
        world.set_num_threads(self._threads)
        self._world = world
        bodies = world.rigid_bodies
        self._bodies = {name: bodies[layout.handle] for name, layout in self._layouts.items()}

    def reset(self, seed: int) -> None:
        """Return to the scene's start. Rapier draws no random numbers, so the seed has no effect."""
        self.restore(StateRapier(self._start, {}))

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Place a driven body where its interval starts; `advance` moves it by the mean velocity of each step."""
        self._motions[body] = DrivenMotion(pose, np.array(velocity), np.array(acceleration))
        held = self._bodies[body]
        held.position = isometry(pose)
        held.linvel, held.angvel = tuple(velocity[:3]), tuple(velocity[3:])

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        held = self._bodies[body]
        held.reset_forces()
        held.reset_torques()
        held.add_force(tuple(wrench[:3] / MASS_UNIT_KG))
        held.add_torque(tuple(wrench[3:] / MASS_UNIT_KG))

    def advance(self, seconds: float) -> None:
        """Step the world. Rapier moves a driven body by its velocity times the step."""
        step_s = self._timestep_s
        for index in range(round(seconds / step_s)):
            for name, motion in self._motions.items():
                mean = motion.mean_velocity(index * step_s, (index + 1) * step_s)
                held = self._bodies[name]
                held.linvel, held.angvel = tuple(mean[:3]), tuple(mean[3:])
            self._world.step()
        for name, motion in self._motions.items():
            end = motion.velocity_at(seconds)
            held = self._bodies[name]
            held.linvel, held.angvel = tuple(end[:3]), tuple(end[3:])
        self._motions = {}

    def fault(self) -> str | None:
        """Return why Rapier disabled a body since the last reset, or None; see `World.fault`."""
        for name, body in self._bodies.items():
            if not body.is_enabled:
                return f"Rapier found that the state of {name!r} is not finite, and disabled the body"
        return None

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities in single precision, shape [len(names), 13]; see `World.body_states`."""
        states = np.empty((len(names), 13))
        for row, name in zip(states, names, strict=True):
            row[:] = self._fixed[name] if name in self._fixed else self._state(name)
        return states

    def _state(self, name: str) -> NDArray[np.float64]:
        body = self._bodies[name]
        place, turned, speed, spin = body.translation, body.rotation, body.linvel, body.angvel
        x, y, z, w = turned.quaternion
        state = np.array([*place.to_tuple(), w, x, y, z, *speed.to_tuple(), *spin.to_tuple()])
        centre_m = self._layouts[name].centre_m
        if centre_m.any():
            # Rapier's velocity is that of the centre of mass.
            arm = turned.transform_vector(tuple(centre_m)).to_tuple()
            state[7:10] -= np.cross(state[10:], arm)
        return state

    def state(self) -> StateRapier:
        """Return a snapshot of the world, and the motions of driven bodies."""
        return StateRapier(self._world.snapshot(), dict(self._motions))

    def restore(self, state: StateRapier) -> None:
        """Restore a state."""
        self._hold(rapier.PhysicsWorld.restore(state.world))
        self._motions = dict(state.motions)

    def close(self) -> None:
        """Free the world."""
        self._bodies = {}
        self._world = rapier.PhysicsWorld()
