"""Base of the control tasks: a published scene whose driver is the action, stepped at the frame rate of the trials.

The module of a task reads in the order of dm_control's suite: the numbers of the task; the scene and its limit; the
hooks of an episode in the order in which `reset` and `step` call them; and the policy of the law.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gauge_envs.envs.arguments import EnvArguments, checked_action
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.guards import GuardedEnv, one_thread
from gauge_envs.envs.initial_states import SEEDS, InitialStates, Scatter
from gauge_envs.envs.pictures import Pictures, Rendered, rollout_picture
from gauge_envs.envs.rollout import intervals
from gauge_envs.errors import EpisodeError, ParameterError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import find_variant
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.states import scene_at
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.control.ids import FAMILIES
from gauge_envs.tools.control.stage import Stage

MAX_OBSERVATION = 1e5
"""Bound on the absolute values of observations [SI units]. Only diverged episodes come near it."""


class Ending(StrEnum):
    """How an episode of a control task ended."""

    HELD = "held"
    """The last frame is reached and the cube has not slipped."""
    SLIPPED = "slipped"
    """The cube moved on its carrier."""
    REACHED = "reached"
    """The ball was at its height, or the cube came to rest at its goal."""
    MISSED = "missed"
    """The last frame is reached, and the ball or the cube has not reached its goal."""
    LOST = "lost"
    """The ball or the cube can no longer reach its goal."""
    DIVERGED = "diverged"
    """The simulation diverged."""


FAILED = (Ending.MISSED, Ending.LOST, Ending.DIVERGED)
"""Endings of episodes without a result."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The best that a law allows.

    Attributes:
        quantity: The limited quantity, in words.
        unit: Its unit; `1` for a ratio.
        law: The law, in words and symbols.
        sigma_source: Source of the uncertainty.
        value: The limit, with the constants of the scene.
        sigma: Its standard uncertainty, from the uncertainty of the measured constants.
    """

    quantity: str
    unit: str = "1"
    law: str
    sigma_source: str
    value: float = math.nan
    sigma: float = math.nan


@dataclass(frozen=True, kw_only=True)
class LimitReport:
    """Result of a policy in an episode, and the limit of the law.

    Attributes:
        limit: The best that the law allows.
        reached: Value that the policy reached, in the limit's unit; 0 if the episode failed.
        ending: How the episode ended.
        time_s: Time of the ending [s].
    """

    limit: Limit
    reached: float
    ending: Ending
    time_s: float

    @property
    def ratio(self) -> float:
        """Reached over the limit; above 1 the policy exploits an error of the simulator."""
        return self.reached / self.limit.value

    @property
    def z(self) -> float:
        """Reached minus the limit, in standard uncertainties of the limit."""
        return (self.reached - self.limit.value) / self.limit.sigma


class ControlEnv(GuardedEnv, gymnasium.Env[FloatArray, NDArray[np.float32]], ABC):
    """A control task in a published scene of the benchmark; a law gives its true optimum.

    One step is 1/30 s, in six intervals of 1/180 s with a constant action. The action is a Box [-1, 1] with an entry
    for each of `COMMANDED`. The subclass documents what they command, the observation, and the reward with its proof.

    `info`: `frame`, `time_s`, and `diverged` (the reason) if the simulation diverged. The last step of an episode adds
    `limit`, a `LimitReport` of the policy's result and the law's limit.

    Args:
        material: Material of the cube, the ball or the cloth.
        backend: Name of an installed physics engine.
        parameters: `published`, another parameter set of the task file, or overrides such as
            `{"cube.friction": 0.3}`.
        settings: Numerical settings of the engine that replace the preset and `MUJOCO_TIMESTEPS_S`.
        render_mode: None; `human` for a window that the mouse turns, drawn by `reset` and `step`; `rgb_array`;
            `depth_array`, the distance from the plane of the camera [m], float32; `rgbd_tuple`, both.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace entries of the scene's camera: `target_m`, `distance_m`, `azimuth_deg` and
            `elevation_deg`.
        jitter: Initial-state noise of every episode, as for `GaugeEnv`: `real`, or a `Jitter`. The random numbers of
            the environment draw it, then the goal, if any.

    Attributes:
        SCENE: Variant whose scene the task uses, without its material, as `Turntable-1`.
        LIMIT: Quantity, law and source of the uncertainty, without numbers.
        FAMILY: Name of the task without its material, in `FAMILIES`.
        MUJOCO_TIMESTEPS_S: Time steps of the task in MuJoCo [s] by preset, in place of the preset's time step;
            studies/steps has the rule that chose them.
        PARAMETERS: Constants that the task changes, such as the initial pose of a body.
        CAMERA: Entries of the camera that show the whole workspace of the actions; empty for the scene's camera.
        COMMANDED: Names of the action's entries.
        OBSERVED: Names of the observation's entries, with units.
        TIME_LIMIT_ENDING: Ending of an episode that reaches its last frame.
        arguments: Variant of the scene, engine, parameters and settings.
        experiment: The experiment, with the drivers and the duration of the task.
        published_scene: The scene of the experiment with its published constants, before the task changes it.
        gravity_m_per_s2: Gravity of the scene.
        limit: The best that the law allows.
        rollout: The episode in one world.
        simulation: The simulation of this world.

    Example:
        >>> import gymnasium as gym, gauge_envs
        >>> env = gym.make("GAUGE/SlopeSlider-Limit-metal")
        >>> _ = env.reset(seed=0)
        >>> over = False
        >>> while not over:
        ...     *_, terminated, truncated, info = env.step(env.unwrapped.law_action(0.98))
        ...     over = terminated or truncated
        >>> report = info["limit"]
        >>> print(report.ending, f"{report.reached:.3f} of {report.limit.value:.3f}, ratio {report.ratio:.2f}")
        held 0.258 of 0.263, ratio 0.98
    """

    metadata = GaugeEnv.metadata

    SCENE: ClassVar[str]
    LIMIT: ClassVar[Limit]
    FAMILY: ClassVar[str]
    MUJOCO_TIMESTEPS_S: ClassVar[Mapping[str, float]] = {}
    PARAMETERS: ClassVar[Mapping[str, Any]] = {}
    CAMERA: ClassVar[Mapping[str, Any]] = {}
    COMMANDED: ClassVar[tuple[str, ...]]
    OBSERVED: ClassVar[tuple[str, ...]]
    TIME_LIMIT_ENDING: ClassVar[Ending] = Ending.MISSED

    def __init__(
        self,
        material: str,
        *,
        backend: str = "mujoco",
        parameters: Parameters = "published",
        settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        jitter: Scatter = None,
    ) -> None:
        self.render_mode = render_mode
        view = {**self.CAMERA, **(camera or {})}
        self._pictures = Pictures(render_mode, width=width, height=height, camera=view)
        self._variant = find_variant(f"{self.SCENE}-{material}")
        self.published_scene = load_experiment(self._variant).scene
        if self.PARAMETERS:
            overrides = load_experiment(self._variant, parameters).overrides
            parameters = {**overrides, **self.PARAMETERS}
        settings = settings or {}
        preset = settings.get("preset", "default")
        if backend == "mujoco" and preset in self.MUJOCO_TIMESTEPS_S:
            settings = {"timestep_s": self.MUJOCO_TIMESTEPS_S[preset], **settings}
        self.arguments = EnvArguments(
            self._variant,
            backend=backend,
            parameters=parameters,
            settings=settings or None,
            # Driven bodies have no motion of their own.
            drivers="action",
        )
        experiment = self.arguments.experiment()
        scene = replace(self._scene(experiment.scene), duration_s=self.duration_s)
        self.experiment = replace(experiment, scene=scene, frame_count=self.steps + 1)
        self.gravity_m_per_s2 = scene.gravity_m_per_s2
        self._initial_states = InitialStates(self.experiment, jitter)
        self.rollout = self.arguments.rollout([self.experiment])
        self.simulation = self.rollout.simulation
        self._frame: int | None = None
        self._ending: Ending | None = None
        self._observations: list[FloatArray] = []
        self._start_from(scene)
        shape = (len(self.OBSERVED),)
        self.observation_space = spaces.Box(
            -MAX_OBSERVATION, MAX_OBSERVATION, shape, np.float64
        )
        # Learners act in single precision.
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.COMMANDED),), np.float32)

    # --- hooks: scene and limit ---

    _stage: Stage | None = None
    """The body that actions accelerate, or None."""

    def _scene(self, scene: Scene) -> Scene:
        """Return the scene of the task, from the experiment's scene, in which driven bodies rest without actions."""
        return scene

    def _follow(self, states: FloatArray) -> None:
        """Move bodies of the task along with changed initial states, shape [body_count, 13]."""

    @abstractmethod
    def _prepare(self, scene: Scene) -> tuple[float, float]:
        """Compute the constants of all episodes with the same initial state.

        Args:
            scene: The scene with this state.

        Returns:
            The largest value that the law allows, and its standard uncertainty.
        """

    # --- hooks: an episode ---

    @abstractmethod
    def _begin(self) -> None:
        """Record the initial state of an episode, which the simulation has."""

    def _before_step(self, command: FloatArray) -> None:
        """Apply an action other than the acceleration of the stage."""

    @abstractmethod
    def _after_interval(self) -> Ending | None:
        """Read the world after 1/180 s; return the ending if the episode ended."""

    @abstractmethod
    def _total_reward(self) -> float:
        """Return the sum of all rewards so far, up to a constant; `_ending` is known if the episode ended."""

    @abstractmethod
    def _observation(self) -> list[float]:
        """Return the observation, in the order of `OBSERVED`."""

    @abstractmethod
    def _reached(self) -> float:
        """Return the value that the policy reached in a successful episode, in the unit of the limit."""

    @abstractmethod
    def _law_command(self, fraction: float) -> float | FloatArray:
        """Return the action of `law_action` before it is clipped to [-1, 1]."""

    def law_action(self, fraction: float) -> NDArray[np.float32]:
        """Return the action of the law's policy, shape [len(COMMANDED)].

        Args:
            fraction: Share of the law's limit that the policy uses. In an engine that obeys the law, a share just below
                1 succeeds and a share just above 1 fails.
        """
        command = np.atleast_1d(np.float32(self._law_command(fraction)))
        return np.clip(command, -1.0, 1.0)

    # --- episode ---

    @property
    def steps(self) -> int:
        """Steps of an episode, one for each frame after the first."""
        return FAMILIES[self.FAMILY][2]

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.steps / FRAME_RATE_HZ

    @property
    def time_s(self) -> float:
        """Time since the start of the episode [s]."""
        return (self._frame or 0) / FRAME_RATE_HZ

    @one_thread
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: Seed of the random numbers, which draw the initial-state noise and the goal, if there are any.
                Without it they continue.
            options: `{"jitter": True}` adds initial-state noise, as for `GaugeEnv`; it also applies to autoreset.

        Raises:
            ParameterError: There is no such option, or no body of the scene can have another initial state.
        """
        super().reset(seed=seed)
        draw = self._initial_states.of_reset(options, seeded=seed is not None)
        if isinstance(draw, int):
            raise ParameterError(
                f"reset of {self.FAMILY} has no option 'trial': its episodes are no recorded trials"
            )
        scene, starts = self.experiment.scene, None
        if draw is not None:
            start_seed = int(self.np_random.integers(SEEDS))
            start = self._initial_states.sample(draw, start_seed)
            self._follow(start.states)
            starts = [start]
            scene = scene_at(scene, start.states)
        self._start_from(scene)
        self.rollout.reset(starts, seed or 0)
        self._frame, self._ending = 0, None
        self._begin()
        self._rewarded = self._total_reward()
        self._observations = []
        return self._observe(), self._info()

    def _start_from(self, scene: Scene) -> None:
        """Prepare the task and its limit for the initial state of a scene."""
        value, sigma = self._prepare(scene)
        self.limit = replace(self.LIMIT, value=value, sigma=sigma)

    @one_thread
    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Simulate one frame, 1/30 s, or less if the episode ends within it.

        Raises:
            ActionError: The action has the wrong shape, is out of range or is not a number.
            EpisodeError: The environment was not reset, or the episode is over.
        """
        if self._frame is None or self.is_over:
            raise EpisodeError(f"{self.FAMILY}: call reset before step")
        command = checked_action(action, self.action_space, self.FAMILY)
        self._before_step(command)
        stages = [self._stage] if self._stage else []
        actions = [command[None]] * len(stages)
        for index in intervals(self.simulation, stages, 0, SAMPLES_PER_FRAME, actions):
            for stage in stages:
                stage.sample = index + 1
            self._ending = self._after_interval()
            if self._ending is not None:
                break
        before, self._rewarded = self._rewarded, self._total_reward()
        reward = self._rewarded - before
        self._frame += 1
        info = self._info()
        reason = self.rollout.divergences().get(0)
        if reason is not None:
            info["diverged"], self._ending, reward = reason, Ending.DIVERGED, 0.0
        terminated = self.is_over
        truncated = not terminated and self._frame == self.steps
        if truncated:
            self._ending = self.TIME_LIMIT_ENDING
        if self.is_over:
            info["limit"] = self.report()
        return self._observe(), reward, terminated, truncated, info

    def _observe(self) -> FloatArray:
        """Record and return the observation, and draw it if there is a window."""
        self._observations.append(np.array(self._observation()))
        if self.render_mode == "human":
            self.render()
        return self._observations[-1]

    def _info(self) -> dict[str, Any]:
        return {"frame": self._frame, "time_s": self.time_s}

    def trajectory(self) -> FloatArray:
        """Return the observations of the episode so far, from the start on, shape [frame + 1, len(OBSERVED)]."""
        return np.array(self._observations)

    @property
    def is_over(self) -> bool:
        """Whether the episode has ended."""
        return self._ending is not None

    def report(self) -> LimitReport:
        """Return the policy's result in the episode and the law's limit.

        Raises:
            EpisodeError: The episode is not over.
        """
        if self._ending is None:
            raise EpisodeError(f"{self.FAMILY}: an episode is reported when it is over")
        reached = 0.0 if self._ending in FAILED else self._reached()
        return LimitReport(
            limit=self.limit, reached=reached, ending=self._ending, time_s=self.time_s
        )

    @one_thread
    def close(self) -> None:
        """Free the simulation and the renderer. A second call does nothing."""
        self._pictures.close()
        self.simulation.close()

    # --- the current world, and its picture ---

    def _state(self, name: str) -> FloatArray:
        """Return the state of a rigid body, shape [13]."""
        return self.simulation.body_states((name,))[0, 0]

    @one_thread
    def render(self) -> Rendered | None:
        """Return a picture of the scene in the form of the render mode; None without one, and with a window."""
        if self.render_mode is None:
            return None
        return rollout_picture(self._pictures, self.rollout, [None])


# --- episodes of policies ---

Policy = Callable[[FloatArray], NDArray[np.floating]]
"""Function that returns an action, shape [len(COMMANDED)], for an observation."""


def play_paid(
    env: ControlEnv, policy: Policy, *, seed: int = 0
) -> tuple[float, LimitReport]:
    """Run one episode and return the sum of its rewards and its report.

    Args:
        env: The task, without wrappers; it then holds the episode's trajectory.
        policy: The policy.
        seed: Seed of the reset, which draws the goal of a task with a goal.
    """
    observation, _ = env.reset(seed=seed)
    paid = 0.0
    while not env.is_over:
        observation, reward, *_ = env.step(policy(observation))
        paid += reward
    return paid, env.report()
