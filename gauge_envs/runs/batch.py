"""Runs of many episodes: each result is written when it is complete, and an interrupted run can be resumed."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue

from gauge_envs.backends import backend_for, engine_call, is_bundled, support_of, versions_of
from gauge_envs.envs.arguments import check_support, start_of
from gauge_envs.errors import GaugeError, ParameterError, ResultFileError, UnsupportedSceneError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import os_errors
from gauge_envs.runs.episodes import planned_result, run_episodes
from gauge_envs.runs.isolation import TIME_LIMIT_S, CrashError, Worker
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.runs.result_file import load_result, result_file_name, write_result
from gauge_envs.scene.jitter import jittered

Notify = Callable[[str], None]

LEFTOVER_AGE_S = 3600.0
"""Age from which a temporary file belongs to no run that goes on [s]."""

CHECK_LIMIT_S = 120.0
"""Time limit of the check of a request in another process [s]."""

CLOSE_LOOK_S = 0.2
"""Time between two attempts to end the processes of an interrupted run [s]."""

_log = logging.getLogger(__name__)


def check_requests(requests: Sequence[RunRequest], *, isolate: bool | None = False) -> None:
    """Raise an error that would otherwise fail every episode of a run.

    Args:
        requests: The run, on one or several backends.
        isolate: As for `run_many`. An engine that crashes here fails each of its episodes later.
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
        if request.settings and support_of(name, experiment.scene, experiment.model_file):
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
            package share another process, which is replaced when it crashes. With False, all run in this process,
            except those of an engine outside this package that raised an unexpected error before. The results have
            the same bits.
        time_limit_s: Time limit of a request that runs in another process, with all its repeats [s].
        memory_limit_gb: Limit of the resident memory of another process [GB], on Linux; None: no limit.
        jobs: Number of requests that run at once. More than one run in as many other processes, with the same bits.

    Returns:
        Iterator over the results. With one job it runs an episode when its result is asked for.
    """
    is_shared = jobs > 1
    workers = [Worker(time_limit_s, memory_limit_gb, single_thread=is_shared) for _ in range(jobs)]
    place = _Place(isolate, workers)
    runs = [(replace(request, jitter=request.scatter), request.calibrated_experiment()) for request in requests]
    if out is not None:
        check_writable(out)
    return _results(runs, place, out, notify if resume else None)


def _results(
    runs: Sequence[tuple[RunRequest, Experiment]], place: _Place, out: Path | None, notify: Notify | None
) -> Iterator[Result]:
    """Yield the results of requests.

    Args:
        runs: Requests with the jitter that applies, and their calibrated experiments.
        place: Choice of the process.
        out: Folder of the result files, or None.
        notify: Receives a sentence for each file that cannot be taken; None takes no files.
    """
    if place.job_count == 1:
        try:
            for run in runs:
                yield from _results_of(run, place, out, notify)
        finally:
            place.close()
        return
    with ThreadPoolExecutor(place.job_count) as threads:
        waiting = [threads.submit(_results_of, run, place, out, notify) for run in runs]
        try:
            for one in waiting:
                yield from one.result()
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            # A thread may just have started the process of its next request.
            while not all(one.done() for one in waiting):
                place.close()
                wait(waiting, CLOSE_LOOK_S)
            place.close()


def _results_of(
    run: tuple[RunRequest, Experiment], place: _Place, out: Path | None, notify: Notify | None
) -> list[Result]:
    """Return the results of a request: those in a folder if all of them are there, else new ones, which are written."""
    request, calibrated = run
    planned = _planned(request, calibrated)
    files = [None if out is None else out / result_file_name(one) for one in planned]
    taken = [
        _earlier_result(file, one, place, notify)
        for file, one in zip(files, planned, strict=True)
        if file is not None and notify is not None
    ]
    if taken and None not in taken:
        return [one for one in taken if one is not None]
    results = place.episodes(request, planned)
    for result, file in zip(results, files, strict=True):
        if file is not None and result.error is None:
            write_result(result, file)
    return results


class _Place:
    """Choice of the process in which the episodes of a request run.

    Args:
        isolate: As for `run_many`.
        workers: The other processes, one for each job. With several, no episode runs in this process.
    """

    def __init__(self, isolate: bool | None, workers: Sequence[Worker]) -> None:
        self._isolate = isolate
        self._workers = workers
        self._free: SimpleQueue[Worker] = SimpleQueue()
        for worker in workers:
            self._free.put(worker)
        self._unsafe: set[str] = set()

    @property
    def job_count(self) -> int:
        """Number of requests that run at once."""
        return len(self._workers)

    @contextmanager
    def _worker(self) -> Iterator[Worker]:
        """Take one of the other processes, and wait until one is free."""
        worker = self._free.get()
        try:
            yield worker
        finally:
            self._free.put(worker)

    def versions(self, backend: str) -> dict[str, str]:
        """Return the versions of an engine's packages."""
        if not self._is_isolated(backend):
            return versions_of(backend)
        with self._worker() as worker:
            return worker.call(versions_of, backend)

    def episodes(self, request: RunRequest, planned: Sequence[Result]) -> list[Result]:
        """Return the results of a request; those that were declined or failed hold the reason."""
        if self.job_count == 1 and not self._is_isolated(request.backend):
            results, is_safe = attempt(request, planned)
            if not is_safe:
                self._unsafe.add(request.backend)
            return results
        with self._worker() as worker:
            try:
                return worker.call(attempt, request, planned)[0]
            except GaugeError as error:
                return not_run(planned, Outcome.FAILED, str(error))
            finally:
                if self._isolate:
                    worker.close()

    def close(self) -> None:
        """End the other processes."""
        for worker in self._workers:
            worker.close()

    def _is_isolated(self, backend: str) -> bool:
        if self._isolate is not None:
            return self._isolate or (backend in self._unsafe and not is_bundled(backend))
        return not is_bundled(backend)


