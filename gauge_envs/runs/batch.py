"""Runs of many episodes: each result is written when it is complete, and an interrupted run can be resumed."""

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

__all__ = ["check_requests", "run_many"]

Notify = Callable[[str], None]

_log = logging.getLogger(__name__)


def check_requests(requests: Sequence[RunRequest]) -> None:
    """Raise an error that would otherwise fail every episode of a run.

    Args:
        requests: The run, on one or several backends.

    Raises:
        UnknownNameError: No such backend.
        MissingExtraError: The engine of a backend is not installed.
        ParameterError: No experiment takes the parameters, or a backend does not take the settings.
        AssetError: The asset cannot be used.
        UnsupportedSceneError: The asset is a model file that a backend does not read.
    """
    by_backend: dict[str, list[tuple[RunRequest, Experiment]]] = {request.backend: [] for request in requests}
    refused = None
    for request in requests:
        try:
            by_backend[request.backend].append((request, request.experiment()))
        except ParameterError as error:
            refused = error
    if refused is not None and not any(by_backend.values()):
        raise refused
    for name, runs in by_backend.items():
        _check_backend(name, runs)


def _check_backend(name: str, runs: Sequence[tuple[RunRequest, Experiment]]) -> None:
    """Raise an error if a backend does not exist, cannot read the asset, or does not take the settings."""
    engine = backend_for(name, runs[0][1].model_file if runs else None)
    if runs and runs[0][0].asset is not None:
        check_support(runs[0][1], name)
    for request, experiment in runs:
        if request.settings and engine.supports(experiment.scene):
            engine.build(experiment.scene, request.settings).close()
            return


def run_many(
    requests: Iterable[RunRequest],
    *,
    out: Path | None = None,
    resume: bool = False,
    notify: Notify = _log.warning,
) -> Iterator[Result]:
    """Run episodes one after another, repeats together; each result is written before it is yielded.

    An episode that is declined or fails is yielded with its `error` and is not written. The others continue.

    Args:
        requests: The runs, in order. Repeats without a jitter have the default `Jitter`.
        out: Folder for the result files, created if it does not exist; None writes no files.
        resume: Take a result from `out` if it has the same request, task file, asset, imported trials and versions of
            engine and gauge-envs. A damaged file is renamed to `*.damaged`, and its episode runs again.
        notify: Receives one sentence for each file that `resume` could not take.

    Returns:
        Iterator over the results; it runs an episode when its result is asked for.

    Raises:
        ResultFileError: `out` cannot be written; raised before anything runs.
        AssetError: An asset or an experiment file cannot be used; raised before anything runs.
        ParameterError: A request has `imported`, but nothing was imported; raised before anything runs.
    """
    runs = [
        _Run(replace(request, jitter=Jitter()) if request.repeats > 1 and request.jitter is None else request)
        for request in requests
    ]
    if out is not None:
        _check_writable(out)
    return (result for run in runs for result in run.results(out, notify=notify if resume else None))


class _Run:
    """The episodes of one request.

    Args:
        request: The request, with the jitter that applies.
    """

    def __init__(self, request: RunRequest) -> None:
        self._request = request
        self._calibrated = request.calibrated_experiment()

    def results(self, out: Path | None, *, notify: Notify | None) -> Iterator[Result]:
        """Yield the results: those in a folder if all are there, else new ones.

        Args:
            out: Folder of the result files, or None.
            notify: Receives a sentence for each file that cannot be taken; None takes no files.
        """
        request = self._request
        planned = [
            planned_result(request, self._calibrated, seed=request.seed + number, jitter=request.jitter)
            for number in range(request.repeats)
        ]
        if out is None:
            yield from self._run(planned)
            return
        files = [out / result_file_name(one) for one in planned]
        if notify is not None:
            found = [_earlier_result(file, one, notify) for file, one in zip(files, planned, strict=True)]
            taken = [result for result in found if result is not None]
            if len(taken) == len(planned):
                yield from taken
                return
        for result, file in zip(self._run(planned), files, strict=True):
            if result.error is None:
                write_result(result, file)
            yield result

    def _run(self, planned: Sequence[Result]) -> list[Result]:
        """Return the results of the episodes; those that were declined or failed hold the reason."""
        request = self._request

        def not_run(outcome: Outcome, reason: str) -> list[Result]:
            return [replace(one, outcome=outcome, error=reason) for one in planned]

        try:
            experiment = request.experiment()
            if request.jitter is not None:
                jittered(experiment.scene, request.jitter, seed=0)
        except GaugeError as error:
            outcome = Outcome.DECLINED if isinstance(error, ParameterError) else Outcome.FAILED
            return not_run(outcome, str(error))
        try:
            return [run_episode(request)] if request.jitter is None else run_repeats(request)
        except GaugeError as error:
            outcome = Outcome.DECLINED if isinstance(error, UnsupportedSceneError) else Outcome.FAILED
            return not_run(outcome, str(error))
        except Exception as error:  # An engine may raise any error, and the other episodes must still run.
            _log.exception("%s on %s", planned[0].id, request.backend)
            return not_run(Outcome.FAILED, f"{type(error).__name__}: {error}")


def _check_writable(out: Path) -> None:
    probe = out / f".probe.{os.getpid()}.tmp"
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise ResultFileError(f"{out}: results cannot be written there: {error.strerror or error}") from error


SAME_EPISODE = (
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
"""Fields of a result that identify its episode."""


def _earlier_result(file: Path, wanted: Result, notify: Notify) -> Result | None:
    """Return the result in a file if it is of the same episode and versions, or None."""
    if not file.exists():
        return None
    try:
        found = load_result(file)
    except ResultFileError as error:
        notify(f"{error}; moved to {_move_aside(file).name} and run again")
        return None
    for key in SAME_EPISODE:
        if getattr(found, key) != getattr(wanted, key):
            notify(f"{file}: {key} differs from the request; run again")
            return None
    engine = {} if wanted.backend is None else find_backend(wanted.backend).versions()
    for package, now in {**engine, "gauge-envs": wanted.versions["gauge-envs"]}.items():
        if found.versions.get(package) != now:
            notify(f"{file}: made with {package} {found.versions.get(package)}, not {now}; run again")
            return None
    return found


def _move_aside(file: Path) -> Path:
    """Rename a damaged file to a name that is free, and return that."""
    aside = file.with_name(f"{file.name}.damaged")
    count = 1
    while aside.exists():
        count += 1
        aside = file.with_name(f"{file.name}.damaged-{count}")
    return file.replace(aside)
