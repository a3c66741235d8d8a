"""Kill `gauge data import` at random moments, and check that nothing is lost, doubled or half-written.

Two synthetic data sets of the same ids are imported in turn, each import is killed, and the store is read. Every
variant must be that of one data set. An import that runs to its end must then remove all leftovers. Example:

    python studies/robustness/killed_imports.py --kills 100
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.references.imported import load_imported
from gauge_envs.references.user_data import user_data_folder

FOLDERS = {
    "SlopeSlider-1-wood": "data/rigid/slope slider/json/wood/task-1",
    "SlopeSlider-1-plastic": "data/rigid/slope slider/json/plastic/task-1",
    "SlopeSlider-2-wood": "data/rigid/slope slider/json/wood/task-2",
    "SlopeSlider-2-plastic": "data/rigid/slope slider/json/plastic/task-2",
}

COMMAND = [
    sys.executable,
    "-c",
    "from gauge_envs.cli.app import main; main()",
    "data",
    "import",
]


def write_data_set(root: Path, shift_mm: float) -> None:
    """Write three trials of each variant, whose mean is shifted along y."""
    for name, folder in FOLDERS.items():
        experiment = load_experiment(name)
        start = 1e3 * np.asarray(experiment.scene.body("cube").pose.position_m)
        (root / folder).mkdir(parents=True)
        for number in range(3):
            frames = np.arange(experiment.frame_count)[:, None]
            positions = start + frames * [2.0, 0.0, 0.0] + [0.0, shift_mm + number, 0.0]
            cube = {
                axis: positions[:, index].tolist() for index, axis in enumerate("xyz")
            }
            content = {"FPS": 30, "translation unit": "mm", "cube": cube}
            (root / folder / f"trial-{number + 1}.json").write_text(json.dumps(content))


def main() -> None:
    """Print how many kills fell into an import, and fail at the first damage."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    chance = random.Random(given.seed)
    with tempfile.TemporaryDirectory() as folder:
        roots = [Path(folder) / name for name in ("first", "second")]
        os.environ["GAUGE_DATA_DIR"] = str(Path(folder) / "store")
        means: list[dict[str, np.ndarray]] = []
        for number, root in enumerate(roots):
            write_data_set(root, 5.0 * number)
            start = time.perf_counter()
            subprocess.run([*COMMAND, str(root)], check=True, capture_output=True)
            duration_s = time.perf_counter() - start
            means.append(stored_means())
        ended, changed, leftovers, before = 0, 0, 0, means[1]
        for number in range(given.kills):
            process = subprocess.Popen(
                [*COMMAND, str(roots[number % 2])],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            # The first part of the time is the import of modules.
            time.sleep(chance.uniform(0.4, 1.05) * duration_s)
            ended += process.poll() is not None
            process.kill()
            process.wait()
            now = stored_means()
            for name, mean in now.items():
                assert any(np.array_equal(mean, known[name]) for known in means), (
                    f"kill {number}: {name} is damaged"
                )
            changed += any(
                not np.array_equal(now[name], before[name]) for name in FOLDERS
            )
            leftovers += len(stored_files()) > 2 * len(FOLDERS)
            before = now
        subprocess.run([*COMMAND, str(roots[0])], check=True, capture_output=True)
        assert all(
            np.array_equal(mean, means[0][name])
            for name, mean in stored_means().items()
        )
        assert len(stored_files()) == 2 * len(FOLDERS), stored_files()
    print(
        f"{given.kills} kills: {given.kills - ended} during an import, the store changed in {changed}, leftovers after "
        f"{leftovers}; nothing lost, doubled or half-written, no leftovers after the last import"
    )


def stored_means() -> dict[str, np.ndarray]:
    """Return the mean of each stored variant."""
    found = {name: load_imported(name) for name in FOLDERS}
    return {name: one.band.mean for name, one in found.items() if one is not None}


def stored_files() -> list[str]:
    """Return the names of the files of the store, without its lock."""
    return sorted(
        file.name
        for file in (user_data_folder() / "trials").iterdir()
        if file.name != ".lock"
    )


if __name__ == "__main__":
    main()
