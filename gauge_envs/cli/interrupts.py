"""Ctrl-C: an exception while a command runs, and the end of the process before and after.

Libraries may turn the exception into another one, or drop it in a callback. So the signal is also remembered.
"""

import _thread
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

EXIT_INTERRUPTED = 130
"""Exit code after Ctrl-C."""

REPEAT_AFTER_S = 0.01
"""Time after which a signal that was dropped comes again [s]; an exception inside a hook would be dropped, too."""

LONGEST_WAIT_S = 2.0
"""Time for which a signal waits for the end of an import [s]."""


class _State:
    is_command = False
    """Whether a command runs, which catches `KeyboardInterrupt`."""

    came = False
    """Whether a signal came in while a command ran."""

    since_s: float | None = None
    """Time of the first one [s]."""

    is_reported = False

    is_in_hook = False
    """Whether a hook runs, which would drop an exception."""


def handle_interrupts() -> None:
    """Handle Ctrl-C in this process from now on, where it was not ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    signal.signal(signal.SIGINT, _on_signal)
    sys.unraisablehook = _on_unraisable


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


def _on_signal(number: int, frame: Any) -> None:
    if not _State.is_command:
        report_interrupt()
        os._exit(EXIT_INTERRUPTED)
    _State.came, _State.since_s = True, _State.since_s or time.monotonic()
    # Extensions print the traceback of an error that their import meets, so Ctrl-C waits for the end of an import.
    if _State.is_in_hook or (
        _is_import(frame) and time.monotonic() < _State.since_s + LONGEST_WAIT_S
    ):
        _repeat_soon()
    else:
        raise KeyboardInterrupt


def _is_import(frame: Any) -> bool:
    while (
        frame is not None
        and frame.f_code.co_filename != "<frozen importlib._bootstrap>"
    ):
        frame = frame.f_back
    return frame is not None


def _on_unraisable(
    unraisable: Any,
    default_hook: Callable[[Any], object] = sys.__unraisablehook__,
    interrupt: type[KeyboardInterrupt] = KeyboardInterrupt,
) -> None:
    """Raise Ctrl-C again soon after a callback or a destructor dropped it.

    At the end of the process, where Python 3.13 flushes stdout, the globals of this module are gone: what is needed
    then are defaults of arguments.
    """
    if isinstance(unraisable.exc_value, interrupt):
        _State.is_in_hook = True
        _repeat_soon()
        _State.is_in_hook = False
    else:
        default_hook(unraisable)


def _repeat_soon() -> None:
    """Send the signal again from another thread. A timer of `threading` would wait here until it has started."""

    def repeat() -> None:
        time.sleep(REPEAT_AFTER_S)
        signal.raise_signal(signal.SIGINT)

    _thread.start_new_thread(repeat, ())
