"""Import of PyBullet without its messages, which would mix with the output of a command."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["pybullet", "silent"]


@contextmanager
def silent() -> Iterator[None]:
    """Discard what C++ code of this process writes to the standard streams."""
    sys.stdout.flush()
    sys.stderr.flush()
    libc = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt
    saved = [os.dup(1), os.dup(2)]
    null = os.open(os.devnull, os.O_WRONLY)
    # What the C library still holds was written before, and belongs to the user.
    libc.fflush(None)
    try:
        for stream in (1, 2):
            os.dup2(null, stream)
        yield
    finally:
        libc.fflush(None)
        for stream, descriptor in zip((1, 2), saved, strict=True):
            os.dup2(descriptor, stream)
            os.close(descriptor)
        os.close(null)


with silent():
    import pybullet
