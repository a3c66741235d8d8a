"""Train linear policies on tasks as they are, apply the change that `gauge sanity` states, and compare.

python studies/cures/policies.py               writes policies.csv

A policy is a matrix from normalized observations to actions, found by augmented random search (Mania et al. 2018).
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.sanity import check, configuration
from gauge_envs.tools.sanity.cure import applied

HERE = Path(__file__).resolve().parent
TASKS = ("HalfCheetah-v5", "Hopper-v5", "Walker2d-v5")
SEEDS = (0, 1, 2, 3)
ROUNDS, DIRECTIONS, BEST, STEP, NOISE, HORIZON = 60, 8, 4, 0.03, 0.05, 300
EPISODES, EPISODE_STEPS = 10, 500
ROWS = ("foot-*", "creep-*", "rest-height", "slide-*")


@dataclass
class Policy:
    """A linear policy with the mean and the variance of what it observed."""

    gain: NDArray[np.float64]
    count: float
    mean: NDArray[np.float64]
    squares: NDArray[np.float64]

    def act(
        self, seen: NDArray[np.float64], gain: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the action."""
        spread = np.sqrt(np.maximum(self.squares / max(self.count, 1.0), 1e-4))
        return np.clip(gain @ ((seen - self.mean) / spread), -1.0, 1.0)

    def see(self, seen: NDArray[np.float64]) -> None:
        """Add an observation to the mean and the variance."""
        self.count += 1.0
        before = seen - self.mean
        self.mean = self.mean + before / self.count
        self.squares = self.squares + before * (seen - self.mean)


def train(env: gym.Env, seed: int) -> Policy:
    """Return a policy after a fixed number of rounds."""
    rng = np.random.default_rng(seed)
    sees, acts = env.observation_space.shape[0], env.action_space.shape[0]
    policy = Policy(np.zeros((acts, sees)), 0.0, np.zeros(sees), np.zeros(sees))
    for _ in range(ROUNDS):
        noises = rng.standard_normal((DIRECTIONS, acts, sees))
        returns = np.zeros((DIRECTIONS, 2))
        for at, noise in enumerate(noises):
            for side, sign in enumerate((1.0, -1.0)):
                seen, _ = env.reset(seed=int(rng.integers(2**31)))
                for _ in range(HORIZON):
                    policy.see(seen)
                    seen, reward, is_over, _, _ = env.step(
                        policy.act(seen, policy.gain + sign * NOISE * noise)
                    )
                    returns[at, side] += reward
                    if is_over:
                        break
        best = np.argsort(returns.max(axis=1))[-BEST:]
        weights = returns[best, 0] - returns[best, 1]
        policy.gain = policy.gain + STEP / (BEST * returns[best].std()) * np.tensordot(
            weights, noises[best], 1
        )
    return policy


def slip_m_per_s(model: mujoco.MjModel, data: mujoco.MjData) -> list[float]:
    """Return the speed along the ground of each body at its contacts with the world [m/s]."""
    speeds = []
    for contact in data.contact:
        bodies = model.geom_bodyid[contact.geom]
        if contact.efc_address < 0 or 0 not in bodies:
            continue
        body, velocity = int(bodies.max()), np.zeros(6)
        mujoco.mj_objectVelocity(
            model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0
        )
        at = velocity[3:] + np.cross(velocity[:3], contact.pos - data.xpos[body])
        speeds.append(float(np.hypot(at[0], at[1])))
    return speeds


def play(env: gym.Env, policy: Policy) -> tuple[float, float, float]:
    """Return the mean return, distance [m], and slip of what touches the ground [m/s], over episodes of fixed seeds."""
    returns, distances, slips = [], [], []
    for episode in range(EPISODES):
        seen, _ = env.reset(seed=1000 + episode)
        total, start = 0.0, env.unwrapped.data.qpos[0]
        for _ in range(EPISODE_STEPS):
            seen, reward, is_over, _, _ = env.step(policy.act(seen, policy.gain))
            total += reward
            slips += slip_m_per_s(env.unwrapped.model, env.unwrapped.data)
            if is_over:
                break
        returns.append(total)
        distances.append(env.unwrapped.data.qpos[0] - start)
    return float(np.mean(returns)), float(np.mean(distances)), float(np.mean(slips))


def main() -> None:
    rows = []
    for task in sys.argv[1:] or TASKS:
        read = configuration(task)
        report = check(read, only=ROWS)
        flags = [row.phenomenon for row in report.rows if row.is_flag]
        assert report.cure is not None, f"{task}: no change is stated for {flags}"
        print(task, report.cure.line, flush=True)
        cured = applied(read, report.cure.changes)[0].robot
        env, mended = gym.make(task).unwrapped, gym.make(task).unwrapped
        assert cured is not None
        mended.model, mended.data = cured.model, mujoco.MjData(cured.model)
        mended.frame_skip = round(env.dt / cured.model.opt.timestep)
        for seed in SEEDS:
            policy = train(env, seed)
            row: dict[str, object] = {
                "task": task,
                "flags": len(flags),
                "change": report.cure.line,
                "seed": seed,
            }
            for name, one in (("as_it_is", env), ("changed", mended)):
                measured = zip(
                    ("return", "distance_m", "slip_m_per_s"),
                    play(one, policy),
                    strict=True,
                )
                row |= {f"{key}_{name}": f"{value:.4g}" for key, value in measured}
            rows.append(row)
            print(row, flush=True)
    with (HERE / "policies.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
