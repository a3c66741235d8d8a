"""Three moments of an episode: markers in space beside those of the reference, with distances as colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gauge_envs.pages.figures import REAL
from gauge_envs.pages.text import quantity_text
from gauge_envs.scene import Markers
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare.panels import DISTANCE_COLORS, Series
from gauge_envs.tools.compare.yardstick import Yardstick, recorded_of

if TYPE_CHECKING:
    from matplotlib.figure import SubFigure

LEAST_UPRIGHT = 0.1
"""Share of the squared normals of faces that is level, from which on a sheet has a front."""
LEAST_LOOSE = 10
"""Number of markers without lines between them, from which on they show a shape."""
MOMENTS = 3
"""Number of moments that are drawn."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Moments:
    """Markers of one configuration and of the reference, and their distances.

    Attributes:
        one: The configuration.
        markers: Their lines and faces.
        places_mm: Simulated markers at the frames [mm], shape [frame_count, marker_count, 3].
        reference_mm: The same of the reference, NaN where it is not known; None where it has no markers.
        sizes: Distance of each marker, or of the area of each face, shape [frame_count, marker_count or face_count].
        unit: Unit of `sizes`.
    """

    one: Series
    markers: Markers
    places_mm: FloatArray
    reference_mm: FloatArray | None
    sizes: FloatArray
    unit: str

    @property
    def frames(self) -> tuple[int, ...]:
        """Frames that are drawn: of the largest distance, the last one, and those at half and a quarter of the time."""
        known = np.flatnonzero(np.isfinite(self.sizes).all(axis=1))
        if not len(known):
            return ()
        largest = known[int(self.sizes[known].sum(axis=1).argmax())]
        wanted = (largest, known[-1], known[len(known) // 2], known[len(known) // 4])
        return tuple(sorted(list(dict.fromkeys(map(int, wanted)))[:MOMENTS]))


def moments_of(
    one: Series, against: Yardstick, markers: Markers | None
) -> Moments | None:
    """Return the markers of a configuration; None where they are not known or not compared."""
    if markers is None:
        return None
    result, count = one.first, len(markers.positions_m)
    # A few loose points in space show no shape.
    if count < LEAST_LOOSE and not (markers.faces or markers.lines):
        return None
    names = tuple(f"marker-{index}" for index in range(count))
    deviation = against.deviation(result, aligned=False)
    if against.points == names:
        places = _frames_of(*against.motion(result), len(deviation)).reshape(
            -1, count, 3
        )
        reference = (
            None if against.of_start else against.band.mean.reshape(-1, count, 3)
        )
        sizes = against.per_point(deviation)[1]
    else:
        found = recorded_of(result).markers_m()
        if found is None or found.shape[1] != count:
            return None
        places = np.full((len(deviation), count, 3), np.nan)
        places[: len(found)] = 1e3 * found[: len(places)]
        reference, sizes = None, np.abs(deviation)
        if sizes.shape[1] != len(markers.faces):
            return None
    return Moments(
        one=one,
        markers=markers,
        places_mm=places,
        reference_mm=reference,
        sizes=sizes,
        unit=against.unit,
    )


def _frames_of(times_s: FloatArray, values: FloatArray, count: int) -> FloatArray:
    """Return values at the frames, shape [count, C]; NaN where they are not known."""
    whole = np.full((count, values.shape[1]), np.nan)
    numbers = np.rint(times_s * FRAME_RATE_HZ).astype(int)
    hits = (np.abs(times_s - numbers / FRAME_RATE_HZ) < 1e-4) & (numbers < count)
    whole[numbers[hits]] = values[hits]
    return whole


def draw_moments(
    figure: SubFigure, every: Sequence[Moments], *, reference: str
) -> None:
    """Draw three moments of each configuration in a row, each beside the reference where its markers are known.

    Args:
        figure: Where to.
        every: One for each row.
        reference: Name of the reference.
    """
    has_reference = every[0].reference_mm is not None
    columns = MOMENTS * (2 if has_reference else 1)
    top = max(
        float(np.nanmax(one.sizes[list(one.frames)], initial=0.0)) for one in every
    )
    grid = figure.add_gridspec(len(every), columns, wspace=0.0, hspace=0.0)
    axes: list[Any] = []
    drawn = None
    for row, moments in enumerate(every):
        shown = [moments.places_mm[list(moments.frames)]]
        if moments.reference_mm is not None:
            shown.append(moments.reference_mm[list(moments.frames)])
        box = _box(np.concatenate(shown), moments.markers.faces)
        for number, frame in enumerate(moments.frames):
            time = f"{quantity_text(frame / FRAME_RATE_HZ)} s"
            if moments.reference_mm is not None:
                axis = figure.add_subplot(grid[row, 2 * number], projection="3d")
                _draw_net(
                    axis, moments.markers, moments.reference_mm[frame], color=REAL
                )
                _frame_space(axis, box, f"{time}: {reference}")
                axes.append(axis)
            place = (2 * number + 1) if has_reference else number
            axis = figure.add_subplot(grid[row, place], projection="3d")
            if moments.reference_mm is not None:
                # A simulation lies on the reference, also where it is behind it.
                axis.computed_zorder = False
                _draw_net(
                    axis, moments.markers, moments.reference_mm[frame], color="#b0b0b0"
                )
            drawn = _draw_sizes(axis, moments, frame, top or 1e-9)
            _frame_space(
                axis,
                box,
                moments.one.label if has_reference else f"{time}: {moments.one.label}",
                color=moments.one.color,
            )
            axes.append(axis)
    if drawn is not None:
        bar = figure.colorbar(drawn, ax=axes, pad=0.01, shrink=0.8)
        what = "distance" if every[0].unit == "mm" else "difference of area"
        bar.set_label(f"{what} [{every[0].unit}]", fontsize=9)
        bar.ax.tick_params(labelsize=8)


def _edges(markers: Markers) -> Iterator[tuple[int, int]]:
    """Yield the lines between markers, and the sides of their faces."""
    sides = [
        (face[one], face[(one + 1) % 3]) for face in markers.faces for one in range(3)
    ]
    yield from dict.fromkeys(
        (min(pair), max(pair)) for pair in (*markers.lines, *sides)
    )


def _draw_net(axis: Any, markers: Markers, places: FloatArray, *, color: str) -> None:
    """Draw markers and the lines between them."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    lines = [places[list(pair)] for pair in _edges(markers)]
    if lines:
        axis.add_collection3d(Line3DCollection(lines, colors=color, linewidths=0.6))
    axis.scatter(*places.T, s=3.0, color=color, depthshade=False)


def _draw_sizes(axis: Any, moments: Moments, frame: int, top: float) -> Any:
    """Draw markers, or faces, with their distances as colour; return what has the colours."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    places, sizes = moments.places_mm[frame], moments.sizes[frame]
    look = {"cmap": DISTANCE_COLORS}
    if len(sizes) == len(places) and len(sizes) != len(moments.markers.faces):
        _draw_net(axis, moments.markers, places, color="#606060")
        return axis.scatter(
            *places.T,
            c=sizes,
            s=22.0,
            vmin=0.0,
            vmax=top,
            depthshade=False,
            edgecolors="#606060",
            linewidths=0.4,
            zorder=5,
            **look,
        )
    faces = Poly3DCollection(
        places[np.array(moments.markers.faces)],
        array=sizes,
        edgecolors="#606060",
        linewidths=0.5,
        zorder=5,
        **look,
    )
    faces.set_clim(0.0, top)
    axis.add_collection3d(faces)
    return faces


def _box(
    places: FloatArray, faces: Sequence[tuple[int, int, int]]
) -> tuple[FloatArray, float, float]:
    """Return the middle, half the width of a cube around places, and direction [degrees] that they are wide from.

    Args:
        places: Markers at the moments, shape [moment_count, marker_count, 3].
        faces: Triangles of markers; empty for markers in lines.
    """
    every = places.reshape(-1, 3)
    every = every[np.isfinite(every).all(axis=1)]
    low, high = every.min(axis=0), every.max(axis=0)
    away = np.linalg.eigh(np.cov(every[:, :2].T))[1][:, 0]
    if faces:
        corners = places[:, np.array(faces)].reshape(-1, 3, 3)
        corners = corners[np.isfinite(corners).all(axis=(1, 2))]
        sides = corners[:, 1:] - corners[:, :1]
        normals = np.cross(sides[:, 0], sides[:, 1])
        turned = normals[:, :2].T @ normals[:, :2]
        upright = np.trace(turned) / np.square(normals).sum()
        # Of a level sheet, no side is its front.
        if upright > LEAST_UPRIGHT:
            away = np.linalg.eigh(turned)[1][:, -1]
    toward = float(np.degrees(np.arctan2(away[1], away[0])))
    return 0.5 * (low + high), 0.5 * float((high - low).max()), toward


def _frame_space(
    axis: Any, box: tuple[FloatArray, float, float], title: str, color: str = REAL
) -> None:
    """Show a cube of space without its axes."""
    middle, half, toward = box
    for limit, center in zip(
        (axis.set_xlim, axis.set_ylim, axis.set_zlim), middle, strict=True
    ):
        limit(center - half, center + half)
    axis.set_proj_type("ortho")
    axis.view_init(elev=20.0, azim=toward + 25.0)
    axis.set_box_aspect((1.0, 1.0, 1.0), zoom=1.1)
    axis.set_axis_off()
    axis.set_title(title, fontsize=8, color=color, pad=0.0)
