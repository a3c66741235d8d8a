"""Calls in a process of their own, so that an engine that crashes, exits or hangs costs one call and not the program.

`Worker.call` sends a function of this package and its arguments to a second Python process, and returns the result.
The process lives on for the next call until it crashes, exceeds its time limit or is closed. What it prints on stdout
goes to stderr.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, BinaryIO, ParamSpec, Self, TypeVar

from gauge_envs.errors import GaugeError, ParameterError

__all__ = ["TIME_LIMIT_S", "CrashError", "Worker", "serve"]

TIME_LIMIT_S = 3600.0
"""Default time limit of a call [s]."""

GRACE_S = 10.0
"""Time after its limit at which a process ends itself, if its parent is gone [s]."""

Parameters = ParamSpec("Parameters")
Value = TypeVar("Value")


class CrashError(GaugeError, RuntimeError):
    """The process of a call ended or exceeded its time limit before it had a result."""


class Worker:
    """A second Python process that runs calls one after another. It starts at the first call.

    Args:
        time_limit_s: Time limit of each call, with the start of the process [s].

    Raises:
        ParameterError: The time limit is not positive.
    """

    def __init__(self, time_limit_s: float = TIME_LIMIT_S) -> None:
        # A comparison with NaN is false.
        if not 0.0 < time_limit_s <= threading.TIMEOUT_MAX:
            raise ParameterError(f"time limit is {time_limit_s} s, expected a positive number of seconds")
        self._time_limit_s = time_limit_s
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def call(self, function: Callable[Parameters, Value], *args: Parameters.args, **kwargs: Parameters.kwargs) -> Value:
        """Return what a function returns in the process.

        Args:
            function: A function of a module, found there by its name.
            *args: Its arguments, which can be pickled, as its result.
            **kwargs: Its keyword arguments.

        Raises:
            CrashError: The process ended or exceeded the time limit; the message gives the cause.
            GaugeError: The function raised an error; the message is that error's.
        """
        task = pickle.dumps((self._time_limit_s + GRACE_S, function, args, kwargs))
        process = self._process = self._process or _start()
        assert process.stdin is not None and process.stdout is not None
        late = threading.Event()

        def stop() -> None:
            late.set()
            _kill(process)

        timer = threading.Timer(self._time_limit_s, stop)
        timer.daemon = True
        timer.start()
        try:
            process.stdin.write(task)
            process.stdin.flush()
            error, value = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            self.close()
            raise CrashError(_cause(process.returncode, self._time_limit_s if late.is_set() else None)) from None
        except BaseException:
            self.close()
            raise
        finally:
            timer.cancel()
        if error is not None:
            raise GaugeError(error)
        return value

    def close(self) -> None:
        """End the process. A later call starts another one."""
        process, self._process = self._process, None
        if process is not None:
            _kill(process)
            process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    with suppress(OSError):
                        stream.close()


def _start() -> subprocess.Popen[bytes]:
    """Start a process with the import path of this one."""
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)  # noqa: PTH109
    return subprocess.Popen(
        [sys.executable, "-P", "-c", f"from {__name__} import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path},
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


def _cause(returncode: int, time_limit_s: float | None) -> str:
    """Return why a process has no result.

    Args:
        returncode: Its exit code, or minus its signal.
        time_limit_s: The time limit that it exceeded [s], or None.
    """
    if time_limit_s is not None:
        return f"the engine did not finish within the time limit of {time_limit_s:g} s and was stopped"
    if returncode < 0:
        return f"the engine crashed: its process ended by {signal.Signals(-returncode).name}"
    return f"the engine ended its process with exit code {returncode}"


def serve() -> None:
    """Run the calls that stdin brings until it ends."""
    tasks, results = _reserved_streams()
    faulthandler.enable()
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
        results.write(_pickled(reply))
        results.flush()


def _pickled(reply: tuple[str | None, Any]) -> bytes:
    """Return a reply in bytes, or an error if its value cannot be pickled."""
    try:
        return pickle.dumps(reply)
    except Exception as error:  # A value of an engine may raise any error here.
        return pickle.dumps((f"the result cannot be pickled: {type(error).__name__}: {error}", None))


def _reserved_streams() -> tuple[BinaryIO, BinaryIO]:
    """Return copies of stdin and stdout; what anything else prints on stdout goes to stderr."""
    tasks, results = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return tasks, results
