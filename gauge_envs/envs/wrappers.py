"""The wrapper that scores episodes. `gymnasium.make` applies it to every id of this suite, innermost."""

from typing import Any

import gymnasium

from gauge_envs.envs.arguments import warn_without_reward
from gauge_envs.envs.env import GaugeEnv


class ScoreEpisode(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Score each episode against reality when it ends.

    Adds to `info` at the last step: `score`, a `gauge_envs.Score`. If the simulation diverged, the score has a grade
    and no metric, and `info["diverged"]` gives the reason. An episode that another wrapper cuts short has no score.
    Other wrappers may come before or after this one.

    Adds also `deformation`, a `gauge_envs.evaluation.deformation.DeformationScore`, for a foam with real statistics of
    deformation; None for others.

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
        """Step, and score the episode if it ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            env = self.unwrapped
            assert isinstance(env, GaugeEnv)
            score = env.score()
            if score is not None:
                info["score"] = score
                info["deformation"] = env.deformation()
        return observation, reward, terminated, truncated, info


def scored_env(**arguments: Any) -> ScoreEpisode:
    """Return a `GaugeEnv` that is scored; `gymnasium.make` calls this for every id.

    The wrapper is not part of the registration, because `make_vec` refuses an id that has both wrappers and a vector
    environment of its own.

    Args:
        **arguments: Arguments of `GaugeEnv`.

    Warns:
        NoRewardWarning: The experiment has no reference in use, so that every reward is 0; once for each id.
    """
    env = GaugeEnv(**arguments)
    warn_without_reward(env.experiment, env.band)
    return ScoreEpisode(env)


# `gymnasium.make` reads the render modes from here.
scored_env.metadata = GaugeEnv.metadata  # type: ignore[attr-defined]
