"""The contract between an environment and a physics engine.

A backend is one class with three methods. It sees a `Scene` and never the name of an experiment:

    class BackendMine(Backend):
        name = "mine"

        def supports(self, scene): ...
        def build(self, scene, settings): ...
        def versions(self): ...

`build` returns a `Simulation` that already stands at the scene's start and is read before it is first reset. An
environment resets it, and in each 1/180 s drives every kinematic body and advances. A backend becomes available under
its name through an entry point of the group `gauge_envs.backends`; docs/adding_an_engine.md walks through one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import BackendError, UnsupportedSceneError
from gauge_envs.scene import Pose, Scene

__all__ = [
    "Backend",
    "FileBackend",
    "ModelFile",
    "Simulation",
    "Support",
    "World",
    "Worlds",
]


@dataclass(frozen=True)
class Support:
    """Whether a backend can build a scene, and if not, everything that it lacks.

    Attributes:
        missing: One sentence for each thing that the backend cannot do; empty when it can build the scene.
    """

    missing: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return not self.missing


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """What a backend reads from a model file in its engine's own format.

    Attributes:
        scene: The scene that it was read for, with starts, masses and driven motion as the file has them.
        changes: How the file differs from the model that the backend builds of the scene, a line each.
    """

    scene: Scene
    changes: tuple[str, ...]


class World(ABC):
    """One copy of a scene, to be driven and read. Poses are body frames in the world; everything is in SI units.

    Attributes:
        settings: Every numerical setting in force, flat, JSON-ready; it is written into each result.
    """

    settings: Mapping[str, Any]

    @abstractmethod
    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Prescribe a kinematic body for the coming `advance`: it starts there and accelerates uniformly.

        Called before every `advance`: t seconds later the body is at pose + v t + a t^2 / 2. Uniform acceleration
        matters: a body driven at piecewise constant speed jolts what rests on it at each change, which lets it creep.
        An engine that cannot may use the mean velocity, and should say so.

        Args:
            body: Name of a kinematic body.
            pose: Its pose at the start of the interval.
            velocity: Its linear [m/s] and angular [rad/s] velocity at the start, in the world frame, shape [6].
            acceleration: Its linear [m/s^2] and angular [rad/s^2] acceleration until the end, shape [6].
        """

    @abstractmethod
    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Poses and velocities now.

        Returns:
            A new array, shape [len(names), 13]: position [m] (3), quaternion w x y z (4), linear velocity of the body
            origin [m/s] (3) and angular velocity [rad/s] (3), both in the world frame. Fixed bodies can be asked for.
        """

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a dynamic body from now on; optional, control tasks with a motor need it.

        Args:
            body: Name of a dynamic body.
            wrench: Force [N] through its centre of mass and torque [N m], in the world frame, shape [6]. It stays
                until another one is applied, and a reset ends it.

        Raises:
            BackendError: The engine does not offer it.
        """
        raise BackendError(
            f"{type(self).__name__} applies no force or torque to {body!r}: it does not implement World.apply_wrench"
        )

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Positions of a deformable body's nodes [m], shape [node_count, 3]."""
        raise KeyError(name)

    def track(self, name: str, points_m: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]] | None:
        """Reader of material points of a deformable body, for engines that know better than its nodes where they are.

        Args:
            name: Name of the body; bodies that are bonded may answer for each other.
            points_m: World positions at the start [m], shape [point_count, 3].

        Returns:
            Function that returns where the points are now [m], shape [point_count, 3]; None leaves it to
            interpolation between the nodes, which a line of nodes does not allow.

        Raises:
            ShapeError: A point lies outside the material.
        """
        return None


