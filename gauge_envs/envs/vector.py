"""Vector environments: many worlds of one experiment at once, and scores of whatever vector environment holds them.

`gymnasium.make_vec(id, num_envs=6)` makes a `GaugeVectorEnv` within `ScoreEpisodes`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any, ClassVar, cast

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from numpy.typing import NDArray

from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.arguments import check_support, jitter_option, plain_spec
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.episode import Episode, Observation, advance_together
from gauge_envs.envs.rendering.lazy import Pictures
from gauge_envs.errors import ActionError, EpisodeError, ParameterError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import resolve_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.observables.observer import checked_proxy
from gauge_envs.scene.jitter import Jitter, jittered

__all__ = [
    "GaugeVectorEnv",
    "ScoreEpisodes",
    "scored_vector_env",
]

Step = tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class GaugeVectorEnv(VectorEnv[Observation, Any, NDArray[Any]]):
    """Worlds of one experiment in lockstep on one backend, which may simulate them at once.

    Each world is what `GaugeEnv` is, frame by frame; spaces, rewards and `infos` are those of
    `gymnasium.vector.SyncVectorEnv`. Worlds differ in their starts, where a reset lets these scatter, and in their
    actions.

    Worlds are reset together, and without divergence all end in the same frame; the step after that starts the next
    episode of all (`AutoresetMode.NEXT_STEP`) and ignores its actions. A world that diverges is terminated in that
    frame, with the reason in `infos["diverged"]`, and waits for the others: until they have ended its observation
    stands still, its reward is 0, `terminations` stays true and `infos` say nothing more of it. So what follows a
    termination is no part of an episode, as in every vector environment of that mode; it may last for more than one
    step.

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        num_envs: Number of worlds, 1 or more.
        backend: As of `GaugeEnv`, as all that follow.
        parameters: As of `GaugeEnv`.
        settings: As of `GaugeEnv`.
        marker_proxy: As of `GaugeEnv`.
        use_withheld: As of `GaugeEnv`.
        drivers: As of `GaugeEnv`.
        reference: As of `GaugeEnv`.
        asset: As of `GaugeEnv`.
        render_mode: As of `GaugeEnv`.
        width: As of `GaugeEnv`.
        height: As of `GaugeEnv`.

    Raises:
        GaugeError: As of `GaugeEnv`.
        ParameterError: There are no worlds.

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
        **GaugeEnv.metadata,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    _spec: EnvSpec | None = None

    def __init__(
        self,
        variant: str,
        num_envs: int = 1,
        *,
        backend: str = "mujoco",
        parameters: Parameters = "calibrated",
        settings: Mapping[str, Any] | None = None,
        marker_proxy: str = "node",
        use_withheld: bool = False,
        drivers: str = "bundled",
        reference: str = "bundled",
        asset: str | PathLike[str] | None = None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        if num_envs < 1:
            raise ParameterError(f"num_envs is {num_envs}, expected 1 or more")
        self._pictures = Pictures(render_mode, width=width, height=height)
        self.num_envs = num_envs
        self.experiment = resolve_experiment(variant, parameters, drivers=drivers, reference=reference, asset=asset)
        self.backend_name = backend
        self.render_mode = render_mode
        self.band = reference_band(self.experiment, use_withheld=use_withheld)
        self.seeds_used: tuple[int, ...] = ()
        self.jitter: Jitter | None = None
        self._settings = settings
        self._marker_proxy = checked_proxy(marker_proxy)
        check_support(self.experiment, backend)
        self._build([self.experiment] * num_envs)
        first = self.episodes[0]
        self.single_action_space = first.action_space
        self.single_observation_space = first.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def _build(self, experiment: Sequence[Experiment]) -> None:
        scenes = [one.scene for one in experiment]
        self.worlds = backend_for(self.backend_name, self.experiment.model_file).build_worlds(scenes, self._settings)
        self.episodes = [
            Episode(one, world, band=self.band, marker_proxy=self._marker_proxy)
            for one, world in zip(experiment, self.worlds.worlds, strict=True)
        ]
        self._running: dict[int, Episode] = {}
        self._observations: list[Observation] = []

    @property
    def spec(self) -> EnvSpec | None:  # type: ignore[override]  # gymnasium declares a variable, and assigns to it
        """How `gymnasium.make_vec` makes this environment again; its arguments are plain enough for JSON."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = plain_spec(spec)

    # --- episodes ---

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode in every world.

        Args:
            seed: Seed of the engine and of the first world's jitter, each next world having one more; or the seed of
                each world, of which the engine takes the first. None is 0.
            options: As of `GaugeEnv.reset`: `{"jitter": True}`, after which each world starts elsewhere.

        Raises:
            ParameterError: There is no such option, nothing can be jittered, or the number of seeds is wrong.
            UnsupportedSceneError: The backend cannot build the scene from one of the starts.
        """
        seeds = self._seeds(seed)
        super().reset(seed=seeds[0])
        self.seeds_used = seeds
        jitter = jitter_option(options or {})
        if jitter is not None or self.jitter is not None:
            self._rebuild(jitter)
        self.jitter = jitter
        self.worlds.reset(seeds[0])
        for episode in self.episodes:
            episode.begin()
        self._running = dict(enumerate(self.episodes))
        self._observations = [episode.observation() for episode in self.episodes]
        return self._batched(), self._infos()

    def _seeds(self, seed: int | Sequence[int] | None) -> tuple[int, ...]:
        if seed is None or isinstance(seed, int | np.integer):
            first = 0 if seed is None else int(seed)
            return tuple(range(first, first + self.num_envs))
        if len(seed) != self.num_envs:
            raise ParameterError(f"{len(seed)} seeds for {self.num_envs} worlds: expected one a world, or a number")
        return tuple(seed)

    def _rebuild(self, jitter: Jitter | None) -> None:
        scene = self.experiment.scene
        scenes = [scene if jitter is None else jittered(scene, jitter, seed=seed) for seed in self.seeds_used]
        experiment = [replace(self.experiment, scene=one) for one in scenes]
        for one in experiment:
            check_support(one, self.backend_name)
        self._pictures.close()
        self.worlds.close()
        self._build(experiment)

    def step(self, actions: Any) -> Step:
        """Simulate one frame, 1/30 s, in every world; where all have ended, start the next episode of all instead.

        Args:
            actions: One action a world.

        Raises:
            ActionError: An action has the wrong shape, is out of range or is not a number, or their number is wrong.
            EpisodeError: The environment was not reset.
        """
        rewards = np.zeros(self.num_envs)
        if not self._observations:
            raise EpisodeError(f"{self.experiment.id}: call reset before step")
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

    def _rates(self, actions: Any) -> dict[int, NDArray[np.float64]]:
        """Residual rates of the worlds that go on; what is asked of the others is not looked at."""
        try:
            count = len(actions)
        except TypeError as error:
            raise ActionError(f"actions {actions!r}: expected one action for each of {self.num_envs} worlds") from error
        if count != self.num_envs:
            raise ActionError(f"{count} actions for {self.num_envs} worlds")
        return {number: episode.checked(actions[number]) for number, episode in self._running.items()}

    def _batched(self) -> Observation:
        space = self.single_observation_space
        empty: Any = create_empty_array(space, self.num_envs)
        return cast("Observation", concatenate(space, self._observations, empty))

    def _flags(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Terminations and truncations, shape [num_envs] each."""
        diverged = np.array([episode.fault is not None for episode in self.episodes])
        return diverged, ~diverged & [episode.is_complete for episode in self.episodes]

    def _infos(self) -> dict[str, Any]:
        """Infos of the worlds that were going on until now."""
        infos: dict[str, Any] = {}
        for number, episode in self._running.items():
            diverged = {} if episode.fault is None else {"diverged": episode.fault}
            infos = self._add_info(infos, episode.info() | diverged, number)
        return infos

    def scores(self) -> tuple[Score | None, ...]:
        """Score of each world's episode; None until it is over, as of `GaugeEnv.score`."""
        return tuple(episode.score() if episode.is_over else None for episode in self.episodes)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Pictures of the worlds now, each of shape [height, width, 3]; None without `render_mode="rgb_array"`.

        Raises:
            RenderError: The machine has no OpenGL library.
            EpisodeError: The environment was not reset.
        """
        if self.render_mode is None:
            return None
        if not self._observations:
            raise EpisodeError(f"{self.experiment.id}: call reset before render")
        first = self.episodes[0]
        return tuple(
            self._pictures.draw(
                first.experiment.scene, first.rest_nodes_m, poses=episode.poses(), nodes_m=episode.nodes_m()
            )
            for episode in self.episodes
        )

    def close_extras(self, **_: Any) -> None:
        """Free the worlds and the renderer."""
        self._pictures.close()
        self.worlds.close()


class ScoreEpisodes(VectorWrapper):
    """Scores the episodes of a vector environment as they end, each once.

    Adds to `infos` at the step that ends an episode: `score`, an array of `gauge_envs.Score` of shape [num_envs] with
    None where no episode ended, and its mask `_score`; so it is in every autoreset mode. Sub-environments of
    `gymnasium.make` bring their scores themselves, which this finds and leaves.

    Args:
        env: A `GaugeVectorEnv`, or Gymnasium's `SyncVectorEnv` or `AsyncVectorEnv` of environments of this suite.

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

    def __init__(self, env: VectorEnv[Any, Any, NDArray[Any]]) -> None:
        super().__init__(env)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes."""
        self._over[:] = False
        # Gymnasium's own vector environments take a seed for each world too, though their base class does not say so.
        return self.env.reset(seed=cast("int | None", seed), options=options)

    def step(self, actions: Any) -> Step:
        """Step, and score what ends.

        Raises:
            EpisodeError: A sub-environment has restarted in the step that ended its episode, and has not scored it.
        """
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        over = terminations | truncations
        ended = np.flatnonzero(over & ~self._over).tolist()
        self._over = over
        if ended and "score" not in infos:
            scores = self._scores(infos)
            for number in ended:
                if scores[number] is not None:
                    infos = self._add_info(infos, {"score": scores[number]}, number)
        return observations, rewards, terminations, truncations, infos

    def _scores(self, infos: Mapping[str, Any]) -> Sequence[Score | None]:
        env = self.env.unwrapped
        if isinstance(env, GaugeVectorEnv):
            return env.scores()
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            return cast("SyncVectorEnv | AsyncVectorEnv", env).call("score")
        if "score" not in infos["final_info"]:
            raise EpisodeError(
                "the sub-environments restart in the step that ends an episode, and it can no longer be scored: make "
                "them with gymnasium.make, which scores each, or choose another autoreset mode"
            )
        return infos["final_info"]["score"]


def scored_vector_env(**arguments: Any) -> ScoreEpisodes:
    """What `gymnasium.make_vec` calls for every id: a `GaugeVectorEnv` that is scored.

    Args:
        **arguments: As of `GaugeVectorEnv`.

    Raises:
        GaugeError: As of `GaugeVectorEnv`.
    """
    return ScoreEpisodes(GaugeVectorEnv(**arguments))
