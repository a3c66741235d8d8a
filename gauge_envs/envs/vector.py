"""The vector environment of many worlds of one experiment, and the wrapper that scores any vector environment.

`gymnasium.make_vec(id, num_envs=6)` makes a `GaugeVectorEnv` within `ScoreEpisodes`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal, Unpack, cast

import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from numpy.typing import NDArray

from gauge_envs.backends.base import worlds_of
from gauge_envs.envs.arguments import EnvArguments, EnvKeywords, jitter_option, jittered_experiment, start_of
from gauge_envs.envs.at_once import EpisodesAtOnce
from gauge_envs.envs.base import EngineEnvironment
from gauge_envs.envs.episode import Episode, Observation, advance_together, run_on_together
from gauge_envs.envs.no_reward import warn_without_reward
from gauge_envs.envs.rendering.lazy import Pictures
from gauge_envs.envs.rendering.tracked import episode_picture
from gauge_envs.envs.rollout import Rollout
from gauge_envs.envs.trial_start import TrialStart
from gauge_envs.errors import ActionError, EpisodeError, ParameterError
from gauge_envs.evaluation.deformation import DeformationScore
from gauge_envs.evaluation.score import Score
from gauge_envs.evaluation.worlds import score_worlds
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.references.bands import Band
from gauge_envs.scene.jitter import Jitter

WORLD_LIMIT = 100_000
"""Largest number of worlds; as many SlopeSlider worlds take 63 GB on MuJoCo."""

Step = tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class GaugeVectorEnv(EngineEnvironment, VectorEnv[Observation, Any, NDArray[Any]]):
    """Worlds of one experiment in lockstep on one backend, which may simulate them at once.

    Each world behaves as a `GaugeEnv`. Spaces, rewards and `infos` have the form of `gymnasium.vector.SyncVectorEnv`.
    Worlds differ in their actions, after a reset with jitter in their starts, and with `world_parameters` in their
    constants.

    Worlds are reset together, and without divergence all end in the same frame. The step after that ignores its actions
    and starts the next episode of all worlds (`AutoresetMode.NEXT_STEP`).

    A world that diverges is terminated in that frame, with the reason in `infos["diverged"]`. It then waits until the
    others have ended: its observation stays the same, its reward is 0, `terminations` stays true, and `infos` has no
    entry for it. These steps belong to no episode.

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        num_envs: Number of worlds, 1 or more.
        render_mode: None or `rgb_array`.
        width: Picture width [pixels].
        height: Picture height [pixels].
        render_overlay: As for `GaugeEnv`.
        world_parameters: Overrides for each world, such as `[{"cube.friction": 0.25}, {"cube.friction": 0.30}]`; they
            come on top of `parameters`. Engines that cannot mix constants in one batch build such worlds one by one.
        **arguments: Keywords of `GaugeEnv`: `backend`, `parameters`, `settings`, ...

    Attributes:
        arguments: Variant and keywords.
        band: Band that rewards and scores are relative to, or None.
        worlds: The worlds.
        episodes: The current episode of each world.
        seeds_used: Seeds of the last reset; empty before the first.
        jitter: Jitter or trial of the last reset, or None.

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
        >>> [score.grade for score in infos["score"]]
        ['trials', 'trials', 'trials']
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        **EngineEnvironment.metadata,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        variant: str | Variant,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        render_overlay: bool = False,
        world_parameters: Sequence[Mapping[str, Any]] | None = None,
        **arguments: Unpack[EnvKeywords],
    ) -> None:
        _check_world_count(num_envs)
        pictures = Pictures(render_mode, width=width, height=height, has_overlay=render_overlay)
        self.arguments = EnvArguments(variant, **arguments)
        experiment = self.arguments.experiment()
        super().__init__(experiment, pictures, backend=self.arguments.backend, settings=self.arguments.settings)
        self.num_envs = num_envs
        self.band = self.arguments.band(experiment)
        self.seeds_used: tuple[int, ...] = ()
        self.jitter: Jitter | TrialStart | None = None
        self._stated = self._with_parameters(world_parameters)
        self._build(self._stated)
        first = self.episodes[0]
        self.single_action_space = first.action_space
        self.single_observation_space = first.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def _with_parameters(self, world_parameters: Sequence[Mapping[str, Any]] | None) -> list[Experiment]:
        """Return the experiment of each world, with its own constants."""
        if world_parameters is None:
            return [self.experiment] * self.num_envs
        if len(world_parameters) != self.num_envs:
            raise ParameterError(
                f"world_parameters has {len(world_parameters)} entries for {self.num_envs} worlds: give one for each"
            )
        common = dict(self.experiment.overrides)
        return [replace(self.arguments, parameters=common | dict(one)).experiment() for one in world_parameters]

    def _build(self, experiments: Sequence[Experiment]) -> None:
        self.worlds = worlds_of(self._engine, [one.scene for one in experiments], self._settings)
        self.episodes = [
            Episode(one, world, band=self._band_of(one), marker_proxy=self.arguments.proxy, backend=self.backend_name)
            for one, world in zip(experiments, self.worlds.worlds, strict=True)
        ]
        self._running: dict[int, Episode] = {}
        self._observations: list[Observation] = []
        self._is_reset = False
        self._has_no_record = False
        fits = EpisodesAtOnce.fits(self.episodes, self.worlds)
        self._at_once = EpisodesAtOnce(self.episodes, self.worlds) if fits else None

    def _band_of(self, experiment: Experiment) -> Band | None:
        """Return the band of a world: that of the stated start, or of the single-shot trial that it starts as."""
        if experiment.trial is not None or experiment.overrides != self.experiment.overrides:
            return self.arguments.band(experiment)
        return self.band

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode in every world.

        Args:
            seed: Seed of the engine and of the first world's jitter; each next world has one more. Or the seed of each
                world; the engine takes the first. None is 0.
            options: See `GaugeEnv.reset`. With `{"jitter": True}` each world has a start of its own; `{"trial": 3}`
                starts every world from imported trial 3. With single-shot trials each world starts from its seed's one.
        """
        seeds = self._seeds(seed)
        self._check_open("reset")
        super().reset(seed=seeds[0])
        self.seeds_used = seeds
        jitter = jitter_option(options or {})
        starts = [start_of(self.experiment, jitter, seed=one) for one in seeds]
        if starts[0] is not None or self.jitter is not None:
            experiments = [
                jittered_experiment(stated, start, seed=one, backend=self.backend_name)
                for stated, start, one in zip(self._stated, starts, seeds, strict=True)
            ]
            self._free()
            self._build(experiments)
        self.jitter = jitter
        self.worlds.reset(seeds[0])
        self._is_reset, self._has_no_record = True, False
        if self._at_once is not None:
            self._at_once.begin()
            return self._at_once.observations(), self._infos_at_once(self._at_once)
        for episode in self.episodes:
            episode.begin()
        self._running = dict(enumerate(self.episodes))
        self._observations = [episode.observation() for episode in self.episodes]
        return self._batched(), self._infos()

    def _seeds(self, seed: int | Sequence[int] | None) -> tuple[int, ...]:
        if seed is None or isinstance(seed, int | np.integer):
            first = 0 if seed is None else int(seed)
            return tuple(range(first, first + self.num_envs))
        if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
            raise ParameterError(f"seed {seed!r}: expected a number of 0 or more, or one for each world")
        if len(seed) != self.num_envs:
            raise ParameterError(
                f"{len(seed)} seeds for {self.num_envs} worlds: give one for each world, or a single number"
            )
        return tuple(seed)

    def step(self, actions: Any) -> Step:
        """Simulate one frame, 1/30 s, in every world; if all have ended, start the next episode of all instead.

        Args:
            actions: One action for each world.
        """
        self._check_started("step", started=self._is_reset)
        if self._at_once is not None:
            return self._step_at_once(self._at_once, actions)
        rewards = np.zeros(self.num_envs)
        if not self._running:
            observations, infos = self.reset()
            return observations, rewards, *self._flags(), infos
        advance_together(self._running, self.worlds, self._rates(actions))
        for number, episode in self._running.items():
            episode.end_frame()
            self._observations[number] = episode.observation()
            rewards[number] = episode.reward()
        infos = self._infos()
        self._running = {number: episode for number, episode in self._running.items() if not episode.is_over}
        return self._batched(), rewards, *self._flags(), infos

    def rollout(self, actions: Any = None, *, keep: bool = False) -> Rollout:
        """Simulate the whole episode after a reset, and return the scores of all worlds.

        Where the engine records on its device (Newton) and the experiment is a passive one of rigid bodies, no state is
        copied to the host before the end: there are no observations, rewards or infos. Other episodes are stepped. The
        result says which.

        Args:
            actions: Actions of each frame as `step` takes them, shape [frame_count - 1, num_envs, ...]; None is zero.
            keep: Whether to copy the record to the host at the end. `scores`, `score_arrays`, `render` and the records
                of `episodes` are then as after stepping. Otherwise the environment must be reset before anything else.
                Episodes that were stepped are always kept.
        """
        self._check_started("rollout", started=self._is_reset)
        if self.band is None:
            raise EpisodeError(f"{self.experiment.id}: it has no reference, and so no scores")
        if any(episode.frame for episode in self.episodes):
            raise EpisodeError(f"{self.experiment.id}: a rollout starts at frame 0, call reset before it")
        every = self._frame_actions(actions)
        if self._at_once is None or not self._at_once.can_roll_out:
            return self._stepped(every)
        if any(np.any(one) for one in every):
            self._rates(next(one for one in every if np.any(one)))
        recorded = self._at_once.roll_out()
        scores = recorded.scores()
        if keep:
            self._at_once.keep(recorded)
        self._is_reset, self._has_no_record = keep, not keep
        return Rollout(
            scores=scores, diverged=recorded.faults, frames=recorded.frames, device=recorded.recording.device
        )

    def _check_record(self, call: str) -> None:
        """Raise an error if the last episode left no record on the host."""
        if self._has_no_record:
            raise EpisodeError(
                f"{self.experiment.id}: the rollout kept no record; use rollout(keep=True), or call reset before {call}"
            )

    def _frame_actions(self, actions: Any) -> Any:
        count = self.experiment.frame_count - 1
        if actions is None:
            return np.zeros((count, *(self.action_space.shape or ())), dtype=self.action_space.dtype)
        if len(actions) != count:
            raise ActionError(f"{len(actions)} frames of actions for an episode of {count} steps")
        return actions

    def _stepped(self, actions: Any) -> Rollout:
        """Return the result of an episode that is stepped to its end."""
        for one in actions:
            self.step(one)
            if all(episode.is_over for episode in self.episodes):
                break
        return Rollout(
            scores=self.score_arrays(),
            diverged={number: one.fault for number, one in enumerate(self.episodes) if one.fault is not None},
            frames=np.array([episode.frame for episode in self.episodes]),
            device=None,
        )

    def _step_at_once(self, at_once: EpisodesAtOnce, actions: Any) -> Step:
        if not len(at_once.running):
            observations, infos = self.reset()
            return observations, np.zeros(self.num_envs), *self._flags(), infos
        # Episodes without drivers take zeros alone; any other action is an error, which `checked` states.
        if not (isinstance(actions, np.ndarray) and actions.shape == (self.num_envs,) and not actions.any()):
            self._rates(actions)
        at_once.step()
        infos = self._infos_at_once(at_once)
        observations, rewards = at_once.observations(), at_once.rewards()
        at_once.end_step()
        return observations, rewards, *self._flags(), infos

    def _infos_at_once(self, at_once: EpisodesAtOnce) -> dict[str, Any]:
        """Return the infos of the worlds that ran in this step, which differ in their divergence alone."""
        running = at_once.running
        infos = self._add_info({}, self.episodes[running[0]].info(), int(running[0]))
        for key in [key for key in infos if not key.startswith("_")]:
            infos[key][running], infos[f"_{key}"][running] = infos[key][running[0]], True
        for number in np.flatnonzero(at_once.diverged[running]).tolist():
            world = int(running[number])
            infos = self._add_info(infos, {"diverged": self.episodes[world].fault}, world)
        return infos

    def _rates(self, actions: Any) -> dict[int, NDArray[np.float64]]:
        """Return the residual rates of the running worlds; actions of the others are not read."""
        try:
            count = len(actions)
        except TypeError as error:
            raise ActionError(f"actions {actions!r}: expected one action for each of {self.num_envs} worlds") from error
        if count != self.num_envs:
            raise ActionError(f"{count} actions for {self.num_envs} worlds")
        running = self._running if self._at_once is None else self._at_once.running.tolist()
        return {number: self.episodes[number].checked(actions[number]) for number in running}

    def _batched(self) -> Observation:
        space = self.single_observation_space
        empty: Any = create_empty_array(space, self.num_envs)
        return cast("Observation", concatenate(space, self._observations, empty))

    def _flags(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return terminations and truncations, shape [num_envs] each."""
        if self._at_once is not None:
            return self._at_once.flags()
        diverged = np.array([episode.fault is not None for episode in self.episodes])
        return diverged, ~diverged & [episode.is_complete for episode in self.episodes]

    def _infos(self) -> dict[str, Any]:
        """Return the infos of the worlds that ran in this step."""
        infos: dict[str, Any] = {}
        for number, episode in self._running.items():
            diverged = {} if episode.fault is None else {"diverged": episode.fault}
            infos = self._add_info(infos, episode.info() | diverged, number)
        return infos

    def scores(self) -> tuple[Score | None, ...]:
        """Return the score of each world's episode, or None before it is over; see `GaugeEnv.score`."""
        self._check_record("scores")
        self._run_on()
        return tuple(episode.score() if episode.is_over else None for episode in self.episodes)

    def score_arrays(self) -> dict[str, NDArray[np.float64]]:
        """Return the scores of all worlds in one pass over their trajectories, as arrays of shape [num_envs].

        The keys are those of `Score`: `rmse` and, where they apply, `rmse_normalized`, `release_offset_s`,
        `rmse_aligned` and `rmse_aligned_normalized`. Entries of worlds whose episode is not over or diverged are NaN.
        A `Score` holds more, as intervals, and takes some milliseconds for each world.
        """
        self._check_record("score_arrays")
        if self.band is None:
            raise EpisodeError(f"{self.experiment.id}: it has no reference, and so no scores")
        self._run_on()
        if self._at_once is not None:
            times_s, samples = self._at_once.trajectories()
        else:
            times_s, samples = _padded([episode.trajectory().dense for episode in self.episodes])
        over = np.array([episode.is_over and episode.fault is None for episode in self.episodes])
        samples[~over] = np.nan
        return score_worlds(self.experiment, self.band, times_s=times_s, values=samples)

    def _run_on(self) -> None:
        if self._at_once is None:
            run_on_together(self.episodes, self.worlds)
        else:
            self._at_once.run_on()

    def deformations(self) -> tuple[DeformationScore | None, ...]:
        """Return the statistics of deformation of each world's episode; see `GaugeEnv.deformation`."""
        self._check_record("deformations")
        return tuple(episode.deformation() if episode.is_over else None for episode in self.episodes)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture of each world, shape [height, width, 3], or None without `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        self._check_started("render", started=self._is_reset)
        return tuple(episode_picture(self._pictures, one, drawn_as=self.episodes[0]) for one in self.episodes)

    def close_extras(self, **_: Any) -> None:
        """Free the worlds and the renderer."""
        self._is_closed = True
        self._free()

    def _free(self) -> None:
        self._pictures.close()
        self.worlds.close()


def _padded(
    trajectories: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the longest times [s], and trajectories of one length, shape [world_count, sample_count, width]."""
    times_s, longest = max(trajectories, key=lambda one: len(one[0]))
    samples = np.full((len(trajectories), *longest.shape), np.nan)
    for row, (_, values) in zip(samples, trajectories, strict=True):
        row[: len(values)] = values
    return times_s, samples


def _check_world_count(num_envs: object) -> None:
    """Raise an error for an impossible number of worlds."""
    if not isinstance(num_envs, int | np.integer) or isinstance(num_envs, bool) or not 1 <= num_envs <= WORLD_LIMIT:
        raise ParameterError(f"num_envs is {num_envs!r}, expected a whole number from 1 to {WORLD_LIMIT}")


class ScoreEpisodes(VectorWrapper):
    """Score each episode of a vector environment once, when it ends.

    Adds to `infos` at the step that ends an episode, in every autoreset mode: `score`, an array of `gauge_envs.Score`
    of shape [num_envs], None for a world whose episode did not end; and its mask `_score`. Scores that sub-environments
    of `gymnasium.make` have already added are kept. `deformation` and its mask `_deformation` have the same form.

    Args:
        env: A `GaugeVectorEnv`, or Gymnasium's `SyncVectorEnv` or `AsyncVectorEnv` of environments of this suite.
        arrays: Whether to add, in place of `score` and `deformation`, the arrays of `GaugeVectorEnv.score_arrays` with
            their masks, at the step that ends the last episode. Thousands of worlds are then scored in one pass.

    Example:
        >>> import gymnasium as gym
        >>> from gauge_envs import GaugeEnv
        >>> from gauge_envs.envs.vector import ScoreEpisodes
        >>> envs = gym.vector.SyncVectorEnv([lambda: GaugeEnv("SlopeSlider-2-wood")] * 2)
        >>> envs = ScoreEpisodes(envs)
        >>> _ = envs.reset(seed=0)
        >>> for _ in range(18):
        ...     *_, infos = envs.step([0, 0])
        >>> [round(score.rmse_normalized, 2) for score in infos["score"]]
        [0.41, 0.41]
    """

    def __init__(self, env: VectorEnv[Any, Any, NDArray[Any]], *, arrays: bool = False) -> None:
        super().__init__(env)
        if arrays and not isinstance(env.unwrapped, GaugeVectorEnv):
            raise ParameterError(f"arrays: expected a GaugeVectorEnv, got a {type(env.unwrapped).__name__}")
        self._arrays = arrays
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes."""
        self._over[:] = False
        # Gymnasium's vector environments take one seed for each world too; the annotation of their base class does not.
        return self.env.reset(seed=cast("int | None", seed), options=options)

    def step(self, actions: Any) -> Step:
        """Step, and score the episodes that end."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        over = terminations | truncations
        ended = np.flatnonzero(over & ~self._over).tolist()
        self._over = over
        if self._arrays:
            if ended and over.all():
                infos |= self._array_infos()
        elif ended and "score" not in infos:
            scores, deformations = self._ended(infos, "score"), self._ended(infos, "deformation")
            for number in ended:
                if scores[number] is not None:
                    added = {"score": scores[number], "deformation": deformations[number]}
                    infos = self._add_info(infos, added, number)
        return observations, rewards, terminations, truncations, infos

    def _array_infos(self) -> dict[str, NDArray[Any]]:
        env = self.env.unwrapped
        assert isinstance(env, GaugeVectorEnv)
        scores = {} if env.band is None else env.score_arrays()
        return scores | {f"_{key}": np.isfinite(values) for key, values in scores.items()}

    def _ended(self, infos: Mapping[str, Any], name: Literal["score", "deformation"]) -> Sequence[Any]:
        """Return what `GaugeEnv.score` or `GaugeEnv.deformation` returns, for each world."""
        env = self.env.unwrapped
        if isinstance(env, GaugeVectorEnv):
            return env.scores() if name == "score" else env.deformations()
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            return cast("SyncVectorEnv | AsyncVectorEnv", env).call(name)
        if "score" not in infos["final_info"]:
            raise EpisodeError(
                "the sub-environments restart in the step that ends an episode, so its score is lost. Make them with "
                "gymnasium.make, which scores each, or choose another autoreset mode."
            )
        return cast("Sequence[Any]", infos["final_info"][name])


def scored_vector_env(*, score_arrays: bool = False, **arguments: Any) -> ScoreEpisodes:
    """Return a `GaugeVectorEnv` that is scored; `gymnasium.make_vec` calls this for every id.

    Args:
        score_arrays: Argument `arrays` of `ScoreEpisodes`.
        **arguments: Arguments of `GaugeVectorEnv`.

    Warns:
        NoRewardWarning: The experiment has no reference in use, so that every reward is 0; once for each id.
    """
    envs = GaugeVectorEnv(**arguments)
    warn_without_reward(envs.experiment, envs.band)
    return ScoreEpisodes(envs, arrays=score_arrays)
