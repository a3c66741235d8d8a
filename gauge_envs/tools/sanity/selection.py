"""Choose rows of a sanity check by ids and patterns."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.capacity import CAPACITY_ID
from gauge_envs.tools.sanity.gravity import GRAVITY_ID
from gauge_envs.tools.sanity.phenomena import phenomena


def selection(only: Sequence[str] = (), *, include_deformables: bool = False) -> tuple[str, ...]:
    """Return ids of rows in a fixed order: all, or those that match one of the patterns.

    Args:
        only: Ids or patterns such as `creep-*`, also several in one text with commas; all when empty.
        include_deformables: Whether to include phenomena of deformable bodies.
    """
    patterns = [part.strip() for text in only for part in text.split(",") if part.strip()]
    known = (GRAVITY_ID, CAPACITY_ID, *(one.id for one in phenomena(include_deformables=include_deformables)))
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownNameError("phenomenon", pattern, known)
    return tuple(name for name in known if not patterns or any(fnmatchcase(name, p) for p in patterns))
