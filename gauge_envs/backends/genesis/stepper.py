"""The environments of a Genesis scene: driven bodies, forces, steps and states of the rigid solver."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.model import Model, start_coordinates
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.genesis.tethers import pull
from gauge_envs.backends.shared.driven_motion import DrivenMotion
from gauge_envs.errors import BackendError
from gauge_envs.scene import Motion, Pose, Scene, Tether


class Stepper:
    """Instances of a scene in one Genesis scene, which advance together.

    Args:
        scenes: The instances; they differ in start poses and velocities only.
        settings: Numerical settings.
        model: The Genesis scene.
    """

    def __init__(self, scenes: Sequence[Scene], settings: SettingsGenesis, model: Model) -> None:
        self._model = model
        self._settings = settings
        self._gravity = scenes[0].gravity_m_per_s2
        starts = [start_coordinates(scene, model) for scene in scenes]
        self._coordinates = np.array([coordinates for coordinates, _ in starts])
        self._velocities = np.array([velocities for _, velocities in starts])
        self._still = [
            {
                body.name: np.array([*body.pose.position_m, *body.pose.quaternion, *np.zeros(6)])
                for body in scene.bodies
                if body.motion is not Motion.DYNAMIC
            }
            for scene in scenes
        ]
        self._starts = [
            {
                b.name: DrivenMotion(b.pose, np.zeros(6), np.zeros(6))
                for b in scene.bodies
                if b.motion is Motion.KINEMATIC
            }
            for scene in scenes
        ]
        self._tethers = [[joint for joint in scene.joints if isinstance(joint, Tether)] for scene in scenes]
        self._masses = {body.name: body.mass_kg for body in scenes[0].bodies}
        self._inertias = {
            b.name: settings.kinematic_mass_kg * float(np.linalg.norm(b.shape.corners_m, axis=1).max()) ** 2
            for b in scenes[0].bodies
            if b.motion is Motion.KINEMATIC
        }

    def reset(self) -> None:
        """Return all instances to their starts."""
        solver = self._model.solver
        self._driven = [dict(motions) for motions in self._starts]
        self._given = [dict(states) for states in self._still]
        self._wrenches: list[dict[str, NDArray[np.float64]]] = [{} for _ in self._still]
        if self._model.fresh is not None:
            solver.__setstate__(self._model.fresh)
            if self._model.places:
                solver.set_qpos(self._coordinates)
                solver.set_dofs_velocity(self._velocities)
        for world, motions in enumerate(self._driven):
            for name, motion in motions.items():
                self._prescribe(world, name, motion)
        for part in self._model.parts:
            part.reset()

    def drive(
        self, world: int, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]
    ) -> None:
        """Put a driven body where its interval starts, and give it the force that accelerates it."""
        motion = DrivenMotion(pose, np.array(velocity, dtype=float), np.array(acceleration, dtype=float))
        self._driven[world][body] = motion
        self._given[world][body] = np.array([*pose.position_m, *pose.quaternion, *velocity])
        self._prescribe(world, body, motion)

    def _prescribe(self, world: int, name: str, motion: DrivenMotion) -> None:
        place, solver = self._model.places[name], self._model.solver
        # Genesis moves a body by its new velocity times the step: half a step earlier, the mean is exact.
        twist = motion.velocity - 0.5 * motion.acceleration * self._settings.timestep_s
        to_body = motion.start.rotation.inv()
        mass = self._settings.kinematic_mass_kg
        force = mass * (motion.acceleration[:3] + np.array([0.0, 0.0, self._gravity]))
        # The inertia is that of a sphere, so the torque has the direction of the acceleration.
        torque = self._inertias[name] * to_body.apply(motion.acceleration[3:])
        coordinates = range(place.coordinates, place.coordinates + 7)
        freedoms = range(place.freedoms, place.freedoms + 6)
        solver.set_qpos(
            np.array([[*motion.start.position_m, *motion.start.quaternion]]), coordinates, [world], skip_forward=True
        )
        solver.set_dofs_velocity(np.array([[*twist[:3], *to_body.apply(twist[3:])]]), freedoms, [world])
        solver.control_dofs_force(np.array([[*force, *torque]]), freedoms, [world])

    def apply_wrench(self, world: int, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a body from now on."""
        self._wrenches[world][body] = np.array(wrench, dtype=float)

    def advance(self, seconds: float) -> None:
        """Step the scene, and leave driven bodies at the end of their interval."""
        step_s = self._settings.timestep_s
        for step in range(round(seconds / step_s)):
            self._apply_forces()
            for part in self._model.parts:
                part.prescribe(self._driven[0], step * step_s, step_s)
            self._step()
        for world, motions in enumerate(self._driven):
            for name, motion in motions.items():
                pose = motion.pose(seconds)
                velocity = motion.velocity_at(seconds)
                self._given[world][name] = np.array([*pose.position_m, *pose.quaternion, *velocity])

    def _step(self) -> None:
        """Make one step."""
        try:
            self._model.scene.sim.step()
        except engine().GenesisException as error:
            raise BackendError(f"Genesis stopped: {error}") from error

    def _apply_forces(self) -> None:
        """Apply wrenches and the pulls of strings during the next step; Genesis forgets them after it."""
        gs, solver = engine(), self._model.solver
        for world, wrenches in enumerate(self._wrenches):
            for name, wrench in wrenches.items():
                solver.apply_links_external_wrench(
                    wrench[None, None, :3],
                    wrench[None, None, 3:],
                    [self._model.places[name].link],
                    [world],
                    ref=gs.link_ref_frame.link_COM,
                )
        for world, tethers in enumerate(self._tethers):
            for tether in tethers:
                state = self.body_states(world, [tether.body])[0]
                frequency = self._settings.tether_rate / self._settings.timestep_s
                force = pull(tether, state, self._masses[tether.body], frequency)
                if force is not None:
                    solver.apply_links_external_wrench(
                        force[None, None, :], None, [self._model.places[tether.body].link], [world]
                    )

    def body_states(self, world: int, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities of bodies of an instance, shape [len(names), 13]; see `World.body_states`."""
        states = np.empty((len(names), 13))
        moving = [
            (row, self._model.places[name].link) for row, name in enumerate(names) if name not in self._given[world]
        ]
        for row, name in enumerate(names):
            if name in self._given[world]:
                states[row] = self._given[world][name]
        if moving:
            rows, links = map(list, zip(*moving, strict=True))
            solver = self._model.solver
            columns = [
                solver.get_links_pos(links, [world]),
                solver.get_links_quat(links, [world]),
                solver.get_links_vel(links, [world]),
                solver.get_links_ang(links, [world]),
            ]
            values = np.concatenate([column.numpy()[0] for column in columns], axis=-1).astype(np.float64)
            values[:, 3:7] /= np.linalg.norm(values[:, 3:7], axis=1, keepdims=True)
            states[rows] = values
        return states

    def state(self) -> Any:
        """Return the rigid solver's arrays, the motions of driven bodies and the wrenches."""
        solver = self._model.solver
        arrays = None if self._model.fresh is None else solver.__getstate__()
        return copy.deepcopy((arrays, self._driven, self._given, self._wrenches))

    def restore(self, state: Any) -> None:
        """Restore a state."""
        arrays, self._driven, self._given, self._wrenches = copy.deepcopy(state)
        if arrays is not None:
            self._model.solver.__setstate__(arrays)
