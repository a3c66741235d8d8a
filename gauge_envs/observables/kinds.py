"""The kinds of generalized trajectory, their units, and the names of their coordinates."""

from collections.abc import Sequence
from enum import StrEnum

from gauge_envs.scene import Markers


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

    @property
    def is_of_places(self) -> bool:
        """Whether g(t) has the places of bodies or markers, x, y and z of each."""
        return self in (Observable.POSITION, Observable.MARKER_POSITION)


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
