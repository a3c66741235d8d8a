"""Registry of backends, which installed packages provide through the entry-point group `gauge_envs.backends`."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from gauge_envs.backends.base import Backend, FileBackend
from gauge_envs.errors import BackendError, GaugeError, UnknownNameError

__all__ = ["backend", "backend_for", "backend_names", "backend_of_suffix"]

ENTRY_POINT_GROUP = "gauge_envs.backends"


def backend_names() -> tuple[str, ...]:
    """Return the sorted names of all installed backends, without importing any."""
    return tuple(sorted({point.name for point in entry_points(group=ENTRY_POINT_GROUP)}))


@cache
def backend(name: str) -> Backend:
    """Return the backend of a name. The first call imports it.

    Raises:
        UnknownNameError: No installed package provides it.
        MissingExtraError: Its engine is not installed.
        BackendError: Its package cannot be imported for another reason.
    """
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name:
            try:
                return point.load()()
            except GaugeError:
                raise
            except Exception as error:  # A third-party package may raise anything; other backends must stay usable.
                raise BackendError(f"backend {name!r} ({point.value}): {type(error).__name__}: {error}") from error
    raise UnknownNameError("backend", name, backend_names())


def backend_for(name: str, model_file: Path | None) -> Backend:
    """Return the backend of a name, or a backend that builds the model file if one replaces the scene.

    Raises:
        UnknownNameError: No installed package provides it.
        MissingExtraError: Its engine is not installed.
        BackendError: Its package cannot be imported for another reason.
    """
    engine = backend(name)
    return engine if model_file is None else FileBackend(engine, model_file)


def backend_of_suffix(suffix: str) -> Backend | None:
    """Return the installed backend that reads model files with a suffix, or None if no backend does."""
    for name in backend_names():
        try:
            engine = backend(name)
        except GaugeError:
            continue
        if suffix in engine.file_suffixes:
            return engine
    return None
