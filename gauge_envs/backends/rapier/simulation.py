"""Simulations and batched worlds on top of Rapier worlds: driving, stepping and reading of states."""

import os
from collections.abc import Sequence
from importlib.metadata import version

import numpy as np
import rapier3d as rapier
from scipy.spatial.transform import Rotation

from gauge_envs.backends.rapier.contacts import (
    LARGEST_CONTACT_COUNT,
    colliding_contacts,
)
from gauge_envs.backends.rapier.model import (
    MASS_UNIT_KG,
    Layout,
    build_world,
    isometry,
)
from gauge_envs.backends.rapier.settings import SettingsRapier
from gauge_envs.backends.shared.rigid import DrivenMotion, PlacedWorld, placed_states
from gauge_envs.backends.shared.states import Snapshot, StateOrigin
from gauge_envs.backends.world import Simulation
from gauge_envs.backends.worlds import Worlds
from gauge_envs.scene import ConvexUnion, Pose, Scene
from gauge_envs.scene.geometry import FloatArray

LARGEST_SHARE = 64
"""Number of scenes without contacts in one Rapier world."""


CALLING_THREAD_BODIES = 16
"""Bodies up to which Rapier steps on the thread that calls it, whatever the number of threads of its pool.

A pool of one thread gives the same bits, and costs 13 us a step: more than the step of a pendulum.
"""

PROCESS = os.getpid()
"""The process that imported this module. One that is forked from it would wait for threads of a common pool."""


class _SceneWorld(PlacedWorld):
    """One scene in a Rapier world, which may hold more of them."""

    def __init__(self, scene: Scene, layout: Layout, settings: SettingsRapier) -> None:
        self.settings = settings.model_dump(mode="json")
        self.layout = layout
        self.placed = placed_states(scene)
        self._bodies: dict[str, rapier.RigidBody] = {}
        self.motions: dict[str, DrivenMotion] = {}

    def hold(
        self, world: rapier.PhysicsWorld, motions: dict[str, DrivenMotion]
    ) -> None:
        """Read and drive the bodies of a Rapier world from now on."""
        bodies = world.rigid_bodies
        self._bodies = {
            name: bodies[handle] for name, (handle, _) in self.layout.items()
        }
        self.motions = dict(motions)

    def release(self) -> None:
        """Hold no body any more."""
        self._bodies, self.motions = {}, {}

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Place a driven body where its interval starts; each step moves it by the mean velocity of the step."""
        self.motions[body] = DrivenMotion.copied(pose, velocity, acceleration)
        self._bodies[body].position = isometry(pose)
        self.set_velocity(body, velocity)

    def set_velocity(self, body: str, velocity: Sequence[float] | FloatArray) -> None:
        """Give a driven body a velocity, by which Rapier moves it in the next step."""
        rigid_body = self._bodies[body]
        rigid_body.linvel, rigid_body.angvel = tuple(velocity[:3]), tuple(velocity[3:])

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body; see `World.apply_wrench`."""
        rigid_body = self._bodies[body]
        rigid_body.reset_forces()
        rigid_body.reset_torques()
        rigid_body.add_force(tuple(wrench[:3] / MASS_UNIT_KG))
        rigid_body.add_torque(tuple(wrench[3:] / MASS_UNIT_KG))

    def fault(self) -> str | None:
        """Return why Rapier disabled a body since the last reset, or None; see `World.fault`."""
        for name, body in self._bodies.items():
            if not body.is_enabled:
                return f"Rapier found that the state of {name!r} is not finite, and disabled the body"
        return None

    def moving_states(self, names: Sequence[str]) -> list[FloatArray]:
        """Return poses and velocities in single precision, rows of shape [13]."""
        return [self._state(name) for name in names]

    def _state(self, name: str) -> FloatArray:
        body = self._bodies[name]
        position_m = body.translation.to_tuple()
        velocity = body.linvel.to_tuple()
        spin = body.angvel.to_tuple()
        x, y, z, w = body.rotation.quaternion
        state = np.array([*position_m, w, x, y, z, *velocity, *spin])
        _, centre_m = self.layout[name]
        if centre_m.any():
            # Rapier's velocity is that of the centre of mass.
            arm_m = body.rotation.transform_vector(tuple(centre_m)).to_tuple()
            state[7:10] -= np.cross(state[10:], arm_m)
        return state


def _mean_velocities(
    motion: DrivenMotion, seconds: float, step_count: int
) -> list[list[float]]:
    """Return the constant velocity in each step of an interval that takes a body along its motion.

    It is that of `DrivenMotion.steps`; about a fixed axis rotation vectors are subtracted.

    Returns:
        Linear [m/s] and angular [rad/s] velocity, shape [step_count, 6].
    """
    times_s = np.linspace(0.0, seconds, step_count + 1)[:, np.newaxis]
    travel = motion.travel(times_s)
    steps = np.diff(travel, axis=0)
    # Rotation vectors subtract if the axis stays the same.
    spin, spin_up = motion.velocity[3:], motion.acceleration[3:]
    if spin.any() and spin_up.any() and np.cross(spin, spin_up).any():
        turned = Rotation.from_rotvec(travel[:, 3:])
        steps[:, 3:] = (turned[1:] * turned[:-1].inv()).as_rotvec()
    return (steps * (step_count / seconds)).tolist()


