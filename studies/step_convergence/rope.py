"""How far RopeWinding-rubber in MuJoCo moves from its default run when a numerical setting changes, and from when on.

python studies/step_convergence/rope.py > studies/step_convergence/rope.csv
"""

from __future__ import annotations

import csv
import sys
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import gauge_envs  # noqa: F401  registers the ids

CHANGES: dict[str, dict[str, Any]] = {
    "half the step": {"timestep_s": 1 / 18000},
    "twice the step": {"timestep_s": 1 / 4500},
    "half the cell": {"cell_m": 0.005},
    "tolerance of the solver 1e-10": {"tolerance": 1e-10},
    "solver CG": {"solver": "CG"},
    "solver CG, 2000 iterations": {"solver": "CG", "iterations": 2000},
}
TIMES_S = (0.5, 0.7, 1.0, 1.5)
"""Times of the table; the rope is slack at first and jerks taut between the first two."""


def run(settings: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the times [s] and the positions of both balls [mm], shape [sample_count, 2, 3]."""
    env = gym.make(
        "GAUGE/RopeWinding-rubber", settings=settings, disable_env_checker=True
    ).unwrapped
    env.reset(seed=0)
    over = False
    while not over:
        *_, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape))
        over = terminated or truncated
    trajectory = env.trajectory()
    env.close()
    return trajectory.times_s, trajectory.samples.reshape(
        len(trajectory.samples), -1, 3
    )


def main() -> None:
    times_s, default = run({})
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(
        ["change", "balls rms mm", *(f"at {time_s} s" for time_s in TIMES_S)]
    )
    for name, settings in CHANGES.items():
        _, changed = run(settings)
        away = np.linalg.norm(changed - default, axis=2).mean(axis=1)
        overall = float(np.sqrt(((changed - default) ** 2).sum(axis=2).mean()))
        at = (float(away[np.searchsorted(times_s, time_s)]) for time_s in TIMES_S)
        table.writerow([name, f"{overall:.3g}", *(f"{value:.2g}" for value in at)])


if __name__ == "__main__":
    main()
