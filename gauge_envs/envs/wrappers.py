"""Wrappers that score episodes and log scores; `gymnasium.make` applies the first one to every id, innermost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

from gauge_envs.envs.arguments import warn_before_use
from gauge_envs.envs.env import GaugeEnv

if TYPE_CHECKING:
    from gauge_envs.scoring.score import Score


class ScoreEpisode(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Score each episode when it ends.

    It adds to `info` at the last step: `score`, a `gauge_envs.Score`. If the simulation diverged, the score has no
    numbers, and `info["diverged"]` gives the reason. If another wrapper cuts an episode short, it has no score. Other
    wrappers may come before or after this one.

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
        env = self.unwrapped
        assert isinstance(env, GaugeEnv)
        if terminated or truncated:
            score = env.score()
            if score is not None:
                info["score"] = score
        return observation, reward, terminated, truncated, info


LOGGED = (
    "rmse",
    "rmse_normalized",
    "rmse_aligned",
    "rmse_aligned_normalized",
    "solution_distance",
)
"""Fields of a score that `LogScore` sends, if they are known."""


class LogScore(gymnasium.Wrapper):
    """Send the score of each episode to TensorBoard or Weights & Biases, as `score/rmse` and further fields.

    With Stable-Baselines3 or CleanRL, wrap each environment; the step is the step of the environment. Fields without a
    value are left out.

    Args:
        env: Scored environment, with or without other wrappers.
        logger: A `SummaryWriter` of TensorBoard; or `wandb.log` or another function of values by name and `step`.

    Example:
        >>> import gymnasium as gym, gauge_envs
        >>> def log(values, step):
        ...     print(step, round(values["score/rmse_aligned"], 2))
        >>> env = gauge_envs.LogScore(gym.make("GAUGE/SlopeSlider-2-wood"), log)
        >>> _ = env.reset(seed=0)
        >>> over = False
        >>> while not over:
        ...     *_, over, info = env.step(0)
        18 3.33
    """

    def __init__(self, env: gymnasium.Env, logger: Any) -> None:
        super().__init__(env)
        self.step_count = 0
        self._logger = logger

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and send the score at the end of an episode."""
        outcome = self.env.step(action)
        self.step_count += 1
        score = outcome[4].get("score")
        if score is not None:
            self._send(_logged(score))
        return outcome

    def _send(self, values: dict[str, float]) -> None:
        if not hasattr(self._logger, "add_scalar"):
            self._logger(values, step=self.step_count)
            return
        for name, value in values.items():
            self._logger.add_scalar(name, value, self.step_count)


def _logged(score: Score) -> dict[str, float]:
    """Return the known fields in `LOGGED`, by name."""
    values = {name: getattr(score, name) for name in LOGGED}
    return {
        f"score/{name}": value for name, value in values.items() if value is not None
    }


def scored_env(*, score: bool = True, **arguments: Any) -> ScoreEpisode | GaugeEnv:
    """Return a `GaugeEnv` that is scored; `gymnasium.make` calls this for every id.

    The wrapper is not part of the registration, because `make_vec` rejects an id with both wrappers and its own vector
    environment.

    Args:
        score: Whether to score each episode. The score of a short episode may take longer than its steps, and training
            needs only rewards.
        **arguments: Arguments of `GaugeEnv`.

    Warns:
        NoRewardWarning: Rewards or scores are missing; once for each id and cause.
        UserWarning: A restitution of the user has no effect; once for each experiment.
    """
    env = GaugeEnv(**arguments)
    warn_before_use(env.experiment, env.band)
    return ScoreEpisode(env) if score else env


# `gymnasium.make` reads the render modes from here.
scored_env.metadata = GaugeEnv.metadata  # type: ignore[attr-defined]
