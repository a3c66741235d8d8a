"""Ids of all checks in their order, and their choice by patterns."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from gauge_envs.errors import UnknownNameError
from gauge_envs.tools.sanity.itself import free_rows, rest_rows
from gauge_envs.tools.sanity.phenomena import GRASP, RIGID, SLOW
from gauge_envs.tools.sanity.robot import (
    ground_rows,
    joint_rows,
    mass_rows,
    rollout,
)
from gauge_envs.tools.sanity.rows import ROWS

MODEL_CHECKS = (rest_rows, free_rows, ground_rows, joint_rows, mass_rows, rollout)
"""Modules with the checks of the target's own model, in their order."""

GRAVITY_ID, CONTROL_ID = "gravity", "control-step"
"""Checks of numbers that a target gives."""

MODEL_IDS = tuple(
    row.id
    for module in MODEL_CHECKS
    for row in ROWS.values()
    if row.measure.__module__ == module.__name__
)

TARGET_IDS = (*MODEL_IDS, GRAVITY_ID, CONTROL_ID)
"""Checks of the target itself, which run none of the suite's experiments."""

SIMULATED_IDS = frozenset(
    {
        *("model-overlap", "model-constraints", "model-sleep", "model-creep"),
        *("model-cloth", "model-cloth-sink", "model-solver", "model-spin"),
        *("robot-holds", "robot-energy", "robot-stands"),
        *("robot-torque", "robot-drive"),
    }
)
"""Checks that run the target's own model, so that settings of the engine can change them."""


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
    more = (*GRASP, *SLOW) if include_deformables else ()
    known = (*TARGET_IDS, *RIGID, *more)
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
    """Return whether a pattern chooses a wall or deformable bodies: it is `*`, or matches no other check."""
    rigid = selection()
    return any(
        pattern == "*" or not any(fnmatchcase(name, pattern) for name in rigid)
        for pattern in only
    )
