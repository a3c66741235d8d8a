"""Many worlds of one control task, as a vector environment: `gymnasium.make_vec("GAUGE/Carry-Limit-wood", 6)`.

The worlds advance together, and start and end their episodes one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.envs.registration import load_env_creator

from gauge_envs.backends.registry import backend_for
from gauge_envs.backends.shared.resampled import (
    in_intervals,
    worlds_in_intervals,
)
from gauge_envs.backends.world import Simulation
from gauge_envs.backends.worlds import SeparateWorlds, Worlds
from gauge_envs.envs.arguments import Scatter, check_episode_steps, check_support
from gauge_envs.envs.base import WorldsEnvironment, world_constants
from gauge_envs.envs.lockstep import check_length
from gauge_envs.envs.pictures import WORLDS_RENDER_MODES, Pictures, Rendered
from gauge_envs.envs.stepper import Stepper
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.control.env import ControlEnv, Step
from gauge_envs.tools.control.tasks import find_control_task


class ControlVectorEnv(WorldsEnvironment[FloatArray]):
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
        render_mode: None, `rgb_array`, `depth_array` or `rgbd_tuple`, as for `ControlEnv`.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace those of the scene's camera: `target_m`, `distance_m`, `azimuth_deg` and
            `elevation_deg`.
        jitter: Scatter of the starts, as of `ControlEnv`; each world has starts of its own, also after autoreset.

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
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        jitter: Scatter = None,
        max_episode_steps: int | None = None,
    ) -> None:
        check_episode_steps(max_episode_steps, find_control_task(task).episode_steps)
        constants = world_constants(num_envs, world_parameters)
        pictures = Pictures(
            render_mode,
            width=width,
            height=height,
            camera=camera,
            modes=WORLDS_RENDER_MODES,
        )
        self.worlds = ControlWorlds(
            task,
            constants,
            parameters=parameters,
            backend=backend,
            settings=settings,
            jitter=jitter,
        )
        first = self.worlds.envs[0]
        super().__init__(first.experiment, pictures, backend=backend, settings=settings)
        self._set_spaces(num_envs, first)
        self._observations = np.zeros((num_envs, len(first.OBSERVED)))
        self._over = np.zeros(num_envs, dtype=np.bool_)

    @property
    def _label(self) -> str:
        return type(self.worlds.envs[0]).__name__

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start a new episode in every world.

        Args:
            seed: Seed of the first world; each next world has one more. Or the seed of each world. None continues the
                random numbers of each world.
            options: See `ControlEnv.reset`; they hold for autoreset.
        """
        self._check_open("reset")
        seeds = [None] * self.num_envs if seed is None else self._seeds(seed)
        super().reset(seed=seeds[0])
        self._is_reset = True
        self._over[:] = False
        infos = self._begin(dict(enumerate(seeds)), {}, options)
        return self._observations.copy(), infos

    def _begin(
        self,
        seeds: Mapping[int, int | None],
        infos: dict[str, Any],
        options: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        for number, (observation, info) in self.worlds.begin(seeds, options).items():
            self._observations[number] = observation
            infos = self._add_info(infos, info, number)
        return infos

    def step(
        self, actions: Any
    ) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Simulate one frame, 1/30 s, in every world; a world whose episode was over starts the next one instead.

        Args:
            actions: One action for each world, shape [num_envs, action_size].
        """
        self._check_started("step", started=self._is_reset)
        check_length(actions, self.num_envs)
        rewards = np.zeros(self.num_envs)
        terminations, truncations = np.zeros((2, self.num_envs), dtype=np.bool_)
        infos: dict[str, Any] = {}
        ended = np.flatnonzero(self._over).tolist()
        steps = self.worlds.step(
            {number: actions[number] for number in np.flatnonzero(~self._over).tolist()}
        )
        for number, step in steps.items():
            (
                self._observations[number],
                rewards[number],
                terminations[number],
                truncations[number],
                info,
            ) = step
            infos = self._add_info(infos, info, number)
        # The worlds of one model advance together, so that the others restart after them.
        infos = self._begin(dict.fromkeys(ended), infos)
        self._over = terminations | truncations
        return self._observations.copy(), rewards, terminations, truncations, infos

    def _picture(self, number: int) -> Rendered | None:
        return self.worlds.envs[number].picture(self._pictures)

    def _free(self) -> None:
        super()._free()
        self.worlds.close()


class ControlWorlds:
    """Worlds of a control task on one engine, which may advance them in one call.

    Each world is the single environment with its constants, to the bit. Engines whose worlds share a model and can
    restart alone, such as Newton, get one model; the worlds of others are simulations of their own.

    Args:
        task: Name or id of the task.
        constants: Overrides of each world, such as `{"cube.friction": 0.3}`, on top of `parameters`.
        parameters: `calibrated`, another parameter set of the task file, or overrides.
        backend: Name of the engine.
        settings: Numerical settings of the engine that replace those of the preset.
        jitter: Scatter of the starts. Worlds that start anew elsewhere are simulations of their own.

    Attributes:
        envs: The environment of each world; their `reset` and `step` are not for use.
    """

    def __init__(
        self,
        task: str,
        constants: Sequence[Mapping[str, Any]],
        *,
        parameters: Parameters = "calibrated",
        backend: str = "mujoco",
        settings: Mapping[str, Any] | None = None,
        jitter: Scatter = None,
    ) -> None:
        found = find_control_task(task)
        make = load_env_creator(found.entry_point)

        def world(chosen: Parameters) -> ControlEnv:
            env = make(
                material=found.material,
                parameters=chosen,
                backend=backend,
                settings=settings,
                jitter=jitter,
                is_world=True,
            )
            assert isinstance(env, ControlEnv)
            return env

        first = world(parameters)
        settings = first.settings_on(backend, settings)
        common = dict(first.experiment.overrides)
        self.envs = [
            world(common | dict(one)) if one else world(parameters) for one in constants
        ]
        self._settings = settings
        self._engine = backend_for(backend, first.experiment.model_file)
        scenes = [env.experiment.scene for env in self.envs]
        self._use(
            worlds_in_intervals(self._engine, scenes, settings, restart_alone=True)
        )

    def _use(self, worlds: Worlds) -> None:
        self._stepper = Stepper(worlds, moving=self.envs[0].moving)
        for env, view in zip(self.envs, self._stepper.views, strict=True):
            env.world = view

    def begin(
        self, seeds: Mapping[int, int | None], options: Mapping[str, Any] | None = None
    ) -> dict[int, tuple[FloatArray, dict[str, Any]]]:
        """Start a new episode in some worlds, as `ControlEnv.reset` does.

        Args:
            seeds: Seed for the number of each world; None continues its random numbers.
            options: Options of the reset.
        """
        placed = {
            number: self.envs[number].place(seed, options)
            for number, seed in seeds.items()
        }
        moved = {number: one for number, one in placed.items() if one is not None}
        if moved:
            self._build_anew(moved)
        self._stepper.restart([*seeds])
        return {number: self.envs[number].begin() for number in seeds}

    def _build_anew(self, moved: Mapping[int, Experiment]) -> None:
        """Build some worlds with other starts; those of one model all become simulations of their own."""
        now = self._stepper.worlds.worlds
        worlds = dict(
            enumerate(world for world in now if isinstance(world, Simulation))
        )
        if not worlds:
            # Only a reset of all worlds asks for the first scatter.
            self._stepper.worlds.close()
        for number, env in enumerate(self.envs):
            if number in moved or number not in worlds:
                experiment = moved.get(number, env.experiment)
                scene = experiment.scene
                if number in worlds:
                    if worlds[number].start_at(scene):
                        continue
                    worlds[number].close()
                check_support(experiment, env.backend_name)
                built = self._engine.build(scene, self._settings)
                worlds[number] = in_intervals(built, scene)
        self._use(SeparateWorlds([worlds[number] for number in range(len(self.envs))]))

    def step(self, actions: Mapping[int, Any]) -> dict[int, Step]:
        """Simulate one frame in some worlds, with `limit` in `info` where an episode ends.

        Args:
            actions: Action for the number of each world whose episode is running.
        """
        steps = self._stepper.run(
            {
                number: self.envs[number].frame(action)
                for number, action in actions.items()
            }
        )
        for number, (_, _, terminated, truncated, info) in steps.items():
            if terminated or truncated:
                info["limit"] = self.envs[number].report()
        return steps

    def close(self) -> None:
        """Free the worlds."""
        self._stepper.worlds.close()
