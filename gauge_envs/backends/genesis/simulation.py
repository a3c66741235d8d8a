"""Worlds of a scene in Genesis: driving, forces, stepping and reading."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gauge_envs.backends.genesis.cloth import ClothPart
from gauge_envs.backends.genesis.document import outer_radius_m
from gauge_envs.backends.genesis.engine import claim, engine, release
from gauge_envs.backends.genesis.foam import FEMPart, MPMPart
from gauge_envs.backends.genesis.model import build_model
from gauge_envs.backends.genesis.settings import (
    SettingsExplicitMPM,
    SettingsFEM,
    SettingsGenesis,
    SettingsPBD,
)
from gauge_envs.backends.shared.rigid import (
    PlacedSimulation,
    TetherSpring,
    hinge_angle,
    later_targets,
    placed_states,
)
from gauge_envs.backends.simulation import MaterialPoints
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.geometry import (
    BoolArray,
    FloatArray,
    rotation_matrices,
)
from gauge_envs.scene.states import nominal_states

PARTS: dict[type[SettingsGenesis], Any] = {
    SettingsPBD: ClothPart,
    SettingsFEM: FEMPart,
    SettingsExplicitMPM: MPMPart,
}
"""Deformable bodies of each solver, by its settings."""


class SimulationGenesis(PlacedSimulation):
    """Worlds of a scene as environments of one Genesis scene, which advance in the same step.

    Args:
        scene: The scene. With deformable bodies, it has one world.
        settings: Numerical settings.
        world_count: Number of worlds N.
    """

    def __init__(
        self, scene: Scene, settings: SettingsGenesis, world_count: int = 1
    ) -> None:
        self.settings = settings.model_dump(mode="json")
        self.world_count = world_count
        self._scene, self._options = scene, settings
        self._step_s = settings.timestep_s
        self._nominal = nominal_states(scene)
        self._tethers = TetherSpring.of(scene)
        claim(self, settings.precision)
        kind = PARTS.get(type(settings))
        self._part = kind(scene, settings) if kind else None
        self._model, self._links = build_model(scene, settings, world_count, self._part)
        self._solver = self._model.sim.rigid_solver
        self.reset()

    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start all worlds. Genesis draws no random numbers here, so the seed has no effect."""
        if starts is None:
            starts = np.tile(self._nominal, (self.world_count, 1, 1))
        self._model.reset()
        self._diverged: dict[int, str] = {}
        self._wrenches: dict[str, FloatArray] = {}
        self._driven: dict[str, FloatArray] = {}
        self.placed = placed_states(self._scene)
        if self._links:
            self._set_starts(starts)
        for row, body in enumerate(self._scene.bodies):
            if body.motion is Motion.KINEMATIC:
                no_acceleration = np.zeros((self.world_count, 6))
                self.drive(body.name, np.hstack([starts[:, row], no_acceleration]))
        if self._part is not None:
            self._part.reset(starts[0, len(self._scene.bodies) :])

    def _set_starts(self, starts: FloatArray) -> None:
        """Write initial states of moving bodies into the rigid solver."""
        coordinates = np.zeros((self.world_count, self._solver.n_qs))
        velocities = np.zeros((self.world_count, self._solver.n_dofs))
        hinges = self._scene.hinges
        for row, body in enumerate(self._scene.bodies):
            link, states = self._links.get(body.name), starts[:, row]
            if link is None:
                continue
            if body.name in hinges:
                hinge = hinges[body.name]
                coordinates[:, link.q_start] = [
                    hinge_angle(hinge, body.pose, state) for state in states
                ]
                velocities[:, link.dof_start] = states[:, 10:] @ hinge.axis
                continue
            coordinates[:, link.q_start : link.q_start + 7] = states[:, :7]
            velocities[:, link.dof_start : link.dof_start + 6] = _twists(
                states[:, 3:7], states[:, 7:]
            )
        self._solver.set_dofs_velocity(velocities, skip_forward=True)
        self._solver.set_qpos(coordinates)

    def drive(self, body: str, targets: FloatArray) -> None:
        """Move a driven body to the start of its interval, and apply the force that accelerates it."""
        self._driven[body] = targets = targets.copy()
        self.placed[body] = targets[:, :13]
        link, solver, settings = self._links[body], self._solver, self._options
        quaternions, acceleration = targets[:, 3:7], targets[:, 13:]
        # Genesis moves a body by its new velocity times the step: half a step earlier, the mean is exact.
        earlier = targets[:, 7:13] - 0.5 * acceleration * self._step_s
        weightless = acceleration.copy()
        weightless[:, 2] += self._scene.gravity_m_per_s2
        forces = settings.kinematic_mass_kg * _twists(quaternions, weightless)
        # The inertia is that of a sphere, so the torque has the direction of the acceleration.
        forces[:, 3:] *= outer_radius_m(self._scene.body(body)) ** 2
        freedoms = range(link.dof_start, link.dof_start + 6)
        solver.set_qpos(
            targets[:, :7], range(link.q_start, link.q_start + 7), skip_forward=True
        )
        solver.set_dofs_velocity(_twists(quaternions, earlier), freedoms)
        solver.control_dofs_force(forces, freedoms)

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `Simulation.apply_wrench`."""
        self._wrenches[body] = np.array(wrenches, dtype=np.float64)

    def advance(self, seconds: float) -> None:
        """Step all worlds; driven bodies stop at the end of their interval."""
        step_count = round(seconds / self._step_s)
        if self._part is not None:
            motions = {name: rows[0] for name, rows in self._driven.items()}
            steps = np.arange(step_count + 1, dtype=np.float64)
            self._part.plan(motions, self._step_s * steps)
        for step in range(step_count):
            self._apply_forces()
            if self._part is not None:
                self._part.hold(step)
            self._step()
        for name, targets in self._driven.items():
            self.placed[name] = later_targets(targets, seconds)[:, :13]

    def _apply_forces(self) -> None:
        """Apply wrenches and the pulls of strings during the next step; Genesis forgets them after it."""
        for name, wrenches in self._wrenches.items():
            self._solver.apply_links_external_wrench(
                wrenches[:, None, :3],
                wrenches[:, None, 3:],
                [self._links[name].idx],
                ref=engine().link_ref_frame.link_COM,
            )
        frequency = self._options.tether_rate / self._step_s
        for spring in self._tethers:
            body = spring.tether.body
            states = self.body_states([body])[:, 0]
            pulls = [spring.pull_n(state, frequency) for state in states]
            if any(pull is not None for pull in pulls):
                forces = [np.zeros(3) if pull is None else pull for pull in pulls]
                self._solver.apply_links_external_wrench(
                    np.array(forces)[:, None], None, [self._links[body].idx]
                )

    def _step(self) -> None:
        """Step all worlds. A world that Genesis stops is reset, so that the other worlds continue."""
        try:
            self._model.sim.step()
        except engine().GenesisException as error:
            worlds = np.flatnonzero(self._solver.get_error_envs_mask().numpy())
            if not worlds.size:
                raise
            for world in worlds.tolist():
                self._diverged.setdefault(world, f"Genesis stopped: {error}")
            self._model.reset(envs_idx=worlds)
            self._model.sim.step()

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities of dynamic bodies, shape [N, len(names), 13]."""
        solver, links = self._solver, [self._links[name].idx for name in names]
        columns = (
            solver.get_links_pos(links),
            solver.get_links_quat(links),
            solver.get_links_vel(links),
            solver.get_links_ang(links),
        )
        states = np.concatenate(
            [column.numpy() for column in columns], axis=-1, dtype=np.float64
        )
        states[..., 3:7] /= np.linalg.norm(states[..., 3:7], axis=-1, keepdims=True)
        return states

    def diverged(self) -> Mapping[int, str]:
        """Return the worlds that Genesis stopped, or whose material left its grid."""
        reason = self._part.diverged() if self._part is not None else None
        return {**self._diverged, **({0: reason} if reason else {})}

    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a deformable body's nodes [m], shape [1, node_count, 3]."""
        if self._part is None:
            raise KeyError(name)
        return self._part.nodes(name)[None]

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points; see `Simulation.track`."""
        return self._part.track(name, points_m) if self._part else None

    def close(self) -> None:
        """Free the Genesis scene."""
        if self._model is not None:
            self._model.destroy()
            self._model = self._solver = self._part = None
            release(self)


def _twists(quaternions: FloatArray, twists: FloatArray) -> FloatArray:
    """Return linear and angular parts for Genesis's free joints, the angular part in the body frame.

    Args:
        quaternions: Orientations of bodies, shape [N, 4].
        twists: Velocities, accelerations or alike in the world frame, shape [N, 6].

    Returns:
        Shape [N, 6].
    """
    in_body = np.einsum("nij,ni->nj", rotation_matrices(quaternions), twists[:, 3:])
    return np.hstack([twists[:, :3], in_body])
