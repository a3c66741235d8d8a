"""Find how the first frame of a video lies on the grid of its task: stretched, cropped or padded.

Video models keep other sizes than the 832 x 480 pixels of the first frames, and reach them in different ways. With the
right registration, edges of the picture lie on the known outline of the object.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video.frames import Registration, cv2, laid_out
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    Motion,
    VideoTask,
)

UNSEEN = "the object is not seen at its place in the known first frame"
"""Problem of a clip whose first frame does not show the outline."""

CLOSE_PX, REACH_PX = 2, 10
"""Distances from the known outline at which an edge agrees, and within which the strongest edge is looked for [px]."""

MIN_SUPPORT = {
    Motion.SLIDE: 0.61,
    Motion.FALL: 0.78,
    Motion.TURN: 0.75,
    Motion.CRADLE: 0.6,
    Motion.PENDULUM: 0.78,
}
"""Smallest support of a registration that agrees. Published clips have at least 0.64, 0.90, 0.86, 0.63 and 0.88. Of
random places and scales in them, 95 % stay below 0.62, 0.68, 0.52, 0.52 and 0.65."""

CLEAR = 0.04
"""Difference of the supports of two registrations from which one is clearly better."""

MIN_VISIBLE_SHARE = 0.5
"""Smallest share of the outline that a crop must leave in the picture."""


def registration_by_outline(
    picture: NDArray[np.uint8], task: VideoTask
) -> Registration:
    """Return the registration of a first frame from the known outline of the task's object.

    Args:
        picture: First frame of the video in its size, shape [height, width, 3].
        task: The task.
    """
    size_px = (picture.shape[1], picture.shape[0])
    candidates = [laid_out(size_px, method) for method in ("stretch", "crop", "pad")]
    outline = _outline(task)
    candidates = [
        replace(one, support=_support(one, picture, outline)) for one in candidates
    ]
    best = max(one.support for one in candidates)
    if best < MIN_SUPPORT[task.motion]:
        return replace(candidates[0], problem=UNSEEN)
    # The paper scales width and height independently: another method must be clearly better.
    return next(one for one in candidates if best - one.support < CLEAR)


def _support(
    registration: Registration, picture: NDArray[np.uint8], outline: NDArray[np.bool_]
) -> float:
    """Return the mean strength of the edges on the outline, relative to the strongest ones beside it.

    Args:
        registration: The registration.
        picture: First frame of the video in its size.
        outline: Whether a pixel of the grid is on the outline, shape [480, 832].
    """
    points = np.argwhere(outline)[:, ::-1] + 0.5
    pixels = (points - registration.offset_px) / registration.scale
    is_seen = ((pixels > 0.0) & (pixels < picture.shape[1::-1])).all(axis=1)
    if is_seen.mean() < MIN_VISIBLE_SHARE:
        return 0.0
    light = cv2.GaussianBlur(registration.applied(picture), (0, 0), 1.0).max(axis=2)
    edges = cv2.morphologyEx(light, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    close, near = (
        cv2.dilate(edges, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
        for side in (2 * CLOSE_PX + 1, 2 * REACH_PX + 1)
    )
    shares = close[outline] / np.maximum(near[outline], 1.0)
    return float(shares[is_seen].mean())


def _outline(task: VideoTask) -> NDArray[np.bool_]:
    """Return which pixels of the grid are on the outlines that a task knows, shape [480, 832]."""
    width, height = REFERENCE_SIZE_PX
    drawn = np.zeros((height, width), np.uint8)
    size_px, circles = task.size_px, [(*task.centre_px, 0.5 * task.size_px)]
    if task.motion is Motion.TURN and task.pivot_px is not None:
        circles = [(*task.pivot_px, PLATE_RADIUS_PX)]
    if task.rest_px is not None:
        # The hanging balls of the cradle touch each other.
        x, y = task.rest_px
        circles += [(x - ball * size_px, y, 0.5 * size_px) for ball in range(4)]
    if task.direction is not None and task.motion is Motion.SLIDE:
        angle_deg = math.degrees(math.atan2(*task.direction[::-1]))
        corners = cv2.boxPoints((task.centre_px, (size_px, size_px), angle_deg))
        cv2.polylines(drawn, [np.rint(corners).astype(int)], True, 1)
        circles = []
    for x, y, radius in circles:
        cv2.circle(drawn, (round(x), round(y)), round(radius), 1)
    return drawn > 0
