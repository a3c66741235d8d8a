"""Train a policy on a control task with a known optimum, and compare it with the law's own policy on unseen starts.

    python examples/train_control.py --task Throw-Limit-rubber --seed 0

It needs the extra `rl`, trains PPO on one core, and writes OUT/TASK-SEED.zip (Stable-Baselines3), OUT/TASK-SEED.pkl
(the statistics that scale observations) and OUT/TASK-SEED.csv (the learning curve). `policy_on_two_engines.py` runs
the first two on another engine.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
import typer
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import gauge_envs  # noqa: F401
from gauge_envs.tools.control import ControlEnv
from gauge_envs.tools.control.env import Ending, LimitReport, Policy, play_paid

UNSEEN = 10_000
"""Seed of the first unseen start; trainings have smaller seeds."""

DISCOUNTS: Mapping[str, tuple[float, float]] = {
    "Carry": (0.95, 0.9),
    "Push": (0.95, 0.9),
    "Throw": (0.95, 0.9),
    "Fling": (0.999, 0.95),
    "Turntable": (0.99, 0.95),
    "SlopeSlider": (0.99, 0.95),
    "Pendulum": (0.99, 0.95),
}
"""Discounts of rewards and of advantages in a step of 1/30 s.

An arrival is 13 to 52 steps away. A cloth swings highest after 80 steps, and a discount would prefer a swing in 40. The
last three are the defaults of PPO.
"""

SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "Carry": {"timestep_s": 1 / 1080},
    "Throw": {"timestep_s": 1 / 1080},
    "Push": {"timestep_s": 1 / 3600},
    "Fling": {"preset": "training"},
}
"""Settings of MuJoCo with which the law's policy reaches 0.96 or more of its result with the default settings.

The other tasks train with the default settings.
"""

WORLDS = 16
"""Number of worlds of a training."""

FIRST_NOISE: Mapping[str, float] = {"Carry": 0.22, "Push": 0.22, "Throw": 0.6, "Fling": 0.6}
"""First standard deviation of the actions: more would hide an arrival within 20 mm/s, less would not find the ball.

It is 1 for the other tasks, as by default.
"""


def trained(task: str, seed: int, steps: int, settings: Mapping[str, Any], curve: Callable[[PPO], None]) -> PPO:
    """Train PPO and return it; its environment holds the statistics of the observations."""
    # With networks this small, threads only add cost.
    torch.set_num_threads(1)
    family = task.partition("-")[0]
    gamma, gae_lambda = DISCOUNTS[family]
    worlds = [partial(Monitor, make_task(task, settings)) for _ in range(WORLDS)]
    scaled = VecNormalize(DummyVecEnv(worlds), gamma=gamma)
    model = PPO(
        "MlpPolicy",
        scaled,
        n_steps=64,
        batch_size=128,
        n_epochs=10,
        gamma=gamma,
        gae_lambda=gae_lambda,
        # The last rollout ends after the last step, where the rest of the training is negative.
        learning_rate=lambda left: 2e-3 * max(left, 0.0),
        policy_kwargs={"log_std_init": math.log(FIRST_NOISE.get(family, 1.0)), "net_arch": [64, 64]},
        seed=seed,
        device="cpu",
    )
    model.learn(steps, callback=Every(steps // 10, curve))
    return model


class Every(BaseCallback):
    """Call a function of the model about every so many steps, and at the end."""

    def __init__(self, steps: int, call: Callable[[PPO], None]) -> None:
        super().__init__()
        self._steps, self._next, self._call = steps, 0, call

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._next:
            self._next += self._steps
            self._call(self.model)
        return True

    def _on_training_end(self) -> None:
        self._call(self.model)


def deterministic(model: PPO) -> Policy:
    """Return the policy without exploration."""
    scaled = model.get_vec_normalize_env()
    return lambda observation: model.predict(scaled.normalize_obs(observation), deterministic=True)[0]


def make_task(task: str, settings: Mapping[str, Any]) -> ControlEnv:
    """Return the environment of a task with initial-state noise of the measured uncertainty."""
    # The rod holds the cloth of Fling, which always starts alike.
    jitter = None if task.startswith("Fling") else "real"
    env = gymnasium.make(f"GAUGE/{task}", settings=settings, jitter=jitter).unwrapped
    assert isinstance(env, ControlEnv)
    return env


def played(env: ControlEnv, policy: Policy | None = None) -> tuple[float, list[LimitReport]]:
    """Return the mean reward and the reports of a policy, or of the law's policy, on ten unseen starts."""
    policy = policy or (lambda _: env.law_action(1.0))
    runs = [play_paid(env, policy, seed=UNSEEN + number) for number in range(10)]
    return float(np.mean([paid for paid, _ in runs])), [report for _, report in runs]


def summary(reports: list[LimitReport]) -> str:
    """Return the number of successful episodes, and their results relative to the law."""
    ratios = [report.ratio for report in reports]
    reached = sum(report.ending is Ending.REACHED for report in reports)
    return f"{reached} of {len(reports)} succeed, ratio {np.mean(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})"


def main(
    task: Annotated[str, typer.Option(help="An id with Limit in its name.")] = "Throw-Limit-rubber",
    seed: Annotated[int, typer.Option(min=0, max=UNSEEN - 1, help="Seed of the training.")] = 0,
    steps: Annotated[int, typer.Option(min=10, help="Steps of training, all worlds together.")] = 60_000,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("trained"),
) -> None:
    """Train a policy, and compare it with the law's own on ten unseen starts."""
    settings = SETTINGS.get(task.partition("-")[0], {})
    env, began_s = make_task(task, settings), time.perf_counter()
    rows: list[tuple[float, ...]] = []

    def look(model: PPO) -> None:
        paid, reports = played(env, deterministic(model))
        arrived = np.mean([report.ending is Ending.REACHED for report in reports])
        ratio = np.mean([report.ratio for report in reports])
        rows.append((model.num_timesteps, time.perf_counter() - began_s, time.process_time(), arrived, ratio, paid))
        print(f"{model.num_timesteps:7d} steps, {rows[-1][1]:4.0f} s: {summary(reports)}", flush=True)

    model = trained(task, seed, steps, settings, look)
    out.mkdir(parents=True, exist_ok=True)
    model.save(out / f"{task}-{seed}.zip")
    model.get_vec_normalize_env().save(str(out / f"{task}-{seed}.pkl"))
    with (out / f"{task}-{seed}.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("steps", "wall_s", "cpu_s", "success", "ratio", "reward"), *rows])
    print(f"trained:  {summary(played(env, deterministic(model))[1])}")
    print(f"the law:  {summary(played(env)[1])}")


if __name__ == "__main__":
    typer.run(main)
