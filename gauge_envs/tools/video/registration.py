"""Find how the first frame of a video lies on the grid of its task: stretched, cropped or padded.

Video models keep other sizes than the 832 x 480 pixels of the first frames, and reach them in different ways. The
known outline of the object decides: at the right registration, edges of the picture lie on it.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Registration, cv2, stretched
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    SLOPE_DIRECTION,
    Motion,
    VideoTask,
)

UNSEEN = "the object is not seen at its place in the known first frame"
"""What is said of a clip whose first frame does not show the outline."""

CLOSE_PX = 2.0
"""Distance from the known outline at which an edge agrees [px]: the outlines were read by eye."""

REACH_PX = 10.0
"""Distance from the outline on both sides within which the strongest edge is looked for [px]."""

LEAST_SUPPORT_DISKS, LEAST_SUPPORT_SQUARES = 0.75, 0.68
"""Smallest support of a registration that agrees. The published first frames and videos have 0.86 to 0.97 and 0.70 to
0.94; of 100 random places and scales in them, 95 stay below 0.65 and 0.72."""

CLEAR = 0.04
"""Difference of the supports of two registrations from which one is clearly better."""

LEAST_VISIBLE = 0.5
"""Smallest share of the outline that a crop must leave in the picture."""

CRADLE_ROW_PX = (367.0, 404.0, 440.5)
"""Horizontal places of the other hanging balls of the cradle in the first frame [px]."""


def registration_by_outline(
    picture: NDArray[np.uint8], task: VideoTask
) -> Registration:
    """Return the registration of a first frame from the known outline of the task's object.

    Args:
        picture: First frame of the video in its own size, shape [height, width, 3].
        task: The task.
    """
    size = (picture.shape[1], picture.shape[0])
    points, normals = _outline(task)
    candidates = [_judged(one, picture, points, normals) for one in _candidates(size)]
    best = max(one.support for one in candidates)
    is_square = task.motion in (Motion.SLIDE, Motion.TURN)
    if best < (LEAST_SUPPORT_SQUARES if is_square else LEAST_SUPPORT_DISKS):
        return replace(candidates[0], problem=UNSEEN)
    # The paper scales width and height each on its own: another way must be clearly better.
    return next(one for one in candidates if best - one.support < CLEAR)


# --- outlines --------------------------------------------------------------------------------------------------------


def _judged(
    one: Registration,
    picture: NDArray[np.uint8],
    points: FloatArray,
    normals: FloatArray,
) -> Registration:
    """Return a registration with its support: strength of the edges on the outline against those beside it.

    Args:
        one: The registration.
        picture: First frame of the video in its own size.
        points: Points of the outline on the grid [px], shape [point_count, 2].
        normals: Its normals there, shape [point_count, 2].
    """
    distances = np.arange(-REACH_PX - 0.5, REACH_PX + 1.0, 0.5)
    places = points[:, None, :] + distances[None, :, None] * normals[:, None, :]
    maps = places.astype(np.float32)
    light = cv2.GaussianBlur(one.applied(picture), (0, 0), 1.0).max(axis=2)
    values = cv2.remap(light.astype(np.float32), maps, None, cv2.INTER_LINEAR)
    strength = np.abs(values[:, 2:] - values[:, :-2]).astype(float)
    is_close = np.abs(distances[1:-1]) <= CLOSE_PX
    nearest = strength[:, is_close].max(axis=1)
    share = nearest / np.maximum(strength.max(axis=1), 1e-3)
    native = (points + 0.5 - one.offset_px) / one.scale
    size = (picture.shape[1], picture.shape[0])
    is_seen = ((native > 0.0) & (native < size)).all(axis=1)
    if is_seen.mean() < LEAST_VISIBLE:
        return replace(one, support=0.0)
    return replace(one, support=float(share[is_seen].mean()))


def _candidates(size_px: tuple[int, int]) -> list[Registration]:
    """Return the ways in which a model reaches another size; those that are the same are there once."""
    plain = stretched(size_px)
    if abs(plain.scale_x / plain.scale_y - 1.0) <= 1e-3:
        return [plain]
    found = [plain]
    for method, choose in (("crop", min), ("pad", max)):
        scale = choose(plain.scale_x, plain.scale_y)
        x, y = 0.5 * (np.array(REFERENCE_SIZE_PX) - scale * np.array(size_px))
        found.append(
            Registration(
                scale_x=scale,
                scale_y=scale,
                offset_x_px=float(x),
                offset_y_px=float(y),
                method=method,
            )
        )
    return found


def _outline(task: VideoTask) -> tuple[FloatArray, FloatArray]:
    """Return points of the outlines that a task knows on the grid [px], and their normals, shape [point_count, 2]."""
    if task.motion is Motion.SLIDE:
        parts = [_square(task, SLOPE_DIRECTION)]
    elif task.motion is Motion.TURN:
        assert task.pivot_px is not None
        plate = _circle(task.pivot_px, 2.0 * PLATE_RADIUS_PX)
        parts = [_square(task, (1.0, 0.0)), plate]
    else:
        centres = [task.centre_px]
        if task.motion is Motion.CRADLE:
            assert task.rest_px is not None
            centres += [(x, task.rest_px[1]) for x in CRADLE_ROW_PX]
            centres.append(task.rest_px)
        parts = [_circle(centre, task.size_px) for centre in centres]
    points, normals = np.hstack(parts)
    return points, normals


def _circle(centre: tuple[float, float], diameter: float) -> FloatArray:
    """Return points of a circle and their normals, shape [2, point_count, 2]."""
    angles = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.stack([np.array(centre) + 0.5 * diameter * normals, normals])


def _square(task: VideoTask, direction: tuple[float, float]) -> FloatArray:
    """Return points of the sides of the object's face and their normals, shape [2, point_count, 2]."""
    steps = np.linspace(-0.4, 0.4, 18)[:, None]
    points, normals = [], []
    normal = np.array(direction)
    for _ in range(4):
        along = np.array([-normal[1], normal[0]])
        points.append(task.centre_px + task.size_px * (0.5 * normal + steps * along))
        normals.append(np.tile(normal, (len(steps), 1)))
        normal = along
    return np.stack([np.vstack(points), np.vstack(normals)])
