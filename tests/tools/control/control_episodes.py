"""What the tests of control tasks share."""

import gymnasium

from gauge_envs.tools.control.env import ControlEnv
from gauge_envs.tools.control.play import play_paid

FAST = {"timestep_s": 1 / 1080}
"""The longest step that the default contacts allow, for tests that do not need an accurate engine."""


def make(name, **options):
    env = gymnasium.make(f"GAUGE/{name}", **options).unwrapped
    assert isinstance(env, ControlEnv)
    return env


def by_law(env, fraction=1.0, *, seed=0):
    """Return the sum of the rewards of the law's policy, and its report."""
    return play_paid(env, lambda _: env.law_action(fraction), seed=seed)


def with_limit_of(env, nominal):
    """Plant a fault: the task has the limit of another one, as if its simulation did not follow its constants."""
    env._limit = nominal._limit
    return env
