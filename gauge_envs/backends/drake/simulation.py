"""A scene in Drake, advanced step by step."""

import logging
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator

from gauge_envs.backends.drake.model import build_model
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.backends.shared.rigid import (
    MeanForces,
    SingleWorldSimulation,
    TetherSpring,
    hinge_angle,
    later_targets,
    motion_steps,
)
from gauge_envs.backends.simulation import ContactForces
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.states import nominal_states

POSE_ORDER = np.array([4, 5, 6, 0, 1, 2, 3])
"""Places of x, y, z and the quaternion w, x, y, z in the positions of a free body; Drake has the quaternion first."""

VELOCITY_ORDER = np.array([3, 4, 5, 0, 1, 2])
"""Places of the linear and the angular velocity in the velocities of a free body."""

# Drake warns about half-spaces, which deformable bodies cannot touch. Its import resets the level.
logging.getLogger("drake").setLevel(logging.ERROR)


class SimulationDrake(SingleWorldSimulation):
    """A scene in Drake's discrete multibody plant."""

    def __init__(self, scene: Scene, settings: SettingsDrake) -> None:
        super().__init__(scene, settings)
        self._tether_rate_per_s = settings.tether_rate / settings.timestep_s
        self._model = build_model(scene, settings)
        plant = self._model.plant
        self._context = self._model.diagram.CreateDefaultContext()
        self._simulator = Simulator(self._model.diagram, self._context)
        self._plant_context = plant.GetMyMutableContextFromRoot(self._context)
        self._forces = plant.get_applied_spatial_force_input_port()
        self._tethers = TetherSpring.of(scene)
        self._force_readers: list[MeanForces] = []
        # Positions, then velocities.
        self._state = np.zeros(plant.num_multibody_states())
        # Indices of each body in the state; a hinged body has the angle and its rate.
        self._places: dict[str, Any] = {}
        for name in self._model.bodies:
            joint = plant.GetJointByName(name)
            position = joint.position_start()
            velocity = plant.num_positions() + joint.velocity_start()
            self._places[name] = [position, velocity]
            if name not in scene.hinges:
                places = position + POSE_ORDER, velocity + VELOCITY_ORDER
                self._places[name] = np.hstack(places)
        self.reset()

    def start(self, states: FloatArray | None) -> None:
        """Write the initial states to the plant, which has no other memory."""
        if states is None:
            states = nominal_states(self.scene)
        for body, state in zip(self.scene.bodies, states, strict=False):
            hinge = self.scene.hinges.get(body.name)
            if hinge is not None:
                turned = hinge_angle(hinge, body.pose, state), state[10:] @ hinge.axis
                self._state[self._places[body.name]] = turned
            elif body.motion is Motion.KINEMATIC:
                self.drive(body.name, np.append(state, np.zeros(6))[None])
            elif body.motion is Motion.DYNAMIC:
                self._state[self._places[body.name]] = state
        self._context.SetDiscreteState(self._state)
        self._apply_forces()

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe a kinematic body; each step starts at its pose with the mean velocity of the step."""
        super().drive(body, targets)
        self._state[self._places[body]] = targets[0, :13]

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force through the centre of mass [N] and a torque [N m] to a dynamic body."""
        super().apply_wrench(body, wrenches)
        self._apply_forces()

    def advance(self, seconds: float) -> None:
        """Step the plant. Driven bodies rest at the end of the interval until they are driven again."""
        count = round(seconds / self.step_s)
        for reader in self._force_readers:
            reader.clear()
        if self.motions or self._tethers or self._force_readers:
            self._advance_in_steps(count)
        else:
            # One call costs half as much as single steps, and gives the same bits.
            self._context.SetTime(0.0)
            self._simulator.Initialize()
            self._simulator.AdvanceTo(count * self.step_s)
            self._state = self._context.get_discrete_state().value(0).copy()
        for name, motion in self.motions.items():
            pose = later_targets(motion[None], seconds)[0, :7]
            self.motions[name] = np.append(pose, np.zeros(12))

    def _advance_in_steps(self, count: int) -> None:
        """Take single steps; before each, place driven bodies and apply the pulls of strings."""
        paths = {
            name: np.hstack(motion_steps(motion, self.step_s, count))
            for name, motion in self.motions.items()
        }
        for step in range(count):
            for name, states in paths.items():
                self._state[self._places[name]] = states[step]
            if paths:
                self._context.SetDiscreteState(self._state)
            if self._tethers:
                self._apply_forces()
            # The contact results belong to the step that is taken next.
            for reader in self._force_readers:
                reader.add()
            after = self._model.diagram.EvalUniquePeriodicDiscreteUpdate(self._context)
            self._state = after.value(0).copy()
            self._context.SetDiscreteState(self._state)

    def _apply_forces(self) -> None:
        """Give the plant the wrenches and the current pulls of strings."""
        forces = [
            self._force(name, self._model.bodies[name].default_com(), wrench)
            for name, wrench in self.wrenches.items()
        ]
        for spring in self._tethers:
            body = spring.tether.body
            pull_n = spring.pull_n(self._free_state(body), self._tether_rate_per_s)
            if pull_n is not None:
                wrench = np.append(pull_n, np.zeros(3))
                forces.append(self._force(body, np.zeros(3), wrench))
        self._forces.FixValue(self._plant_context, forces)

    def _force(self, name: str, place_m: FloatArray, wrench: FloatArray) -> Any:
        """Return a force [N] at a point in the frame of a body, and a torque [N m], in Drake's type."""
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._model.bodies[name].index()
        force.p_BoBq_B = place_m
        force.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
        return force

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of dynamic and driven bodies, shape [1, len(names), 13]."""
        states = [
            self._hinged_state(name)
            if name in self.scene.hinges
            else self._free_state(name)
            for name in names
        ]
        return np.array([states])

    def _free_state(self, name: str) -> FloatArray:
        state = self._state[self._places[name]]
        state[3:7] /= np.linalg.norm(state[3:7])
        return state

    def _hinged_state(self, name: str) -> FloatArray:
        body = self._model.bodies[name]
        pose = body.EvalPoseInWorld(self._plant_context)
        velocity = body.EvalSpatialVelocityInWorld(self._plant_context)
        quaternion = pose.rotation().ToQuaternion().wxyz()
        linear, angular = velocity.translational(), velocity.rotational()
        return np.concatenate([pose.translation(), quaternion, linear, angular])

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces:
        """Return a reader of contact forces; see `Simulation.contact_forces`."""
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

    def close(self) -> None:
        """Do nothing, since the simulation only holds memory."""
