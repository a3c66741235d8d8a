"""State where the object of a recording is when its first frame is not a known one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.video.frames import Frames
from gauge_envs.video.plane import PlaneView
from gauge_envs.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask

__all__ = ["Start", "swing_reach_px", "task_from_start"]


@dataclass(frozen=True, kw_only=True)
class Start:
    """Place of the object in the first frame, in pixels of the video itself.

    Attributes:
        x_px: Horizontal place of its centre [px].
        y_px: Vertical place of its centre [px].
        size_px: Its apparent edge or diameter [px]; from the size of the task's object and the camera if None.
    """

    x_px: float
    y_px: float
    size_px: float | None = None


def task_from_start(task: VideoTask, start: Start, camera: PlaneView, frames: Frames) -> VideoTask:
    """Return a task whose pixels are those of a recording on the reference grid, for the followers.

    Args:
        task: The task.
        start: Where the object is.
        camera: How the recording sees the plane of the motion.
        frames: The recording.

    Raises:
        VideoError: The start lies outside of the picture, the size is not positive, or a swing has no pivot.
    """
    width, height = frames.size_px
    if not (0.0 <= start.x_px < width and 0.0 <= start.y_px < height):
        raise VideoError(f"start: {start.x_px:g}, {start.y_px:g} lies outside of the {width} x {height} pixels")
    if start.size_px is not None and not (math.isfinite(start.size_px) and start.size_px > 0.0):
        raise VideoError(f"start: the size is {start.size_px}; give the edge or diameter in pixels")
    to_grid = np.array(REFERENCE_SIZE_PX) / np.array(frames.size_px, dtype=float)
    centre = np.array([start.x_px, start.y_px]) * to_grid
    if start.size_px is None:
        size = task.size_m / float(camera.grid_scale_m_per_px(centre[None])[0])
    else:
        size = start.size_px * math.sqrt(float(to_grid.prod()))
    pivot = None
    if task.motion in (Motion.PENDULUM, Motion.CRADLE):
        if camera.pivot_m is None:
            raise VideoError(f"{task.id} needs motion.pivot_m in the camera file: the pivot about which it swings")
        x, y = camera.plane_to_grid_px(camera.pivot_m[None])[0]
        pivot = (float(x), float(y))
    at = (float(centre[0]), float(centre[1]))
    rest = at if task.motion is Motion.CRADLE else None
    return replace(task, size_px=size, centre_px=at, pivot_px=pivot, rest_px=rest)


def swing_reach_px(camera: PlaneView, place_px: NDArray[np.float64], margin: float) -> tuple[float, float]:
    """Return the smallest and largest distance from the pivot in the picture of a ball that swings in the plane [px].

    Args:
        camera: How the recording sees the plane, with a pivot.
        place_px: Place of the ball on the reference grid [px], shape [2].
        margin: Share by which the range is widened on both sides.
    """
    assert camera.pivot_m is not None
    radius = float(np.linalg.norm(camera.grid_to_plane_m(place_px[None])[0] - camera.pivot_m))
    # The lower half of the circle and some more: no pendulum of these tasks swings over its pivot.
    angles = np.linspace(-0.6 * math.pi, 0.6 * math.pi, 61)
    circle = camera.pivot_m + radius * np.column_stack([np.sin(angles), -np.cos(angles)])
    offset = camera.plane_to_grid_px(circle) - camera.plane_to_grid_px(camera.pivot_m[None])
    distances = np.linalg.norm(offset, axis=1)
    return (1.0 - margin) * float(distances.min()), (1.0 + margin) * float(distances.max())
