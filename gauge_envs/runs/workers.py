"""Worker processes with limits of time and memory: an engine that crashes, exits or hangs loses one result.

A `Worker` sends a function of this package and its arguments to a second Python process, and waits for the reply until
the time limit. The process stays for the next call. `ProcessPoolExecutor` is unsuitable: it does not report how a
process died, cannot end a process that hangs, and leaves processes behind when the program is killed.

A `ProcessWorker` runs requests in such a process, and `run_tasks` runs tasks on several workers. The same function runs
all episodes, so results have the same bits in this process, in many processes and on other machines.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, Self, TypeVar

from gauge_envs.backends.registry import is_bundled, versions_of
from gauge_envs.errors import GaugeError, ParameterError

if TYPE_CHECKING:
    from gauge_envs.runs.request import RunRequest
    from gauge_envs.runs.result import Result

TIME_LIMIT_S = 3600.0
"""Default time limit of a call [s]."""

END_S = 10.0
"""Time for a waiting process to end itself [s]."""

GRACE_S = 10.0
"""Time after the limit of a call at which a process ends itself if the program is gone [s]."""

PARENT_INTERVAL_S = 0.5
"""Time between two checks whether the program is gone [s]."""

Parameters = ParamSpec("Parameters")
Value = TypeVar("Value")


class CrashError(GaugeError, RuntimeError):
    """The process of a call ended or exceeded a limit before its result."""


class TimeLimitError(CrashError):
    """The process of a call exceeded its time limit."""


class Worker:
    """A second Python process that runs calls one after another. It starts at the first call.

    Args:
        time_limit_s: Time limit of each call, including the start of the process [s].
        memory_limit_gb: Limit of the memory for data of the process [GB], on Linux; None: no limit. Most engines report
            the lack of memory as an error. Memory of child processes and of a GPU does not count.
        single_thread: Whether libraries use one thread, unless `OMP_NUM_THREADS` is set. It is for processes that share
            the cores, because threads of linear algebra wait for one another in a loop.
    """

    def __init__(
        self,
        time_limit_s: float = TIME_LIMIT_S,
        memory_limit_gb: float | None = None,
        *,
        single_thread: bool = False,
    ) -> None:
        # A comparison with NaN is false.
        if not 0.0 < time_limit_s <= threading.TIMEOUT_MAX - GRACE_S:
            raise ParameterError(
                f"time limit is {time_limit_s} s, expected a positive number of seconds"
            )
        if memory_limit_gb is not None and not 0.0 < memory_limit_gb < float("inf"):
            raise ParameterError(
                f"memory limit is {memory_limit_gb} GB, expected a positive number"
            )
        if memory_limit_gb is not None and sys.platform != "linux":
            raise ParameterError(
                "a memory limit needs Linux: leave it out on this system"
            )
        self._time_limit_s = time_limit_s
        self._memory_limit_gb = memory_limit_gb
        self._environment = {"OMP_NUM_THREADS": "1"} if single_thread else {}
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._is_killed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def call(
        self,
        function: Callable[Parameters, Value],
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Value:
        """Call a function in the process, and return its result.

        Args:
            function: A function of a module, found there by its name.
            *args: Its arguments; they and the result can be pickled.
            **kwargs: Its keyword arguments.

        Raises:
            CrashError: The process died, or exceeded a limit. The limit of time raises its subclass `TimeLimitError`.
            GaugeError: The function raised an error.
            concurrent.futures.CancelledError: `kill` ended the process.
        """
        task = pickle.dumps((function, args, kwargs))
        process = self._started()
        with ThreadPoolExecutor(1) as thread:
            try:
                reply = thread.submit(_reply_of, process, task)
                error, value = reply.result(self._time_limit_s)
            except BaseException as fault:
                self._process = None
                _end(process)
                if self._is_killed:
                    raise CancelledError from None
                if isinstance(fault, TimeoutError):
                    raise TimeLimitError(
                        "the engine did not finish within the time limit of "
                        f"{self._time_limit_s:g} s and was stopped"
                    ) from None
                if isinstance(fault, OSError | EOFError | pickle.UnpicklingError):
                    raise CrashError(_end_text(process.returncode)) from None
                raise
        if error is not None:
            raise GaugeError(error)
        return value

    def close(self) -> None:
        """End the waiting process; a later call starts another one.

        The process ends itself, so that Genesis can store its compiled kernels.
        """
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None
            process.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
            _end(process)

    def kill(self) -> None:
        """Kill the process and reject later calls, also while another thread waits in `call`."""
        with self._lock:
            self._is_killed = True
            if self._process is not None:
                _kill(self._process)

    def _started(self) -> subprocess.Popen[bytes]:
        """Return the process, which has the import path of this one and its own session."""
        serving = f"{self._time_limit_s!r}, {self._memory_limit_gb!r}, {os.getpid()}"
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)  # noqa: PTH109
        with self._lock:
            if self._is_killed:
                raise CancelledError
            # Unbuffered (-u), also in C, so that the last output of a dying engine is visible. Ctrl-C reaches only the
            # program, which ends the process and its child processes.
            self._process = self._process or subprocess.Popen(
                [
                    *(sys.executable, "-u", "-P", "-c"),
                    f"from {__name__} import serve; serve({serving})",
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**self._environment, **os.environ, "PYTHONPATH": path},
                start_new_session=True,
            )
            return self._process


def _end_text(returncode: int) -> str:
    """Return how a process ended, from its exit code or minus its signal."""
    if returncode < 0:
        name = (signal.strsignal(-returncode) or "unknown").lower()
        return f"the engine's process died with signal {-returncode} ({name})"
    return f"the engine ended its process with exit code {returncode}"


def call_engine(
    backend: str,
    function: Callable[..., Value],
    *args: Any,
    time_limit_s: float = TIME_LIMIT_S,
    isolate: bool | None = None,
) -> Value:
    """Call a function in the process of an engine, and return its result.

    Args:
        backend: Name of the engine.
        function: The function.
        *args: Its arguments.
        time_limit_s: Time limit in another process [s].
        isolate: Whether to use another process; None only for engines outside this package.
    """
    if not _is_apart(backend, isolate):
        return function(*args)
    with Worker(time_limit_s) as worker:
        return worker.call(function, *args)


def _is_apart(backend: str, isolate: bool | None) -> bool:
    """Return whether an engine runs in another process; None selects engines outside this package."""
    return not is_bundled(backend) if isolate is None else isolate


def _reply_of(process: subprocess.Popen[bytes], task: bytes) -> tuple[str | None, Any]:
    """Send a task to a process and return its error, or None, and its value."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(task)
    process.stdin.flush()
    error, value = pickle.load(process.stdout)
    return error, value


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a process, and its child processes if the system has process groups."""
    if sys.platform == "win32":
        process.kill()
        return
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and wait for its end."""
    _kill(process)
    process.wait()
    for stream in (process.stdin, process.stdout):
        assert stream is not None
        with suppress(OSError):
            stream.close()