def planned_results(request: RunRequest) -> list[Result]:
    """Return the results of a request that has not run, in the order of their seeds.

    Args:
        request: The request, with the jitter that applies.
    """
    return _planned(request, request.calibrated_experiment())


def _planned(request: RunRequest, calibrated: Experiment) -> list[Result]:
    seeds = range(request.seed, request.seed + request.repeats)
    return [
        planned_result(request, calibrated, seed=seed, jitter=start_of(calibrated, request.jitter, seed=seed))
        for seed in seeds
    ]


def not_run(planned: Sequence[Result], outcome: Outcome, reason: str) -> list[Result]:
    """Return planned results with an outcome and its reason."""
    return [replace(one, outcome=outcome, error=reason) for one in planned]


def attempt(request: RunRequest, planned: Sequence[Result]) -> tuple[list[Result], bool]:
    """Run the episodes of a request; whatever the engine raises becomes the reason of a result.

    Args:
        request: The request.
        planned: Its results before it runs.

    Returns:
        The results, and whether the engine raised no unexpected error. Results of episodes that were declined or failed
        hold the reason.
    """
    try:
        experiment = request.experiment()
        if request.jitter is not None:
            jittered(experiment.scene, request.jitter, seed=0)
    except GaugeError as error:
        outcome = Outcome.DECLINED if isinstance(error, ParameterError) else Outcome.FAILED
        return not_run(planned, outcome, str(error)), True
    try:
        return run_episodes(request), True
    except GaugeError as error:
        outcome = Outcome.DECLINED if isinstance(error, UnsupportedSceneError) else Outcome.FAILED
        return not_run(planned, outcome, str(error)), True
    except KeyboardInterrupt:
        raise
    # An engine may raise any error, SystemExit included, and the other episodes must still run.
    except BaseException as error:
        _log.exception("%s on %s", planned[0].id, request.backend)
        return not_run(planned, Outcome.FAILED, f"{type(error).__name__}: {error}".removesuffix(": ")), False


def check_writable(out: Path) -> None:
    """Create a folder for results if it does not exist, and remove what killed runs left half-written in it."""
    probe = out / f".probe.{os.getpid()}.tmp"
    with os_errors(lambda cause: ResultFileError(f"{out}: results cannot be written there: {cause}")):
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


def _earlier_result(file: Path, wanted: Result, place: _Place, notify: Notify) -> Result | None:
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
        engine = {} if wanted.backend is None else place.versions(wanted.backend)
    except GaugeError as error:
        notify(f"{file}: the versions of {wanted.backend} are unknown: {error}; run again")
        return None
    for package, now in {**engine, "gauge-envs": wanted.versions["gauge-envs"]}.items():
        if found.versions.get(package) != now:
            notify(f"{file}: made with {package} {found.versions.get(package)}, not {now}; run again")
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
