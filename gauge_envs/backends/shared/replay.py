"""Going back to a state by replaying all calls since the reset, for engines that cannot restore one bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation
from gauge_envs.scene import Pose


@dataclass(frozen=True)
class ReplayedState:
    """Everything that happened since a reset.

    Attributes:
        seed: Seed of the reset.
        calls: Names and arguments of the calls, in their order.
    """

    seed: int
    calls: tuple[tuple[str, tuple[Any, ...]], ...]


class ReplayedSimulation(Simulation):
    """A simulation whose `restore` resets the engine and repeats all calls since the reset.

    `build` returns it around a simulation that implements neither `state` nor `restore`. The same seed must give the
    same trajectory. The time of `restore` grows with the time that was simulated since the reset.

    Args:
        inner: The simulation.
    """

    def __init__(self, inner: Simulation) -> None:
        self.settings = inner.settings
        self._inner = inner
        self._seed = 0
        self._calls: list[tuple[str, tuple[Any, ...]]] = []

    def reset(self, seed: int) -> None:
        """Return to the scene's start and forget all calls."""
        self._seed, self._calls = seed, []
        self._inner.reset(seed)

    def drive(self, body: str, pose: Pose, velocity: NDArray[np.float64], acceleration: NDArray[np.float64]) -> None:
        """Prescribe the motion of a kinematic body; see `World.drive`."""
        self._call("drive", body, pose, np.array(velocity), np.array(acceleration))

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Apply a force and a torque; see `World.apply_wrench`."""
        self._call("apply_wrench", body, np.array(wrench))

    def advance(self, seconds: float) -> None:
        """Simulate an interval [s]."""
        self._call("advance", seconds)

    def sample_positions(self, names: Sequence[str], count: int, interval_s: float) -> NDArray[np.float64]:
        """Advance and return positions; see `Simulation.sample_positions`."""
        positions: NDArray[np.float64] = self._call("sample_positions", tuple(names), count, interval_s)
        return positions

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return poses and velocities of bodies, shape [len(names), 13]; see `World.body_states`."""
        return self._inner.body_states(names)

    def fault(self) -> str | None:
        """Return why the engine gave up the state; see `World.fault`."""
        return self._inner.fault()

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Return the positions of a deformable body's nodes [m], shape [node_count, 3]."""
        return self._inner.nodes(name)

    def track(self, name: str, points_m: NDArray[np.float64]) -> Callable[[], NDArray[np.float64]] | None:
        """Return a reader of material points; see `World.track`."""
        return self._inner.track(name, points_m)

    def state(self) -> ReplayedState:
        """Return the seed and all calls since the reset."""
        return ReplayedState(self._seed, tuple(self._calls))

    def restore(self, state: ReplayedState) -> None:
        """Reset the engine and repeat the calls of a state."""
        self.reset(state.seed)
        for name, arguments in state.calls:
            self._call(name, *arguments)

    def close(self) -> None:
        """Free the engine's resources."""
        self._inner.close()

    def _call(self, name: str, *arguments: Any) -> Any:
        result = getattr(self._inner, name)(*arguments)
        self._calls.append((name, arguments))
        return result
