"""A scene in Drake, advanced step by step."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator

from gauge_envs.backends.drake.model import build_model
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.backends.shared.rigid import (
    DrivenMotion,
    MeanForces,
    PlacedWorld,
    TetherSpring,
    body_state,
    placed_states,
)
from gauge_envs.backends.world import Simulation
from gauge_envs.scene import Motion, Pose, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.meshes import body_mass_properties


class SimulationDrake(PlacedWorld, Simulation):
    """A scene in Drake's discrete multibody plant."""

    def __init__(self, scene: Scene, settings: SettingsDrake) -> None:
        self.settings = settings.model_dump(mode="json")
        self._scene = scene
        self._step_s = settings.timestep_s
        self._tether_rate = settings.tether_rate
        self._model = build_model(scene, settings)
        plant = self._model.plant
        self._context = self._model.diagram.CreateDefaultContext()
        self._simulator = Simulator(self._model.diagram, self._context)
        self._plant_context = plant.GetMyMutableContextFromRoot(self._context)
        self._forces = plant.get_applied_spatial_force_input_port()
        self._tethers = TetherSpring.of(scene)
        self._force_readers: list[MeanForces] = []
        # Where the state has the pose and the velocity of bodies without joints.
        self._rows = {
            name: (
                body.floating_positions_start(),
                plant.num_positions() + body.floating_velocities_start_in_v(),
            )
            for name, body in self._model.bodies.items()
            if name not in scene.hinges
        }
        self._centres = {
            body.name: body_mass_properties(body)[0] for body in scene.dynamic_bodies
        }
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Return to the scene's start. Drake draws no random numbers here, so the seed has no effect."""
        self._state = self._model.start.copy()
        self._motions: dict[str, DrivenMotion] = {}
        self._wrenches: dict[str, FloatArray] = {}
        self.placed = placed_states(self._scene)
        for body in self._scene.bodies:
            if body.motion is Motion.KINEMATIC:
                self._motions[body.name] = DrivenMotion(body.pose)
                self._place(body.name, body.pose, np.zeros(6))
        self._load()

    def _load(self) -> None:
        self._context.SetDiscreteState(self._state)
        self._apply_forces()

    def _place(self, name: str, pose: Pose, velocity: FloatArray) -> None:
        """Write the pose of a driven body to the state, and keep what `body_states` returns until the next step."""
        first, _ = self._rows[name]
        self._state[first : first + 7] = [*pose.quaternion, *pose.position_m]
        self.placed[name] = body_state(pose, velocity)
        self.placed[name][3:7] /= np.linalg.norm(pose.quaternion)

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Prescribe a kinematic body; see `World.drive`."""
        self._motions[body] = DrivenMotion.copied(pose, velocity, acceleration)
        self._place(body, pose, velocity)
        self._context.SetDiscreteState(self._state)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force through the centre of mass and a torque; see `World.apply_wrench`."""
        self._wrenches[body] = np.array(wrench, dtype=float)
        self._apply_forces()

    def advance(self, seconds: float) -> None:
        """Step the plant; driven bodies start each step at their pose, with their mean velocity in the step."""
        count = round(seconds / self._step_s)
        for reader in self._force_readers:
            reader.clear()
        if self._motions or self._tethers or self._force_readers:
            self._advance_with(self._motions, count)
        else:
            # In one call, which costs half of as many single steps and gives the same bits.
            self._context.SetTime(0.0)
            self._simulator.Initialize()
            self._simulator.AdvanceTo(count * self._step_s)
            self._state = _plant_state(self._context.get_discrete_state())
        # Driven bodies rest at the end of their interval until they are driven again; what Drake made of them is read.
        for name, motion in self._motions.items():
            self.placed.pop(name, None)
            self._motions[name] = DrivenMotion(motion.pose(seconds))

    def _advance_with(self, motions: Mapping[str, DrivenMotion], count: int) -> None:
        """Take steps before each of which driven bodies are placed and strings pull."""
        paths = []
        for name, motion in motions.items():
            poses, velocities = motion.steps(self._step_s, count)
            # Drake has the rotation first.
            poses, velocities = (
                np.roll(poses, 4, axis=1),
                np.roll(velocities, 3, axis=1),
            )
            paths.append((*self._rows[name], poses, velocities))
        for step in range(count):
            for position, velocity, poses, velocities in paths:
                self._state[position : position + 7] = poses[step]
                self._state[velocity : velocity + 6] = velocities[step]
            if paths:
                self._context.SetDiscreteState(self._state)
            if self._tethers:
                self._apply_forces()
            # The contact results are those of the step that is taken now.
            for reader in self._force_readers:
                reader.add()
            after = self._model.diagram.EvalUniquePeriodicDiscreteUpdate(self._context)
            self._state = _plant_state(after)
            self._context.SetDiscreteState(self._state)

    def _apply_forces(self) -> None:
        forces = [
            self._force(name, self._centres[name], wrench)
            for name, wrench in self._wrenches.items()
        ]
        for spring in self._tethers:
            body = spring.tether.body
            frequency_per_s = self._tether_rate / self._step_s
            pull = spring.pull_n(self._free_state(body), frequency_per_s)
            if pull is not None:
                wrench = np.concatenate([pull, np.zeros(3)])
                forces.append(self._force(body, np.zeros(3), wrench))
        self._forces.FixValue(self._plant_context, forces)

    def _force(self, name: str, place_m: FloatArray, wrench: FloatArray) -> Any:
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._model.bodies[name].index()
        force.p_BoBq_B = place_m
        force.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
        return force

    def moving_states(self, names: Sequence[str]) -> list[FloatArray]:
        """Return poses and velocities of dynamic and driven bodies in Drake, rows of shape [13]."""
        return [
            self._free_state(name) if name in self._rows else self._hinged_state(name)
            for name in names
        ]

    def _free_state(self, name: str) -> FloatArray:
        position, velocity = self._rows[name]
        quaternion, place = np.split(self._state[position : position + 7], [4])
        angular, linear = np.split(self._state[velocity : velocity + 6], 2)
        return np.concatenate(
            [place, quaternion / np.linalg.norm(quaternion), linear, angular]
        )

    def _hinged_state(self, name: str) -> FloatArray:
        body = self._model.bodies[name]
        pose = self._model.plant.EvalBodyPoseInWorld(self._plant_context, body)
        velocity = self._model.plant.EvalBodySpatialVelocityInWorld(
            self._plant_context, body
        )
        quaternion = pose.rotation().ToQuaternion().wxyz()
        return np.concatenate(
            [
                pose.translation(),
                quaternion,
                velocity.translational(),
                velocity.rotational(),
            ]
        )

    def contact_forces(
        self, pairs: Sequence[tuple[str, str]]
    ) -> Callable[[], FloatArray]:
        """Return a reader of contact forces; see `World.contact_forces`."""
        reader = MeanForces(pairs, self._touches)
        self._force_readers.append(reader)
        return reader.mean

    def _touches(self) -> Iterator[tuple[str, str, FloatArray]]:
        """Yield the contacts of the next step: two bodies, and the force on the first [N]."""
        names, plant = self._model.names, self._model.plant
        results = plant.get_contact_results_output_port().Eval(self._plant_context)
        for index in range(results.num_point_pair_contacts()):
            point = results.point_pair_contact_info(index)
            ends = point.point_pair()
            on_first_n = -np.array(point.contact_force())
            yield names[ends.id_A], names[ends.id_B], on_first_n
        for index in range(results.num_hydroelastic_contacts()):
            patch = results.hydroelastic_contact_info(index)
            surface = patch.contact_surface()
            on_first_n = np.array(patch.F_Ac_W().translational())
            yield names[surface.id_M()], names[surface.id_N()], on_first_n

    def state(self) -> Any:
        """Return the plant's state, driven motions, states of placed bodies and applied wrenches."""
        return (
            self._state.copy(),
            dict(self._motions),
            dict(self.placed),
            dict(self._wrenches),
        )

    def restore(self, state: Any) -> None:
        """Restore a state."""
        values, motions, placed, wrenches = state
        self._state = values.copy()
        self._motions, self.placed, self._wrenches = (
            dict(motions),
            dict(placed),
            dict(wrenches),
        )
        self._load()

    def close(self) -> None:
        """Do nothing, since the simulation only holds memory."""


def _plant_state(values: Any) -> FloatArray:
    """Return a copy of the state of the plant among discrete values, of which Drake's diagram may have more groups."""
    return np.array(values.value(0) if values.num_groups() > 1 else values.value())
