"""Ctrl-C: an exception while a command runs, and the end of the process before and after.

Libraries may turn the exception into another one, or drop it in a callback. So the signal is also remembered.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

EXIT_INTERRUPTED = 130
"""Exit code after Ctrl-C."""


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


def _on_signal(*_: Any) -> None:
    """Raise `KeyboardInterrupt` at the first signal; the second ends the process, as a library may drop the first."""
    if _State.came or not _State.is_command:
        report_interrupt()
        os._exit(EXIT_INTERRUPTED)
    _State.came = True
    raise KeyboardInterrupt


def _on_dropped(report: Callable[[Any], None], dropped: Any) -> None:
    """Report an exception that a callback drops, but for Ctrl-C, which is remembered.

    As Python ends it takes names from modules, so that the report is an argument.
    """
    if dropped.exc_type is not KeyboardInterrupt:
        report(dropped)