# --- workers of a run ---


@dataclass(frozen=True)
class Limits:
    """Limits of the processes of workers.

    Attributes:
        time_limit_s: Time limit of a request [s].
        memory_limit_gb: Limit of the memory of a process [GB], on Linux; None: no limit.
        is_per_request: Whether each request has its own process.
    """

    time_limit_s: float = TIME_LIMIT_S
    memory_limit_gb: float | None = None
    is_per_request: bool = False


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
        isolate: Whether engines run in the other process; None only for engines of other packages.
        single_thread: Whether libraries use one thread; for processes that share the cores.
    """

    def __init__(
        self, limits: Limits, *, isolate: bool | None = True, single_thread: bool = True
    ) -> None:
        self._process = Worker(
            limits.time_limit_s, limits.memory_limit_gb, single_thread=single_thread
        )
        self._limits = limits
        self._isolate = isolate
        self._backend = ""

    def run(self, request: RunRequest) -> list[Result]:
        """Return the results of a request; an episode that ends the process is `failed` with the cause."""
        from gauge_envs.runs.episodes import results_without_run, run_request
        from gauge_envs.runs.result import Outcome

        limit_gb = self._limits.memory_limit_gb
        try:
            results = self._call(request.backend, run_request, request)
            # Memory that an engine keeps after a failure would count against the limit of the next episode.
            is_lost = (
                limit_gb is not None
                and _is_apart(request.backend, self._isolate)
                and any(result.outcome is Outcome.FAILED for result in results)
            )
        except GaugeError as error:
            results = results_without_run(request, Outcome.FAILED, str(error))
            is_lost = True
        if is_lost or self._limits.is_per_request:
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

    def _call(self, backend: str, function: Callable[..., Any], argument: Any) -> Any:
        """Call a function in the process of an engine, and return its result."""
        if not _is_apart(backend, self._isolate):
            return function(argument)
        if backend != self._backend:
            self._process.close()
            self._backend = backend
        return self._process.call(function, argument)


TaskT = TypeVar("TaskT")
WorkerT = TypeVar("WorkerT", bound=RequestWorker)


def run_tasks(
    tasks: Sequence[TaskT],
    workers: Sequence[WorkerT],
    perform: Callable[[WorkerT, TaskT], list[Result]],
) -> Generator[Result, None, None]:
    """Yield the results of a function for each task, in the order of the tasks.

    A single worker runs a task when its result is requested; several workers run in threads. Closing the iterator
    before its end, as by Ctrl-C, kills the workers.

    Args:
        tasks: The tasks.
        workers: The workers.
        perform: Function that runs a task on a worker and writes its results; its error ends the run.
    """
    if len(workers) == 1:
        (worker,) = workers
        try:
            for task in tasks:
                yield from perform(worker, task)
        finally:
            worker.close()
        return
    idle: SimpleQueue[WorkerT] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def results_of(task: TaskT) -> list[Result]:
        worker = idle.get()
        try:
            return perform(worker, task)
        finally:
            idle.put(worker)

    threads = ThreadPoolExecutor(len(workers))
    try:
        futures = deque(threads.submit(results_of, task) for task in tasks)
        while futures:
            yield from futures.popleft().result()
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


# --- in the process of a worker ---


def serve(time_limit_s: float, memory_limit_gb: float | None, parent: int) -> None:
    """Run the calls from stdin until it ends; output on stdout goes to stderr.

    Args:
        time_limit_s: Time limit of each call [s].
        memory_limit_gb: Limit of the memory for data [GB], or None.
        parent: Process of the program; the end of the program ends a call.
    """
    is_called = threading.Event()
    threading.Thread(target=_end_with, args=(parent, is_called), daemon=True).start()
    tasks = os.fdopen(os.dup(0), "rb")
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    faulthandler.enable()
    if memory_limit_gb is not None and sys.platform == "linux":
        import resource

        limit_bytes = int(1e9 * memory_limit_gb)
        resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, limit_bytes))
    # At the end of stdin or after a failed reply, the program has closed the worker or is gone.
    with suppress(EOFError, OSError):
        while True:
            is_called.clear()
            function, args, kwargs = pickle.load(tasks)
            is_called.set()
            # The program stops a call at its time limit, unless the program is gone.
            faulthandler.dump_traceback_later(time_limit_s + GRACE_S, exit=True)
            reply = _reply(function, args, kwargs)
            faulthandler.cancel_dump_traceback_later()
            replies.write(reply)
            replies.flush()


def _end_with(parent: int, is_called: threading.Event) -> None:
    """End this process and its child processes in a call whose program is gone; a waiting process ends itself.

    Windows keeps the number of the parent, so there the time limit ends the call.
    """
    while os.getppid() == parent or not is_called.is_set():
        time.sleep(PARENT_INTERVAL_S)
    if sys.platform != "win32":
        os.killpg(os.getpgrp(), signal.SIGKILL)


def _reply(function: Callable[..., Any], args: Any, kwargs: Any) -> bytes:
    """Return the error of a call, or None, and its value, as a pickle."""
    try:
        return pickle.dumps((None, function(*args, **kwargs)))
    except GaugeError as error:
        cause = str(error)
    except BaseException as error:  # Also SystemExit.
        cause = f"{type(error).__name__}: {error}"
    return pickle.dumps((cause, None))
