"""Genesis's import and start: quiet, on the CPU, once per process and precision."""

import contextlib
import gc
import logging
import os
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from functools import cache
from typing import Any
from weakref import WeakSet

from gauge_envs.errors import BackendError

LOGGER = logging.getLogger("gauge_envs.genesis")

PATIENCE_S = 5.0
"""Duration of a build after which a note says what it waits for [s]."""


@cache
def engine() -> Any:
    """Return the module `genesis`. Its import takes 4 s; it neither prints nor replaces the hook of exceptions."""
    hook = sys.excepthook
    # Otherwise the compiler prints a line about any stdout but that of the process.
    os.environ.setdefault("QD_ENABLE_PYBUF", "0")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import genesis
    finally:
        sys.excepthook = hook
    return genesis


class EngineLease:
    """A claim on Genesis, which has one precision per process while a scene exists.

    Args:
        precision: Bits of floating-point numbers, 32 or 64.
    """

    def __init__(self, precision: int) -> None:
        self.precision = precision
        if any(lease.precision != precision for lease in _LEASES):
            # A cycle of references may still hold a simulation that nothing uses.
            gc.collect()
        if any(lease.precision != precision for lease in _LEASES):
            raise BackendError(
                f"Genesis has one precision per process, and a simulation with {96 - precision} bits exists. A "
                f"simulation with {precision} bits cannot start beside it. Close the other one first, set precision to "
                "the same value, or use another process."
            )
        _start(precision)
        _LEASES.add(self)

    def release(self) -> None:
        """Give up the claim."""
        _LEASES.discard(self)


_LEASES: WeakSet[EngineLease] = WeakSet()


def _start(precision: int) -> None:
    gs = engine()
    if gs.backend is not None:
        if gs.np_float().itemsize * 8 == precision:
            return
        gs.destroy()
    with _quiet():
        gs.init(backend=gs.cpu, precision=str(precision), logging_level="error", seed=0)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Genesis and its compiler from writing to stdout, and from warnings about their own code."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(sys.stderr):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def patient(work: str) -> Iterator[None]:
    """Say on stderr what a long step waits for, unless it is over within `PATIENCE_S`.

    Args:
        work: What happens, as `building a scene`.
    """

    def say() -> None:
        folder = os.environ.get("QD_OFFLINE_CACHE_FILE_PATH", "~/.cache/quadrants")
        LOGGER.warning(
            "Genesis is %s: it compiles kernels, which takes up to two minutes the first time. It keeps them in %s.",
            work,
            folder,
        )

    timer = threading.Timer(PATIENCE_S, say)
    timer.daemon = True
    start = time.monotonic()
    timer.start()
    try:
        with _quiet():
            yield
    finally:
        timer.cancel()
        if time.monotonic() - start > PATIENCE_S:
            LOGGER.warning("Genesis was %s for %.0f s", work, time.monotonic() - start)
