"""The vector environment of many worlds of one experiment, and the wrapper that scores any vector environment.

`gymnasium.make_vec(id, num_envs=6)` makes a `GaugeVectorEnv` within `ScoreEpisodes`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, Unpack, cast

import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import (
    AsyncVectorEnv,
    AutoresetMode,
    SyncVectorEnv,
    VectorEnv,
    VectorWrapper,
)
from numpy.typing import NDArray

from gauge_envs.backends.device import DeviceWorlds
from gauge_envs.backends.worlds import Worlds
from gauge_envs.envs.arguments import (
    EnvArguments,
    EnvKeywords,
    Scatter,
    Starts,
    TrialStart,
    check_episode_steps,
    drawn_seed,
    jittered_experiment,
    start_of,
    warn_without_reward,
)
from gauge_envs.envs.at_once import episodes_in_lockstep
from gauge_envs.envs.base import WorldsEnvironment, world_constants
from gauge_envs.envs.device import EpisodesOnDevice, dynamic_states
from gauge_envs.envs.episode import Episode
from gauge_envs.envs.lockstep import EpisodesOneByOne
from gauge_envs.envs.pictures import (
    WORLDS_RENDER_MODES,
    Pictures,
    Rendered,
    episode_picture,
)
from gauge_envs.envs.spaces import Observation
from gauge_envs.errors import EpisodeError, ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.references.kind import Kind
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.jitter import Jitter, jittered
from gauge_envs.scoring.reference import refusal
from gauge_envs.scoring.score import Score
from gauge_envs.scoring.worlds import score_worlds

Step = tuple[
    Observation,
    FloatArray,
    BoolArray,
    BoolArray,
    dict[str, Any],
]


START_COUNT = 1024
"""Smallest number of random starts from which episodes draw theirs."""


class GaugeVectorEnv(WorldsEnvironment[Observation]):
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
        render_mode: None, `rgb_array`, `depth_array` or `rgbd_tuple`, as for `GaugeEnv`.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace those of the scene's camera: `target_m`, `distance_m`, `azimuth_deg` and
            `elevation_deg`.
        render_overlay: As for `GaugeEnv`.
        jitter: As for `GaugeEnv`; each world has starts of its own.
        world_parameters: Overrides for each world, such as `[{"cube.friction": 0.25}, {"cube.friction": 0.30}]`; they
            come on top of `parameters`. Engines that cannot mix constants in one batch build such worlds one by one.
        **arguments: Keywords of `GaugeEnv`: `backend`, `parameters`, `settings`, ...

    Attributes:
        arguments: Variant and keywords.
        band: Band that rewards and scores are relative to, or None.
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
        >>> [score.kind for score in infos["score"]]
        ['trials', 'trials', 'trials']
    """

    _lockstep: EpisodesOneByOne

    def __init__(
        self,
        variant: str | Variant,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        render_overlay: bool = False,
        jitter: Scatter = None,
        world_parameters: Sequence[Mapping[str, Any]] | None = None,
        **arguments: Unpack[EnvKeywords],
    ) -> None:
        constants = world_constants(num_envs, world_parameters)
        pictures = Pictures(
            render_mode,
            width=width,
            height=height,
            camera=camera,
            has_overlay=render_overlay,
            modes=WORLDS_RENDER_MODES,
        )
        self.arguments = EnvArguments(variant, **arguments)
        experiment = self.arguments.experiment()
        super().__init__(
            experiment,
            pictures,
            backend=self.arguments.backend,
            settings=self.arguments.settings,
        )
        band = self.arguments.band(experiment)
        # A model is the solution of the calibrated scene, and not of worlds with other constants.
        is_another = (
            band is not None
            and band.kind is Kind.NUMERICAL
            and any(world_parameters or ())
        )
        self.band = None if is_another else band
        self._starts = Starts(experiment, jitter)
        self._randoms: list[np.random.Generator] = []
        self.seeds_used: tuple[int, ...] = ()
        self.jitter: Jitter | TrialStart | None = None
        common = dict(experiment.overrides)
        self._stated = [
            replace(self.arguments, parameters=common | dict(one)).experiment()
            if one
            else experiment
            for one in constants
        ]
        self._bands = [
            self.band if one is experiment else self.arguments.band(one)
            for one in self._stated
        ]
        self._build(self._stated)
        self._set_spaces(num_envs, self.episodes[0])

    def _build(self, experiments: Sequence[Experiment]) -> None:
        kept: Worlds | None = None
        if "_lockstep" in vars(self):
            if self.worlds.start_at([one.scene for one in experiments]):
                self._pictures.free()
                if all(map(Episode.start_at, self.episodes, experiments)):
                    return
                kept = self.worlds
            else:
                self._free()
        self._lockstep = episodes_in_lockstep(
            self.arguments, experiments, self._bands, worlds=kept
        )
        self._is_reset = False

    @property
    def worlds(self) -> Worlds:
        """The worlds."""
        return self._lockstep.worlds

    @property
    def episodes(self) -> Sequence[Episode]:
        """The current episode of each world."""
        return self._lockstep.episodes

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode in every world.

        Args:
            seed: Seed of the engine and of the first world's jitter; each next world has one more. Or the seed of each
                world; the engine takes the first. None is 0; where starts scatter, the
                random numbers of each world draw its seed, as at autoreset.
            options: See `GaugeEnv.reset`; they hold for autoreset. With `{"jitter": True}` each world has a start of
                its own; `{"trial": 3}` starts every world from imported trial 3. With single-shot trials each world
                starts from its seed's one.
        """
        stated = [None] * self.num_envs if seed is None else self._seeds(seed)
        self._check_open("reset")
        jitter = self._starts.of_reset(options, seeded=seed is not None)
        if seed is not None or not self._randoms:
            self._randoms = [np_random(one)[0] for one in stated]
        seeds = [*range(self.num_envs)]
        if seed is not None or jitter is not None:
            seeds = [
                drawn_seed(one, jitter, random)
                for one, random in zip(stated, self._randoms, strict=True)
            ]
        super().reset(seed=seeds[0])
        self.seeds_used = tuple(seeds)
        starts = [start_of(self.experiment, jitter, seed=one) for one in seeds]
        if any(starts) or self.jitter is not None:
            experiments = [
                jittered_experiment(stated, start, seed=one)
                for stated, start, one in zip(self._stated, starts, seeds, strict=True)
            ]
            self._build(experiments)
        self.jitter = starts[0]
        self._is_reset = True
        self._lockstep.begin(seeds[0])
        return self._lockstep.observations(), self._lockstep.infos(self._add_info)

    def step(self, actions: Any) -> Step:
        """Simulate one frame, 1/30 s, in every world; if all have ended, start the next episode of all instead.

        Args:
            actions: One action for each world.
        """
        self._check_started("step", started=self._is_reset)
        if not len(self._lockstep.running):
            observations, infos = self.reset()
            return observations, np.zeros(self.num_envs), *self._lockstep.flags(), infos
        self._lockstep.step(actions)
        rewards, infos = self._lockstep.rewards(), self._lockstep.infos(self._add_info)
        return self._lockstep.observations(), rewards, *self._lockstep.flags(), infos

    def scores(self) -> tuple[Score | None, ...]:
        """Return the score of each world's episode, or None before it is over; see `GaugeEnv.score`."""
        self._lockstep.run_on()
        return tuple(
            episode.score() if episode.is_over else None for episode in self.episodes
        )

    def score_arrays(self) -> dict[str, FloatArray]:
        """Return the scores of all worlds in one pass over their trajectories, as arrays of shape [num_envs].

        The keys are those of `Score`: `rmse` and, where they apply, `rmse_normalized`, `time_offset_s`, `rmse_aligned`
        and `rmse_aligned_normalized`. Entries are NaN of worlds whose episode is not over or diverged, and of those
        that the reference does not score (`Score.refused`). A `Score` has more, and takes some milliseconds.
        """
        if self.band is None:
            raise EpisodeError(
                f"{self.experiment.id}: it has no reference, and so no scores"
            )
        self._lockstep.run_on()
        times_s, samples = self._lockstep.trajectories()
        over = np.array(
            [
                one.is_over
                and one.fault is None
                and refusal(one.experiment, one.band) is None
                for one in self.episodes
            ]
        )
        samples[~over] = np.nan
        scores: dict[str, FloatArray] = {}
        # Worlds may replay different trials; each band scores its worlds in one pass.
        bands = [one.band for one in self.episodes if one.band is not None]
        for band in {id(one): one for one in bands}.values():
            rows = [one.band is band for one in self.episodes]
            found = score_worlds(
                self.experiment, band, times_s=times_s, values=samples[rows]
            )
            for key, values in found.items():
                scores.setdefault(key, np.full(self.num_envs, np.nan))[rows] = values
        return scores

    def _picture(self, number: int) -> Rendered | None:
        return episode_picture(
            self._pictures, self.episodes[number], drawn_as=self.episodes[0]
        )

    def _free(self) -> None:
        super()._free()
        self.worlds.close()


