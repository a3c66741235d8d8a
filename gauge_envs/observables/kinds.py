"""The kinds of generalized trajectory, their units, and the names of their coordinates."""

import math
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from gauge_envs.scene import Markers, Scene
from gauge_envs.scene.geometry import length_of


class Observable(StrEnum):
    """Kind of generalized trajectory g(t)."""

    POSITION = "position"
    """Positions of the recorded bodies [mm]."""
    CURVATURE = "curvature"
    """Angle deficit at each marker [rad]."""
    LINE_CURVATURE = "line_curvature"
    """Turning angle at each inner marker of a line [rad]."""
    FACE_AREA = "face_area"
    """Areas of the marker triangles [mm^2]."""
    MARKER_POSITION = "marker_position"
    """Marker positions [mm]."""

    @property
    def unit(self) -> str:
        """Unit of g(t)."""
        if self in (Observable.CURVATURE, Observable.LINE_CURVATURE):
            return "rad"
        return "mm^2" if self is Observable.FACE_AREA else "mm"


def largest_distance(
    observable: Observable, scene: Scene, *, recorded: Sequence[str]
) -> float:
    """Return a bound on the root mean square distance between two motions of a scene, in the unit of g(t).

    - Positions: both motions begin at the start of the scene, and no body is faster than its speed limit.
    - Turning angles lie in [0, pi].
    - The angle deficit at a marker changes by at most pi for each face there, the range of an angle.
    - The area of a triangle is at most half the product of two sides. Two markers of a solid move apart by no more than
      its drivers move, and without drivers as far as positions may.

    Args:
        observable: Kind of generalized trajectory.
        scene: The scene.
        recorded: Bodies whose positions are observed.
    """
    reach_mm = 2e3 * scene.speed_limit_m_per_s * scene.duration_s
    if observable is Observable.POSITION:
        return math.sqrt(len(recorded)) * reach_mm
    markers = scene.markers
    if markers is None:
        return math.inf
    places_mm = 1e3 * np.asarray(markers.positions_m)
    if observable is Observable.MARKER_POSITION:
        return math.sqrt(len(places_mm)) * reach_mm
    if observable is Observable.LINE_CURVATURE:
        names = coordinate_names(observable, recorded=recorded, markers=markers)
        return math.sqrt(len(names)) * math.pi
    faces = np.asarray(markers.faces)
    if observable is Observable.CURVATURE:
        faces_at = np.bincount(faces.ravel(), minlength=len(places_mm))
        return math.pi * length_of(faces_at)
    if scene.drivers:
        reach_mm = sum(
            1e3 * scene.duration_s * one.speed_limit_m_per_s(scene.body(one.body))
            for one in scene.drivers
        )
    corners_mm = places_mm[faces]
    sides_mm = np.linalg.norm(corners_mm - np.roll(corners_mm, 1, axis=1), axis=2)
    one, other = np.sort(sides_mm + reach_mm, axis=1)[:, :2].T
    return length_of(0.5 * one * other)


def coordinate_names(
    observable: Observable, *, recorded: Sequence[str], markers: Markers | None
) -> tuple[str, ...]:
    """Return the names of the coordinates of g(t): `cube.x`, `marker-3.x`, `marker-3` (curvature) or `face-3` (area).

    Args:
        observable: Kind of generalized trajectory.
        recorded: Bodies whose positions are observed.
        markers: Markers of the scene, or None.
    """
    if observable is Observable.POSITION:
        return tuple(f"{body}.{axis}" for body in recorded for axis in "xyz")
    if markers is None:
        return ()
    if observable is Observable.FACE_AREA:
        return tuple(f"face-{index}" for index in range(len(markers.faces)))
    if observable is Observable.LINE_CURVATURE:
        inner = {start for start, _ in markers.lines} & {
            end for _, end in markers.lines
        }
        return tuple(f"marker-{index}" for index in sorted(inner))
    names = [f"marker-{index}" for index in range(len(markers.positions_m))]
    if observable is Observable.CURVATURE:
        return tuple(names)
    return tuple(f"{name}.{axis}" for name in names for axis in "xyz")
