"""Run one episode or many, write each result as it ends, go on where a run was cut off; score files of users."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from os import PathLike
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gauge_envs.asset import is_experiment_file
from gauge_envs.backends import backend as find_backend
from gauge_envs.backends import backend_for
from gauge_envs.backends.base import Worlds
from gauge_envs.dataset.store import chosen_drivers, dataset_record
from gauge_envs.env import GaugeEnv, check_support
from gauge_envs.episode import Episode, advance_together, reference_band
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError, TrajectoryFileError, UnsupportedSceneError
from gauge_envs.experiment import ASSET_NAME, Experiment, Parameters, experiment
from gauge_envs.jitter import Jitter, jittered
from gauge_envs.observer import checked_proxy
from gauge_envs.reference import BandGrade
from gauge_envs.result import (
    Outcome,
    RecordedTrajectory,
    Result,
    asset_record,
    json_ready,
    load_result,
    recorded_experiment,
    result_file_name,
    versions,
    write_result,
)
from gauge_envs.score import Score, score_trajectory
from gauge_envs.task import find_variant
from gauge_envs.task_format import Variant
from gauge_envs.trajectory_file import coordinate_names, read_trajectory, recorded_id

__all__ = ["check_request", "episode_result", "run_episode", "run_many", "run_repeats", "run_together", "score_file"]

Notify = Callable[[str], None]

_log = logging.getLogger(__name__)


# --- one episode -----------------------------------------------------------------------------------------------------


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
    subject = _subject(variant)
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
    resolved, recorded = episode.experiment, episode.trajectory()
    return Result(
        id=resolved.id,
        outcome=Outcome.DIVERGED if fault else Outcome.FINISHED,
        parameters=_parameters_of(resolved),
        score=score or episode.score(),
        task_sha256=resolved.file_sha256,
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
        driver_provenance=resolved.driver_provenance,
        dataset=dataset_record(resolved.name, resolved.drivers),
        asset=asset_record(resolved),
        trajectory=_recorded(resolved, recorded.times_s, recorded.samples),
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
    resolved = experiment(variant, parameters, asset=asset)
    engine = backend_for(backend, resolved.model_file)
    band = reference_band(resolved)
    runs = [replace(resolved, scene=jittered(resolved.scene, jitter, seed=seed + k)) for k in range(repeats)]
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


def score_file(
    file: Path, *, variant: str | None = None, parameters: Parameters | None = None, use_withheld: bool = False
) -> tuple[Result, int]:
    """Score a trajectory that a user brought from their own simulator (formats: `gauge_envs.trajectory_file`).

    Args:
        file: CSV, NPZ or JSON file.
        variant: Name or id of the experiment, or an experiment file; None takes what a JSON file states.
        parameters: Parameters of the scene, for bands that follow from it; None takes what the file states, else
            `calibrated`.
        use_withheld: Score on a band too that is withheld by default.

    Returns:
        The result, and the number of frames that had to be interpolated.

    Raises:
        TrajectoryFileError: The file cannot be used, or it is of another experiment than `variant`.
        UnknownNameError: No such variant.
        ParameterError: No such parameters.
    """
    resolved = _experiment_of_file(file, variant, parameters)
    trajectory = read_trajectory(file, resolved)
    band = reference_band(resolved, use_withheld=use_withheld)
    score = score_trajectory(resolved, band, times_s=trajectory.times_s, values=trajectory.values)
    result = Result(
        id=resolved.id,
        outcome=Outcome.FINISHED,
        parameters=_parameters_of(resolved),
        score=score,
        task_sha256=resolved.file_sha256,
        frames=resolved.frame_count,
        sim_s=float(trajectory.times_s[-1]),
        driver_provenance=resolved.driver_provenance,
        dataset=dataset_record(resolved.name, resolved.drivers),
        asset=asset_record(resolved),
        trajectory=_recorded(resolved, trajectory.times_s, trajectory.values),
    )
    return result, trajectory.interpolated_frames


def _experiment_of_file(file: Path, variant: str | None, parameters: Parameters | None) -> Experiment:
    """The experiment that a trajectory is of: as asked for, else as the file states."""
    stated_id, stated_parameters, has_asset = recorded_id(file)
    if has_asset and variant is None and parameters is None:
        return recorded_experiment(load_result(file))
    name = variant or stated_id
    if name is None:
        raise TrajectoryFileError(f"{file}: states no id, expected one with --id, as --id GAUGE/SlopeSlider-2-wood")
    subject = _subject(name)
    if parameters is None:
        known = isinstance(stated_parameters, str | dict) and not has_asset
        parameters = stated_parameters if known else "calibrated"
    resolved = experiment(subject, parameters)
    stated = stated_id if stated_id is None or has_asset else find_variant(stated_id).id
    if stated is not None and stated != resolved.id:
        raise TrajectoryFileError(f"{file}: id is {stated_id!r}, but {resolved.id} was asked for")
    return resolved


def _subject(name: str | Variant) -> Variant | str:
    """What is run: a variant, or the path of an experiment file."""
    if isinstance(name, Variant):
        return name
    return name if is_experiment_file(Path(name)) else find_variant(name)


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise ParameterError(f"seed is {seed}, expected 0 or more")


def _parameters_of(resolved: Experiment) -> str | dict[str, Any]:
    return json_ready(resolved.overrides) if resolved.parameters == "custom" else resolved.parameters


def _recorded(resolved: Experiment, times_s: NDArray[np.float64], samples: NDArray[np.float64]) -> RecordedTrajectory:
    return RecordedTrajectory(
        unit=resolved.score.observable.unit,
        coordinates=list(coordinate_names(resolved)),
        times_s=times_s.tolist(),
        samples=json_ready(samples.tolist()),
    )


# --- many episodes ---------------------------------------------------------------------------------------------------


def check_request(
    variants: Sequence[str | Variant],
    *,
    backends: Sequence[str],
    parameters: Parameters,
    settings: Mapping[str, Any] | None,
    asset: str | PathLike[str] | None = None,
) -> None:
    """Raise at once what would otherwise fail every single episode.

    Raises:
        UnknownNameError: No such backend.
        MissingExtraError: The engine of a backend is not installed.
        ParameterError: No variant takes the parameters, or a backend does not take the settings.
        AssetError: The asset cannot be used.
        UnsupportedSceneError: The asset is a model file that a backend does not read.
    """
    resolved, refused = [], None
    for variant in variants:
        try:
            resolved.append(experiment(variant, parameters, asset=asset))
        except ParameterError as error:
            refused = error
    if refused is not None and not resolved:
        raise refused
    for name in backends:
        engine = backend_for(name, resolved[0].model_file if resolved else None)
        if asset is not None:
            check_support(resolved[0], name)
        able = next((one.scene for one in resolved if settings and engine.supports(one.scene)), None)
        if able is not None:
            engine.build(able, settings).close()


def run_many(
    variants: Iterable[str | Variant],
    *,
    backends: Sequence[str] = ("mujoco",),
    parameters: Parameters = "calibrated",
    settings: Mapping[str, Any] | None = None,
    marker_proxy: str = "node",
    asset: str | PathLike[str] | None = None,
    seed: int = 0,
    repeats: int = 1,
    jitter: Jitter | None = None,
    out: Path | None = None,
    resume: bool = False,
    notify: Notify = _log.warning,
) -> Iterator[Result]:
    """Run episodes one after another, repeats together; each result is on disk before it is yielded.

    One that is declined or fails is yielded with its `error`, and not written; the others go on.

    Args:
        variants: Variants, names, ids, or paths of experiment files.
        backends: Names of installed physics engines.
        parameters: As in `run_episode`.
        settings: As in `run_episode`.
        marker_proxy: As in `run_episode`.
        asset: As in `run_episode`; it is of one variant.
        seed: As in `run_episode`.
        repeats: How often each runs, from starts that scatter; 1 runs the calibrated start, unless jitter is given.
        jitter: How far starts scatter; the default `Jitter` where repeats ask for it.
        out: Folder for the result files, created if need be; None writes none.
        resume: Take results that `out` has already, where they are of the same experiment, backend, parameters,
            settings, seed, jitter, task file, asset, imported trials and versions of engine and gauge-envs. A damaged
            one is moved aside, to `*.damaged`, and run again.
        notify: Takes one sentence for each file that `resume` could not take.

    Returns:
        Iterator that runs the next episode when asked for it.

    Raises:
        UnknownNameError: No such variant.
        ResultFileError: `out` cannot be written; raised before anything runs.
        AssetError: The asset or an experiment file cannot be used; raised before anything runs.
    """
    chosen = {subject: experiment(subject, asset=asset) for subject in map(_subject, variants)}
    if out is not None:
        _check_writable(out)

    if repeats > 1 and jitter is None:
        jitter = Jitter()

    def results() -> Iterator[Result]:
        for name in backends:
            for subject, known in chosen.items():
                empty = [
                    _empty_result(known, name, parameters, settings, marker_proxy, seed + number, jitter)
                    for number in range(repeats)
                ]
                files = [None if out is None else out / result_file_name(one) for one in empty]
                found = [
                    _earlier(file, one, notify) if resume and file is not None else None
                    for file, one in zip(files, empty, strict=True)
                ]
                if all(found):
                    yield from (result for result in found if result)
                    continue
                for result, file in zip(_attempt(subject, asset, parameters, empty, jitter), files, strict=True):
                    if file is not None and result.error is None:
                        write_result(result, file)
                    yield result

    return results()


def _attempt(
    subject: Variant | str,
    asset: str | PathLike[str] | None,
    parameters: Parameters,
    empty: Sequence[Result],
    jitter: Jitter | None,
) -> list[Result]:
    """Results of an experiment's repeats; those that were declined or failed carry the reason."""
    first = empty[0]
    try:
        resolved = experiment(subject, parameters, asset=asset)
        if jitter is not None:
            jittered(resolved.scene, jitter, seed=0)
    except ParameterError as error:
        return [replace(one, outcome=Outcome.DECLINED, error=str(error)) for one in empty]
    except GaugeError as error:
        return [replace(one, error=str(error)) for one in empty]
    request: dict[str, Any] = {
        "backend": first.backend,
        "parameters": parameters,
        "settings": first.settings_given or None,
        "marker_proxy": first.marker_proxy,
        "asset": asset,
        "seed": first.seed,
    }
    try:
        if jitter is None:
            return [run_episode(subject, **request)]
        return run_repeats(subject, repeats=len(empty), jitter=jitter, **request)
    except UnsupportedSceneError as error:
        return [replace(one, outcome=Outcome.DECLINED, error=str(error)) for one in empty]
    except GaugeError as error:
        return [replace(one, error=str(error)) for one in empty]
    except Exception as error:  # Engines raise anything, and one episode must not cost the others.
        _log.exception("%s on %s", first.id, first.backend)
        return [replace(one, error=f"{type(error).__name__}: {error}") for one in empty]


