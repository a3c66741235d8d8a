"""The Gymnasium environment: one experiment, stepped at the frame rate of its real trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation
from gauge_envs.backends.registry import backend as find_backend
from gauge_envs.backends.registry import backend_names
from gauge_envs.episode import Episode, Observation, Trajectory, reference_band
from gauge_envs.errors import EpisodeError, GaugeError, ParameterError, UnsupportedSceneError
from gauge_envs.experiment import Experiment, Parameters, experiment
from gauge_envs.jitter import Jitter, jittered
from gauge_envs.observer import checked_proxy
from gauge_envs.task_format import FRAME_RATE_HZ

__all__ = ["GaugeEnv", "check_support"]


class GaugeEnv(gymnasium.Env[Observation, Any]):
    """One experiment of the GAUGE benchmark.

    An episode starts from the motion-capture initial state and lasts the published number of frames; `reset` returns
    frame 0 and each `step` the next one, 1/30 s later. The last frame truncates the episode; a simulation that
    diverges terminates it.

    | observation  | shape       | what                                                                         |
    |--------------|-------------|------------------------------------------------------------------------------|
    | `observable` | [C]         | generalized trajectory g(t): mm, rad or mm^2                                 |
    | `bodies`     | [N, 13]     | recorded bodies: position m, quaternion wxyz, velocity m/s, spin rad/s       |
    | `markers`    | [M, 3]      | markers, m; instead of `bodies` where a deformable body is recorded          |
    | `driver`     | [D, 13]     | driven bodies, likewise; only where something is driven                      |
    | `time`       | [1]         | s                                                                            |

    Action: where a body is driven, a Box in [-1, 1] with one entry a motion of the driver, a velocity that is added to
    the recorded one (scale: `residual_rate_*` in the task file); zero replays the recorded motion. Elsewhere
    `Discrete(1)`.

    Reward: minus the mean over band coordinates of |g - mean| / sigma at the frame; 0 where there is no reference.

    `info`: `frame`, `time_s`, `reference` (grade of the band) and, when the simulation diverged, `diverged` (why).

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        backend: Name of an installed physics engine.
        parameters: `calibrated`, another parameter set of the task file, or overrides such as
            `{"cube.friction": 0.3}`.
        settings: Numerical settings of the backend that replace its defaults.
        marker_proxy: What stands for a marker on a deformable body: `node`, the nearest node, as in the paper; or
            `material`, its own material point between the nodes.
        drivers: `imported` drives bodies as imported trials show, `bundled` as the task file states; None takes what
            `gauge data use` chose, `imported` unless it was asked otherwise.
        use_withheld: Score on a band too that is withheld by default; `gauge show` tells why it is.
        render_mode: None or `rgb_array`.
        width: Picture width [pixels].
        height: Picture height [pixels].

    Raises:
        UnknownNameError: No such variant or backend.
        ParameterError: A parameter or setting does not exist or is out of range.
        UnsupportedSceneError: The backend cannot build the scene.

    Example:
        >>> import gymnasium as gym, gauge_envs
        >>> env = gym.make("GAUGE/SlopeSlider-2-wood")
        >>> observation, info = env.reset(seed=0)
        >>> terminated = truncated = False
        >>> while not (terminated or truncated):
        ...     observation, reward, terminated, truncated, info = env.step(0)
        >>> info["frame"], info["score"].grade
        (18, 'trials')
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        "render_modes": ["rgb_array"],
        "render_fps": int(FRAME_RATE_HZ),
    }

    def __init__(
        self,
        variant: str,
        *,
        backend: str = "mujoco",
        parameters: Parameters = "calibrated",
        settings: Mapping[str, Any] | None = None,
        marker_proxy: str = "node",
        use_withheld: bool = False,
        drivers: str | None = None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ParameterError(f"render_mode {render_mode!r}: choose None or 'rgb_array'")
        self.experiment = experiment(variant, parameters, drivers=drivers)
        self.backend_name = backend
        self.render_mode = render_mode
        self.band = reference_band(self.experiment, use_withheld=use_withheld)
        self.seed_used: int | None = None
        self.jitter: Jitter | None = None
        self._settings = settings
        self._marker_proxy = checked_proxy(marker_proxy)
        self._picture_size = (width, height)
        self._renderer: Any = None
        self._over = False
        check_support(self.experiment, backend)
        self.versions = find_backend(backend).versions()
        self._build(self.experiment)
        self.action_space = self.episode.action_space
        self.observation_space = self.episode.observation_space

    def _build(self, resolved: Experiment) -> None:
        self.simulation: Simulation = find_backend(self.backend_name).build(resolved.scene, self._settings)
        self.episode = Episode(resolved, self.simulation, band=self.band, marker_proxy=self._marker_proxy)

    # --- episode ---

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict]:
        """Start a new episode from the motion-capture initial state.

        Args:
            seed: Seed of the engine and of the jitter.
            options: `{"jitter": True}` moves the start as real hands do, by the default `Jitter`; a `Jitter` by its
                own. The scene is built anew, so it takes as long as making the environment.

        Raises:
            ParameterError: There is no such option, or nothing in the scene can be jittered.
            UnsupportedSceneError: The backend cannot build the scene from that start.
        """
        super().reset(seed=seed)
        self.seed_used = 0 if seed is None else seed
        jitter = _jitter_option(options or {})
        if jitter is not None or self.jitter is not None:
            scene = self.experiment.scene
            if jitter is not None:
                scene = jittered(scene, jitter, seed=self.seed_used)
            resolved = replace(self.experiment, scene=scene)
            check_support(resolved, self.backend_name)
            self._close_renderer()
            self.simulation.close()
            self._build(resolved)
        self.jitter = jitter
        self.simulation.reset(self.seed_used)
        self._over = False
        self.episode.begin()
        return self.episode.observation(), self.episode.info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulate one frame, 1/30 s.

        Raises:
            ActionError: The action has the wrong shape, is out of range or is not a number.
            EpisodeError: The environment was not reset, or the episode is over.
        """
        episode = self.episode
        if episode.frame is None:
            raise EpisodeError(f"{self.experiment.variant.id}: call reset before step")
        if self._over:
            raise EpisodeError(f"{self.experiment.variant.id}: the episode is over, call reset")
        episode.advance(self.simulation, episode.checked(action))
        fault = episode.end_frame()
        truncated = not fault and episode.is_complete
        self._over = bool(fault) or truncated
        info = episode.info()
        if fault:
            info["diverged"] = fault
        return episode.observation(), episode.reward(), bool(fault), truncated, info

    def trajectory(self) -> Trajectory:
        """What the current episode recorded so far.

        Raises:
            EpisodeError: The environment was not reset.
        """
        return self.episode.trajectory()

    def render(self) -> NDArray[np.uint8] | None:
        """Picture of the scene now, shape [height, width, 3]; None without `render_mode="rgb_array"`.

        Raises:
            RenderError: The machine has no OpenGL library.
            EpisodeError: The environment was not reset.
        """
        if self.render_mode is None:
            return None
        episode = self.episode
        if episode.frame is None:
            raise EpisodeError(f"{self.experiment.variant.id}: call reset before render")
        if self._renderer is None:
            from gauge_envs.rendering import SceneRenderer

            self._renderer = SceneRenderer(self.experiment.scene, episode.rest_nodes_m, *self._picture_size)
        poses = dict(zip(episode.moving, self.simulation.body_states(episode.moving)[:, :7], strict=True))
        return self._renderer.picture(poses, episode.nodes_m())

    def close(self) -> None:
        """Free the simulation and the renderer."""
        self._close_renderer()
        self.simulation.close()

    def _close_renderer(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _jitter_option(options: Mapping[str, Any]) -> Jitter | None:
    unknown = [repr(key) for key in options if key != "jitter"]
    if unknown:
        raise ParameterError(f"reset knows the option 'jitter' alone, got {', '.join(unknown)}")
    value = options.get("jitter", False)
    if isinstance(value, bool):
        return Jitter() if value else None
    if not isinstance(value, Jitter):
        raise ParameterError(f"option 'jitter' is {value!r}, expected True, False or a gauge_envs.Jitter")
    return value


def check_support(resolved: Experiment, backend: str) -> None:
    """Raise when a backend cannot build an experiment.

    Raises:
        UnknownNameError: No such backend.
        MissingExtraError: Its engine is not installed.
        UnsupportedSceneError: It declines; the message gives its reasons, and a backend that can.
    """
    support = find_backend(backend).supports(resolved.scene)
    if not support:
        raise UnsupportedSceneError(_unsupported_message(resolved, backend, support.missing))


def _unsupported_message(resolved: Experiment, asked: str, missing: tuple[str, ...]) -> str:
    able = []
    for name in backend_names():
        try:
            if name != asked and find_backend(name).supports(resolved.scene):
                able.append(name)
        except GaugeError:
            continue
    reasons = "; ".join(missing)
    others = f"backend={able[0]!r} can" if able else "no installed backend can run this experiment yet"
    return f"{resolved.variant.id}: backend {asked!r} cannot build it: {reasons}; {others}"
