"""Track the object of a task through a video, and name what makes the track doubtful."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.tools.video.background import Region, background
from gauge_envs.tools.video.cadence import Cadence, read_cadence
from gauge_envs.tools.video.follow import DiskFollower, FaceFollower, PatchFollower, Sight
from gauge_envs.tools.video.frames import LEAST_FRAMES, Frames, read_picture
from gauge_envs.tools.video.grid import Picture, Registration
from gauge_envs.tools.video.registration import registration_by_first_frame, registration_by_outline
from gauge_envs.tools.video.scene_watch import SceneWatch
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask
from gauge_envs.tools.video.track import Event, Track

PLATE_RADIUS_PX = 235.0
"""Radius of the turntable in the first frames [px], with its rim."""

CRADLE_BALLS = 5
"""Balls of the cradle."""

LOST_SHARE = 0.02
"""Share of the stated frames that a sound file may lack: some count one too many."""

LEAST_TWIN_FRAMES = 3
"""Fewest frames with a second object of the same size and colour that are no accident of a mask."""


class _Follower(Protocol):
    def see(self, picture: Picture) -> Sight: ...


def track_object(frames: Frames, task: VideoTask, *, first_frame: Path | None = None) -> Track:
    """Return the track of the object of a task.

    Args:
        frames: The video; its first frame is the task's known one, in any resolution, stretched, cropped or padded.
        task: The task.
        first_frame: Picture that the model was given, on the whole grid; the video is registered by its points.
    """
    cadence = read_cadence(frames)
    count = int(cadence.is_new.sum())
    if count < LEAST_FRAMES:
        lost = f" that can be decoded, of the {frames.stated_count} that it states" if _is_cut(frames, cadence) else ""
        raise VideoError(f"{frames.name}: it has {count} frames{lost}; a motion needs at least {LEAST_FRAMES}")
    registration = _registration(frames, task, first_frame)

    def pictures() -> Iterator[Picture]:
        for is_new, picture in zip(cadence.is_new, frames.native(), strict=False):
            if is_new:
                yield registration.applied(picture)

    first = next(pictures())
    follower = _follower(pictures, count, first, task)
    watch = SceneWatch(first, _moving_part(task))
    sights = []
    for picture in pictures():
        sights.append(follower.see(picture))
        watch.look(picture)
    numbers = np.flatnonzero(cadence.is_new)
    last = int(numbers[-1])
    notes = [Event(kind="cadence", first_frame=0, last_frame=last, text=cadence.text, is_note=True)]
    doubts = [Event(kind="registration", first_frame=0, last_frame=last, text=registration.problem)]
    if _is_cut(frames, cadence):
        text = f"the file states {frames.stated_count} frames, and {len(cadence.is_new)} can be decoded"
        doubts.append(Event(kind="file", first_frame=0, last_frame=last, text=text))
    return Track(
        frames=numbers,
        fps=cadence.fps,
        points_px=np.array([(s.x_px, s.y_px) for s in sights]),
        confidence=np.array([s.confidence for s in sights]),
        size_ratio=np.array([s.size_ratio for s in sights]),
        events=(*(one for one in (*doubts, *notes) if one.text), *watch.events(), *_twin_events(sights)),
        clock_s=cadence.times_s,
        registration=registration,
    )


def _is_cut(frames: Frames, cadence: Cadence) -> bool:
    """Return whether a file holds fewer frames than it states."""
    return frames.stated_count > len(cadence.is_new) * (1.0 + LOST_SHARE)


def _registration(frames: Frames, task: VideoTask, first_frame: Path | None) -> Registration:
    picture = next(frames.native())
    if first_frame is None:
        return registration_by_outline(picture, task)
    return registration_by_first_frame(picture, read_picture(first_frame))


def _follower(pictures: Callable[[], Iterator[Picture]], count: int, first: Picture, task: VideoTask) -> _Follower:
    centre = np.array(task.centre_px)
    if task.motion is Motion.TURN:
        return FaceFollower(first, centre_px=centre, size_px=task.size_px)
    scene = background(first, pictures(), count, _surroundings(centre, task.size_px))
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
