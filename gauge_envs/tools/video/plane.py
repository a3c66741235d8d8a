"""Place tracks in millimetres on the grid of the known first frame."""

import math
from dataclasses import replace

import numpy as np

from gauge_envs.errors import VideoError
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

LEAST_SLOPE = 0.1
"""Smallest sine of a slope."""

METRIC_AXES = "x_mm and y_mm are in millimetres, to the right and up"

MOST_ARM_ERROR = 0.3
"""Largest relative error of the length of a swing in a track in millimetres; another unit is off by more."""


def _main_direction(track: Track) -> tuple[float, float]:
    """Return the direction in the picture in which a track spreads most, away from its first place."""
    places = track.points_px[track.is_found]
    x, y = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][0]
    sign = float(np.sign((places[-1] - places[0]) @ [x, y]) or 1.0)
    return sign * float(x), sign * float(y)


def metric_on_grid(track: Track, task: VideoTask) -> tuple[Track, VideoTask]:
    """Return a track in millimetres on the grid, and its task there, whose pivot is exact.

    A swing counts from its pivot; a slide has any direction that leads down.

    Raises:
        VideoError: The object goes up, or is not on the string or rod of a swing: the axes or the unit are others.
    """
    origin_px = np.array(task.pivot_px or task.centre_px)
    places_px = 1e-3 * track.points_px * [1.0, -1.0] / task.scale_m_per_px + origin_px
    track = replace(track, points_px=places_px, is_metric=False)
    if task.motion is Motion.SLIDE:
        task = replace(task, direction=_main_direction(track))
        found_px = places_px[track.is_found]
        away, down = found_px[-1] - found_px[0]
        if math.hypot(away, down) > max(task.size_px, down / LEAST_SLOPE):
            raise VideoError(f"the object does not go down: {METRIC_AXES}")
    if task.motion in (Motion.CRADLE, Motion.PENDULUM):
        arms_px = places_px[track.is_found] - origin_px
        hanging_px = np.subtract(task.rest_px or task.centre_px, origin_px)
        share = np.median(np.hypot(*arms_px.T)) / math.hypot(*hanging_px)
        if abs(share - 1.0) > MOST_ARM_ERROR or np.median(arms_px[:, 1]) < 0.0:
            raise VideoError(
                f"the object is not {1e3 * task.scale_m_per_px * math.hypot(*hanging_px):.0f} mm below the pivot of "
                f"its swing: {METRIC_AXES}, from the pivot"
            )
    return track, replace(task, pivot_sigma_px=0.0)
