"""Many MuJoCo worlds of rigid bodies: Python drives and reads them in turn, and threads step them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo, without_clock
from gauge_envs.backends.worlds import Worlds
from gauge_envs.files import processors

OnArray = Callable[..., None]
"""Function of an array, which it reads, or writes to."""


class WorldsMuJoCo(Worlds):
    """Simulations of rigid scenes that advance together: each has the bits of one alone.

    A world costs Python three short calls an interval: one that places its driven body, one that steps it in C without
    Python's lock, and one that reads it.

    Args:
        simulations: The worlds, which differ in starts and constants.
    """

    are_separate = False
    worlds: Sequence[SimulationMuJoCo]

    def __init__(self, simulations: Sequence[SimulationMuJoCo]) -> None:
        self.worlds = simulations
        thread_count = min(processors(), len(simulations))
        self._threads = ThreadPoolExecutor(thread_count) if thread_count > 1 else None
        self._writers: dict[str, Sequence[OnArray]] = {}
        self._readers: dict[tuple[str, ...], Sequence[OnArray]] = {}
        self._parts = [
            simulations[first::thread_count] for first in range(thread_count)
        ]

    def reset(self, seed: int) -> None:
        """Return all worlds to their starts."""
        for world in self.worlds:
            world.reset(seed)

    def drive(
        self, body: str, motions: NDArray[np.float64], numbers: NDArray[np.intp]
    ) -> None:
        """Write the motion of a body in some worlds; see `Worlds.drive`."""
        if body not in self._writers:
            self._writers[body] = [
                world.driven_body(body).write for world in self.worlds
            ]
        writers = self._writers[body]
        for number, motion in zip(numbers.tolist(), motions, strict=True):
            writers[number](motion[:7], motion[7:13], motion[13:])

    def advance(self, seconds: float) -> None:
        """Step all worlds, in threads."""
        steps = round(seconds / self.worlds[0].timestep_s)

        def step(worlds: Sequence[SimulationMuJoCo]) -> None:
            for world in worlds:
                if world.contact_readers:
                    world.advance(seconds)
                    continue
                mujoco.mj_step(world.model, world.data, nstep=steps)

        threads = self._threads
        if threads is None:
            without_clock(partial(step, self.worlds))
        else:
            # The results of the map raise the errors of its calls.
            without_clock(lambda: list(threads.map(step, self._parts)))

    def body_positions(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return the positions of body origins; see `Worlds.body_positions`."""
        positions = np.empty((len(self.worlds), len(names), 3))
        key = tuple(names)
        if key not in self._readers:
            self._readers[key] = [
                world.reader(key).read_positions for world in self.worlds
            ]
        for read, row in zip(self._readers[key], positions, strict=True):
            read(row)
        return positions

    def close(self) -> None:
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()
