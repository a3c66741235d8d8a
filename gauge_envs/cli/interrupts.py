"""Ctrl-C: an exception while a command runs, and the end of the process before and after, and during an import.

Libraries may turn the exception into another one, or drop it in a callback. So the signal is also remembered.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Any

EXIT_INTERRUPTED = 130
"""Exit code after Ctrl-C."""

IMPORT_FILE = "<frozen importlib._bootstrap>"
"""File of the frames of Python's import system."""


class _State:
    is_command = False
    """Whether a command runs, which catches `KeyboardInterrupt`."""

    came = False
    """Whether a signal came in while a command ran."""

    is_reported = False


def handle_interrupts() -> None:
    """Handle Ctrl-C in this process from now on, where it was not ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    signal.signal(signal.SIGINT, _on_signal)
    sys.unraisablehook = partial(_on_dropped, sys.__unraisablehook__)


@contextmanager
def command_runs() -> Iterator[None]:
    """Let Ctrl-C raise `KeyboardInterrupt` inside, so that the command can keep what is complete."""
    try:
        _State.is_command, _State.is_reported = True, False
        yield
    finally:
        _State.is_command = False


def was_interrupted() -> bool:
    """Return whether Ctrl-C came while a command ran."""
    return _State.came


def report_interrupt() -> None:
    """Print that the command was interrupted, once."""
    if not _State.is_reported:
        _State.is_reported = True
        os.write(2, b"interrupted\n")


def _on_signal(_: int, frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`, or end the process where the exception may be dropped.

    A library may drop the first exception, and Python may replace one that comes up during an import.
    """
    if _State.came or not _State.is_command or _is_importing(frame):
        report_interrupt()
        os._exit(EXIT_INTERRUPTED)
    _State.came = True
    raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    """Return whether a frame runs on behalf of an import."""
    while frame is not None:
        if frame.f_code.co_filename == IMPORT_FILE:
            return True
        frame = frame.f_back
    return False


def _on_dropped(report: Callable[[Any], None], dropped: Any) -> None:
    """Report an exception that a callback drops, but for Ctrl-C, which is remembered.

    As Python ends it takes names from modules, so that the report is an argument.
    """
    if dropped.exc_type is not KeyboardInterrupt:
        report(dropped)
