"""The vector environment of many worlds of one control task: `gymnasium.make_vec("GAUGE/Carry-Limit-wood", 6)`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from gauge_envs.envs.base import EngineEnvironment
from gauge_envs.envs.control.worlds import ControlWorlds
from gauge_envs.envs.rendering.lazy import Pictures
from gauge_envs.errors import ActionError, ParameterError
from gauge_envs.experiments.scene_builder import Parameters

FloatArray = NDArray[np.float64]

WORLD_LIMIT = 100_000
"""Largest number of worlds, as of `GaugeVectorEnv`."""


class ControlVectorEnv(EngineEnvironment, VectorEnv[FloatArray, Any, NDArray[Any]]):
    """Worlds of one control task on one engine.

    Observations, rewards, flags and `infos` are those of `gymnasium.vector.SyncVectorEnv` with the same number of
    single environments, to the bit. A world whose episode is over restarts alone in the next step, which ignores its
    action (`AutoresetMode.NEXT_STEP`). `infos["limit"]` and its mask `_limit` report each episode that ends.

    Args:
        task: Name of the task, as `Carry-Limit-wood`.
        num_envs: Number of worlds, 1 or more.
        backend: Name of the engine.
        parameters: `calibrated`, another parameter set of the task file, or overrides.
        settings: Numerical settings of the engine that replace those of the preset.
        world_parameters: Overrides for each world, such as `[{"cube.friction": 0.25}, {"cube.friction": 0.30}]`; they
            come on top of `parameters`.
        render_mode: None or `rgb_array`.
        width: Picture width [pixels].
        height: Picture height [pixels].

    Attributes:
        worlds: The worlds.

    Example:
        >>> import gymnasium as gym, gauge_envs
        >>> envs = gym.make_vec("GAUGE/Throw-Limit-rubber", num_envs=2)
        >>> observations, infos = envs.reset(seed=0)
        >>> observations.shape
        (2, 9)
        >>> terminations = [False]
        >>> while not any(terminations):
        ...     _, _, terminations, _, infos = envs.step([[0.0, 0.0], [0.0, 0.0]])
        >>> [str(report.ending) for report in infos["limit"]]
        ['lost', 'lost']
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        **EngineEnvironment.metadata,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        backend: str = "mujoco",
        parameters: Parameters = "calibrated",
        settings: Mapping[str, Any] | None = None,
        world_parameters: Sequence[Mapping[str, Any]] | None = None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or not 1 <= num_envs <= WORLD_LIMIT:
            raise ParameterError(f"num_envs is {num_envs!r}, expected a whole number from 1 to {WORLD_LIMIT}")
        constants = [{}] * num_envs if world_parameters is None else list(world_parameters)
        if len(constants) != num_envs:
            raise ParameterError(
                f"world_parameters has {len(constants)} entries for {num_envs} worlds: give one for each"
            )
        pictures = Pictures(render_mode, width=width, height=height)
        self.worlds = ControlWorlds(task, constants, parameters=parameters, backend=backend, settings=settings)
        first = self.worlds.envs[0]
        super().__init__(first.experiment, pictures, backend=backend, settings=settings)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._observations = np.zeros((num_envs, len(first.OBSERVED)))
        self._over = np.zeros(num_envs, dtype=np.bool_)
        self._is_reset = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start a new episode in every world.

        Args:
            seed: Seed of the first world; each next world has one more. Or the seed of each world. None continues the
                random numbers of each world.
            options: There are none.
        """
        self._check_open("reset")
        if options:
            raise ParameterError(f"reset of {type(self).__name__} has no options, got {', '.join(options)}")
        seeds = self._seeds(seed)
        super().reset(seed=seeds[0])
        self._is_reset = True
        self._over[:] = False
        infos = self._begin(dict(enumerate(seeds)), {})
        return self._observations.copy(), infos

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return list(range(int(seed), int(seed) + self.num_envs))
        if len(seed) != self.num_envs:
            raise ParameterError(
                f"{len(seed)} seeds for {self.num_envs} worlds: give one for each world, or a single number"
            )
        return list(seed)

    def _begin(self, seeds: Mapping[int, int | None], infos: dict[str, Any]) -> dict[str, Any]:
        for number, (observation, info) in self.worlds.begin(seeds).items():
            self._observations[number] = observation
            infos = self._add_info(infos, info, number)
        return infos

    def step(self, actions: Any) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Simulate one frame, 1/30 s, in every world; a world whose episode was over starts the next one instead.

        Args:
            actions: One action for each world, shape [num_envs, action_size].
        """
        self._check_started("step", started=self._is_reset)
        try:
            count = len(actions)
        except TypeError as error:
            raise ActionError(f"actions {actions!r}: expected one action for each of {self.num_envs} worlds") from error
        if count != self.num_envs:
            raise ActionError(f"{count} actions for {self.num_envs} worlds")
        rewards = np.zeros(self.num_envs)
        terminations, truncations = np.zeros((2, self.num_envs), dtype=np.bool_)
        infos: dict[str, Any] = {}
        ended = np.flatnonzero(self._over).tolist()
        steps = self.worlds.step({number: actions[number] for number in np.flatnonzero(~self._over).tolist()})
        for number, step in steps.items():
            self._observations[number], rewards[number], terminations[number], truncations[number], info = step
            infos = self._add_info(infos, info, number)
        # The worlds of one model advance together, so that the others restart after them.
        infos = self._begin(dict.fromkeys(ended), infos)
        self._over = terminations | truncations
        return self._observations.copy(), rewards, terminations, truncations, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture of each world, shape [height, width, 3], or None without `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        self._check_started("render", started=self._is_reset)
        return tuple(
            self._pictures.draw(self.experiment, {}, reach=env.reach(), poses=env.moving_poses(), nodes_m={})
            for env in self.worlds.envs
        )

    def close_extras(self, **_: Any) -> None:
        """Free the worlds and the renderer."""
        self._is_closed = True
        self._pictures.close()
        self.worlds.close()
