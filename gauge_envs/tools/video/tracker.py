"""Track the object of a task through a video, and report events that make the track doubtful."""

import math

import numpy as np
from scipy import constants

from gauge_envs.errors import VideoError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.face import FaceDetector
from gauge_envs.tools.video.frames import (
    FileFrames,
    Picture,
    cv2,
    registration_by_outline,
)
from gauge_envs.tools.video.shape import LOST, Detection, ShapeDetector
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    MotionKind,
    VideoTask,
)
from gauge_envs.tools.video.track import Track

MIN_FRAMES = 8
"""Smallest number of frames of a video."""

BEND, BEND_COST = 0.5, 0.4
"""Change of the velocity between frames, in sizes, that reduces the likeness by `BEND_COST`."""

MAX_STRUCK_STEP = 4.0
"""Largest first step of a struck ball, in sizes or in changes by gravity."""

MAX_ARC_ERROR = {MotionKind.CRADLE: 0.08, MotionKind.PENDULUM: 0.2}
"""Largest relative error of the distance of a swinging ball from its pivot."""

MIN_SWING_RAD = 0.05
"""Smallest angle of the outgoing ball of a cradle in the search."""

MAX_NEIGHBOUR_ERROR = 0.15
"""Largest relative error of the distance of other balls of a cradle from their pivots."""

CRADLE_BALLS = 5
"""Number of balls of the cradle."""


def track_object(frames: FileFrames, task: VideoTask) -> Track:
    """Return the track of the object of a task.

    The first pass compares the background of each frame with the first frame. The second pass detects the object.

    Args:
        frames: The video. Its first frame is the known frame of the task, stretched, cropped or padded to any size.
        task: The task.

    Raises:
        VideoError: The video has too few frames.
    """
    registration = registration_by_outline(next(iter(frames)), task)
    first = last = registration.applied(next(iter(frames)))
    points = _background_points(first, task)
    shifts_px = []
    for picture in frames:
        last = registration.applied(picture)
        shifts_px.append(_camera_shift_px(first, last, points))
    count = len(shifts_px)
    if count < MIN_FRAMES:
        raise VideoError(
            f"{frames.path}: it has {count} frames; a motion needs at least {MIN_FRAMES}"
        )
    detector = (
        FaceDetector(first, task)
        if task.motion is MotionKind.TURN
        else ShapeDetector(first, last, task)
    )
    candidates = [
        detector.candidates(registration.applied(picture)) for picture in frames
    ]
    path = followed(candidates, task, frames.fps)
    places_px, likeness, misfit = map(np.array, zip(*path, strict=True))
    events = [registration.problem] if registration.problem else []
    has_moved = np.array(shifts_px) > MAX_SHIFT_PX
    if has_moved.mean() > MAX_MOVING_SHARE:
        events.append(
            f"the camera moves from frame {has_moved.argmax()}, or the background has too few features to show that it "
            "is fixed"
        )
    return Track(
        frames=np.arange(count),
        times_s=np.arange(count) / frames.fps,
        fps=frames.fps,
        points_px=places_px,
        confidence=likeness,
        misfit=misfit,
        other_likeness=_other_likeness(candidates, path, task),
        events=tuple(events),
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
    if task.motion is MotionKind.TURN:
        return [next(iter(detections), LOST) for detections in candidates]
    is_cradle = task.motion is MotionKind.CRADLE
    start_px = np.array(task.rest_px or task.centre_px)
    # A ball on wires, released at the height of its pivot, has an acceleration of twice gravity at its lowest point.
    max_m_per_s2 = (1.0 if task.direction else 2.0) * constants.g
    gravity_px = max_m_per_s2 / fps**2 / task.scale_m_per_px
    place_px, step_px, gap, seen_count = start_px, np.zeros(2), 1, 0
    path = []
    for detections in candidates:
        bend_px = gap * max(BEND * task.size_px, gravity_px)
        if task.motion is MotionKind.FALL:
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
    if task.pivot_px is None or task.motion is MotionKind.TURN:
        return True
    x_px, y_px = detection.place_px - task.pivot_px
    is_out = (
        task.motion is MotionKind.PENDULUM or math.atan2(x_px, y_px) > MIN_SWING_RAD
    )
    return is_out and _arc_error(detection, task) <= MAX_ARC_ERROR[task.motion]


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
            if task.motion is MotionKind.CRADLE:
                is_other &= _arc_error(detection, task) > MAX_NEIGHBOUR_ERROR
            if is_other and not is_near:
                likeness = max(likeness, detection.likeness)
        largest.append(likeness)
    return np.array(largest)


# --- the camera -------------------------------------------------------------------------------------------------------

MAX_SHIFT_PX = 2.0
"""Largest mean shift of the corners of the picture with a fixed camera [px]. Sound published clips have 1.8 px."""

MAX_MOVING_SHARE = 0.1
"""Largest share of frames with a moved camera or with an unknown motion of the camera."""

MIN_POINTS, MIN_AGREEING_SHARE = 12, 0.4
"""Smallest number and share of points of the scene that must agree on the motion of the camera."""


def _background_points(first: Picture, task: VideoTask) -> FloatArray | None:
    """Return corners of the first frame away from the object, and from its swing or ride; None without any."""
    places_px = np.indices(REFERENCE_SIZE_PX).T.astype(float)
    away_px = np.linalg.norm(places_px - task.centre_px, axis=-1)
    if task.pivot_px is not None:
        away_px = _arm_px(places_px, task) - task.arm_length_px
    is_still = (away_px > 1.2 * task.size_px).astype(np.uint8)
    grey = cv2.cvtColor(first, cv2.COLOR_BGR2GRAY)
    corners: FloatArray | None = cv2.goodFeaturesToTrack(
        grey, 150, 0.02, 12, mask=is_still
    )
    return corners


def _camera_shift_px(
    first: Picture, picture: Picture, points: FloatArray | None
) -> float:
    """Return the mean shift of the corners of a picture since the first one [px]; infinite if unknown.

    Optical flow (Lucas and Kanade, 1981) follows points of the background. A shift, a rotation and a scale are fitted
    to them by random samples (RANSAC).
    """
    if points is None:
        return math.inf
    before, after = (
        cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in (first, picture)
    )
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points, None, winSize=(21, 21), maxLevel=3
    )
    is_found = status.ravel() == 1
    if is_found.sum() < MIN_POINTS:
        return math.inf
    matrix, is_inlier = cv2.estimateAffinePartial2D(
        points[is_found], moved[is_found], ransacReprojThreshold=1.5
    )
    if is_inlier.mean() < MIN_AGREEING_SHARE:
        return math.inf
    width, height = REFERENCE_SIZE_PX
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]])
    shifts = corners @ matrix[:, :2].T + matrix[:, 2] - corners
    return float(np.linalg.norm(shifts, axis=1).mean())
