"""Genesis simulations and batched worlds: driving, forces, stepping and reading."""

import copy
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from gauge_envs.backends.genesis.document import reach_m
from gauge_envs.backends.genesis.engine import engine
from gauge_envs.backends.genesis.model import (
    Model,
    borrow_model,
    return_model,
    start_coordinates,
)
from gauge_envs.backends.genesis.parts import DeformablePart
from gauge_envs.backends.genesis.settings import SettingsGenesis
from gauge_envs.backends.shared.rigid import (
    DrivenMotion,
    PlacedWorld,
    TetherSpring,
    body_state,
    placed_states,
)
from gauge_envs.backends.shared.states import Snapshot, StateOrigin
from gauge_envs.backends.world import Simulation
from gauge_envs.backends.worlds import Worlds
from gauge_envs.errors import BackendError
from gauge_envs.scene import Motion, Pose, Scene
from gauge_envs.scene.geometry import FloatArray


class _Lent:
    """A model while it is in use.

    Args:
        scenes: The instances of a scene in the model.
        settings: Numerical settings.
    """

    def __init__(self, scenes: Sequence[Scene], settings: SettingsGenesis) -> None:
        self.settings = settings
        self._model: Model | None = borrow_model(scenes[0], settings, len(scenes))

    @property
    def model(self) -> Model:
        """The model, until it is returned."""
        if self._model is None:
            raise BackendError("the Genesis simulation is closed: build another one")
        return self._model

    def close(self) -> None:
        """Free the model, or keep it for the next simulation of the same bodies."""
        if self._model is not None:
            return_model(self._model)
            self._model = None


