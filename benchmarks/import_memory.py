"""Memory and throughput of `gauge data import` on many long textile trials.

    python benchmarks/import_memory.py                    1600 trials of 600 frames x 63 markers, 1.8 GB on disk
    python benchmarks/import_memory.py --trials 100

The trials are synthetic and all of one variant, so that no memory is freed between variants. They are first written to
a temporary folder. The import then runs in its own process, and its peak resident memory is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.tools.dataset.importer import import_trials
from gauge_envs.tools.dataset.layout import find_trials

VARIANT = "TextileFlinging-satin"
FOLDER = "data/textile/textile flinging/json/satin"
TEMPLATES = 16  # distinct trials; writing 113 400 numbers as text takes longer than importing them
MISSING_SHARE = 0.002  # share of hidden markers, in every fourth trial
LIMIT_BYTES = 1e9


def write_trials(root: Path, trials: int, frames: int) -> int:
    """Write trials that sway, with noise of 0.5 mm, all different; return the number of bytes."""
    experiment = load_experiment(VARIANT)
    markers = experiment.scene.markers
    assert markers is not None
    random = np.random.default_rng(0)
    rest = 1e3 * np.asarray(markers.positions_m)
    rod = 1e3 * np.asarray(experiment.scene.body("rod").pose.position_m)
    depth = (rest[:, 2].max() - rest[:, 2])[:, None]
    sway = (
        np.sin(np.arange(frames) / 15.0)[:, None, None]
        * (0.3 * depth)
        * [0.0, 1.0, 0.0]
    )
    folder = root / FOLDER
    folder.mkdir(parents=True)
    templates = []
    for number in range(TEMPLATES):
        positions = np.round(
            rest + sway + random.normal(0.0, 0.5, (frames, len(rest), 3)), 3
        )
        if number % 4 == 0:
            positions[1:][random.random((frames - 1, len(rest))) < MISSING_SHARE] = (
                np.nan
            )
        textile = {
            str(1000 + marker): {
                axis: _column(positions[:, marker, k]) for k, axis in enumerate("xyz")
            }
            for marker in range(len(rest))
        }
        body = {axis: [float(rod[k])] * frames for k, axis in enumerate("xyz")}
        body |= {key: [float(key == "qw")] * frames for key in ("qx", "qy", "qz", "qw")}
        content = {"FPS": 30, "translation unit": "mm", "rod": body, "textile": textile}
        templates.append(json.dumps(content)[:-1])
    written = 0
    for trial in range(trials):
        text = f'{templates[trial % TEMPLATES]}, "trial": {trial}}}'
        written += (folder / f"trial-{trial:04d}.json").write_text(text)
    return written


def _column(values: np.ndarray) -> list[float | None]:
    return [None if np.isnan(value) else float(value) for value in values]


def measure(root: Path) -> dict[str, float]:
    """Import a dataset, and return its counts, wall time and peak memory."""
    start = time.perf_counter()
    imports = list(import_trials(find_trials(root)))
    wall_s = time.perf_counter() - start
    scale = 1 if sys.platform == "darwin" else 1024
    return {
        "trials": sum(result.used for result in imports),
        "left_out": sum(result.left_out for result in imports),
        "wall_s": wall_s,
        "peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale,
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Memory and throughput of importing many long textile trials."
    )
    parser.add_argument("--trials", type=int, default=1600)
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure is not None:
        print(json.dumps(measure(options.measure)))
        return 0
    with tempfile.TemporaryDirectory(prefix="gauge-import-memory-") as folder:
        root = Path(folder)
        written = write_trials(root / "dataset", options.trials, options.frames)
        child = subprocess.run(
            [sys.executable, __file__, "--measure", str(root / "dataset")],
            env=os.environ | {"GAUGE_DATA_DIR": str(root / "store")},
            check=True,
            capture_output=True,
            text=True,
        )
    run = json.loads(child.stdout)
    markers = len(load_experiment(VARIANT).scene.markers.positions_m)
    print(
        f"{options.trials} trials of {options.frames} frames x {markers} markers, {written / 1e6:.0f} MB of JSON"
    )
    print(
        f"imported {run['trials']:.0f}, left out {run['left_out']:.0f}, in {run['wall_s']:.1f} s:"
    )
    print(
        f"  {run['trials'] / run['wall_s']:.1f} trials/s, {written / 1e6 / run['wall_s']:.1f} MB/s"
    )
    print(
        f"  peak memory {run['peak_bytes'] / 1e6:.0f} MB (limit {LIMIT_BYTES / 1e6:.0f} MB)"
    )
    return int(run["peak_bytes"] > LIMIT_BYTES or run["trials"] != options.trials)


if __name__ == "__main__":
    sys.exit(main())
