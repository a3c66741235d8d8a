"""Draw the learning curves of `examples/train_control.py` (`train_control.png`), and print their ends.

    python studies/trained_policies/training_curves.py trained --out train_control.png

The folder holds the TASK-SEED.csv files of the trainings. Each panel shows one task: mean and range over seeds of the
ratio on ten unseen starts, 0 for an episode that fails, and the mean ratio of the law's own policy.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

LAW = {"Carry-Limit-wood": 0.990, "Push-Limit-wood": 0.841, "Throw-Limit-rubber": 0.965}
"""Mean ratio of the law's policy on the unseen starts; each training prints it."""


def curves(folder: Path, task: str) -> dict[str, np.ndarray]:
    """Return the columns of all seeds of a task, shape [seeds, rows]."""
    tables = []
    for path in sorted(folder.glob(f"{task}-*.csv")):
        with path.open(newline="") as file:
            tables.append(
                [
                    {key: float(value) for key, value in row.items()}
                    for row in csv.DictReader(file)
                ]
            )
    return {
        key: np.array([[row[key] for row in table] for table in tables])
        for key in tables[0][0]
    }


def main() -> None:
    """Draw all tasks of a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("train_control.png"))
    arguments = parser.parse_args()
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    for axis, (task, law) in zip(
        figure.subplots(1, len(LAW), sharey=True), LAW.items(), strict=True
    ):
        found = curves(arguments.folder, task)
        steps, ratio = 1e-3 * found["steps"][0], found["ratio"]
        axis.fill_between(
            steps,
            ratio.min(axis=0),
            ratio.max(axis=0),
            color="#0072b2",
            alpha=0.2,
            lw=0,
        )
        axis.plot(
            steps,
            ratio.mean(axis=0),
            color="#0072b2",
            label=f"PPO, mean and range of {len(ratio)} seeds",
        )
        axis.axhline(law, color="#303030", lw=1, ls="--", label="the law's policy")
        axis.set(title=task, xlabel="steps [thousands]", ylim=(0.0, 1.05))
        for number, (success, end, wall_s) in enumerate(
            zip(
                found["success"][:, -1],
                ratio[:, -1],
                found["wall_s"][:, -1],
                strict=True,
            )
        ):
            print(
                f"{task} seed {number}: {10 * success:.0f} of 10, ratio {end:.3f}, {wall_s:.0f} s"
            )
    figure.axes[0].set_ylabel("ratio to the law's limit (0 if failed)")
    figure.axes[-1].legend(loc="lower right", fontsize=8)
    figure.savefig(arguments.out, dpi=130)


if __name__ == "__main__":
    main()
