"""Wrappers. `gymnasium.make` applies `ScoreEpisode` to every id of this suite, innermost."""

from __future__ import annotations

from typing import Any

import gymnasium

from gauge_envs.envs.env import GaugeEnv

__all__ = [
    "ScoreEpisode",
    "scored_env",
]


class ScoreEpisode(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Scores each episode against reality when it ends.

    Adds to `info` at the last step: `score`, a `gauge_envs.Score`. A simulation that diverged has no score: its
    `score` holds the grade and nothing else, and `info["diverged"]` says why. An episode that another wrapper cuts
    short has none. Other wrappers may come before or after it.

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
            score = env.score()
            if score is not None:
                info["score"] = score
        return observation, reward, terminated, truncated, info


def scored_env(**arguments: Any) -> ScoreEpisode:
    """What `gymnasium.make` calls for every id: a `GaugeEnv` that is scored.

    Wrappers that an id is registered with would rule out a vector environment of its own: `make_vec` refuses both.

    Args:
        **arguments: As of `GaugeEnv`.

    Raises:
        GaugeError: As of `GaugeEnv`.
    """
    return ScoreEpisode(GaugeEnv(**arguments))


# Read by `gymnasium.make`, which adapts other render modes to those that it finds here.
scored_env.metadata = GaugeEnv.metadata  # type: ignore[attr-defined]
