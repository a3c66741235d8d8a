"""Run a policy on the engine of its training and on another engine, from the same initial states.

    python examples/policy_on_two_engines.py trained/Throw-Limit-rubber-0.zip --id Throw-Limit-rubber --other newton
    python examples/policy_on_two_engines.py my_policies:push --id Push-Limit-wood --trained-on mujoco --other rapier

A policy is a zip of Stable-Baselines3 (extra `rl`), with the statistics of `VecNormalize` in a file .pkl beside it if
it has some; or `module:function`, from an observation to an action. Both run code of the file: run your own.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import typer

import gauge_envs  # noqa: F401


def load_policy(name: str, algorithm: str) -> Callable[[Any], Any]:
    """Return the policy that a file or a name `module:function` holds, as a function of an observation."""
    if not name.endswith(".zip"):
        module, _, function = name.partition(":")
        policy: Callable[[Any], Any] = getattr(import_module(module), function)
        return policy
    model = getattr(import_module("stable_baselines3"), algorithm).load(name, device="cpu")
    file = Path(name).with_suffix(".pkl")
    normalized = pickle.loads(file.read_bytes()).normalize_obs if file.exists() else np.asarray
    return lambda observation: model.predict(normalized(observation), deterministic=True)[0]


def mean_return(experiment: str, backend: str, policy: Callable[[Any], Any], episodes: int) -> float:
    """Return the mean sum of rewards of a policy on an engine; episode i starts by seed i."""
    env = gymnasium.make(f"GAUGE/{experiment}", backend=backend)
    paid = 0.0
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        is_over = False
        while not is_over:
            observation, reward, terminated, truncated, _ = env.step(policy(observation))
            paid += float(reward)
            is_over = terminated or truncated
    env.close()
    return paid / episodes


def main(
    policy: Annotated[str, typer.Argument(help="Zip of Stable-Baselines3, or module:function.")],
    experiment: Annotated[str, typer.Option("--id", help="Experiment or control task.")],
    trained_on: Annotated[str, typer.Option(help="Engine of the training.")] = "mujoco",
    other: Annotated[str, typer.Option(help="Other engine.")] = "newton",
    algorithm: Annotated[str, typer.Option(help="Class of a zip.")] = "PPO",
    episodes: Annotated[int, typer.Option(min=1, help="Number of starts.")] = 5,
) -> None:
    """Print the mean return of a policy on two engines."""
    function = load_policy(policy, algorithm)
    for backend in (trained_on, other):
        print(f"{backend:10s} {mean_return(experiment, backend, function, episodes):.4f}")


if __name__ == "__main__":
    typer.run(main)
