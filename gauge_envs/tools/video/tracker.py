"""Track the object of a task through a video, and name what makes the track doubtful."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.camera import SceneWatch
from gauge_envs.tools.video.face import FaceFollower
from gauge_envs.tools.video.frames import (
    LEAST_FRAMES,
    Cadence,
    Frames,
    cadence_of,
)
from gauge_envs.tools.video.laws import GRAVITY_M_PER_S2, LEAST_APEX_RAD
from gauge_envs.tools.video.registration import registration_by_outline
from gauge_envs.tools.video.shape import LEAST_KNOWN_SHARE, ShapeFollower
from gauge_envs.tools.video.sight import Sight
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    Motion,
    VideoTask,
)
from gauge_envs.tools.video.track import Event, Track

BEND, BEND_COST = 0.5, 0.4
"""Change of the velocity from frame to frame, in sizes, that costs `BEND_COST` of a likeness."""

MOST_STEP = 4.0
"""Largest step of a ball that is struck, in sizes or in changes by gravity."""

FIRST_STEP, FIRST_FRAMES = 0.4, 3
"""Largest distance from the known place, in sizes, and frames in which the object is seen there."""

MOST_SWING_RAD = 0.65 * math.pi
"""Largest angle of a cradle's outgoing ball: one that gains momentum rises above its pivot."""

CRADLE_BALLS, ARC_PLACES = 5, 30
"""Balls of the cradle, and places of an arc at which its background is looked at."""

FOREIGN = (
    "the first frame does not show the object of the task at its place, "
    "so its law, scale and direction do not apply"
)
"""What is said of a clip whose first frame shows something else."""

BLIND = (
    "the plate has the colour of the metal, so that its size, its shape and a second object "
    "cannot be seen"
)
"""What is said of metal that is followed by its edges alone."""

LOST_SHARE = 0.02
"""Share of the stated frames that a sound file may lack: some count one too many."""


def track_object(frames: Frames, task: VideoTask) -> Track:
    """Return the track of the object of a task.

    A first pass finds the motion of the camera, and a second one the object in frames from which it is subtracted.

    Args:
        frames: The video; its first frame is the task's known one, in any resolution, stretched, cropped or padded.
        task: The task.
    """
    registration = registration_by_outline(next(frames.native()), task)
    first = next(frames.pictures(registration))
    watch = SceneWatch(first, _moving_part(task))
    last = first
    for last in frames.pictures(registration):
        watch.look(last)
    cadence = cadence_of(np.array(watch.differences), frames.fps, frames.times_s)
    count = int(cadence.is_new.sum())
    if count < LEAST_FRAMES:
        lost = (
            f" that can be decoded, of the {frames.stated_count} that it states"
            if _is_cut(frames, cadence)
            else ""
        )
        raise VideoError(
            f"{frames.name}: it has {count} frames{lost}; a motion needs at least {LEAST_FRAMES}"
        )
    last = watch.steadied(last, len(cadence.is_new) - 1)
    follower = (
        FaceFollower(first, task)
        if task.motion is Motion.TURN
        else ShapeFollower(first, last, task)
    )
    candidates = []
    for number, picture in enumerate(frames.pictures(registration)):
        if cadence.is_new[number]:
            steady = watch.steadied(picture, number)
            watch.compare(steady, number)
            candidates.append(follower.candidates(steady))
    path = followed(candidates, task, cadence.fps)
    numbers = np.flatnonzero(cadence.is_new).tolist()
    centre = task.rest_px or task.centre_px
    early = [
        math.dist(one.place, centre)
        for ones in candidates[:FIRST_FRAMES]
        for one in ones
    ]
    is_foreign = (
        task.motion is not Motion.CRADLE
        and min(early, default=math.inf) > FIRST_STEP * task.size_px
    )
    doubts = (
        registration.problem,
        FOREIGN if is_foreign else "",
        _hidden(follower, task),
    )
    return Track(
        frames=np.flatnonzero(cadence.is_new),
        fps=cadence.fps,
        points_px=np.array([s.place for s in path]),
        confidence=np.array([s.likeness for s in path]),
        size_ratio=np.array([s.size_ratio for s in path]),
        misfit=np.array([s.misfit for s in path]),
        tint=np.array([s.tint for s in path]),
        other_likeness=_other_likeness(candidates, path, task),
        events=(
            *_of_the_file(frames, cadence, *doubts),
            *watch.events(),
        ),
        clock_s=cadence.times_s,
        registration=registration,
        moves=tuple(watch.moves[frame] for frame in numbers),
    )


