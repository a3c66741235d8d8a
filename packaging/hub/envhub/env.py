"""Control tasks of gauge-envs for LeRobot's EnvHub, as `make_env("OWNER/gauge-envs", trust_remote_code=True)`.

Each task has a maximum that follows from a law of physics and from measured constants.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.vector import (
    AsyncVectorEnv,
    AutoresetMode,
    SyncVectorEnv,
    VectorEnv,
)
from gymnasium.wrappers import AddRenderObservation

import gauge_envs
from gauge_envs.tools.control import names

gym.register_envs(gauge_envs)

SUITE = "gauge_limit"

DESCRIPTIONS = {
    "Turntable": "Turn the plate as fast as the cube's friction allows.",
    "SlopeSlider": "Tilt the board as far as the cube's friction allows.",
    "Pendulum": "Swing the pendulum to 60 degrees with the least work.",
    "Carry": "Carry the cube on the plate to the goal in the shortest time.",
    "Push": "Push the cube to the goal in the shortest time.",
    "Throw": "Throw the ball to the largest height.",
    "Fling": "Fling the free edge of the cloth to the largest height.",
}
"""Instruction of each family of tasks."""

MIN_RATIO = 0.9
"""Smallest share of the maximum that is a success."""


class LeRobotTask(gym.Wrapper):
    """A task with LeRobot's keys: `pixels` and `agent_pos` in observations, `is_success` in the information.

    An episode is a success if the policy reaches 90 % of the maximum. A policy above the maximum by more than two
    standard uncertainties exploits an error of the simulator, which is not a success.

    Args:
        env_id: Id of a control task, as `GAUGE/Turntable-Limit-wood`.
    """

    def __init__(self, env_id: str) -> None:
        env = gym.make(env_id, render_mode="rgb_array", width=256, height=256)
        super().__init__(
            AddRenderObservation(
                env, render_only=False, render_key="pixels", obs_key="agent_pos"
            )
        )
        self.task = env_id
        family = env_id.removeprefix("GAUGE/").partition("-")[0]
        self.task_description = DESCRIPTIONS[family]

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Advance the task by 1/30 s."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        report = info.get("limit")
        is_success = report is not None and report.ratio >= MIN_RATIO and report.z <= 2
        info = {**info, "is_success": is_success}
        return observation, reward, terminated, truncated, info


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None
) -> dict[str, dict[int, VectorEnv]]:
    """Return the vector environment of each task, as `{suite: {number of the task: environment}}`.

    Args:
        n_envs: Number of worlds of each task.
        use_async_envs: Whether each world has its own process.
        cfg: Configuration of LeRobot. Its `task` is an id or a pattern, as `GAUGE/Push-Limit-*`; without it the suite
            has all 15 tasks.

    Raises:
        ValueError: No task matches the pattern.
    """
    pattern = getattr(cfg, "task", None) or "*"
    ids = [f"GAUGE/{name}" for name in names()]
    ids = [env_id for env_id in ids if fnmatchcase(env_id, pattern)]
    if not ids:
        raise ValueError(
            f"no control task matches {pattern!r}, try 'GAUGE/Push-Limit-*'"
        )
    vector = AsyncVectorEnv if use_async_envs else SyncVectorEnv
    return {
        SUITE: {
            number: vector(
                [partial(LeRobotTask, env_id)] * n_envs,
                autoreset_mode=AutoresetMode.SAME_STEP,
            )
            for number, env_id in enumerate(ids)
        }
    }
