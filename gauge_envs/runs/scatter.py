"""Runs with starts or driven bodies that scatter, and what they say beside the published scatter of real trials."""

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from gauge_envs.envs.arguments import jittered_experiment
from gauge_envs.envs.at_once import episodes_in_lockstep
from gauge_envs.evaluation.scatter import (
    Scatter,
    is_held,
    published_numbers,
    refused_scatter,
    scatter_test,
)
from gauge_envs.evaluation.scatter_groups import SPREADS, TRIAL_COUNT
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.jitter import Jitter


def with_scatter(request: RunRequest, results: Sequence[Result]) -> list[Result]:
    """Return the repeats of a request with their scatter beside that of real trials, where that is published.

    It takes as many further runs with half the spread of the starts, and as many with twice; of held bodies none.

    Args:
        request: The run.
        results: Its results; fewer than the number of real trials stay as they are.
    """
    experiment = request.experiment()
    is_known = (
        published_numbers(experiment.baselines) is not None
        and not experiment.impossible_scores
        and experiment.trial is None
    )
    if len(results) < TRIAL_COUNT or not is_known:
        return list(results)
    scatter = _measured(request, experiment, results)
    return [replace(result, scatter=scatter) for result in results]


def _measured(
    request: RunRequest, experiment: Experiment, results: Sequence[Result]
) -> Scatter:
    found, markers_m = [], None
    for result in results:
        if result.outcome is Outcome.FINISHED and result.trajectory is not None:
            found.append(result.trajectory.arrays()[1])
            markers_m = result.trajectory.markers_m()
    samples: dict[float, FloatArray] = {}
    is_attached = is_held(experiment)
    for share in (1.0,) if is_attached else SPREADS:
        runs = found
        if share != 1.0:
            runs = scattered_runs(
                request, experiment, share=share, seeds=_seeds(request)
            )
        if len(runs) < len(results):
            lost = len(results) - len(runs)
            return refused_scatter(
                experiment,
                f"{lost} of {len(results)} runs with {share:g} times the spread of starts diverged",
            )
        samples[share] = np.array(runs)
    return scatter_test(
        experiment, samples, markers_m=markers_m if is_attached else None
    )


def _seeds(request: RunRequest) -> range:
    return range(request.seed, request.seed + request.repeats)


def scattered_runs(
    request: RunRequest, experiment: Experiment, *, share: float, seeds: Sequence[int]
) -> list[FloatArray]:
    """Return g(t) of runs that did not diverge, 180 samples a second, each [sample_count, coordinate_count].

    The runs are worlds of one simulation if the engine supports that.

    Args:
        request: Engine, settings and jitter; the default one if it has none.
        experiment: Experiment that is run.
        share: Spread of the starts, over that of the jitter.
        seeds: Seed of each run.
    """
    spread = asdict(request.jitter or Jitter())
    jitter = Jitter(**{name: share * std for name, std in spread.items()})
    experiments = [jittered_experiment(experiment, jitter, seed=seed) for seed in seeds]
    lockstep = episodes_in_lockstep(request, experiments, [None] * len(seeds))
    try:
        lockstep.play(seeds[0])
        return [
            episode.trajectory().dense[1]
            for episode in lockstep.episodes
            if episode.fault is None
        ]
    finally:
        lockstep.worlds.close()
