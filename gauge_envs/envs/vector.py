"""The vector environment of many worlds of one experiment, and the wrapper that scores its episodes.

`gymnasium.make_vec(id, num_envs=6)` makes a `GaugeVectorEnv` within `ScoreEpisodes`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from gymnasium import spaces
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space, iterate
from numpy.typing import NDArray

from gauge_envs.backends.registry import versions_of
from gauge_envs.envs.arguments import (
    EnvArguments,
    check_episode_steps,
    checked_action,
    warn_before_use,
)
from gauge_envs.envs.guards import GuardedEnv, one_thread
from gauge_envs.envs.initial_states import Draw, InitialStates, Scatter
from gauge_envs.envs.pictures import WORLDS_RENDER_MODES, Pictures, rollout_picture
from gauge_envs.envs.spaces import (
    Observation,
    action_space_of,
    observation_space_of,
)
from gauge_envs.envs.world_references import WorldReferences
from gauge_envs.errors import ActionError, EpisodeError, ParameterError
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.band import Band
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.validation import chosen

if TYPE_CHECKING:
    from gauge_envs.scoring.score import Score

Step = tuple[
    Observation,
    FloatArray,
    BoolArray,
    BoolArray,
    dict[str, Any],
]


class WorldsEnv(GuardedEnv, VectorEnv[Any, Any, NDArray[Any]], ABC):
    """Worlds that advance together, and whose episodes start and end on their own; base of the vector environments.

    A subclass also names `VectorEnv` as its base, by which skrl recognizes it.

    Spaces, rewards and `infos` have the form of `gymnasium.vector.SyncVectorEnv`, with its three autoreset modes:

    - `NEXT_STEP`: the step after the end of a world's episode ignores its action and starts its next episode.
    - `SAME_STEP`: the step that ends an episode also starts the next one; `infos` has `final_obs` and `final_info`.
    - `DISABLED`: the user resets the worlds that have ended, with the option `reset_mask`, before the next step.

    Attributes:
        rollout: The current episodes.
        on_end: Function that is called at the end of episodes, before the worlds restart. It gets the mask of these
            worlds, shape [N], and returns entries of `infos`.
    """

    on_end: Callable[[BoolArray], dict[str, Any]] | None = None
    _pictures: Pictures
    _initial_states: InitialStates

    def __init__(self, num_envs: int, autoreset_mode: AutoresetMode | str) -> None:
        if not isinstance(num_envs, int) or num_envs < 1:
            raise ParameterError(f"num_envs is {num_envs!r}, expected 1 or more")
        self._mode = chosen(AutoresetMode, autoreset_mode, "autoreset_mode")
        self.metadata = {**type(self).metadata, "autoreset_mode": self._mode}
        self.num_envs = num_envs
        self._over = np.zeros(num_envs, dtype=np.bool_)
        self._entries: dict[str, Any] | None = None
        self._randoms: list[np.random.Generator] = []

    def _set_spaces(
        self, observation: spaces.Space[Any], action: spaces.Space[Any]
    ) -> None:
        self.single_observation_space, self.single_action_space = observation, action
        self.observation_space = batch_space(observation, self.num_envs)
        self.action_space = batch_space(action, self.num_envs)

    # --- hooks ---

    @abstractmethod
    def _start(self, worlds: BoolArray, given: list[int | None], draw: Draw) -> None:
        """Start an episode in worlds, shape [N], from the given seeds and the source of initial states."""

    @abstractmethod
    def _advance(self, actions: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Simulate a frame, and return rewards, terminations and truncations, shape [N]."""

    @abstractmethod
    def _observations(self) -> Any:
        """Return the observations of all worlds in new arrays."""

    @abstractmethod
    def _info(self, world: int) -> dict[str, Any]:
        """Return the `info` of a world without frame and time."""

    # --- episodes ---

    @one_thread
    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode in every world, or in those of the option `reset_mask`.

        Args:
            seed: Seed of the engine and of the first world's random numbers; each next world has one more. Or the seeds
                of all worlds; the engine takes the first. None is 0 in an experiment without noise. With noise and in
                control tasks, the random numbers of each world continue, as in an autoreset.
            options: See `GaugeEnv.reset`; an autoreset keeps them. With `{"jitter": True}` each world has its own
                initial state; `{"trial": 3}` starts every world from trial 3. With single-trial recordings, the seed of
                a world selects its trial. `{"reset_mask": mask}` starts the worlds of a mask of shape [N] alone.
        """
        self._check_open("reset")
        worlds = np.ones(self.num_envs, dtype=np.bool_)
        if isinstance(options, dict) and "reset_mask" in options:
            worlds = self._mask(options["reset_mask"])
            others = {key: options[key] for key in options if key != "reset_mask"}
            options = others or None
        given = self._seeds(seed)
        draw = self._initial_states.of_reset(options, seeded=seed is not None)
        if not self._randoms:
            self._randoms = [np_random(None)[0] for _ in given]
        for world in np.flatnonzero(worlds).tolist():
            if given[world] is not None:
                self._randoms[world] = np_random(given[world])[0]
        self._begin(worlds, given, draw)
        return self._observations(), self._infos(worlds)

    def _begin(self, worlds: BoolArray, given: list[int | None], draw: Draw) -> None:
        self._start(worlds, given, draw)
        self._over[worlds] = False
        self._entries = None

    def _restart(self, worlds: BoolArray) -> None:
        """Start the next episode of worlds, as a reset without seed and options."""
        if worlds.any():
            draw = self._initial_states.of_reset(None, seeded=False)
            self._begin(worlds, [None] * self.num_envs, draw)

    def _mask(self, mask: Any) -> BoolArray:
        mask = np.asarray(mask)
        is_mask = mask.shape == (self.num_envs,) and mask.dtype == np.bool_
        if not (is_mask and mask.any() and (mask.all() or self.rollout.has_begun)):
            expected = (
                f"{self.num_envs} booleans with a True; the first reset needs all"
            )
            raise ParameterError(
                f"option 'reset_mask' is {mask.tolist()}, expected {expected}"
            )
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """Return the seed of each world; a single seed grows by one per world."""
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + world for world in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ParameterError(
                f"{len(seed)} seeds for {self.num_envs} worlds: give one for each world, or a single number"
            )
        return list(seed)

    @one_thread
    def step(self, actions: Any) -> Step:
        """Simulate one frame, 1/30 s, in every world; the autoreset mode says what happens after an end.

        Args:
            actions: One action for each world; actions of worlds that have ended are ignored.

        Raises:
            EpisodeError: The environment was not reset, or with `DISABLED` a world that has ended was not.
        """
        self._check_started("step")
        ended, running = self._over.copy(), ~self._over
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros((2, self.num_envs), dtype=np.bool_)
        if ended.any() and self._mode is AutoresetMode.DISABLED:
            raise EpisodeError(
                f"{self._name}: the episodes of worlds {np.flatnonzero(ended).tolist()} are over: reset them with the "
                "option 'reset_mask'"
            )
        # If all worlds have ended, nothing is left to simulate.
        if running.any():
            rewards, terminated, truncated = self._advance(
                self._checked(actions, running)
            )
            rewards[ended], terminated[ended], truncated[ended] = 0.0, False, False
        self._over = terminated | truncated
        infos: dict[str, Any] = {}
        if self._over.any():
            self._entries = None
            if self.on_end is not None:
                infos = self.on_end(self._over)
            if self._mode is AutoresetMode.SAME_STEP:
                infos |= self._final(self._over, infos)
                ended = self._over.copy()
        self._restart(ended)
        infos |= self._infos(np.ones(self.num_envs, dtype=np.bool_))
        return self._observations(), rewards, terminated, truncated, infos

    def _final(self, over: BoolArray, ending: dict[str, Any]) -> dict[str, Any]:
        """Return the last observations and infos of worlds that restart in this step, with entries of their end."""
        observations = np.full(self.num_envs, None, dtype=object)
        batch = [*iterate(self.observation_space, self._observations())]
        for world in np.flatnonzero(over).tolist():
            observations[world] = batch[world]
        final_info = self._infos(over) | ending
        return {
            "final_obs": observations,
            "_final_obs": over.copy(),
            "final_info": final_info,
            "_final_info": over.copy(),
        }

    def _checked(self, actions: Any, running: BoolArray) -> FloatArray:
        """Return the actions of all worlds, shape [num_envs, action_size]; 0 for worlds that have ended."""
        count = len(actions) if hasattr(actions, "__len__") else 0
        if count != self.num_envs:
            raise ActionError(
                f"{self._name}: actions {actions!r}: expected one action for each of {self.num_envs} worlds"
            )
        shape = self.num_envs, *(self.single_action_space.shape or (0,))
        if isinstance(actions, np.ndarray) and actions in self.action_space:
            if not shape[1]:
                return np.zeros(shape)
            return np.where(running[:, None], actions, 0.0).astype(np.float64)
        checked = np.zeros(shape)
        for world in np.flatnonzero(running).tolist():
            checked[world] = checked_action(
                actions[world], self.single_action_space, self._name
            )
        return checked

    def _infos(self, worlds: BoolArray) -> dict[str, Any]:
        """Return the infos of some worlds."""
        rollout = self.rollout
        infos: dict[str, Any] = {
            "frame": np.where(worlds, rollout.frames, 0),
            "time_s": np.where(worlds, rollout.times_s, 0.0),
            "_frame": worlds.copy(),
            "_time_s": worlds.copy(),
        }
        if not worlds.all():
            return infos | self._entries_of(worlds)
        # Only a start and an end change entries.
        if self._entries is None:
            self._entries = self._entries_of(worlds)
        return infos | {key: rows.copy() for key, rows in self._entries.items()}

    def _entries_of(self, worlds: BoolArray) -> dict[str, Any]:
        """Return the infos of some worlds without frame and time."""
        infos: dict[str, Any] = {}
        for world in np.flatnonzero(worlds).tolist():
            infos = self._add_info(infos, self._info(world), world)
        return infos

    @one_thread
    def render(self) -> tuple[Any, ...] | None:
        """Return a picture of each world in the form of the render mode, or None without one."""
        if self.render_mode is None:
            return None
        self._check_started("render")
        return tuple(
            rollout_picture(self._pictures, self.rollout, self._bands, world)
            for world in range(self.num_envs)
        )

    @property
    def _bands(self) -> Sequence[Band | None]:
        """Reference of each world, which pictures show."""
        return [None] * self.num_envs

    @one_thread
    def close_extras(self, **_: Any) -> None:
        """Free the worlds and the renderer."""
        self._pictures.close()
        self.rollout.simulation.close()


class GaugeVectorEnv(WorldsEnv, VectorEnv[Any, Any, NDArray[Any]]):
    """Worlds of one experiment on one backend, which may simulate them in a batch.

    Each world behaves as a `GaugeEnv`; see `WorldsEnv` for the three autoreset modes. Worlds differ in their actions,
    with `jitter` in their initial states, and with `world_parameters` in their constants. Divergence terminates a world
    in that frame, with the reason in `infos["diverged"]`; it restarts alone.

    Args:
        variant: Variant, its name, or its Gymnasium id, as `SlopeSlider-2-wood`; or the path of a task file, as
            `crate.toml`.
        num_envs: Number of worlds, 1 or more.
        backend: Name of an installed physics engine.
        parameters: `published`, another parameter set of the task file, or overrides such as
            `{"cube.friction": 0.3}`, in SI units.
        settings: Numerical settings of the engine that replace those of the preset, as `{"timestep_s": 1 / 1800}`.
        marker_proxy: Marker proxy of deformable bodies. `material` tracks the material point of the marker between
            nodes; `node` tracks the nearest node, as in the paper.
        drivers: `bundled` moves driven bodies as in the task file, `imported` as in the imported trials. With `action`
            they rest until actions move them, see `gauge_envs.experiments.resolve.moved_by_actions`.
        reference: `bundled` scores against the package's references, `imported` against the imported trials.
        asset: File with the scene in place of the task file: a USD layer for any engine, an MJCF file for `mujoco`. It
            has constants and driven motion; observation and score stay those of the variant.
        render_mode: None, `rgb_array`, `depth_array` or `rgbd_tuple`, as for `GaugeEnv`.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace those of the scene's camera: `target_m` [m], `distance_m` [m], `azimuth_deg` and
            `elevation_deg` [degrees].
        render_overlay: As for `GaugeEnv`.
        jitter: As for `GaugeEnv`; each world has its own initial states.
        world_parameters: Overrides for each world in addition to `parameters`, such as
            `[{"cube.friction": 0.25}, {"cube.friction": 0.30}]`. Such worlds are built sequentially. A solution cannot
            score a world with other constants, see `Score.refused`.
        autoreset_mode: Mode of `gymnasium.vector.AutoresetMode`, or its value.

    Attributes:
        arguments: Variant and keywords.
        experiment: The experiment.
        band: Reference of rewards and scores, or None.
        rollout: The current episodes.
        seeds_used: Seeds of the last reset; empty before the first.
        versions: Versions of the engine's packages.

    Example:
        >>> import gymnasium as gym, gauge_envs
        >>> envs = gym.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=3)
        >>> observations, infos = envs.reset(seed=0, options={"jitter": True})
        >>> observations["observable"].shape
        (3, 3)
        >>> over = False
        >>> while not over:
        ...     *_, terminations, truncations, infos = envs.step([0, 0, 0])
        ...     over = (terminations | truncations).all()
        >>> [score.kind for score in infos["score"]]
        ['trials', 'trials', 'trials']
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        "render_modes": [*WORLDS_RENDER_MODES],
        "render_fps": int(FRAME_RATE_HZ),
    }

    def __init__(
        self,
        variant: str | Variant,
        num_envs: int = 1,
        *,
        backend: str = "mujoco",
        parameters: Parameters = "published",
        settings: Mapping[str, Any] | None = None,
        marker_proxy: MarkerProxy | str = MarkerProxy.MATERIAL,
        drivers: DataSource | str = DataSource.BUNDLED,
        reference: DataSource | str = DataSource.BUNDLED,
        asset: str | PathLike[str] | None = None,
        render_mode: str | None = None,
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        render_overlay: bool = False,
        jitter: Scatter = None,
        world_parameters: Sequence[Mapping[str, Any]] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        super().__init__(num_envs, autoreset_mode)
        if world_parameters is not None and len(world_parameters) != num_envs:
            raise ParameterError(
                f"world_parameters has {len(world_parameters)} entries for {num_envs} worlds: give one for each"
            )
        self.render_mode = render_mode
        self._pictures = Pictures(
            render_mode,
            width=width,
            height=height,
            camera=camera,
            has_overlay=render_overlay,
            modes=WORLDS_RENDER_MODES,
        )
        self.arguments = EnvArguments(
            variant,
            backend=backend,
            parameters=parameters,
            settings=settings,
            marker_proxy=marker_proxy,
            drivers=drivers,
            reference=reference,
            asset=asset,
        )
        self.experiment = experiment = self.arguments.experiment()
        experiments = [experiment] * num_envs
        for world, constants in enumerate(world_parameters or ()):
            if constants:
                changed = dict(experiment.overrides) | dict(constants)
                varied = replace(self.arguments, parameters=changed)
                experiments[world] = varied.experiment()
        self._initial_states = InitialStates(experiment, jitter)
        self.rollout = self.arguments.rollout(experiments, restarts=True)
        self.references = WorldReferences(self.rollout)
        self.band = self.references.bands[0]
        self.versions = versions_of(self.arguments.backend)
        self.seeds_used: tuple[int, ...] = ()
        self._name = experiment.id
        self._set_spaces(observation_space_of(experiment), action_space_of(experiment))

    def _start(self, worlds: BoolArray, given: list[int | None], draw: Draw) -> None:
        sampler, rollout = self._initial_states, self.rollout
        seeds = list(self.seeds_used or range(self.num_envs))
        starts = list(rollout.initial_states) or [sampler.sample(None, 0)] * len(seeds)
        chosen = np.flatnonzero(worlds).tolist()
        for world in chosen:
            seeds[world] = world
            if given[world] is not None or draw is not None:
                random = self._randoms[world]
                seeds[world] = sampler.seed_of(given[world], draw, random)
            starts[world] = sampler.sample(draw, seeds[world])
        self.seeds_used = tuple(seeds)
        rollout.reset(starts, seeds[chosen[0]], worlds)
        self.references.start()

    def _advance(self, actions: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
        rollout = self.rollout
        rollout.step(actions)
        terminated = rollout.terminated.copy()
        truncated = rollout.is_over & ~terminated
        return self.references.rewards(), terminated, truncated

    def _observations(self) -> Observation:
        return self.rollout.recording.observation()

    def _info(self, world: int) -> dict[str, Any]:
        return {**self.rollout.info(world), "reference": self.references.kind(world)}

    @property
    def _bands(self) -> Sequence[Band | None]:
        return self.references.bands

    @one_thread
    def scores(self) -> tuple[Score | None, ...]:
        """Return the score of each world's episode, None before its end; see `GaugeEnv.score`."""
        is_over = self.rollout.is_over
        return tuple(
            self.references.score(world) if is_over[world] else None
            for world in range(self.num_envs)
        )

    @one_thread
    def score_arrays(self) -> dict[str, FloatArray]:
        """Return the scores of all worlds in one pass over their trajectories, as arrays of shape [num_envs].

        The keys are those of `Score`: `rmse` and, where they apply, `rmse_normalized`, `time_offset_s`, `rmse_aligned`
        and `rmse_aligned_normalized`. An entry is NaN if the episode of the world is not over or diverged, or if the
        reference cannot score it (`Score.refused`). A `Score` has more fields, and takes some milliseconds.
        """
        if self.band is None:
            raise EpisodeError(
                f"{self.experiment.id}: it has no reference, so it has no scores"
            )
        return self.references.score_arrays()


class ScoreEpisodes(VectorWrapper):
    """Score each episode of a `GaugeVectorEnv` once, when it ends.

    At the step that ends an episode, in every autoreset mode, it adds to `infos`: `score`, an array of
    `gauge_envs.Score` of shape [num_envs], None for a world whose episode did not end; and the mask `_score`.
    Environments of `gymnasium.make` score themselves, also within Gymnasium's vector environments.

    Args:
        env: The environment, with or without other wrappers.
        arrays: Whether to add the arrays of `GaugeVectorEnv.score_arrays` with their masks in place of `score`. This
            scores thousands of worlds in one pass.

    Raises:
        ParameterError: The environment is no `GaugeVectorEnv`.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, NDArray[Any]], *, arrays: bool = False
    ) -> None:
        super().__init__(env)
        worlds = env.unwrapped
        if not isinstance(worlds, GaugeVectorEnv):
            raise ParameterError(
                f"ScoreEpisodes: expected a GaugeVectorEnv, got a {type(worlds).__name__}"
            )
        self._worlds, self._arrays = worlds, arrays
        worlds.on_end = self._scores

    def _scores(self, over: BoolArray) -> dict[str, Any]:
        """Return the scores of worlds that have ended, as entries of `infos`."""
        if self._arrays:
            arrays = self._worlds.score_arrays()
            masks = {f"_{key}": over & np.isfinite(arrays[key]) for key in arrays}
            return arrays | masks
        infos: dict[str, Any] = {}
        scores = self._worlds.scores()
        for world in np.flatnonzero(over).tolist():
            infos = self._add_info(infos, {"score": scores[world]}, world)
        return infos


def scored_vector_env(
    *,
    score: bool = True,
    score_arrays: bool = False,
    max_episode_steps: int | None = None,
    **arguments: Any,
) -> ScoreEpisodes | GaugeVectorEnv:
    """Return a `GaugeVectorEnv` that is scored; `gymnasium.make_vec` calls this for every id.

    Args:
        score: Whether to score each episode; training needs only rewards.
        score_arrays: Argument `arrays` of `ScoreEpisodes`.
        max_episode_steps: Steps of an episode; `gymnasium.make_vec` passes those of the spec.
        **arguments: Arguments of `GaugeVectorEnv`.

    Raises:
        ParameterError: `max_episode_steps` differs from the experiment, or arrays of scores lack a reference.

    Warns:
        NoRewardWarning: Rewards or scores are missing; once for each id and cause.
        UserWarning: A restitution of the user has no effect; once for each experiment.
    """
    envs = GaugeVectorEnv(**arguments)
    if score_arrays and envs.band is None:
        raise ParameterError(
            f"{envs.experiment.id}: score_arrays=True needs a reference, and it has none"
        )
    check_episode_steps(max_episode_steps, envs.experiment.frame_count - 1)
    warn_before_use(envs.experiment, envs.band)
    return ScoreEpisodes(envs, arrays=score_arrays) if score else envs
