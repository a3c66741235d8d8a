"""Measure size and power of the scatter test on simulated realities, with seeds that nothing else uses.

python -m studies.scatter.size_and_power ID ...    2 minutes an id

`scoring/scatter.csv` has all ids, each with one sample of runs and 100 further ones. Here each id has several samples,
so that the shares are those of the test and not of one sample.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gauge_envs.evaluation.scatter import (
    ASSUMED,
    LEVEL,
    SPREADS,
    TRIAL_COUNT,
    delayed,
    differs,
    group_models,
    group_scores,
)
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.scatter import scatter_rows
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.scatter import scattered_runs
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from scripts.build_scatter import LATE_S, faulty_scenes

TABLE = Path(__file__).with_name("size_and_power.csv")
SEED = 70_000
"""Seed of the first run."""
SAMPLES = 6
SAMPLE_RUNS = 40
REALITY_RUNS = 240
REALITIES = 50
"""Realities that each sample is compared with."""
LATE = {"late": (LATE_S, 0.0), "scattered late": (0.0, LATE_S)}
"""Further delay of each trial [s]: a constant, and the spread of |N|."""


def counted(name: str) -> Counter[tuple[str, str]]:
    """Return how many realities of an id are refused, by fault and by what refuses: the assumed starts, or all."""
    experiment, asked = load_experiment(name), RunRequest(name)
    release_s = scatter_rows()[name].release_s
    frames = experiment.baselines["rmse"].frames
    first = SEED

    def runs(scene: Scene, share: float, count: int) -> FloatArray:
        nonlocal first
        seeds = range(first, first + count)
        first += count
        changed = replace(experiment, scene=scene)
        return np.array(scattered_runs(asked, changed, share=share, seeds=seeds))

    samples = [
        {share: runs(experiment.scene, share, SAMPLE_RUNS) for share in SPREADS}
        for _ in range(SAMPLES)
    ]
    models = [
        group_models(sample, frames, seed=SEED + number)
        for number, sample in enumerate(samples)
    ]
    random = np.random.default_rng(SEED)
    refused: Counter[tuple[str, str]] = Counter()
    scenes = {"none": experiment.scene, **dict(faulty_scenes(experiment))}
    for scene_fault, scene in scenes.items():
        real = runs(scene, 1.0, REALITY_RUNS)
        faults = [scene_fault, *LATE] if scene_fault == "none" else [scene_fault]
        for fault in faults:
            constant_s, spread_s = LATE.get(fault, (0.0, 0.0))
            for model in models:
                chosen = random.integers(len(real), size=(REALITIES, TRIAL_COUNT))
                delays_s = release_s * np.abs(random.standard_normal(chosen.shape))
                delays_s += spread_s * np.abs(random.standard_normal(chosen.shape))
                delays_s += constant_s
                found = group_scores(delayed(real, chosen, delays_s, frames))
                for one in found:
                    p_values = {
                        starts: group.answer(one, starts).p_value
                        for starts, group in model.items()
                    }
                    refused[fault, "assumed"] += p_values[ASSUMED] < LEVEL
                    refused[fault, "all"] += differs([*p_values.values()]) is True
    return refused


def main(names: Sequence[str]) -> None:
    """Measure ids, and add their rows to the table."""
    is_new = not TABLE.is_file()
    with TABLE.open("a", newline="", encoding="utf-8") as text:
        writer = csv.writer(text, lineterminator="\n")
        if is_new:
            writer.writerow(
                ["id", "fault", "realities", "refused_assumed", "refused_all"]
            )
        for name in names:
            refused = counted(name)
            for fault in dict.fromkeys(fault for fault, _ in refused):
                told = (refused[fault, "assumed"], refused[fault, "all"])
                writer.writerow([name, fault, SAMPLES * REALITIES, *told])
            text.flush()
            print(name, dict(refused), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
