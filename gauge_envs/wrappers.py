"""Wrappers. `gymnasium.make` applies `ScoreEpisode` to every id of this suite."""

from __future__ import annotations

from typing import Any

import gymnasium

from gauge_envs.env import GaugeEnv
from gauge_envs.episode import score_episode

__all__ = ["ScoreEpisode"]


class ScoreEpisode(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Scores each episode against reality when it ends.

    Adds to `info` at the last step: `score`, a `gauge_envs.Score`. A simulation that diverged has no score: its
    `score` holds the grade and nothing else, and `info["diverged"]` says why.

    Example:
        >>> import gymnasium as gym, gauge_envs
        >>> env = gym.make("GAUGE/BouncingBall-rubber")
        >>> _ = env.reset(seed=0)
        >>> while True:
        ...     *_, truncated, info = env.step(0)
        ...     if truncated:
        ...         break
        >>> round(info["score"].rmse_normalized, 1)
        14.1
    """

    def __init__(self, env: gymnasium.Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        gymnasium.Wrapper.__init__(self, env)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and score at the end."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            env = self.unwrapped
            assert isinstance(env, GaugeEnv)
            info["score"] = score_episode(env.episode, diverged="diverged" in info)
        return observation, reward, terminated, truncated, info
