"""Runs single episodes and repeats of an experiment, and returns their results."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from os import PathLike
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import backend_for
from gauge_envs.backends.base import Worlds
from gauge_envs.envs.arguments import check_support
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.envs.episode import Episode, advance_together
from gauge_envs.errors import ParameterError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.experiment import ASSET_NAME, Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.scene_source import is_experiment_file
from gauge_envs.experiments.task_files import find_variant
from gauge_envs.experiments.task_format import Variant
from gauge_envs.files import json_ready, versions
from gauge_envs.observables.observer import checked_proxy
from gauge_envs.references.imported import dataset_record
from gauge_envs.runs.result import Outcome, RecordedTrajectory, Result
from gauge_envs.runs.scene_record import asset_record
from gauge_envs.scene.jitter import Jitter, jittered

__all__ = [
    "episode_result",
    "run_episode",
    "run_repeats",
    "run_together",
]


def run_episode(
    variant: str | Variant,
    *,
    backend: str = "mujoco",
    parameters: Parameters = "calibrated",
    settings: Mapping[str, Any] | None = None,
    marker_proxy: str = "node",
    asset: str | PathLike[str] | None = None,
    seed: int = 0,
) -> Result:
    """Run one episode with zero actions, which replays the recorded motion, and score it.

    Args:
        variant: Variant, its name, or its Gymnasium id; or an experiment file, as `crate.toml`.
        backend: Name of an installed physics engine.
        parameters: Name of a parameter set, or overrides keyed `body.constant`.
        settings: Numerical settings of the backend that replace its defaults.
        marker_proxy: What stands for a marker on a deformable body, `node` or `material`; see `GaugeEnv`.
        asset: File that the scene is from, instead of the task file; see `GaugeEnv`.
        seed: Seed of the reset, 0 or more.

    Raises:
        UnknownNameError: No such variant or backend.
        ParameterError: A parameter, a setting or the seed does not exist or is out of range.
        UnsupportedSceneError: The backend cannot build the scene.
        AssetError: The asset cannot be used.
    """
    _check_seed(seed)
    subject = run_subject(variant)
    env = gymnasium.make(
        f"GAUGE/{ASSET_NAME}" if isinstance(subject, str) else subject.id,
        asset=subject if isinstance(subject, str) else asset,
        backend=backend,
        parameters=parameters,
        settings=settings,
        marker_proxy=marker_proxy,
        disable_env_checker=True,
    )
    try:
        space = env.action_space
        zero = np.zeros(space.shape) if isinstance(space, gymnasium.spaces.Box) else 0
        start = time.perf_counter()
        env.reset(seed=seed)
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
    """Result of an episode that has just ended, for those who step the environment themselves.

    Args:
        env: Environment made by `gymnasium.make`.
        info: What its last step returned.
        wall_s: How long it took [s].

    Raises:
        KeyError: The episode is not over: `info` has no score.
    """
    inner: GaugeEnv = env.unwrapped  # type: ignore[assignment]
    return _result_of(
        inner.episode,
        info.get("diverged"),
        backend=inner.backend_name,
        settings=inner.simulation.settings,
        settings_given=env.spec.kwargs.get("settings") if env.spec else None,
        engine_versions=inner.versions,
        seed=inner.seed_used,
        jitter=inner.jitter,
        wall_s=wall_s,
        score=info["score"],
    )


def _result_of(
    episode: Episode,
    fault: str | None,
    *,
    backend: str,
    settings: Mapping[str, Any],
    settings_given: Mapping[str, Any] | None,
    engine_versions: Mapping[str, str],
    seed: int | None,
    jitter: Jitter | None,
    wall_s: float | None,
    score: Score | None = None,
) -> Result:
    experiment, recorded = episode.experiment, episode.trajectory()
    return Result(
        id=experiment.id,
        outcome=Outcome.DIVERGED if fault else Outcome.FINISHED,
        parameters=recorded_parameters(experiment),
        score=score or episode.score(),
        task_sha256=experiment.file_sha256,
        backend=backend,
        frames=len(recorded.frames),
        diverged=bool(fault),
        diverged_reason=fault,
        wall_s=wall_s,
        sim_s=float(recorded.times_s[-1]),
        settings=json_ready(settings),
        settings_given=json_ready(settings_given or {}),
        versions={**engine_versions, **versions()},
        seed=seed,
        jitter=asdict(jitter) if jitter else {},
        marker_proxy=episode.marker_proxy.value,
        driver_provenance=experiment.driver_provenance,
        dataset=dataset_record(experiment.name, experiment.drivers),
        asset=asset_record(experiment),
        trajectory=recorded_trajectory(experiment, recorded.times_s, recorded.samples),
    )


def run_repeats(
    variant: str | Variant,
    *,
    repeats: int,
    backend: str = "mujoco",
    parameters: Parameters = "calibrated",
    settings: Mapping[str, Any] | None = None,
    marker_proxy: str = "node",
    asset: str | PathLike[str] | None = None,
    seed: int = 0,
    jitter: Jitter | None = None,
) -> list[Result]:
    """Run an experiment several times at once, from starts that scatter as real ones do, and score each.

    They are worlds of one simulation where the engine has such; else simulations that are stepped in turn.

    Args:
        variant: As in `run_episode`.
        repeats: How many, 1 or more.
        backend: Name of an installed physics engine.
        parameters: Name of a parameter set, or overrides keyed `body.constant`.
        settings: Numerical settings of the backend that replace its defaults.
        marker_proxy: As in `run_episode`.
        asset: As in `run_episode`.
        seed: Seed of the first; each next one has one more.
        jitter: How far the starts scatter; the default `Jitter` when left out.

    Returns:
        Results in the order of their seeds. All are scored against the same reference, that of the calibrated start.

    Raises:
        UnknownNameError: No such variant or backend.
        ParameterError: A parameter, a setting, the seed or the number is out of range, or nothing can be jittered.
        UnsupportedSceneError: The backend cannot build the scene.
    """
    _check_seed(seed)
    if repeats < 1:
        raise ParameterError(f"repeats is {repeats}, expected 1 or more")
    proxy = checked_proxy(marker_proxy)
    jitter = jitter or Jitter()
    experiment = load_experiment(variant, parameters, asset=asset)
    engine = backend_for(backend, experiment.model_file)
    band = reference_band(experiment)
    runs = [replace(experiment, scene=jittered(experiment.scene, jitter, seed=seed + k)) for k in range(repeats)]
    for run in runs:
        check_support(run, backend)
    worlds = engine.build_worlds([run.scene for run in runs], settings)
    try:
        start = time.perf_counter()
        worlds.reset(seed)
        episodes = [
            Episode(run, world, band=band, marker_proxy=proxy) for run, world in zip(runs, worlds.worlds, strict=True)
        ]
        faults = run_together(episodes, worlds)
        share_s = (time.perf_counter() - start) / repeats
        return [
            _result_of(
                episode,
                fault,
                backend=backend,
                settings=world.settings,
                settings_given=settings,
                engine_versions=engine.versions(),
                seed=seed + number,
                jitter=jitter,
                wall_s=share_s,
            )
            for number, (episode, fault, world) in enumerate(zip(episodes, faults, worlds.worlds, strict=True))
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


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise ParameterError(f"seed is {seed}, expected 0 or more")


def recorded_parameters(experiment: Experiment) -> str | dict[str, Any]:
    return json_ready(experiment.overrides) if experiment.parameters == "custom" else experiment.parameters


def recorded_trajectory(
    experiment: Experiment, times_s: NDArray[np.float64], samples: NDArray[np.float64]
) -> RecordedTrajectory:
    return RecordedTrajectory(
        unit=experiment.score.observable.unit,
        coordinates=list(experiment.coordinates),
        times_s=times_s.tolist(),
        samples=json_ready(samples.tolist()),
    )


def run_subject(name: str | Variant) -> Variant | str:
    """What is run: a variant, or the path of an experiment file."""
    if isinstance(name, Variant):
        return name
    return name if is_experiment_file(Path(name)) else find_variant(name)
