"""A simulation around another one, to which it passes all calls that a subclass does not change."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.world import Simulation
from gauge_envs.scene import Pose


class WrappedSimulation(Simulation):
    """A simulation that passes calls on to another one; see `Simulation` for what each does.

    Args:
        inner: The other simulation.
    """

    def __init__(self, inner: Simulation) -> None:
        self.settings = inner.settings
        self.inner = inner

    def reset(self, seed: int) -> None:
        """Pass on."""
        self.inner.reset(seed)

    def drive(
        self,
        body: str,
        pose: Pose,
        velocity: NDArray[np.float64],
        acceleration: NDArray[np.float64],
    ) -> None:
        """Pass on."""
        self.inner.drive(body, pose, velocity, acceleration)

    def apply_wrench(self, body: str, wrench: NDArray[np.float64]) -> None:
        """Pass on."""
        self.inner.apply_wrench(body, wrench)

    def command(self, values: NDArray[np.float64]) -> None:
        """Pass on."""
        self.inner.command(values)

    def advance(self, seconds: float) -> None:
        """Pass on."""
        self.inner.advance(seconds)

    def body_states(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Pass on."""
        return self.inner.body_states(names)

    def nodes(self, name: str) -> NDArray[np.float64]:
        """Pass on."""
        return self.inner.nodes(name)

    def track(
        self, name: str, points_m: NDArray[np.float64]
    ) -> Callable[[], NDArray[np.float64]] | None:
        """Pass on."""
        return self.inner.track(name, points_m)

    def contact_forces(
        self, pairs: Sequence[tuple[str, str]]
    ) -> Callable[[], NDArray[np.float64]] | None:
        """Pass on."""
        return self.inner.contact_forces(pairs)

    def grip_wrenches(self, names: Sequence[str]) -> NDArray[np.float64] | None:
        """Pass on."""
        return self.inner.grip_wrenches(names)

    def fault(self) -> str | None:
        """Pass on."""
        return self.inner.fault()

    def state(self) -> Any:
        """Pass on."""
        return self.inner.state()

    def restore(self, state: Any) -> None:
        """Pass on."""
        self.inner.restore(state)

    def close(self) -> None:
        """Pass on."""
        self.inner.close()
