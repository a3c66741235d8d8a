"""How often the 95 % interval of a normalized distance holds the true one, in worlds resampled from the real trials.

    python studies/coverage/resampled.py --worlds 200

In a world, the measured trials of an id are all trials that exist. A score sees N of them, drawn with replacement. The
true normalized distance is that from the mean of all trials, over the mean distance of trials in many worlds. The
motion is the exact one with the constants of a parameter set.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gauge_envs import load_experiment, reference_band, score_trajectory
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLES_PER_FRAME
from gauge_envs.scoring.exact import exact_motion
from gauge_envs.scoring.metrics import time_offset
from gauge_envs.tools.dataset.statistics import (
    baselines_without,
    leave_one_out_distances,
    mean_and_sigma,
)

CASES = (
    ("SlopeSlider-2-wood", "published"),
    ("SlopeSlider-2-wood", "measured"),
    ("SlopeSlider-2-plastic", "published"),
    ("SlopeSlider-2-metal", "published"),
    ("BouncingBall-rubber", "published"),
    ("BouncingBall-rubber", "measured"),
)


def band_of(band: Band, trials: FloatArray) -> Band:
    """Return the band of trials, shape [N, T, C]."""
    mean, sigma = mean_and_sigma(trials)
    rmse, rmse_aligned = leave_one_out_distances(trials)
    return replace(
        band,
        mean=np.where(np.isfinite(band.mean), mean, np.nan),
        sigma=sigma,
        trials=trials,
        trial_count=len(trials),
        trial_rmse=rmse,
        trial_rmse_aligned=rmse_aligned,
        baselines_without=baselines_without(trials),
        given_uncertainty=None,
    )


def worlds(band: Band, count: int, seed: int) -> Iterator[FloatArray]:
    """Yield trials that are drawn with replacement, shape [N, T, C]."""
    random = np.random.default_rng(seed)
    assert band.trials is not None
    for _ in range(count):
        drawn = random.integers(len(band.trials), size=len(band.trials))
        yield band.trials[drawn]


def coverage(
    experiment: Experiment, count: int, *, seed: int = 2
) -> tuple[float, float]:
    """Return the true normalized distance, and the share of worlds whose interval holds it."""
    band = reference_band(experiment)
    assert band is not None and band.trials is not None
    sample_count = (experiment.frame_count - 1) * SAMPLES_PER_FRAME + 1
    times_s = np.arange(sample_count) / (SAMPLES_PER_FRAME * FRAME_RATE_HZ)
    motion = exact_motion(experiment, times_s)
    assert motion is not None
    whole = band_of(band, band.trials)
    _, distance = time_offset(times_s, band.project(motion), whole.mean)
    baselines = [
        leave_one_out_distances(trials)[1].mean()
        for trials in worlds(band, 300, seed=1)
    ]
    truth = distance / float(np.mean(baselines))
    held = 0
    for trials in worlds(band, count, seed):
        world = band_of(band, trials)
        score = score_trajectory(
            experiment, world, times_s=times_s, values=motion, is_checked=True
        )
        low, high = score.primary_interval
        held += low <= truth <= high
    return truth, held / count


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2)
    arguments = parser.parse_args()
    print("id, parameters: true normalized distance; share of intervals that hold it")
    for name, parameters in CASES:
        experiment = load_experiment(name, parameters)
        truth, held = coverage(experiment, arguments.worlds, seed=arguments.seed)
        print(f"{name}, {parameters}: {truth:.2f}; {held:.3f}", flush=True)


if __name__ == "__main__":
    main()
