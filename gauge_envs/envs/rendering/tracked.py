"""The overlay of an episode: what its score compares, as far as that is in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.envs.episode import Episode
from gauge_envs.envs.rendering.lazy import Pictures
from gauge_envs.envs.rendering.overlay import RECORDED_COLOR, Overlay, OverlayPath
from gauge_envs.evaluation.reference_path import reference_path
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene import Sphere

__all__ = ["episode_picture", "tracked_overlay"]

FloatArray = NDArray[np.float64]

MOST_PATHS = 12
"""Largest number of points whose paths are drawn; the paths of more hide the scene."""
MOST_POINTS = 240
"""Largest number of points of a path; more of them cost time, and show nothing more."""


def episode_picture(pictures: Pictures, episode: Episode, *, drawn_as: Episode) -> NDArray[np.uint8]:
    """Return a picture of an episode, shape [height, width, 3], with its overlay if the pictures have one.

    Args:
        pictures: Renderer.
        episode: An episode that has begun.
        drawn_as: Episode whose scene states camera and shapes, the same in each call until the renderer is closed.

    Raises:
        RenderError: The machine has no OpenGL library.
    """
    return pictures.draw(
        drawn_as.experiment,
        drawn_as.rest_nodes_m,
        band=drawn_as.band,
        poses=episode.poses(),
        nodes_m=episode.nodes_m(),
        overlay=tracked_overlay(episode) if pictures.has_overlay else None,
    )


def tracked_overlay(episode: Episode) -> Overlay:
    """Return the overlay of an episode that has begun.

    Tracked points are the markers of deformable bodies, and the recorded origins of rigid ones. Both the simulation and
    the reference have a path where g(t) is of positions. A ball of the reference is drawn with its own shape, any other
    body as a point, because a reference holds no orientation.
    """
    experiment, scene = episode.experiment, episode.experiment.scene
    frame, trajectory = episode.frame or 0, episode.trajectory()
    observable = experiment.score.observable
    markers_m = trajectory.markers_m[-1]
    paths: list[OverlayPath] = []
    if observable in (Observable.POSITION, Observable.MARKER_POSITION):
        places_m = 1e-3 * trajectory.samples.reshape(len(trajectory.samples), -1, 3)
        markers_m = places_m[-1]
        if markers_m.shape[0] <= MOST_PATHS:
            paths += [OverlayPath(points_m=_thinned(places_m[:, index])) for index in range(len(markers_m))]
    reference = reference_path(experiment, episode.band)
    recorded_m, ghosts = np.zeros((0, 3)), {}
    if reference is not None:
        if len(reference.names) <= MOST_PATHS:
            paths += [
                OverlayPath(points_m=_thinned(reference.places_m[:, index]), color=RECORDED_COLOR)
                for index in range(len(reference.names))
            ]
        if frame < len(reference.places_m):
            recorded_m = reference.places_m[frame]
        if observable is Observable.POSITION:
            balls = [name for name in reference.names if isinstance(scene.body(name).shape, Sphere)]
            places = dict(zip(reference.names, recorded_m, strict=False))
            ghosts = {name: np.array([*places[name], 1.0, 0.0, 0.0, 0.0]) for name in balls if name in places}
    return Overlay(markers_m=markers_m, recorded_m=recorded_m, paths=tuple(paths), ghosts=ghosts)


def _thinned(points_m: FloatArray) -> FloatArray:
    """Return every k-th point and the last one."""
    step = -(-len(points_m) // MOST_POINTS)
    return np.concatenate([points_m[:-1:step], points_m[-1:]])
