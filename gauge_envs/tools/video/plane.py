"""Place tracks in millimetres on the grid of the known first frame."""

import math
from dataclasses import replace

import numpy as np

from gauge_envs.errors import VideoError
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

MIN_SLOPE = 0.1
"""Smallest sine of a slope."""

AXES = "x_mm and y_mm are in millimetres, to the right and up"

MAX_ARM_ERROR = 0.3
"""Largest relative error of the length of a swing in a track in millimetres; another unit is off by more."""


def metric_on_grid(track: Track, task: VideoTask) -> tuple[Track, VideoTask]:
    """Return a track in millimetres on the grid, and its task there, whose pivot is exact.

    A swing counts from its pivot; a slide has any direction that leads down.

    Raises:
        VideoError: The object goes up, or is not on the string or rod of a swing: the axes or the unit are others.
    """
    origin_px = np.array(task.pivot_px or task.centre_px)
    places_px = 1e-3 * track.points_px * [1.0, -1.0] / task.scale_m_per_px + origin_px
    track = replace(track, points_px=places_px, is_metric=False)
    found_px = places_px[track.is_found]
    if task.motion is Motion.SLIDE:
        right_px, down_px = found_px[-1] - found_px[0]
        way_px = math.hypot(right_px, down_px)
        if way_px > task.size_px:
            if down_px < MIN_SLOPE * way_px:
                raise VideoError(f"the object does not go down: {AXES}")
            task = replace(task, direction=(right_px / way_px, down_px / way_px))
    if task.motion in (Motion.CRADLE, Motion.PENDULUM):
        arms_px = found_px - origin_px
        length_px = math.dist(task.rest_px or task.centre_px, origin_px)
        share = np.median(np.hypot(*arms_px.T)) / length_px
        if abs(share - 1.0) > MAX_ARM_ERROR or np.median(arms_px[:, 1]) < 0.0:
            length_mm = 1e3 * task.scale_m_per_px * length_px
            raise VideoError(
                f"the object is not {length_mm:.0f} mm below the pivot of its swing: {AXES}, from the pivot"
            )
    return track, replace(task, pivot_sigma_px=0.0)
