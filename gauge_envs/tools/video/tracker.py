"""Track the object of a task through a video, and report events that make the track doubtful."""

import math

import numpy as np
from scipy import constants
from scipy.ndimage import binary_closing, maximum_filter1d

from gauge_envs.errors import VideoError
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.video.face import FaceDetector
from gauge_envs.tools.video.frames import (
    FileFrames,
    Gray,
    Picture,
    cv2,
    registration_by_outline,
)
from gauge_envs.tools.video.shape import LOST, Detection, ShapeDetector, shrunk
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    Motion,
    VideoTask,
)
from gauge_envs.tools.video.track import Event, Track

MIN_FRAMES = 8
"""Smallest number of frames of a video."""

BEND, BEND_COST = 0.5, 0.4
"""Change of the velocity between frames, in sizes, that reduces the likeness by `BEND_COST`."""

MAX_STRUCK_STEP = 4.0
"""Largest first step of a struck ball, in sizes or in changes by gravity."""

MAX_ARC_ERROR = {Motion.CRADLE: 0.08, Motion.PENDULUM: 0.2}
"""Largest relative error of the distance of a swinging ball from its pivot."""

MIN_SWING_RAD = 0.05
"""Smallest angle of the outgoing ball of a cradle in the search."""

MAX_NEIGHBOUR_ERROR = 0.15
"""Largest relative error of the distance of other balls of a cradle from their pivots."""

CRADLE_BALLS = 5
"""Number of balls of the cradle."""


def track_object(frames: FileFrames, task: VideoTask) -> Track:
    """Return the track of the object of a task.

    The first pass compares the scene of each frame with the first frame. The second pass detects the object.

    Args:
        frames: The video. Its first frame is the known frame of the task, stretched, cropped or padded to any size.
        task: The task.

    Raises:
        VideoError: The video has too few frames.
    """
    picture = next(iter(frames))
    registration = registration_by_outline(picture, task)
    first = last = registration.applied(picture)
    watch = SceneWatch(first, _moving_part(task))
    count = 0
    for picture in frames:
        last = registration.applied(picture)
        watch.look(last)
        count += 1
    if count < MIN_FRAMES:
        raise VideoError(
            f"{frames.path}: it has {count} frames; a motion needs at least {MIN_FRAMES}"
        )
    detector = (
        FaceDetector(first, task)
        if task.motion is Motion.TURN
        else ShapeDetector(first, last, task)
    )
    candidates = [
        detector.candidates(registration.applied(picture)) for picture in frames
    ]
    path = followed(candidates, task, frames.fps)
    places_px, likeness, size_ratio, misfit = map(np.array, zip(*path, strict=True))
    problems = [Event(registration.problem)] if registration.problem else []
    return Track(
        frames=np.arange(count),
        times_s=np.arange(count) / frames.fps,
        fps=frames.fps,
        points_px=places_px,
        confidence=likeness,
        size_ratio=size_ratio,
        misfit=misfit,
        other_likeness=_other_likeness(candidates, path, task),
        events=(*problems, *watch.events()),
        registration=registration,
    )


def followed(
    candidates: list[list[Detection]], task: VideoTask, fps: float
) -> list[Detection]:
    """Return the detection of the object in each frame, near its predicted place; `LOST` if it is lost.

    Args:
        candidates: Possible detections of the object by frame; the first detection on a turntable is the object.
        task: The task.
        fps: Frames per second.
    """
    if task.motion is Motion.TURN:
        return [next(iter(detections), LOST) for detections in candidates]
    is_cradle = task.motion is Motion.CRADLE
    start_px = np.array(task.rest_px or task.centre_px)
    # A ball on wires, released at the height of its pivot, has an acceleration of twice gravity at its lowest point.
    max_m_per_s2 = (1.0 if task.direction else 2.0) * constants.g
    gravity_px = max_m_per_s2 / fps**2 / task.scale_m_per_px
    place_px, step_px, gap, seen_count = start_px, np.zeros(2), 1, 0
    path = []
    for detections in candidates:
        bend_px = gap * max(BEND * task.size_px, gravity_px)
        if task.motion is Motion.FALL:
            # An impact reverses the velocity.
            bend_px = max(bend_px, gap * float(np.linalg.norm(step_px)))
        expected_px = [place_px + gap * step_px]
        if task.direction is not None:
            # An impact may stop a body between two frames.
            expected_px.append(place_px)
        if is_cradle and seen_count < 2:
            # The time of the strike between two frames is unknown, so the first step is unknown too.
            bend_px = MAX_STRUCK_STEP * max(task.size_px, gravity_px)
        best, best_value = LOST, 0.0
        for detection in detections:
            away_px = min(math.dist(detection.place_px, place) for place in expected_px)
            value = detection.likeness - BEND_COST * (away_px / bend_px) ** 2
            if value > best_value and _is_allowed(detection, task):
                best, best_value = detection, value
        path.append(best)
        if best_value > 0.0:
            step_px, place_px = (best.place_px - place_px) / gap, best.place_px
            gap, seen_count = 1, seen_count + 1
        elif is_cradle:
            # A hanging ball is not detected.
            place_px, step_px, seen_count = start_px, np.zeros(2), 0
        else:
            gap += 1
    return path


