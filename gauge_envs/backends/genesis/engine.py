"""Genesis's import and start: quiet, on the CPU, once per process and precision."""

import contextlib
import gc
import logging
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

from gauge_envs.errors import BackendError

LOGGER = logging.getLogger("gauge_envs.genesis")

PATIENCE_S = 5.0
"""Duration of a build after which a note explains the wait [s]."""

_PRECISIONS: WeakKeyDictionary[Any, int] = WeakKeyDictionary()
"""Precision of each simulation that exists [bits]."""


@cache
def engine() -> Any:
    """Return the module `genesis`. Its import takes 4 s; it neither prints nor replaces the hook of exceptions."""
    hook = sys.excepthook
    # Otherwise the compiler prints a line if stdout is replaced.
    os.environ.setdefault("QD_ENABLE_PYBUF", "0")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import genesis
    finally:
        sys.excepthook = hook
    return genesis


def claim(owner: object, precision: int) -> None:
    """Start Genesis for a simulation, which keeps it from starting in another precision.

    Args:
        owner: The simulation. Its claim ends with `release`, or when it is garbage-collected.
        precision: Bits of floating-point numbers, 32 or 64.

    Raises:
        BackendError: A simulation with the other precision exists.
    """
    if set(_PRECISIONS.values()) - {precision}:
        # A cycle of references may still keep an unused simulation.
        gc.collect()
    if set(_PRECISIONS.values()) - {precision}:
        raise BackendError(
            f"Genesis has one precision per process, and a simulation with {96 - precision} bits exists. A "
            f"simulation with {precision} bits cannot start at the same time. Close the other simulation first, set "
            "precision to the same value, or use another process."
        )
    gs = engine()
    if gs.backend is not None and gs.np_float().itemsize * 8 != precision:
        gs.destroy()
    if gs.backend is None:
        with _quiet():
            gs.init(
                backend=gs.cpu,
                precision=str(precision),
                logging_level="error",
                seed=0,
            )
    _PRECISIONS[owner] = precision


def release(owner: object) -> None:
    """End the claim of a simulation."""
    _PRECISIONS.pop(owner, None)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep Genesis and its compiler from writing to stdout, and from warnings about their own code."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(sys.stderr):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def patient_build() -> Iterator[None]:
    """Build a scene quietly, but explain the wait on stderr if it takes more than `PATIENCE_S`."""
    folder = os.environ.get("QD_OFFLINE_CACHE_FILE_PATH", "~/.cache/quadrants")
    note = (
        "Genesis is building a scene: it compiles kernels, which takes up to two minutes the first time. It keeps them "
        f"in {folder}."
    )
    timer = threading.Timer(PATIENCE_S, LOGGER.warning, [note])
    timer.daemon = True
    timer.start()
    try:
        with _quiet():
            yield
    finally:
        timer.cancel()
