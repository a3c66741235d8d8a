"""What control tasks share: a calibrated scene whose driver is the action, stepped at the frame rate of the trials."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gauge_envs.backends.base import Simulation
from gauge_envs.backends.registry import backend as find_backend
from gauge_envs.backends.settings import check_drive_interval
from gauge_envs.envs.arguments import check_support
from gauge_envs.envs.control.limit import Ending, Limit, LimitReport
from gauge_envs.envs.rendering.lazy import RENDER_MODES, Pictures
from gauge_envs.errors import ActionError, EpisodeError, ParameterError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant, find_variant
from gauge_envs.scene import Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.timing import FRAME_RATE_HZ

__all__ = [
    "ControlEnv",
]

FloatArray = NDArray[np.float64]


class ControlEnv(gymnasium.Env[FloatArray, NDArray[np.float32]], ABC):
    """A control task whose true optimum a law gives, in a calibrated scene of the benchmark.

    One step is 1/30 s, in six intervals of 1/180 s in which the action is constant. The action is a Box [-1, 1] of one
    entry; what it commands, and the observation, the reward and its proof are the subclass's.

    `info`: `frame`, `time_s` and, when the simulation diverged, `diverged` (why). Copies and pickles go on bit for bit
    from where the environment is.

    Args:
        variant: Experiment whose scene it is, as `Turntable-1-wood`.
        backend: Name of an installed physics engine.
        parameters: `calibrated`, another parameter set of the task file, or overrides as `{"cube.friction": 0.3}`.
        settings: Numerical settings of the backend that replace its defaults.
        render_mode: None or `rgb_array`.
        width: Picture width [pixels].
        height: Picture height [pixels].

    Attributes:
        FAMILY: Family of the experiment whose scene it is.
        LAW: The law, in words and symbols.
        SIGMA_SOURCE: Where the uncertainty of the limit is from.
        DURATION_S: Length of an episode [s].
        OBSERVED: Names of the observation's entries, with units.
        experiment: The experiment whose scene it is, as it is built.
        simulation: The running scene.
        limit: What the law allows.

    Raises:
        UnknownNameError: No such variant or backend.
        ParameterError: A parameter or setting does not exist or is out of range.
        UnsupportedSceneError: The backend cannot build the scene.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium declares it without ClassVar
        "render_modes": [*RENDER_MODES],
        "render_fps": int(FRAME_RATE_HZ),
    }
    FAMILY: ClassVar[str]
    LAW: ClassVar[str]
    SIGMA_SOURCE: ClassVar[str]
    DURATION_S: ClassVar[float]
    OBSERVED: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        variant: str,
        *,
        backend: str = "mujoco",
        parameters: Parameters = "calibrated",
        settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        self._pictures = Pictures(render_mode, width=width, height=height)
        self.render_mode = render_mode
        chosen = find_variant(variant)
        experiment = load_experiment(chosen, self._placed(chosen, parameters))
        scene = replace(experiment.scene, drivers=self._drivers(experiment.scene), duration_s=self.DURATION_S)
        self.experiment = replace(experiment, scene=scene, frame_count=self.frame_count)
        self.backend_name = backend
        self._settings = settings
        check_support(self.experiment, backend)
        self._build()
        check_drive_interval(self.simulation.settings)
        self._dynamic = tuple(body.name for body in scene.dynamic_bodies)
        self._frame: int | None = None
        self._ending: Ending | None = None
        self._observations: list[FloatArray] = []
        self.limit = self._limit()
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(self.OBSERVED),), np.float64)
        # Learners act in single precision.
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def _build(self) -> None:
        self.simulation: Simulation = find_backend(self.backend_name).build(self.experiment.scene, self._settings)

    def __getstate__(self) -> dict[str, Any]:
        """What `__setstate__` needs to build the same run again and to put it where it was."""
        # An engine's model does not pickle, and what it is built from does.
        kept = {name: value for name, value in vars(self).items() if name != "simulation"}
        return {"attributes": kept, "simulation": self.simulation.state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Build the same run again, and go on from where it was."""
        vars(self).update(state["attributes"])
        self._build()
        self.simulation.restore(state["simulation"])

    # --- what a task states ---

    def _placed(self, variant: Variant, parameters: Parameters) -> Parameters:
        """The parameters, with the start of the task where it is not that of the experiment."""
        return parameters

    @abstractmethod
    def _drivers(self, scene: Scene) -> tuple[Driver, ...]:
        """Drivers that move nothing by themselves and say how fast actions may."""

    @abstractmethod
    def _limit(self) -> Limit:
        """What the law allows."""

    @abstractmethod
    def _begin(self) -> None:
        """Take note of the start; the world stands at it."""

    @abstractmethod
    def _advance(self, command: float) -> tuple[float, Ending | None]:
        """Simulate a frame; its reward, and how it ended the episode, if it did."""

    @abstractmethod
    def _observation(self) -> FloatArray:
        """Observation now, in the order of `OBSERVED`."""

    @abstractmethod
    def _reached(self) -> float:
        """What the policy has reached so far, in the unit of the limit."""

    @abstractmethod
    def _law_command(self, fraction: float) -> float:
        """What `law_action` returns, as a number that need not be in range."""

    def law_action(self, fraction: float) -> NDArray[np.float32]:
        """Action, now, of the policy that the law itself suggests.

        Args:
            fraction: How much of the law's limit it uses; just below 1 succeeds in an engine that obeys the law, and
                just above 1 fails.
        """
        return np.clip(np.array([self._law_command(fraction)], dtype=np.float32), -1.0, 1.0)

    _at_time_limit: ClassVar[Ending]

    # --- episode ---

    @property
    def frame_count(self) -> int:
        """Frames of an episode, the first included."""
        return round(self.DURATION_S * FRAME_RATE_HZ) + 1

    @property
    def time_s(self) -> float:
        """Time since the start of the episode [s]."""
        return (self._frame or 0) / FRAME_RATE_HZ

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[FloatArray, dict]:
        """Start a new episode; the start is always the same, and there are no options."""
        super().reset(seed=seed)
        if options:
            raise ParameterError(f"reset of {type(self).__name__} has no options, got {', '.join(options)}")
        self.simulation.reset(0 if seed is None else seed)
        self._frame, self._ending = 0, None
        self._begin()
        observation = self._observation()
        self._observations = [observation]
        return observation, self._info()

    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Simulate one frame, 1/30 s.

        Raises:
            ActionError: The action has the wrong shape, is out of range or is not a number.
            EpisodeError: The environment was not reset, or the episode is over.
        """
        if self._frame is None or self._ending is not None:
            raise EpisodeError(f"{type(self).__name__}: call reset before step, and when an episode is over")
        command = self._checked(action)
        reward, ending = self._advance(command)
        self._frame += 1
        info = self._info()
        fault = self._fault()
        if fault is not None:
            info["diverged"], ending, reward = fault, Ending.DIVERGED, 0.0
        terminated = ending is not None
        truncated = not terminated and self._frame == self.frame_count - 1
        self._ending = self._at_time_limit if truncated else ending
        observation = self._observation()
        self._observations.append(observation)
        return observation, reward, terminated, truncated, info

    def trajectory(self) -> FloatArray:
        """Observations of the episode so far, the start's first, shape [frame + 1, len(OBSERVED)]."""
        return np.array(self._observations)

    def report(self) -> LimitReport:
        """What the policy reached in the episode, beside what the law allows.

        Raises:
            EpisodeError: The episode is not over.
        """
        if self._ending is None:
            raise EpisodeError(f"{type(self).__name__}: an episode is reported when it is over")
        reached = 0.0 if self._ending is Ending.DIVERGED else self._reached()
        return LimitReport(limit=self.limit, reached=reached, ending=self._ending, time_s=self.time_s)

    def _info(self) -> dict[str, Any]:
        return {"frame": self._frame, "time_s": self.time_s}

    def _checked(self, action: Any) -> float:
        try:
            command = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ActionError(f"action {action!r} is not an array of numbers") from error
        if command.shape != (1,):
            raise ActionError(f"action has shape {command.shape}, expected (1,)")
        value = float(command[0])
        # A comparison with NaN is false.
        if not abs(value) <= 1.0:
            raise ActionError(f"action {value} must be a number from -1 to 1")
        return value

    def _fault(self) -> str | None:
        """Why the simulation counts as diverged."""
        speed = np.abs(self.simulation.body_states(self._dynamic)[:, 7:10]).max()
        limit = self.experiment.scene.speed_limit_m_per_s
        return (
            None if speed <= limit else f"a body moves at {speed:.3g} m/s, more than the scene can give ({limit:.3g})"
        )

    # --- pictures ---

    def render(self) -> NDArray[np.uint8] | None:
        """Picture of the scene now, shape [height, width, 3]; None without `render_mode="rgb_array"`.

        Raises:
            RenderError: The machine has no OpenGL library.
            EpisodeError: The environment was not reset.
        """
        if self.render_mode is None:
            return None
        if self._frame is None:
            raise EpisodeError(f"{type(self).__name__}: call reset before render")
        scene = self.experiment.scene
        moving = (*self._dynamic, *(driver.body for driver in scene.drivers))
        poses = self.simulation.body_states(moving)[:, :7]
        return self._pictures.draw(scene, {}, poses=dict(zip(moving, poses, strict=True)), nodes_m={})

    def close(self) -> None:
        """Free the simulation and the renderer."""
        self._pictures.close()
        self.simulation.close()
