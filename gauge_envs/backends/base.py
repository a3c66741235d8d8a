"""The interface between an environment and a physics engine.

A backend is one class with three methods. It receives a `Scene` and never the name of an experiment:

    class BackendMine(Backend):
        name = "mine"

        def supports(self, scene): ...
        def build(self, scene, settings): ...
        def versions(self): ...

`build` returns a `Simulation` at the scene's start; it may be read before its first reset. An environment resets it.
Then, every 1/180 s, the environment drives each kinematic body and advances the simulation. An entry point of the group
`gauge_envs.backends` makes a backend available by name; docs/adding_an_engine.md gives a complete example.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.device import DeviceWorlds
from gauge_envs.backends.fabric_constants import FabricConstants
from gauge_envs.errors import BackendError, UnsupportedSceneError
from gauge_envs.scene import Hinge, Pose, Scene
from gauge_envs.scene.fabrics import Fabric
from gauge_envs.scene.motors import Servo, TorqueMotor


@dataclass(frozen=True)
class Support:
    """Whether a backend can build a scene, and the unsupported features if it cannot.

    Attributes:
        missing: One sentence for each unsupported feature; empty if the backend can build the scene.
    """

    missing: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return not self.missing


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """Content of a model file in an engine's own format.

    Attributes:
        scene: The requested scene, with the start poses, masses and driven motion of the file.
        changes: Differences between the file and the model that the backend builds from the scene, one line each.
    """

    scene: Scene
    changes: tuple[str, ...]


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
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
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
    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return the current poses and velocities of bodies.

        Args:
            names: Names of rigid bodies; fixed bodies are allowed.

        Returns:
            A new array, shape [len(names), 13]: position [m] (3), quaternion w x y z (4), linear velocity of the body
            origin [m/s] (3) and angular velocity [rad/s] (3), both in the world frame.
        """

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque to a dynamic body from now on. Only control tasks with a motor need this method.

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

    def command(self, values: NDArray[np.float64]) -> None:
        """Set what the motors of the scene's joints follow from now on. Only scenes with motors need this method.

        It is called before every `advance`, which holds the values.

        Args:
            values: Angle from the start [rad] of a servo, torque [N m] of a torque motor, shape [motor_count], in the
                order of `Scene.motors`.

        Raises:
            BackendError: The engine has no motors.
        """
        raise BackendError(
            f"{type(self).__name__} moves no joint: it does not implement World.command"
        )

    def fault(self) -> str | None:
        """Return why the engine itself gave up the state since the last reset, or None.

        An engine that replaces a state that is not finite must report it here. Environments then count the episode as
        diverged. They find a state that is not finite, or outside the scene's bounds, on their own.
        """
        return None

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the positions of a deformable body's nodes [m], shape [node_count, 3]."""
        raise KeyError(name)

    def track(
        self, name: str, points_m: NDArray[np.float64]
    ) -> Callable[[], NDArray[np.float64]] | None:
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

    def grip_wrenches(self, names: Sequence[str]) -> NDArray[np.float64] | None:
        """Return the wrenches by which rigid bodies hold the deformable bodies attached to them.

        They include what carries the attached row of a cloth: a body at rest that holds a whole cloth pulls up with the
        weight of all of it. Contact is not part of them.

        Args:
            names: Names of fixed or driven bodies of attachments.

        Returns:
            A new array, shape [len(names), 6]: force [N] (3) and torque about the body origin [N m] (3) on the
            deformable bodies, in the world frame. None where the engine does not read them.
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

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval [s]. Environments pass multiples of 1/180 s."""

    def sample_positions(
        self, names: Sequence[str], count: int, interval_s: float
    ) -> NDArray[np.float64]:
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


