"""The Gymnasium environment: one experiment, stepped at the frame rate of its real trials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium

from gauge_envs.backends.registry import versions_of
from gauge_envs.envs.arguments import EnvArguments, checked_action
from gauge_envs.envs.initial_states import InitialStates, Scatter
from gauge_envs.envs.pictures import (
    RENDER_MODES,
    Pictures,
    Rendered,
    rollout_picture,
)
from gauge_envs.envs.rollout import Trajectory
from gauge_envs.envs.spaces import (
    Observation,
    action_space_of,
    observation_space_of,
)
from gauge_envs.errors import EpisodeError
from gauge_envs.experiments.variants import Variant
from gauge_envs.references.band import Band
from gauge_envs.scene.timing import FRAME_RATE_HZ

if TYPE_CHECKING:
    from gauge_envs.scoring.score import Score


class GaugeEnv(gymnasium.Env[Observation, Any]):
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
    added to the recorded one; the task file states its scale, `residual_rate_*`. Zeros replay the recorded motion.
    With `drivers="action"` there is no recorded motion, and zero leaves the driven bodies at rest.
    Without driven bodies the action is `Discrete(1)`.

    Reward: minus the mean z over band coordinates of |g - mean| / sigma at the frame, of the marker positions where the
    band has `points`; 0 without a reference. With deformable bodies it is -z / (1 + z), with the size of the motion in
    place of a smaller sigma.

    `info`: `frame`, `time_s`, `reference` (kind of the reference), `reference_source` and `drivers` (`bundled`,
    `imported` or `action`), `edited` if an edited asset states the scene, `trial` (its number) if the episode repeats
    one, and `diverged` (the reason) if the simulation diverged.
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
        jitter: Noise of the start of every episode. `real` draws starts as real hands scatter: recorded ones where
            the trials have a start each, elsewhere by the default `Jitter`. Or a `Jitter`, or its fields as a mapping.
        **arguments: Keywords of `gauge_envs.envs.arguments.EnvArguments`, with their defaults: `backend="mujoco"`,
            `parameters="calibrated"`, `settings=None`, `marker_proxy="material"`, `drivers="bundled"`,
            `reference="bundled"`, `asset=None`.

    Attributes:
        arguments: Variant and keywords.
        experiment: The experiment.
        rollout: The episode, in one world.
        seed_used: Seed of the last reset; None before the first.
        versions: Versions of the engine's packages.

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

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        "render_modes": [*RENDER_MODES],
        "render_fps": int(FRAME_RATE_HZ),
    }

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
        **arguments: Any,
    ) -> None:
        self.render_mode = render_mode
        self._pictures = Pictures(
            render_mode,
            width=width,
            height=height,
            camera=camera,
            has_overlay=render_overlay,
        )
        self.arguments = EnvArguments(variant, **arguments)
        self.experiment = self.arguments.experiment()
        self._initial_states = InitialStates(self.experiment, jitter)
        band = self.arguments.band(self.experiment)
        self.rollout = self.arguments.rollout([self.experiment], [band])
        self.versions = versions_of(self.arguments.backend)
        self.seed_used: int | None = None
        self.action_space = action_space_of(self.experiment)
        self.observation_space = observation_space_of(self.experiment)
        self._is_closed = False

    @property
    def band(self) -> Band | None:
        """Band that rewards and the score of the episode are relative to, or None."""
        return self.rollout.bands[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode from the motion-capture initial state.

        Args:
            seed: Seed of the engine and of the noise, and of the random numbers that seed later resets without one.
            options: Options stay in force for later resets, as those of an autoreset, until a reset passes a seed or
                options.

                - `{"jitter": True}` moves the start at random by the default `Jitter`, as repeats of a real trial
                  scatter. A `Jitter` gives other standard deviations; False takes the argument `jitter` back.
                - `{"trial": 3}` starts from the positions and velocities of imported trial 3, see
                  `gauge_envs.envs.trial_start.trial_states`, or replays a bundled trial with its own driven path,
                  which then scores it.

                An experiment with single-shot trials starts from trial `seed` modulo their number without an option.

        Raises:
            EpisodeError: The environment is closed.
            ParameterError: There is no such option or trial, or the scene has no start that can scatter.
        """
        self._check_open("reset")
        super().reset(seed=seed)
        draw = self._initial_states.of_reset(options, seeded=seed is not None)
        self.seed_used = self._initial_states.seed_of(seed, draw, self.np_random)
        start = self._initial_states.sample(draw, self.seed_used)
        self.rollout.reset([start], self.seed_used)
        self._show()
        return self._observation(), self.rollout.info(0)

    def step(
        self, action: Any
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulate one frame, 1/30 s.

        Raises:
            ActionError: The action has the wrong shape, is out of range or is not a number.
            EpisodeError: The environment was not reset, or the episode is over.
        """
        self._check_started("step")
        rollout = self.rollout
        if rollout.is_over[0]:
            raise EpisodeError(f"{self.experiment.id}: the episode is over, call reset")
        rollout.step(checked_action(action, self.action_space)[None])
        self._show()
        terminated = 0 in rollout.diverged
        truncated = rollout.is_complete and not terminated
        reward = float(rollout.rewards()[0])
        return self._observation(), reward, terminated, truncated, rollout.info(0)

    def _observation(self) -> Observation:
        return {name: rows[0] for name, rows in self.rollout.observation().items()}

    def trajectory(self) -> Trajectory:
        """Return what the current episode has recorded so far.

        Raises:
            EpisodeError: The environment was not reset.
        """
        return self.rollout.trajectory()

    def score(self) -> Score | None:
        """Return the score of the episode, or None before it is over.

        An experiment that starts with a release is simulated on by 10 frames first, for the release alignment. The
        score of an episode that diverged has a kind and no number.
        """
        self._check_open("score")
        if self.rollout.frame is None or not self.rollout.is_over[0]:
            return None
        return self.rollout.score()

    def render(self) -> Rendered | None:
        """Return a picture of the scene in the form of the render mode; None without one, and with a window.

        Raises:
            RenderError: The machine has no OpenGL library.
            EpisodeError: The environment was not reset.
        """
        if self.render_mode is None:
            return None
        self._check_started("render")
        return rollout_picture(self._pictures, self.rollout)

    def close(self) -> None:
        """Free the simulation and the renderer. A second call does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._pictures.close()
            self.rollout.simulation.close()

    def _show(self) -> None:
        """Draw what a reset or a step has reached, in the window if there is one."""
        if self.render_mode == "human":
            self.render()

    def _check_open(self, call: str) -> None:
        if self._is_closed:
            raise EpisodeError(
                f"{self.experiment.id}: {call} after close; make the environment again"
            )

    def _check_started(self, call: str) -> None:
        self._check_open(call)
        if self.rollout.frame is None:
            raise EpisodeError(f"{self.experiment.id}: call reset before {call}")
