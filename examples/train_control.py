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
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
import typer
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

import gauge_envs  # noqa: F401
from gauge_envs.tools.control import ControlVectorEnv, LimitReport, names

UNSEEN = 10_000
"""Seed of the first unseen start; trainings have smaller seeds."""

DISCOUNTS: Mapping[str, tuple[float, float]] = {
    "Carry": (0.95, 0.9),
    "Push": (0.95, 0.9),
    "Throw": (0.95, 0.9),
    "Turntable": (0.95, 0.9),
    "SlopeSlider": (0.95, 0.9),
    "Fling": (0.999, 0.95),
}
"""Discounts of rewards and of advantages in a step of 1/30 s, in place of PPO's defaults 0.99 and 0.95.

An arrival is 13 to 52 steps away, and a slip costs the rewards of 30 steps. A cloth swings highest after 80 steps, and
a discount would prefer a swing in 40.
"""

SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "Carry": {"timestep_s": 1 / 360},
    "Push": {"timestep_s": 1 / 3600},
}
"""Settings of MuJoCo with which the law's policy reaches 0.96 or more of its result with the default settings.

The other tasks train with the preset `training`.
"""

WORLDS: Mapping[str, int] = {"Carry": 32}
"""Number of worlds of a training, 16 for the other tasks. A batch has eight steps of each."""

STARTS = 10
"""Number of unseen starts."""

FIRST_NOISE: Mapping[str, float] = {"Carry": 0.22, "Push": 0.22, "Turntable": 0.3, "SlopeSlider": 0.3, "Pendulum": 1.0}
"""First standard deviation of the actions, 0.6 for the other tasks.

More would hide an arrival within 20 mm/s or cause a slip; less would not find the ball.
"""

LAST_NOISE: Mapping[str, float] = {"Push": 0.022}
"""Last standard deviation of the actions, which falls linearly; the other tasks learn theirs.

In Push one or two actions decide how far the cube coasts: a noise of 0.1 moves its end by more than the goal's 15 mm.
In Carry less noise slowed the training, from a ratio of 0.64 to 0.18 (training seed 7, starts from 20,000 on).
"""

LEARNING_RATE: Mapping[str, float] = {"Carry": 1e-3}
"""First learning rate, 0.002 for the other tasks."""


STEPS: Mapping[str, int] = {"Carry": 200_000}
"""Steps of a training, 60,000 for the other tasks; Carry still improves there. Each takes less than two CPU minutes."""

LAW_SHARE = 0.98
"""Share of the maximum that the law's policy uses; at 1, every slip of the simulator ends its episode."""


