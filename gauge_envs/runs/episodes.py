"""Runs of single episodes and of repeats, and their results."""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium

from gauge_envs.backends.registry import versions_of
from gauge_envs.backends.settings import settings_record
from gauge_envs.envs.arguments import (
    EnvArguments,
    TrialStart,
    jittered_experiment,
    start_of,
)
from gauge_envs.envs.at_once import episodes_in_lockstep
from gauge_envs.envs.episode import Episode
from gauge_envs.errors import GaugeError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready, processor, versions
from gauge_envs.references.imported import dataset_record
from gauge_envs.references.kind import Kind
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.result_file import asset_record
from gauge_envs.scene.jitter import Jitter, scattered
from gauge_envs.scoring.score import Score

_log = logging.getLogger(__name__)


def run_episode(request: RunRequest) -> Result:
    """Run one episode without actions, which replays the recorded motion, and score it.

    Args:
        request: The run; its `repeats` and `jitter` do not apply.
    """
    (result,) = run_episodes(replace(request, repeats=1, jitter=None))
    return result


def run_episodes(request: RunRequest) -> list[Result]:
    """Run the episodes of a request without actions, and score each.

    Repeats and episodes with a jitter are worlds of one simulation if the engine supports that; else simulations that
    are stepped in turn.

    Args:
        request: The run. Its repeats start as those of real trials scatter: with its `jitter`, with the default one, or
            as the single-shot trial of each seed.

    Returns:
        Results in the order of their seeds. All are scored against the reference of the calibrated start, or each
        against its own single-shot trial.
    """
    experiment = request.experiment()
    seeds = range(request.seed, request.seed + request.repeats)
    together = request.repeats > 1 or request.jitter is not None
    starts = [
        start_of(experiment, request.jitter, seed=seed)
        or (Jitter() if together else None)
        for seed in seeds
    ]
    runs = [
        jittered_experiment(experiment, start, seed=seed)
        for start, seed in zip(starts, seeds, strict=True)
    ]
    lockstep = episodes_in_lockstep(
        request, runs, [request.band(experiment)] * len(runs), together=together
    )
    try:
        began_s = time.perf_counter(), time.process_time()
        lockstep.play(request.seed)
        wall_s, cpu_s = (
            time.perf_counter() - began_s[0],
            time.process_time() - began_s[1],
        )
        return [
            _finished(
                planned_result(request, experiment, seed=seed, jitter=start),
                episode,
                episode.score(),
                engine_versions=versions_of(request.backend),
                times_s=(wall_s / len(starts), cpu_s / len(starts)),
            )
            for seed, start, episode in zip(
                seeds, starts, lockstep.episodes, strict=True
            )
        ]
    finally:
        lockstep.worlds.close()


def planned_results(request: RunRequest) -> list[Result]:
    """Return the results of a request that has not run, in the order of their seeds.

    Args:
        request: The request, with the jitter that applies.
    """
    calibrated = request.calibrated_experiment()
    return [
        planned_result(
            request,
            calibrated,
            seed=seed,
            jitter=start_of(calibrated, request.jitter, seed=seed),
        )
        for seed in range(request.seed, request.seed + request.repeats)
    ]


def not_run(planned: Sequence[Result], outcome: Outcome, reason: str) -> list[Result]:
    """Return planned results with an outcome and its reason."""
    return [replace(one, outcome=outcome, error=reason) for one in planned]


def run_request(request: RunRequest) -> list[Result]:
    """Run the episodes of a request; whatever the engine raises becomes the reason of a result.

    Args:
        request: The request, with the jitter that applies.

    Returns:
        The results in the order of their seeds. Those of episodes that were declined or failed hold the reason.
    """
    planned = planned_results(request)
    try:
        experiment = request.experiment()
        if request.jitter is not None:
            scattered(experiment.scene, request.jitter, seed=0)
    except GaugeError as error:
        outcome = (
            Outcome.DECLINED if isinstance(error, ParameterError) else Outcome.FAILED
        )
        return not_run(planned, outcome, str(error))
    try:
        return run_episodes(request)
    except GaugeError as error:
        outcome = (
            Outcome.DECLINED
            if isinstance(error, UnsupportedSceneError)
            else Outcome.FAILED
        )
        return not_run(planned, outcome, str(error))
    except KeyboardInterrupt:
        raise
    # An engine may raise any error, SystemExit included, and the other episodes must still run.
    except BaseException as error:
        _log.exception("%s on %s", planned[0].id, request.backend)
        return not_run(
            planned,
            Outcome.FAILED,
            f"{type(error).__name__}: {error}".removesuffix(": "),
        )


def episode_result(env: gymnasium.Env[Any, Any], info: Mapping[str, Any]) -> Result:
    """Return the result of an episode that has just ended.

    Args:
        env: Environment made by `gymnasium.make`, which the caller has stepped to the end.
        info: The `info` of its last step.
    """
    from gauge_envs.envs.env import GaugeEnv

    inner = env.unwrapped
    assert isinstance(inner, GaugeEnv)
    planned = planned_result(
        inner.arguments, inner.experiment, seed=inner.seed_used, jitter=inner.jitter
    )
    return _finished(
        planned,
        inner.episode,
        info["score"],
        engine_versions=inner.versions,
        times_s=(None, None),
    )


def planned_result(
    arguments: EnvArguments,
    experiment: Experiment,
    *,
    seed: int | None,
    jitter: Jitter | TrialStart | None,
) -> Result:
    """Return the result of an episode that has not run.

    Args:
        arguments: Arguments of its environment.
        experiment: Its experiment, or the calibrated one if the parameters are wrong.
        seed: Seed of the episode.
        jitter: Standard deviations or trial of its start, or None.
    """
    band = arguments.band(experiment)
    kind = Kind.NONE if band is None else band.kind
    parameters = arguments.parameters
    return Result(
        id=experiment.id,
        outcome=Outcome.FAILED,
        parameters=(
            parameters if isinstance(parameters, str) else json_ready(parameters)
        )
        or "calibrated",
        score=Score(kind=kind.value, unit=experiment.score.observable.unit),
        task_sha256=experiment.file_sha256,
        revision=experiment.revision,
        backend=arguments.backend,
        settings_given=json_ready(arguments.settings or {}),
        seed=seed,
        jitter=jitter.to_dict() if jitter else {},
        marker_proxy=arguments.proxy.value,
        driver_provenance=experiment.driver_provenance,
        dataset=dataset_record(
            experiment.name,
            drivers=experiment.drivers,
            reference=experiment.reference_source,
        ),
        asset=asset_record(experiment),
        error="not run",
    )


def _finished(
    planned: Result,
    episode: Episode,
    score: Score,
    *,
    engine_versions: Mapping[str, str],
    times_s: tuple[float | None, float | None],
) -> Result:
    """Return a planned result with what its episode gave; `times_s` are its wall and its CPU time."""
    recorded = episode.trajectory()
    return replace(
        planned,
        outcome=Outcome.DIVERGED if episode.fault else Outcome.FINISHED,
        score=score,
        frames=len(recorded.frames),
        diverged=bool(episode.fault),
        diverged_reason=episode.fault,
        wall_s=times_s[0],
        cpu_s=times_s[1],
        sim_s=float(recorded.times_s[-1]),
        settings=settings_record(planned.backend, episode.settings),
        versions={**engine_versions, **versions()},
        processor=processor(),
        error=None,
        trajectory=RecordedTrajectory.of(
            episode.experiment,
            *recorded.dense,
            markers_m=recorded.markers_m,
        ),
    )
