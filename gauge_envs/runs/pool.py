"""Workers that run requests sequentially, and a pool of parallel workers.

The same function runs all episodes, so results have the same bits in this process, in many processes and on other
machines.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from gauge_envs.backends import is_bundled, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.runs.episodes import results_without_run, run_request
from gauge_envs.runs.isolation import TIME_LIMIT_S, Worker
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result


@dataclass(frozen=True)
class Limits:
    """Limits of the processes of workers.

    Attributes:
        time_limit_s: Time limit of a request, with all its repeats [s].
        memory_limit_gb: Limit of the memory of a process [GB], on Linux; None: no limit.
        isolate: Whether each request has its own process.
    """

    time_limit_s: float = TIME_LIMIT_S
    memory_limit_gb: float | None = None
    isolate: bool = False


class RequestWorker(Protocol):
    """Worker that runs requests sequentially."""

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request in the order of its seeds; a result without a trajectory has a reason.

        Raises:
            concurrent.futures.CancelledError: `kill` ended the worker.
        """

    def close(self) -> None:
        """End the waiting worker."""

    def kill(self) -> None:
        """Kill the worker and reject later requests, also while another thread waits in `run`."""


class ProcessWorker:
    """Worker in another process for one engine; the next engine gets a new process.

    Args:
        limits: Limits of the process.
        apart: Whether engines run in the other process; None only for engines of other packages.
        single_thread: Whether libraries use one thread; for processes that share the cores.
    """

    def __init__(
        self, limits: Limits, *, apart: bool | None = True, single_thread: bool = True
    ) -> None:
        self._process = Worker(
            limits.time_limit_s, limits.memory_limit_gb, single_thread=single_thread
        )
        self._limits = limits
        self._apart = apart
        self._backend = ""

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request; an episode that ends the process is `failed` with the cause."""
        limit_gb = self._limits.memory_limit_gb
        try:
            results = self._call(request.backend, run_request, request)
            # Memory that an engine keeps after a failure would count against the limit of the next episode.
            is_lost = (
                limit_gb is not None
                and self._is_apart(request.backend)
                and any(result.outcome is Outcome.FAILED for result in results)
            )
        except GaugeError as error:
            results = results_without_run(request, Outcome.FAILED, str(error))
            is_lost = True
        if is_lost or self._limits.isolate:
            self._process.close()
        if is_lost and request.repeats > 1:
            # Run each repeat alone, so that only the repeat that ended the process is lost.
            alone = [replace(request, seed=seed, repeats=1) for seed in request.seeds]
            return [result for repeat in alone for result in self.run(repeat)]
        if is_lost and limit_gb is not None:
            note = f" (memory limit: {limit_gb:g} GB)"
            return [
                replace(result, error=f"{result.error}{note}") for result in results
            ]
        return results

    def versions(self, backend: str) -> dict[str, str]:
        """Return the versions of an engine's packages."""
        return self._call(backend, versions_of, backend)

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def kill(self) -> None:
        """Kill the process and reject later requests."""
        self._process.kill()

    def _is_apart(self, backend: str) -> bool:
        return not is_bundled(backend) if self._apart is None else self._apart

    def _call(self, backend: str, function: Callable[..., Any], argument: Any) -> Any:
        """Call a function in the process of an engine, and return its result."""
        if not self._is_apart(backend):
            return function(argument)
        if backend != self._backend:
            self._process.close()
            self._backend = backend
        return self._process.call(function, argument)


TaskT = TypeVar("TaskT")
WorkerT = TypeVar("WorkerT", bound=RequestWorker)
Done = TypeVar("Done")


def run_tasks(
    tasks: Sequence[TaskT],
    workers: Sequence[WorkerT],
    perform: Callable[[WorkerT, TaskT], Done],
) -> Generator[Done, None, None]:
    """Yield the result of a function for each task, in the order of the tasks.

    A single worker runs a task when its result is requested; several workers run in threads. Closing the iterator
    before its end, as by Ctrl-C, kills the workers.

    Args:
        tasks: The tasks.
        workers: The workers.
        perform: Function that runs a task on a worker and writes its results; its error ends the run.
    """
    idle: SimpleQueue[WorkerT] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def done(task: TaskT) -> Done:
        worker = idle.get()
        try:
            return perform(worker, task)
        finally:
            idle.put(worker)

    if len(workers) == 1:
        try:
            yield from map(done, tasks)
        finally:
            workers[0].close()
        return
    threads = ThreadPoolExecutor(len(workers))
    try:
        futures = deque(threads.submit(done, task) for task in tasks)
        while futures:
            yield futures.popleft().result()
        # Processes take time to end, so end them in parallel.
        for worker in workers:
            threads.submit(worker.close)
    except BaseException:
        threads.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.kill()
        raise
    finally:
        threads.shutdown()
        for worker in workers:
            worker.close()
