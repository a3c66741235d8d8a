"""Track the object of a task through a video, and name what makes the track doubtful: its camera and scene too."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.follow import DiskFollower, FaceFollower, PatchFollower, Region, Sight, background
from gauge_envs.tools.video.frames import LEAST_FRAMES, Cadence, Frames, Picture, cv2, read_cadence, read_picture
from gauge_envs.tools.video.registration import registration_by_first_frame, registration_by_outline
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
    start = next(frames.native())
    if first_frame is None:
        registration = registration_by_outline(start, task)
    else:
        registration = registration_by_first_frame(start, read_picture(first_frame))

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


def _follower(
    pictures: Callable[[], Iterator[Picture]], count: int, first: Picture, task: VideoTask
) -> DiskFollower | FaceFollower | PatchFollower:
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


def _surroundings(centre: FloatArray, size_px: float) -> Region:
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
        return (away < reach) & (rows > y - task.size_px)
    centre, radius = np.array(task.centre_px), 1.2 * task.size_px
    if task.motion is Motion.TURN:
        assert task.pivot_px is not None
        centre, radius = np.array(task.pivot_px), PLATE_RADIUS_PX
    return np.hypot(columns - centre[0], rows - centre[1]) < radius


def _twin_events(sights: list[Sight]) -> list[Event]:
    twins = [number for number, sight in enumerate(sights) if sight.twins]
    if len(twins) < LEAST_TWIN_FRAMES:
        return []
    text = f"a second object of the same size and colour is seen in {len(twins)} frames, from {twins[0]} to {twins[-1]}"
    return [Event(kind="duplicated", first_frame=twins[0], last_frame=twins[-1], text=text)]


# --- camera and scene -------------------------------------------------------------------------------------------------


STRIDE = 3
"""Frames from one look to the next."""

SHRINKAGE = 4
"""Factor by which pictures are made smaller before they are compared."""

CHANGED = 30.0
"""Difference of the brightness with which a place has changed since the first frame."""

RECOMPOSED_SHARE = 0.2
"""Share of the picture that must change for the scene to be another one."""

MOST_SHIFT_PX = 4.0
"""Largest shift of the picture of a still camera [px]; compression and texture that swims stay below it."""

MOST_ZOOM = 0.02
"""Largest change of the scale of a still camera."""

SURE = 4.0
"""Standard uncertainties by which a shift or a zoom must exceed its limit."""

LEAST_LOOKS = 2
"""Fewest looks that must show it."""

LEAST_POINTS = 12
"""Fewest points of the scene that must be found again for a statement on the camera."""


@dataclass(frozen=True, kw_only=True)
class _Look:
    frame: int
    shift_px: float
    zoom: float
    changed_share: float


class SceneWatch:
    """Compares the scene of each frame with the first one.

    Args:
        first: The first frame.
        ignored: Part of the picture that moves on purpose, shape [480, 832].
    """

    def __init__(self, first: Picture, ignored: NDArray[np.bool_]) -> None:
        self._grey = cv2.cvtColor(first, cv2.COLOR_BGR2GRAY)
        self._counted = ~self._small(ignored.astype(np.float32)).astype(bool)
        self._first = self._small(self._grey.astype(np.float32))
        mask = np.where(ignored, 0, 255).astype(np.uint8)
        points = cv2.goodFeaturesToTrack(self._grey, 150, 0.02, 12, mask=mask)
        self._points = np.zeros((0, 1, 2), np.float32) if points is None else points
        self._looks: list[_Look] = []
        self._frame = 0

    def look(self, picture: Picture) -> None:
        """Compare the next frame."""
        if self._frame % STRIDE == 0:
            self._looks.append(self._compare(picture))
        self._frame += 1

    def events(self) -> list[Event]:
        """Return what happened to the camera and the scene."""
        found = []
        recomposed = [one for one in self._looks if one.changed_share > RECOMPOSED_SHARE]
        if recomposed:
            worst = max(one.changed_share for one in recomposed)
            text = f"the scene is recomposed: up to {worst:.0%} of the picture differs from the first frame"
            found.append(_event("scene", recomposed, text))
        zoomed = [one for one in self._looks if abs(one.zoom) > MOST_ZOOM]
        if len(zoomed) >= LEAST_LOOKS:
            worst = max((one.zoom for one in zoomed), key=abs)
            found.append(_event("camera", zoomed, f"the camera zooms by up to {worst:+.1%}"))
        shifted = [one for one in self._looks if one.shift_px > MOST_SHIFT_PX]
        if len(shifted) >= LEAST_LOOKS:
            worst = max(one.shift_px for one in shifted)
            found.append(_event("camera", shifted, f"the camera moves by up to {worst:.0f} px"))
        return found

    def _compare(self, picture: Picture) -> _Look:
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        difference = np.abs(self._small(grey.astype(np.float32)) - self._first)
        share = float((difference[self._counted] > CHANGED).mean()) if self._counted.any() else 0.0
        shift, zoom = self._camera(grey) if share <= RECOMPOSED_SHARE else (0.0, 0.0)
        return _Look(frame=self._frame, shift_px=shift, zoom=zoom, changed_share=share)

    def _camera(self, grey: NDArray[np.uint8]) -> tuple[float, float]:
        """Return the shift at the centre of the picture [px] and the relative change of the scale."""
        if len(self._points) < LEAST_POINTS:
            return 0.0, 0.0
        moved, status, _ = cv2.calcOpticalFlowPyrLK(self._grey, grey, self._points, None, winSize=(21, 21), maxLevel=3)
        is_found = status.ravel() == 1
        if is_found.sum() < LEAST_POINTS:
            return 0.0, 0.0
        matrix, inliers = cv2.estimateAffinePartial2D(
            self._points[is_found], moved[is_found], method=cv2.RANSAC, ransacReprojThreshold=1.5
        )
        if matrix is None or inliers.sum() < max(LEAST_POINTS, 0.4 * is_found.sum()):
            return 0.0, 0.0
        agreed = inliers.ravel() == 1
        before, after = self._points[is_found][agreed][:, 0], moved[is_found][agreed][:, 0]
        middle = before.mean(axis=0)
        residual = after - before @ matrix[:, :2].T - matrix[:, 2]
        scatter = float(np.sqrt((residual**2).mean()))
        spread = float(np.sqrt(((before - middle) ** 2).sum()))
        zoom = float(np.hypot(matrix[0, 0], matrix[1, 0])) - 1.0
        shift = float(np.linalg.norm(matrix[:, :2] @ middle + matrix[:, 2] - middle))
        # What the scatter of the points can feign is no motion of the camera.
        zoom = float(np.sign(zoom)) * max(0.0, abs(zoom) - SURE * scatter / max(spread, 1.0))
        return max(0.0, shift - SURE * scatter / len(before) ** 0.5), zoom

    @staticmethod
    def _small(picture: NDArray[np.float32]) -> NDArray[np.float32]:
        height, width = picture.shape[:2]
        size = (width // SHRINKAGE, height // SHRINKAGE)
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _event(kind: str, looks: list[_Look], text: str) -> Event:
    first, last = looks[0].frame, looks[-1].frame
    return Event(kind=kind, first_frame=first, last_frame=last, text=f"{text} (frames {first} to {last})")
