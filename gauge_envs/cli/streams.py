"""Streams of a command: stdout has only its results."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TextIO

_reserved: list[TextIO] = []


def result_stream() -> TextIO:
    """Return the stream of the results of a command: its original stdout."""
    return _reserved[-1] if _reserved else sys.stdout


@contextmanager
def reserved_stdout() -> Iterator[None]:
    """Redirect all output on stdout except that of `result_stream` to stderr.

    Engines print in Python or write to file descriptor 1 in C, and both would break the JSON on stdout. File descriptor
    1 stays redirected until the process ends, because C code may flush its buffer at the end.
    """
    outer = sys.stdout
    outer.flush()
    stream = _stream_of_process() if _has_descriptors() else outer
    sys.stdout = sys.stderr
    _reserved.append(stream)
    try:
        yield
        stream.flush()
    finally:
        _reserved.pop()
        sys.stdout = outer


def _has_descriptors() -> bool:
    """Return whether stdout and stderr are the file descriptors 1 and 2."""
    try:
        return sys.stdout.fileno() == 1 and sys.stderr.fileno() == 2
    except (OSError, ValueError, AttributeError):  # A stream in memory, or none.
        return False


@cache
def _stream_of_process() -> TextIO:
    """Return a stream on the stdout of the process, and point file descriptor 1 to stderr."""
    stream = os.fdopen(
        os.dup(1), "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors
    )
    os.dup2(2, 1)
    return stream
