"""Ids of all rows of a sanity check, in their order, and their choice by patterns."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.own_rows import ROWS
from gauge_envs.tools.sanity.phenomena import GRASP, RIGID, SLOW

GRAVITY_ID, CONTROL_ID = "gravity", "control-step"
"""Rows on what a target gives as numbers."""

OWN_IDS = (*ROWS, GRAVITY_ID, CONTROL_ID)
"""Rows on the target itself, which run none of the suite's experiments."""

SIMULATED_IDS = frozenset(
    {
        *("model-overlap", "model-constraints", "model-sleep", "model-creep"),
        *("model-cloth", "model-cloth-sink", "model-solver", "model-spin"),
        *("robot-holds", "robot-energy", "robot-stands"),
        *("robot-torque", "robot-drive"),
    }
)
"""Rows that run the target's own model, so that settings of the engine can change them."""


def selection(
    only: Sequence[str] = (), *, include_deformables: bool = False
) -> tuple[str, ...]:
    """Return ids of rows in a fixed order: all, or those that match one of the patterns.

    Args:
        only: Ids or patterns such as `creep-*`, also several in one text with commas; all when empty.
        include_deformables: Whether to include rows on grasps, a wall and deformable bodies.

    Raises:
        UnknownNameError: A pattern matches no row.
    """
    more = (*GRASP, *SLOW) if include_deformables else ()
    known = (*OWN_IDS, *RIGID, *more)
    patterns = [part.strip() for text in only for part in text.split(",")]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownNameError("phenomenon", pattern, known)
    return tuple(
        name
        for name in known
        if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)
    )


def chooses_deformables(only: Sequence[str]) -> bool:
    """Return whether a pattern chooses a wall or deformable bodies: it is `*`, or matches no other row."""
    rigid = selection()
    return any(
        pattern == "*" or not any(fnmatchcase(name, pattern) for name in rigid)
        for pattern in only
    )
