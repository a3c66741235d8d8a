"""The Gymnasium environment: one experiment at the frame rate of its real trials."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium

from gauge_envs.backends.registry import versions_of
from gauge_envs.envs.arguments import EnvArguments, checked_action
from gauge_envs.envs.guards import GuardedEnv, one_thread
from gauge_envs.envs.initial_states import InitialStates, Scatter
from gauge_envs.envs.pictures import (
    RENDER_MODES,
    Pictures,
    Rendered,
    rollout_picture,
)
from gauge_envs.envs.recording import Trajectory
from gauge_envs.envs.spaces import (
    Observation,
    action_space_of,
    observation_space_of,
)
from gauge_envs.envs.world_references import WorldReferences
from gauge_envs.errors import EpisodeError
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant
from gauge_envs.observables.observer import MarkerProxy
from gauge_envs.references.band import Band
from gauge_envs.references.user_data import DataSource
from gauge_envs.scene.timing import FRAME_RATE_HZ

if TYPE_CHECKING:
    from gauge_envs.scoring.score import Score


class GaugeEnv(GuardedEnv, gymnasium.Env[Observation, Any]):
    """One experiment of the GAUGE benchmark.

    An episode starts from the motion-capture initial state and has the published number of frames. `reset` returns
    frame 0, and each `step` returns the next frame, 1/30 s later. The last frame truncates the episode. Divergence of
    the simulation terminates it.

    | observation  | shape   | meaning                                                                            |
    |--------------|---------|------------------------------------------------------------------------------------|
    | `observable` | [C]     | generalized trajectory g(t): mm, rad or mm^2                                       |
    | `bodies`     | [N, 13] | recorded bodies: position m, quaternion wxyz, velocity m/s, angular velocity rad/s |
    | `markers`    | [M, 3]  | markers, m; in place of `bodies` if a deformable body is recorded                  |
    | `driver`     | [D, 13] | driven bodies, in the form of `bodies`; only if the experiment has driven bodies    |
    | `time`       | [1]     | s                                                                                  |

    Action: with driven bodies, a Box in [-1, 1] with one entry for each degree of freedom of the drivers. It is a
    velocity added to the recorded one; its scale is `residual_rate_*` of the task file. Zeros replay the recorded
    motion. With `drivers="action"` there is no recorded motion, and zeros leave the driven bodies at rest. Without
    driven bodies the action is `Discrete(1)`.

    Reward: -z, where z is the mean over coordinates of |g - mean| / sigma at the frame; 0 without a reference. If the
    reference has `points`, z compares marker positions. With deformable bodies the reward is -z / (1 + z), and sigma is
    at least the size of the motion.

    `info`: `frame`, `time_s`, `reference` (its kind), `reference_source` and `drivers` (`bundled`, `imported` or
    `action`). Further: `edited` if the scene is that of an edited asset, `trial` (its number) if the episode replays
    one, and `diverged` (the reason) after divergence. `gymnasium.make` adds `score` at the end, see `ScoreEpisode`.

    Args:
        variant: Variant, its name, or its Gymnasium id, as `SlopeSlider-2-wood`; or the path of a task file, as
            `crate.toml`.
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
        render_mode: None; `human`, a window that `reset` and `step` draw; `rgb_array`; `depth_array`, the distance from
            the camera plane [m], float32; or `rgbd_tuple`, both.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace those of the scene's camera: `target_m` [m], `distance_m` [m], `azimuth_deg` and
            `elevation_deg` [degrees].
        render_overlay: Whether pictures also show the tracked points, their paths, and the positions of the reference,
            if g(t) has positions. Off by default, because a policy that learns from pictures must not see the
            reference.
        jitter: Initial-state noise of every episode: a `Jitter`, its fields as a mapping, or `real`. `real` draws
            recorded initial states if each trial has its own, else noise of the default `Jitter`.

    Attributes:
        arguments: Variant and keywords.
        experiment: The experiment.
        rollout: The episode in one world.
        seed_used: Seed of the last reset; None before the first.
        versions: Versions of the engine's packages.

    Raises:
        UnknownNameError: No such variant, backend or argument.
        ParameterError: A parameter or setting does not exist or is out of range.
        UnsupportedSceneError: The backend cannot build the scene.
        AssetError: The asset cannot be used.

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
    ) -> None:
        self.render_mode = render_mode
        self._pictures = Pictures(
            render_mode,
            width=width,
            height=height,
            camera=camera,
            has_overlay=render_overlay,
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
        self.experiment = self.arguments.experiment()
        self._initial_states = InitialStates(self.experiment, jitter)
        self.rollout = self.arguments.rollout([self.experiment])
        self.references = WorldReferences(self.rollout)
        self.versions = versions_of(self.arguments.backend)
        self.seed_used: int | None = None
        self.action_space = action_space_of(self.experiment)
        self.observation_space = observation_space_of(self.experiment)
        self._name = self.experiment.id

    @property
    def band(self) -> Band | None:
        """Reference of the rewards and the score of the episode, or None."""
        return self.references.bands[0]

    @one_thread
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode from the motion-capture initial state.

        Args:
            seed: Seed of the engine and of the noise. It also seeds later resets without a seed.
            options: They stay effective for later resets, such as an autoreset, until a reset passes a seed or options.

                - `{"jitter": True}` adds noise of the default `Jitter` to the initial state. A `Jitter` gives other
                  standard deviations; False disables the argument `jitter`.
                - `{"trial": 3}` starts from the positions and velocities of imported trial 3, see
                  `gauge_envs.envs.trial_start.trial_states`. Or it replays bundled trial 3 with its own driven path;
                  this trial is then the reference.

                Without options, an experiment with single-trial recordings starts from trial `seed` modulo their
                number.

        Raises:
            EpisodeError: The environment is closed.
            ParameterError: There is no such option or trial, or noise can move no body of the scene.
        """
        self._check_open("reset")
        super().reset(seed=seed)
        draw = self._initial_states.of_reset(options, seeded=seed is not None)
        self.seed_used = self._initial_states.seed_of(seed, draw, self.np_random)
        start = self._initial_states.sample(draw, self.seed_used)
        self.rollout.reset([start], self.seed_used)
        self.references.start()
        self._show()
        return self._observation(), self._info()

    @one_thread
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
        checked = checked_action(action, self.action_space, self.experiment.id)
        rollout.step(checked[None])
        self._show()
        terminated = 0 in rollout.diverged
        truncated = bool(rollout.is_over[0]) and not terminated
        reward = float(self.references.rewards()[0])
        return self._observation(), reward, terminated, truncated, self._info()

    def _observation(self) -> Observation:
        observations = self.rollout.recording.observation()
        return {name: rows[0] for name, rows in observations.items()}

    def _info(self) -> dict[str, Any]:
        rollout = self.rollout
        frame = int(rollout.frames[0])
        info = {"frame": frame, "time_s": frame / FRAME_RATE_HZ, **rollout.info(0)}
        return {**info, "reference": self.references.kind(0)}

    @one_thread
    def trajectory(self) -> Trajectory:
        """Return the recorded motion of the current episode so far.

        Raises:
            EpisodeError: The environment was not reset.
        """
        if not self.rollout.has_begun:
            raise EpisodeError(f"{self.experiment.id}: no trajectory before reset")
        return self.rollout.recording.trajectory()

    @one_thread
    def score(self) -> Score | None:
        """Return the score of the episode, or None before it is over.

        The score of a diverged episode has no numbers.
        """
        self._check_open("score")
        if not self.rollout.has_begun or not self.rollout.is_over[0]:
            return None
        return self.references.score()

    @one_thread
    def render(self) -> Rendered | None:
        """Return a picture of the scene in the form of the render mode; None without a mode and with a window.

        Raises:
            RenderError: The machine has no OpenGL library.
            EpisodeError: The environment was not reset.
        """
        if self.render_mode is None:
            return None
        self._check_started("render")
        return rollout_picture(self._pictures, self.rollout, self.references.bands)

    @one_thread
    def close(self) -> None:
        """Free the simulation and the renderer. A second call does nothing."""
        if not self.closed:
            self.closed = True
            self._pictures.close()
            self.rollout.simulation.close()

    def _show(self) -> None:
        """Draw the current frame in the window if there is one."""
        if self.render_mode == "human":
            self.render()
