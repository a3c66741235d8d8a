"""Run one episode or many, write each result as it ends, go on where a run was cut off; score files of users."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import backend as find_backend
from gauge_envs.env import GaugeEnv
from gauge_envs.episode import reference_band
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError, TrajectoryFileError, UnsupportedSceneError
from gauge_envs.experiment import Experiment, Parameters, experiment
from gauge_envs.reference import band_grade
from gauge_envs.result import (
    Outcome,
    RecordedTrajectory,
    Result,
    json_ready,
    load_result,
    result_file_name,
    task_sha256,
    versions,
    write_result,
)
from gauge_envs.score import Score, score_trajectory
from gauge_envs.task import find_variant, task_spec
from gauge_envs.task_format import Variant
from gauge_envs.trajectory_file import coordinate_names, read_trajectory, recorded_id

__all__ = ["check_request", "episode_result", "run_episode", "run_many", "score_file"]

Notify = Callable[[str], None]

_log = logging.getLogger(__name__)


# --- one episode -----------------------------------------------------------------------------------------------------


def run_episode(
    variant: str | Variant,
    *,
    backend: str = "mujoco",
    parameters: Parameters = "calibrated",
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
) -> Result:
    """Run one episode with zero actions, which replays the recorded motion, and score it.

    Args:
        variant: Variant, its name, or its Gymnasium id.
        backend: Name of an installed physics engine.
        parameters: Name of a parameter set, or overrides keyed `body.constant`.
        settings: Numerical settings of the backend that replace its defaults.
        seed: Seed of the reset, 0 or more.

    Raises:
        UnknownNameError: No such variant or backend.
        ParameterError: A parameter, a setting or the seed does not exist or is out of range.
        UnsupportedSceneError: The backend cannot build the scene.
    """
    if seed < 0:
        raise ParameterError(f"seed is {seed}, expected 0 or more")
    name = variant.name if isinstance(variant, Variant) else find_variant(variant).name
    env = gymnasium.make(
        f"GAUGE/{name}", backend=backend, parameters=parameters, settings=settings, disable_env_checker=True
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
    resolved, recorded, reason = inner.experiment, inner.trajectory(), info.get("diverged")
    return Result(
        id=resolved.variant.id,
        outcome=Outcome.DIVERGED if reason else Outcome.FINISHED,
        parameters=_parameters_of(resolved),
        score=info["score"],
        task_sha256=task_sha256(resolved.variant.family),
        backend=inner.backend_name,
        frames=len(recorded.frames),
        diverged=bool(reason),
        diverged_reason=reason,
        wall_s=wall_s,
        sim_s=float(recorded.times_s[-1]),
        settings=json_ready(inner.simulation.settings),
        settings_given=json_ready((env.spec.kwargs.get("settings") if env.spec else None) or {}),
        versions=inner.versions | versions(),
        seed=inner.seed_used,
        driver_provenance=resolved.driver_provenance,
        trajectory=_recorded(resolved, recorded.times_s, recorded.samples),
    )


def score_file(file: Path, *, variant: str | None = None, parameters: Parameters | None = None) -> tuple[Result, int]:
    """Score a trajectory that a user brought from their own simulator (formats: `gauge_envs.trajectory_file`).

    Args:
        file: CSV, NPZ or JSON file.
        variant: Name or id of the experiment; None takes the id that a JSON file states.
        parameters: Parameters of the scene, for bands that follow from it; None takes what the file states, else
            `calibrated`.

    Returns:
        The result, and the number of frames that had to be interpolated.

    Raises:
        TrajectoryFileError: The file cannot be used, or it is of another experiment than `variant`.
        UnknownNameError: No such variant.
        ParameterError: No such parameters.
    """
    stated_id, stated_parameters = recorded_id(file)
    name = variant or stated_id
    if name is None:
        raise TrajectoryFileError(f"{file}: states no id, expected one with --id, as --id GAUGE/SlopeSlider-2-wood")
    chosen = find_variant(name)
    if stated_id is not None and find_variant(stated_id) != chosen:
        raise TrajectoryFileError(f"{file}: id is {stated_id!r}, but {chosen.id} was asked for")
    if parameters is None:
        parameters = stated_parameters if isinstance(stated_parameters, str | dict) else "calibrated"
    resolved = experiment(chosen, parameters)
    trajectory = read_trajectory(file, resolved)
    score = score_trajectory(resolved, reference_band(resolved), times_s=trajectory.times_s, values=trajectory.values)
    result = Result(
        id=chosen.id,
        outcome=Outcome.FINISHED,
        parameters=_parameters_of(resolved),
        score=score,
        task_sha256=task_sha256(chosen.family),
        frames=resolved.frame_count,
        sim_s=float(trajectory.times_s[-1]),
        driver_provenance=resolved.driver_provenance,
        trajectory=_recorded(resolved, trajectory.times_s, trajectory.values),
    )
    return result, trajectory.interpolated_frames


def _parameters_of(resolved: Experiment) -> str | dict[str, Any]:
    return json_ready(resolved.overrides) if resolved.parameters == "custom" else resolved.parameters


def _recorded(resolved: Experiment, times_s: NDArray[np.float64], samples: NDArray[np.float64]) -> RecordedTrajectory:
    return RecordedTrajectory(
        unit=resolved.spec.score.observable.unit,
        coordinates=list(coordinate_names(resolved)),
        times_s=times_s.tolist(),
        samples=json_ready(samples.tolist()),
    )


# --- many episodes ---------------------------------------------------------------------------------------------------


def check_request(
    variants: Sequence[Variant], *, backends: Sequence[str], parameters: Parameters, settings: Mapping[str, Any] | None
) -> None:
    """Raise at once what would otherwise fail every single episode.

    Raises:
        UnknownNameError: No such backend.
        MissingExtraError: The engine of a backend is not installed.
        ParameterError: No variant takes the parameters, or a backend does not take the settings.
    """
    resolved, refused = [], None
    for variant in variants:
        try:
            resolved.append(experiment(variant, parameters))
        except ParameterError as error:
            refused = error
    if refused is not None and not resolved:
        raise refused
    for name in backends:
        engine = find_backend(name)
        able = next((one.scene for one in resolved if settings and engine.supports(one.scene)), None)
        if able is not None:
            engine.build(able, settings).close()


def run_many(
    variants: Iterable[str | Variant],
    *,
    backends: Sequence[str] = ("mujoco",),
    parameters: Parameters = "calibrated",
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    out: Path | None = None,
    resume: bool = False,
    notify: Notify = _log.warning,
) -> Iterator[Result]:
    """Run episodes one after another; each result is on disk before it is yielded.

    One that is declined or fails is yielded with its `error`, and not written; the others go on.

    Args:
        variants: Variants, names or ids.
        backends: Names of installed physics engines.
        parameters: As in `run_episode`.
        settings: As in `run_episode`.
        seed: As in `run_episode`.
        out: Folder for the result files, created if need be; None writes none.
        resume: Take results that `out` has already, where they are of the same experiment, backend, parameters,
            settings, seed, task file and versions of engine and gauge-envs. A damaged one is moved aside, to
            `*.damaged`, and run again.
        notify: Takes one sentence for each file that `resume` could not take.

    Returns:
        Iterator that runs the next episode when asked for it.

    Raises:
        UnknownNameError: No such variant.
        ResultFileError: `out` cannot be written; raised before anything runs.
    """
    chosen = list(dict.fromkeys(find_variant(v) if isinstance(v, str) else v for v in variants))
    if out is not None:
        _check_writable(out)

    def results() -> Iterator[Result]:
        for name in backends:
            for variant in chosen:
                empty = _empty_result(variant, name, parameters, settings, seed)
                file = None if out is None else out / result_file_name(empty)
                result = _earlier(file, empty, notify) if resume and file is not None else None
                if result is None:
                    result = _attempt(variant, name, parameters, settings, seed, empty)
                    if file is not None and result.error is None:
                        write_result(result, file)
                yield result

    return results()


def _attempt(
    variant: Variant,
    backend: str,
    parameters: Parameters,
    settings: Mapping[str, Any] | None,
    seed: int,
    empty: Result,
) -> Result:
    try:
        experiment(variant, parameters)
    except ParameterError as error:
        return replace(empty, outcome=Outcome.DECLINED, error=str(error))
    except GaugeError as error:
        return replace(empty, error=str(error))
    try:
        return run_episode(variant, backend=backend, parameters=parameters, settings=settings, seed=seed)
    except UnsupportedSceneError as error:
        return replace(empty, outcome=Outcome.DECLINED, error=str(error))
    except GaugeError as error:
        return replace(empty, error=str(error))
    except Exception as error:  # Engines raise anything, and one episode must not cost the others.
        _log.exception("%s on %s", variant.id, backend)
        return replace(empty, error=f"{type(error).__name__}: {error}")


def _empty_result(
    variant: Variant, backend: str, parameters: Parameters, settings: Mapping[str, Any] | None, seed: int
) -> Result:
    """What is known before an episode runs; as it stands, one that failed."""
    return Result(
        id=variant.id,
        outcome=Outcome.FAILED,
        parameters=(parameters if isinstance(parameters, str) else json_ready(parameters)) or "calibrated",
        score=Score(grade=band_grade(variant.name).value, unit=task_spec(variant.family).score.observable.unit),
        task_sha256=task_sha256(variant.family),
        backend=backend,
        settings_given=json_ready(settings or {}),
        seed=seed,
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
    for key in ("id", "backend", "parameters", "settings_given", "seed", "task_sha256"):
        if getattr(found, key) != getattr(wanted, key):
            notify(f"{file}: {key} differs from what is asked for; run again")
            return None
    engine = {} if wanted.backend is None else find_backend(wanted.backend).versions()
    for package, now in {**engine, "gauge-envs": wanted.versions["gauge-envs"]}.items():
        if found.versions.get(package) != now:
            notify(f"{file}: made with {package} {found.versions.get(package)}, not {now}; run again")
            return None
    return found
