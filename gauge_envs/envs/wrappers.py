"""The wrapper that scores episodes, which `gymnasium.make` applies to every id, innermost; and one that logs scores."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

from gauge_envs.envs.arguments import warn_without_reward
from gauge_envs.envs.env import GaugeEnv

if TYPE_CHECKING:
    from gauge_envs.scoring.score import Score


class EndWrapper(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    """Add entries to `info` at the last step of an episode."""

    def __init__(self, env: gymnasium.Env) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        gymnasium.Wrapper.__init__(self, env)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and add the entries if the episode ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            self._add(info)
        return observation, reward, terminated, truncated, info

    def _add(self, info: dict[str, Any]) -> None:
        """Add the entries of the episode that has ended."""
        raise NotImplementedError


class ScoreEpisode(EndWrapper):
    """Score each episode when it ends.

    Adds to `info` at the last step: `score`, a `gauge_envs.Score`. If the simulation diverged, the score has a kind
    and no number, and `info["diverged"]` gives the reason. An episode that another wrapper cuts short has no score.
    Other wrappers may come before or after this one.

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

    def _add(self, info: dict[str, Any]) -> None:
        env = self.unwrapped
        assert isinstance(env, GaugeEnv)
        score = env.score()
        if score is not None:
            info["score"] = score


LOGGED = (
    "rmse",
    "rmse_normalized",
    "rmse_aligned",
    "rmse_aligned_normalized",
    "percentile",
    "over_uncertainty",
    "marker_rmse_mm",
)
"""Fields of a score that `LogScore` sends."""


class LogScore(gymnasium.Wrapper):
    """Send the score of each episode to TensorBoard or to Weights & Biases, as `score/rmse` and the like.

    With Stable-Baselines3 or CleanRL it goes around each environment; the step is that of the environment. Fields that
    an id does not have are left out.

    Args:
        env: Scored environment, within other wrappers or not.
        logger: A `SummaryWriter` of TensorBoard, or `wandb.log` and functions like it: values by name, and `step`.

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
        """Step, and send the score if the episode ends with one."""
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
    """Return what is known of the fields in `LOGGED`, by name."""
    values = {name: getattr(score, name) for name in LOGGED}
    return {
        f"score/{name}": value for name, value in values.items() if value is not None
    }


def scored_env(*, score: bool = True, **arguments: Any) -> ScoreEpisode | GaugeEnv:
    """Return a `GaugeEnv` that is scored; `gymnasium.make` calls this for every id.

    The wrapper is not part of the registration, because `make_vec` refuses an id that has both wrappers and a vector
    environment of its own.

    Args:
        score: Whether to score each episode. A score of a short episode may take longer than its steps, and training
            needs rewards alone.
        **arguments: Arguments of `GaugeEnv`.

    Warns:
        NoRewardWarning: The experiment has no reference in use, so that every reward is 0; once for each id.
    """
    env = GaugeEnv(**arguments)
    warn_without_reward(env.experiment, env.band)
    return ScoreEpisode(env) if score else env


# `gymnasium.make` reads the render modes from here.
scored_env.metadata = GaugeEnv.metadata  # type: ignore[attr-defined]
