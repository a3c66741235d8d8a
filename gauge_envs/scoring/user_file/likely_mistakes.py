"""Find the likely mistake in a trajectory of another simulator: its unit, its axes, or its start."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import observe_markers
from gauge_envs.scene.geometry import FloatArray

START_TOLERANCE_MM = 30.0
"""Largest distance of a point of the first frame from the start of the scene [mm].

It is 1.5 times 19.9 mm, the largest distance of real trials in half of the ids with a real first frame. In the other
half, the largest distance is 10 mm."""

AREA_RATIO = 3.0
"""Largest ratio of an area of the first frame to that of the scene; nearest nodes in place of markers give up to 2."""

ANGLE_ROUNDING_RAD = 1e-6
"""Excess of an angle that is only rounding [rad]."""


def start_values(experiment: Experiment) -> FloatArray:
    """Return g(t) at the start of the scene, shape [coordinate_count]; no engine is needed."""
    scene, observable = experiment.scene, experiment.score.observable
    if observable is Observable.POSITION or scene.markers is None:
        poses = [scene.body(name).pose for name in experiment.recorded]
        return 1e3 * np.array([pose.position_m for pose in poses]).ravel()
    markers_m = np.asarray(scene.markers.positions_m)
    start: FloatArray = observe_markers(markers_m[None], scene.markers, observable)[0]
    return start


def value_mistake(
    experiment: Experiment,
    values: FloatArray,
    *,
    tolerance_mm: float = START_TOLERANCE_MM,
) -> str | None:
    """Return what is probably wrong with the values of a trajectory, and the fix; None if nothing is.

    Args:
        experiment: Experiment that was simulated.
        values: g(t) at the 30 Hz frames in the expected unit, shape [T, coordinate_count].
        tolerance_mm: Largest distance of a position from the start of the scene.
    """
    observable = experiment.score.observable
    if observable in (Observable.CURVATURE, Observable.LINE_CURVATURE):
        return _angle_mistake(experiment, values)
    start = start_values(experiment)
    if observable is Observable.FACE_AREA:
        return _area_mistake(values[0], start)
    return _place_mistake(
        values[0].reshape(-1, 3),
        start.reshape(-1, 3),
        names=[name.rpartition(".")[0] for name in experiment.coordinates[::3]],
        tolerance=tolerance_mm,
        unit="mm",
    )


def marker_mistake(experiment: Experiment, markers_m: FloatArray) -> str | None:
    """Return what is probably wrong with the markers of the first frame [m], shape [T, M, 3]; None if nothing is."""
    markers = experiment.scene.markers
    if markers is None:
        return None
    return _place_mistake(
        markers_m[0],
        np.asarray(markers.positions_m),
        names=[f"marker-{number}" for number in range(len(markers.positions_m))],
        tolerance=1e-3 * START_TOLERANCE_MM,
        unit="m",
    )


def _place_mistake(
    places: FloatArray,
    start: FloatArray,
    *,
    names: Sequence[str],
    tolerance: float,
    unit: str,
) -> str | None:
    """Return why places of the first frame differ from the scene; None if each is within a tolerance.

    Args:
        places: Places in the expected unit, shape [point_count, 3].
        start: Places of the scene in the same unit and shape.
        names: Names of the points.
        tolerance: Largest distance of a point.
        unit: `mm` or `m`.
    """
    distances = np.linalg.norm(places - start, axis=1)
    worst = int(distances.argmax())
    if distances[worst] <= tolerance:
        return None
    difference = (
        f"the first frame has {names[worst]} at {_listed(places[worst])}, "
        f"and the scene at {_listed(start[worst])} {unit}"
    )
    # If several mistakes explain the start equally well, take the first, which is the simplest.
    mistakes = [
        (round(float(np.linalg.norm(corrected - start, axis=1).max()), 6), text)
        for text, corrected in corrections(places, unit)
    ]
    remaining, text = min(mistakes, key=lambda mistake: mistake[0])
    if remaining <= tolerance:
        return f"{difference}: {text}"
    return (
        f"{difference}, {distances[worst]:.3g} {unit} apart; real starts are within {tolerance:.3g} {unit}. "
        "Check the id. Start as the scene does, in its frame with z up; or give the start as a parameter, "
        "as 'cube.position_m'"
    )


def corrections(places: FloatArray, unit: str) -> Iterator[tuple[str, FloatArray]]:
    """Yield likely mistakes, each with the places after its fix [mm or m], shape [point_count, 3].

    Args:
        places: Places of the file, shape [point_count, 3].
        unit: Expected unit, `mm` or `m`. Simulators use metres, and motion capture uses millimetres.
    """
    factor, wrong_unit, action = 1e-3, "millimetres", "Divide them by 1,000"
    if unit == "mm":
        factor, wrong_unit, action = 1e3, "metres", "Multiply them by 1,000"
    yield f"the values look like {wrong_unit}. {action}", factor * places
    for scale, note in ((1.0, ""), (factor, f"; the unit looks like {wrong_unit}")):
        for order in itertools.permutations(range(3)):
            for signs in itertools.product((1.0, -1.0), repeat=3):
                axes = ", ".join(
                    f"{'-' if sign < 0 else ''}{'xyz'[axis]}"
                    for axis, sign in zip(order, signs, strict=True)
                )
                text = f"the axes look exchanged. Write ({axes}) of your frame, so that z is up{note}"
                if axes != "x, y, z":
                    yield text, scale * places[:, order] * signs


def _listed(numbers: FloatArray) -> str:
    return f"({', '.join(f'{number:.4g}' for number in numbers)})"


def _area_mistake(areas_mm2: FloatArray, start_mm2: FloatArray) -> str | None:
    """Return why areas of the first frame differ from the scene; None if their ratio is plausible."""
    known = start_mm2 > 0.0
    ratio = float(np.median(areas_mm2[known] / start_mm2[known]))
    if 1.0 / AREA_RATIO <= ratio <= AREA_RATIO:
        return None
    fix = "Start with the areas of the marker triangles of the scene [mm^2]"
    if 1.0 / AREA_RATIO <= 1e6 * ratio <= AREA_RATIO:
        fix = "The values look like square metres. Multiply them by 1,000,000"
    return (
        f"the areas of the first frame are {ratio:.3g} times those of the scene. {fix}"
    )


def _angle_mistake(experiment: Experiment, angles_rad: FloatArray) -> str | None:
    """Return which angle is impossibly large; None if all are possible."""
    largest_rad = np.full(angles_rad.shape[1], math.pi)
    markers = experiment.scene.markers
    if experiment.score.observable is Observable.CURVATURE and markers is not None:
        # The angle deficit at a marker is at least 2 pi minus pi for each of its faces.
        face_counts = np.bincount(
            np.ravel(markers.faces), minlength=len(markers.positions_m)
        )
        largest_rad = math.pi * face_counts
    over = np.abs(angles_rad) > largest_rad + ANGLE_ROUNDING_RAD
    if not over.any():
        return None
    frame, column = np.argwhere(over)[0]
    return (
        f"frame {frame} has {experiment.coordinates[column]} at {angles_rad[frame, column]:.4g} rad, and the largest "
        f"possible angle is {largest_rad[column]:.4g}: the values look like degrees. Divide them by 57.29578"
    )