def _empty_result(
    known: Experiment,
    backend: str,
    parameters: Parameters,
    settings: Mapping[str, Any] | None,
    marker_proxy: str,
    seed: int,
    jitter: Jitter | None,
) -> Result:
    """What is known before an episode runs; as it stands, one that failed."""
    band = reference_band(known)
    grade = BandGrade.NONE if band is None else band.grade
    return Result(
        id=known.id,
        outcome=Outcome.FAILED,
        parameters=(parameters if isinstance(parameters, str) else json_ready(parameters)) or "calibrated",
        score=Score(grade=grade.value, unit=known.score.observable.unit, edited=known.edited),
        task_sha256=known.file_sha256,
        backend=backend,
        settings_given=json_ready(settings or {}),
        seed=seed,
        jitter=asdict(jitter) if jitter else {},
        marker_proxy=marker_proxy,
        dataset=dataset_record(known.name, chosen_drivers() if known.asset is None else known.drivers),
        asset=asset_record(known),
        error="not run",
    )


def _check_writable(out: Path) -> None:
    probe = out / f".probe.{os.getpid()}.tmp"
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise ResultFileError(f"{out}: results cannot be written there: {error.strerror or error}") from error


def _earlier(file: Path, wanted: Result, notify: Notify) -> Result | None:
    """The result that is there already, when it is of the very same episode."""
    if not file.exists():
        return None
    try:
        found = load_result(file)
    except ResultFileError as error:
        aside = file.with_name(f"{file.name}.damaged")
        count = 1
        while aside.exists():
            count += 1
            aside = file.with_name(f"{file.name}.damaged-{count}")
        file.replace(aside)
        notify(f"{error}; moved to {aside.name} and run again")
        return None
    same = (
        "id",
        "backend",
        "parameters",
        "settings_given",
        "seed",
        "jitter",
        "marker_proxy",
        "task_sha256",
        "dataset",
        "asset",
    )
    for key in same:
        if getattr(found, key) != getattr(wanted, key):
            notify(f"{file}: {key} differs from what is asked for; run again")
            return None
    engine = {} if wanted.backend is None else find_backend(wanted.backend).versions()
    for package, now in {**engine, "gauge-envs": wanted.versions["gauge-envs"]}.items():
        if found.versions.get(package) != now:
            notify(f"{file}: made with {package} {found.versions.get(package)}, not {now}; run again")
            return None
    return found
