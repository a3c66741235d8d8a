"""States of simulations: with their origin, so that none continues in another engine, setting or scene; or as a replay.

An engine that cannot restore a state bit for bit replays all calls since the reset.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gauge_envs.backends.shared.wrapped import WrappedSimulation
from gauge_envs.backends.world import Simulation
from gauge_envs.errors import BackendError
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import FloatArray

HASHED = (
    "bodies",
    "deformables",
    "joints",
    "attachments",
    "contacts",
    "gravity_m_per_s2",
    "air",
)
"""Parts of a scene in which those of two states must agree."""


@dataclass(frozen=True)
class ReplayedState:
    """Everything that happened since a reset.

    Attributes:
        seed: Seed of the reset.
        calls: Names and arguments of the calls, in their order.
    """

    seed: int
    calls: tuple[tuple[str, tuple[Any, ...]], ...]


class ReplayedSimulation(WrappedSimulation):
    """A simulation whose `restore` resets the engine and repeats all calls since the reset.

    `build` returns it around a simulation that implements neither `state` nor `restore`. The same seed must give the
    same trajectory. The time of `restore` grows with the time that was simulated since the reset.

    Args:
        inner: The simulation.
    """

    def __init__(self, inner: Simulation) -> None:
        super().__init__(inner)
        self._seed = 0
        self._calls: list[tuple[str, tuple[Any, ...]]] = []

    def reset(self, seed: int) -> None:
        """Return to the scene's start and forget all calls."""
        self._seed, self._calls = seed, []
        self.inner.reset(seed)

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Prescribe the motion of a kinematic body; see `World.drive`."""
        self._call("drive", body, pose, np.array(velocity), np.array(acceleration))

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Apply a force and a torque; see `World.apply_wrench`."""
        self._call("apply_wrench", body, np.array(wrench))

    def advance(self, seconds: float) -> None:
        """Simulate an interval [s]."""
        self._call("advance", seconds)

    def sample_positions(
        self, names: Sequence[str], count: int, interval_s: float
    ) -> FloatArray:
        """Advance and return positions; see `Simulation.sample_positions`."""
        return self._call("sample_positions", tuple(names), count, interval_s)

    def state(self) -> ReplayedState:
        """Return the seed and all calls since the reset."""
        return ReplayedState(self._seed, tuple(self._calls))

    def restore(self, state: ReplayedState) -> None:
        """Reset the engine and repeat the calls of a state."""
        self.reset(state.seed)
        for name, arguments in state.calls:
            self._call(name, *arguments)

    def _call(self, name: str, *arguments: Any) -> Any:
        result = getattr(self.inner, name)(*arguments)
        self._calls.append((name, arguments))
        return result


@dataclass(frozen=True)
class Snapshot:
    """A state and its origin.

    Attributes:
        engine: Engine and version, as `mujoco 4.0.0`.
        settings: Numerical settings in force.
        scene: Hash of the scene.
        values: The engine's state.
    """

    engine: str
    settings: Mapping[str, Any]
    scene: str
    values: Any


class StateOrigin:
    """Origin of the states of a simulation.

    Args:
        engine: Engine and version, as `mujoco 4.0.0`.
        settings: Numerical settings in force.
        scene: The scene.
    """

    def __init__(self, engine: str, settings: Mapping[str, Any], scene: Scene) -> None:
        self._engine, self._settings, self._scene = engine, settings, scene
        self._hash = ""

    def state(self, values: Any) -> Snapshot:
        """Return an engine's state with its origin."""
        return Snapshot(self._engine, dict(self._settings), self._scene_hash(), values)

    def values(self, state: Any) -> Any:
        """Return the engine's state of a snapshot from the same engine, settings and scene."""
        if not isinstance(state, Snapshot):
            raise BackendError(
                f"restore got a {type(state).__name__}: give it what state() returned"
            )
        if state.engine != self._engine:
            self._refuse(state.engine, self._engine)
        changed = [
            name
            for name in sorted({*state.settings, *self._settings})
            if state.settings.get(name) != self._settings.get(name)
        ]
        if changed:
            self._refuse(
                *(
                    _listed(settings, changed)
                    for settings in (state.settings, self._settings)
                )
            )
        if state.scene != self._scene_hash():
            self._refuse(
                f"scene {state.scene[:12]}",
                f"scene {self._scene_hash()[:12]} ({_names(self._scene)})",
            )
        return state.values

    def _refuse(self, saved: str, present: str) -> None:
        raise BackendError(
            f"the state is from a simulation with {saved}, this one has {present}. "
            "A state continues only in the same engine, settings and scene: build that simulation, or start again."
        )

    def _scene_hash(self) -> str:
        if not self._hash:
            parts = asdict(self._scene)
            texts = [repr(parts[name]) for name in HASHED]
            self._hash = hashlib.sha256("".join(texts).encode()).hexdigest()
        return self._hash


def _listed(settings: Mapping[str, Any], names: list[str]) -> str:
    return ", ".join(f"{name} = {settings.get(name)}" for name in names)


def _names(scene: Scene) -> str:
    return ", ".join(one.name for one in (*scene.bodies, *scene.deformables))
