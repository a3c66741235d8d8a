"""One instance of a scene in an engine: what environments drive and read."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import FloatArray


class World(ABC):
    """One instance of a scene that can be driven and read, in SI units. A pose is a body frame in the world.

    Attributes:
        settings: Every numerical setting in force, as a flat, JSON-ready mapping. Each result records it.
    """

    settings: Mapping[str, Any]

    @abstractmethod
    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Prescribe the uniformly accelerated motion of a kinematic body during the next `advance`.

        It is called before every `advance`; t seconds later the body is at pose + v t + a t^2 / 2. With piecewise
        constant velocity, each change of speed would jolt the bodies that rest on it and let them creep. An engine
        without prescribed acceleration may use the mean velocity, and should document it.

        Args:
            body: Name of a kinematic body.
            pose: Its pose at the start of the interval.
            velocity: Its linear [m/s] and angular [rad/s] velocity at the start, in the world frame, shape [6].
            acceleration: Its linear [m/s^2] and angular [rad/s^2] acceleration during the interval, shape [6].
        """

    @abstractmethod
    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the current poses and velocities of bodies.

        Args:
            names: Names of rigid bodies; fixed bodies are allowed.

        Returns:
            A new array, shape [len(names), 13]: position [m] (3), quaternion w x y z (4), linear velocity of the body
            origin [m/s] (3) and angular velocity [rad/s] (3), both in the world frame.
        """

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque to a dynamic body from now on. Only checks and a control task need it.

        Args:
            body: Name of a dynamic body.
            wrench: Force [N] through its centre of mass and torque [N m], in the world frame, shape [6]. It acts
                until another wrench replaces it or a reset removes it.

        Raises:
            BackendError: The engine does not support it.
        """
        raise BackendError(
            f"{type(self).__name__} applies no force or torque to {body!r}: it does not implement World.apply_wrench"
        )

    def fault(self) -> str | None:
        """Return why the engine itself gave up the state since the last reset, or None.

        An engine that replaces a state that is not finite must report it here. Environments then count the episode as
        diverged. They find a state that is not finite, or outside the scene's bounds, on their own.
        """
        return None

    def nodes(self, name: str) -> FloatArray:
        """Return the positions of a deformable body's nodes [m], shape [node_count, 3]."""
        raise KeyError(name)

    def stated_nodes(self, name: str) -> FloatArray | None:
        """Return what `nodes` is at the start of `Scene.stated`, or None where the engine did not build that start."""
        return None

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Return a reader of material points of a deformable body, if the engine locates them better than its nodes do.

        Args:
            name: Name of the body. A body may also track points of the bodies that it is bonded to.
            points_m: World positions at the start [m], shape [point_count, 3].

        Returns:
            Function that returns the current positions of the points [m], shape [point_count, 3]. None means that the
            caller interpolates between the nodes; ropes and rods need a reader, because their nodes form a line.

        Raises:
            ShapeError: A point lies outside the material.
        """
        return None

    def contact_forces(
        self, pairs: Sequence[tuple[str, str]]
    ) -> Callable[[], FloatArray] | None:
        """Return a reader of contact forces between rigid bodies, if the engine has them.

        Args:
            pairs: Names of two bodies each.

        Returns:
            Function that returns the forces [N] of the second bodies on the first, friction included, in the world
            frame, in the mean over the last `advance`, a new array of shape [len(pairs), 3]. None where the engine
            does not read them.
        """
        return None


class Simulation(World):
    """A world that advances on its own.

    Attributes:
        frees_python: Whether `advance` runs without Python's lock, so that several simulations advance at once in as
            many threads.
    """

    frees_python: ClassVar[bool] = False

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Return to the scene's start at time 0. The same seed gives the same trajectory."""

    def start_at(self, scene: Scene) -> bool:
        """Make the start of another scene the one that `reset` returns to, if every bit is then that of a new build.

        Args:
            scene: The scene.

        Returns:
            Whether it is; otherwise the caller closes this simulation and builds the scene. An engine may always
            return False.
        """
        return False

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval [s]. Environments pass multiples of 1/180 s."""

    def sample_positions(
        self, names: Sequence[str], count: int, interval_s: float
    ) -> FloatArray:
        """Advance `count` intervals and read body positions after each. An engine may override it with a faster loop.

        Args:
            names: Names of rigid bodies.
            count: Number of intervals.
            interval_s: Length of an interval [s].

        Returns:
            Positions of the body origins [m], shape [count, len(names), 3].
        """
        positions = np.empty((count, len(names), 3))
        for row in positions:
            self.advance(interval_s)
            row[:] = self.body_states(names)[:, :3]
        return positions

    def state(self) -> Any:
        """Return a snapshot, from which `restore` continues bit for bit. It can be pickled.

        Raises:
            BackendError: The engine cannot continue bit for bit, and `build` returned no `ReplayedSimulation`.
        """
        raise BackendError(
            f"{type(self).__name__} saves no state. Implement Simulation.state and Simulation.restore, or let build() "
            "return a ReplayedSimulation of it"
        )

    def restore(self, state: Any) -> None:
        """Restore a snapshot of this simulation, or of another simulation of the same scene.

        Raises:
            BackendError: The engine cannot continue bit for bit, and `build` returned no `ReplayedSimulation`.
        """
        raise BackendError(
            f"{type(self).__name__} restores no state. Implement Simulation.state and Simulation.restore, or let "
            "build() return a ReplayedSimulation of it"
        )

    @abstractmethod
    def close(self) -> None:
        """Free the engine's resources. A second call does nothing."""