class DeviceVectorEnv(GaugeVectorEnv):
    """Worlds of one experiment of rigid bodies in arrays of the engine's device: `make_vec(id, mode="device")`.

    It has the spaces, the starts, the rewards and the scores of `GaugeVectorEnv`, but for rounding in the engine's
    precision. What differs:

    - Observations, rewards, terminations, truncations and scores are arrays of the engine's library. Actions may be;
      they are clipped to -1 and 1.
    - All worlds run to the last frame of the experiment, and start their next episode in the step after it, also with
      random starts. A world that diverges is terminated from then on and keeps its observation; its reward is 0, and
      its scores are NaN. No reason is given.
    - A reset draws a random start for each world, and for 1,024 at least. Each later episode takes one of them
      in each world, without repetition among the worlds.
    - `infos` has `frame` and `time_s`, and at the last frame the arrays of `GaugeVectorEnv.score_arrays`.
    - There are no pictures, trials, or records of single worlds.

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        num_envs: Number of worlds.
        **arguments: Other arguments of `GaugeVectorEnv`.

    Raises:
        UnsupportedSceneError: The experiment has deformable bodies, or observes no positions.
        BackendError: The engine has no arrays on a device.
    """

    _lockstep: EpisodesOnDevice  # type: ignore[assignment]  # the parent's other methods that need records raise

    def _build(self, experiments: Sequence[Experiment]) -> None:
        if self.render_mode is not None:
            raise ParameterError("render_mode: worlds on a device have no pictures")
        self._lockstep = EpisodesOnDevice(
            self.arguments, experiments, self.experiment, self.band
        )
        self._starts_m: Any = None
        self._order = np.random.default_rng(0)
        self._is_reset = False

    @property
    def worlds_on_device(self) -> DeviceWorlds:
        """The worlds in arrays of the device."""
        return self._lockstep.device

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a new episode in every world.

        Args:
            seed: As for `GaugeVectorEnv.reset`; None draws seeds where starts scatter.
            options: `{"jitter": ...}`, as for `GaugeEnv.reset`; it holds for the next episodes.
        """
        self._check_open("reset")
        jitter = self._starts.of_reset(options, seeded=seed is not None)
        if not isinstance(jitter, Jitter | None):
            raise ParameterError(
                f"{self.experiment.id}: trials do not start worlds on a device"
            )
        stated = [None] * self.num_envs if seed is None else self._seeds(seed)
        seeds = [drawn_seed(one, jitter, self._order) for one in stated]
        self._order = np.random.default_rng(seeds[0])
        self.seeds_used, self.jitter = tuple(seeds), jitter
        self._starts_m = None
        if jitter is not None:
            later = range(seeds[-1] + 1, seeds[-1] + 1 + START_COUNT - len(seeds))
            scene = self.experiment.scene
            starts = [
                dynamic_states(jittered(scene, jitter, seed=one))
                for one in (*seeds, *later)
            ]
            self._starts_m = self._lockstep.device.asarray(np.stack(starts))
        self._is_reset = True
        return self._begin(np.arange(self.num_envs))

    def _begin(self, order: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode in all worlds, from random starts of some numbers if starts scatter."""
        starts = self._starts_m
        if starts is not None:
            starts = starts[self._lockstep.device.asarray(order)]
        self._lockstep.start(starts)
        return self._lockstep.observation(), self._lockstep.info()

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        """Simulate one frame, 1/30 s, in every world; after the last one, start the next episode of all instead.

        Args:
            actions: Actions of all worlds, shape [num_envs, ...]; on the device, or a NumPy array.
        """
        self._check_started("step", started=self._is_reset)
        episodes = self._lockstep
        if episodes.is_complete:
            count = self.num_envs if self._starts_m is None else len(self._starts_m)
            order = self._order.choice(count, self.num_envs, replace=False)
            observation, info = self._begin(order)
            return observation, *episodes.nothing(), info
        rewards = episodes.advance(actions)
        over = (episodes.diverged, episodes.truncations())
        return episodes.observation(), rewards, *over, episodes.info()

    def scores(self) -> Any:
        """Raise an error."""
        raise EpisodeError(
            f"{self.experiment.id}: the record stays on the device; infos has scores at the end"
        )

    score_arrays = scores


