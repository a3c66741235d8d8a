"""Base of the control tasks: a published scene whose driver is the action, in N worlds on the rollout of experiments.

The module of a task reads in the order of dm_control's suite: the numbers of the task; the scene and its limit; the
hooks of an episode in the order in which `start` and `step` call them; and the policy of the law. `ControlEnv` is one
world of a task, and `ControlVectorEnv` is N.
"""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs import registration
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from gauge_envs.envs.arguments import (
    EnvArguments,
    check_episode_steps,
    checked_action,
)
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.guards import GuardedEnv, one_thread
from gauge_envs.envs.initial_states import SEEDS, Draw, InitialStates, Scatter
from gauge_envs.envs.pictures import (
    WORLDS_RENDER_MODES,
    Pictures,
    Rendered,
    rollout_picture,
)
from gauge_envs.envs.rollout import Rollout
from gauge_envs.envs.vector import GaugeVectorEnv, WorldsEnv
from gauge_envs.errors import EpisodeError, ParameterError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import find_variant
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.control.ids import ENTRY_POINT, FAMILIES
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

SUCCESSFUL = (Ending.HELD, Ending.REACHED)
"""Endings at the goal, or at the last frame without a slip."""


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
        return_limit: Largest sum of rewards that the law allows.
    """

    limit: Limit
    reached: float
    ending: Ending
    time_s: float
    return_limit: float

    @property
    def is_success(self) -> bool:
        """Whether the episode ended at the goal, or at the last frame without a slip."""
        return self.ending in SUCCESSFUL

    @property
    def ratio(self) -> float:
        """Reached over the limit; above 1 the policy exploits an error of the simulator."""
        return self.reached / self.limit.value

    @property
    def z(self) -> float:
        """Reached minus the limit, in standard uncertainties of the limit."""
        return (self.reached - self.limit.value) / self.limit.sigma


class FrameSamples:
    """Recording of the current frame of a control task: a reading at its seven samples.

    Args:
        read: Function that reads all worlds, shape [N, ...].

    Attributes:
        values: The readings at the start of the frame and after each interval, shape [7, N, ...].
    """

    def __init__(self, read: Callable[[], FloatArray]) -> None:
        self._read = read
        self.values = np.repeat(read()[None], SAMPLES_PER_FRAME + 1, axis=0)

    def start(self, worlds: BoolArray) -> None:
        """Read the start of worlds."""
        self.values[:, worlds] = self._read()[worlds]

    def read_points(self, interval: int) -> None:
        """Read all worlds after an interval of a frame, from 0 to 5."""
        if interval == 0:
            self.values[0] = self.values[-1]
        self.values[interval + 1] = self._read()

    def end_frame(self, is_running: BoolArray) -> None:
        """Leave the reading of the states to the rollout."""


class ControlTask(GuardedEnv, ABC):
    """A control task in N worlds of a published scene; a law gives its true optimum.

    One step is 1/30 s, in six intervals of 1/180 s with a constant action. The action is a Box [-1, 1] with an entry
    for each of `COMMANDED`. The subclass documents what they command, the observation, and the reward with its proof.
    Its hooks compute all worlds and all samples of a frame at once. An episode that ends within a frame has the
    observation and the reward of that sample.

    Args:
        material: Material of the cube, the ball or the cloth.
        world_count: Number of worlds N.
        backend: As for `ControlEnv`, like the other arguments.
        parameters: Parameter set or overrides.
        settings: Settings of the engine.
        jitter: Initial-state noise.

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
        world_count: Number of worlds N.
        arguments: Variant of the scene, engine, parameters and settings.
        experiment: The experiment, with the drivers and the duration of the task.
        published_scene: The scene of the experiment with its published constants, before the task changes it.
        gravity_m_per_s2: Gravity of the scene.
        initial_states: Sampler of the initial states.
        simulation: The worlds.
        rollout: The episodes.
        limits: The largest value that the law allows in each world, shape [N].
        sigmas: Its standard uncertainty, shape [N].
        endings: How the episode of each world ended; None before its end.
    """

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
        world_count: int = 1,
        backend: str = "mujoco",
        parameters: Parameters = "published",
        settings: Mapping[str, Any] | None = None,
        jitter: Scatter = None,
    ) -> None:
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
        scene = replace(self._scene(experiment.scene), duration_s=self.duration_s())
        steps = FAMILIES[self.FAMILY][2]
        self.experiment = replace(experiment, scene=scene, frame_count=steps + 1)
        self.gravity_m_per_s2 = scene.gravity_m_per_s2
        self.initial_states = InitialStates(self.experiment, jitter)
        self.world_count = world_count
        self._worlds = np.arange(world_count)
        experiments = [self.experiment] * world_count
        self.simulation = self.arguments.simulation(experiments, restarts=True)
        self._dynamic = [body.name for body in scene.dynamic_bodies]
        self._nominal_limit = self._prepare(scene)
        self._frame = FrameSamples(self._read)
        self.rollout = Rollout(
            experiments,
            self.simulation,
            motions=[self._stage] if self._stage else [],
            recorder=self._frame,
        )
        self.limits = np.full(world_count, self._nominal_limit[0])
        self.sigmas = np.full(world_count, self._nominal_limit[1])
        self.endings: list[Ending | None] = [None] * world_count
        self._rewarded = np.zeros(world_count)
        # The sample of the frame that each world shows.
        self._shown = np.zeros(world_count, dtype=np.intp)

    @classmethod
    def duration_s(cls) -> float:
        """Return the length of an episode [s]."""
        return FAMILIES[cls.FAMILY][2] / FRAME_RATE_HZ

    # --- hooks: scene and limit ---

    _stage: Stage | None = None
    """The body that actions accelerate, or None."""

    def _scene(self, scene: Scene) -> Scene:
        """Return the scene of the task, from the experiment's scene, in which driven bodies rest without actions."""
        return scene

    def _follow(self, states: FloatArray) -> None:
        """Move bodies of the task along with changed initial states of a world, shape [body_count, 13]."""

    @abstractmethod
    def _prepare(self, scene: Scene) -> tuple[float, float]:
        """Compute the constants of all episodes, before the worlds start.

        Args:
            scene: The scene of the task.

        Returns:
            The largest value that the law allows, and its standard uncertainty, from the nominal start.
        """

    def _read(self) -> FloatArray:
        """Read what the task observes: the states of its dynamic bodies, shape [N, body_count, 13]."""
        return self.simulation.body_states(self._dynamic)

    # --- hooks: an episode ---

    @abstractmethod
    def _begin(self, worlds: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        """Record the initial states of episodes, which the simulation has.

        Args:
            worlds: Numbers of the worlds that begin.
            randoms: Random numbers of all worlds.
        """

    def _before_step(self, commands: FloatArray) -> None:
        """Apply actions other than the acceleration of the stage, shape [N, len(COMMANDED)]."""

    @abstractmethod
    def _after_frame(self) -> None:
        """Read the samples of the frame, and call `_end` once."""

    @abstractmethod
    def _total_reward(self) -> FloatArray:
        """Return the sum of all rewards so far, up to a constant, shape [N]; `endings` is known."""

    @abstractmethod
    def _observed(self) -> list[FloatArray]:
        """Return the columns of the observation, in the order of `OBSERVED`, shape [N] or [N, count] each."""

    @abstractmethod
    def _reached(self, world: int) -> float:
        """Return the value that the policy reached in a successful episode, in the unit of the limit."""

    def return_limit(self, world: int = 0) -> float:
        """Return the largest sum of rewards that the law allows in an episode."""
        return 1.0

    @abstractmethod
    def _law_command(self, fraction: float, world: int) -> float | FloatArray:
        """Return the action of `law_action` before it is clipped to [-1, 1]."""

    def law_action(self, fraction: float, world: int = 0) -> NDArray[np.float32]:
        """Return the action of the law's policy in a world, shape [len(COMMANDED)].

        Args:
            fraction: Share of the law's limit that the policy uses. In an engine that obeys the law, a share just below
                1 succeeds and a share just above 1 fails.
            world: Number of the world.
        """
        command = np.atleast_1d(np.float32(self._law_command(fraction, world)))
        return np.clip(command, -1.0, 1.0)

    # --- episodes ---

    def start(
        self,
        worlds: BoolArray,
        draw: Draw,
        randoms: Sequence[np.random.Generator],
        seed: int = 0,
    ) -> None:
        """Start an episode in worlds.

        Args:
            worlds: Which worlds start, shape [N].
            draw: Source of the initial states.
            randoms: Random numbers of all worlds.
            seed: Seed of the engine.

        Raises:
            ParameterError: The source is a recorded trial.
        """
        if isinstance(draw, int):
            raise ParameterError(
                f"reset of {self.FAMILY} has no option 'trial': its episodes are no recorded trials"
            )
        chosen, starts = np.flatnonzero(worlds), None
        if draw is not None:
            nominal = self.initial_states.sample(None, 0)
            starts = list(self.rollout.initial_states) or [nominal] * len(worlds)
            for world in chosen.tolist():
                start_seed = int(randoms[world].integers(SEEDS))
                starts[world] = self.initial_states.sample(draw, start_seed)
                self._follow(starts[world].states)
        self.rollout.reset(starts, seed, worlds)
        self.limits[chosen], self.sigmas[chosen] = self._nominal_limit
        self._shown[chosen] = 0
        for world in chosen.tolist():
            self.endings[world] = None
        self._begin(chosen, randoms)
        self._rewarded[chosen] = self._total_reward()[chosen]

    def step(self, commands: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Simulate one frame of all worlds.

        Args:
            commands: Actions from -1 to 1, shape [N, len(COMMANDED)].

        Returns:
            Rewards, terminations and truncations, shape [N].
        """
        self._before_step(commands)
        self.rollout.step(commands)
        self._after_frame()
        total = self._total_reward()
        rewards, self._rewarded = total - self._rewarded, total
        for world in self.rollout.diverged:
            self.endings[world], rewards[world] = Ending.DIVERGED, 0.0
        terminated = np.array([ending is not None for ending in self.endings])
        truncated = self.rollout.is_over & ~terminated
        for world in np.flatnonzero(truncated).tolist():
            self.endings[world] = self.TIME_LIMIT_ENDING
        return rewards, terminated, truncated

    def _end(self, ends: Mapping[Ending, BoolArray]) -> tuple[IntArray, IntArray]:
        """End episodes at the first sample that ends them.

        Args:
            ends: Which samples after the intervals have each ending, shape [6, N]; the first ending counts.

        Returns:
            Index of a value at the sample that each world shows, in arrays of shape [6, N, ...]: the last sample of the
            frame, or that of the ending.
        """
        any_end = functools.reduce(np.logical_or, ends.values())
        last = np.full(self.world_count, SAMPLES_PER_FRAME - 1)
        for world in np.flatnonzero(any_end.any(axis=0)).tolist():
            last[world] = sample = int(any_end[:, world].argmax())
            self.endings[world] = next(
                ending for ending, masks in ends.items() if masks[sample, world]
            )
        self._shown = last + 1
        return last, self._worlds

    @property
    def _offsets(self) -> FloatArray:
        """Coordinates of the stage [m or rad] that each world shows, shape [N, M]."""
        assert self._stage is not None
        return self._stage.offsets[self._shown, self._worlds]

    @property
    def _rates(self) -> FloatArray:
        """Rates of the coordinates of the stage [m/s or rad/s], shape [N, M]."""
        assert self._stage is not None
        return self._stage.rates[self._shown, self._worlds]

    def observation(self) -> FloatArray:
        """Return the observations, shape [N, len(OBSERVED)]."""
        columns = [
            column if column.ndim > 1 else column[:, None]
            for column in self._observed()
        ]
        return np.concatenate(columns, axis=1)

    def info(self, world: int) -> dict[str, Any]:
        """Return the `info` of a world without frame and time, see `ControlEnv`."""
        info: dict[str, Any] = {}
        if world in self.rollout.diverged:
            info["diverged"] = self.rollout.diverged[world]
        if self.endings[world] is not None:
            info["limit"] = report = self.report(world)
            info["success"] = report.is_success
            info["return_limit"] = report.return_limit
        return info

    def limit(self, world: int = 0) -> Limit:
        """Return the best that the law allows in a world."""
        value, sigma = float(self.limits[world]), float(self.sigmas[world])
        return replace(self.LIMIT, value=value, sigma=sigma)

    def report(self, world: int = 0) -> LimitReport:
        """Return the policy's result in the episode of a world, and the law's limit.

        Raises:
            EpisodeError: The episode is not over.
        """
        ending = self.endings[world]
        if ending is None:
            raise EpisodeError(f"{self.FAMILY}: an episode is reported when it is over")
        return LimitReport(
            limit=self.limit(world),
            reached=0.0 if ending in FAILED else self._reached(world),
            ending=ending,
            time_s=float(self.rollout.times_s[world]),
            return_limit=self.return_limit(world),
        )


def made_task(family: str, *arguments: Any, **options: Any) -> ControlTask:
    """Return the task of a family; see `ControlTask` for the arguments."""
    kind: Any = registration.load_env_creator(f"{ENTRY_POINT}.{FAMILIES[family][0]}")
    return cast("ControlTask", kind(*arguments, **options))


def _spaces(task: ControlTask) -> tuple[Any, Any]:
    """Return the spaces of observations and actions of a world."""
    bound, shape = MAX_OBSERVATION, (len(task.OBSERVED),)
    # Learners act in single precision.
    return (
        spaces.Box(-bound, bound, shape, np.float64),
        spaces.Box(-1.0, 1.0, (len(task.COMMANDED),), np.float32),
    )


class ControlEnv(GuardedEnv, gymnasium.Env[FloatArray, NDArray[np.float32]]):
    """One world of a control task; see `ControlTask` for steps and actions.

    `info`: `frame`, `time_s`, and `diverged` (the reason) if the simulation diverged. The last step of an episode adds
    `limit`, a `LimitReport` of the policy's result and the law's limit; `success`, whether it ended at its goal or
    without a slip; and `return_limit`, the largest sum of rewards that the law allows.

    Args:
        family: Name of the task without its material, as `Throw`.
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
        task: The task, with one world; it has the limit and the report.
        OBSERVED: Names of the observation's entries, with units.
        COMMANDED: Names of the action's entries.
        arguments: Variant of the scene, engine, parameters and settings.
        experiment: The experiment, with the drivers and the duration of the task.
        rollout: The episode.

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

    def __init__(
        self,
        family: str,
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
        self.task = task = made_task(
            family,
            material,
            backend=backend,
            parameters=parameters,
            settings=settings,
            jitter=jitter,
        )
        view = {**task.CAMERA, **(camera or {})}
        self._pictures = Pictures(render_mode, width=width, height=height, camera=view)
        self.OBSERVED, self.COMMANDED = task.OBSERVED, task.COMMANDED
        self.arguments, self.experiment = task.arguments, task.experiment
        self.rollout = task.rollout
        self._observations: list[FloatArray] = []
        self.observation_space, self.action_space = _spaces(task)

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
        draw = self.task.initial_states.of_reset(options, seeded=seed is not None)
        self.task.start(np.ones(1, np.bool_), draw, [self.np_random], seed or 0)
        self._observations = []
        return self._observe(), self._info()

    @one_thread
    def step(self, action: Any) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Simulate one frame, 1/30 s.

        Raises:
            ActionError: The action has the wrong shape, is out of range or is not a number.
            EpisodeError: The environment was not reset, or the episode is over.
        """
        task = self.task
        if not self.rollout.has_begun or task.endings[0] is not None:
            raise EpisodeError(f"{task.FAMILY}: call reset before step")
        command = checked_action(action, self.action_space, task.FAMILY)
        (reward,), (terminated,), (truncated,) = task.step(command[None])
        return (
            self._observe(),
            float(reward),
            bool(terminated),
            bool(truncated),
            self._info(),
        )

    def _info(self) -> dict[str, Any]:
        frame = int(self.rollout.frames[0])
        return {"frame": frame, "time_s": frame / FRAME_RATE_HZ, **self.task.info(0)}

    def _observe(self) -> FloatArray:
        """Record and return the observation, and draw it if there is a window."""
        self._observations.append(self.task.observation()[0])
        if self.render_mode == "human":
            self.render()
        return self._observations[-1]

    def trajectory(self) -> FloatArray:
        """Return the observations of the episode so far, from the start on, shape [frame + 1, len(OBSERVED)]."""
        return np.array(self._observations)

    def law_action(self, fraction: float) -> NDArray[np.float32]:
        """Return the action of the law's policy; see `ControlTask.law_action`."""
        return self.task.law_action(fraction)

    @one_thread
    def render(self) -> Rendered | None:
        """Return a picture of the scene in the form of the render mode; None without one, and with a window."""
        if self.render_mode is None:
            return None
        return rollout_picture(self._pictures, self.rollout, [None])

    @one_thread
    def close(self) -> None:
        """Free the simulation and the renderer. A second call does nothing."""
        self._pictures.close()
        self.rollout.simulation.close()


class ControlVectorEnv(WorldsEnv, VectorEnv[Any, Any, NDArray[Any]]):
    """Worlds of a control task; `gymnasium.make_vec` makes it. Each behaves as a `ControlEnv`.

    Args:
        family: As for `ControlEnv`.
        material: As for `ControlEnv`.
        num_envs: Number of worlds, 1 or more.
        render_mode: None, `rgb_array`, `depth_array` or `rgbd_tuple`, as for `ControlEnv`.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: As for `ControlEnv`.
        autoreset_mode: Mode of `gymnasium.vector.AutoresetMode`, or its value.
        max_episode_steps: Steps of an episode; `gymnasium.make_vec` passes those of the spec.
        **arguments: Other arguments of `ControlTask`; with `jitter` each world has its own initial states.

    Attributes:
        task: The task.
    """

    metadata = GaugeVectorEnv.metadata

    def __init__(
        self,
        family: str,
        material: str,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        **arguments: Any,
    ) -> None:
        super().__init__(num_envs, autoreset_mode)
        self.render_mode = render_mode
        self.task = made_task(family, material, world_count=num_envs, **arguments)
        check_episode_steps(max_episode_steps, FAMILIES[family][2])
        self._pictures = Pictures(
            render_mode,
            width=width,
            height=height,
            camera={**self.task.CAMERA, **(camera or {})},
            modes=WORLDS_RENDER_MODES,
        )
        self._name, self.rollout = family, self.task.rollout
        self._initial_states = self.task.initial_states
        self._set_spaces(*_spaces(self.task))

    def _start(self, worlds: BoolArray, given: list[int | None], draw: Draw) -> None:
        seed = given[int(worlds.argmax())] or 0
        self.task.start(worlds, draw, self._randoms, seed)

    def _advance(self, actions: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
        return self.task.step(actions)

    def _observations(self) -> FloatArray:
        return self.task.observation()

    def _info(self, world: int) -> dict[str, Any]:
        return self.task.info(world)


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
    paid, over = 0.0, False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        paid += reward
        over = terminated or truncated
    return paid, env.task.report()
