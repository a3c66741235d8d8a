"""Track the object of a task through a video, and name what makes the track doubtful."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from gauge_envs.errors import VideoError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.camera import SceneWatch
from gauge_envs.tools.video.face import FaceDetector
from gauge_envs.tools.video.frames import MIN_FRAMES, Frames, cadence_of
from gauge_envs.tools.video.registration import registration_by_outline
from gauge_envs.tools.video.shape import ShapeDetector
from gauge_envs.tools.video.sight import Detection
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    Motion,
    VideoTask,
)
from gauge_envs.tools.video.track import Event, Track

BEND, BEND_COST = 0.5, 0.4
"""Change of the velocity from frame to frame, in sizes, that costs `BEND_COST` of a likeness."""

MAX_STRUCK_STEP = 4.0
"""Largest first step of a ball that is struck, in sizes or in changes by gravity."""

MAX_ARC_ERROR = {Motion.CRADLE: 0.08, Motion.PENDULUM: 0.2}
"""Largest relative difference of the distance of a swinging ball from its pivot."""

MIN_SWING_RAD = 0.05
"""Smallest angle at which the outgoing ball of a cradle is looked for."""

MAX_NEIGHBOUR_ERROR = 0.15
"""Largest relative difference of the distance of another ball of a cradle from its pivot."""

CRADLE_BALLS = 5
"""Balls of the cradle."""


def track_object(frames: Frames, task: VideoTask) -> Track:
    """Return the track of the object of a task.

    A first pass finds the motion of the camera, and a second one the object in frames from which it is subtracted.

    Args:
        frames: The video; its first frame is the task's known one, in any resolution, stretched, cropped or padded.
        task: The task.

    Raises:
        VideoError: The video has too few frames.
    """
    registration = registration_by_outline(next(frames.native()), task)
    first = last = next(frames.pictures(registration))
    watch = SceneWatch(first, _moving_part(task))
    for last in frames.pictures(registration):
        watch.look(last)
    cadence = cadence_of(np.array(watch.differences), frames.fps, frames.times_s)
    numbers = np.flatnonzero(cadence.is_new)
    if len(numbers) < MIN_FRAMES:
        raise VideoError(
            f"{frames.name}: it has {len(numbers)} frames; a motion needs at least {MIN_FRAMES}"
        )
    detector = (
        FaceDetector(first, task)
        if task.motion is Motion.TURN
        else ShapeDetector(first, watch.steadied(last, -1), task)
    )
    candidates = [
        detector.candidates(watch.steadied(picture, number))
        for number, picture in enumerate(frames.pictures(registration))
        if cadence.is_new[number]
    ]
    path = followed(candidates, task, cadence.fps)
    texts = {"registration": registration.problem, "cadence": cadence.text}
    events = [
        Event(kind=kind, text=text, is_note=kind == "cadence")
        for kind, text in texts.items()
        if text
    ]
    return Track(
        frames=numbers,
        fps=cadence.fps,
        points_px=np.array([one.place_px for one in path]),
        confidence=np.array([one.likeness for one in path]),
        size_ratio=np.array([one.size_ratio for one in path]),
        misfit=np.array([one.misfit for one in path]),
        tint=np.array([one.tint for one in path]),
        other_likeness=_other_likeness(candidates, path, task),
        events=(*events, *watch.events()),
        clock_s=cadence.times_s,
        registration=registration,
        moves=tuple(watch.moves[number] for number in numbers),
    )


def followed(
    candidates: list[list[Detection]], task: VideoTask, fps: float
) -> list[Detection]:
    """Return the detection of the object in each frame, near where the last ones predict it; empty where it is lost.

    Args:
        candidates: Detections that may show the object, by frame; those of a turntable begin with the object.
        task: The task.
        fps: Frames per second.
    """
    if task.motion is Motion.TURN:
        return [next(iter(found), Detection()) for found in candidates]
    is_cradle = task.motion is Motion.CRADLE
    start_px = np.array(task.rest_px or task.centre_px)
    # A ball on wires that was released at the height of their ends passes its lowest point with twice gravity.
    max_m_per_s2 = (1.0 if task.direction else 2.0) * constants.g
    gravity_px = max_m_per_s2 / fps**2 / task.scale_m_per_px
    place_px, step_px, gap, seen = start_px, np.zeros(2), 1, 0
    path = []
    for found in candidates:
        bend_px = gap * max(BEND * task.size_px, gravity_px)
        if task.motion is Motion.FALL:
            # An impact turns the velocity.
            bend_px = max(bend_px, gap * float(np.linalg.norm(step_px)))
        expected_px = [place_px + gap * step_px]
        if task.direction is not None:
            # An impact stops a body at an unknown time between two frames.
            expected_px.append(place_px)
        if is_cradle and seen < 2:
            # The time of the strike between two frames is unknown, and so is the velocity of the first step.
            bend_px = MAX_STRUCK_STEP * max(task.size_px, gravity_px)
        best, best_value = Detection(), 0.0
        for one in found:
            away_px = min(math.dist(one.place_px, place) for place in expected_px)
            value = one.likeness - BEND_COST * (away_px / bend_px) ** 2
            if value > best_value and _is_allowed(one, task):
                best, best_value = one, value
        path.append(best)
        if best_value > 0.0:
            step_px, place_px = (best.place_px - place_px) / gap, best.place_px
            gap, seen = 1, seen + 1
        elif is_cradle:
            # A ball that hangs is not looked for.
            place_px, step_px, seen = start_px, np.zeros(2), 0
        else:
            gap += 1
    return path


def _arm_px(places_px: FloatArray, task: VideoTask) -> FloatArray:
    """Return the distances of places, shape [..., 2], from the pivot, or from the row of pivots of a cradle [px]."""
    arms_px = places_px - np.array(task.pivot_px)
    row_px = (CRADLE_BALLS - 1) * task.size_px if task.rest_px else 0.0
    arms_px[..., 0] -= np.clip(arms_px[..., 0], -row_px, 0.0)
    return np.asarray(np.linalg.norm(arms_px, axis=-1))


def _arc_error(detection: Detection, task: VideoTask) -> float:
    """Return the relative difference of the distance from the pivot, or from the row of pivots of a cradle."""
    return abs(float(_arm_px(detection.place_px, task)) / _length_px(task) - 1.0)


def _length_px(task: VideoTask) -> float:
    """Return the length of the string or rod of a swing [px]."""
    assert task.pivot_px is not None
    return math.dist(task.rest_px or task.centre_px, task.pivot_px)


def _is_allowed(detection: Detection, task: VideoTask) -> bool:
    """Return whether the object can be at a place: a swinging ball only at a known distance from its pivot."""
    if task.pivot_px is None or task.motion is Motion.TURN:
        return True
    x_px, y_px = detection.place_px - task.pivot_px
    is_out = task.motion is Motion.PENDULUM or math.atan2(x_px, y_px) > MIN_SWING_RAD
    return is_out and _arc_error(detection, task) <= MAX_ARC_ERROR[task.motion]


def _moving_part(task: VideoTask) -> NDArray[np.bool_]:
    """Return where the picture changes on purpose, shape [480, 832].

    That is around the object's first place, on the plate of a turntable, and where the balls of a cradle swing.
    """
    places_px = np.indices(REFERENCE_SIZE_PX).T.astype(float)
    if task.motion is Motion.TURN:
        return _arm_px(places_px, task) < PLATE_RADIUS_PX
    if task.rest_px is not None:
        return _arm_px(places_px, task) < _length_px(task) + task.size_px
    away_px = np.linalg.norm(places_px - task.centre_px, axis=-1)
    return np.asarray(away_px < 1.2 * task.size_px)


def _other_likeness(
    candidates: list[list[Detection]], path: list[Detection], task: VideoTask
) -> FloatArray:
    """Return in each frame the likeness of another place that is most like the object, shape [frame_count]."""
    largest = np.zeros(len(path))
    for row, (found, chosen) in enumerate(zip(candidates, path, strict=True)):
        for one in found:
            is_near = math.dist(one.place_px, chosen.place_px) < task.size_px
            # Where the object cannot be, it is another one although the place of the object is unknown.
            is_other = chosen.likeness > 0.0 or not _is_allowed(one, task)
            if task.motion is Motion.CRADLE:
                is_other &= _arc_error(one, task) > MAX_NEIGHBOUR_ERROR
            if is_other and not is_near:
                largest[row] = max(largest[row], one.likeness)
    return largest
