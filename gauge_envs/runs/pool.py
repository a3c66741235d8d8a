"""Workers that run requests one after another, and the loop that gives them their tasks.

The same function runs the episodes everywhere, so results have the same bits in this process, in many and on other
machines.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import Generic, Protocol, TypeVar

from gauge_envs.backends import is_bundled, versions_of
from gauge_envs.errors import GaugeError
from gauge_envs.runs.episodes import not_run, planned_results, run_request
from gauge_envs.runs.isolation import TIME_LIMIT_S, Worker
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome, Result

CLOSE_INTERVAL_S = 0.2
"""Time between two attempts to end the workers of an interrupted run [s]."""


class WorkerClosedError(GaugeError, RuntimeError):
    """A worker was closed while it ran a request, which has no result then."""


@dataclass(frozen=True)
class Limits:
    """Limits of the processes of workers.

    Attributes:
        time_limit_s: Time limit of a request, with all its repeats [s].
        memory_limit_gb: Limit of the resident memory of a process [GB], on Linux; None: no limit.
        isolate: Whether each request has a process of its own.
    """

    time_limit_s: float = TIME_LIMIT_S
    memory_limit_gb: float | None = None
    isolate: bool = False


class TaskWorker(Protocol):
    """A place where requests run one after another."""

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request, in the order of its seeds; those without a trajectory hold the reason."""

    def close(self) -> None:
        """End the worker for good, also while another thread waits in `run`."""


class ProcessWorker:
    """A worker in another process, which serves one engine; the next engine gets a new process.

    Args:
        limits: Limits of the process.
        single_thread: Whether libraries compute with one thread; for processes that share the cores.
    """

    def __init__(self, limits: Limits, *, single_thread: bool = True) -> None:
        self._process = Worker(
            limits.time_limit_s, limits.memory_limit_gb, single_thread=single_thread
        )
        self._isolate = limits.isolate
        self._backend = ""
        self._is_closed = False

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request; an episode that ends the process is `failed`, with the cause."""
        self._serve(request.backend)
        try:
            return self._process.call(run_request, request)
        except GaugeError as error:
            if self._is_closed:
                raise WorkerClosedError("the worker is closed") from error
            if request.repeats == 1:
                return not_run(planned_results(request), Outcome.FAILED, str(error))
        finally:
            if self._isolate:
                self._process.close()
        # One of the repeats ended the process. Each runs on its own, so that only that one is lost.
        results: list[Result] = []
        for seed in range(request.seed, request.seed + request.repeats):
            results += self.run(replace(request, seed=seed, repeats=1))
        return results

    def versions(self, backend: str) -> dict[str, str]:
        """Return the versions of an engine's packages."""
        self._serve(backend)
        return self._process.call(versions_of, backend)

    def close(self) -> None:
        """End the process for good."""
        self._is_closed = True
        self._process.close()

    def _serve(self, backend: str) -> None:
        """Let the process serve an engine."""
        if self._is_closed:
            raise WorkerClosedError("the worker is closed")
        if backend != self._backend:
            self._process.close()
            self._backend = backend


class LocalWorker:
    """A worker in this process, but for engines that have to run in another one.

    Args:
        limits: Limits of the other process.
        isolate: Whether engines run in another process; None: those of other packages alone.
    """

    def __init__(self, limits: Limits, *, isolate: bool | None) -> None:
        self._isolate = isolate
        self._process = ProcessWorker(limits, single_thread=False)

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request."""
        return (
            self._process.run(request)
            if self._is_isolated(request.backend)
            else run_request(request)
        )

    def versions(self, backend: str) -> dict[str, str]:
        """Return the versions of an engine's packages."""
        return (
            self._process.versions(backend)
            if self._is_isolated(backend)
            else versions_of(backend)
        )

    def close(self) -> None:
        """End the other process for good."""
        self._process.close()

    def _is_isolated(self, backend: str) -> bool:
        return not is_bundled(backend) if self._isolate is None else self._isolate


