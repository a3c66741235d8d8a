"""Overlay of a picture: tracked points, their paths, and the reference."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.band import Band
from gauge_envs.rendering.reference_path import reference_path
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ

MAX_PATHS = 12
"""Largest number of paths and of marked bodies in a picture; more would hide the scene."""


def _no_points() -> FloatArray:
    return np.zeros((0, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlay:
    """Tracked points and paths of one picture, in the world frame. Points that are not finite are left out.

    Attributes:
        markers_m: Points of the simulation [m], shape [n, 3].
        recorded_m: Points of the reference at the same time [m], shape [n, 3].
        paths: Paths of the simulation so far [m], shape [point_count, 3] each.
        recorded_paths: Paths of the reference [m].
    """

    markers_m: FloatArray = field(default_factory=_no_points)
    recorded_m: FloatArray = field(default_factory=_no_points)
    paths: tuple[FloatArray, ...] = ()
    recorded_paths: tuple[FloatArray, ...] = ()


def tracked_overlay(
    experiment: Experiment,
    band: Band | None,
    *,
    time_s: float,
    samples: FloatArray,
    markers_m: FloatArray,
) -> Overlay:
    """Return the overlay at a time of an episode: the compared quantities, if they are positions.

    Args:
        experiment: The experiment with its effective initial state.
        band: Its reference, or None.
        time_s: The time [s].
        samples: g(t) until this time, in its unit, shape [sample_count, coordinate_count].
        markers_m: Markers at this time [m], shape [marker_count, 3], shown if g(t) has no positions.
    """
    observable = experiment.score.observable
    if observable is Observable.POSITION and len(experiment.recorded) > MAX_PATHS:
        return Overlay()
    paths: tuple[FloatArray, ...] = ()
    if observable.is_of_places:
        places_m = 1e-3 * samples.reshape(len(samples), -1, 3)
        markers_m, paths = places_m[-1], _paths(places_m)
    reference = reference_path(experiment, band)
    if reference is None:
        return Overlay(markers_m=markers_m, paths=paths)
    frame = round(time_s * FRAME_RATE_HZ)
    return Overlay(
        markers_m=markers_m,
        recorded_m=reference.places_m[frame : frame + 1].reshape(-1, 3),
        paths=paths,
        recorded_paths=_paths(reference.places_m),
    )


def _paths(places_m: FloatArray) -> tuple[FloatArray, ...]:
    """Return the path of each point; empty if there are too many points."""
    is_drawn = places_m.shape[1] <= MAX_PATHS
    return tuple(places_m.swapaxes(0, 1)) if is_drawn else ()