def _arm_px(places_px: FloatArray, task: VideoTask) -> FloatArray:
    """Return the distances of places of shape [..., 2] from the pivot, or from the row of pivots of a cradle [px]."""
    arms_px = places_px - np.array(task.pivot_px)
    row_px = (CRADLE_BALLS - 1) * task.size_px if task.rest_px else 0.0
    arms_px[..., 0] -= np.clip(arms_px[..., 0], -row_px, 0.0)
    return np.asarray(np.linalg.norm(arms_px, axis=-1))


def _arc_error(detection: Detection, task: VideoTask) -> float:
    """Return the relative error of the distance from the pivot, or from the row of pivots of a cradle."""
    return abs(float(_arm_px(detection.place_px, task)) / task.arm_length_px - 1.0)


def _is_allowed(detection: Detection, task: VideoTask) -> bool:
    """Return whether the object can be at a place: a swinging ball has a known distance from its pivot."""
    if task.pivot_px is None or task.motion is Motion.TURN:
        return True
    x_px, y_px = detection.place_px - task.pivot_px
    is_out = task.motion is Motion.PENDULUM or math.atan2(x_px, y_px) > MIN_SWING_RAD
    return is_out and _arc_error(detection, task) <= MAX_ARC_ERROR[task.motion]


def _moving_part(task: VideoTask) -> BoolArray:
    """Return the moving part of the picture, shape [480, 832].

    It is the first place of the object, the plate of a turntable, or the swings of a cradle.
    """
    places_px = np.indices(REFERENCE_SIZE_PX).T.astype(float)
    if task.motion is Motion.TURN:
        return _arm_px(places_px, task) < PLATE_RADIUS_PX
    if task.rest_px is not None:
        return _arm_px(places_px, task) < task.arm_length_px + task.size_px
    away_px = np.linalg.norm(places_px - task.centre_px, axis=-1)
    return np.asarray(away_px < 1.2 * task.size_px)


def _other_likeness(
    candidates: list[list[Detection]], path: list[Detection], task: VideoTask
) -> FloatArray:
    """Return the largest likeness of another place to the object in each frame, shape [frame_count]."""
    largest = []
    for detections, chosen in zip(candidates, path, strict=True):
        likeness = 0.0
        for detection in detections:
            is_near = math.dist(detection.place_px, chosen.place_px) < task.size_px
            # At a place that the object cannot have, it is another object, even if the object is lost.
            is_other = chosen.likeness > 0.0 or not _is_allowed(detection, task)
            if task.motion is Motion.CRADLE:
                is_other &= _arc_error(detection, task) > MAX_NEIGHBOUR_ERROR
            if is_other and not is_near:
                likeness = max(likeness, detection.likeness)
        largest.append(likeness)
    return np.array(largest)


# --- the scene --------------------------------------------------------------------------------------------------------

CHANGED_LEVELS = 30.0
"""Smallest difference of brightness at a changed place."""

MAX_CHANGED_SHARE = 0.2
"""Smallest changed share of the picture in another scene."""

MAX_SHIFT_PX = 2.0
"""Largest mean shift of the corners of the picture with a fixed camera [px]. Sound published clips have 1.8 px."""

MAX_UNKNOWN_SHARE = 0.1
"""Largest share of frames with an unknown motion of the camera."""

MIN_POINTS, MIN_AGREEING_SHARE = 12, 0.4
"""Smallest number and share of points of the scene that must agree on the motion of the camera."""

MIN_MOTION_LEVELS = 12.0
"""Smallest difference of brightness between two small pictures with motion."""

MAX_REPEAT_SHARE = 0.25
"""Largest difference of a repeated picture, relative to its neighbours; compression causes up to a tenth."""

