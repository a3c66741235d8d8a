"""Ropes and rods, whatever the engine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Rod, Rope

__all__ = [
    "LINE_AXIS",
    "attached_ends",
    "points_on_axis",
]

LINE_AXIS = {Rope: "x", Rod: "z"}
"""Axis of its frame along which a line lies."""


def points_on_axis(line: Rope | Rod, places_m: NDArray[np.floating]) -> NDArray[np.float64]:
    """World positions at the start of places along a line, from its middle [m], shape [place_count, 3]."""
    points = np.zeros((len(places_m), 3))
    points[:, "xyz".index(LINE_AXIS[type(line)])] = places_m
    return line.pose.to_world(points)


def attached_ends(line: Rope | Rod, glued: Sequence[RigidAttachment]) -> dict[str, RigidAttachment]:
    """What the ends of a line are glued to, by side: `low` or `high`.

    Raises:
        UnsupportedSceneError: Something else than an end is glued, a length of a rope, or all of a rod.
    """
    ends: dict[str, RigidAttachment] = {}
    for glue in glued:
        if glue.region.axis != LINE_AXIS[type(line)] or glue.region.side in ends:
            raise UnsupportedSceneError(f"{line.name!r} is glued elsewhere than at its two ends")
        ends[glue.region.side] = glue
    depth_m = sum(glue.region.depth_m for glue in ends.values())
    if isinstance(line, Rope) and depth_m > 0.0:
        raise UnsupportedSceneError(f"rope {line.name!r} is glued over a length, not at its end")
    if depth_m >= line.length_m:
        raise UnsupportedSceneError(f"{line.name!r} is glued over all of its length")
    return ends
