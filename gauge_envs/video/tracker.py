"""Track the object of a task through a video, and name what makes the track doubtful."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.video.background import Region, background
from gauge_envs.video.follow import DiskFollower, FaceFollower, PatchFollower, Sight
from gauge_envs.video.frames import LEAST_FRAMES, Frames, Picture
from gauge_envs.video.scene_watch import SceneWatch
from gauge_envs.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask
from gauge_envs.video.track import Event, Track

__all__ = ["track_object"]

PLATE_RADIUS_PX = 235.0
"""Radius of the turntable in the first frames [px], with its rim."""

CRADLE_BALLS = 5
"""Balls of the cradle."""

LEAST_TWIN_FRAMES = 3
"""Fewest frames with a second object of the same size and colour that are no accident of a mask."""


class _Follower(Protocol):
    def see(self, picture: Picture) -> Sight: ...


def track_object(frames: Frames, task: VideoTask) -> Track:
    """Return the track of the object of a task.

    Args:
        frames: The video; its first frame is the task's known one, in any resolution or aspect.
        task: The task.

    Raises:
        VideoError: The video has too few frames, or cannot be decoded.
    """
    first: Picture | None = None
    count = 0
    for picture in frames.pictures():
        first = picture.copy() if first is None else first
        count += 1
    if first is None or count < LEAST_FRAMES:
        raise VideoError(f"{frames.name}: it has {count} frames; a motion needs at least {LEAST_FRAMES}")
    follower = _follower(frames, count, first, task)
    watch = SceneWatch(first, _moving_part(task))
    sights = []
    for picture in frames.pictures():
        sights.append(follower.see(picture))
        watch.look(picture)
    return Track(
        frames=np.arange(len(sights)),
        fps=frames.fps,
        points_px=np.array([(s.x_px, s.y_px) for s in sights]),
        confidence=np.array([s.confidence for s in sights]),
        size_ratio=np.array([s.size_ratio for s in sights]),
        events=(*watch.events(), *_twin_events(sights)),
    )


def _follower(frames: Frames, count: int, first: Picture, task: VideoTask) -> _Follower:
    centre = np.array(task.centre_px)
    if task.motion is Motion.TURN:
        return FaceFollower(first, centre_px=centre, size_px=task.size_px)
    scene, _ = background(frames, count, _surroundings(centre, task.size_px))
    if task.motion in (Motion.SLIDE, Motion.FALL):
        is_cube = task.motion is Motion.SLIDE
        area = task.size_px**2 * (1.08 if is_cube else math.pi / 4.0)
        return PatchFollower(scene, centre_px=centre, size_px=task.size_px, area_px=area)
    assert task.pivot_px is not None
    pivot = np.array(task.pivot_px)
    if task.motion is Motion.PENDULUM:
        length = float(np.linalg.norm(centre - pivot))
        return DiskFollower(
            scene, diameter_px=task.size_px, centre_px=centre, pivot_px=pivot, reach_px=(0.8 * length, 1.2 * length)
        )
    assert task.rest_px is not None
    rest = np.array(task.rest_px)
    length = float(np.linalg.norm(rest - pivot))
    return DiskFollower(
        scene,
        diameter_px=task.size_px,
        centre_px=rest,
        pivot_px=pivot,
        reach_px=(0.92 * length, 1.08 * length),
        sector_rad=(0.05, 0.5 * math.pi),
    )


def _surroundings(centre: NDArray[np.float64], size_px: float) -> Region:
    """Return the part of the first frame that an object and its shadow may hide."""
    half = 1.1 * size_px
    low, high = np.floor(centre - half), np.ceil(centre + half)
    width, height = REFERENCE_SIZE_PX
    return max(0, int(low[0])), max(0, int(low[1])), min(width, int(high[0])), min(height, int(high[1]))


def _moving_part(task: VideoTask) -> NDArray[np.bool_]:
    """Return where the picture changes on purpose.

    That is around the object's first place, on the plate of a turntable, and where the balls of a cradle swing.
    """
    width, height = REFERENCE_SIZE_PX
    rows, columns = np.mgrid[0:height, 0:width]
    if task.motion is Motion.CRADLE:
        assert task.pivot_px is not None and task.rest_px is not None
        x, y = task.pivot_px
        # The incoming ball hangs as many diameters to the left as there are balls before the last one.
        first_x = x - (CRADLE_BALLS - 1) * task.size_px
        reach = task.rest_px[1] - y + task.size_px
        away = np.hypot(columns - np.clip(columns, first_x, x), rows - y)
        swept: NDArray[np.bool_] = (away < reach) & (rows > y - task.size_px)
        return swept
    centre, radius = np.array(task.centre_px), 1.2 * task.size_px
    if task.motion is Motion.TURN:
        assert task.pivot_px is not None
        centre, radius = np.array(task.pivot_px), PLATE_RADIUS_PX
    inside: NDArray[np.bool_] = np.hypot(columns - centre[0], rows - centre[1]) < radius
    return inside


def _twin_events(sights: list[Sight]) -> list[Event]:
    twins = [number for number, sight in enumerate(sights) if sight.twins]
    if len(twins) < LEAST_TWIN_FRAMES:
        return []
    text = f"a second object of the same size and colour is seen in {len(twins)} frames, from {twins[0]} to {twins[-1]}"
    return [Event(kind="duplicated", first_frame=twins[0], last_frame=twins[-1], text=text)]
