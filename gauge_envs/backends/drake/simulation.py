"""A scene in Drake, advanced step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce

from gauge_envs.backends.base import Simulation
from gauge_envs.backends.drake.model import build_model
from gauge_envs.backends.drake.settings import SettingsDrake
from gauge_envs.backends.shared.driven_motion import DrivenMotion
from gauge_envs.scene import Hinge, Motion, Pose, Scene, Tether
from gauge_envs.scene.hinged import parent_hinges
from gauge_envs.scene.meshes import body_mass_properties


class SimulationDrake(Simulation):
    """A scene in Drake's discrete multibody plant."""

    def __init__(self, scene: Scene, settings: SettingsDrake) -> None:
        self.settings = settings.model_dump(mode="json")
        self._scene = scene
        self._step_s = settings.timestep_s
        self._tether_rate = settings.tether_rate
        model = build_model(scene, settings)
        self._diagram, self._plant, self._bodies = model.diagram, model.plant, model.bodies
        self._start = model.start
        self._context = self._diagram.CreateDefaultContext()
        self._plant_context = self._plant.GetMyMutableContextFromRoot(self._context)
        self._forces = self._plant.get_applied_spatial_force_input_port()
        self._hinged = {joint.body for joint in scene.joints if isinstance(joint, Hinge)}
        self._hinged |= parent_hinges(scene.body_hinges).keys()
        self._tethers = [joint for joint in scene.joints if isinstance(joint, Tether)]
        self._rows = {
            name: (body.floating_positions_start(), self._plant.num_positions() + body.floating_velocities_start_in_v())
            for name, body in self._bodies.items()
            if name not in self._hinged
        }
        self._fixed = {
            body.name: np.array([*body.pose.position_m, *body.pose.quaternion, *np.zeros(6)])
            for body in scene.bodies
            if body.motion is Motion.FIXED
        }
        self._driven = [body.name for body in scene.bodies if body.motion is Motion.KINEMATIC]
        self._centres = {body.name: body_mass_properties(body)[0] for body in scene.dynamic_bodies}
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Return to the scene's start. Drake draws no random numbers here, so the seed has no effect."""
        self._state = self._start.copy()
        self._motions = {
            name: DrivenMotion(self._scene.body(name).pose, np.zeros(6), np.zeros(6)) for name in self._driven
        }
        self._velocities = {name: np.zeros(6) for name in self._driven}
        self._wrenches: dict[str, NDArray[np.float64]] = {}
        self._load()

    def _load(self) -> None:
        self._context.SetDiscreteState(self._state)
        self._apply_forces()

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Prescribe a kinematic body; see `World.drive`."""
        self._motions[body] = DrivenMotion(pose, np.array(velocity, dtype=float), np.array(acceleration, dtype=float))
        first, _ = self._rows[body]
        self._state[first : first + 7] = [*pose.quaternion, *pose.position_m]
        self._velocities[body] = np.array(velocity, dtype=float)
        self._context.SetDiscreteState(self._state)

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force through the centre of mass and a torque; see `World.apply_wrench`."""
        self._wrenches[body] = np.array(wrench, dtype=float)
        self._apply_forces()

    def advance(self, seconds: float) -> None:
        """Step the plant; driven bodies start each step at their pose, with their mean velocity in the step."""
        for step in range(round(seconds / self._step_s)):
            if self._driven:
                self._place_driven(step)
            if self._tethers:
                self._apply_forces()
            values = self._diagram.EvalUniquePeriodicDiscreteUpdate(self._context)
            self._state = np.array(values.value(0) if values.num_groups() > 1 else values.value())
            self._context.SetDiscreteState(self._state)
        if self._driven:
            self._end_interval(seconds)

    def _place_driven(self, step: int) -> None:
        start, end = step * self._step_s, (step + 1) * self._step_s
        for name, motion in self._motions.items():
            position, velocity = self._rows[name]
            pose, mean = motion.pose(start), motion.mean_velocity(start, end)
            self._state[position : position + 7] = [*pose.quaternion, *pose.position_m]
            self._state[velocity : velocity + 6] = [*mean[3:], *mean[:3]]
        self._context.SetDiscreteState(self._state)

    def _end_interval(self, seconds: float) -> None:
        """Put driven bodies at the end of their interval; they rest there until they are driven again."""
        for name, motion in self._motions.items():
            position, _ = self._rows[name]
            pose = motion.pose(seconds)
            self._state[position : position + 7] = [*pose.quaternion, *pose.position_m]
            self._velocities[name] = motion.velocity_at(seconds)
            self._motions[name] = DrivenMotion(pose, np.zeros(6), np.zeros(6))
        self._context.SetDiscreteState(self._state)

    def _apply_forces(self) -> None:
        forces = [self._force(name, self._centres[name], wrench) for name, wrench in self._wrenches.items()]
        forces += [force for tether in self._tethers if (force := self._pull(tether)) is not None]
        self._forces.FixValue(self._plant_context, forces)

    def _force(self, name: str, place_m: NDArray[np.float64], wrench: NDArray[np.float64]) -> Any:
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._bodies[name].index()
        force.p_BoBq_B = place_m
        force.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
        return force

    def _pull(self, tether: Tether) -> Any:
        """Return the force of a taut string, a stiff spring with critical damping that only pulls, or None."""
        position, velocity = self._rows[tether.body]
        arm = np.asarray(tether.anchor_m) - self._state[position + 4 : position + 7]
        length = float(np.linalg.norm(arm))
        if length <= tether.length_m:
            return None
        along = arm / length
        lengthening = -float(along @ self._state[velocity + 3 : velocity + 6])
        frequency = self._tether_rate / self._step_s
        mass = self._scene.body(tether.body).mass_kg
        size = mass * (frequency**2 * (length - tether.length_m) + 2.0 * frequency * lengthening)
        if size <= 0.0:
            return None
        return self._force(tether.body, np.zeros(3), np.concatenate([size * along, np.zeros(3)]))

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities, shape [len(names), 13]; see `World.body_states`."""
        states = np.empty((len(names), 13))
        for row, name in zip(states, names, strict=True):
            if name in self._fixed:
                row[:] = self._fixed[name]
                continue
            if name in self._hinged:
                row[:] = self._hinged_state(name)
                continue
            position, velocity = self._rows[name]
            quaternion = self._state[position : position + 4]
            row[:3] = self._state[position + 4 : position + 7]
            row[3:7] = quaternion / np.linalg.norm(quaternion)
            if name in self._velocities:
                row[7:] = self._velocities[name]
            else:
                row[7:10] = self._state[velocity + 3 : velocity + 6]
                row[10:] = self._state[velocity : velocity + 3]
        return states

    def _hinged_state(self, name: str) -> NDArray[np.float64]:
        body = self._bodies[name]
        pose = self._plant.EvalBodyPoseInWorld(self._plant_context, body)
        velocity = self._plant.EvalBodySpatialVelocityInWorld(self._plant_context, body)
        quaternion = pose.rotation().ToQuaternion().wxyz()
        return np.concatenate([pose.translation(), quaternion, velocity.translational(), velocity.rotational()])

    def state(self) -> Any:
        """Return the plant's state, the driven motions and the applied wrenches."""
        return (
            self._state.copy(),
            dict(self._motions),
            {name: velocity.copy() for name, velocity in self._velocities.items()},
            {name: wrench.copy() for name, wrench in self._wrenches.items()},
        )

    def restore(self, state: Any) -> None:
        """Restore a state."""
        values, motions, velocities, wrenches = state
        self._state = values.copy()
        self._motions = dict(motions)
        self._velocities = {name: velocity.copy() for name, velocity in velocities.items()}
        self._wrenches = {name: wrench.copy() for name, wrench in wrenches.items()}
        self._load()

    def close(self) -> None:
        """Do nothing, since the simulation only holds memory."""
