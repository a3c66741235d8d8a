"""Run single episodes and repeats, and return their results."""

import logging
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium

from gauge_envs.backends.registry import versions_of
from gauge_envs.backends.settings import settings_record
from gauge_envs.envs.arguments import EnvArguments
from gauge_envs.envs.initial_states import InitialStates
from gauge_envs.envs.rollout import Rollout
from gauge_envs.envs.world_references import WorldReferences
from gauge_envs.errors import GaugeError, ParameterError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import json_ready
from gauge_envs.processors import processor_name
from gauge_envs.references.kind import Kind
from gauge_envs.registry import package_versions
from gauge_envs.runs.motion import play_recorded
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.result_file import result_of
from gauge_envs.scoring.score import Score

_log = logging.getLogger(__name__)


def run_episode(request: RunRequest) -> Result:
    """Run one episode without actions, which replays the recorded motion, and score it.

    Args:
        request: The run; `repeats` and `jitter` are ignored.
    """
    (result,) = run_episodes(replace(request, repeats=1, jitter=None))
    return result


def run_episodes(request: RunRequest) -> list[Result]:
    """Run the episodes of a request without actions, and score each.

    Repeats are worlds of one simulation if the engine supports that, else sequential simulations.

    Args:
        request: The run. The initial states of repeats have its `jitter`, the default `Jitter`, or the single-trial
            recording of each seed.

    Returns:
        Results in the order of their seeds. The reference of all is that of the nominal start, or each has its own
        single-trial recording.
    """
    experiment = request.experiment()
    sampler = InitialStates(experiment, request.scatter)
    draw = sampler.of_reset(None, seeded=True)
    initial_states = [sampler.sample(draw, seed) for seed in request.seeds]
    versions = versions_of(request.backend)
    rollout = request.rollout([experiment] * request.repeats)
    references = WorldReferences(rollout)
    try:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        rollout.reset(initial_states, request.seed)
        references.start()
        motion = play_recorded(rollout)
        wall_s = (time.perf_counter() - wall_s) / request.repeats
        cpu_s = (time.process_time() - cpu_s) / request.repeats
        results = []
        for world, start in enumerate(initial_states):
            planned = _without_run(
                request, experiment, seed=request.seeds[world], start=start.record
            )
            result = _with_episode(
                planned,
                rollout,
                world,
                references.score(world),
                versions_of_engine=versions,
            )
            results.append(replace(result, wall_s=wall_s, cpu_s=cpu_s))
        results[0] = replace(results[0], motion=motion)
        return results
    finally:
        rollout.simulation.close()


def _start_record(
    request: RunRequest, experiment: Experiment, seed: int
) -> dict[str, float]:
    """Return the entry `jitter` of a result, also if noise is impossible."""
    if request.scatter is not None:
        return request.scatter.to_dict()
    sampler = InitialStates(experiment)
    return sampler.sample(sampler.of_reset(None, seeded=True), seed).record


def run_request(request: RunRequest) -> list[Result]:
    """Run the episodes of a request; an error of the engine becomes the reason of a result.

    Args:
        request: The request with the effective jitter.

    Returns:
        The results in the order of their seeds; unsupported and failed episodes have a reason.
    """
    # Wrong constants make an episode unsupported; wrong settings of the engine make it fail.
    unsupported: type[GaugeError] = ParameterError
    try:
        experiment = request.experiment()
        InitialStates(experiment, request.jitter)
        unsupported = UnsupportedSceneError
        return run_episodes(request)
    except GaugeError as error:
        is_unsupported = isinstance(error, unsupported)
        outcome = Outcome.UNSUPPORTED if is_unsupported else Outcome.FAILED
        return results_without_run(request, outcome, str(error))
    except KeyboardInterrupt:
        raise
    # An engine may raise any error, SystemExit included, but the other episodes must still run.
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
        request: The request with the effective jitter.
        outcome: Outcome of the episodes.
        reason: Why they did not run.
    """
    published = request.published_experiment()
    results = []
    for seed in request.seeds:
        start = _start_record(request, published, seed)
        planned = _without_run(request, published, seed=seed, start=start)
        results.append(replace(planned, outcome=outcome, error=reason))
    return results


def episode_result(env: gymnasium.Env[Any, Any], info: Mapping[str, Any]) -> Result:
    """Return the result of an episode that has just ended.

    Args:
        env: Environment from `gymnasium.make` after its last step.
        info: The `info` of its last step.
    """
    from gauge_envs.envs.env import GaugeEnv

    inner = env.unwrapped
    assert isinstance(inner, GaugeEnv)
    (start,) = inner.rollout.initial_states
    return _with_episode(
        _without_run(
            inner.arguments,
            inner.experiment,
            seed=inner.seed_used,
            start=start.record,
        ),
        inner.rollout,
        0,
        info["score"],
        versions_of_engine=inner.versions,
    )


def _without_run(
    arguments: EnvArguments,
    experiment: Experiment,
    *,
    seed: int | None,
    start: dict[str, float],
) -> Result:
    """Return the result of an episode that has not run.

    Args:
        arguments: Arguments of its environment.
        experiment: Its experiment, or the published one if the parameters are wrong.
        seed: Seed of the episode.
        start: Standard deviations or trial of its initial state.
    """
    return result_of(
        experiment,
        outcome=Outcome.FAILED,
        parameters=json_ready(arguments.parameters) or "published",
        score=Score(kind=Kind.NONE.value, unit=experiment.score.observable.unit),
        backend=arguments.backend,
        settings_given=json_ready(arguments.settings or {}),
        seed=seed,
        jitter=start,
        marker_proxy=arguments.proxy.value,
        error="not run",
    )


def _with_episode(
    result: Result,
    rollout: Rollout,
    world: int,
    score: Score,
    *,
    versions_of_engine: Mapping[str, str],
) -> Result:
    """Return the result of an episode that has run.

    Args:
        result: The result without its run.
        rollout: Episodes that have ended.
        world: Number of the world of this one.
        score: Its score.
        versions_of_engine: Versions of the engine's packages.
    """
    recorded = rollout.recording.trajectory(world)
    reason = rollout.diverged.get(world)
    return replace(
        result,
        outcome=Outcome.DIVERGED if reason else Outcome.FINISHED,
        score=score,
        frames=len(recorded.frames),
        diverged=bool(reason),
        diverged_reason=reason,
        sim_s=float(recorded.times_s[-1]),
        settings=settings_record(result.backend, rollout.simulation.settings),
        versions={**versions_of_engine, **package_versions()},
        processor=processor_name(),
        error=None,
        trajectory=RecordedTrajectory.of(
            rollout.experiment_of(world),
            times_s=recorded.times_s,
            samples=recorded.samples,
            markers_m=recorded.markers_m,
        ),
    )
