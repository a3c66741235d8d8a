"""N worlds of one scene in a physics engine: what environments drive, advance and read.

The first axis of every array is the world. All numbers are in SI units, in the world frame, float64. A state of a
rigid body has 13 numbers: position of the body origin [m] (3), unit quaternion w x y z (4), linear velocity of the body
origin [m/s] (3) and angular velocity [rad/s] (3).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar

import numpy as np

from gauge_envs.errors import BackendError
from gauge_envs.processors import processor_count
from gauge_envs.scene.geometry import BoolArray, FloatArray

ContactForces = Callable[[], FloatArray]
"""Reader of contact forces [N], which returns a new array of shape [world_count, pair_count, 3]."""

MaterialPoints = Callable[[], FloatArray]
"""Reader of material points [m], which returns an array of shape [world_count, point_count, 3]."""


class Sampler:
    """Readings of a simulation at several times, in the rows of an array.

    Args:
        read: Function that reads all worlds, shape [N, ...].
        rows: Array for the readings, shape [count, N, ...].
    """

    def __init__(self, read: Callable[[], FloatArray], rows: FloatArray) -> None:
        self._read, self._rows = read, rows

    def read(self, index: int) -> None:
        """Read all worlds now, for a row."""
        self._rows[index] = self._read()

    def finish(self) -> None:
        """Complete the velocities of states after the last reading."""


class Simulation(ABC):
    """Worlds of one scene that advance together.

    A new simulation is at the nominal start of its scene, at time 0, and can be read before its first reset.
    Environments call `reset`; then, every 1/180 s, `drive` for each kinematic body, `advance`, and the readers.

    Attributes:
        settings: Every effective numerical setting, as a flat, JSON-ready mapping. Each result records it.
        world_count: Number of worlds N.
    """

    settings: Mapping[str, Any]
    world_count: int = 1
    releases_gil: ClassVar[bool] = False
    """Whether `advance` runs without Python's lock, so that `LoopedSimulation` advances several in as many threads."""

    @abstractmethod
    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start worlds at time 0. The same starts and seed give the same trajectories.

        Args:
            starts: Initial states, shape [N, B, 13], in the order of `scene.bodies` followed by `scene.deformables`.
                Dynamic and kinematic bodies, and unclamped cloth, may start in other states than the scene gives. The
                row of a cloth holds the pose of its frame. All other rows equal the scene. None is the nominal start,
                see `gauge_envs.scene.states.nominal_states`.
            seed: Seed of engines that draw random numbers.
            worlds: Which worlds start, shape [N]; the others continue. None is all. Environments pass it only to an
                engine with `Backend.restarts_worlds`, so any other engine may leave the argument out.
        """

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe the motion of a kinematic body during the next `advance`.

        The motion is uniformly accelerated in the world frame. After t seconds the origin has moved by
        v t + a t^2 / 2. The body has rotated by the rotation vector with the same formula, from its angular velocity
        and acceleration. With piecewise constant velocity, each change of speed would jolt the bodies that rest on it.
        An engine without prescribed acceleration may use the mean velocity of each step, and should document it.

        Args:
            body: Name of a kinematic body. Environments drive each of them before every `advance`.
            targets: Shape [N, 19]: pose at the start of the interval, position [m] (3) and quaternion w x y z (4);
                linear [m/s] (3) and angular velocity [rad/s] (3) at that time; linear [m/s^2] (3) and angular
                acceleration [rad/s^2] (3). It may be a read-only view.

        Raises:
            BackendError: The engine drives no bodies.
        """
        raise BackendError(
            f"{type(self).__name__} does not drive bodies: implement drive"
        )

    def prepared(self, body: str, targets: FloatArray) -> Callable[[int], None]:
        """Return a function that drives a body in one of several intervals, whose number it gets.

        Args:
            body: Name of a kinematic body.
            targets: Targets of `drive` in each interval, shape [count, N, 19].
        """
        return lambda interval: self.drive(body, targets[interval])

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval [s] in all worlds. Environments pass 1/180 s."""

    @abstractmethod
    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the current states of rigid bodies, a new array of shape [N, len(names), 13].

        Args:
            names: Names of rigid bodies; fixed and driven bodies are allowed.
        """

    def sampler(self, names: Sequence[str], rows: FloatArray) -> Sampler:
        """Return a sampler of states, which environments read after each interval of a frame.

        Args:
            names: Names of rigid bodies.
            rows: Array for their states, shape [count, N, len(names), 13].
        """
        return Sampler(lambda: self.body_states(names), rows)

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of a deformable body [m], shape [N, node_count, 3]."""
        raise KeyError(name)

    def diverged(self) -> Mapping[int, str]:
        """Return the reason why the engine discarded a world's state since the last reset, by number of the world.

        An engine that replaces a state that is not finite must report it here. Environments find states that are not
        finite, too fast or too far away on their own.
        """
        return {}

    @abstractmethod
    def close(self) -> None:
        """Free the engine's resources. A second call does nothing."""

    # --- optional: forces, and material points that the engine locates more accurately than its nodes do ---

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body until the next call or reset.

        Args:
            body: Name of a dynamic body.
            wrenches: Force [N] through its centre of mass and torque [N m], shape [N, 6].

        Raises:
            BackendError: The engine does not support it.
        """
        raise BackendError(
            f"{type(self).__name__} cannot apply a force or torque to {body!r}: implement apply_wrench"
        )

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces | None:
        """Return a reader of contact forces between rigid bodies, or None if the engine has none.

        Args:
            pairs: Names of the two bodies of each pair.

        Returns:
            Reader of the force [N] of the second body on the first, friction included. It is the mean over the last
            `advance`, shape [N, len(pairs), 3].
        """
        return None

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points of a deformable body, or None to interpolate between its nodes.

        Ropes and rods need a reader, because their nodes form a line.

        Args:
            name: Name of the body. A body may also track points of the bodies that it is bonded to.
            points_m: World positions at the nominal start [m], shape [point_count, 3].

        Raises:
            ShapeError: A point lies outside the material.
        """
        return None


