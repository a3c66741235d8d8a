"""What a picture can have on top of its scene: tracked points, paths and translucent bodies.

An overlay is plain data in the world frame. It changes no body and no camera. That of an episode shows what its score
compares, as far as that is in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gauge_envs.errors import ParameterError, ShapeError
from gauge_envs.evaluation.reference_path import ReferencePath, reference_path
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import shots_of
from gauge_envs.observables.kinds import Observable
from gauge_envs.references.bands import Band
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity from 0 to 1."""

SIMULATED_COLOR: Color = (0.07, 0.33, 0.85, 1.0)
"""Colour of what a simulation did: tracked points and their paths."""
RECORDED_COLOR: Color = (0.85, 0.05, 0.38, 1.0)
"""Colour of the reference, as the mean of the real trials."""

MOST_PATHS = 12
"""Largest number of points whose paths are drawn; the paths of more hide the scene."""
MOST_POINTS = 240
"""Largest number of points of a path; more of them cost time, and show nothing more."""


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


# --- episodes ---


def tracked_overlay(
    experiment: Experiment,
    band: Band | None,
    *,
    frame: int,
    samples: FloatArray,
    markers_m: FloatArray,
    poses: Mapping[str, FloatArray],
) -> Overlay:
    """Return the overlay of an episode that has begun.

    Tracked points are the markers of deformable bodies, and the recorded origins of rigid ones. Both the simulation and
    the reference have a path where g(t) is of positions. A body of the reference is drawn once more as a ghost.

    Args:
        experiment: The experiment.
        band: Its band, or None.
        frame: Number of the frame that is drawn.
        samples: g(t) up to this frame, in its unit, shape [frame_count, coordinate_count].
        markers_m: Markers at this frame [m], shape [marker_count, 3].
        poses: Position [m] and quaternion w x y z of each rigid body at this frame, shape [7].
    """
    observable = experiment.score.observable
    paths: list[OverlayPath] = []
    if observable in (Observable.POSITION, Observable.MARKER_POSITION):
        places_m = 1e-3 * samples.reshape(len(samples), -1, 3)
        markers_m = places_m[-1]
        if markers_m.shape[0] <= MOST_PATHS:
            paths += [OverlayPath(points_m=_thinned(places_m[:, index])) for index in range(len(markers_m))]
    reference = reference_path(experiment, band)
    recorded_m, ghosts = np.zeros((0, 3)), {}
    if reference is not None:
        if len(reference.names) <= MOST_PATHS:
            paths += [
                OverlayPath(points_m=_thinned(reference.places_m[:, index]), color=RECORDED_COLOR)
                for index in range(len(reference.names))
            ]
        if frame < len(reference.places_m):
            recorded_m = reference.places_m[frame]
            ghosts = reference_ghosts(experiment, reference, recorded_m, time_s=frame / FRAME_RATE_HZ, poses=poses)
    return Overlay(markers_m=markers_m, recorded_m=recorded_m, paths=tuple(paths), ghosts=ghosts)


def reference_ghosts(
    experiment: Experiment,
    reference: ReferencePath,
    places_m: FloatArray,
    *,
    time_s: float,
    poses: Mapping[str, FloatArray],
) -> dict[str, FloatArray]:
    """Return the poses of the bodies of a reference; one that holds no orientation turns as the simulation.

    Args:
        experiment: The experiment, with the trial that it starts from.
        reference: Places of the reference.
        places_m: Those of the moment [m], shape [body_count, 3].
        time_s: The moment [s].
        poses: Poses of the simulated bodies at that moment, shape [7] each; others stand at their start.

    Returns:
        Position [m] and quaternion w x y z of each body, shape [7]; none where g(t) is not of positions, or of many
        bodies.
    """
    if experiment.score.observable is not Observable.POSITION or len(reference.names) > MOST_PATHS:
        return {}
    shots, ghosts = shots_of(experiment), {}
    for name, place in zip(reference.names, places_m, strict=True):
        if shots is not None and experiment.trial is not None:
            # A single trial is known between the frames, too.
            position_m, turns = shots.shot(experiment.trial, name).poses_at(np.array([time_s]))
            ghosts[name] = np.concatenate([position_m[0], turns[0].as_quat(scalar_first=True)])
            continue
        turn = poses[name][3:] if name in poses else np.array(experiment.scene.body(name).pose.quaternion)
        ghosts[name] = np.concatenate([place, turn])
    return ghosts


def _thinned(points_m: FloatArray) -> FloatArray:
    """Return every k-th point and the last one."""
    step = -(-len(points_m) // MOST_POINTS)
    return np.concatenate([points_m[:-1:step], points_m[-1:]])
