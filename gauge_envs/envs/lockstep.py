"""Episodes of many worlds in lockstep: they start together, and each step is one frame of all that run.

There are two types with the same methods and the same numbers. `EpisodesOneByOne` takes one world after another, of any
engine and experiment. `EpisodesAtOnce` of `envs.at_once` takes all worlds in arrays, where the engine advances them in
one call and the experiment allows it.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array

from gauge_envs.backends.worlds import Worlds
from gauge_envs.envs.episode import Episode, run_on_together
from gauge_envs.envs.spaces import Observation
from gauge_envs.envs.stepper import Stepper
from gauge_envs.errors import ActionError
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray

Numbers = IntArray
AddInfo = Callable[[dict[str, Any], dict[str, Any], int], dict[str, Any]]
"""Function of `VectorEnv` that adds the `info` of a world to those of all."""


class EpisodesOneByOne:
    """Episodes of one experiment on the worlds of an engine, which are driven, observed and judged one after another.

    Worlds that are simulations of their own give the same bits as in an environment of one world. They share the
    processors in threads, where the engine frees Python's lock.

    Args:
        episodes: The episode of each world.
        worlds: The worlds.

    Attributes:
        worlds: The worlds.
        ran: Numbers of the worlds whose episodes ran in the last step; all after `begin`.
    """

    def __init__(self, episodes: Sequence[Episode], worlds: Worlds) -> None:
        self._episodes = episodes
        self.worlds = worlds
        self.ran: Numbers = np.arange(len(episodes))
        self._observations: list[Observation] = []
        self._stepper = Stepper(worlds)

    @property
    def episodes(self) -> Sequence[Episode]:
        """The episode of each world."""
        return self._episodes

    @property
    def running(self) -> Numbers:
        """Numbers of the worlds whose episodes are not over."""
        return np.flatnonzero([not episode.is_over for episode in self.episodes])

    def begin(self, seed: int) -> None:
        """Return all worlds to their starts, and record frame 0."""
        self.worlds.reset(seed)
        for episode in self.episodes:
            episode.begin()
        self.ran = np.arange(len(self.episodes))
        self._observations = [episode.observation() for episode in self.episodes]

    def step(self, actions: Any) -> None:
        """Run a frame of the episodes that are not over.

        Args:
            actions: One action for each world; those of worlds whose episodes are over are not read.
        """
        rates = self._rates(actions)
        self.ran = np.array([*rates], dtype=np.intp)
        self._advance(rates)
        for number in rates:
            self.episodes[number].end_frame()
            self._observations[number] = self.episodes[number].observation()

    def _rates(self, actions: Any) -> dict[int, FloatArray]:
        """Return the residual rates of the running worlds."""
        check_length(actions, len(self.episodes))
        return {
            number: self.episodes[number].checked(actions[number])
            for number in self.running.tolist()
        }

    def _advance(self, rates: Mapping[int, FloatArray]) -> None:
        """Drive, advance and observe a frame of the worlds of some numbers."""
        self._stepper.run(
            {
                number: self.episodes[number].simulated(one)
                for number, one in rates.items()
            }
        )

    def play(self, seed: int) -> None:
        """Run all episodes without actions to their ends, and past them as far as their scores need.

        An episode that diverges ends there, with the reason in its `fault`; the others continue.
        """
        space = batch_space(self.episodes[0].action_space, len(self.episodes))
        self.begin(seed)
        while len(self.running):
            self.step(np.zeros(space.shape or (), dtype=space.dtype))
        self.run_on()

    def run_on(self) -> None:
        """Simulate on past the last frame, as `Episode.run_on` does for one world."""
        run_on_together(
            self.episodes,
            lambda numbers: self._advance(
                {one: self.episodes[one].no_rates for one in numbers}
            ),
        )

    def observations(self) -> Observation:
        """Return the observations of all worlds in new arrays; a world whose episode is over keeps its last one."""
        space = self.episodes[0].observation_space
        empty: Any = create_empty_array(space, len(self.episodes))
        return cast("Observation", concatenate(space, self._observations, empty))

    def rewards(self) -> FloatArray:
        """Return the reward of each world in this frame, shape [world_count]; 0 for one that did not run."""
        rewards = np.zeros(len(self.episodes))
        rewards[self.ran] = [
            self.episodes[number].reward() for number in self.ran.tolist()
        ]
        return rewards

    def infos(self, add: AddInfo) -> dict[str, Any]:
        """Return the infos of the worlds that ran in the last step."""
        infos: dict[str, Any] = {}
        for number in self.ran.tolist():
            infos = add(infos, self.episodes[number].info(), number)
        return infos

    def flags(self) -> tuple[BoolArray, BoolArray]:
        """Return terminations and truncations, shape [world_count] each."""
        diverged = np.array([episode.fault is not None for episode in self.episodes])
        return diverged, ~diverged & [episode.is_complete for episode in self.episodes]

    def trajectories(self) -> tuple[FloatArray, FloatArray]:
        """Return times [s], shape [sample_count], and g(t) of all worlds, shape [world_count, sample_count, width].

        Samples that a world did not reach are NaN.
        """
        found = [episode.trajectory().dense for episode in self.episodes]
        times_s, longest = max(found, key=lambda one: len(one[0]))
        samples = np.full((len(found), *longest.shape), np.nan)
        for row, (_, values) in zip(samples, found, strict=True):
            row[: len(values)] = values
        return times_s, samples


def check_length(actions: Any, count: int) -> None:
    """Raise an error unless there is one action for each world."""
    try:
        found = len(actions)
    except TypeError as error:
        raise ActionError(
            f"actions {actions!r}: expected one action for each of {count} worlds"
        ) from error
    if found != count:
        raise ActionError(f"{found} actions for {count} worlds")