class Worlds(VecEnv):
    """Worlds of `gymnasium.make_vec` as Stable-Baselines3 takes them; its `DummyVecEnv` steps them one by one."""

    def __init__(self, envs: gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        self._envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:
        """Start an episode in all worlds."""
        return self._envs.reset(seed=self._seeds)[0]

    def step_async(self, actions: Any) -> None:
        """Keep the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Step all worlds; those that end restart, and their last observations are in the infos."""
        observations, rewards, terminated, truncated, infos = self._envs.step(self._actions)
        rows: list[dict[str, Any]] = [{} for _ in rewards]
        for world in np.flatnonzero(terminated | truncated):
            rows[world] = {
                "terminal_observation": infos["final_obs"][world],
                "TimeLimit.truncated": bool(truncated[world]),
            }
        return observations, rewards, terminated | truncated, rows

    def close(self) -> None:
        """Close the worlds."""
        self._envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute that all worlds share."""
        return [getattr(self._envs, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the worlds are one environment."""
        raise NotImplementedError("the worlds are one environment")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuse: the worlds are one environment."""
        raise NotImplementedError("the worlds are one environment")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for each world, as wrappers are around all of them."""
        return [False] * self.num_envs


def make_worlds(task: str, count: int, mode: str) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    """Return worlds of a task with initial-state noise of the measured uncertainty."""
    family = task.partition("-")[0]
    settings = SETTINGS.get(family, {"preset": "training"})
    # The rod holds the cloth of Fling, which always starts alike.
    jitter = None if family == "Fling" else "real"
    return gymnasium.make_vec(f"GAUGE/{task}", count, settings=settings, jitter=jitter, autoreset_mode=mode)


def trained(task: str, seed: int, steps: int, curve: Callable[[PPO], None]) -> PPO:
    """Train PPO and return it; its environment holds the statistics of the observations."""
    # With networks this small, threads only add cost.
    torch.set_num_threads(1)
    family = task.partition("-")[0]
    gamma, gae_lambda = DISCOUNTS.get(family, (0.99, 0.95))
    worlds = make_worlds(task, WORLDS.get(family, 16), "SameStep")
    scaled = VecNormalize(VecMonitor(Worlds(worlds)), gamma=gamma)
    model = PPO(
        "MlpPolicy",
        scaled,
        n_steps=64,
        batch_size=8 * worlds.num_envs,
        n_epochs=10,
        gamma=gamma,
        gae_lambda=gae_lambda,
        # The last rollout ends after the last step, where the rest of the training is negative.
        learning_rate=lambda left: LEARNING_RATE.get(family, 2e-3) * max(left, 0.0),
        policy_kwargs={"log_std_init": math.log(FIRST_NOISE.get(family, 0.6)), "net_arch": [64, 64]},
        seed=seed,
        device="cpu",
    )
    callbacks: list[BaseCallback] = [Every(steps // 10, curve)]
    if family in LAST_NOISE:
        callbacks.append(LessNoise(steps, FIRST_NOISE[family], LAST_NOISE[family]))
    model.learn(steps, callback=callbacks)
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


class LessNoise(BaseCallback):
    """Lower the standard deviation of the actions linearly, in place of learning it."""

    def __init__(self, steps: int, first: float, last: float) -> None:
        super().__init__()
        self._steps, self._first, self._last = steps, first, last

    def _on_rollout_start(self) -> None:
        left = max(1.0 - self.num_timesteps / self._steps, 0.0)
        noise = self._last + (self._first - self._last) * left
        self.model.policy.log_std.requires_grad_(False).fill_(math.log(noise))

    def _on_step(self) -> bool:
        return True


Policy = Callable[[np.ndarray], Any]
"""Function of the observations of all worlds that returns their actions."""


def deterministic(model: PPO) -> Policy:
    """Return the policy without exploration."""
    scaled = model.get_vec_normalize_env()
    return lambda observations: model.predict(scaled.normalize_obs(observations), deterministic=True)[0]


def played(task: str, policy: Policy | None = None) -> tuple[float, list[LimitReport]]:
    """Return the mean return over its limit and the reports of a policy, or of the law's policy, on unseen starts."""
    envs = make_worlds(task, STARTS, "NextStep")
    worlds = envs.unwrapped
    assert isinstance(worlds, ControlVectorEnv)
    observations, _ = envs.reset(seed=UNSEEN)
    returns, reports = np.zeros(STARTS), np.full(STARTS, None)
    while (playing := np.equal(reports, None)).any():
        if policy is None:
            actions = np.array([worlds.task.law_action(LAW_SHARE, world) for world in range(STARTS)])
        else:
            actions = policy(observations)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        returns[playing] += rewards[playing]
        over = playing & (terminated | truncated)
        if over.any():
            reports[over] = infos["limit"][over]
    envs.close()
    return float(np.mean([paid / report.return_limit for paid, report in zip(returns, reports, strict=True)])), [
        *reports
    ]


def summary(paid: float, reports: Sequence[LimitReport]) -> str:
    """Return the number of successful episodes, and returns and results relative to the law."""
    ratios = [report.ratio for report in reports]
    succeeded = sum(report.is_success for report in reports)
    return (
        f"{succeeded} of {len(reports)} succeed, return {paid:.3f} of its limit, "
        f"ratio {np.mean(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})"
    )


def main(
    task: Annotated[str, typer.Option(help="An id with Limit in its name.")] = "Throw-Limit-rubber",
    seed: Annotated[int, typer.Option(min=0, max=UNSEEN - 1, help="Seed of the training.")] = 0,
    steps: Annotated[
        int | None, typer.Option(min=10, help="Steps of training, all worlds together. [default: of the task]")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("trained"),
) -> None:
    """Train a policy, and compare it with the law's own on ten unseen starts."""
    if task not in names():
        raise typer.BadParameter(f"--task {task}: no control task has this name; choose one of {', '.join(names())}")
    steps = steps or STEPS.get(task.partition("-")[0], 60_000)
    began_s = time.perf_counter()
    rows: list[tuple[float, ...]] = []

    def look(model: PPO) -> None:
        paid, reports = played(task, deterministic(model))
        succeeded = np.mean([report.is_success for report in reports])
        ratio = np.mean([report.ratio for report in reports])
        rows.append((model.num_timesteps, time.perf_counter() - began_s, time.process_time(), succeeded, ratio, paid))
        print(f"{model.num_timesteps:7d} steps, {rows[-1][1]:4.0f} s: {summary(paid, reports)}", flush=True)

    model = trained(task, seed, steps, look)
    out.mkdir(parents=True, exist_ok=True)
    model.save(out / f"{task}-{seed}.zip")
    model.get_vec_normalize_env().save(str(out / f"{task}-{seed}.pkl"))
    with (out / f"{task}-{seed}.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("steps", "wall_s", "cpu_s", "success", "ratio", "return_over_limit"), *rows])
    print(f"trained:  {summary(*played(task, deterministic(model)))}")
    print(f"the law:  {summary(*played(task))}, with {LAW_SHARE:.0%} of the maximum")


if __name__ == "__main__":
    typer.run(main)
