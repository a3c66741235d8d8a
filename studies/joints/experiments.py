"""Scores of engines on all trials of the joint experiments, with the constants of the task files.

    python studies/joints/experiments.py mujoco drake ...     # all trials: experiments.csv, results/ENGINE.npz
    python studies/joints/experiments.py                      # the tables engines.csv, steps.csv, draws.csv

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
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.uncertain import overrides_at, uncertain_parameters
from gauge_envs.references.single_shot import single_shots
from gauge_envs.tools.transfer.envelope import sobol_sigmas

IDS = (
    "JointPendulum-dry",
    "JointPendulum-viscous",
    "DoublePendulum-bars",
    "TorquePendulum-ak80",
    "ServoArm-so101",
)

DRAWS = 32

COLUMNS = (
    "engine",
    "id",
    "trial",
    "half",
    "rmse_mm",
    "rmse_low_mm",
    "rmse_high_mm",
    "cpu_s",
)


def rows() -> list[dict[str, str]]:
    """Return the scores that are stored."""
    file = HERE / "experiments.csv"
    if not file.is_file():
        return []
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def run(engine: str) -> None:
    """Score all trials with an engine, and replace its rows; the frames go to a file for the table."""
    kept = [
        [row[name] for name in COLUMNS] for row in rows() if row["engine"] != engine
    ]
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
    """Return the mean over trials and its 95 % interval by Student's t, from 0 on; NaN for fewer than three trials."""
    mean, count = float(np.mean(values)), len(values)
    if count < 3:
        return mean, np.nan, np.nan
    half = float(t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))
    return mean, max(mean - half, 0.0), mean + half


def table() -> None:
    """Write the means of the halves, and how far each engine is from Drake with a fifth of the step."""
    stored = rows()
    frames: dict[str, np.ndarray] = {}
    for file in sorted((HERE / "results").glob("*.npz")):
        frames |= dict(np.load(file))
    found = []
    for engine, name in dict.fromkeys((row["engine"], row["id"]) for row in stored):
        own = [row for row in stored if (row["engine"], row["id"]) == (engine, name)]
        halves = {
            half: [float(row["rmse_mm"]) for row in own if row["half"] == half]
            for half in ("fit", "judge")
        }
        apart = [
            np.mean(
                np.square(
                    frames[f"{engine}/{name}/{row['trial']}"]
                    - frames[f"drake/{name}/{row['trial']}"]
                )
            )
            for row in own
            if row["half"] == "judge" and f"{engine}/{name}/1" in frames
        ]
        width = frames[f"drake/{name}/1"].shape[1]
        judged = mean_with_interval(halves["judge"])
        found.append(
            (
                engine,
                name,
                float(np.mean(halves["fit"])),
                *judged,
                float(np.sqrt(np.mean(apart) * width)),
                len(halves["judge"]),
            )
        )
    write(
        "engines.csv",
        (
            "engine",
            "id",
            "fit_mm",
            "judged_mm",
            "low_mm",
            "high_mm",
            "from_drake_mm",
            "judged",
        ),
        found,
    )


def step_errors() -> None:
    """Write the error on judged trial 5 with the step of the preset, and shorter ones."""
    found = []
    cases = [
        (one, "DoublePendulum-bars", factor)
        for one in ("mujoco", "rapier", "physx")
        for factor in (1, 2, 5)
    ]
    for engine, name, factor in (
        *cases,
        ("rapier", "ServoArm-so101", 1),
        ("rapier", "ServoArm-so101", 2),
    ):
        env = gymnasium.make(
            f"GAUGE/{name}",
            backend=engine,
            settings={"timestep_s": 1.0 / (1800 * factor)},
        )
        env.reset(options={"trial": 5})
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(0)
            over = terminated or truncated
        found.append((engine, name, 1800 * factor, info["score"].rmse))
        print(found[-1], flush=True)
        env.close()
    write("steps.csv", ("engine", "id", "steps_per_s", "rmse_mm"), found)


def draws() -> None:
    """Write the errors of MuJoCo on judged trials of pendulums, with constants from scoring/uncertainties.toml."""
    found = []
    for name in IDS[:-1]:
        parameters, shots = (
            uncertain_parameters(load_experiment(name)),
            single_shots(name),
        )
        assert shots is not None
        judged = range(1, len(shots), 2)
        errors: list[list[float]] = [[] for _ in judged]
        for sigmas in sobol_sigmas(DRAWS, len(parameters)):
            env = gymnasium.make(
                f"GAUGE/{name}", parameters=overrides_at(parameters, sigmas.tolist())
            )
            for own, trial in zip(errors, judged, strict=True):
                env.reset(options={"trial": trial})
                over = False
                while not over:
                    _, _, terminated, truncated, info = env.step(0)
                    over = terminated or truncated
                own.append(info["score"].rmse)
            env.close()
        for own, trial in zip(errors, judged, strict=True):
            found.append(
                (name, trial, *map(float, np.quantile(own, (0.0, 0.025, 0.5, 0.975))))
            )
            print(found[-1], flush=True)
    write(
        "draws.csv",
        ("id", "trial", "least_mm", "low_mm", "median_mm", "high_mm"),
        found,
    )


def main() -> None:
    """Run the engines that are named, or write the tables."""
    for engine in sys.argv[1:]:
        run(engine)
    if len(sys.argv) == 1:
        table()
        step_errors()
        draws()


if __name__ == "__main__":
    main()
