"""What the tests of control tasks share."""

import gymnasium

from gauge_envs.tools.control.env import ControlEnv, play_paid

FAST = {"timestep_s": 1 / 1080}
"""The longest step that the default contacts allow, for tests that do not need an accurate engine."""


def make(name, **options):
    env = gymnasium.make(f"GAUGE/{name}", **options).unwrapped
    assert isinstance(env, ControlEnv)
    return env


def by_law(env, fraction=1.0, *, seed=0):
    """Return the sum of the rewards of the law's policy, and its report."""
    return play_paid(env, lambda _: env.law_action(fraction), seed=seed)


def play(env, policy, *, seed=0):
    """Return the report of a policy."""
    return play_paid(env, policy, seed=seed)[1]


def with_limit_of(env, nominal):
    """Plant a fault: the task has the limit of another one, as if its simulation did not follow its constants."""
    begin = env.task._begin

    def begin_with_wrong_limit(worlds, randoms):
        begin(worlds, randoms)
        env.task.limits[:] = nominal.task.limits

    env.task._begin = begin_with_wrong_limit
    return env
