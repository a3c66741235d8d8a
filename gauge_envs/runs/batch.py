"""Run one episode or many, write each result as it ends, go on where a run was cut off; score files of users."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from os import PathLike
from pathlib import Path
from typing import Any

from gauge_envs.backends import backend as find_backend
from gauge_envs.backends import backend_for
from gauge_envs.envs.arguments import check_support
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError, UnsupportedSceneError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.score import Score
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.scene_builder import Parameters
from gauge_envs.experiments.task_format import Variant
from gauge_envs.files import json_ready
from gauge_envs.references.bands import BandGrade
from gauge_envs.references.imported import chosen_drivers, dataset_record
from gauge_envs.runs.episodes import run_episode, run_repeats, run_subject
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.runs.scene_record import asset_record
from gauge_envs.scene.jitter import Jitter, jittered

__all__ = [
    "check_request",
    "run_many",
]

Notify = Callable[[str], None]

_log = logging.getLogger(__name__)


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
    experiment, refused = [], None
    for variant in variants:
        try:
            experiment.append(load_experiment(variant, parameters, asset=asset))
        except ParameterError as error:
            refused = error
    if refused is not None and not experiment:
        raise refused
    for name in backends:
        engine = backend_for(name, experiment[0].model_file if experiment else None)
        if asset is not None:
            check_support(experiment[0], name)
        able = next((one.scene for one in experiment if settings and engine.supports(one.scene)), None)
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
    chosen = {subject: load_experiment(subject, asset=asset) for subject in map(run_subject, variants)}
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
        experiment = load_experiment(subject, parameters, asset=asset)
        if jitter is not None:
            jittered(experiment.scene, jitter, seed=0)
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
