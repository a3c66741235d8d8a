"""Depth of two convex shapes by their geometry: the shortest way out, as closed forms and by separating axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gauge_envs.scene.geometry import FloatArray, length_of

PARALLEL = 1e-9
"""Length of a cross product below which two edges are parallel."""


@dataclass(frozen=True)
class Solid:
    """A box or a ball at a pose.

    Attributes:
        half_sizes_m: Half sizes of a box, shape [3]; 0 for a ball.
        radius_m: Radius of a ball; 0 for a box.
        position_m: Centre, shape [3].
        rotation: Axes of a box as columns, shape [3, 3].
    """

    half_sizes_m: FloatArray
    radius_m: float
    position_m: FloatArray
    rotation: FloatArray


def depth_m(one: Solid, two: Solid) -> float:
    """Return how far two solids must move apart to touch no more [m]; negative for a gap between them."""
    if two.radius_m:
        return _ball_m(one, two)
    return _ball_m(two, one) if one.radius_m else _box_box_m(one, two)


def _ball_m(other: Solid, ball: Solid) -> float:
    """Return the depth of a ball in a box or another ball."""
    inside = other.rotation.T @ (ball.position_m - other.position_m)
    outside = np.abs(inside) - other.half_sizes_m
    radius_m = ball.radius_m + other.radius_m
    if np.all(outside <= 0.0):
        # The centre leaves by the nearest face.
        return radius_m - float(np.max(outside))
    return radius_m - length_of(np.maximum(outside, 0.0))


def _box_box_m(one: Solid, two: Solid) -> float:
    """Return the smallest overlap on the 15 axes on which two boxes can be apart (Gottschalk et al. 1996)."""
    between = two.position_m - one.position_m
    axes = [*one.rotation.T, *two.rotation.T]
    for first in one.rotation.T:
        for second in two.rotation.T:
            cross = np.cross(first, second)
            length = length_of(cross)
            if length > PARALLEL:
                axes.append(cross / length)
    overlaps = []
    for axis in axes:
        reach = np.abs(axis @ one.rotation) @ one.half_sizes_m
        reach += np.abs(axis @ two.rotation) @ two.half_sizes_m
        overlaps.append(float(reach - abs(axis @ between)))
    return min(overlaps)