class _WorldGenesis(PlacedWorld):
    """One environment of a Genesis scene.

    Args:
        scene: The instance.
        lent: The Genesis scene.
        index: Number of the environment.
    """

    def __init__(self, scene: Scene, lent: _Lent, index: int) -> None:
        self.settings = lent.settings.model_dump(mode="json")
        self._scene, self._lent, self._index = scene, lent, index
        self.start = start_coordinates(scene, lent.model)
        self._tethers = TetherSpring.of(scene)

    def begin(self) -> None:
        """Put driven bodies to their starts, without wrenches."""
        self.driven: dict[str, DrivenMotion] = {}
        self.wrenches: dict[str, FloatArray] = {}
        self.placed = placed_states(self._scene, Motion.FIXED, Motion.KINEMATIC)
        for body in self._scene.bodies:
            if body.motion is Motion.KINEMATIC:
                self.driven[body.name] = DrivenMotion(body.pose)
                self._prescribe(body.name)

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Put a driven body where its interval starts, and give it the force that accelerates it."""
        self.driven[body] = DrivenMotion.copied(pose, velocity, acceleration)
        self.placed[body] = body_state(pose, velocity)
        self._prescribe(body)

    def _prescribe(self, name: str) -> None:
        motion, solver, settings = (
            self.driven[name],
            self._lent.model.solver,
            self._lent.settings,
        )
        link = self._lent.model.links[name]
        # Genesis moves a body by its new velocity times the step: half a step earlier, the mean is exact.
        twist = motion.velocity - 0.5 * motion.acceleration * settings.timestep_s
        to_body = motion.start.rotation.inv()
        mass = settings.kinematic_mass_kg
        force = mass * (
            motion.acceleration[:3] + np.array([0.0, 0.0, self._scene.gravity_m_per_s2])
        )
        # The inertia is that of a sphere, so the torque has the direction of the acceleration.
        torque = (
            mass
            * reach_m(self._scene.body(name)) ** 2
            * to_body.apply(motion.acceleration[3:])
        )
        coordinates = range(link.q_start, link.q_start + 7)
        freedoms = range(link.dof_start, link.dof_start + 6)
        world = [self._index]
        solver.set_qpos(
            np.array([[*motion.start.position_m, *motion.start.quaternion]]),
            coordinates,
            world,
            skip_forward=True,
        )
        solver.set_dofs_velocity(
            np.array([[*twist[:3], *to_body.apply(twist[3:])]]), freedoms, world
        )
        solver.control_dofs_force(np.array([[*force, *torque]]), freedoms, world)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        self.wrenches[body] = np.array(wrench, dtype=float)

    def apply_forces(self) -> None:
        """Apply wrenches and the pulls of strings during the next step; Genesis forgets them after it."""
        solver, links, world = (
            self._lent.model.solver,
            self._lent.model.links,
            [self._index],
        )
        frequency = self._lent.settings.tether_rate / self._lent.settings.timestep_s
        for name, wrench in self.wrenches.items():
            solver.apply_links_external_wrench(
                wrench[None, None, :3],
                wrench[None, None, 3:],
                [links[name].idx],
                world,
                ref=engine().link_ref_frame.link_COM,
            )
        for spring in self._tethers:
            body = spring.tether.body
            force = spring.pull_n(self.body_states([body])[0], frequency)
            if force is not None:
                solver.apply_links_external_wrench(
                    force[None, None, :], None, [links[body].idx], world
                )

    def moving_states(self, names: Sequence[str]) -> FloatArray:
        """Return poses and velocities of dynamic bodies, shape [len(names), 13]."""
        solver, links = (
            self._lent.model.solver,
            [self._lent.model.links[name].idx for name in names],
        )
        read = (
            solver.get_links_pos,
            solver.get_links_quat,
            solver.get_links_vel,
            solver.get_links_ang,
        )
        columns = [one(links, [self._index]).numpy()[0] for one in read]
        states: FloatArray = np.concatenate(columns, axis=-1).astype(np.float64)
        states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
        return states


def _reset(lent: _Lent, worlds: Sequence[_WorldGenesis]) -> None:
    """Return all environments of a model to their starts."""
    model = lent.model
    if model.fresh is not None:
        model.solver.__setstate__(model.fresh)
        if model.links:
            model.solver.set_qpos(np.array([world.start[0] for world in worlds]))
            model.solver.set_dofs_velocity(
                np.array([world.start[1] for world in worlds])
            )
    for world in worlds:
        world.begin()
    if model.part is not None:
        model.part.reset()


def _advance(lent: _Lent, worlds: Sequence[_WorldGenesis], seconds: float) -> None:
    """Step the environments of a model, and leave driven bodies at the end of their interval."""
    model, step_s = lent.model, lent.settings.timestep_s
    for step in range(round(seconds / step_s)):
        for world in worlds:
            world.apply_forces()
        if model.part is not None:
            model.part.prescribe(worlds[0].driven, step * step_s, step_s)
        try:
            model.scene.sim.step()
        except engine().GenesisException as error:
            raise BackendError(f"Genesis stopped: {error}") from error
    for world in worlds:
        world.placed |= {
            name: motion.state_at(seconds) for name, motion in world.driven.items()
        }


class SimulationGenesis(_WorldGenesis, Simulation):
    """A scene in Genesis."""

    def __init__(self, scene: Scene, settings: SettingsGenesis) -> None:
        super().__init__(scene, _Lent([scene], settings), 0)
        self._origin = StateOrigin(
            f"genesis {version('genesis-world')}", self.settings, scene
        )
        self.reset(0)

    def _part(self, name: str) -> DeformablePart:
        part = self._lent.model.part
        if part is None or name not in part.names:
            raise KeyError(name)
        return part

    def reset(self, seed: int) -> None:
        """Return to the scene's start. Genesis draws no random numbers here, so the seed has no effect."""
        _reset(self._lent, [self])

    def advance(self, seconds: float) -> None:
        """Step the scene."""
        _advance(self._lent, [self], seconds)

    def fault(self) -> str | None:
        """Return why Genesis gave up the state, or None."""
        part = self._lent.model.part
        return None if part is None else part.fault()

    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a deformable body's nodes [m], shape [node_count, 3]."""
        return self._part(name).nodes(name)

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Return a reader of material points; see `World.track`."""
        return self._part(name).track(name, points_m)

    def state(self) -> Snapshot:
        """Return every array that a step reads, with its origin."""
        model = self._lent.model
        rigid = None if model.fresh is None else model.solver.__getstate__()
        inputs = (self.driven, self.placed, self.wrenches)
        return self._origin.state(
            (
                *copy.deepcopy((rigid, inputs)),
                model.part.state() if model.part else None,
            )
        )

    def restore(self, state: Snapshot) -> None:
        """Restore a state."""
        model = self._lent.model
        values: tuple[Any, ...] = self._origin.values(state)
        rigid, inputs = copy.deepcopy(values[:2])
        self.driven, self.placed, self.wrenches = inputs
        if rigid is not None:
            model.solver.__setstate__(rigid)
        if model.part is not None:
            model.part.restore(values[2])

    def close(self) -> None:
        """Free the scene, or keep it for the next simulation of the same bodies."""
        self._lent.close()


class WorldsGenesis(Worlds):
    """Instances of a rigid scene as environments of one Genesis scene.

    Args:
        scenes: The instances.
        settings: Numerical settings.
    """

    def __init__(self, scenes: Sequence[Scene], settings: SettingsGenesis) -> None:
        self._lent = _Lent(scenes, settings)
        self.worlds: Sequence[_WorldGenesis] = [
            _WorldGenesis(scene, self._lent, index)
            for index, scene in enumerate(scenes)
        ]
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Return all environments to their starts. Genesis draws no random numbers here, so the seed has no effect."""
        _reset(self._lent, self.worlds)

    def advance(self, seconds: float) -> None:
        """Step the Genesis scene, which contains all environments."""
        _advance(self._lent, self.worlds, seconds)

    def close(self) -> None:
        """Free the scene, or keep it for the next worlds of the same bodies."""
        self._lent.close()
