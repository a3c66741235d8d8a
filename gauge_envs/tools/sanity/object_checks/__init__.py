"""Checks of measured objects in GAUGE's experiments, each with a number, its scatter and its source."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial

from gauge_envs.tools.sanity.object_checks import friction
from gauge_envs.tools.sanity.object_checks.check import ObjectCheck

OBJECT_CHECKS: Mapping[str, Callable[[], ObjectCheck]] = {
    "creep-wood": partial(friction.creep, "wood"),
    "creep-plastic": partial(friction.creep, "plastic"),
    "creep-metal": partial(friction.creep, "metal"),
    "rest-height": partial(friction.rest_height, "wood"),
    "slide-wood": partial(friction.slide, "wood"),
    "slide-plastic": partial(friction.slide, "plastic"),
    "slide-metal": partial(friction.slide, "metal"),
    "slide-turned": partial(friction.turned_slide, "wood"),
}
"""Functions that make the checks, by id, in their order."""


@cache
def object_check(name: str) -> ObjectCheck:
    """Return a check of measured objects by its id."""
    return replace(OBJECT_CHECKS[name](), id=name)