class Task(Protocol):
    """Work for a worker."""

    @property
    def backend(self) -> str:
        """Name of the engine."""


TaskT = TypeVar("TaskT", bound=Task)
WorkerT = TypeVar("WorkerT", bound=TaskWorker)
Done = TypeVar("Done")


class TaskQueue(Generic[TaskT]):
    """Tasks that wait, in their order for each engine. Its methods may be called from any thread."""

    def __init__(self, tasks: Iterable[TaskT]) -> None:
        self._waiting: dict[str, deque[TaskT]] = {}
        for task in tasks:
            self._waiting.setdefault(task.backend, deque()).append(task)
        self._worker_counts: Counter[str] = Counter()
        self._lock = threading.Lock()

    def take(self, last: str | None) -> TaskT | None:
        """Return the next task of a worker, or None when none is left.

        A worker stays with its engine; without more tasks of it, it joins the engine that the fewest workers serve.

        Args:
            last: Engine of the worker's last task, or None.
        """
        with self._lock:
            if last not in self._waiting:
                if last is not None:
                    self._worker_counts[last] -= 1
                if not self._waiting:
                    return None
                last = min(self._waiting, key=self._worker_counts.__getitem__)
                self._worker_counts[last] += 1
            tasks = self._waiting[last]
            task = tasks.popleft()
            if not tasks:
                del self._waiting[last]
            return task

    def clear(self) -> None:
        """Leave out the tasks that wait."""
        with self._lock:
            self._waiting.clear()


def run_tasks(
    tasks: Iterable[TaskT],
    workers: Sequence[WorkerT],
    perform: Callable[[WorkerT, TaskT], Done],
) -> Generator[Done, None, None]:
    """Yield what a function returns for each task, in the order in which they are complete.

    A single worker runs a task when its result is asked for; several have threads of their own. At the end, also when
    the iterator is closed as by Ctrl-C, the workers are closed.

    Args:
        tasks: The tasks.
        workers: The workers.
        perform: Runs a task on a worker, and writes its results. An error that it raises ends the run.
    """
    queue = TaskQueue(tasks)
    if len(workers) == 1:
        try:
            yield from _performed(queue, workers[0], perform)
        finally:
            workers[0].close()
        return
    outcomes: SimpleQueue[Done | _End] = SimpleQueue()
    threads = [
        threading.Thread(
            target=_serve, args=(queue, worker, perform, outcomes), daemon=True
        )
        for worker in workers
    ]
    for thread in threads:
        thread.start()
    try:
        running_count = len(threads)
        while running_count:
            outcome = outcomes.get()
            if not isinstance(outcome, _End):
                yield outcome
            elif outcome.error is not None:
                raise outcome.error
            else:
                running_count -= 1
    finally:
        queue.clear()
        for worker, thread in zip(workers, threads, strict=True):
            # The thread may just have started the process of its next request.
            while thread.is_alive():
                worker.close()
                thread.join(CLOSE_INTERVAL_S)
            worker.close()


@dataclass(frozen=True)
class _End:
    """End of a worker's thread, with the error that ended it."""

    error: BaseException | None = None


def _performed(
    queue: TaskQueue[TaskT], worker: WorkerT, perform: Callable[[WorkerT, TaskT], Done]
) -> Iterator[Done]:
    """Yield what a function returns for each task that a worker takes."""
    backend = None
    while (task := queue.take(backend)) is not None:
        backend = task.backend
        yield perform(worker, task)


def _serve(
    queue: TaskQueue[TaskT],
    worker: WorkerT,
    perform: Callable[[WorkerT, TaskT], Done],
    outcomes: SimpleQueue[Done | _End],
) -> None:
    """Run the tasks that a worker takes."""
    try:
        for done in _performed(queue, worker, perform):
            outcomes.put(done)
    # It ends the run, in the thread of the caller.
    except BaseException as error:
        outcomes.put(_End(error))
    else:
        outcomes.put(_End())
