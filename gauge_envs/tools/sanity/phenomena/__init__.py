"""Phenomena of real objects in GAUGE's experiments, each with one number, its scatter and its source."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.phenomena import (
    carrying,
    edges,
    foot,
    friction,
    impact,
    lines,
    solids,
    stacking,
    swing,
    textile,
)
from gauge_envs.tools.sanity.phenomena.phenomenon import Phenomenon, PhenomenonValue, Trace

__all__ = ["Phenomenon", "PhenomenonValue", "Trace", "phenomena"]


@cache
def _all() -> dict[str, Phenomenon]:
    modules = (foot, friction, impact, swing, carrying, edges, stacking, textile, solids, lines)
    return {one.id: one for module in modules for one in module.phenomena()}


def phenomena(only: Sequence[str] = (), *, include_deformables: bool = False) -> tuple[Phenomenon, ...]:
    """Return all phenomena in a fixed order, or those whose id matches one of the patterns.

    Args:
        only: Ids or patterns such as `creep-*`; all when empty.
        include_deformables: Whether to include phenomena of deformable bodies.
    """
    known = {name: one for name, one in _all().items() if include_deformables or not one.scenario.scene.deformables}
    for pattern in only:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownNameError("phenomenon", pattern, known)
    return tuple(one for name, one in known.items() if not only or any(fnmatchcase(name, p) for p in only))