def _restored(
    snapshot: bytes, threads: int, parts: Sequence[_SceneWorld]
) -> rapier.PhysicsWorld:
    """Return the world of a snapshot, which holds the bodies of some scenes."""
    world = rapier.PhysicsWorld.restore(snapshot)
    body_count = sum(len(part.layout) for part in parts)
    is_forked = os.getpid() != PROCESS
    if threads > 1 or body_count > CALLING_THREAD_BODIES or is_forked:
        world.set_num_threads(threads)
    return world


def _advance(
    world: rapier.PhysicsWorld,
    parts: Sequence[_SceneWorld],
    seconds: float,
    step_s: float,
) -> None:
    """Step a world; driven bodies have the mean velocity of each step, and that of the end of the interval after it."""
    count = round(seconds / step_s)
    driven = [
        (part, name, motion, _mean_velocities(motion, seconds, count))
        for part in parts
        for name, motion in part.motions.items()
    ]
    for index in range(count):
        for part, name, _, velocities in driven:
            part.set_velocity(name, velocities[index])
        world.step()
    for part, name, motion, _ in driven:
        part.set_velocity(name, motion.velocity_at(seconds))
        part.motions = {}


class SimulationRapier(_SceneWorld, Simulation):
    """A scene in Rapier."""

    def __init__(self, scene: Scene, settings: SettingsRapier) -> None:
        world, (layout,) = build_world([scene], settings)
        super().__init__(scene, layout, settings)
        self._timestep_s = settings.timestep_s
        self._threads = settings.threads
        self._origin = StateOrigin(
            f"rapier3d {version('rapier3d')}", self.settings, scene
        )
        self._start = world.snapshot()
        self._continue_from(self._start, {})

    def reset(self, seed: int) -> None:
        """Return to the scene's start. Rapier draws no random numbers, so the seed has no effect."""
        self._continue_from(self._start, {})

    def advance(self, seconds: float) -> None:
        """Step the world."""
        _advance(self._world, (self,), seconds, self._timestep_s)

    def state(self) -> Snapshot:
        """Return a snapshot of the world and the motions of driven bodies, with their origin."""
        return self._origin.state((self._world.snapshot(), dict(self.motions)))

    def restore(self, state: Snapshot) -> None:
        """Restore a state."""
        self._continue_from(*self._origin.values(state))

    def _continue_from(self, world: bytes, motions: dict[str, DrivenMotion]) -> None:
        self._world = _restored(world, self._threads, (self,))
        self.hold(self._world, motions)

    def close(self) -> None:
        """Free the world."""
        self.release()
        self._world = rapier.PhysicsWorld()


def _share_count(scene: Scene) -> int:
    """Return how many copies of a scene can share a world and move as alone, bit for bit.

    Rapier solves the contacts of multibody joints in the order of the whole world, so jointed bodies that collide are
    alone. It solves the contacts of one body in the order in which its tree of all colliders found the pairs, which
    other scenes change. So a body of several pieces, which touches with more than one of them at once, is alone too.
    """
    contacts = colliding_contacts(scene)
    if not contacts:
        return LARGEST_SHARE
    pairs = (pair for contact in contacts for pair in scene.colliding_pairs(contact))
    shapes = (scene.body(name).shape for pair in pairs for name in pair)
    in_pieces = any(
        isinstance(shape, ConvexUnion) and len(shape.pieces_m) > 1 for shape in shapes
    )
    return 1 if scene.joints or in_pieces else LARGEST_CONTACT_COUNT // len(contacts)


class WorldsRapier(Worlds):
    """Instances of a scene in Rapier worlds that they share, separated by collision groups.

    Args:
        scenes: Scenes that differ only in their starts.
        settings: Numerical settings.
    """

    def __init__(self, scenes: Sequence[Scene], settings: SettingsRapier) -> None:
        self._timestep_s, self._threads = settings.timestep_s, settings.threads
        size = _share_count(scenes[0])
        self._shares: list[tuple[bytes, list[_SceneWorld]]] = []
        for first in range(0, len(scenes), size):
            share = scenes[first : first + size]
            world, layouts = build_world(share, settings)
            parts = [
                _SceneWorld(scene, one, settings)
                for scene, one in zip(share, layouts, strict=True)
            ]
            self._shares.append((world.snapshot(), parts))
        self.worlds = [part for _, parts in self._shares for part in parts]
        self._worlds: list[rapier.PhysicsWorld] = []
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Return all worlds to their starts. Rapier draws no random numbers, so the seed has no effect."""
        self._worlds = []
        for start, parts in self._shares:
            self._worlds.append(_restored(start, self._threads, parts))
            for part in parts:
                part.hold(self._worlds[-1], {})

    def advance(self, seconds: float) -> None:
        """Step the worlds."""
        for world, (_, parts) in zip(self._worlds, self._shares, strict=True):
            _advance(world, parts, seconds, self._timestep_s)

    def close(self) -> None:
        """Free the worlds."""
        self._worlds, self._shares = [], []
        for part in self.worlds:
            assert isinstance(part, _SceneWorld)
            part.release()
