"""Base of the control tasks: a calibrated scene whose driver is the action, stepped at the frame rate of the trials.

The module of a task reads in the order of dm_control's suite: constants; the scene and its limit; *physics*, which
drives the world and reads quantities from it; *task*, which starts, observes and ends an episode; *reward*; and the
policy of the law.
"""

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gauge_envs.backends.world import World
from gauge_envs.envs.arguments import (
    SEEDS,
    Scatter,
    Starts,
    TrialStart,
    checked_action,
    jittered_experiment,
)
from gauge_envs.envs.base import SimulationEnvironment
from gauge_envs.envs.divergence import DeformableBounds, speed_fault
from gauge_envs.envs.pictures import Pictures, Rendered
from gauge_envs.envs.stepper import run_frame
from gauge_envs.errors import EpisodeError, ParameterError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.variants import Variant, find_variant
from gauge_envs.references.uncertainties import friction_std
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter, jittered
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.tools.control.limit import Ending, Limit, LimitReport, pair_friction

Step = tuple[FloatArray, float, bool, bool, dict[str, Any]]
"""What `step` returns."""


class ControlEnv(SimulationEnvironment[FloatArray, NDArray[np.float32]], ABC):
    """A control task in a calibrated scene of the benchmark; a law gives its true optimum.

    One step is 1/30 s, in six intervals of 1/180 s with a constant action. The action is a Box [-1, 1] with an entry
    for each of `COMMANDED`. The subclass documents what they command, the observation, and the reward with its proof.

    `info`: `frame`, `time_s`, and `diverged` (the reason) if the simulation diverged.

    Args:
        material: Material of the cube, the ball or the cloth.
        backend: Name of an installed physics engine.
        parameters: `calibrated`, another parameter set of the task file, or overrides such as
            `{"cube.friction": 0.3}`.
        settings: Numerical settings of the engine that replace those of the preset, and of `OWN_STEPS_S`.
        render_mode: None; `human` for a window that the mouse turns, drawn by `reset` and `step`; `rgb_array`;
            `depth_array`, the distance from the plane of the camera [m], float32; `rgbd_tuple`, both.
        width: Picture width [pixels]; None is 640.
        height: Picture height [pixels]; None is 480.
        camera: Entries that replace those of the scene's camera: `target_m`, `distance_m`, `azimuth_deg` and
            `elevation_deg`.
        jitter: Scatter of the start of every episode, as of `GaugeEnv`: `real`, or a `Jitter`. The random numbers of
            the environment draw it, then the goal, if any.
        is_world: Whether it is one of many worlds, which get `world` from `ControlWorlds` and build no simulation.

    Attributes:
        SCENE: Variant that states the scene, without its material, as `Turntable-1`.
        LAW: The law, in words and symbols.
        SIGMA_SOURCE: Source of the limit's uncertainty.
        STEPS: Steps of an episode, one for each frame after the first.
        OWN_STEPS_S: Time steps of the task [s] by engine and preset, in place of those of the preset; studies/steps
            has the rule that chose them.
        COMMANDED: Names of the action's entries.
        OBSERVED: Names of the observation's entries, with units.
        experiment: The experiment, with the drivers and the duration of the task.
        limit: The best that the law allows.
        world: The simulation, or the world of it.
        moving: Names of the bodies that move.
        rest_nodes_m: Nodes of each deformable body at the start of the episode [m], shape [node_count, 3], by name.
    """

    SCENE: ClassVar[str]
    LAW: ClassVar[str]
    SIGMA_SOURCE: ClassVar[str]
    STEPS: ClassVar[int]
    OWN_STEPS_S: ClassVar[Mapping[str, Mapping[str, float]]] = {}
    COMMANDED: ClassVar[tuple[str, ...]]
    OBSERVED: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        material: str,
        *,
        backend: str = "mujoco",
        parameters: Parameters = "calibrated",
        settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        width: int | None = None,
        height: int | None = None,
        camera: Mapping[str, Any] | None = None,
        jitter: Scatter = None,
        is_world: bool = False,
    ) -> None:
        pictures = Pictures(render_mode, width=width, height=height, camera=camera)
        self._variant = find_variant(f"{self.SCENE}-{material}")
        stated = load_experiment(
            self._variant, self._start_parameters(self._variant, parameters)
        )
        scene = replace(self._scene(stated.scene), duration_s=self.duration_s)
        experiment = replace(stated, scene=scene, frame_count=self.frame_count)
        super().__init__(
            experiment,
            pictures,
            backend=backend,
            settings=self.settings_on(backend, settings),
        )
        # The laws hold for a stage that starts where it is stated.
        self._starts = Starts(experiment, jitter, draw=jittered)
        self._is_moved = False
        if not is_world:
            self._build(experiment)
        self._dynamic = tuple(body.name for body in scene.dynamic_bodies)
        self.moving = (*self._dynamic, *(driver.body for driver in scene.drivers))
        self._frame: int | None = None
        self._ending: Ending | None = None
        self._observations: list[FloatArray] = []
        self._prepare(scene)
        self.limit = self._limit()
        largest = np.array(self._largest_observation(), dtype=np.float64)
        self.observation_space = spaces.Box(-largest, largest, dtype=np.float64)
        # Learners act in single precision.
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.COMMANDED),), np.float32)

    @classmethod
    def settings_on(
        cls, backend: str, settings: Mapping[str, Any] | None
    ) -> Mapping[str, Any] | None:
        """Return the settings on an engine: what is given, with the task's own step unless it states one."""
        preset = (settings or {}).get("preset", "default")
        step_s = cls.OWN_STEPS_S.get(backend, {}).get(preset)
        if step_s is None:
            return settings
        return {"timestep_s": step_s, **(settings or {})}

    @property
    def _label(self) -> str:
        return type(self).__name__

    def _build(self, experiment: Experiment) -> bool:
        is_kept = super()._build(experiment)
        self.world: World = self.simulation
        return is_kept

    # --- what a task states ---

    _at_time_limit: ClassVar[Ending]
    """Ending of an episode that reaches its last frame."""

    MEASURES_FROM_START: ClassVar[bool] = True
    """Whether quantities and limit count from where an episode starts, and not from the start of the scene."""

    def _start_parameters(self, variant: Variant, parameters: Parameters) -> Parameters:
        """Return the parameters, with the start of the task if it differs from that of the experiment."""
        return parameters

    @abstractmethod
    def _scene(self, stated: Scene) -> Scene:
        """Return the scene of the task, from that of the experiment.

        Drivers have no motion of their own; their residual rates state how fast actions may move them.
        """

    def _cleared(self, scene: Scene) -> Scene:
        """Return a scene whose start scatters, in which what the task adds stands in no body's way."""
        return scene

    def _prepare(self, scene: Scene) -> None:
        """Compute what stays the same in all episodes, from the scene of the task."""

    @abstractmethod
    def _limit(self) -> Limit:
        """Return the best that the law allows."""

    def _limit_of(self, quantity: str, unit: str, value: float, sigma: float) -> Limit:
        """Return a limit of the task's law; the arguments are those of `Limit`."""
        return Limit(
            quantity=quantity,
            unit=unit,
            value=value,
            sigma=sigma,
            law=self.LAW,
            sigma_source=self.SIGMA_SOURCE,
        )

    def _friction_limit(self, pair: tuple[str, str], quantity: str) -> Limit:
        """Return the limit of a quantity that is at most the friction of two bodies."""
        # The uncertainty is that of the calibrated coefficient, also if an override replaces the coefficient.
        calibrated = pair_friction(load_experiment(self._variant).scene, *pair)
        sigma = friction_std(calibrated, self._variant.material)
        return self._limit_of(
            quantity, "1", pair_friction(self.experiment.scene, *pair), sigma
        )

    @abstractmethod
    def _begin(self) -> None:
        """Record the start of an episode; the simulation is at it."""

    def _start_frame(self, command: FloatArray) -> None:
        """Set what an action changes for the whole frame."""

    def _drive(self, command: FloatArray) -> None:
        """Drive the world with an action in the next 1/180 s."""

    @abstractmethod
    def _look(self) -> Ending | None:
        """Read the world, which has advanced by 1/180 s; return the ending, if the episode ended in it."""

    def _frame_ending(self) -> Ending | None:
        """Return the ending, if the episode ended with the frame, after its last look."""
        return None

    @abstractmethod
    def _reward(self, ending: Ending | None) -> float:
        """Return the reward of the frame, which may have ended the episode."""

    @abstractmethod
    def _observation(self) -> FloatArray:
        """Return the observation, in the order of `OBSERVED`."""

    @abstractmethod
    def _largest_observation(self) -> list[float]:
        """Return a bound on the absolute value of each entry of `OBSERVED`, which no episode in bounds reaches."""

    @abstractmethod
    def _reached(self) -> float:
        """Return what the policy has reached so far, in the unit of the limit."""

    @abstractmethod
    def _law_command(self, fraction: float) -> float | FloatArray:
        """Return the action of `law_action` before it is clipped to [-1, 1]."""

    def law_action(self, fraction: float) -> NDArray[np.float32]:
        """Return the action that the law suggests now, shape [len(COMMANDED)].

        Args:
            fraction: Share of the law's limit that the policy uses. In an engine that obeys the law, a share just below
                1 succeeds and one just above 1 fails.
        """
        return np.clip(
            np.atleast_1d(np.asarray(self._law_command(fraction), dtype=np.float32)),
            -1.0,
            1.0,
        )

    # --- episode ---

    @property
    def frame_count(self) -> int:
        """Number of frames of an episode, the first included."""
        return self.STEPS + 1

    @property
    def duration_s(self) -> float:
        """Length of an episode [s]."""
        return self.STEPS / FRAME_RATE_HZ

    @property
    def time_s(self) -> float:
        """Time since the start of the episode [s]."""
        return (self._frame or 0) / FRAME_RATE_HZ

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: Seed of the random numbers, which draw the scatter of the start and the goal, if there are any.
                Without it they go on.
            options: `{"jitter": True}` scatters the start, as for `GaugeEnv`; it holds for autoreset too.
        """
        self._check_open("reset")
        moved = self.place(seed, options)
        if moved is not None:
            self._build(moved)
        self.simulation.reset(0 if seed is None else seed)
        started = self.begin()
        self._show()
        return started

    def place(
        self, seed: int | None, options: Mapping[str, Any] | None
    ) -> Experiment | None:
        """Seed the random numbers and draw the start; return the experiment if its world must be built anew.

        Args:
            seed: Seed of a reset, or None.
            options: Its options; None keeps those of the last one, unless there is a seed.
        """
        super().reset(seed=seed)
        jitter = self._starts.of_reset(options, seeded=seed is not None)
        if isinstance(jitter, TrialStart):
            raise ParameterError(
                f"reset of {self._label} has no option 'trial': its episodes are no recorded trials"
            )
        if jitter is None and not self._is_moved:
            return None
        moved = self.experiment
        if isinstance(jitter, Jitter):
            moved = jittered_experiment(
                moved, jitter, seed=int(self.np_random.integers(SEEDS))
            )
            moved = replace(moved, scene=self._cleared(moved.scene))
        self._is_moved = jitter is not None
        if self.MEASURES_FROM_START:
            self._prepare(moved.scene)
            self.limit = self._limit()
        return moved

    def begin(self) -> tuple[FloatArray, dict[str, Any]]:
        """Start a new episode of a world that is at its start; `reset` brings it there."""
        self._frame, self._ending = 0, None
        self.rest_nodes_m = self.nodes_m()
        self._begin()
        observation = self._observation()
        self._observations = [observation]
        return observation, self._info()

    def step(self, action: Any) -> Step:
        """Simulate one frame, 1/30 s."""
        ended = run_frame(self.frame(action), self.simulation)
        self._show()
        return ended

    def frame(self, action: Any) -> Generator[None, None, Step]:
        """Drive one frame of a world that someone else advances; return what `step` returns.

        It yields where the world must advance by 1/180 s: up to six times, less often if the episode ends within the
        frame.
        """
        self._check_running(
            started=self._frame is not None, is_over=self._ending is not None
        )
        return self._run(checked_action(action, self.action_space))

    def _run(self, command: FloatArray) -> Generator[None, None, Step]:
        ending = None
        self._start_frame(command)
        for _ in range(SAMPLES_PER_FRAME):
            self._drive(command)
            yield
            ending = self._look()
            if ending is not None:
                break
        ending = ending or self._frame_ending()
        reward = self._reward(ending)
        self._frame = (self._frame or 0) + 1
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
        """Return the observations of the episode so far, from the start on, shape [frame + 1, len(OBSERVED)]."""
        return np.array(self._observations)

    def report(self) -> LimitReport:
        """Return what the policy reached in the episode and what the law allows."""
        if self._ending is None:
            raise EpisodeError(f"{self._label}: an episode is reported when it is over")
        reached = 0.0 if self._ending is Ending.DIVERGED else self._reached()
        return LimitReport(
            limit=self.limit, reached=reached, ending=self._ending, time_s=self.time_s
        )

    def _info(self) -> dict[str, Any]:
        return {"frame": self._frame, "time_s": self.time_s}

    def _fault(self) -> str | None:
        """Return why the simulation counts as diverged, or None."""
        engine_fault = self.world.fault()
        if engine_fault is not None:
            return engine_fault
        scene = self.experiment.scene
        for name, nodes_m in self.nodes_m().items():
            fault = DeformableBounds(name, scene, self.rest_nodes_m[name]).fault(
                nodes_m
            )
            if fault is not None:
                return fault
        velocities = self.world.body_states(self._dynamic)[:, 7:10]
        return speed_fault(self._dynamic, velocities, scene.speed_limit_m_per_s)

    # --- pictures ---

    def render(self) -> Rendered | None:
        """Return a picture of the scene in the form of the render mode; None without one, and with a window."""
        if self.render_mode is None:
            return None
        self._check_started("render", started=self._frame is not None)
        return self.picture(self._pictures)

    def picture(self, pictures: Pictures) -> Rendered | None:
        """Return a picture of the world as it is now, in the form of the renderer's mode."""
        return pictures.draw(
            self.experiment,
            self.rest_nodes_m,
            reach_m=self.reach_m(),
            poses=self.moving_poses(),
            nodes_m=self.nodes_m(),
        )

    def reach_m(self) -> FloatArray | None:
        """Return places that actions bring bodies to [m], shape [..., 3]; None where the camera shows all."""
        return None

    def moving_poses(self) -> dict[str, FloatArray]:
        """Return position [m] and quaternion of each body that moves, shape [7], by name."""
        return dict(
            zip(self.moving, self.world.body_states(self.moving)[:, :7], strict=True)
        )

    def nodes_m(self) -> dict[str, FloatArray]:
        """Return the nodes of each deformable body now [m], shape [node_count, 3], by name."""
        return {
            body.name: self.world.nodes(body.name)
            for body in self.experiment.scene.deformables
        }
