"""Several instances of a scene: each its own simulation, or all of them in arrays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from gauge_envs.backends.device import DeviceWorlds
from gauge_envs.backends.world import Simulation, World
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray


class Worlds(ABC):
    """Instances of a scene with different starts that advance together.

    Environments call the methods that take and return arrays of all worlds. Here they call each world in turn. An
    engine that holds its worlds in arrays derives from `ArrayWorlds`.

    Attributes:
        worlds: The instances, in the order of the scenes.
        are_separate: Whether environments drive, advance and read each world on its own, and not all of them at once.
    """

    worlds: Sequence[World]
    are_separate: ClassVar[bool] = False

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Return all worlds to their starts at time 0. The same seed gives the same trajectories."""

    def restart(self, number: int) -> None:
        """Return one world to its start at time 0; the others go on.

        Args:
            number: Number of the world.

        Raises:
            BackendError: The engine can return only all worlds at once.
        """
        world = self.worlds[number]
        if not isinstance(world, Simulation):
            raise BackendError(
                f"{type(self).__name__} returns to the start only all worlds at once: call reset"
            )
        world.reset(0)

    def start_at(self, scenes: Sequence[Scene]) -> bool:
        """Make the starts of other scenes those of the worlds, or return False; see `Simulation.start_at`."""
        return all(
            isinstance(world, Simulation) and world.start_at(scene)
            for world, scene in zip(self.worlds, scenes, strict=True)
        )

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval in all worlds, a multiple of 1/180 s."""

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the current poses and velocities of bodies in all worlds.

        An engine that holds all worlds in one array may override it; the values must be those of each world.

        Args:
            names: Names of rigid bodies.

        Returns:
            A new array, shape [world_count, len(names), 13]; see `World.body_states`.
        """
        return np.stack([world.body_states(names) for world in self.worlds])

    def body_positions(self, names: Sequence[str]) -> FloatArray:
        """Return the positions of body origins in all worlds [m], a new array of shape [world_count, len(names), 3].

        Args:
            names: Names of rigid bodies.
        """
        return self.body_states(names)[:, :, :3].copy()

    def drive(self, body: str, motions: FloatArray, numbers: IntArray) -> None:
        """Prescribe the motion of a kinematic body in some worlds during the next `advance`; see `World.drive`.

        Args:
            body: Name of a kinematic body.
            motions: Position [m] (3) and quaternion w x y z (4) at the start, linear [m/s] (3) and angular [rad/s] (3)
                velocity, linear [m/s^2] (3) and angular [rad/s^2] (3) acceleration, shape [len(numbers), 19]. It may
                be a read-only view in which all worlds share one row.
            numbers: Numbers of the worlds, ascending.
        """
        for number, motion in zip(numbers.tolist(), motions, strict=True):
            values = motion.tolist()
            pose = Pose(position_m=tuple(values[:3]), quaternion=tuple(values[3:7]))
            self.worlds[number].drive(body, pose, motion[7:13], motion[13:])

    def apply_wrench(self, body: str, wrenches: FloatArray, numbers: IntArray) -> None:
        """Apply forces and torques to a body in some worlds, shape [len(numbers), 6]; see `World.apply_wrench`."""
        for number, wrench in zip(numbers.tolist(), wrenches, strict=True):
            self.worlds[number].apply_wrench(body, wrench)

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a deformable body in all worlds [m], shape [world_count, node_count, 3]."""
        return np.stack([world.nodes(name) for world in self.worlds])

    def faults(self) -> Mapping[int, str]:
        """Return why the engine itself gave up the state of a world, by its number; see `World.fault`."""
        found = {
            number: world.fault()
            for number, world in enumerate(self.worlds)
            if type(world).fault is not World.fault
        }
        return {number: fault for number, fault in found.items() if fault is not None}

    def on_device(self) -> DeviceWorlds:
        """Return these worlds as arrays of the engine's device, for `make_vec(..., mode="device")`.

        Raises:
            BackendError: The engine, or its solver of this scene, has none.
        """
        raise BackendError(
            "this engine's worlds have no arrays on a device: leave out mode='device'"
        )

    @abstractmethod
    def close(self) -> None:
        """Free the engine's resources. A second call does nothing."""


