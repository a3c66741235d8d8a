"""What takes the processor time of episodes in MuJoCo, as `shares.csv` and `shares.png`; needs `perf` of Linux.

python studies/cost/shares.py            measures one id of each experiment
python studies/cost/shares.py --draw     draws shares.csv again
"""

from __future__ import annotations

import csv
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import gymnasium
import numpy as np

from gauge_envs import find_variant, variants
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.pages.figures import legend_above, new_figure, save_png, tidy_axis
from gauge_envs.tools.catalog.description import episode_costs

TABLE = Path(__file__).with_name("shares.csv")
LONGEST_FRAMES = 90
LEAST_S, MOST_S = 0.6, 4.0
"""Processor time that is sampled; short episodes are repeated, long ones are cut."""

PARTS = {
    "contacts": "search for contacts",
    "constraints": "constraints and their solver",
    "elements": "elements and passive forces",
    "motion": "rest of MuJoCo: motion, sparse algebra",
    "python": "Python: driving, observing, reward",
    "scoring": "scoring",
}
"""Parts of an episode with their labels."""

SYMBOLS = {
    "contacts": r"(?i)coll|_SAP|mjc_|gjk|epa|ccd|polytope|horizon|bvh|broad|hull|support|sphere|capsule|box|plane",
    "elements": r"(?i)flex|mj_eff|springdamper|mjd_|interp|passive|bend|stretch|elastic",
    "constraints": r"(?i)sol(?!veLD|veM)|constraint|primal|newton|cg_|chol|efc|jac|impedance|diag|contact|island|hess|"
    r"mulMatTVec|sqrMat|cone|warm|line_?search|mj_instantiate|band",
}
"""Part of a function of the library by its name, the first that fits; any other one moves bodies."""


def part_of(library: str, symbol: str) -> str | None:
    """Return the part of a function; None where all parts call it."""
    if library.startswith(("libc.", "libm.", "[", "ld-")):
        return None
    if "mujoco.so" not in library:
        return "python"
    return next(
        (part for part, pattern in SYMBOLS.items() if re.search(pattern, symbol)),
        "motion",
    )


def sampled(env: GaugeEnv) -> tuple[Counter[tuple[str, str]], float]:
    """Return samples of `perf` by library and symbol over episodes, and the share of scoring in the time."""
    action = (
        0
        if isinstance(env.action_space, gymnasium.spaces.Discrete)
        else np.zeros(env.action_space.shape)
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "perf.data"
        env.reset(seed=0)
        perf = subprocess.Popen(
            ["perf", "record", "-q", "-F", "997", "-p", str(os.getpid()), "-o", file]
        )
        time.sleep(1.0)
        start, steps_s, scoring_s = time.process_time(), 0.0, 0.0
        while steps_s < LEAST_S:
            env.reset(seed=0)
            for _ in range(LONGEST_FRAMES):
                *_, terminated, truncated, _ = env.step(action)
                if terminated or truncated or time.process_time() - start > MOST_S:
                    break
            steps_s = time.process_time() - start - scoring_s
            if env.episode.is_over:
                env.episode.run_on()
                steps_s, before = (
                    time.process_time() - start - scoring_s,
                    time.process_time(),
                )
                env.episode.score()
                env.deformation()
                scoring_s += time.process_time() - before
        perf.send_signal(signal.SIGINT)
        perf.wait()
        report = [
            "perf",
            "report",
            "-i",
            file,
            "--stdio",
            "--no-children",
            "-F",
            "sample,dso,symbol",
            "-t",
            "\t",
        ]
        lines = subprocess.run(
            report, capture_output=True, text=True, check=True
        ).stdout.splitlines()
    found: Counter[tuple[str, str]] = Counter()
    for line in lines:
        if line.strip() and not line.startswith("#"):
            count, library, symbol = (cell.strip() for cell in line.split("\t")[:3])
            found[library, symbol.partition("] ")[2]] += int(count)
    return found, scoring_s / (steps_s + scoring_s)


def measure() -> None:
    families = {variant.family: variant.name for variant in variants()}
    with TABLE.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["id", *PARTS])
        for name in sorted(
            families.values(),
            key=lambda name: episode_costs(find_variant(name).family)["mujoco"].most,
        ):
            env = GaugeEnv(name)
            found, scoring = sampled(env)
            env.close()
            shares = Counter(dict.fromkeys(PARTS, 0.0))
            known = Counter(
                {key: count for key, count in found.items() if part_of(*key)}
            )
            for (library, symbol), count in known.items():
                shares[part_of(library, symbol)] += count / known.total()
            # Scoring is Python and NumPy too.
            shares["scoring"], shares["python"] = (
                scoring,
                max(shares["python"] - scoring, 0.0),
            )
            table.writerow([name, *(f"{shares[part]:.3f}" for part in PARTS)])
            file.flush()
            others = [
                (s, n)
                for (d, s), n in found.most_common(60)
                if part_of(d, s) == "motion" and "mujoco.so" in d
            ]
            print(name, dict(shares), others[:8], file=sys.stderr, flush=True)


def draw() -> None:
    with TABLE.open(newline="") as file:
        rows = sorted(
            csv.DictReader(file),
            key=lambda row: [-float(row[part]) for part in ("elements", "constraints")],
        )
    figure = new_figure(8.0, 6.0)
    axis = figure.add_subplot()
    left = np.zeros(len(rows))
    for part, label in PARTS.items():
        shares = np.array([100.0 * float(row[part]) for row in rows])
        axis.barh(range(len(rows)), shares, left=left, label=label)
        left += shares
    axis.set_yticks(range(len(rows)), [row["id"] for row in rows])
    axis.invert_yaxis()
    axis.set_xlim(0, 100)
    axis.set_xlabel("share of the processor time of an episode, %")
    tidy_axis(axis)
    legend_above(axis)
    save_png(figure, TABLE.with_suffix(".png"))


if __name__ == "__main__":
    if "--draw" not in sys.argv:
        measure()
    draw()