def followed(candidates: list[list[Sight]], task: VideoTask, fps: float) -> list[Sight]:
    """Return the place of the object in each frame, near where the last ones predict it; empty where it is lost.

    Args:
        candidates: Places that may show the object, by frame; those of a turntable begin with the object.
        task: The task.
        fps: Frames per second.
    """
    if task.motion is Motion.TURN:
        return [next(iter(ones), Sight()) for ones in candidates]
    is_struck = task.motion is Motion.CRADLE
    # A ball on wires that was released at the height of their ends passes its lowest point with twice gravity.
    most_m_s2 = (1.0 if task.direction else 2.0) * GRAVITY_M_PER_S2
    lawful_px = most_m_s2 / fps**2 / task.scale_m_per_px
    usual_px = max(BEND * task.size_px, lawful_px)
    start = np.array(task.rest_px or task.centre_px)
    place, step, gap, seen = start, np.zeros(2), 1, 0
    speeds_px = [0.0, 0.0]
    path = []
    for ones in candidates:
        chosen, best_likeness = Sight(), 0.0
        for one in ones:
            away_px = math.dist(one.place, place + gap * step)
            if task.direction is not None:
                # An impact stops a body or turns its velocity; when it came between two frames is unknown.
                away_px = min(away_px, math.dist(one.place, place))
            most_px = gap * max(usual_px, *speeds_px)
            cost = BEND_COST * (away_px / most_px) ** 2
            if is_struck and seen < 2:
                # When it was struck between two frames is unknown, and so is the velocity of its first step.
                is_near = away_px < MOST_STEP * max(task.size_px, lawful_px)
                cost = 0.0 if is_near else math.inf
            if one.likeness - cost > best_likeness and _is_allowed(one, task):
                chosen, best_likeness = one, one.likeness - cost
        path.append(chosen)
        if chosen.likeness > 0.0:
            step, place = (chosen.place - place) / gap, chosen.place
            gap, seen = 1, seen + 1
            if task.motion is Motion.FALL:
                speeds_px = [speeds_px[1], float(np.linalg.norm(step))]
        else:
            gap, seen = gap + 1, 0
            if is_struck:
                # A ball that hangs is not looked for.
                place, step = start, np.zeros(2)
    return path


def _of_the_file(
    frames: Frames, cadence: Cadence, registration: str, foreign: str, hidden: str
) -> Iterator[Event]:
    """Yield what is doubtful in the whole of a video: how it lies on the grid, what it shows and hides, its frames."""
    cut = f"the file states {frames.stated_count} frames, and {len(cadence.is_new)} can be decoded"
    for kind, text in (
        ("registration", registration),
        ("picture", foreign),
        ("scene", hidden),
        ("file", cut if _is_cut(frames, cadence) else ""),
        ("cadence", cadence.text),
        ("time", cadence.fault),
    ):
        if text:
            last = int(np.flatnonzero(cadence.is_new)[-1])
            yield Event(
                kind=kind,
                first_frame=0,
                last_frame=last,
                text=text,
                is_note=kind == "cadence",
            )


def _is_cut(frames: Frames, cadence: Cadence) -> bool:
    """Return whether a file holds fewer frames than it states."""
    return frames.stated_count > len(cadence.is_new) * (1.0 + LOST_SHARE)