MIN_REPEATS, MIN_REPEATING_SHARE = 3, 0.14
"""Smallest number and share of repeated frames of a motion. A film with 25 pictures per second, shown at 30, repeats
17 %. A pendulum is slow for one frame at each turning point."""


class SceneWatch:
    """Compare the scene of each frame with the first frame.

    Optical flow (Lucas and Kanade, 1981) follows corners of the scene. A shift, a rotation and a scale are fitted to
    them by random samples (RANSAC).

    Args:
        first: The first frame.
        moving: Moving part of the picture, shape [480, 832].
    """

    def __init__(self, first: Picture, moving: BoolArray) -> None:
        self._grey = cv2.cvtColor(first, cv2.COLOR_BGR2GRAY)
        self._is_still = shrunk(moving.astype(np.uint8)) == 0
        mask = np.where(moving, 0, 255).astype(np.uint8)
        points = cv2.goodFeaturesToTrack(self._grey, 150, 0.02, 12, mask=mask)
        self._points = np.zeros((0, 1, 2), np.float32) if points is None else points
        self._pictures: list[Gray] = []
        self._shifts_px: list[float] = []

    def look(self, picture: Picture) -> None:
        """Store a small picture of the next frame and the shift of its camera."""
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        self._pictures.append(shrunk(grey))
        self._shifts_px.append(self._shift_px(grey))

    def events(self) -> list[Event]:
        """Return the events of the camera and the scene."""
        pictures, shifts_px = np.array(self._pictures), np.array(self._shifts_px)
        still = pictures[:, self._is_still]
        changed = (np.abs(still - still[0]) > CHANGED_LEVELS).mean(axis=1)
        steps = np.abs(np.diff(pictures, axis=0, prepend=pictures[:1])).max(axis=(1, 2))
        is_unknown = np.isnan(shifts_px)
        is_unknown &= is_unknown.mean() > MAX_UNKNOWN_SHARE
        largest_px = np.nanmax(shifts_px, initial=0.0)
        events = []
        for text, is_seen in (
            (
                f"the scene changes: up to {changed.max():.0%} of the picture differs from the first frame",
                changed > MAX_CHANGED_SHARE,
            ),
            (
                "the camera moves, or the background has too few features to show that it is fixed",
                is_unknown,
            ),
            (
                f"the camera moves: the corners of the picture shift by up to {largest_px:.1f} px",
                shifts_px > MAX_SHIFT_PX,
            ),
            (
                "frames repeat the previous picture: use the original frame rate of the video",
                _repeats(steps),
            ),
        ):
            if is_seen.any():
                first, last = np.flatnonzero(is_seen)[[0, -1]].tolist()
                events.append(Event(f"{text} (frames {first} to {last})", first))
        return events

    def _shift_px(self, grey: Picture) -> float:
        """Return the mean shift of the corners of the picture since the first frame [px]; NaN if unknown."""
        if len(self._points) < MIN_POINTS:
            return math.nan
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            self._grey, grey, self._points, None, winSize=(21, 21), maxLevel=3
        )
        is_found = status.ravel() == 1
        if is_found.sum() < MIN_POINTS:
            return math.nan
        matrix, is_inlier = cv2.estimateAffinePartial2D(
            self._points[is_found], moved[is_found], ransacReprojThreshold=1.5
        )
        if is_inlier.sum() < max(MIN_POINTS, MIN_AGREEING_SHARE * is_found.sum()):
            return math.nan
        width, height = REFERENCE_SIZE_PX
        corners = np.array([[0, 0], [width, 0], [0, height], [width, height]])
        shifts = corners @ matrix[:, :2].T + matrix[:, 2] - corners
        return float(np.linalg.norm(shifts, axis=1).mean())


def _repeats(steps: FloatArray) -> BoolArray:
    """Return the frames that repeat a picture during a motion; empty if they are few.

    Args:
        steps: Largest difference of brightness between each frame and the previous one, shape [frame_count].
    """
    # The grain of a body at rest is much smaller than its motion.
    min_motion = max(MIN_MOTION_LEVELS, MAX_REPEAT_SHARE * float(steps.max()))
    is_moving = binary_closing(steps > min_motion, np.ones(5))
    is_repeat = is_moving & (steps < MAX_REPEAT_SHARE * maximum_filter1d(steps, 5))
    min_count = max(MIN_REPEATS, MIN_REPEATING_SHARE * is_moving.sum())
    return np.asarray(is_repeat & (is_repeat.sum() >= min_count))
