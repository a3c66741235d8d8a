"""Phenomena of real objects in GAUGE's experiments, each with one number, its scatter and its source."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from gauge_envs.errors import UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.phenomena.base import Phenomenon
    from gauge_envs.tools.sanity.robot.foot import FootGeometry

GRAVITY_ID, CONTROL_ID = "gravity", "control-step"
"""Rows on what a target states, which need no rollout."""

_TABLES = tomllib.loads(
    (Path(__file__).parent / "phenomena.toml").read_text(encoding="utf-8")
)

ROBOT_IDS = tuple(_TABLES["robot"])
"""Rows on the target's own model: its rollout, and what it states."""

STATED_IDS = (GRAVITY_ID, CONTROL_ID, *ROBOT_IDS)
"""Rows that run none of the suite's experiments."""

UNCHANGED_IDS = frozenset(ROBOT_IDS) - {
    *("model-overlap", "model-constraints", "model-sleep", "model-creep"),
    *("model-cloth", "model-cloth-sink", "model-solver", "model-spin"),
    *("robot-holds", "robot-energy"),
    *("robot-stands", "robot-slip", "robot-torque", "robot-drive"),
}
"""Rows on the robot that no setting of the engine changes."""

RIGID: Mapping[str, Sequence[str]] = _TABLES["rigid"]
"""Module, function and argument of the phenomena of rigid bodies by id, in the order of their rows."""

GRASP: Mapping[str, Sequence[str]] = _TABLES["grasp"]
"""The same for what a hand holds; measured of a model that has a hand, or by name."""

DEFORMABLE: Mapping[str, Sequence[str]] = _TABLES["deformable"]
"""The same for deformable bodies."""


@cache
def phenomenon(name: str, foot: FootGeometry | None = None) -> Phenomenon:
    """Return a phenomenon by its id.

    Args:
        name: The id.
        foot: Foot of the target, for rows that need one; that of a small quadruped if None.
    """
    module, function, *arguments = {**RIGID, **GRASP, **DEFORMABLE}[name]
    make = getattr(import_module(f"{__name__}.{module}"), function)
    made: Phenomenon = make(*arguments) if foot is None else make(foot)
    return replace(made, id=name)


def phenomena(
    only: Sequence[str] = (), *, include_deformables: bool = False
) -> tuple[Phenomenon, ...]:
    """Return the phenomena of `selection`."""
    chosen = selection(only, include_deformables=include_deformables)
    return tuple(phenomenon(name) for name in chosen if name not in STATED_IDS)


def selection(
    only: Sequence[str] = (), *, include_deformables: bool = False
) -> tuple[str, ...]:
    """Return ids of rows in a fixed order: all, or those that match one of the patterns.

    Args:
        only: Ids or patterns such as `creep-*`, also several in one text with commas; all when empty.
        include_deformables: Whether to include phenomena of deformable bodies and of grasps.
    """
    more = (*GRASP, *DEFORMABLE) if include_deformables else ()
    known = (*STATED_IDS, *RIGID, *more)
    patterns = [part.strip() for text in only for part in text.split(",")]
    chosen = set() if any(patterns) else {*known}
    for pattern in filter(None, patterns):
        matching = {name for name in known if fnmatchcase(name, pattern)}
        if not matching:
            raise UnknownNameError("phenomenon", pattern, known)
        chosen |= matching
    return tuple(name for name in known if name in chosen)
