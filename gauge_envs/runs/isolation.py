"""Calls in a process of their own, so that an engine that crashes, exits or hangs costs one call and not the program.

`Worker.call` sends a function of this package and its arguments to a second Python process, and returns the result.
The process lives on for the next call until it crashes, exceeds a limit or is closed. What it prints on stdout goes to
stderr.

A limit of memory is watched from outside, because engines that use a GPU reserve far more addresses than memory.
"""

import faulthandler
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from select import select
from types import TracebackType
from typing import Any, BinaryIO, ParamSpec, Self, TypeVar

from gauge_envs.errors import GaugeError, ParameterError

TIME_LIMIT_S = 3600.0
"""Default time limit of a call [s]."""

LOOK_S = 0.05
"""Time between two looks at the memory of a process [s]."""

PARENT_LOOK_S = 0.2
"""Time between two looks of a process at whether its parent lives [s]."""

END_S = 10.0
"""Time in which a process that waits for a call may end itself [s]."""

GRACE_S = 10.0
"""Time after its limit at which a process ends itself, if its parent is gone [s]."""

ONE_THREAD = {"OMP_NUM_THREADS": "1"}
"""What OpenMP and the libraries of linear algebra read."""

Parameters = ParamSpec("Parameters")
Value = TypeVar("Value")


class CrashError(GaugeError, RuntimeError):
    """The process of a call ended or exceeded a limit before it had a result."""


