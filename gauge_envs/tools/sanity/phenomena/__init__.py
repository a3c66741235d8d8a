"""Phenomena of real objects in GAUGE's experiments, each with one number, its scatter and its source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from gauge_envs.errors import UnknownNameError

if TYPE_CHECKING:
    from gauge_envs.tools.sanity.phenomena.base import Phenomenon
    from gauge_envs.tools.sanity.robot.foot import FootGeometry

__all__ = ["CAPACITY_ID", "GRAVITY_ID", "RELEASE_ID", "RIGID", "ROBOT_IDS", "phenomena", "phenomenon", "selection"]

GRAVITY_ID, CAPACITY_ID = "gravity", "contact-capacity"
"""Rows on what a target states, which need no rollout."""

RELEASE_ID = "release"
"""Row on a body that touches the ground at the start."""

ROBOT_IDS = (
    *("robot-holds", "robot-stands", "robot-loads", "robot-saturation", "robot-slip", "robot-overlap", "robot-energy"),
    *("robot-feet", "robot-friction", "robot-floor-friction", "floor-tilt"),
    *("robot-density", "robot-bound", "robot-gravcomp", "robot-inertia"),
    *("robot-servo", "robot-torque", "robot-damping", "robot-frictionloss", "robot-armature"),
    *("robot-dry", "robot-lag", "robot-sag", "robot-action", "robot-delay"),
)
"""Rows on the target's own model: its rollout, and what it states."""

MATERIALS = ("wood", "plastic", "metal")
"""Materials of the cubes."""

RIGID: Mapping[str, tuple[str, ...]] = {
    "foot-creep": ("foot", "creep"),
    "foot-push": ("foot", "push"),
    "foot-slide": ("foot", "slide"),
    "foot-landing-depth": ("foot", "depth"),
    "foot-rebound": ("foot", "rebound"),
    "foot-rest": ("foot", "rest"),
    **{f"creep-{material}": ("friction", "creep", material) for material in MATERIALS},
    "rest-height": ("friction", "rest_height", "wood"),
    RELEASE_ID: ("friction", "thrown", "wood"),
    **{f"slide-{material}": ("friction", "slide", material) for material in MATERIALS},
    "slide-turned": ("friction", "turned_slide", "wood"),
    "rebound": ("impact", "rebound"),
    "rebound-slow": ("impact", "slow_rebound"),
    "momentum": ("impact", "momentum"),
    "period": ("rigid", "period"),
    "energy": ("rigid", "energy"),
    **{f"carry-{material}": ("friction", "carry", material) for material in MATERIALS},
    "slip": ("friction", "slip"),
    "seam": ("rigid", "seam"),
    "point": ("rigid", "point"),
    "wall-sag": ("rigid", "wall_sag"),
    "wall-drift": ("rigid", "wall_drift"),
}
"""Module, function and argument of the phenomena of rigid bodies by id, in the order of their rows."""

DEFORMABLE: Mapping[str, tuple[str, ...]] = {
    "cloth-carry": ("deformable", "cloth_carry"),
    "cloth-sag": ("deformable", "cloth_sag"),
    "fling-lag": ("deformable", "fling_lag"),
    "foam-stretch": ("deformable", "foam", "stretch", "FoamStretching-soft", "foam_stretching", "pulled"),
    "foam-compress": ("deformable", "foam", "compress", "FoamCompressing-soft", "foam_compressing", "compressed"),
    "beam": ("deformable", "beam"),
    "rope-length": ("deformable", "rope_length"),
    "foot-lag": ("deformable", "foot_lag"),
}
"""The same for deformable bodies."""


def _known(*, include_deformables: bool) -> tuple[str, ...]:
    return (*RIGID, *DEFORMABLE) if include_deformables else tuple(RIGID)


@cache
def phenomenon(name: str, foot: FootGeometry | None = None) -> Phenomenon:
    """Return a phenomenon by its id.

    Args:
        name: The id.
        foot: Foot of the target, for rows that need one; that of a small quadruped if None.
    """
    module, function, *arguments = {**RIGID, **DEFORMABLE}[name]
    make = getattr(import_module(f"{__name__}.{module}"), function)
    made: Phenomenon = make(*arguments) if foot is None else make(foot)
    return replace(made, id=name)


def phenomena(only: Sequence[str] = (), *, include_deformables: bool = False) -> tuple[Phenomenon, ...]:
    """Return all phenomena in a fixed order, or those whose id matches one of the patterns.

    Args:
        only: Ids or patterns such as `creep-*`; all when empty.
        include_deformables: Whether to include phenomena of deformable bodies.
    """
    return tuple(map(phenomenon, _matching(only, _known(include_deformables=include_deformables))))


def selection(only: Sequence[str] = (), *, include_deformables: bool = False) -> tuple[str, ...]:
    """Return ids of rows in a fixed order: all, or those that match one of the patterns.

    Args:
        only: Ids or patterns such as `creep-*`, also several in one text with commas; all when empty.
        include_deformables: Whether to include phenomena of deformable bodies.
    """
    patterns = [part.strip() for text in only for part in text.split(",") if part.strip()]
    return _matching(patterns, (GRAVITY_ID, CAPACITY_ID, *ROBOT_IDS, *_known(include_deformables=include_deformables)))


def _matching(patterns: Sequence[str], known: tuple[str, ...]) -> tuple[str, ...]:
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownNameError("phenomenon", pattern, known)
    return tuple(name for name in known if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns))
