"""Finds backends: each installed package offers its own through the entry-point group `gauge_envs.backends`."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from gauge_envs.backends.base import Backend
from gauge_envs.errors import BackendError, GaugeError, UnknownNameError

__all__ = ["backend", "backend_names"]

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
