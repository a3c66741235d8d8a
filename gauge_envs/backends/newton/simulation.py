"""Worlds of a scene in one Newton model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gauge_envs.backends.newton.model import build_model
from gauge_envs.backends.newton.mujoco_stepper import StepperMuJoCo
from gauge_envs.backends.newton.parts import ClothPartNewton
from gauge_envs.backends.newton.settings import SettingsNewton
from gauge_envs.backends.shared.rigid import (
    MeanForces,
    PlacedSimulation,
    placed_states,
)
from gauge_envs.backends.simulation import ContactForces, MaterialPoints
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.states import nominal_states, row_of


class SimulationNewton(PlacedSimulation):
    """Worlds of a scene, which advance in the same step.

    Args:
        scene: The scene.
        world_count: Number of worlds.
        settings: Settings of the solver.
    """

    def __init__(
        self, scene: Scene, world_count: int, settings: SettingsNewton
    ) -> None:
        self.settings = settings.model_dump(mode="json")
        self.world_count = world_count
        self.placed = placed_states(scene)
        self._stepper, layout = build_model(scene, world_count, settings)
        self._bodies, self._shapes = layout.rigid.bodies, layout.rigid.shapes
        self._parts, self._origin_m = layout.parts, layout.origin_m
        self._nominal = nominal_states(scene)
        self._moving = {
            row: self._bodies[body.name]
            for row, body in enumerate(scene.bodies)
            if body.motion is not Motion.FIXED
        }
        attached = {a.deformable for a in scene.attachments}
        self._free_cloths = {
            row_of(scene, name): part
            for name, part in self._parts.items()
            if isinstance(part, ClothPartNewton) and name not in attached
        }
        self.reset()

    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start worlds. Newton draws no random numbers here, so the seed has no effect."""
        if starts is None:
            starts = np.broadcast_to(
                self._nominal, (self.world_count, *self._nominal.shape)
            )
        bodies = starts[:, [*self._moving]]
        bodies[:, :, :3] -= self._origin_m
        particles_m = None
        if self._free_cloths:
            particles_m = self._stepper.first_particles_m()
            for row, cloth in self._free_cloths.items():
                particles_m[:, cloth.particles] = cloth.at(starts[:, row])
        self._stepper.reset([*self._moving.values()], bodies, particles_m, worlds)

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe a kinematic body."""
        near = targets.copy()
        near[:, :3] -= self._origin_m
        self._stepper.drive(self._bodies[body], near)

    def advance(self, seconds: float) -> None:
        """Step the model, which contains all worlds."""
        self._stepper.advance(seconds)

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of bodies in single precision, shape [N, len(names), 13]."""
        states = self._stepper.body_states([self._bodies[name] for name in names])
        states[:, :, :3] += self._origin_m
        return states

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a deformable body [m], shape [N, node_count, 3]."""
        part = self._parts[name]
        nodes_m = part.nodes(self._stepper) + self._origin_m
        indices = part.node_indices.get(name)
        return nodes_m if indices is None else nodes_m[:, indices]

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points, or None for cloth."""
        read = self._parts[name].track(points_m - self._origin_m)
        return None if read is None else lambda: read(self._stepper) + self._origin_m

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body, with the MuJoCo solver only."""
        if isinstance(self._stepper, StepperMuJoCo):
            self._stepper.apply_wrench(self._bodies[body], wrenches)
        else:
            super().apply_wrench(body, wrenches)

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces | None:
        """Return a reader of contact forces, or None where the solver is not MuJoCo's."""
        stepper = self._stepper
        if not isinstance(stepper, StepperMuJoCo):
            return None
        names = {shape: name for name, own in self._shapes.items() for shape in own}

        def touches() -> Iterator[tuple[tuple[int, str], tuple[int, str], FloatArray]]:
            for world, first, second, force_n in stepper.touches():
                yield (world, names[first]), (world, names[second]), force_n

        worlds = range(self.world_count)
        keys = [((w, first), (w, second)) for w in worlds for first, second in pairs]
        reader = MeanForces(keys, touches)
        stepper.force_readers.append(reader)
        return lambda: reader.mean().reshape(self.world_count, -1, 3)

    def close(self) -> None:
        """Do nothing, since the simulation only holds memory."""
