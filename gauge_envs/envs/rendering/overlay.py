"""What a picture can have on top of its scene: tracked points, paths and translucent bodies.

An overlay is plain data in the world frame. It changes no body and no camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError, ShapeError

FloatArray = NDArray[np.float64]

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity from 0 to 1."""

SIMULATED_COLOR: Color = (0.07, 0.33, 0.85, 1.0)
"""Colour of what a simulation did: tracked points and their paths."""
RECORDED_COLOR: Color = (0.85, 0.05, 0.38, 1.0)
"""Colour of the reference, as the mean of the real trials."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OverlayPath:
    """A line through points, drawn as a thin tube.

    Attributes:
        points_m: Points in order [m], shape [point_count, 3]; the tube has a gap at a point that is not finite.
        color: Red, green, blue and opacity from 0 to 1.
    """

    points_m: FloatArray
    color: Color = SIMULATED_COLOR

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", _points("points_m", self.points_m))
        _check_color(self.color)


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlay:
    """Tracked points, paths and translucent bodies of one picture.

    Attributes:
        markers_m: Points of the simulation [m], shape [n, 3], drawn as small bright balls. A point that is not finite
            is left out, here and in `recorded_m`.
        recorded_m: Points of the reference at the same time [m], shape [n, 3], in the colour of the reference.
        paths: Paths, as of the simulation so far or of the reference.
        ghosts: Bodies that are drawn once more, translucent and with their own shape: position [m] and quaternion
            w x y z by name of the body, shape [7]. Deformable bodies have no pose; draw their points as `recorded_m`.
        ghost_color: Colour of the ghosts.

    Example:
        >>> import numpy as np
        >>> overlay = Overlay(
        ...     markers_m=np.zeros((1, 3)), paths=(OverlayPath(points_m=np.array([[0, 0, 0], [0, 0, 0.1]])),)
        ... )
        >>> overlay.geom_count
        2
    """

    markers_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    recorded_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    paths: tuple[OverlayPath, ...] = ()
    ghosts: Mapping[str, FloatArray] = field(default_factory=dict)
    ghost_color: Color = (*RECORDED_COLOR[:3], 0.35)

    def __post_init__(self) -> None:
        for name in ("markers_m", "recorded_m"):
            object.__setattr__(self, name, _points(name, getattr(self, name)))
        ghosts = {name: np.asarray(pose, dtype=np.float64) for name, pose in self.ghosts.items()}
        for name, pose in ghosts.items():
            if pose.shape != (7,):
                raise ShapeError(
                    f"ghosts[{name!r}] has shape {pose.shape}; [7] is needed: position, quaternion w x y z"
                )
        object.__setattr__(self, "ghosts", ghosts)
        _check_color(self.ghost_color)

    @property
    def geom_count(self) -> int:
        """Number of balls and tubes; ghosts come on top of it."""
        tubes = sum(max(len(path.points_m) - 1, 0) for path in self.paths)
        return len(self.markers_m) + len(self.recorded_m) + tubes


def _points(name: str, values: FloatArray) -> FloatArray:
    points = np.asarray(values, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ShapeError(f"{name} has shape {points.shape}; [point_count, 3] is needed")
    return points


def _check_color(color: Color) -> None:
    if len(color) != 4 or not all(0.0 <= part <= 1.0 for part in color):
        raise ParameterError(f"colour {color!r}: expected red, green, blue and opacity from 0 to 1")
