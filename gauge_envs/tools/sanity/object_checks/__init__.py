"""Checks of measured objects in GAUGE's experiments, each with a number, its scatter and its source."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial

from gauge_envs.tools.sanity.object_checks import (
    foot,
    friction,
    grasp,
    rigid,
)
from gauge_envs.tools.sanity.object_checks.check import ObjectCheck
from gauge_envs.tools.sanity.robot.foot import REFERENCE_FOOT, FootGeometry

FOOT: Mapping[str, Callable[[FootGeometry], ObjectCheck]] = {
    "foot-creep": foot.creep,
    "foot-push": foot.push,
    "foot-slide": foot.steep_slide,
}
"""Checks of the target's foot by id, in their order."""

Maker = Callable[[], ObjectCheck]

BODIES: Mapping[str, Maker] = {
    "creep-wood": partial(friction.creep, "wood"),
    "creep-plastic": partial(friction.creep, "plastic"),
    "creep-metal": partial(friction.creep, "metal"),
    "rest-height": partial(friction.rest_height, "wood"),
    "slide-wood": partial(friction.slide, "wood"),
    "slide-plastic": partial(friction.slide, "plastic"),
    "slide-metal": partial(friction.slide, "metal"),
    "slide-turned": partial(friction.turned_slide, "wood"),
    "rebound": rigid.rebound,
}
"""Checks of other rigid bodies."""

RIGID = (*FOOT, *BODIES)
"""Ids of the checks of rigid bodies."""

GRASP: Mapping[str, Maker] = {
    "grasp-creep": grasp.creep,
    "grasp-sink": grasp.sink,
}
"""Checks of grasps; run where a model has a hand, or by name."""

MAKERS = {**BODIES, **GRASP}


@cache
def object_check(name: str, foot: FootGeometry = REFERENCE_FOOT) -> ObjectCheck:
    """Return a check of measured objects.

    Args:
        name: Its id.
        foot: Foot of the target, for checks that need one; that of a small quadruped by default.
    """
    if name in FOOT:
        return replace(FOOT[name](foot), id=name)
    return replace(MAKERS[name](), id=name)
