"""Scores of engines on all trials of the joint experiments, with the constants of the task files.

    python studies/joints/experiments.py mujoco drake ...     # all trials: experiments.csv, results/ENGINE.npz
    python studies/joints/experiments.py                      # the table of means: engines.csv

A score is the root-mean-square distance from the recording, with the interval that its measurement leaves. Constants
were fitted to even trials; odd ones judge.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Sequence

import gymnasium
import numpy as np
from fits import HERE, write
from scipy.stats import t

import gauge_envs  # noqa: F401
from gauge_envs.errors import GaugeError
from gauge_envs.references.single_shot import single_shots

IDS = ("JointPendulum-dry", "JointPendulum-viscous", "DoublePendulum-bars", "TorquePendulum-ak80", "ServoArm-so101")

COLUMNS = ("engine", "id", "trial", "half", "rmse_mm", "rmse_low_mm", "rmse_high_mm", "cpu_s")


def rows() -> list[dict[str, str]]:
    """Return the scores that are stored."""
    file = HERE / "experiments.csv"
    if not file.is_file():
        return []
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def run(engine: str) -> None:
    """Score all trials with an engine, and replace its rows; the frames go to a file for the table."""
    kept = [[row[name] for name in COLUMNS] for row in rows() if row["engine"] != engine]
    found: list[list[object]] = []
    frames: dict[str, np.ndarray] = {}
    for name in IDS:
        shots = single_shots(name)
        assert shots is not None
        try:
            env = gymnasium.make(f"GAUGE/{name}", backend=engine)
        except GaugeError as error:
            print(engine, name, error, flush=True)
            continue
        for trial in range(len(shots)):
            start, over = time.process_time(), False
            observation, _ = env.reset(options={"trial": trial})
            path = [observation["observable"]]
            while not over:
                observation, _, terminated, truncated, info = env.step(0)
                path.append(observation["observable"])
                over = terminated or truncated
            score, half = info["score"], "judge" if trial % 2 else "fit"
            seconds = round(time.process_time() - start, 2)
            low, high = score.rmse_95 or (np.nan, np.nan)
            found.append([engine, name, trial, half, score.rmse, low, high, seconds])
            frames[f"{engine}/{name}/{trial}"] = np.array(path)
            print(found[-1], flush=True)
        env.close()
        write("experiments.csv", COLUMNS, kept + found)
    folder = HERE / "results"
    folder.mkdir(exist_ok=True)
    np.savez_compressed(folder / f"{engine}.npz", **frames)


def mean_with_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Return the mean of trials and its 95 % interval by Student's t; NaN for fewer than three trials."""
    mean, count = float(np.mean(values)), len(values)
    if count < 3:
        return mean, np.nan, np.nan
    half = float(t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))
    return mean, mean - half, mean + half


def main() -> None:
    """Run the engines that are named."""
    for engine in sys.argv[1:]:
        run(engine)


if __name__ == "__main__":
    main()
