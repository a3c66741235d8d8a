"""What a picture can have on top of its scene: tracked points, paths and translucent bodies.

An overlay is plain data in the world frame. It changes no body and no camera. That of an episode shows what its score
compares, as far as that is in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import shots_of
from gauge_envs.observables.kinds import Observable
from gauge_envs.rendering.reference_path import ReferencePath
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity from 0 to 1."""

SIMULATED_COLOR: Color = (0.07, 0.33, 0.85, 1.0)
"""Colour of what a simulation did: tracked points and their paths."""
RECORDED_COLOR: Color = (0.85, 0.05, 0.38, 1.0)
"""Colour of the reference, as the mean of the real trials."""

PLACES = (Observable.POSITION, Observable.MARKER_POSITION)
"""Observables that are places in space."""
MOST_PATHS = 12
"""Largest number of points whose paths are drawn; the paths of more hide the scene."""
MOST_POINTS = 240
"""Largest number of points of a path; more of them cost time, and show nothing more."""
LEAST_LENGTH = 0.9
"""Share of the length of a path that its drawn points keep. It is a choice."""


def _no_points() -> FloatArray:
    return np.zeros((0, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlay:
    """Tracked points, paths and translucent bodies of one picture. Points that are not finite are left out.

    Attributes:
        markers_m: Points of the simulation [m], shape [n, 3], drawn as small bright balls.
        recorded_m: Points of the reference at the same time [m], shape [n, 3], in the colour of the reference.
        paths: Lines of the simulation so far [m], shape [point_count, 3] each, drawn as thin tubes.
        recorded_paths: Lines of the reference, in its colour.
        ghosts: Bodies of the reference that are drawn translucent, with their own shape: position [m] and quaternion
            w x y z by name of the body, shape [7].
    """

    markers_m: FloatArray = field(default_factory=_no_points)
    recorded_m: FloatArray = field(default_factory=_no_points)
    paths: tuple[FloatArray, ...] = ()
    recorded_paths: tuple[FloatArray, ...] = ()
    ghosts: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def geom_count(self) -> int:
        """Number of balls and tubes; ghosts come on top of it."""
        tubes = sum(
            max(len(path) - 1, 0) for path in (*self.paths, *self.recorded_paths)
        )
        return len(self.markers_m) + len(self.recorded_m) + tubes


def tracked_overlay(
    experiment: Experiment,
    reference: ReferencePath | None,
    *,
    time_s: float,
    samples: FloatArray,
    markers_m: FloatArray,
    poses: Mapping[str, FloatArray],
) -> Overlay:
    """Return the overlay of a moment of an episode.

    Tracked points are the markers of deformable bodies, and the recorded origins of rigid ones. Both the simulation and
    the reference have a path where g(t) is of positions. A body of the reference is drawn once more as a ghost.

    Args:
        experiment: The experiment, with the trial that it starts from.
        reference: Places of its reference, or None.
        time_s: The moment [s].
        samples: g(t) up to the moment, in its unit, shape [sample_count, coordinate_count].
        markers_m: Markers at the moment [m], shape [marker_count, 3].
        poses: Poses of the simulated bodies at the moment, shape [7] each; others stand at their start.
    """
    paths: tuple[FloatArray, ...] = ()
    if experiment.score.observable in PLACES:
        places_m = 1e-3 * samples.reshape(len(samples), -1, 3)
        markers_m, paths = places_m[-1], _paths(places_m)
    if reference is None:
        return Overlay(markers_m=markers_m, paths=paths)
    recorded_m, ghosts = _no_points(), {}
    at = round(time_s * FRAME_RATE_HZ, 6)
    if at <= len(reference.places_m) - 1:
        recorded_m = between(reference.places_m, at)
        ghosts = _ghosts(experiment, reference, recorded_m, time_s, poses)
    if ghosts:
        recorded_m = np.array([pose[:3] for pose in ghosts.values()])
    return Overlay(
        markers_m=markers_m,
        recorded_m=recorded_m,
        paths=paths,
        recorded_paths=_paths(reference.places_m),
        ghosts=ghosts,
    )


def between(points: NDArray[np.floating], at: float) -> FloatArray:
    """Return points between two views, which are rows, by linear interpolation; the last view stays."""
    first = min(int(at), len(points) - 1)
    later = min(first + 1, len(points) - 1)
    share = at - first if later > first else 0.0
    here = points[first].astype(np.float64)
    if share == 0.0:
        return here
    return (1.0 - share) * here + share * points[later]


def _ghosts(
    experiment: Experiment,
    reference: ReferencePath,
    places_m: FloatArray,
    time_s: float,
    poses: Mapping[str, FloatArray],
) -> dict[str, FloatArray]:
    """Return the poses of the bodies of a reference; one that holds no orientation turns as the simulation."""
    if (
        experiment.score.observable is not Observable.POSITION
        or len(reference.names) > MOST_PATHS
    ):
        return {}
    shots, ghosts = shots_of(experiment), {}
    for name, place in zip(reference.names, places_m, strict=True):
        if shots is not None and experiment.trial is not None:
            # A single trial is known between the frames, too.
            position_m, turns = shots.shot(experiment.trial).poses_at(
                np.array([time_s])
            )
            ghosts[name] = np.concatenate(
                [position_m[0], turns[0].as_quat(scalar_first=True)]
            )
            continue
        turn = (
            poses[name][3:]
            if name in poses
            else np.array(experiment.scene.body(name).pose.quaternion)
        )
        ghosts[name] = np.concatenate([place, turn])
    return ghosts


def _paths(places_m: FloatArray) -> tuple[FloatArray, ...]:
    """Return the path of each point, every k-th place and the last one; none of many points.

    Where these cut turns off, as those of many swings, the path is its first places.
    """
    if places_m.shape[1] > MOST_PATHS:
        return ()
    step = -(-len(places_m) // MOST_POINTS)
    shown_m = np.concatenate([places_m[:-1:step], places_m[-1:]])
    if _length_m(shown_m) < LEAST_LENGTH * _length_m(places_m):
        shown_m = places_m[:MOST_POINTS]
    return tuple(shown_m[:, index] for index in range(places_m.shape[1]))


def _length_m(places_m: FloatArray) -> float:
    """Return the length of all paths between known places [m]."""
    ways_m = np.linalg.norm(np.diff(places_m, axis=0), axis=2)
    return float(np.nansum(ways_m))