class Worker:
    """A second Python process that runs calls one after another. It starts at the first call.

    Args:
        time_limit_s: Time limit of each call, with the start of the process [s].
        memory_limit_gb: Limit of the resident memory of the process [GB], or None. Memory of its children and of a GPU
            does not count.
        single_thread: Whether libraries compute with one thread, unless the environment states a number. It is for
            processes that share the cores: threads of linear algebra wait for one another in a loop.
    """

    def __init__(
        self,
        time_limit_s: float = TIME_LIMIT_S,
        memory_limit_gb: float | None = None,
        *,
        single_thread: bool = False,
    ) -> None:
        # A comparison with NaN is false.
        if not 0.0 < time_limit_s <= threading.TIMEOUT_MAX:
            raise ParameterError(
                f"time limit is {time_limit_s} s, expected a positive number of seconds"
            )
        if memory_limit_gb is not None:
            if not memory_limit_gb > 0.0:
                raise ParameterError(
                    f"memory limit is {memory_limit_gb} GB, expected a positive number"
                )
            if _memory_gb(os.getpid()) == 0.0:
                raise ParameterError(
                    "a memory limit needs /proc, which Linux alone has: leave it out on this system"
                )
        self._time_limit_s = time_limit_s
        self._memory_limit_gb = memory_limit_gb
        self._environment: Mapping[str, str] = ONE_THREAD if single_thread else {}
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def call(
        self,
        function: Callable[Parameters, Value],
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Value:
        """Return what a function returns in the process.

        Args:
            function: A function of a module, found there by its name.
            *args: Its arguments, which can be pickled, as its result.
            **kwargs: Its keyword arguments.
        """
        task = pickle.dumps((self._time_limit_s + GRACE_S, function, args, kwargs))
        process = self._process = self._process or _start(self._environment)
        assert process.stdin is not None and process.stdout is not None
        watch = _Watch(process, self._time_limit_s, self._memory_limit_gb)
        try:
            process.stdin.write(task)
            process.stdin.flush()
            error, value = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            watch.close()
            self._end()
            raise CrashError(watch.reason or _cause(process.returncode)) from None
        except BaseException:
            self._end()
            raise
        finally:
            watch.close()
        if error is not None:
            raise GaugeError(error)
        return value

    def close(self) -> None:
        """End the process. A later call starts another one.

        As it waits for a call, it ends itself, so that Genesis can write the kernels that it compiled.
        """
        self._end(END_S)

    def _end(self, patience_s: float = 0.0) -> None:
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None and process.stdout is not None
            if patience_s and sys.platform != "win32":
                with suppress(OSError):
                    process.stdin.close()
                select([process.stdout], [], [], patience_s)
            _kill(process)
            process.wait()
            for stream in (process.stdin, process.stdout):
                with suppress(OSError):
                    stream.close()


def _start(environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """Start a process with the import path of this one, and with variables that its environment may lack."""
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)  # noqa: PTH109
    # Unbuffered (-u), also in C: what an engine prints before it dies is the cause that its author looks for.
    return subprocess.Popen(
        [sys.executable, "-u", "-P", "-c", f"from {__name__} import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**environment, **os.environ, "PYTHONPATH": path},
        # The parent alone handles Ctrl-C, and can end everything that the process has started.
        start_new_session=True,
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process, with all that it has started where the system has process groups."""
    if sys.platform == "win32":
        process.kill()
        return
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)


def _cause(returncode: int) -> str:
    """Return how a process ended before it had a result.

    Args:
        returncode: Its exit code, or minus its signal.
    """
    if returncode < 0:
        name = (signal.strsignal(-returncode) or "unknown").lower()
        return f"the engine's process died with signal {-returncode} ({name})"
    return f"the engine ended its process with exit code {returncode}"


def _memory_gb(pid: int) -> float:
    """Return the resident memory of a process [GB]; 0 where the system does not report it."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9


class _Watch:
    """Thread that ends a process which exceeds a limit.

    Args:
        process: The process.
        time_limit_s: Time limit from now on [s].
        memory_limit_gb: Limit of its resident memory [GB], or None.

    Attributes:
        reason: The limit that the process exceeded; empty if it did not.
    """

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        time_limit_s: float,
        memory_limit_gb: float | None,
    ) -> None:
        self.reason = ""
        self._process, self._time_limit_s, self._memory_limit_gb = (
            process,
            time_limit_s,
            memory_limit_gb,
        )
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the watch."""
        self._is_over.set()
        self._thread.join()

    def _run(self) -> None:
        end_s = time.monotonic() + self._time_limit_s
        while not self.reason:
            left_s = end_s - time.monotonic()
            if self._is_over.wait(
                max(
                    0.0,
                    left_s if self._memory_limit_gb is None else min(left_s, LOOK_S),
                )
            ):
                return
            if time.monotonic() >= end_s:
                self.reason = f"the engine did not finish within the time limit of {self._time_limit_s:g} s"
            elif (
                self._memory_limit_gb is not None
                and _memory_gb(self._process.pid) > self._memory_limit_gb
            ):
                self.reason = f"the engine exceeded the memory limit of {self._memory_limit_gb:g} GB"
        self.reason += " and was stopped"
        _kill(self._process)


def serve() -> None:
    """Run the calls that stdin brings until it ends."""
    tasks, results = _reserved_streams()
    faulthandler.enable()
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    while True:
        try:
            limit_s, function, args, kwargs = pickle.load(tasks)
        except EOFError:
            return
        # It ends the process even where an engine never returns to Python.
        faulthandler.dump_traceback_later(limit_s, exit=True)
        reply: tuple[str | None, Any]
        try:
            reply = (None, function(*args, **kwargs))
        except GaugeError as error:
            reply = (str(error), None)
        except BaseException as error:  # Also SystemExit.
            reply = (f"{type(error).__name__}: {error}", None)
        faulthandler.cancel_dump_traceback_later()
        try:
            results.write(_pickled(reply))
            results.flush()
        except OSError:  # The parent is gone.
            return


def _end_with_parent(parent: int) -> None:
    """End this process and what it has started when its parent is gone: nobody takes the result of a call.

    Where a process keeps the number of a parent that is gone, as on Windows, the call goes on; then stdin ends.
    """
    while os.getppid() == parent:
        time.sleep(PARENT_LOOK_S)
    if sys.platform != "win32":
        os.killpg(0, signal.SIGKILL)


def _pickled(reply: tuple[str | None, Any]) -> bytes:
    """Return a reply in bytes, or an error if its value cannot be pickled."""
    try:
        return pickle.dumps(reply)
    except Exception as error:  # A value of an engine may raise any error here.
        return pickle.dumps(
            (f"the result cannot be pickled: {type(error).__name__}: {error}", None)
        )


def _reserved_streams() -> tuple[BinaryIO, BinaryIO]:
    """Return copies of stdin and stdout; what anything else prints on stdout goes to stderr."""
    tasks = os.fdopen(os.dup(0), "rb")
    # It stays open until the process ends, which `Worker.close` waits for.
    results = os.fdopen(os.dup(1), "wb", closefd=False)
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return tasks, results
