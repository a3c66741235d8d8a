"""Step many worlds of an engine by frames: world by world, or all in one call.

A frame is a generator that drives and reads one world. It yields before each interval of 1/180 s in which someone else
must advance the world, and returns the result of the frame.
"""

from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, cast

from gauge_envs.backends.world import Simulation, World
from gauge_envs.backends.worlds import Worlds
from gauge_envs.files import processors
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

Result = TypeVar("Result")


def run_frame(frame: Generator[None, None, Result], simulation: Simulation) -> Result:
    """Run a frame of a world that is a simulation of its own, and return what the frame returns."""
    while True:
        try:
            next(frame)
        except StopIteration as end:
            return cast("Result", end.value)
        simulation.advance(SAMPLE_INTERVAL_S)


class Stepper:
    """Steps the worlds of an engine.

    Worlds that are simulations of their own run world by world; they share the processors in threads, where the engine
    frees Python's lock. Worlds of one model advance together in one call, after which all are read at once.

    Args:
        worlds: The worlds.
        moving: Names of the bodies that are read of worlds of one model, for `views`.

    Attributes:
        worlds: The worlds.
        views: The worlds, as frames drive and read them.
    """

    def __init__(self, worlds: Worlds, moving: Sequence[str] = ()) -> None:
        self.worlds = worlds
        self._simulations = [
            world for world in worlds.worlds if isinstance(world, Simulation)
        ]
        thread_count = 1
        if all(
            isinstance(world, Simulation) and world.frees_python
            for world in worlds.worlds
        ):
            thread_count = min(processors(), len(worlds.worlds))
        self._threads = ThreadPoolExecutor(thread_count) if thread_count > 1 else None
        self._thread_count = thread_count
        self._moving = tuple(dict.fromkeys(moving))
        self._states: FloatArray | None = None
        self.views: Sequence[World] = worlds.worlds
        if moving and not self._simulations:
            self.views = [
                cast("World", _View(self, number))
                for number in range(len(worlds.worlds))
            ]

    def run(
        self, frames: Mapping[int, Generator[None, None, Result]]
    ) -> dict[int, Result]:
        """Run a frame of some worlds, and return what the frames return; an error of a frame is raised at the end.

        Args:
            frames: Frames by the number of their world. Those of worlds that are simulations of their own must change
                nothing but their world.
        """
        results = (
            self._run_alone(frames) if self._simulations else self._run_together(frames)
        )
        return {number: results[number] for number in frames}

    def _run_alone(
        self, frames: Mapping[int, Generator[None, None, Result]]
    ) -> dict[int, Result]:
        results: dict[int, Result] = {}

        def run(numbers: Sequence[int]) -> None:
            for number in numbers:
                results[number] = run_frame(frames[number], self._simulations[number])

        numbers = [*frames]
        if self._threads is None or len(numbers) < 2:
            run(numbers)
        else:
            parts = [
                numbers[first :: self._thread_count]
                for first in range(self._thread_count)
            ]
            # The results of the map raise the errors of its calls.
            list(self._threads.map(run, parts))
        return results

    def _run_together(
        self, frames: Mapping[int, Generator[None, None, Result]]
    ) -> dict[int, Result]:
        results: dict[int, Result] = {}
        running = dict(frames)
        while running:
            for number, frame in list(running.items()):
                try:
                    next(frame)
                except StopIteration as end:
                    results[number] = end.value
                    del running[number]
            if running:
                self.worlds.advance(SAMPLE_INTERVAL_S)
                self._states = None
        return results

    def restart(self, numbers: Sequence[int]) -> None:
        """Return some worlds to their starts; the others go on."""
        for number in numbers:
            self.worlds.restart(number)
        self._states = None

    def body_states(self, number: int, names: Sequence[str]) -> FloatArray:
        """Return the states of bodies of a world from the reading of all; see `World.body_states`."""
        if self._states is None:
            self._states = self.worlds.body_states(self._moving)
        return self._states[number, [self._moving.index(name) for name in names]]


class _View:
    """A world whose states are read together with those of all others; the rest is the world's own."""

    def __init__(self, stepper: Stepper, number: int) -> None:
        self._stepper = stepper
        self._number = number

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stepper.worlds.worlds[self._number], name)

    def body_states(self, names: Sequence[str]) -> FloatArray:
        return self._stepper.body_states(self._number, names)
