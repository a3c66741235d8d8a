"""Wrappers. `gymnasium.make` applies `ScoreEpisode` to every id of this suite."""

from __future__ import annotations

from typing import Any

import gymnasium

from gauge_envs.env import GaugeEnv
from gauge_envs.score import Score, score_trajectory

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
            info["score"] = self._score(diverged="diverged" in info)
        return observation, reward, terminated, truncated, info

    def _score(self, *, diverged: bool) -> Score:
        env = self.unwrapped
        assert isinstance(env, GaugeEnv)
        if diverged:
            grade = "none" if env.band is None else env.band.grade.value
            return Score(grade=grade, unit=env.experiment.spec.score.observable.unit)
        trajectory = env.trajectory()
        return score_trajectory(env.experiment, env.band, times_s=trajectory.times_s, values=trajectory.samples)
