"""Ids of all checks in their order, and their choice by patterns."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.object_checks import OBJECT_CHECKS
from gauge_envs.tools.sanity.target_checks import TARGET_CHECKS


def selection(only: Sequence[str] = ()) -> tuple[str, ...]:
    """Return ids of checks in a fixed order: all, or those that match a pattern.

    Args:
        only: Ids or patterns such as `creep-*`, also several in a text with commas; all when empty.

    Raises:
        UnknownNameError: A pattern matches no check.
    """
    known: tuple[str, ...] = (*TARGET_CHECKS, *OBJECT_CHECKS)
    patterns = [part.strip() for text in only or ["*"] for part in text.split(",")]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownNameError("check", pattern, known)
    return tuple(
        name
        for name in known
        if any(fnmatchcase(name, pattern) for pattern in patterns)
    )
