"""A simulation around another one, to which it passes all calls that a subclass does not change."""

from collections.abc import Callable, Sequence
from typing import Any

from gauge_envs.backends.world import Simulation
from gauge_envs.scene import Pose
from gauge_envs.scene.geometry import FloatArray


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
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> None:
        """Pass on."""
        self.inner.drive(body, pose, velocity, acceleration)

    def apply_wrench(self, body: str, wrench: FloatArray) -> None:
        """Pass on."""
        self.inner.apply_wrench(body, wrench)

    def advance(self, seconds: float) -> None:
        """Pass on."""
        self.inner.advance(seconds)

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Pass on."""
        return self.inner.body_states(names)

    def nodes(self, name: str) -> FloatArray:
        """Pass on."""
        return self.inner.nodes(name)

    def stated_nodes(self, name: str) -> FloatArray | None:
        """Pass on."""
        return self.inner.stated_nodes(name)

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Pass on."""
        return self.inner.track(name, points_m)

    def contact_forces(
        self, pairs: Sequence[tuple[str, str]]
    ) -> Callable[[], FloatArray] | None:
        """Pass on."""
        return self.inner.contact_forces(pairs)

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
