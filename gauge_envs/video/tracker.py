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
from gauge_envs.video.plane import PlaneView
from gauge_envs.video.scene_watch import SceneWatch
from gauge_envs.video.start import Start, swing_reach_px, task_from_start
from gauge_envs.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask
from gauge_envs.video.track import Event, Track

__all__ = ["track_object"]

PLATE_RADIUS_PX = 235.0
"""Radius of the turntable in the first frames [px], with its rim."""

PLATE_SIZES = 4.5
"""Distance from the cube to the far rim of its plate, in edges of the cube: 0.075 and 0.15 m from an edge of 0.05 m."""

LEAST_TWIN_FRAMES = 3
"""Fewest frames with a second object of the same size and colour that are no accident of a mask."""


class _Follower(Protocol):
    def see(self, picture: Picture) -> Sight: ...


def track_object(
    frames: Frames, task: VideoTask, *, camera: PlaneView | None = None, start: Start | None = None
) -> Track:
    """Return the track of the object of a task.

    Args:
        frames: The video; its first frame is the task's known one, in any resolution or aspect, without a camera.
        task: The task.
        camera: How a recording of one's own sees the plane of the motion.
        start: Where its object is in the first frame.

    Raises:
        VideoError: The video has too few frames, or cannot be decoded; or one of camera and start is missing.
    """
    if (camera is None) != (start is None):
        raise VideoError(
            f"{frames.name}: a recording of your own needs both: --camera, and --start with the place of the object"
        )
    if camera is not None and start is not None:
        task = task_from_start(task, start, camera, frames)
    first: Picture | None = None
    count = 0
    for picture in frames.pictures():
        first = picture.copy() if first is None else first
        count += 1
    if first is None or count < LEAST_FRAMES:
        raise VideoError(f"{frames.name}: it has {count} frames; a motion needs at least {LEAST_FRAMES}")
    follower = _follower(frames, count, first, task, camera)
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
        events=(*watch.events(), *_twin_events(sights), *_start_events(sights, start)),
    )


def _follower(frames: Frames, count: int, first: Picture, task: VideoTask, camera: PlaneView | None) -> _Follower:
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
        reach = (0.8 * length, 1.2 * length) if camera is None else swing_reach_px(camera, centre, 0.2)
        return DiskFollower(scene, diameter_px=task.size_px, centre_px=centre, pivot_px=pivot, reach_px=reach)
    assert task.rest_px is not None
    rest = np.array(task.rest_px)
    length = float(np.linalg.norm(rest - pivot))
    reach = (0.92 * length, 1.08 * length) if camera is None else swing_reach_px(camera, rest, 0.08)
    return DiskFollower(
        scene,
        diameter_px=task.size_px,
        centre_px=rest,
        pivot_px=pivot,
        reach_px=reach,
        sector_rad=(0.05, 0.5 * math.pi),
    )


def _surroundings(centre: NDArray[np.float64], size_px: float) -> Region:
    """Return the part of the first frame that an object and its shadow may hide."""
    half = 1.1 * size_px
    low, high = np.floor(centre - half), np.ceil(centre + half)
    width, height = REFERENCE_SIZE_PX
    return max(0, int(low[0])), max(0, int(low[1])), min(width, int(high[0])), min(height, int(high[1]))


def _moving_part(task: VideoTask) -> NDArray[np.bool_]:
    """Return where the picture changes on purpose: around the object's first place, and the plate of a turntable."""
    width, height = REFERENCE_SIZE_PX
    rows, columns = np.mgrid[0:height, 0:width]
    centre, radius = np.array(task.centre_px), 1.2 * task.size_px
    if task.motion is Motion.TURN and task.pivot_px is not None:
        centre, radius = np.array(task.pivot_px), PLATE_RADIUS_PX
    elif task.motion is Motion.TURN:
        radius = PLATE_SIZES * task.size_px
    inside: NDArray[np.bool_] = np.hypot(columns - centre[0], rows - centre[1]) < radius
    return inside


def _start_events(sights: list[Sight], start: Start | None) -> list[Event]:
    """Return the reminder that another thing may have been followed: no known first frame shows what the object is."""
    if start is None:
        return []
    found = sum(math.isfinite(sight.x_px) for sight in sights)
    text = (
        f"the object was followed from a stated place and found in {found} of {len(sights)} frames: see in the overlay "
        "whether it is the object, or give a track"
    )
    return [Event(kind="start", first_frame=0, last_frame=len(sights) - 1, text=text)]


def _twin_events(sights: list[Sight]) -> list[Event]:
    twins = [number for number, sight in enumerate(sights) if sight.twins]
    if len(twins) < LEAST_TWIN_FRAMES:
        return []
    text = f"a second object of the same size and colour is seen in {len(twins)} frames, from {twins[0]} to {twins[-1]}"
    return [Event(kind="duplicated", first_frame=twins[0], last_frame=twins[-1], text=text)]
