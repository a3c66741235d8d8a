"""Runs of single episodes and of repeats, and their results."""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

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
from gauge_envs.envs.episode import Trajectory
from gauge_envs.errors import GaugeError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready, processor, versions
from gauge_envs.references.kind import Kind
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.result_file import result_of
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
    starts = [
        start_of(experiment, request.jitter, seed=seed)
        or (Jitter() if request.repeats > 1 else None)
        for seed in request.seeds
    ]
    runs = [
        jittered_experiment(experiment, start, seed=seed)
        for start, seed in zip(starts, request.seeds, strict=True)
    ]
    engine_versions = versions_of(request.backend)
    return [
        _with_episode(
            _without_run(request, experiment, seed=seed, start=start),
            run,
            episode,
            engine_versions,
        )
        for seed, start, run, episode in zip(
            request.seeds, starts, runs, _play(request, experiment, runs), strict=True
        )
    ]


class _Played(NamedTuple):
    """What an episode gave; `wall_s` and `cpu_s` are its shares of the times of all episodes, or None."""

    trajectory: Trajectory
    score: Score
    fault: str | None
    settings: Mapping[str, Any]
    wall_s: float | None = None
    cpu_s: float | None = None


def _play(
    request: RunRequest, experiment: Experiment, runs: Sequence[Experiment]
) -> list[_Played]:
    """Run episodes without actions.

    Args:
        request: Engine, settings and marker proxy.
        experiment: The experiment with the calibrated start, whose band scores all episodes but single-shot trials.
        runs: The experiment of each episode; they differ in their starts.
    """
    lockstep = episodes_in_lockstep(
        request,
        runs,
        [request.band(experiment)] * len(runs),
        together=request.repeats > 1 or request.jitter is not None,
    )
    try:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        lockstep.play(request.seed)
        wall_s = (time.perf_counter() - wall_s) / len(runs)
        cpu_s = (time.process_time() - cpu_s) / len(runs)
        return [
            _Played(
                score=one.score(),
                # The score may add later samples.
                trajectory=one.trajectory(),
                fault=one.fault,
                settings=one.settings,
                wall_s=wall_s,
                cpu_s=cpu_s,
            )
            for one in lockstep.episodes
        ]
    finally:
        lockstep.worlds.close()


def run_request(request: RunRequest) -> list[Result]:
    """Run the episodes of a request; whatever the engine raises becomes the reason of a result.

    Args:
        request: The request, with the jitter that applies.

    Returns:
        The results in the order of their seeds. Those of episodes that were declined or failed hold the reason.
    """
    # Wrong constants decline an episode; wrong settings of the engine fail it.
    declines: type[GaugeError] = ParameterError
    try:
        experiment = request.experiment()
        if request.jitter is not None:
            scattered(experiment.scene, request.jitter, seed=0)
        declines = UnsupportedSceneError
        return run_episodes(request)
    except GaugeError as error:
        is_declined = isinstance(error, declines)
        outcome = Outcome.DECLINED if is_declined else Outcome.FAILED
        return results_without_run(request, outcome, str(error))
    except KeyboardInterrupt:
        raise
    # An engine may raise any error, SystemExit included, and the other episodes must still run.
    except BaseException as error:
        _log.exception("%s on %s", request.variant, request.backend)
        cause = f"{type(error).__name__}: {error}".removesuffix(": ")
        return results_without_run(request, Outcome.FAILED, cause)


def results_without_run(
    request: RunRequest,
    outcome: Outcome = Outcome.FAILED,
    reason: str = "not run",
) -> list[Result]:
    """Return the results of episodes that have not run, in the order of their seeds.

    Args:
        request: The request, with the jitter that applies.
        outcome: Outcome of the episodes.
        reason: Why they have not run.
    """
    calibrated = request.calibrated_experiment()
    return [
        replace(
            _without_run(
                request,
                calibrated,
                seed=seed,
                start=start_of(calibrated, request.jitter, seed=seed),
            ),
            outcome=outcome,
            error=reason,
        )
        for seed in request.seeds
    ]


def episode_result(env: gymnasium.Env[Any, Any], info: Mapping[str, Any]) -> Result:
    """Return the result of an episode that has just ended.

    Args:
        env: Environment made by `gymnasium.make`, which the caller has stepped to the end.
        info: The `info` of its last step.
    """
    from gauge_envs.envs.env import GaugeEnv

    inner = env.unwrapped
    assert isinstance(inner, GaugeEnv)
    episode = inner.episode
    return _with_episode(
        _without_run(
            inner.arguments, inner.experiment, seed=inner.seed_used, start=inner.jitter
        ),
        episode.experiment,
        _Played(episode.trajectory(), info["score"], episode.fault, episode.settings),
        inner.versions,
    )


def _without_run(
    arguments: EnvArguments,
    experiment: Experiment,
    *,
    seed: int | None,
    start: Jitter | TrialStart | None,
) -> Result:
    """Return the result of an episode that has not run.

    Args:
        arguments: Arguments of its environment.
        experiment: Its experiment, or the calibrated one if the parameters are wrong.
        seed: Seed of the episode.
        start: Standard deviations or trial of its start, or None.
    """
    band = arguments.band(experiment)
    kind = Kind.NONE if band is None else band.kind
    parameters = arguments.parameters
    return result_of(
        experiment,
        outcome=Outcome.FAILED,
        parameters=(
            parameters if isinstance(parameters, str) else json_ready(parameters)
        )
        or "calibrated",
        score=Score(kind=kind.value, unit=experiment.score.observable.unit),
        backend=arguments.backend,
        settings_given=json_ready(arguments.settings or {}),
        seed=seed,
        jitter=start.to_dict() if start else {},
        marker_proxy=arguments.proxy.value,
        error="not run",
    )


def _with_episode(
    result: Result,
    experiment: Experiment,
    episode: _Played,
    engine_versions: Mapping[str, str],
) -> Result:
    """Return the result of an episode that has run.

    Args:
        result: The result without its run.
        experiment: The experiment with the start of the episode.
        episode: What the episode gave.
        engine_versions: Versions of the engine's packages.
    """
    recorded = episode.trajectory
    return replace(
        result,
        outcome=Outcome.DIVERGED if episode.fault else Outcome.FINISHED,
        score=episode.score,
        frames=len(recorded.frames),
        diverged=bool(episode.fault),
        diverged_reason=episode.fault,
        wall_s=episode.wall_s,
        cpu_s=episode.cpu_s,
        sim_s=float(recorded.times_s[-1]),
        settings=settings_record(result.backend, episode.settings),
        versions={**engine_versions, **versions()},
        processor=processor(),
        error=None,
        trajectory=RecordedTrajectory.of(
            experiment, *recorded.dense, markers_m=recorded.markers_m
        ),
    )
