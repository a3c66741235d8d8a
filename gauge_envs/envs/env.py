"""The Gymnasium environment: one experiment, stepped at the frame rate of its real trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from gauge_envs.backends.base import Backend, Simulation
from gauge_envs.backends.registry import backend_for
from gauge_envs.envs.arguments import check_support, jitter_option, plain_spec
from gauge_envs.envs.episode import Episode, Observation, Trajectory
from gauge_envs.envs.rendering.lazy import RENDER_MODES, Pictures
from gauge_envs.errors import BackendError, EpisodeError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import resolve_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.observables.observer import checked_proxy
from gauge_envs.scene.jitter import Jitter, jittered
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "GaugeEnv",
]


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

    `info`: `frame`, `time_s`, `reference` (grade of the band), `reference_source` and `drivers` (where band and driven
    motion are from, `bundled` or `imported`), where the scene is that of an edited asset `edited`, and
    when the simulation diverged `diverged` (why).

    Copies and pickles are environments of their own that go on bit for bit from where this one is, also in another
    process, where the same versions of the engine are installed.

    Args:
        variant: Name of the variant, as `SlopeSlider-2-wood`.
        backend: Name of an installed physics engine.
        parameters: `calibrated`, another parameter set of the task file, or overrides such as
            `{"cube.friction": 0.3}`.
        settings: Numerical settings of the backend that replace its defaults.
        marker_proxy: What stands for a marker on a deformable body: `node`, the nearest node, as in the paper; or
            `material`, its own material point between the nodes.
        drivers: `bundled` moves driven bodies as the task file states, `imported` as the imported trials show.
        reference: `bundled` scores against what the package has, `imported` against the imported trials.
        asset: File that the scene is from, instead of the task file: a USD layer for any backend, an MJCF file for
            `mujoco`. It states constants and driven motion; what is observed, and what it is scored against, stay the
            variant's. For `GAUGE/Asset` it is an experiment file, as `crate.toml`; docs/assets.md.
        use_withheld: Score on a band too that is withheld by default; `gauge show` tells why it is.
        render_mode: None or `rgb_array`.
        width: Picture width [pixels].
        height: Picture height [pixels].

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
        >>> info["frame"], info["score"].grade
        (18, 'trials')
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        "render_modes": [*RENDER_MODES],
        "render_fps": int(FRAME_RATE_HZ),
    }
    _spec: EnvSpec | None = None

    def __init__(
        self,
        variant: str,
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
        self._pictures = Pictures(render_mode, width=width, height=height)
        self.experiment = resolve_experiment(variant, parameters, drivers=drivers, reference=reference, asset=asset)
        self.backend_name = backend
        self.render_mode = render_mode
        self.band = reference_band(self.experiment, use_withheld=use_withheld)
        self.seed_used: int | None = None
        self.jitter: Jitter | None = None
        self._settings = settings
        self._marker_proxy = checked_proxy(marker_proxy)
        check_support(self.experiment, backend)
        self.versions = self._engine.versions()
        self._build(self.experiment)
        self.action_space = self.episode.action_space
        self.observation_space = self.episode.observation_space

    @property
    def _engine(self) -> Backend:
        return backend_for(self.backend_name, self.experiment.model_file)

    def _build(self, experiment: Experiment) -> None:
        self.simulation: Simulation = self._engine.build(experiment.scene, self._settings)
        self.episode = Episode(experiment, self.simulation, band=self.band, marker_proxy=self._marker_proxy)

    # --- copies ---

    def __getstate__(self) -> dict[str, Any]:
        """What `__setstate__` needs to build the same run again and to put it where it was."""
        # An engine's model does not pickle, and what it is built from does.
        built = ("simulation", "episode")
        return {
            "attributes": {name: value for name, value in vars(self).items() if name not in built},
            "experiment": self.episode.experiment,
            "simulation": self.simulation.state(),
            "episode": self.episode.state(),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Build the same run again, and go on from where it was.

        Raises:
            BackendError: Other versions of the engine are installed here.
            MissingExtraError: The engine is not installed here.
        """
        vars(self).update(state["attributes"])
        installed = self._engine.versions()
        if installed != self.versions:
            raise BackendError(
                f"{self.experiment.id}: pickled with {self.versions}, but here are {installed}: "
                "a state goes on only in the engine that it is from"
            )
        self._build(state["experiment"])
        self.simulation.restore(state["simulation"])
        self.episode.restore(state["episode"])

    @property
    def spec(self) -> EnvSpec | None:  # type: ignore[override]  # gymnasium declares a variable, and assigns to it
        """How `gymnasium.make` makes this environment again; its arguments are plain enough for JSON."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = plain_spec(spec)

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
        jitter = jitter_option(options or {})
        if jitter is not None or self.jitter is not None:
            scene = self.experiment.scene
            if jitter is not None:
                scene = jittered(scene, jitter, seed=self.seed_used)
            experiment = replace(self.experiment, scene=scene)
            check_support(experiment, self.backend_name)
            self._pictures.close()
            self.simulation.close()
            self._build(experiment)
        self.jitter = jitter
        self.simulation.reset(self.seed_used)
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
            raise EpisodeError(f"{self.experiment.id}: call reset before step")
        if episode.is_over:
            raise EpisodeError(f"{self.experiment.id}: the episode is over, call reset")
        episode.advance(self.simulation, episode.checked(action))
        fault = episode.end_frame()
        truncated = not fault and episode.is_complete
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

    def score(self) -> Score | None:
        """Score of the episode; None until it is over. One that diverged has a grade and nothing else."""
        return self.episode.score() if self.episode.is_over else None

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
            raise EpisodeError(f"{self.experiment.id}: call reset before render")
        return self._pictures.draw(
            self.experiment.scene, episode.rest_nodes_m, poses=episode.poses(), nodes_m=episode.nodes_m()
        )

    def close(self) -> None:
        """Free the simulation and the renderer."""
        self._pictures.close()
        self.simulation.close()
