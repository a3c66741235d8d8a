"""The Gymnasium environment: one experiment, stepped at the frame rate of its real trials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Unpack

from gauge_envs.envs.arguments import (
    EnvArguments,
    EnvKeywords,
    Scatter,
    Starts,
    TrialStart,
    drawn_seed,
    jittered_experiment,
    start_of,
)
from gauge_envs.envs.base import SimulationEnvironment
from gauge_envs.envs.episode import Episode, Trajectory
from gauge_envs.envs.pictures import Pictures, Rendered, episode_picture
from gauge_envs.envs.spaces import Observation
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.variants import Variant
from gauge_envs.scene.jitter import Jitter

if TYPE_CHECKING:
    from gauge_envs.scoring.score import Score


class GaugeEnv(SimulationEnvironment[Observation, Any]):
    """One experiment of the GAUGE benchmark.

    An episode starts from the motion-capture initial state and has the published number of frames. `reset` returns
    frame 0, and each `step` the next one, 1/30 s later. The last frame truncates the episode. A simulation that
    diverges terminates it.

    | observation  | shape   | meaning                                                                            |
    |--------------|---------|------------------------------------------------------------------------------------|
    | `observable` | [C]     | generalized trajectory g(t): mm, rad or mm^2                                       |
    | `bodies`     | [N, 13] | recorded bodies: position m, quaternion wxyz, velocity m/s, angular velocity rad/s |
    | `markers`    | [M, 3]  | markers, m; in place of `bodies` if a deformable body is recorded                  |
    | `driver`     | [D, 13] | driven bodies, in the form of `bodies`; only if the experiment has any             |
    | `time`       | [1]     | s                                                                                  |

    Action: with driven bodies, a Box in [-1, 1] with one entry for each motion of a driver. It is a velocity that is
    added to the recorded one; the task file states its scale, `residual_rate_*`. Zero replays the recorded motion.
    With `drivers="action"` there is no recorded motion, and zero leaves the driven bodies at rest.
    Without driven bodies the action is `Discrete(1)`.

    Reward: minus the mean z over band coordinates of |g - mean| / sigma at the frame, of the marker positions where the
    band has `points`; 0 without a reference. With deformable bodies it is -z / (1 + z), with the size of the motion in
    place of a smaller sigma.

    `info`: `frame`, `time_s`, `reference` (kind of the reference), `reference_source` and `drivers` (`bundled`,
    `imported` or `action`), `edited` if an edited asset states the scene, and `diverged` (the reason) if the
    simulation diverged.
    `gymnasium.make` adds `score` at the end; see `ScoreEpisode`.

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        render_mode: None; `human` for a window that the mouse turns, drawn by `reset` and `step`; `rgb_array`;
            `depth_array`, the distance from the plane of the camera [m], float32; `rgbd_tuple`, both.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace those of the scene's camera: `target_m`, `distance_m`, `azimuth_deg` and
            `elevation_deg`.
        render_overlay: Whether pictures also show the tracked points, their paths so far, and the places of the
            reference, as far as g(t) is of positions. Off by default: a policy that learns from pictures must not see
            the reference, and pictures of different references stay comparable.
        jitter: Scatter of the start of every episode. `real` draws starts as real hands scatter: recorded ones where
            the trials have a start each, elsewhere by the default `Jitter`. Or a `Jitter`, or its fields as a mapping.
        **arguments: Keywords of `gauge_envs.envs.arguments.EnvArguments`, with their defaults: `backend="mujoco"`,
            `parameters="calibrated"`, `settings=None`, `marker_proxy="material"`, `drivers="bundled"`,
            `reference="bundled"`, `asset=None`.

    Attributes:
        arguments: Variant and keywords.
        band: Band that rewards and scores are relative to, or None.
        episode: The current episode.
        seed_used: Seed of the last reset; None before the first.
        jitter: Jitter or trial of the last reset, or None.

    Raises:
        UnknownNameError: No such variant or backend.
        ParameterError: A parameter or setting does not exist or is out of range.
        UnsupportedSceneError: The backend cannot build the scene.
        AssetError: The asset cannot be used; the message names file, place and reason.

    Example:
        >>> import gymnasium as gym, gauge_envs
        >>> env = gym.make("GAUGE/SlopeSlider-2-wood")
        >>> observation, info = env.reset(seed=0)
        >>> terminated = truncated = False
        >>> while not (terminated or truncated):
        ...     observation, reward, terminated, truncated, info = env.step(0)
        >>> info["frame"], info["score"].kind
        (18, 'trials')
    """

    episode: Episode

    def __init__(
        self,
        variant: str | Variant,
        *,
        render_mode: str | None = None,
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        render_overlay: bool = False,
        jitter: Scatter = None,
        **arguments: Unpack[EnvKeywords],
    ) -> None:
        pictures = Pictures(
            render_mode,
            width=width,
            height=height,
            camera=camera,
            has_overlay=render_overlay,
        )
        self.arguments = EnvArguments(variant, **arguments)
        experiment = self.arguments.experiment()
        super().__init__(
            experiment,
            pictures,
            backend=self.arguments.backend,
            settings=self.arguments.settings,
        )
        self.band = self._stated_band = self.arguments.band(experiment)
        self._starts = Starts(experiment, jitter)
        self.seed_used: int | None = None
        self.jitter: Jitter | TrialStart | None = None
        self._build(experiment)
        self.action_space = self.episode.action_space
        self.observation_space = self.episode.observation_space

    def _build(self, experiment: Experiment) -> bool:
        is_kept = super()._build(experiment)
        if is_kept and self.episode.start_at(experiment):
            return True
        self.episode = Episode(
            experiment,
            self.simulation,
            band=self.band,
            marker_proxy=self.arguments.proxy,
        )
        return is_kept

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode from the motion-capture initial state.

        Args:
            seed: Seed of the engine and of the jitter, and of the random numbers that seed later resets without one.
            options: They hold for the next resets too, which an autoreset calls without any, until a reset has a seed
                or options. `{"jitter": True}` moves the start at random by the default `Jitter`, as repeats of a real
                trial scatter; a `Jitter` states other standard deviations, and False takes the argument `jitter` back.
                `{"trial": 3}` starts from the positions and velocities of imported trial 3, see
                `gauge_envs.envs.trial_start.trial_scene`, or replays a bundled one with its own driven path, which then
                scores it. An engine that cannot place the start in what it has built builds the scene anew. An
                experiment with single-shot trials starts from one of them without an option too: from trial `seed`
                modulo their number.

        Raises:
            EpisodeError: The environment is closed.
            ParameterError: There is no such option or trial, or the scene has no start that can be jittered.
            UnsupportedSceneError: The backend cannot build the scene from that start.
        """
        self._check_open("reset")
        super().reset(seed=seed)
        scatter = self._starts.of_reset(options, seeded=seed is not None)
        self.seed_used = drawn_seed(seed, scatter, self.np_random)
        jitter = start_of(self.experiment, scatter, seed=self.seed_used)
        if jitter is not None or self.jitter is not None:
            experiment = jittered_experiment(
                self.experiment, jitter, seed=self.seed_used
            )
            self.band = self._stated_band
            if experiment.trial is not None:
                self.band = self.arguments.band(experiment)
            self._build(experiment)
        self.jitter = jitter
        self.simulation.reset(self.seed_used)
        self.episode.begin()
        self._show()
        return self.episode.observation(), self.episode.info()

    def step(
        self, action: Any
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulate one frame, 1/30 s.

        Raises:
            ActionError: The action has the wrong shape, is out of range or is not a number.
            EpisodeError: The environment was not reset, or the episode is over.
        """
        episode = self.episode
        self._check_running(started=episode.frame is not None, is_over=episode.is_over)
        episode.advance(episode.checked(action))
        fault = episode.end_frame()
        truncated = not fault and episode.is_complete
        self._show()
        return (
            episode.observation(),
            episode.reward(),
            bool(fault),
            truncated,
            episode.info(),
        )

    def trajectory(self) -> Trajectory:
        """Return what the current episode has recorded so far.

        Raises:
            EpisodeError: The environment was not reset.
        """
        return self.episode.trajectory()

    def score(self) -> Score | None:
        """Return the score of the episode, or None before it is over.

        An experiment that starts with a release is simulated on by 10 frames first, for the release alignment. The
        score of an episode that diverged has a kind and no number.
        """
        if not self.episode.is_over:
            return None
        self.episode.run_on()
        return self.episode.score()

    def render(self) -> Rendered | None:
        """Return a picture of the scene in the form of the render mode; None without one, and with a window.

        Raises:
            RenderError: The machine has no OpenGL library.
            EpisodeError: The environment was not reset.
        """
        if self.render_mode is None:
            return None

        episode = self.episode
        self._check_started("render", started=episode.frame is not None)
        return episode_picture(self._pictures, episode, drawn_as=episode)
