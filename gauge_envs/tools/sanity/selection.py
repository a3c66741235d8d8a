"""Ids of all checks in their order, and their choice by patterns."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.model_checks import TARGET_CHECKS
from gauge_envs.tools.sanity.object_checks import GRASP, RIGID, SLOW


def selection(
    only: Sequence[str] = (), *, include_deformables: bool = False
) -> tuple[str, ...]:
    """Return ids of checks in a fixed order: all, or those that match a pattern.

    Args:
        only: Ids or patterns such as `creep-*`, also several in a text with commas; all when empty.
        include_deformables: Whether to include checks of grasps, a wall and deformable bodies.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    known: tuple[str, ...] = (*TARGET_CHECKS, *RIGID)
    if include_deformables:
        known = (*known, *GRASP, *SLOW)
    patterns = [part.strip() for text in only for part in text.split(",")]
    if not patterns:
        return known
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownNameError("check", pattern, known)
    return tuple(name for name in known if _matches(name, patterns))


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def chooses_deformables(only: Sequence[str]) -> bool:
    """Return whether a pattern chooses a wall or deformable bodies: it is `*`, or matches no other check."""
    rigid = selection()
    return any(
        pattern == "*" or not any(_matches(name, [pattern]) for name in rigid)
        for pattern in only
    )