class Simulation(World):
    """One running scene."""

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Return to the scene's start at time 0; the same seed gives the same trajectory."""

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval; a multiple of 1/180 s whenever an environment calls."""

    def sample_positions(self, names: Sequence[str], count: int, interval_s: float) -> NDArray[np.float64]:
        """Advance `count` intervals and read where bodies are after each; override where a tighter loop is possible.

        Returns:
            Positions of the body origins [m], shape [count, len(names), 3].
        """
        positions = np.empty((count, len(names), 3))
        for row in positions:
            self.advance(interval_s)
            row[:] = self.body_states(names)[:, :3]
        return positions

    @abstractmethod
    def state(self) -> Any:
        """Everything that `restore` needs to go on from here bit for bit; it can be pickled."""

    @abstractmethod
    def restore(self, state: Any) -> None:
        """Go back to a state that `state` returned, of this simulation or of another one of the same scene."""

    @abstractmethod
    def close(self) -> None:
        """Free what the simulation holds; calling it twice is harmless."""


class Worlds(ABC):
    """Copies of a scene with different starts, that run together.

    Attributes:
        worlds: The copies, in the order of the scenes.
    """

    worlds: Sequence[World]

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Return all to their starts at time 0; the same seed gives the same trajectories."""

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval in all of them; a multiple of 1/180 s."""

    @abstractmethod
    def close(self) -> None:
        """Free what they hold; calling it twice is harmless."""


class _SeparateWorlds(Worlds):
    """Simulations one after another, for engines that have no batches."""

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self.worlds = simulations
        self._simulations = simulations

    def reset(self, seed: int) -> None:
        for simulation in self._simulations:
            simulation.reset(seed)

    def advance(self, seconds: float) -> None:
        for simulation in self._simulations:
            simulation.advance(seconds)

    def close(self) -> None:
        for simulation in self._simulations:
            simulation.close()


class Backend(ABC):
    """A physics engine.

    Attributes:
        name: What users type: `backend="mujoco"`.
        file_suffixes: Suffixes of the model files that `read_file` and `build_file` take, as `.xml`; mostly none.
    """

    name: ClassVar[str]
    file_suffixes: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def versions(self) -> dict[str, str]:
        """Versions of the engine's packages, written into each result."""

    @abstractmethod
    def supports(self, scene: Scene) -> Support:
        """Whether `build` will work on a scene, and if not, why: at once, without building anything."""

    @abstractmethod
    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build a scene; the simulation stands at the scene's start, where `reset` brings it back to.

        Args:
            scene: What to build; `supports` is true for it.
            settings: Numerical settings that replace the backend's defaults, by name; `preset` picks a named set.

        Raises:
            ParameterError: A setting of that name does not exist or has an impossible value.
        """

    def build_worlds(self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None) -> Worlds:
        """Build copies of a scene that run together; override where the engine can simulate them at once.

        Args:
            scenes: One or more, alike but for the poses at the start.
            settings: As in `build`.

        Raises:
            ParameterError: As `build`.
        """
        return _SeparateWorlds([self.build(scene, settings) for scene in scenes])

    def read_file(self, path: Path, scene: Scene) -> ModelFile:
        """Read a model file of the engine's own that stands for a scene; needed where `file_suffixes` names any.

        Args:
            path: The file.
            scene: What the file must show: its bodies by name, and what of them is driven.

        Raises:
            AssetError: The file cannot be read, or lacks something of the scene.
        """
        raise UnsupportedSceneError(f"backend {self.name!r} reads no model files")

    def build_file(self, path: Path, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build the model of a file; the simulation stands at the file's start.

        Args:
            path: The file.
            scene: What `read_file` returned for it.
            settings: Those that can be laid over a model file; an engine may have none.

        Raises:
            AssetError: As `read_file`, or the scene starts elsewhere than the file.
            ParameterError: A setting cannot be laid over a file.
        """
        raise UnsupportedSceneError(f"backend {self.name!r} builds no model files")


class FileBackend(Backend):
    """A backend that builds one model file, whatever scene it is asked for.

    Args:
        engine: The backend that reads the file.
        path: The file.
    """

    def __init__(self, engine: Backend, path: Path) -> None:
        self.name = engine.name  # type: ignore[misc]  # a class variable of engines, whose name this one carries
        self._engine = engine
        self._path = path

    def versions(self) -> dict[str, str]:
        """Versions of the engine's packages."""
        return self._engine.versions()

    def supports(self, scene: Scene) -> Support:
        """Whether the engine reads such files, and could build the scene itself."""
        if self._path.suffix not in self._engine.file_suffixes:
            known = ", ".join(self._engine.file_suffixes) or "none"
            return Support((f"{self._path.name} is a model of another engine; model files that it reads: {known}",))
        return self._engine.supports(scene)

    def build(self, scene: Scene, settings: Mapping[str, Any] | None = None) -> Simulation:
        """Build the file; see `Backend.build_file`."""
        return self._engine.build_file(self._path, scene, settings)
