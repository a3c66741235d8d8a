"""Synthetic joints of known friction, armature and gains: how often is the truth inside its 95 % interval?

python studies/identify/coverage.py free 4000 100 studies/identify/coverage_free.csv

Worlds that the file has are not simulated again.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from gauge_envs.backends import backend
from gauge_envs.tools.identify import Log, identify, one_joint
from gauge_envs.tools.identify.rig import simulated

SETTINGS = {"timestep_s": 1 / 900, "preset": "contact_free"}
NOISE_RAD = 1e-3
"""Standard deviation of the noise, half of it white and half with a correlation time of 0.1 s."""


def world(seed: int, kind: str) -> list[tuple[str, float, float, float, float]]:
    """Return seed, name, truth, and ends of the interval of each number of one world."""
    random = np.random.default_rng(seed)
    engine, mass_kg, length_m = (
        backend("mujoco"),
        random.uniform(0.1, 1.0),
        random.uniform(0.1, 0.4),
    )
    scene = one_joint(mass_kg, length_m)
    weight, inertia = 9.80665 * mass_kg * length_m, mass_kg * length_m**2
    rate = np.sqrt(weight / inertia)

    def drawn(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    truth = {
        "dry_friction_n_m": weight * drawn(0.003, 0.02),
        "armature_kg_m2": inertia * drawn(0.05, 0.5),
    }
    times_s = np.arange(0.0, 5.0, 0.01)
    command = None
    angle = np.array([random.uniform(0.4, 0.9)])
    if kind == "free":
        truth["viscous_friction_n_m_s_per_rad"] = weight / rate * drawn(0.003, 0.03)
    else:
        truth |= {
            "kp_n_m_per_rad": weight * drawn(5.0, 30.0),
            "kv_n_m_s_per_rad": weight / rate * drawn(1.0, 4.0),
            "delay_s": random.uniform(0.0, 0.06),
        }
        sweep = 0.4 * np.sin(2.0 * np.pi * (0.3 + 0.15 * times_s) * times_s)
        command = (sweep + 0.3 * np.sign(np.sin(1.7 * times_s)))[:, None]
        angle = np.zeros(1)
    log = Log(f"world {seed}", times_s, np.zeros((len(times_s), 1)), command)
    measured = simulated(engine, scene, log, [truth], (angle, np.zeros(1)), SETTINGS)
    white, shocks = random.standard_normal((2, len(times_s)))
    memory = np.exp(-0.01 / 0.1)
    lasting = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], shocks)
    noisy = measured + NOISE_RAD * np.sqrt(0.5) * (white + lasting)[:, None]
    found = identify(
        engine,
        scene,
        [Log(log.name, times_s, noisy, command)],
        tuple(truth),
        settings=SETTINGS,
    )
    return [
        (str(seed), one.name, truth[one.name], one.low, one.high)
        for one in found.settings
    ]


def main() -> None:
    """Write a row for each number of each world, and print how many intervals hold the truth."""
    kind, first, count, path = (
        sys.argv[1],
        int(sys.argv[2]),
        int(sys.argv[3]),
        Path(sys.argv[4]),
    )
    new = not path.exists()
    with path.open("a+", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(["seed", "setting", "truth", "low", "high"])
        file.seek(0)
        done = {row["seed"] for row in csv.DictReader(file)}
        for seed in range(first, first + count):
            if str(seed) not in done:
                writer.writerows(
                    (*row[:2], *(f"{value:.5g}" for value in row[2:]))
                    for row in world(seed, kind)
                )
                file.flush()
        file.seek(0)
        rows = [
            (one["setting"], *(float(one[key]) for key in ("truth", "low", "high")))
            for one in csv.DictReader(file)
        ]
    for name in dict.fromkeys(row[0] for row in rows):
        table = np.array([row[1:] for row in rows if row[0] == name])
        truth, low, high = table.T
        inside, half = (low <= truth) & (truth <= high), 0.5 * (high - low) / truth
        print(
            f"{name}: {inside.sum()} of {len(inside)}, half width {100.0 * np.median(half):.2g} % (median)"
        )


if __name__ == "__main__":
    main()
