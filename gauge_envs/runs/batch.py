"""Runs of many episodes: each result is written at once, and an interrupted run can resume."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Generator, Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from gauge_envs.backends.registry import shares_worlds
from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.files import os_errors
from gauge_envs.runs.episodes import results_without_run
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.runs.workers import (
    TIME_LIMIT_S,
    Limits,
    ProcessWorker,
    call_engine,
    run_tasks,
)

Notify = Callable[[str], None]

_log = logging.getLogger(__name__)


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
) -> Generator[Result, None, None]:
    """Run episodes, and yield the results in the order of the requests, each after it is written.

    Repeats run together if the engine advances them in one simulation, else one after another.

    An unsupported or failed episode is yielded with its `error` and is not written. The other episodes continue.

    Args:
        requests: The runs in order. Repeats without a jitter get the default `Jitter`.
        out: Folder for the result files, created if it does not exist; None writes no files.
        resume: Use a result in `out` if its request, task file, asset, imported trials and versions of engine and
            gauge-envs are the same. The episode of a damaged file runs again.
        notify: Gets one sentence for each file that `resume` could not use.
        isolate: True runs each episode, or repeats that run together, in its own process. None runs engines outside
            this package in another process, which is replaced after a crash. False runs all in this process. The
            results have the same bits.
        time_limit_s: Time limit of an episode, or of repeats that run together, in another process [s].
        memory_limit_gb: Limit of the memory of another process [GB], on Linux; None: no limit.
        jobs: Number of parallel episodes, each in another process if more than 1. The results have the same bits.

    Returns:
        Iterator over the results. With one job, it runs an episode when its result is requested.
    """
    limits = Limits(time_limit_s, memory_limit_gb, is_per_request=bool(isolate))
    is_parallel = jobs > 1
    workers = [
        ProcessWorker(
            limits,
            isolate=True if is_parallel else isolate,
            single_thread=is_parallel,
        )
        for _ in range(jobs)
    ]
    repeated = [replace(request, jitter=request.scatter) for request in requests]
    for request in repeated:
        # Raise the error of an unknown experiment before the first run.
        request.published_experiment()
    is_here = isolate is False and not is_parallel
    together = {
        backend: _run_together(backend, is_here)
        for backend in {run.backend for run in repeated if run.repeats > 1}
    }
    runs = [
        part
        for request in repeated
        for part in request.parts((), together=together.get(request.backend, False))
    ]
    if out is not None:
        check_writable(out)

    def results_of(worker: ProcessWorker, request: RunRequest) -> list[Result]:
        if out is None:
            return worker.run(request)
        planned = dict(zip(request.seeds, results_without_run(request), strict=True))
        files = {seed: out / result_file_name(planned[seed]) for seed in planned}
        results: dict[int, Result] = {}
        for seed in filter(lambda seed: resume and files[seed].exists(), files):
            try:
                results[seed] = _earlier_result(files[seed], planned[seed], worker)
            except ResultFileError as error:
                notify(f"{error}; run again")
        for part in request.parts(results, together=True):
            for seed, result in zip(part.seeds, worker.run(part), strict=True):
                if result.error is None:
                    write_result(result, files[seed])
                results[seed] = result
        return [results[seed] for seed in files]

    return run_tasks(runs, workers, results_of)


def _run_together(backend: str, is_here: bool) -> bool:
    """Return whether an engine advances repeats in one simulation; False for an engine that cannot be asked."""
    isolate = False if is_here else None
    with suppress(GaugeError):
        return call_engine(backend, shares_worlds, backend, isolate=isolate)
    return False


def check_writable(out: Path) -> None:
    """Create a folder for results if it does not exist, and check that it is writable."""
    probe = out / f".probe.{os.getpid()}.tmp"
    with os_errors(
        lambda cause: ResultFileError(
            f"{out}: results cannot be written there: {cause}"
        )
    ):
        out.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()


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


def _earlier_result(file: Path, wanted: Result, worker: ProcessWorker) -> Result:
    """Return the result in a file.

    Args:
        file: The file.
        wanted: The result without its run.
        worker: Worker that knows the versions of the engine.

    Raises:
        ResultFileError: The file is damaged, or is of another episode or of other versions.
    """
    earlier = load_result(file)
    for key in SAME_EPISODE:
        if getattr(earlier, key) != getattr(wanted, key):
            raise ResultFileError(f"{file}: {key} differs from the request")
    try:
        installed = worker.versions(str(wanted.backend))
    except GaugeError as error:
        raise ResultFileError(
            f"{file}: the versions of {wanted.backend} are unknown: {error}"
        ) from error
    if difference := earlier.version_difference(
        installed | {"gauge-envs": wanted.versions["gauge-envs"]}
    ):
        raise ResultFileError(f"{file}: {difference}")
    return earlier