class SeparateWorlds(Worlds):
    """Simulations that run one after another, for engines without batched worlds."""

    worlds: Sequence[Simulation]
    are_separate = True

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self.worlds = simulations

    def reset(self, seed: int) -> None:
        """Return each simulation to its start."""
        for simulation in self.worlds:
            simulation.reset(seed)

    def advance(self, seconds: float) -> None:
        """Advance each simulation."""
        for simulation in self.worlds:
            simulation.advance(seconds)

    def close(self) -> None:
        """Close each simulation."""
        for simulation in self.worlds:
            simulation.close()


class ArrayWorlds(Worlds):
    """Worlds of an engine that holds them in arrays, whose first axis are the worlds.

    It implements `reset`, `advance`, `body_states` and `close`; `drive` for scenes with drivers; `apply_wrench`
    for forces; and `nodes` for scenes with deformable bodies, with `track` for ropes and
    rods. `on_device` is for learners there.

    Args:
        settings: Every numerical setting in force; see `World`.
        world_count: Number of worlds.
    """

    def __init__(self, settings: Mapping[str, Any], world_count: int) -> None:
        self.worlds = [
            _ArrayWorld(self, settings, number) for number in range(world_count)
        ]

    @abstractmethod
    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the current poses and velocities of bodies in all worlds; see `Worlds.body_states`."""

    def drive(self, body: str, motions: FloatArray, numbers: IntArray) -> None:
        """Prescribe the motion of a kinematic body in some worlds; see `Worlds.drive`."""
        raise self._lacks("drive")

    def apply_wrench(self, body: str, wrenches: FloatArray, numbers: IntArray) -> None:
        """Apply forces and torques to a body in some worlds; see `Worlds.apply_wrench`."""
        raise self._lacks("apply_wrench")

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a deformable body in all worlds; see `Worlds.nodes`."""
        raise self._lacks("nodes")

    def track(
        self, number: int, name: str, points_m: FloatArray
    ) -> Callable[[], FloatArray] | None:
        """Return a reader of material points in one world, or None to interpolate between nodes; see `World.track`."""
        return None

    def state(self) -> Any:
        """Return a snapshot of all worlds; see `Simulation.state`. Without it, `build` wraps a `ReplayedSimulation`."""
        raise self._lacks("state")

    def restore(self, state: Any) -> None:
        """Restore a snapshot; see `Simulation.restore`."""
        raise self._lacks("restore")

    def _lacks(self, method: str) -> BackendError:
        return BackendError(
            f"{type(self).__name__} does not implement Worlds.{method}, which this scene or call needs"
        )

    def faults(self) -> Mapping[int, str]:
        """Return why the engine gave up the state of a world, by its number; none here."""
        return {}


class _ArrayWorld(World):
    """One of several worlds in arrays, for what an environment asks of a single one."""

    def __init__(
        self, worlds: ArrayWorlds, settings: Mapping[str, Any], number: int
    ) -> None:
        self.settings = settings
        self._worlds = worlds
        self._number = number
        self._numbers = np.array([number])

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        motion = np.concatenate(
            [pose.position_m, pose.quaternion, velocity, acceleration]
        )
        self._worlds.drive(body, motion[None], self._numbers)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        self._worlds.apply_wrench(body, wrench[None], self._numbers)

    def body_states(self, names: Sequence[str]) -> FloatArray:
        return self._worlds.body_states(names)[self._number]

    def nodes(self, name: str) -> FloatArray:
        return self._worlds.nodes(name)[self._number]

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        return self._worlds.track(self._number, name, points_m)

    def fault(self) -> str | None:
        return self._worlds.faults().get(self._number)


class ArraySimulation(_ArrayWorld, Simulation):
    """The only world of an `ArrayWorlds`: what `build` of an engine in arrays returns.

    In a `ReplayedSimulation` unless its worlds have `state` and `restore`.

    Args:
        worlds: Worlds of one scene.
    """

    def __init__(self, worlds: ArrayWorlds) -> None:
        super().__init__(worlds, worlds.worlds[0].settings, 0)

    def reset(self, seed: int) -> None:
        """Return to the scene's start."""
        self._worlds.reset(seed)

    def advance(self, seconds: float) -> None:
        """Simulate an interval."""
        self._worlds.advance(seconds)

    def state(self) -> Any:
        """Return a snapshot."""
        return self._worlds.state()

    def restore(self, state: Any) -> None:
        """Restore a snapshot."""
        self._worlds.restore(state)

    def close(self) -> None:
        """Free the engine's resources."""
        self._worlds.close()