class ScoreEpisodes(VectorWrapper):
    """Score each episode of a vector environment once, when it ends.

    Adds to `infos` at the step that ends an episode, in every autoreset mode: `score`, an array of `gauge_envs.Score`
    of shape [num_envs], None for a world whose episode did not end; and its mask `_score`. Scores that sub-environments
    of `gymnasium.make` have already added are kept.

    Args:
        env: A `GaugeVectorEnv`, or Gymnasium's `SyncVectorEnv` or `AsyncVectorEnv` of environments of this suite.
        arrays: Whether to add, in place of `score`, the arrays of `GaugeVectorEnv.score_arrays` with
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

    def __init__(
        self, env: VectorEnv[Any, Any, NDArray[Any]], *, arrays: bool = False
    ) -> None:
        super().__init__(env)
        if arrays and not isinstance(env.unwrapped, GaugeVectorEnv):
            raise ParameterError(
                f"arrays: expected a GaugeVectorEnv, got a {type(env.unwrapped).__name__}"
            )
        self._arrays = arrays
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
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
            env = self.env.unwrapped
            assert isinstance(env, GaugeVectorEnv)
            if ended and over.all() and env.band is not None:
                scores = env.score_arrays()
                infos |= scores | {
                    f"_{key}": np.isfinite(values) for key, values in scores.items()
                }
        elif ended and "score" not in infos:
            found = self._ended(infos)
            for number in ended:
                if found[number] is not None:
                    infos = self._add_info(infos, {"score": found[number]}, number)
        return observations, rewards, terminations, truncations, infos

    def _ended(self, infos: Mapping[str, Any]) -> Sequence[Any]:
        """Return what `GaugeEnv.score` returns, for each world."""
        env = self.env.unwrapped
        if isinstance(env, GaugeVectorEnv):
            return env.scores()
        env = cast("SyncVectorEnv | AsyncVectorEnv", env)
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            return env.call("score")
        final = infos["final_info"]
        last = env.get_attr("experiment")[0].frame_count - 1
        if "score" not in final and ("diverged" in final or last in final["frame"]):
            raise EpisodeError(
                "the sub-environments restart in the step that ends an episode, so its score is lost. Make them with "
                "gymnasium.make, which scores each, or choose another autoreset mode."
            )
        none: list[None] = [None] * self.num_envs
        return cast("Sequence[Any]", final.get("score", none))


def scored_vector_env(
    *,
    mode: Literal["host", "device"] = "host",
    score: bool = True,
    score_arrays: bool = False,
    max_episode_steps: int | None = None,
    **arguments: Any,
) -> ScoreEpisodes | GaugeVectorEnv:
    """Return a `GaugeVectorEnv` that is scored; `gymnasium.make_vec` calls this for every id.

    Args:
        mode: `device` makes a `DeviceVectorEnv`, whose arrays stay on the engine's device and which scores itself.
        score: Whether to score each episode; training needs rewards alone.
        score_arrays: Argument `arrays` of `ScoreEpisodes`.
        max_episode_steps: Steps of an episode, as `gymnasium.make_vec` repeats them from the spec.
        **arguments: Arguments of `GaugeVectorEnv`.

    Raises:
        ParameterError: Other `max_episode_steps` than those of the experiment, or an argument would change nothing.

    Warns:
        NoRewardWarning: The experiment has no reference in use, so that every reward is 0; once for each id.
    """
    if not score and (score_arrays or mode == "device"):
        raise ParameterError(
            "score=False goes with separate scores alone: leave out score_arrays=True and mode='device', or score=False"
        )
    if mode not in ("host", "device"):
        raise ParameterError(f"mode is {mode!r}, expected 'host' or 'device'")
    if mode == "device":
        envs: GaugeVectorEnv = DeviceVectorEnv(**arguments)
    else:
        envs = GaugeVectorEnv(**arguments)
    envs.arguments.check_read(envs.experiment)
    if score_arrays and envs.band is None:
        raise ParameterError(
            f"{envs.experiment.id}: score_arrays=True would change nothing: it has no reference, and so no scores"
        )
    check_episode_steps(max_episode_steps, envs.experiment.frame_count - 1)
    warn_without_reward(envs.experiment, envs.band)
    if mode == "device" or not score:
        return envs
    return ScoreEpisodes(envs, arrays=score_arrays)
