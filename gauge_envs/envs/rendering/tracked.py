"""The overlay of an episode: what its score compares, as far as that is in space."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gauge_envs.envs.episode import Episode
from gauge_envs.envs.rendering.lazy import Pictures
from gauge_envs.envs.rendering.overlay import RECORDED_COLOR, Overlay, OverlayPath
from gauge_envs.evaluation.reference_path import ReferencePath, reference_path
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.resolve import shots_of
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene.timing import FRAME_RATE_HZ

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
    the reference have a path where g(t) is of positions. A body of the reference is drawn once more as a ghost.
    """
    experiment = episode.experiment
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
            ghosts = reference_ghosts(
                experiment, reference, recorded_m, time_s=frame / FRAME_RATE_HZ, poses=episode.poses()
            )
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
