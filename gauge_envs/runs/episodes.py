"""Runs single episodes and repeats of an experiment, and returns their results."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import gymnasium
import numpy as np

from gauge_envs.backends import backend_for
from gauge_envs.backends.base import Worlds
from gauge_envs.envs.arguments import check_support
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.episode import Episode, advance_together
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.experiment import ASSET_NAME, Experiment
from gauge_envs.files import json_ready, versions
from gauge_envs.observables.observer import checked_proxy
from gauge_envs.references.bands import BandGrade
from gauge_envs.references.imported import dataset_record
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result, parameters_record
from gauge_envs.runs.scene_record import asset_record
from gauge_envs.scene.jitter import Jitter, jittered

__all__ = ["episode_result", "planned_result", "run_episode", "run_repeats", "run_together"]


def run_episode(request: RunRequest) -> Result:
    """Run one episode with zero actions, which replays the recorded motion, and score it.

    Args:
        request: What to run; `repeats` and `jitter` are for `run_repeats`.

    Raises:
        UnknownNameError: No such backend.
        ParameterError: A parameter, a setting or an import does not exist, or a value is out of range.
        UnsupportedSceneError: The backend cannot build the scene.
        AssetError: The asset cannot be used.
    """
    subject = request.subject
    env = gymnasium.make(
        f"GAUGE/{ASSET_NAME}" if isinstance(subject, str) else subject.id,
        asset=subject if isinstance(subject, str) else request.asset,
        backend=request.backend,
        parameters=request.parameters,
        settings=request.settings,
        marker_proxy=request.marker_proxy,
        drivers=request.drivers,
        reference=request.reference,
        use_withheld=request.use_withheld,
        disable_env_checker=True,
    )
    try:
        space = env.action_space
        zero = np.zeros(space.shape) if isinstance(space, gymnasium.spaces.Box) else 0
        start = time.perf_counter()
        env.reset(seed=request.seed)
        over = False
        info: dict[str, Any] = {}
        while not over:
            *_, terminated, truncated, info = env.step(zero)
            over = terminated or truncated
        wall_s = time.perf_counter() - start
        return episode_result(env, info, wall_s=wall_s)
    finally:
        env.close()


def episode_result(env: gymnasium.Env, info: Mapping[str, Any], *, wall_s: float | None = None) -> Result:
    """Return the result of an episode that has just ended, for those who step the environment themselves.

    Args:
        env: Environment made by `gymnasium.make`.
        info: What its last step returned.
        wall_s: How long it took [s].

    Raises:
        KeyError: The episode is not over: `info` has no score.
    """
    inner: GaugeEnv = env.unwrapped  # type: ignore[assignment]
    planned = _planned(
        inner.experiment,
        score=info["score"],
        backend=inner.backend_name,
        settings_given=(env.spec.kwargs.get("settings") if env.spec else None) or {},
        seed=inner.seed_used,
        jitter=inner.jitter,
        marker_proxy=inner.episode.marker_proxy.value,
    )
    return _finished(
        planned,
        inner.episode,
        info.get("diverged"),
        settings=inner.simulation.settings,
        engine_versions=inner.versions,
        wall_s=wall_s,
    )


def run_repeats(request: RunRequest) -> list[Result]:
    """Run an experiment several times at once, from starts that scatter as real ones do, and score each.

    They are worlds of one simulation where the engine has such; else simulations that are stepped in turn.

    Args:
        request: What to run; its `jitter` is the default `Jitter` where it states none.

    Returns:
        Results in the order of their seeds. All are scored against the same reference, that of the calibrated start.

    Raises:
        UnknownNameError: No such backend.
        ParameterError: A parameter or a setting is out of range, or nothing can be jittered.
        UnsupportedSceneError: The backend cannot build the scene.
    """
    request = replace(request, jitter=request.jitter or Jitter())
    experiment = request.experiment()
    engine = backend_for(request.backend, experiment.model_file)
    band = reference_band(experiment, use_withheld=request.use_withheld)
    seeds = range(request.seed, request.seed + request.repeats)
    assert request.jitter is not None
    runs = [replace(experiment, scene=jittered(experiment.scene, request.jitter, seed=seed)) for seed in seeds]
    for run in runs:
        check_support(run, request.backend)
    worlds = engine.build_worlds([run.scene for run in runs], request.settings)
    try:
        start = time.perf_counter()
        worlds.reset(request.seed)
        episodes = [
            Episode(run, world, band=band, marker_proxy=checked_proxy(request.marker_proxy))
            for run, world in zip(runs, worlds.worlds, strict=True)
        ]
        faults = run_together(episodes, worlds)
        share_s = (time.perf_counter() - start) / request.repeats
        return [
            _finished(
                replace(planned_result(request, episode.experiment, seed=seed), score=episode.score()),
                episode,
                fault,
                settings=world.settings,
                engine_versions=engine.versions(),
                wall_s=share_s,
            )
            for seed, episode, fault, world in zip(seeds, episodes, faults, worlds.worlds, strict=True)
        ]
    finally:
        worlds.close()


def run_together(episodes: Sequence[Episode], worlds: Worlds) -> list[str | None]:
    """Run episodes with zero actions to their end, all worlds at once; why each one diverged, or None.

    One that has diverged is recorded no further, and the others go on.
    """
    faults: list[str | None] = [None] * len(episodes)
    zero = {number: np.zeros(episode.action_space.shape or 0) for number, episode in enumerate(episodes)}
    for episode in episodes:
        episode.begin()
    for _ in range(episodes[0].experiment.frame_count - 1):
        running = {number: episode for number, episode in enumerate(episodes) if faults[number] is None}
        if not running:
            break
        advance_together(running, worlds, zero)
        for number, episode in running.items():
            faults[number] = episode.end_frame()
    return faults


def planned_result(request: RunRequest, experiment: Experiment, *, seed: int) -> Result:
    """Return what is known of an episode before it runs; as it stands, a result that failed.

    Args:
        request: What will run.
        experiment: Its experiment; where the parameters of the request are wrong, the calibrated one.
        seed: Seed of the episode.
    """
    band = reference_band(experiment, use_withheld=request.use_withheld)
    grade = BandGrade.NONE if band is None else band.grade
    planned = _planned(
        experiment,
        score=Score(grade=grade.value, unit=experiment.score.observable.unit, edited=experiment.edited),
        backend=request.backend,
        settings_given=request.settings or {},
        seed=seed,
        jitter=request.jitter,
        marker_proxy=request.marker_proxy,
    )
    stated = request.parameters if isinstance(request.parameters, str) else json_ready(request.parameters)
    return replace(planned, parameters=stated or "calibrated")


def _planned(
    experiment: Experiment,
    *,
    score: Score,
    backend: str,
    settings_given: Mapping[str, Any],
    seed: int | None,
    jitter: Jitter | None,
    marker_proxy: str,
) -> Result:
    return Result(
        id=experiment.id,
        outcome=Outcome.FAILED,
        parameters=parameters_record(experiment),
        score=score,
        task_sha256=experiment.file_sha256,
        backend=backend,
        settings_given=json_ready(settings_given),
        seed=seed,
        jitter=asdict(jitter) if jitter else {},
        marker_proxy=marker_proxy,
        driver_provenance=experiment.driver_provenance,
        dataset=dataset_record(experiment.name, drivers=experiment.drivers, reference=experiment.reference_source),
        asset=asset_record(experiment),
        error="not run",
    )


def _finished(
    planned: Result,
    episode: Episode,
    fault: str | None,
    *,
    settings: Mapping[str, Any],
    engine_versions: Mapping[str, str],
    wall_s: float | None,
) -> Result:
    recorded = episode.trajectory()
    return replace(
        planned,
        outcome=Outcome.DIVERGED if fault else Outcome.FINISHED,
        frames=len(recorded.frames),
        diverged=bool(fault),
        diverged_reason=fault,
        wall_s=wall_s,
        sim_s=float(recorded.times_s[-1]),
        settings=json_ready(settings),
        versions={**engine_versions, **versions()},
        error=None,
        trajectory=RecordedTrajectory.of(episode.experiment, recorded.times_s, recorded.samples),
    )
