"""Errors of engines on the judged trials of the joint experiments, with the constants of the task files.

    python studies/joints/experiments.py mujoco drake ...

Writes experiments.csv: root-mean-square distance of the bodies' centres from the recording, per engine and id.
"""

from __future__ import annotations

import csv
import sys
import time

import gymnasium
import numpy as np
from fits import HERE, write

import gauge_envs  # noqa: F401
from gauge_envs.errors import GaugeError
from gauge_envs.references.single_shot import single_shots

TRIALS = {
    "JointPendulum-dry": (1,),
    "JointPendulum-viscous": (1, 3),
    "DoublePendulum-bars": (1, 7, 13, 19, 25),
    "TorquePendulum-ak80": (1, 3),
    "ServoArm-so101": (7,),
}
"""Judged trials that are run: of the double pendulum and the arm some, which keeps this to minutes."""


def errors_mm(name: str, engine: str) -> list[float]:
    """Return the error of each judged trial [mm]."""
    shots = single_shots(name)
    assert shots is not None
    env = gymnasium.make(f"GAUGE/{name}", backend=engine)
    found = []
    for trial in TRIALS[name]:
        observation, _ = env.reset(options={"trial": trial})
        frames, over = [observation["observable"]], False
        while not over:
            observation, _, terminated, truncated, _ = env.step(0)
            frames.append(observation["observable"])
            over = terminated or truncated
        band = shots.band(trial, len(frames))
        off = (np.array(frames) - band.mean)[band.measured].reshape(-1, 3)
        found.append(float(np.sqrt(np.mean(np.square(off).sum(axis=1)))))
    env.close()
    return found


def main() -> None:
    """Run the engines that are named, and replace their rows."""
    file = HERE / "experiments.csv"
    rows: list[list[object]] = []
    if file.is_file():
        with file.open(encoding="utf-8", newline="") as stream:
            rows = [list(row) for row in list(csv.reader(stream))[1:] if row[0] not in sys.argv[1:]]
    for engine in sys.argv[1:]:
        for name in TRIALS:
            start = time.process_time()
            try:
                found = errors_mm(name, engine)
            except GaugeError as error:
                print(engine, name, error, flush=True)
                continue
            rows.append([engine, name, float(np.median(found)), float(max(found))])
            print(rows[-1], f"{time.process_time() - start:.1f} s", flush=True)
            write("experiments.csv", ("engine", "id", "median_mm", "largest_mm"), rows)


if __name__ == "__main__":
    main()
