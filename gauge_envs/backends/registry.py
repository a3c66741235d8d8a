"""Finds backends: each installed package offers its own through the entry-point group `gauge_envs.backends`."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from gauge_envs.backends.base import Backend, FileBackend
from gauge_envs.errors import BackendError, GaugeError, UnknownNameError

__all__ = [
    "backend",
    "backend_for",
    "backend_names",
    "backend_of_suffix",
]

ENTRY_POINT_GROUP = "gauge_envs.backends"


def backend_names() -> tuple[str, ...]:
    """Names of all installed backends, sorted; none of them is imported."""
    return tuple(sorted({point.name for point in entry_points(group=ENTRY_POINT_GROUP)}))


@cache
def backend(name: str) -> Backend:
    """Backend of that name, imported on first use.

    Raises:
        UnknownNameError: No installed package offers it.
        MissingExtraError: Its engine is not installed.
        BackendError: Its package cannot be imported for another reason.
    """
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name:
            try:
                return point.load()()
            except GaugeError:
                raise
            except Exception as error:  # A package of someone else raises anything, and others must stay usable.
                raise BackendError(f"backend {name!r} ({point.value}): {type(error).__name__}: {error}") from error
    raise UnknownNameError("backend", name, backend_names())


def backend_for(name: str, model_file: Path | None) -> Backend:
    """Backend of that name; where a model file stands for the scene, one that builds the file.

    Raises:
        UnknownNameError: No installed package offers it.
        MissingExtraError: Its engine is not installed.
        BackendError: Its package cannot be imported for another reason.
    """
    engine = backend(name)
    return engine if model_file is None else FileBackend(engine, model_file)


def backend_of_suffix(suffix: str) -> Backend | None:
    """The installed backend whose engine has model files of that suffix; None where none has."""
    for name in backend_names():
        try:
            engine = backend(name)
        except GaugeError:
            continue
        if suffix in engine.file_suffixes:
            return engine
    return None
