"""Geometry and attachments of ropes and rods, for every engine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.shared.attachments import RigidAttachment
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Rod, Rope

LINE_AXIS = {Rope: "x", Rod: "z"}
"""Axis of its frame along which a line lies."""


def points_on_axis(line: Rope | Rod, places_m: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the world positions of points on a line at the start [m], shape [place_count, 3].

    Args:
        line: The rope or rod.
        places_m: Signed distances of the points from the middle of the line [m], shape [place_count].
    """
    points = np.zeros((len(places_m), 3))
    points[:, "xyz".index(LINE_AXIS[type(line)])] = places_m
    return line.pose.to_world(points)


def attached_ends(line: Rope | Rod, attachments: Sequence[RigidAttachment]) -> dict[str, RigidAttachment]:
    """Return the attachments of the ends of a line, by side: `low` or `high`."""
    ends: dict[str, RigidAttachment] = {}
    for attachment in attachments:
        if attachment.region.axis != LINE_AXIS[type(line)] or attachment.region.side in ends:
            raise UnsupportedSceneError(
                f"{line.name!r} is attached elsewhere than at its two ends: attach each end once"
            )
        ends[attachment.region.side] = attachment
    depth_m = sum(attachment.region.depth_m for attachment in ends.values())
    if isinstance(line, Rope) and depth_m > 0.0:
        raise UnsupportedSceneError(f"rope {line.name!r} is attached over a length: set the region's depth_m to 0")
    if depth_m >= line.length_m:
        raise UnsupportedSceneError(f"{line.name!r} is attached over all of its length: reduce the regions' depth_m")
    return ends
