"""The wrapper that reports control tasks; `gymnasium.make` applies it to their ids."""

from typing import Any

from gauge_envs.envs.wrappers import EndWrapper
from gauge_envs.tools.control.env import ControlEnv


class ReportLimit(EndWrapper):
    """Report what the policy reached and what the law allows when an episode ends.

    Adds to `info` at the last step: `limit`, a `gauge_envs.tools.control.limit.LimitReport`. An episode that another
    wrapper cuts short has no report.

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

    def _add(self, info: dict[str, Any]) -> None:
        env = self.unwrapped
        assert isinstance(env, ControlEnv)
        if env.is_over:
            info["limit"] = env.report()
