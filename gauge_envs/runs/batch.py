"""Runs many episodes, writes each result as it ends, and goes on where a run was cut off."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from gauge_envs.backends import backend as find_backend
from gauge_envs.backends import backend_for
from gauge_envs.envs.arguments import check_support
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.runs.episodes import planned_result, run_episode, run_repeats
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.scene.jitter import Jitter, jittered

__all__ = [
    "check_requests",
    "run_many",
]

Notify = Callable[[str], None]

_log = logging.getLogger(__name__)


def check_requests(requests: Sequence[RunRequest]) -> None:
    """Raise at once what would otherwise fail every single episode.

    Args:
        requests: What will run, on one or several backends.

    Raises:
        UnknownNameError: No such backend.
        MissingExtraError: The engine of a backend is not installed.
        ParameterError: No experiment takes the parameters, or a backend does not take the settings.
        AssetError: The asset cannot be used.
        UnsupportedSceneError: The asset is a model file that a backend does not read.
    """
    usable: dict[str, list[tuple[RunRequest, Experiment]]] = {request.backend: [] for request in requests}
    refused = None
    for request in requests:
        try:
            usable[request.backend].append((request, request.experiment()))
        except ParameterError as error:
            refused = error
    if refused is not None and not any(usable.values()):
        raise refused
    for name, pairs in usable.items():
        engine = backend_for(name, pairs[0][1].model_file if pairs else None)
        for request, experiment in pairs[:1]:
            if request.asset is not None:
                check_support(experiment, name)
        able = next(((r, e) for r, e in pairs if r.settings and engine.supports(e.scene)), None)
        if able is not None:
            engine.build(able[1].scene, able[0].settings).close()


def run_many(
    requests: Iterable[RunRequest],
    *,
    out: Path | None = None,
    resume: bool = False,
    notify: Notify = _log.warning,
) -> Iterator[Result]:
    """Run episodes one after another, repeats together; each result is on disk before it is yielded.

    One that is declined or fails is yielded with its `error`, and not written; the others go on.

    Args:
        requests: What to run, in order. Repeats without a jitter start from the default `Jitter`.
        out: Folder for the result files, created if need be; None writes none.
        resume: Take results that `out` has already, where they are of the same request, task file, asset, imported
            trials and versions of engine and gauge-envs. A damaged one is moved aside, to `*.damaged`, and run again.
        notify: Takes one sentence for each file that `resume` could not take.

    Returns:
        Iterator that runs the next episode when asked for it.

    Raises:
        ResultFileError: `out` cannot be written; raised before anything runs.
        AssetError: An asset or an experiment file cannot be used; raised before anything runs.
        ParameterError: `imported` was asked for, and nothing was imported; raised before anything runs.
    """
    jittered_requests = [
        replace(request, jitter=Jitter()) if request.repeats > 1 and request.jitter is None else request
        for request in requests
    ]
    planned = [(request, request.calibrated_experiment()) for request in jittered_requests]
    if out is not None:
        _check_writable(out)

    def results() -> Iterator[Result]:
        for request, known in planned:
            empty = [planned_result(request, known, seed=request.seed + number) for number in range(request.repeats)]
            files = [None if out is None else out / result_file_name(one) for one in empty]
            found = [
                _earlier(file, one, notify) if resume and file is not None else None
                for file, one in zip(files, empty, strict=True)
            ]
            if all(found):
                yield from (result for result in found if result)
                continue
            for result, file in zip(_attempt(request, empty), files, strict=True):
                if file is not None and result.error is None:
                    write_result(result, file)
                yield result

    return results()


def _attempt(request: RunRequest, empty: Sequence[Result]) -> list[Result]:
    """Results of a request's episodes; those that were declined or failed carry the reason."""
    try:
        experiment = request.experiment()
        if request.jitter is not None:
            jittered(experiment.scene, request.jitter, seed=0)
    except ParameterError as error:
        return [replace(one, outcome=Outcome.DECLINED, error=str(error)) for one in empty]
    except GaugeError as error:
        return [replace(one, error=str(error)) for one in empty]
    try:
        return [run_episode(request)] if request.jitter is None else run_repeats(request)
    except UnsupportedSceneError as error:
        return [replace(one, outcome=Outcome.DECLINED, error=str(error)) for one in empty]
    except GaugeError as error:
        return [replace(one, error=str(error)) for one in empty]
    except Exception as error:  # Engines raise anything, and one episode must not cost the others.
        _log.exception("%s on %s", empty[0].id, request.backend)
        return [replace(one, error=f"{type(error).__name__}: {error}") for one in empty]


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