class Worlds(ABC):
    """Instances of a scene with different starts that advance together.

    Environments call the methods that take and return arrays of all worlds. Here they call each world in turn. An
    engine that holds its worlds in arrays derives from `ArrayWorlds`.

    Attributes:
        worlds: The instances, in the order of the scenes.
    """

    worlds: Sequence[World]

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

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Simulate an interval in all worlds, a multiple of 1/180 s."""

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return the current poses and velocities of bodies in all worlds.

        An engine that holds all worlds in one array may override it; the values must be those of each world.

        Args:
            names: Names of rigid bodies.

        Returns:
            A new array, shape [world_count, len(names), 13]; see `World.body_states`.
        """
        return np.stack([world.body_states(names) for world in self.worlds])

    def body_positions(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return the positions of body origins in all worlds [m], a new array of shape [world_count, len(names), 3].

        Args:
            names: Names of rigid bodies.
        """
        return self.body_states(names)[:, :, :3].copy()

    def drive(
        self, body: str, motions: NDArray[np.float64], numbers: NDArray[np.intp]
    ) -> None:
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

    def command(self, values: NDArray[np.float64], numbers: NDArray[np.intp]) -> None:
        """Set what the motors follow in some worlds; see `World.command`.

        Args:
            values: Shape [len(numbers), motor_count]; it may be a read-only view, as in `drive`.
            numbers: Numbers of the worlds, ascending.
        """
        for number, row in zip(numbers.tolist(), values, strict=True):
            self.worlds[number].command(row)

    def apply_wrench(
        self, body: str, wrenches: NDArray[np.float64], numbers: NDArray[np.intp]
    ) -> None:
        """Apply forces and torques to a body in some worlds, shape [len(numbers), 6]; see `World.apply_wrench`."""
        for number, wrench in zip(numbers.tolist(), wrenches, strict=True):
            self.worlds[number].apply_wrench(body, wrench)

    def nodes(self, name: str) -> NDArray[np.float64]:
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


class _SeparateWorlds(Worlds):
    """Simulations that run one after another, for engines without batched worlds."""

    worlds: Sequence[Simulation]

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self.worlds = simulations

    def reset(self, seed: int) -> None:
        for simulation in self.worlds:
            simulation.reset(seed)

    def advance(self, seconds: float) -> None:
        for simulation in self.worlds:
            simulation.advance(seconds)

    def close(self) -> None:
        for simulation in self.worlds:
            simulation.close()


def separate_worlds(simulations: Sequence[Simulation]) -> Worlds:
    """Return worlds that are simulations of their own."""
    return _SeparateWorlds(simulations)


class ArrayWorlds(Worlds):
    """Worlds of an engine that holds them in arrays, whose first axis are the worlds.

    It implements `reset`, `advance`, `body_states` and `close`; `drive` for scenes with drivers; `command` and
    `apply_wrench` for scenes with motors; and `nodes` for scenes with deformable bodies, with `track` for ropes and
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
    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return the current poses and velocities of bodies in all worlds; see `Worlds.body_states`."""

    def drive(
        self, body: str, motions: NDArray[np.float64], numbers: NDArray[np.intp]
    ) -> None:
        """Prescribe the motion of a kinematic body in some worlds; see `Worlds.drive`."""
        raise self._lacks("drive")

    def command(self, values: NDArray[np.float64], numbers: NDArray[np.intp]) -> None:
        """Set what the motors follow in some worlds; see `Worlds.command`."""
        raise self._lacks("command")

    def apply_wrench(
        self, body: str, wrenches: NDArray[np.float64], numbers: NDArray[np.intp]
    ) -> None:
        """Apply forces and torques to a body in some worlds; see `Worlds.apply_wrench`."""
        raise self._lacks("apply_wrench")

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the nodes of a deformable body in all worlds; see `Worlds.nodes`."""
        raise self._lacks("nodes")

    def track(
        self, number: int, name: str, points_m: NDArray[np.float64]
    ) -> Callable[[], NDArray[np.float64]] | None:
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
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> None:
        motion = np.concatenate(
            [pose.position_m, pose.quaternion, velocity, acceleration]
        )
        self._worlds.drive(body, motion[None], self._numbers)

    def command(self, values: NDArray[np.float64]) -> None:
        self._worlds.command(values[None], self._numbers)

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        self._worlds.apply_wrench(body, wrench[None], self._numbers)

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        return self._worlds.body_states(names)[self._number]

    def nodes(self, name: str) -> NDArray[np.float64]:
        return self._worlds.nodes(name)[self._number]

    def track(
        self, name: str, points_m: NDArray[np.float64]
    ) -> Callable[[], NDArray[np.float64]] | None:
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


class Feature(StrEnum):
    """Part of a scene that an engine builds only if it says so."""

    AIR = "air"
    """`Scene.air` around cloth."""
    BODY_HINGES = "body hinges"
    """`Scene.body_hinges`."""
    STATED_INERTIA = "stated inertia"
    """`RigidBody.inertia_kg_m2`."""
    CHAINS = "chains"
    """Bodies that hinges join, of which one has a hinge to the world."""
    DRY_FRICTION = "dry joint friction"
    """`JointDynamics.dry_friction_n_m`."""
    VISCOUS_FRICTION = "viscous joint friction"
    """`JointDynamics.viscous_friction_n_m_s_per_rad`."""
    QUADRATIC_FRICTION = "quadratic joint friction"
    """`JointDynamics.quadratic_friction_n_m_s2_per_rad2`."""
    ARMATURE = "armature"
    """`JointDynamics.armature_kg_m2`."""
    BACKLASH = "backlash"
    """`JointDynamics.backlash_rad`."""
    SERVO = "servo"
    """`Servo` on a joint."""
    TORQUE_MOTOR = "torque motor"
    """`TorqueMotor` on a joint."""
    TORSION = "torsional friction"
    """`Contact.torsion_m`."""
    ROLLING = "rolling friction"
    """`Contact.rolling_m`."""


JOINT_FEATURES = frozenset(
    {
        Feature.CHAINS,
        Feature.DRY_FRICTION,
        Feature.VISCOUS_FRICTION,
        Feature.ARMATURE,
        Feature.SERVO,
        Feature.TORQUE_MOTOR,
    }
)
"""Features of joints."""


class Backend(ABC):
    """A physics engine.

    Attributes:
        name: Name that users type, as in `backend="mujoco"`.
        title: Name as the engine's authors write it, for pages; empty for `name`.
        color: Colour in figures, as `#0072b2`; empty for a grey that engines without a colour share.
        marker: Marker in figures, by matplotlib's names.
        file_suffixes: Suffixes of the model files that `read_file` and `build_file` accept, such as `.xml`.
        configurations: Settings of further solvers and presets that are compared beside the defaults, by name. They
            must suit any scene; a scene that a solver cannot build is declined.
        corrections: Where the engine's own physics is replaced or completed, one sentence each. An option of the engine
            is none. They hold for all presets but those of `own_defaults`.
        features: Optional features that `build` builds. Scenes with others are declined, so that an engine which was
            written before a feature existed leaves none out.
        own_defaults: Presets that leave the engine as its makers deliver it.
        worlds_mix_constants: Whether `build_worlds` takes scenes that differ in masses and contact constants too. Such
            scenes are built one by one for other engines.
        worlds_restart_alone: Whether `Worlds.restart` of what `build_worlds` returns starts one world anew while others
            go on.
    """

    name: ClassVar[str]
    title: ClassVar[str] = ""
    color: ClassVar[str] = ""
    marker: ClassVar[str] = "*"
    file_suffixes: ClassVar[tuple[str, ...]] = ()
    configurations: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({})
    corrections: ClassVar[tuple[str, ...]] = ()
    features: ClassVar[frozenset[Feature]] = frozenset()
    own_defaults: ClassVar[frozenset[str]] = frozenset({"out_of_box"})
    worlds_mix_constants: ClassVar[bool] = False
    worlds_restart_alone: ClassVar[bool] = False

    def whose_physics(self, preset: str) -> str:
        """Return whose physics a preset shows: `own defaults`, `own options`, or `corrected` by this package."""
        if preset in self.own_defaults:
            return "own defaults"
        return "corrected" if self.corrections else "own options"

    @abstractmethod
    def versions(self) -> dict[str, str]:
        """Return the versions of the engine's packages, which each result records."""

    @abstractmethod
    def supports(self, scene: Scene) -> Support:
        """Return whether `build` can build a scene, without building it."""

    @abstractmethod
    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build a scene and return a simulation at the scene's start.

        Args:
            scene: A scene that `supports` accepts.
            settings: Numerical settings that replace those of the preset, by name; `preset` selects another preset.

        Raises:
            ParameterError: A setting does not exist or has an invalid value.
        """

    def build_worlds(
        self, scenes: Sequence[Scene], settings: Mapping[str, Any] | None = None
    ) -> Worlds:
        """Build several instances of a scene. An engine with batched worlds overrides it.

        Args:
            scenes: One or more scenes that differ only in their start poses and velocities; with `worlds_mix_constants`
                also in the masses of rigid bodies, and in friction and restitution.
            settings: As in `build`.

        Raises:
            ParameterError: A setting does not exist or has an invalid value.
        """
        return _SeparateWorlds([self.build(scene, settings) for scene in scenes])

    def resolved_settings(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Mapping[str, Any] | None:
        """Return the numerical settings that `build` would use, without building; None where an engine does not tell.

        A sweep checks its settings with it before anything runs, and finds settings that are the same.

        Args:
            scene: A scene that `supports` accepts.
            settings: As in `build`.

        Returns:
            A flat, JSON-ready mapping, or None.

        Raises:
            ParameterError: A setting does not exist or has an invalid value.
        """
        return None

    @staticmethod
    def fabric_constants(fabric: Fabric) -> FabricConstants | None:
        """Return a measured fabric in the engine's own constants; None where no mapping is known."""
        return None

    def read_file(self, path: Path, scene: Scene) -> ModelFile:
        """Read a model file in the engine's format that replaces a scene. Backends with `file_suffixes` implement it.

        Args:
            path: The file.
            scene: The scene whose bodies, by name, and driven motions the file must contain.

        Raises:
            AssetError: The file cannot be read, or lacks a part of the scene.
        """
        raise UnsupportedSceneError(
            f"backend {self.name!r} reads no model files: use a USD layer"
        )

    def build_file(
        self, path: Path, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build the model of a file and return a simulation at the file's start.

        Args:
            path: The file.
            scene: The scene that `read_file` returned for it.
            settings: Numerical settings that replace those of the file; an engine may accept none.

        Raises:
            AssetError: The file cannot be read, lacks a part of the scene, or has other start poses than the scene.
            ParameterError: A setting cannot replace one of the file.
        """
        raise UnsupportedSceneError(
            f"backend {self.name!r} builds no model files: use a USD layer"
        )


def worlds_of(
    engine: Backend,
    scenes: Sequence[Scene],
    settings: Mapping[str, Any] | None = None,
    *,
    restart_alone: bool = False,
) -> Worlds:
    """Build several instances of a scene that may differ in starts and constants.

    The engine builds them together where it can, and one by one otherwise. An engine whose `build_worlds` was written
    for scenes with the same constants thus never gives all worlds those of the first.

    Args:
        engine: The engine.
        scenes: One or more scenes with the same bodies, shapes and motions of drivers.
        settings: As in `Backend.build`.
        restart_alone: Whether `Worlds.restart` is needed.
    """
    if restart_alone and not engine.worlds_restart_alone:
        return Backend.build_worlds(engine, scenes, settings)
    first = scenes[0]
    alike = all(_soft_constants(scene) == _soft_constants(first) for scene in scenes)
    same = alike and all(
        _rigid_constants(scene) == _rigid_constants(first) for scene in scenes
    )
    if same or (alike and engine.worlds_mix_constants and not first.deformables):
        return engine.build_worlds(scenes, settings)
    return Backend.build_worlds(engine, scenes, settings)


def _rigid_constants(scene: Scene) -> tuple[object, ...]:
    return (
        *((body.mass_kg, body.inertia_kg_m2) for body in scene.bodies),
        *scene.contacts,
    )


def _soft_constants(scene: Scene) -> tuple[object, ...]:
    origin = Pose(position_m=(0.0, 0.0, 0.0))
    return (
        *(replace(body, pose=origin) for body in scene.deformables),
        *scene.joints,
        *((one.shift_m, one.turn_rad) for one in scene.drivers),
        scene.air,
    )


def scene_support(engine: Backend, scene: Scene) -> Support:
    """Return whether an engine can build a scene: what `supports` returns, and what its class declares."""
    return with_declared(engine, scene, engine.supports(scene))


def with_declared(engine: Backend, scene: Scene, support: Support) -> Support:
    """Return what an engine's `supports` returned for a scene, with the features that its class does not declare."""
    # The last sentence of each feature.
    needed = dict(_needed_features(scene))
    reasons = tuple(
        reason for feature, reason in needed.items() if feature not in engine.features
    )
    return Support((*support.missing, *reasons)) if reasons else support


def _needed_features(scene: Scene) -> Iterator[tuple[Feature, str]]:
    """Yield the optional features that a scene needs, each with the sentence of a backend that lacks it."""
    if scene.air:
        yield (
            Feature.AIR,
            "the scene has air around its cloth, which this backend does not apply",
        )
    for hinge in scene.body_hinges[:1]:
        bodies = f"{hinge.first!r} and {hinge.second!r}"
        yield (
            Feature.BODY_HINGES,
            f"{bodies} are joined by a hinge, which this backend does not build",
        )
    joined = {
        name for hinge in scene.body_hinges for name in (hinge.first, hinge.second)
    }
    for name in joined & {*scene.hung}:
        yield (
            Feature.CHAINS,
            f"a chain of hinges hangs on the world by {name!r}, which this backend does not build",
        )
    yield from _needed_joint_features(scene)
    for contact in scene.contacts:
        bodies = f"{contact.first[0]!r} and {contact.second[0]!r}"
        for feature, length_m in (
            (Feature.TORSION, contact.torsion_m),
            (Feature.ROLLING, contact.rolling_m),
        ):
            if length_m:
                yield (
                    feature,
                    f"{bodies} touch with {feature.value}, which this backend does not build",
                )
    for body in scene.dynamic_bodies:
        if body.inertia_kg_m2 is not None:
            yield (
                Feature.STATED_INERTIA,
                f"{body.name!r} states its inertia, which this backend does not read",
            )


def _needed_joint_features(scene: Scene) -> Iterator[tuple[Feature, str]]:
    for hinge in scene.hinges:
        name = hinge.body if isinstance(hinge, Hinge) else hinge.second
        terms = {
            Feature.DRY_FRICTION: (hinge.dynamics.dry_friction_n_m, "dry friction"),
            Feature.VISCOUS_FRICTION: (
                hinge.dynamics.viscous_friction_n_m_s_per_rad,
                "viscous friction",
            ),
            Feature.QUADRATIC_FRICTION: (
                hinge.dynamics.quadratic_friction_n_m_s2_per_rad2,
                "quadratic friction",
            ),
            Feature.ARMATURE: (hinge.dynamics.armature_kg_m2, "armature"),
            Feature.BACKLASH: (hinge.dynamics.backlash_rad, "backlash"),
            Feature.SERVO: (isinstance(hinge.motor, Servo), "a position servo"),
            Feature.TORQUE_MOTOR: (
                isinstance(hinge.motor, TorqueMotor),
                "a torque motor",
            ),
        }
        for feature, (value, noun) in terms.items():
            if value:
                yield (
                    feature,
                    f"the joint of {name!r} has {noun}, which this backend does not build",
                )


class FileBackend(Backend):
    """A backend that builds one model file for every scene.

    Args:
        engine: The backend that reads the file.
        path: The file.
    """

    def __init__(self, engine: Backend, path: Path) -> None:
        self.name = engine.name  # type: ignore[misc]  # a class variable of engines, whose name this one carries
        self._engine = engine
        self._path = path

    def versions(self) -> dict[str, str]:
        """Return the versions of the engine's packages."""
        return self._engine.versions()

    def supports(self, scene: Scene) -> Support:
        """Return whether the engine reads files with this suffix and can build the scene itself."""
        if self._path.suffix not in self._engine.file_suffixes:
            known = ", ".join(self._engine.file_suffixes) or "none"
            return Support(
                (
                    f"{self._path.name} is a model of another engine; this engine reads: {known}",
                )
            )
        return self._engine.supports(scene)

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Build the model file; see `Backend.build_file`."""
        return self._engine.build_file(self._path, scene, settings)
