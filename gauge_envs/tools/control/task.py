"""Base of the control tasks: a published scene whose driver is the action, in N worlds on the rollout of experiments.

The module of a task reads in the order of dm_control's suite: the numbers of the task; the scene and its limit; the
hooks of an episode in the order in which `start` and `step` call them; and the policy of the law.
"""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, cast

import numpy as np
from gymnasium.envs import registration
from numpy.typing import NDArray

from gauge_envs.backends.simulation import Sampler
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.envs.guards import GuardedEnv
from gauge_envs.envs.initial_states import SEEDS, Draw, InitialStates, Scatter
from gauge_envs.envs.rollout import Rollout
from gauge_envs.errors import EpisodeError, ParameterError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import find_variant
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.control.ids import ENTRY_POINT, FAMILIES
from gauge_envs.tools.control.stage import Stage

Index = int | tuple[IntArray, IntArray]
"""Index of the sample that each world shows in arrays of shape [6, N, ...]; -1 if no episode ends in the frame."""


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
        sampler: Function that returns a sampler of the same readings, from the array for its rows.
        has_states: Whether the readings are the states of all dynamic bodies.

    Attributes:
        values: The readings at the start of the frame and after each interval, shape [7, N, ...].
    """

    def __init__(
        self,
        read: Callable[[], FloatArray],
        sampler: Callable[[FloatArray], Sampler],
        *,
        has_states: bool,
    ) -> None:
        self._read, self._has_states = read, has_states
        self.values = np.repeat(read()[None], SAMPLES_PER_FRAME + 1, axis=0)
        self._sampler = sampler(self.values[1:])

    def start(self, worlds: BoolArray) -> None:
        """Read the start of worlds."""
        self.values[:, worlds] = self._read()[worlds]

    def read_points(self, interval: int) -> None:
        """Read all worlds after an interval of a frame, from 0 to 5."""
        if interval == 0:
            self.values[0] = self.values[-1]
        self._sampler.read(interval)

    def end_frame(self, is_running: BoolArray) -> FloatArray | None:
        """Complete the readings of the frame, and return the last if they are states."""
        self._sampler.finish()
        return self.values[-1] if self._has_states else None


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
        self._seen = np.zeros((world_count, len(self.OBSERVED)))
        self._nominal_limit = self._prepare(scene)
        self._frame = self._samples()
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

    def _samples(self) -> FrameSamples:
        """Return the recording of what the task observes: the states of its dynamic bodies, [7, N, body_count, 13]."""
        simulation, names = self.simulation, self._dynamic
        read = functools.partial(simulation.body_states, names)
        sampler = functools.partial(simulation.sampler, names)
        return FrameSamples(read, sampler, has_states=True)

    # --- hooks: an episode ---

    @abstractmethod
    def _begin(self, worlds: IntArray, randoms: Sequence[np.random.Generator]) -> None:
        """Record the initial states of episodes, which the simulation has.

        Args:
            worlds: Numbers of the worlds that begin; all entries of their observations are 0.
            randoms: Random numbers of all worlds.
        """

    def _before_step(self, commands: FloatArray) -> None:
        """Apply actions other than the acceleration of the stage, shape [N, len(COMMANDED)]."""

    @abstractmethod
    def _after_frame(self) -> None:
        """Read the samples of the frame, and write the entries of the observation but for the time."""

    @abstractmethod
    def _total_reward(self) -> FloatArray:
        """Return the sum of all rewards so far, up to a constant, shape [N]; `endings` is known."""

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
        self._seen[chosen] = 0.0
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
        self._seen[:, -1] = self.rollout.times_s
        self._after_frame()
        total = self._total_reward()
        rewards, self._rewarded = total - self._rewarded, total
        for world in self.rollout.diverged:
            self.endings[world], rewards[world] = Ending.DIVERGED, 0.0
        terminated = np.array([ending is not None for ending in self.endings])
        truncated = self.rollout.is_over & ~terminated
        if truncated.any():
            for world in np.flatnonzero(truncated).tolist():
                self.endings[world] = self.TIME_LIMIT_ENDING
        return rewards, terminated, truncated

    def _end(self, ends: Mapping[Ending, BoolArray]) -> Index:
        """End episodes at the first sample that ends them.

        Args:
            ends: Which samples after the intervals have each ending, shape [6, N]; the first ending counts.

        Returns:
            Index of the sample that each world shows: the last of the frame, or the sample of the ending.
        """
        any_end = functools.reduce(np.logical_or, ends.values())
        if not any_end.any():
            return -1
        last = np.full(self.world_count, SAMPLES_PER_FRAME - 1)
        for world in np.flatnonzero(any_end.any(axis=0)).tolist():
            last[world] = sample = int(any_end[:, world].argmax())
            self.endings[world] = next(
                ending for ending, masks in ends.items() if masks[sample, world]
            )
        return last, self._worlds

    def _entry(self, name: str) -> FloatArray:
        """Return a view of an entry of the observations, shape [N]."""
        return self._seen[:, self.OBSERVED.index(name)]

    def _entries(self, first: str, count: int) -> FloatArray:
        """Return a view of entries of the observations, shape [N, count], from the name of the first."""
        start = self.OBSERVED.index(first)
        return self._seen[:, start : start + count]

    def observation(self) -> FloatArray:
        """Return the observations in a new array, shape [N, len(OBSERVED)]."""
        return self._seen.copy()

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
