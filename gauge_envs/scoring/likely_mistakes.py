"""Likely mistakes of trajectories from other simulators: another unit, other axes, another place, another rate.

A trajectory starts where the scene starts. Where it does not, this module says in words what makes the two agree.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import observe_markers
from gauge_envs.references.band import Band
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ

START_TOLERANCE_MM = 30.0
"""Largest distance of a point of the first frame from the start of the scene [mm].

It is 1.5 times the largest one of real trials, 19.9 mm. That was found in every second id with a real first frame. The
largest one of the others is 10 mm."""

AREA_RATIO = 3.0
"""Largest ratio of an area of the first frame and of the scene; it is 2 with the nearest node in place of a marker."""

DEGREES = 180.0 / math.pi
"""Factor of an angle in degrees."""

DEGREES_RANGE = 1.5
"""Factor by which an amplitude may miss that of degrees."""

DEGREES_CORRELATION = 0.9
"""Least correlation with the reference of angles that count as its own in degrees."""

LENGTHS = {1e-3: "metres", 0.1: "centimetres", 1.0 / 25.4: "inches", 1e3: "micrometres"}
"""Units of lengths by their values where mm are expected."""

AREAS = {1e-6: "square metres", 1e-2: "square centimetres", 1e6: "square micrometres"}
"""Units of areas by their values where mm^2 are expected."""

RATES_HZ = (24, 25, 50, 60, 90, 100, 120, 180, 200, 240, 250, 360, 400, 480, 500, 1000)
"""Frame rates that simulators write."""

LATER_FRAMES = 10
"""Largest number of frames after the last one: the release alignment uses them."""


def start_values(experiment: Experiment) -> FloatArray:
    """Return g(t) at the start of the scene, shape [coordinate_count]; no engine is needed."""
    scene, observable = experiment.scene, experiment.score.observable
    if observable is Observable.POSITION or scene.markers is None:
        poses = [scene.body(name).pose for name in experiment.recorded]
        return 1e3 * np.array([pose.position_m for pose in poses]).ravel()
    markers_m = np.asarray(scene.markers.positions_m)
    found: FloatArray = observe_markers(markers_m[None], scene.markers, observable)[0]
    return found


def value_mistake(
    experiment: Experiment,
    values: FloatArray,
    *,
    band: Band | None = None,
    tolerance_mm: float = START_TOLERANCE_MM,
) -> str | None:
    """Return what is probably wrong with the values of a trajectory, and what would be right; None if nothing is.

    Args:
        experiment: Experiment that was simulated.
        values: g(t) at the 30 Hz frames in the unit that is expected, shape [T, coordinate_count].
        band: Reference; angles are compared with it.
        tolerance_mm: Largest distance of a position from the start of the scene.
    """
    observable = experiment.score.observable
    start = start_values(experiment)
    if observable in (Observable.POSITION, Observable.MARKER_POSITION):
        names = [name.rpartition(".")[0] for name in experiment.coordinates[::3]]
        return place_mistake(
            values[0].reshape(-1, 3),
            start.reshape(-1, 3),
            names=names,
            tolerance=tolerance_mm,
        )
    if observable is Observable.FACE_AREA:
        return _area_mistake(values[0], start)
    return _angle_mistake(experiment, values, band)


@dataclass(frozen=True)
class _Axes:
    """Axes of a file, each an axis of the scene with a sign.

    Attributes:
        order: Axis of the scene for each of the file.
        signs: Its sign.
    """

    order: tuple[int, ...]
    signs: tuple[int, ...]

    def of_file(self, places: FloatArray) -> FloatArray:
        """Return places of the scene as the file states them."""
        found: FloatArray = places[:, self.order] * self.signs
        return found

    @property
    def words(self) -> str:
        """The mistake, and what would be right."""
        if self.order == (0, 1, 2):
            flipped = " and ".join(
                "xyz"[i] for i, sign in enumerate(self.signs) if sign < 0
            )
            return f"{flipped} mirrored: change the sign"
        stated = {
            scene: f"{'-' if sign < 0 else ''}{'xyz'[file]}"
            for file, (scene, sign) in enumerate(
                zip(self.order, self.signs, strict=True)
            )
        }
        right = ", ".join(stated[axis] for axis in range(3))
        return f"the axes of another frame: x, y, z of the scene, z up, are its {right}"


ALL_AXES = [
    _Axes(order, signs)
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
]


def place_mistake(
    places: FloatArray,
    start: FloatArray,
    *,
    names: Sequence[str],
    tolerance: float,
    unit: str = "mm",
) -> str | None:
    """Return what is probably wrong with the places of the first frame; None if they are near those of the scene.

    Args:
        places: Places in the unit that is expected, shape [point_count, 3].
        start: Places of the scene, likewise.
        names: Names of the points.
        tolerance: Largest distance of a point.
        unit: `mm` or `m`.
    """
    turned = min(ALL_AXES, key=lambda one: _farthest(places, one.of_file(start)))
    away, away_turned = (
        _farthest(places, one) for one in (start, turned.of_file(start))
    )
    # Where coordinates are alike, a file with other axes is within the tolerance, too, but fits its axes far better.
    is_turned = away > tolerance / 6.0 and away_turned < 0.1 * away
    if away <= tolerance and not is_turned:
        return None
    distances = np.linalg.norm(places - start, axis=1)
    worst = int(distances.argmax())
    stated = (
        f"the first frame has {names[worst]} at {_listed(places[worst])}, "
        f"and the scene at {_listed(start[worst])} {unit}"
    )
    if away <= tolerance:
        return f"{stated}: the values look like {turned.words}"
    lengths = LENGTHS if unit == "mm" else {1e3: "millimetres", 1e2: "centimetres"}
    for axes in ALL_AXES:
        for factor, word in lengths.items():
            if _farthest(places / factor, axes.of_file(start)) <= tolerance:
                also = "" if axes == ALL_AXES[0] else f", and like {axes.words}"
                return f"{stated}: the values look like {word}{also}. {_times(factor)}"
    if away_turned <= tolerance:
        return f"{stated}: the values look like {turned.words}"
    shift = (places - start).mean(axis=0)
    if len(places) > 1 and _farthest(places - shift, start) <= tolerance:
        return (
            f"{stated}: everything is shifted by {_listed(shift)} {unit}. Subtract that"
        )
    return (
        f"{stated}, {distances[worst]:.3g} {unit} apart; real starts are within {tolerance:.3g} {unit}. "
        "Start there, in the frame of the scene, z up; or state the start as a parameter, as 'cube.position_m'"
    )


def _farthest(places: FloatArray, start: FloatArray) -> float:
    return float(np.linalg.norm(places - start, axis=1).max())


def _listed(numbers: FloatArray) -> str:
    return f"({', '.join(f'{number:.4g}' for number in numbers)})"


def _times(factor: float) -> str:
    """Return what undoes a factor."""
    if factor > 1.0:
        return f"Divide them by {factor:,.10g}"
    return f"Multiply them by {1.0 / factor:,.10g}"


def _area_mistake(areas: FloatArray, start: FloatArray) -> str | None:
    known = start > 0.0
    ratio = float(np.median(areas[known] / start[known]))
    if 1.0 / AREA_RATIO <= ratio <= AREA_RATIO:
        return None
    stated = (
        f"the areas of the first frame are {ratio:.3g} times those of the scene, "
        f"{np.median(start[known]):.4g} mm^2 in the middle"
    )
    for factor, word in AREAS.items():
        if 1.0 / AREA_RATIO <= ratio / factor <= AREA_RATIO:
            return f"{stated}: the values look like {word}. {_times(factor)}"
    return f"{stated}. Give the areas of the marker triangles at the start of the scene first"


def _angle_mistake(
    experiment: Experiment, angles: FloatArray, band: Band | None
) -> str | None:
    markers = experiment.scene.markers
    largest = np.full(angles.shape[1], math.pi)
    if experiment.score.observable is Observable.CURVATURE and markers is not None:
        count = len(markers.positions_m)
        faces_at = np.bincount(np.asarray(markers.faces).ravel(), minlength=count)
        largest = math.pi * faces_at
    right = "the values look like degrees. Divide them by 57.29578"
    over = np.abs(angles) > largest + 1e-6
    if over.any():
        frame, column = np.argwhere(over)[0]
        return (
            f"frame {frame} has {experiment.coordinates[column]} at {angles[frame, column]:.4g} rad, and the largest "
            f"angle there is {largest[column]:.4g}: {right}"
        )
    if band is None:
        return None
    count = min(len(band.mean), len(angles))
    simulated, mean = angles[:count] @ band.projection.T, band.mean[:count]
    known = np.isfinite(mean)
    simulated, mean = simulated[known], mean[known]
    product_ = float(simulated @ mean)
    sizes = length_of(simulated), length_of(mean)
    if not all(sizes) or product_ / (sizes[0] * sizes[1]) < DEGREES_CORRELATION:
        return None
    ratio = product_ / sizes[1] ** 2
    if DEGREES / DEGREES_RANGE <= ratio <= DEGREES * DEGREES_RANGE:
        return f"the angles are {ratio:.3g} times those of the reference: {right}"
    return None


def marker_mistake(experiment: Experiment, markers_m: FloatArray) -> str | None:
    """Return what is probably wrong with the markers of the first frame [m], shape [T, M, 3]; None if nothing is."""
    markers = experiment.scene.markers
    if markers is None:
        return None
    start = np.asarray(markers.positions_m)
    names = [f"marker-{number}" for number in range(len(start))]
    return place_mistake(
        markers_m[0],
        start,
        names=names,
        tolerance=1e-3 * START_TOLERANCE_MM,
        unit="m",
    )


def count_mistake(row_count: int, frame_count: int) -> str | None:
    """Return what is probably wrong with the number of rows without times; None if they can be frames of 30 Hz."""
    spans = frame_count - 1
    is_multiple = row_count >= 2 * spans + 1 and (
        (row_count - 1) % spans == 0 or row_count % frame_count == 0
    )
    if row_count <= frame_count + LATER_FRAMES and not is_multiple:
        return None
    # The last frame may be there or not.
    rates_hz = np.multiply(
        FRAME_RATE_HZ, [(row_count - 1) / spans, row_count / frame_count]
    )
    near = min(RATES_HZ, key=lambda one: np.abs(one - rates_hz).min())
    is_near = np.abs(near - rates_hz).min() <= 0.03 * near
    looks = f". They look like {near} Hz" if is_near else ""
    return (
        f"{row_count} rows without a column time_s count as frames of 30 Hz, and an episode has {frame_count}, with "
        f"{LATER_FRAMES} later ones at most{looks}. Add a column time_s [s], or give every frame of 30 Hz alone"
    )


def time_mistake(times_s: FloatArray, frame_count: int) -> str | None:
    """Return which unit times have that are no seconds; None if they may be seconds."""
    last_s = (frame_count - 1) / FRAME_RATE_HZ
    step = float(np.median(np.diff(times_s)))
    if step == 1.0 and frame_count > 1:
        return "time_s looks like numbers of frames. Divide them by the rate [Hz]"
    for factor, word in {
        1e3: "milliseconds",
        1e6: "microseconds",
        1e9: "nanoseconds",
    }.items():
        if 0.5 <= times_s[-1] / (factor * last_s) <= 20.0 and step > 1.0:
            return f"time_s looks like {word}. {_times(factor)}"
    return None
