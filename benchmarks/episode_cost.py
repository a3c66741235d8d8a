"""Processor time of an environment beside the time within MuJoCo's `mj_step`.

`mj_step` is timed where the package calls it, in every second run, without the time of the timer. All other time, such
as driving and reading the bodies, is the package's.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import gymnasium
import mujoco
import numpy as np

import gauge_envs  # noqa: F401  registers the ids


class Cost(NamedTuple):
    """Processor time of a step of one world [s].

    Attributes:
        total_s: The whole step.
        engine_s: The part within `mj_step`.
    """

    total_s: float
    engine_s: float


def step_cost(
    name: str, preset: str, world_count: int, *, budget_s: float, steps: int = 30
) -> Cost:
    """Return the cost of a step with random actions and without scores, the median of repeats.

    Args:
        name: Id without `GAUGE/`.
        preset: Preset of MuJoCo.
        world_count: Number of worlds of `make_vec`; 0 is a single environment.
        budget_s: Processor time to spend [s]; at least three repeats are measured.
        steps: Steps of a repeat.
    """
    settings = None if preset == "default" else {"preset": preset}
    options: dict[str, Any] = {"settings": settings}
    if "Limit" not in name:
        options["score"] = False
    if world_count:
        env: Any = gymnasium.make_vec(f"GAUGE/{name}", world_count, **options)
    else:
        env = gymnasium.make(f"GAUGE/{name}", disable_env_checker=True, **options)
    actions, costs, start_s = _actions(env.action_space, steps), [], time.process_time()
    env.reset(seed=0)
    worlds = steps * max(world_count, 1)
    while len(costs) < 3 or time.process_time() - start_s < budget_s:
        total_s = process_s(lambda: _run(env, actions))
        with _timed_steps() as times_s:
            _run(env, actions)
        costs.append(Cost(total_s / worlds, sum(times_s) / worlds))
    env.close()
    return Cost(*(statistics.median(column) for column in zip(*costs, strict=True)))


@contextmanager
def _timed_steps() -> Iterator[list[float]]:
    """Yield a list of the times of each call of `mj_step` [s]."""
    step, times_s = mujoco.mj_step, []
    empty_s = [-time.thread_time() + time.thread_time() for _ in range(100)]
    timer_s = statistics.median(empty_s)

    def timed(*arguments: Any, **options: Any) -> None:
        start = time.thread_time()
        step(*arguments, **options)
        times_s.append(time.thread_time() - start - timer_s)

    mujoco.mj_step = timed
    try:
        yield times_s
    finally:
        mujoco.mj_step = step


def _actions(space: gymnasium.Space[Any], count: int) -> list[Any]:
    """Return random actions, half of their range."""
    space.seed(0)
    samples = [space.sample() for _ in range(count)]
    is_continuous = isinstance(space, gymnasium.spaces.Box)
    return [np.float32(0.5) * sample if is_continuous else sample for sample in samples]


def _run(env: Any, actions: list[Any]) -> None:
    """Step an environment, and reset a single one after the end of an episode."""
    is_single = isinstance(env, gymnasium.Env)
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        if is_single and (terminated or truncated):
            env.reset()


def process_s(call: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    start = time.process_time()
    call()
    return time.process_time() - start
