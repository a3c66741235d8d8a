"""Gymnasium environments of the control tasks: `ControlEnv` is one world of a task, and `ControlVectorEnv` is N."""

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from gauge_envs.envs.arguments import check_episode_steps, checked_action
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.guards import GuardedEnv, one_thread
from gauge_envs.envs.initial_states import Draw, Scatter
from gauge_envs.envs.pictures import (
    WORLDS_RENDER_MODES,
    Pictures,
    Rendered,
    rollout_picture,
)
from gauge_envs.envs.vector import GaugeVectorEnv, WorldsEnv
from gauge_envs.errors import EpisodeError
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.control.ids import FAMILIES
from gauge_envs.tools.control.task import ControlTask, LimitReport, made_task

MAX_OBSERVATION = 1e5
"""Bound on the absolute values of observations [SI units]. Only diverged episodes come near it."""


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
