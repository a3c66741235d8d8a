"""Simulations whose step does not divide 1/180 s, resampled at the intervals of environments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from gauge_envs.backends.shared.rigid import later_targets
from gauge_envs.backends.simulation import ContactForces, MaterialPoints, Simulation
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import DRIVE_INTERVAL_S

ROUNDING_S = 1e-9


def in_intervals(simulation: Simulation, scene: Scene) -> Simulation:
    """Return a simulation in intervals of 1/180 s, resampled if the given simulation has another interval."""
    interval_s = simulation.settings.get("drive_interval_s", DRIVE_INTERVAL_S)
    if abs(interval_s - DRIVE_INTERVAL_S) <= ROUNDING_S:
        return simulation
    return ResampledSimulation(simulation, scene, interval_s)


class ResampledSimulation(Simulation):
    """A simulation in steps of h that is read between them.

    Values are interpolated linearly between the steps before and after the time of reading, orientations on the shorter
    arc. In uniform acceleration a, positions are at most a h^2 / 8 off: 5 um in free fall
    at 2 ms. An impact that changes the speed by v is cut short by at most v h / 4 within its step. Driven motion and
    wrenches act from the next step on, at most h later.

    Args:
        simulation: The simulation, whose `drive_interval_s` is h.
        scene: Its scene.
        step_s: Its interval h [s].
    """

    def __init__(self, simulation: Simulation, scene: Scene, step_s: float) -> None:
        self.settings = {**simulation.settings, "drive_interval_s": DRIVE_INTERVAL_S}
        self.world_count = simulation.world_count
        self._inner = simulation
        self._step_s = step_s
        self._bodies = [body.name for body in scene.bodies]
        self._deformables = [body.name for body in scene.deformables]
        self._readers: list[Callable[[], FloatArray]] = []
        self._begin()

    def _begin(self) -> None:
        self._time_s = 0.0
        self._step_count = 0
        self._before: dict[str, FloatArray] = {}
        self._targets: dict[str, FloatArray] = {}
        self._driven_s = 0.0

    def reset(
        self,
        starts: FloatArray | None = None,
        seed: int = 0,
        worlds: BoolArray | None = None,
    ) -> None:
        """Start all worlds."""
        self._inner.reset(starts, seed)
        self._begin()

    def drive(self, body: str, targets: FloatArray) -> None:
        """Prescribe the motion of a kinematic body from the next step on."""
        self._targets[body] = targets.copy()
        self._driven_s = self._time_s

    def advance(self, seconds: float) -> None:
        """Step until the end of the interval is reached."""
        self._time_s += seconds
        while self._step_count * self._step_s < self._time_s - ROUNDING_S:
            self._before = self._read()
            since_s = self._step_count * self._step_s - self._driven_s
            for body, targets in self._targets.items():
                self._inner.drive(body, later_targets(targets, since_s))
            self._inner.advance(self._step_s)
            self._step_count += 1

    def _read(self) -> dict[str, FloatArray]:
        """Return all values that may be read between the current state and the next."""
        values = {"bodies": self._inner.body_states(self._bodies)}
        values |= {name: self._inner.nodes(name).copy() for name in self._deformables}
        values |= {f"reader {n}": read() for n, read in enumerate(self._readers)}
        return values

    @property
    def _share(self) -> float:
        """Share of the last step that lies before the current time."""
        ahead_s = self._step_count * self._step_s - self._time_s
        if not self._before or ahead_s < ROUNDING_S * self._step_s:
            return 1.0
        return 1.0 - ahead_s / self._step_s

    def _between(self, key: str, current: FloatArray) -> FloatArray:
        share = self._share
        if share == 1.0 or key not in self._before:
            return current
        return (1.0 - share) * self._before[key] + share * current

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states at the current time, shape [N, len(names), 13]."""
        current = self._inner.body_states(names)
        share = self._share
        if share == 1.0:
            return current
        rows = [self._bodies.index(name) for name in names]
        before = self._before["bodies"][:, rows].copy()
        products = (before[..., 3:7] * current[..., 3:7]).sum(axis=-1, keepdims=True)
        before[..., 3:7] *= np.where(products < 0.0, -1.0, 1.0)
        states = (1.0 - share) * before + share * current
        states[..., 3:7] /= np.linalg.norm(states[..., 3:7], axis=-1, keepdims=True)
        return states

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes at the current time [m], shape [N, node_count, 3]."""
        return self._between(name, self._inner.nodes(name))

    def track(self, name: str, points_m: FloatArray) -> MaterialPoints | None:
        """Return a reader of material points at the current time."""
        read = self._inner.track(name, points_m)
        if read is None:
            return None
        key = f"reader {len(self._readers)}"
        self._readers.append(read)
        return lambda: self._between(key, read())

    def apply_wrench(self, body: str, wrenches: FloatArray) -> None:
        """Apply a force and a torque from the next step on."""
        self._inner.apply_wrench(body, wrenches)

    def contact_forces(self, pairs: Sequence[tuple[str, str]]) -> ContactForces | None:
        """Return a reader of the mean contact forces over the last step."""
        return self._inner.contact_forces(pairs)

    def diverged(self) -> Mapping[int, str]:
        """Return the reason of each world that diverged."""
        return self._inner.diverged()

    def close(self) -> None:
        """Free the engine's resources."""
        self._inner.close()
