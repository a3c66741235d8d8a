"""Finds backends: each installed package offers its own through the entry-point group `gauge_envs.backends`."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from gauge_envs.backends.base import Backend
from gauge_envs.errors import UnknownNameError

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
    """
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name:
            return point.load()()
    raise UnknownNameError("backend", name, backend_names())