def _is_allowed(sight: Sight, task: VideoTask) -> bool:
    """Return whether the object can be at a place: a swinging one only at a known distance from its pivot."""
    if task.pivot_px is None:
        return True
    x, y = sight.place - task.pivot_px
    length = math.dist(task.rest_px or task.centre_px, task.pivot_px)
    if task.motion is Motion.PENDULUM:
        return 0.8 * length <= math.hypot(x, y) <= 1.2 * length
    return (
        0.92 * length <= math.hypot(x, y) <= 1.08 * length
        and 0.05 < math.atan2(x, y) < MOST_SWING_RAD
    )


def _row_px(task: VideoTask) -> float:
    """Return how far to the left of the last ball the first one of a cradle hangs [px]."""
    return (CRADLE_BALLS - 1) * task.size_px


def _is_neighbour(sight: Sight, task: VideoTask) -> bool:
    """Return whether another ball of a cradle can be at a place: the first one on its arc, all of them near the row."""
    if task.motion is not Motion.CRADLE or _is_allowed(sight, task):
        return False
    assert task.pivot_px is not None and task.rest_px is not None
    x, y = sight.place - task.pivot_px
    length, row_px = task.rest_px[1] - task.pivot_px[1], _row_px(task)
    first_x = x + row_px
    is_on_arc = (
        first_x < 0.0 and 0.92 * length <= math.hypot(first_x, y) <= 1.08 * length
    )
    is_in_row = -row_px - task.size_px < x < task.size_px
    return is_on_arc or (is_in_row and abs(y - length) < task.size_px)


def _moving_part(task: VideoTask) -> NDArray[np.bool_]:
    """Return where the picture changes on purpose.

    That is around the object's first place, on the plate of a turntable, and where the balls of a cradle swing.
    """
    width, height = REFERENCE_SIZE_PX
    rows, columns = np.mgrid[0:height, 0:width]
    if task.motion is Motion.CRADLE:
        assert task.pivot_px is not None and task.rest_px is not None
        x, y = task.pivot_px
        first_x = x - _row_px(task)
        reach = task.rest_px[1] - y + task.size_px
        away = np.hypot(columns - np.clip(columns, first_x, x), rows - y)
        return (away < reach) & (rows > y - task.size_px)
    centre, radius = np.array(task.centre_px), 1.2 * task.size_px
    if task.motion is Motion.TURN:
        assert task.pivot_px is not None
        centre, radius = np.array(task.pivot_px), PLATE_RADIUS_PX
    return np.hypot(columns - centre[0], rows - centre[1]) < radius


def _other_likeness(
    candidates: list[list[Sight]], path: list[Sight], task: VideoTask
) -> FloatArray:
    """Return in each frame the likeness of another place that is most like the object, shape [frame_count]."""
    largest = np.zeros(len(path))
    for row, (ones, chosen) in enumerate(zip(candidates, path, strict=True)):
        for one in ones:
            is_near = math.dist(one.place, chosen.place) < task.size_px
            # Where an object cannot be, it is seen for another one although its own place is unknown.
            is_other = chosen.likeness > 0.0 or not _is_allowed(one, task)
            if is_other and not is_near and not _is_neighbour(one, task):
                largest[row] = max(largest[row], one.likeness)
    return largest


def _hidden(follower: ShapeFollower | FaceFollower, task: VideoTask) -> str:
    """Return what cannot be told from what is behind it: metal, or low swings that the mean would lack."""
    if isinstance(follower, FaceFollower):
        return BLIND if follower.is_blind else ""
    if task.motion is not Motion.CRADLE:
        return ""
    assert task.pivot_px is not None and task.rest_px is not None
    length_px = math.dist(task.rest_px, task.pivot_px)
    angles_rad = np.linspace(LEAST_APEX_RAD, 0.5 * math.pi, ARC_PLACES)
    arc = length_px * np.column_stack([np.sin(angles_rad), np.cos(angles_rad)])
    shares = np.array([follower.known_share(task.pivot_px + one) for one in arc])
    blind_deg = np.degrees(angles_rad[shares < LEAST_KNOWN_SHARE])
    if not len(blind_deg):
        return ""
    return (
        f"swings of {blind_deg.min():.0f} to {blind_deg.max():.0f} degrees may be missed: the background there has the "
        "colour of the ball"
    )
