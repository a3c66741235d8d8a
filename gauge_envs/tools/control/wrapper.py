"""The wrapper that reports control tasks, and the entry point of their ids, which applies it."""

from typing import Any

from gymnasium.envs.registration import load_env_creator

from gauge_envs.envs.wrappers import EndWrapper
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.tasks import find_control_task


class ReportLimit(EndWrapper):
    """Report what the policy reached and what the law allows when an episode ends.

    Adds to `info` at the last step: `limit`, a `gauge_envs.tools.control.limit.LimitReport`.

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
        info["limit"] = env.report()


def control_env(task: str, **arguments: Any) -> ReportLimit:
    """Return a control task that is reported; `gymnasium.make` calls this for every id.

    The wrapper is not part of the registration, because `make_vec` refuses an id that has both wrappers and a vector
    environment of its own.

    Args:
        task: Name of the task, as `Carry-Limit-wood`.
        **arguments: Keywords of `ControlEnv`.
    """
    found = find_control_task(task)
    env = load_env_creator(found.entry_point)(material=found.material, **arguments)
    assert isinstance(env, ControlEnv)
    return ReportLimit(env)


# `gymnasium.make` reads the render modes from here.
control_env.metadata = ControlEnv.metadata  # type: ignore[attr-defined]