class LoopedSimulation(Simulation):
    """Simulations of one world each, combined; for engines without batches and for worlds with different constants.

    Args:
        simulations: One simulation for each world.
    """

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self._simulations = simulations
        self.settings = simulations[0].settings
        self.world_count = len(simulations)
        thread_count = min(processor_count(), self.world_count)
        is_threaded = simulations[0].releases_gil and thread_count > 1
        self._threads = ThreadPoolExecutor(thread_count) if is_threaded else None

    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start each world, or some of them."""
        for number, world in enumerate(self._simulations):
            if worlds is None or worlds[number]:
                start = None if starts is None else starts[number : number + 1]
                world.reset(start, seed)

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe the motion of a body in each world."""
        for number, world in enumerate(self._simulations):
            world.drive(body, targets[number : number + 1])

    def advance(self, seconds: float) -> None:
        """Advance each world."""
        apply = map if self._threads is None else self._threads.map
        # The results of the map raise the errors of its calls.
        list(apply(lambda world: world.advance(seconds), self._simulations))

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states of each world."""
        return np.concatenate([world.body_states(names) for world in self._simulations])

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes of each world."""
        return np.concatenate([world.nodes(name) for world in self._simulations])

    def diverged(self) -> Mapping[int, str]:
        """Return the reason of each world that diverged."""
        reasons = [world.diverged().get(0) for world in self._simulations]
        return {number: reason for number, reason in enumerate(reasons) if reason}

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque in each world."""
        for number, world in enumerate(self._simulations):
            world.apply_wrench(body, wrenches[number : number + 1])

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces | None:
        """Return a reader of the contact forces in each world."""
        return _joined([world.contact_forces(pairs) for world in self._simulations])

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points in each world."""
        return _joined([world.track(name, points_m) for world in self._simulations])

    def close(self) -> None:
        """Close each world."""
        if self._threads is not None:
            self._threads.shutdown()
        for world in self._simulations:
            world.close()


def _joined(
    readers: Sequence[Callable[[], FloatArray] | None],
) -> Callable[[], FloatArray] | None:
    """Return a reader of all worlds, or None if a world has none."""
    known = [reader for reader in readers if reader is not None]
    if len(known) < len(readers):
        return None
    return lambda: np.concatenate([read() for read in known])
