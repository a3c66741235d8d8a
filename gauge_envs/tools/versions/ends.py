"""How the motions of two versions end: which body stands, falls, moves or explodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from gauge_envs.tools.versions.gap import NOISE_FACTOR
from gauge_envs.tools.versions.model import Settled

END_TOLERANCE_M = 1e-3
"""Least distance between two ends of a body that counts [m]."""

EXPLODING_SPEED = 100.0
"""Velocity that no body of a robot's scene has [m/s or rad/s]."""

DEEP_M = 5e-3
"""Depth of a contact beyond which a body is inside another one [m]."""

FALL_M = 0.03
"""Way down that is a fall [m]."""

STANDING_M, STANDING_M_PER_S = 1e-2, 0.1
"""Displacement [m] and speed [m/s] of a body that stands."""


def settled(one: Mapping[str, Any], two: Mapping[str, Any]) -> Iterator[Settled]:
    """Yield the segments that end differently, by more than what chaos makes of nothing."""
    for before, after in zip(one["ends"], two["ends"], strict=True):
        ends = [np.array(side["positions_m"]) for side in (before, after)]
        difference = np.linalg.norm(ends[0] - ends[1], axis=1)
        noise = 0.0
        for side in (before, after):
            change = np.subtract(side["perturbed_positions_m"], side["positions_m"])
            noise = np.fmax(noise, np.max(np.linalg.norm(change, axis=1)))
        body = int(np.argmax(np.nan_to_num(difference, nan=np.inf)))
        if difference[body] <= max(END_TOLERANCE_M, NOISE_FACTOR * noise):
            continue
        moved = []
        for side in (before, after):
            start_m, end_m = side["first_positions_m"][body], side["positions_m"][body]
            moved.append(float(np.linalg.norm(np.subtract(end_m, start_m))))
        yield Settled(
            segment=before["segment"],
            body=one["names"]["body"][body],
            difference_m=float(difference[body]),
            noise_m=float(noise),
            moved_before_m=moved[0],
            moved_after_m=moved[1],
            depth_before_m=before["depths_m"][body],
            depth_after_m=after["depths_m"][body],
            speed_before_m_per_s=before["speeds"][body],
            speed_after_m_per_s=after["speeds"][body],
            end_before=_end(before, body, moved[0]),
            end_after=_end(after, body, moved[1]),
        )


def _end(end: Mapping[str, Any], body: int, moved_m: float) -> str:
    is_bad = any(name.startswith("mjWARN_BAD") for name in end["warnings"])
    if is_bad or not end["largest_speed"] < EXPLODING_SPEED:
        return "explodes"
    if end["fallen_m"][body] > FALL_M:
        return "falls"
    if end["depths_m"][body] > DEEP_M:
        return "penetrates"
    is_still = moved_m < STANDING_M and end["speeds"][body] < STANDING_M_PER_S
    return "stands" if is_still else "moves"
