"""Simulations whose step does not divide 1/180 s, resampled at the intervals of environments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from gauge_envs.backends.base import Backend, worlds_of
from gauge_envs.backends.shared.wrapped import WrappedSimulation
from gauge_envs.backends.world import Simulation
from gauge_envs.backends.worlds import SeparateWorlds, Worlds
from gauge_envs.scene import Pose, Scene
from gauge_envs.scene.geometry import FloatArray, vector
from gauge_envs.scene.timing import DRIVE_INTERVAL_S

ROUNDING_S = 1e-9


def in_intervals(simulation: Simulation, scene: Scene) -> Simulation:
    """Return a simulation in intervals of 1/180 s: the given one, or where it has others, one that resamples it."""
    interval_s = simulation.settings.get("drive_interval_s", DRIVE_INTERVAL_S)
    if abs(interval_s - DRIVE_INTERVAL_S) <= ROUNDING_S:
        return simulation
    return ResampledSimulation(simulation, scene, interval_s)


def worlds_in_intervals(
    engine: Backend,
    scenes: Sequence[Scene],
    settings: Mapping[str, Any] | None = None,
    *,
    restart_alone: bool = False,
    together: bool = True,
) -> Worlds:
    """Return worlds as `worlds_of` does; those with other intervals than 1/180 s are resampled one by one.

    Args:
        engine: The engine.
        scenes: Scene of each world.
        settings: As in `Backend.build`.
        restart_alone: As in `worlds_of`.
        together: Whether the engine may build the worlds as one simulation.
    """
    if together:
        worlds = worlds_of(engine, scenes, settings, restart_alone=restart_alone)
    else:
        worlds = Backend.build_worlds(engine, scenes, settings)
    interval_s = worlds.worlds[0].settings.get("drive_interval_s", DRIVE_INTERVAL_S)
    if abs(interval_s - DRIVE_INTERVAL_S) <= ROUNDING_S:
        return worlds
    worlds.close()
    return SeparateWorlds(
        [in_intervals(engine.build(scene, settings), scene) for scene in scenes]
    )


class ResampledSimulation(WrappedSimulation):
    """A simulation in steps of h that is read between them.

    What is read at a time is interpolated linearly between the last step before it and the first one after it;
    orientations on the shorter arc. In uniform acceleration a, positions are at most a h^2 / 8 off: 5 um in free fall
    at 2 ms. An impact that changes the speed by v is cut short by at most v h / 4 within its step. What the
    environment prescribes, as driven motion, commands and wrenches, acts from the next step on, at most h later.

    Args:
        simulation: The simulation, whose `drive_interval_s` is h.
        scene: Its scene.
        step_s: Its interval h [s].
    """

    def __init__(self, simulation: Simulation, scene: Scene, step_s: float) -> None:
        super().__init__(simulation)
        self.settings = {**simulation.settings, "drive_interval_s": DRIVE_INTERVAL_S}
        self._step_s = step_s
        self._bodies = [body.name for body in scene.bodies]
        self._rows = {name: row for row, name in enumerate(self._bodies)}
        self._nodes = [body.name for body in scene.deformables]
        self._readers: list[Callable[[], FloatArray]] = []
        self._begin()

    def _begin(self) -> None:
        self._time_s = 0.0
        self._step_count = 0
        self._before: dict[str, Any] = {}
        self._drives: Mapping[str, tuple[Pose, FloatArray, FloatArray]] = (
            MappingProxyType({})
        )
        self._driven_s = 0.0

    def reset(self, seed: int) -> None:
        """Return to the scene's start."""
        self.inner.reset(seed)
        self._begin()

    def drive(
        self, body: str, pose: Pose, velocity: FloatArray, acceleration: FloatArray
    ) -> None:
        """Prescribe the motion of a kinematic body; see `World.drive`."""
        given = (pose, np.array(velocity), np.array(acceleration))
        self._drives = {**self._drives, body: given}
        self._driven_s = self._time_s

    def advance(self, seconds: float) -> None:
        """Step until the end of the interval is reached."""
        self._time_s += seconds
        while self._stepped_s < self._time_s - ROUNDING_S:
            self._before = self._read()
            since_s = self._stepped_s - self._driven_s
            for body, given in self._drives.items():
                self.inner.drive(body, *_moved(*given, since_s))
            self.inner.advance(self._step_s)
            self._step_count += 1

    @property
    def _stepped_s(self) -> float:
        return self._step_count * self._step_s

    def _read(self) -> dict[str, Any]:
        """Return all that may be read between the state now and the next one."""
        found: dict[str, Any] = {"bodies": self.inner.body_states(self._bodies)}
        found |= {name: self.inner.nodes(name).copy() for name in self._nodes}
        found |= {f"reader {n}": one() for n, one in enumerate(self._readers)}
        return found

    @property
    def _share(self) -> float:
        """Share of the last step that lies before the time now."""
        if not self._before:
            return 1.0
        return 1.0 - (self._stepped_s - self._time_s) / self._step_s

    def _between(self, key: str, now: FloatArray) -> FloatArray:
        if self._share > 1.0 - ROUNDING_S or key not in self._before:
            return now
        return np.asarray((1.0 - self._share) * self._before[key] + self._share * now)

    def body_states(self, names: Sequence[str]) -> FloatArray:
        """Return the states at the time now; see `World.body_states`."""
        now = self.inner.body_states(names)
        if self._share > 1.0 - ROUNDING_S:
            return now
        before = self._before["bodies"][[self._rows[name] for name in names]]
        signs = np.sign((before[:, 3:7] * now[:, 3:7]).sum(axis=1, keepdims=True))
        before[:, 3:7] *= np.where(signs == 0.0, 1.0, signs)
        states = (1.0 - self._share) * before + self._share * now
        states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
        return np.asarray(states)

    def nodes(self, name: str) -> FloatArray:
        """Return the nodes at the time now [m]."""
        return self._between(name, self.inner.nodes(name))

    def track(self, name: str, points_m: FloatArray) -> Callable[[], FloatArray] | None:
        """Return a reader of material points; see `World.track`."""
        read = self.inner.track(name, points_m)
        if read is None:
            return None
        key = f"reader {len(self._readers)}"
        self._readers.append(read)
        return lambda: self._between(key, read())

    def state(self) -> Any:
        """Return a snapshot."""
        times = (self._time_s, self._step_count, self._driven_s)
        return self.inner.state(), times, self._before, dict(self._drives)

    def restore(self, state: Any) -> None:
        """Restore a snapshot."""
        inner, times, self._before, self._drives = state
        self._time_s, self._step_count, self._driven_s = times
        self.inner.restore(inner)


def _moved(
    pose: Pose, velocity: FloatArray, acceleration: FloatArray, seconds: float
) -> tuple[Pose, FloatArray, FloatArray]:
    """Return a uniformly accelerated motion some time later."""
    from scipy.spatial.transform import Rotation

    way = seconds * velocity + 0.5 * seconds**2 * acceleration
    place = vector(np.asarray(pose.position_m) + way[:3])
    turned = Rotation.from_rotvec(way[3:]) * pose.rotation
    later = velocity + seconds * acceleration
    return Pose.from_rotation(place, turned), later, acceleration
