"""Runs of many episodes: each result is written when it is complete, and an interrupted run can be resumed."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from gauge_envs.backends import backend_for, engine_call, is_bundled, support_of
from gauge_envs.envs.arguments import check_support
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import os_errors
from gauge_envs.runs.episodes import planned_results
from gauge_envs.runs.isolation import TIME_LIMIT_S, CrashError, Worker
from gauge_envs.runs.pool import Limits, LocalWorker, ProcessWorker, run_tasks
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result

Notify = Callable[[str], None]

LEFTOVER_AGE_S = 3600.0
"""Age from which a temporary file belongs to no run that goes on [s]."""

CHECK_LIMIT_S = 120.0
"""Time limit of the check of a request in another process [s]."""

_log = logging.getLogger(__name__)


def check_requests(
    requests: Sequence[RunRequest], *, isolate: bool | None = False
) -> None:
    """Raise an error that would otherwise fail every episode of a run.

    Args:
        requests: The run, on one or several backends.
        isolate: As for `run_many`. An engine that crashes here fails each of its episodes later.
    """
    by_backend: dict[str, list[tuple[RunRequest, Experiment]]] = {
        request.backend: [] for request in requests
    }
    refused = None
    for request in requests:
        try:
            by_backend[request.backend].append((request, request.experiment()))
        except ParameterError as error:
            refused = error
    if refused is not None and not any(by_backend.values()):
        raise refused
    for name, runs in by_backend.items():
        if isolate or (isolate is None and not is_bundled(name)):
            with Worker(CHECK_LIMIT_S) as worker, suppress(CrashError):
                worker.call(_check_backend, name, runs)
        else:
            _check_backend(name, runs)


def _check_backend(name: str, runs: Sequence[tuple[RunRequest, Experiment]]) -> None:
    """Raise an error if a backend does not exist, cannot read the asset, or does not take the settings."""
    engine = backend_for(name, runs[0][1].model_file if runs else None)
    if runs and runs[0][0].asset is not None:
        check_support(runs[0][1], name)
    for request, experiment in runs:
        if request.settings and support_of(
            name, experiment.scene, experiment.model_file
        ):
            with engine_call(name, "build"):
                engine.build(experiment.scene, request.settings).close()
            return


def run_many(
    requests: Iterable[RunRequest],
    *,
    out: Path | None = None,
    resume: bool = False,
    notify: Notify = _log.warning,
    isolate: bool | None = False,
    time_limit_s: float = TIME_LIMIT_S,
    memory_limit_gb: float | None = None,
    jobs: int = 1,
) -> Iterator[Result]:
    """Run episodes, repeats together; each result is written before it is yielded, in the order of the requests.

    An episode that is declined or fails is yielded with its `error` and is not written. The others continue.

    Args:
        requests: The runs, in order. Repeats without a jitter have the default `Jitter`.
        out: Folder for the result files, created if it does not exist; None writes no files.
        resume: Take a result from `out` if it has the same request, task file, asset, imported trials and versions of
            engine and gauge-envs. A damaged file is renamed to `*.damaged`, and its episode runs again.
        notify: Receives one sentence for each file that `resume` could not take.
        isolate: With True, each request runs in a process of its own. With None, requests of engines outside this
            package run in another process, which is replaced when it crashes. With False, all run in this process. The
            results have the same bits.
        time_limit_s: Time limit of a request that runs in another process, with all its repeats [s].
        memory_limit_gb: Limit of the resident memory of another process [GB], on Linux; None: no limit.
        jobs: Number of requests that run at once. More than one run in as many other processes, with the same bits.

    Returns:
        Iterator over the results. With one job it runs an episode when its result is asked for.
    """
    limits = Limits(time_limit_s, memory_limit_gb, isolate=bool(isolate))
    workers: list[LocalWorker | ProcessWorker]
    workers = (
        [LocalWorker(limits, isolate=isolate)]
        if jobs == 1
        else [ProcessWorker(limits) for _ in range(jobs)]
    )
    tasks = [
        _Task(number, replace(request, jitter=request.scatter))
        for number, request in enumerate(requests)
    ]
    for task in tasks:
        # An experiment that does not exist is an error of the caller.
        task.request.calibrated_experiment()
    if out is not None:
        check_writable(out)
    return _in_order(
        run_tasks(
            tasks,
            workers,
            partial(_results_of, out=out, notify=notify if resume else None),
        )
    )


@dataclass(frozen=True)
class _Task:
    """A request and its number."""

    number: int
    request: RunRequest

    @property
    def backend(self) -> str:
        """Name of the engine."""
        return self.request.backend


def _in_order(
    done: Generator[tuple[int, list[Result]], None, None],
) -> Iterator[Result]:
    """Yield the results of requests in the order of their numbers."""
    complete: dict[int, list[Result]] = {}
    next_number = 0
    with closing(done):
        for number, results in done:
            complete[number] = results
            while next_number in complete:
                yield from complete.pop(next_number)
                next_number += 1


def _results_of(
    worker: LocalWorker | ProcessWorker,
    task: _Task,
    *,
    out: Path | None,
    notify: Notify | None,
) -> tuple[int, list[Result]]:
    """Return the results of a request: those in a folder if all of them are there, else new ones, which are written.

    Args:
        worker: Runs the request.
        task: The request.
        out: Folder of the result files, or None.
        notify: Receives a sentence for each file that cannot be taken; None takes no files.
    """
    if out is None:
        return task.number, worker.run(task.request)
    planned = planned_results(task.request)
    files = [out / result_file_name(one) for one in planned]
    if notify is not None:
        earlier = [
            _earlier_result(file, one, worker, notify)
            for file, one in zip(files, planned, strict=True)
        ]
        taken = [result for result in earlier if result is not None]
        if len(taken) == len(files):
            return task.number, taken
    results = worker.run(task.request)
    for result, file in zip(results, files, strict=True):
        if result.error is None:
            write_result(result, file)
    return task.number, results


def check_writable(out: Path) -> None:
    """Create a folder for results if it does not exist, and remove what killed runs left half-written in it."""
    probe = out / f".probe.{os.getpid()}.tmp"
    with os_errors(
        lambda cause: ResultFileError(
            f"{out}: results cannot be written there: {cause}"
        )
    ):
        out.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
        for file in out.glob(".*.json.*.tmp"):
            with suppress(OSError):
                if time.time() - file.stat().st_mtime > LEFTOVER_AGE_S:
                    file.unlink()


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


def _earlier_result(
    file: Path, wanted: Result, worker: LocalWorker | ProcessWorker, notify: Notify
) -> Result | None:
    """Return the result in a file if it is of the same episode and versions, or None."""
    if not file.exists():
        return None
    try:
        found = load_result(file)
    except ResultFileError as error:
        notify(f"{error}; moved to {move_aside(file).name} and run again")
        return None
    for key in SAME_EPISODE:
        if getattr(found, key) != getattr(wanted, key):
            notify(f"{file}: {key} differs from the request; run again")
            return None
    try:
        engine = {} if wanted.backend is None else worker.versions(wanted.backend)
    except GaugeError as error:
        notify(
            f"{file}: the versions of {wanted.backend} are unknown: {error}; run again"
        )
        return None
    for package, now in {**engine, "gauge-envs": wanted.versions["gauge-envs"]}.items():
        if found.versions.get(package) != now:
            notify(
                f"{file}: made with {package} {found.versions.get(package)}, not {now}; run again"
            )
            return None
    return found


def move_aside(file: Path) -> Path:
    """Rename a damaged file to a name that is free, and return that."""
    aside = file.with_name(f"{file.name}.damaged")
    count = 1
    while aside.exists():
        count += 1
        aside = file.with_name(f"{file.name}.damaged-{count}")
    return file.replace(aside)
