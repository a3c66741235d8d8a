"""Episodes of policies in control tasks, and how closely an engine follows the law."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.limit import Ending, LimitReport

Policy = Callable[[FloatArray], NDArray[np.floating]]
"""Function that returns an action, shape [len(COMMANDED)], for an observation."""


def play(env: ControlEnv, policy: Policy, *, seed: int = 0) -> LimitReport:
    """Run one episode and return its report; see `play_paid`."""
    return play_paid(env, policy, seed=seed)[1]


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
    paid = 0.0
    while not env.is_over:
        observation, reward, *_ = env.step(policy(observation))
        paid += reward
    return paid, env.report()


def engine_limit(
    env: ControlEnv,
    *,
    bounds: tuple[float, float] = (0.2, 1.5),
    resolution: float = 0.002,
) -> float:
    """Return the largest share of the law's limit that the law's policy can use in the engine, by bisection.

    It is 1 in an engine that obeys the law. Above 1 the engine allows more than reality.

    Args:
        env: The task, without wrappers.
        bounds: A share of the limit with which the policy succeeds, and a share with which it fails.
        resolution: Largest width of the last interval; the result is its middle.

    Raises:
        ParameterError: The policy fails with the lower bound, or succeeds with the upper bound.
    """
    low, high = bounds

    def succeeds(share: float) -> bool:
        report = play(env, lambda _: env.law_action(share))
        return report.ending in (Ending.HELD, Ending.REACHED)

    if not succeeds(low) or succeeds(high):
        raise ParameterError(
            f"{env.FAMILY}: the law's policy must succeed with {low} of the limit and fail with {high}"
        )
    while high - low > resolution:
        middle = 0.5 * (low + high)
        if succeeds(middle):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
