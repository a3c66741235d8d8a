"""An episode of an environment beside the bare engine, which repeats the same calls.

The calls of an episode are recorded: `reset`, `drive`, `advance` and `apply_wrench` with their arrays. The engine then
repeats them without observations, rewards and scores. So the difference is what the environment costs.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np

import gauge_envs  # noqa: F401  registers the ids

CALLS = ("reset", "drive", "advance", "apply_wrench")
Call = tuple[Callable[..., Any], tuple[Any, ...]]


def settings_of(preset: str) -> dict[str, str] | None:
    """Return the settings that select a preset."""
    return None if preset == "default" else {"preset": preset}


def episode_ratio(name: str, preset: str, *, budget_s: float) -> float:
    """Return the processor time of an episode with random actions over the bare engine's, the median of pairs.

    Args:
        name: Id without `GAUGE/`.
        preset: Preset of MuJoCo.
        budget_s: Processor time to spend [s]; at least one pair is measured.
    """
    env = gymnasium.make(f"GAUGE/{name}", settings=settings_of(preset))
    actions = actions_of(env.action_space, env.spec.max_episode_steps)
    bare_s, full_s = paired_s(env, simulation_of(env), actions, budget_s)
    return statistics.median(np.divide(full_s, bare_s).tolist())


def python_s(name: str, world_count: int, steps: int, *, budget_s: float) -> float:
    """Return the processor time of a world and a step outside the engine's calls, with random actions [s].

    Args:
        name: Id without `GAUGE/`.
        world_count: Number of worlds; 0 is a single environment.
        steps: Number of steps.
        budget_s: Processor time to spend [s]; at least one pair is measured.
    """
    settings = settings_of("training")
    if world_count:
        count = world_count
        env = gymnasium.make_vec(f"GAUGE/{name}", num_envs=count, settings=settings)
    else:
        count = 1
        env = gymnasium.make(f"GAUGE/{name}", settings=settings)
    actions = actions_of(env.action_space, steps)
    bare_s, full_s = paired_s(env, simulation_of(env), actions, budget_s)
    difference_s = statistics.median(np.subtract(full_s, bare_s).tolist())
    return difference_s / (steps * count)


def actions_of(space: gymnasium.Space[Any], count: int) -> list[Any]:
    """Return random actions, a tenth of their range."""
    space.seed(0)
    samples = [space.sample() for _ in range(count)]
    is_continuous = isinstance(space, gymnasium.spaces.Box)
    return [np.float32(0.1) * sample if is_continuous else sample for sample in samples]


def simulation_of(env: Any) -> Any:
    """Return the simulation of an environment."""
    inner = env.unwrapped
    return inner.rollout.simulation if hasattr(inner, "rollout") else inner.simulation


def paired_s(
    env: Any, simulation: Any, actions: Sequence[Any], budget_s: float
) -> tuple[list[float], list[float]]:
    """Return processor times of repeated calls and of episodes, which alternate [s]."""
    calls: list[Call] = []
    for name in CALLS:
        setattr(simulation, name, _recorder(getattr(simulation, name), calls))
    run(env, actions)
    for name in CALLS:
        delattr(simulation, name)
    bare_s, full_s = [], []
    start = time.process_time()
    while not bare_s or time.process_time() - start < budget_s:
        bare_s.append(process_s(lambda: repeat(calls)))
        full_s.append(process_s(lambda: run(env, actions)))
    return bare_s, full_s


def _recorder(call: Callable[..., Any], calls: list[Call]) -> Callable[..., Any]:
    """Return a method that adds itself and copies of its arguments to a list."""

    def recorded(*arguments: Any) -> Any:
        copies = [
            argument.copy() if isinstance(argument, np.ndarray) else argument
            for argument in arguments
        ]
        calls.append((call, tuple(copies)))
        return call(*arguments)

    return recorded


def repeat(calls: Sequence[Call]) -> None:
    """Repeat recorded calls."""
    for call, arguments in calls:
        call(*arguments)


def run(env: Any, actions: Sequence[Any]) -> None:
    """Step an environment until an episode ends or the actions end."""
    env.reset(seed=0)
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        if np.count_nonzero(terminated | truncated):
            return


def process_s(call: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    start = time.process_time()
    call()
    return time.process_time() - start
