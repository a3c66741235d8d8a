"""Choose the frames of a track that a law is fitted to: from the release to the end of the first motion.

The paper removes leading and trailing rest with a window of six frames and ends a slide at the first plateau or
reversal. It does not state the thresholds. Those here were chosen before any published value was compared, and are the
same for every clip. Lengths are in pixels of the reference grid.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

WINDOW = 6
"""Frames of the window in which motion or rest is decided, as in the paper."""

MOVING_PX = 1.5
"""Displacement in a window with which an object moves [px]; trackers scatter by 0.1 to 0.4 px."""

MOVING_DEG = 0.8
"""Rotation in a window with which a pendulum moves [degrees]."""

RELEASED_PX = 0.6
"""Displacement from rest that a frame may have and still count as the release [px]."""

OFF_LINE = 0.5
"""Distance from the fixed line at which an object has left it, in its sizes."""

ESTABLISHED = 0.25
"""Displacement with which a motion is established, in sizes of the object."""

REVERSAL_PX = 0.5
"""Step against a fall that is a reversal and no noise [px]."""

APEX_SEPARATION_S = 0.35
"""Shortest time between two apices [s]: about half a period of the cradle's balls."""

LEAST_APEX_RAD = 0.08
"""Smallest angle of an apex [rad]; hanging balls are no event."""


def displacement_px(track: Track, task: VideoTask) -> FloatArray:
    """Return the displacement along the fixed direction of a task since the first place [px], shape [frame_count]."""
    assert task.direction is not None
    points = track.points_px
    first = points[track.is_found][0]
    along: FloatArray = (points - first) @ np.array(task.direction)
    return along


def swing_angles_rad(track: Track, task: VideoTask) -> FloatArray:
    """Return the angle of the object about the pivot, from the vertical [rad], shape [frame_count].

    Equation "c7-angle" of the paper's appendix; positive to the right.
    """
    assert task.pivot_px is not None
    offset = track.points_px - np.array(task.pivot_px)
    angles: FloatArray = np.arctan2(offset[:, 0], offset[:, 1])
    return angles


def retained(track: Track, task: VideoTask) -> tuple[int, int] | None:
    """Return the first and the last retained row of a track; None when the object does not move.

    Args:
        track: The track.
        task: The task, whose kind of motion decides the rule.
    """
    rows = np.flatnonzero(track.is_found)
    if len(rows) <= WINDOW:
        return None
    if task.motion in (Motion.SLIDE, Motion.FALL):
        found = _straight(track, task, rows)
    elif task.motion is Motion.TURN:
        found = _without_rest(track.points_px[rows], MOVING_PX, keeps_end=False)
    else:
        found = _without_rest(np.degrees(swing_angles_rad(track, task)[rows])[:, None], MOVING_DEG, keeps_end=True)
    if found is None:
        return None
    first, last = int(rows[found[0]]), int(rows[found[1]])
    # A slide and a fall may end outside of the picture. A swing and a ride go on, so frames without the object count.
    goes_on = task.motion in (Motion.TURN, Motion.PENDULUM) and last == rows[-1]
    return first, len(track.frames) - 1 if goes_on else last


def apices(times_s: FloatArray, angles_rad: FloatArray) -> NDArray[np.intp]:
    """Return the rows of the apices of a ball that swings out, in order.

    An apex is the largest angle within `APEX_SEPARATION_S` on both sides, and has a later and an earlier neighbour.

    Args:
        times_s: Times of the frames in which the ball was found [s], shape [frame_count].
        angles_rad: Its angles from the vertical [rad], shape [frame_count].
    """
    found: list[int] = []
    for row in range(1, len(times_s) - 1):
        near = np.abs(times_s - times_s[row]) <= APEX_SEPARATION_S
        is_highest = angles_rad[row] >= angles_rad[near].max()
        if is_highest and angles_rad[row] >= LEAST_APEX_RAD and not (found and near[found[-1]]):
            found.append(row)
    return np.array(found, dtype=np.intp)


def _straight(track: Track, task: VideoTask, rows: NDArray[np.intp]) -> tuple[int, int] | None:
    along = displacement_px(track, task)[rows]
    rest = float(np.median(along[: WINDOW // 2]))
    far = np.flatnonzero(along - rest > ESTABLISHED * task.size_px)
    if not len(far):
        return None
    # Back from where motion is established, to the window in which there is none.
    start = established = int(far[0])
    while start > 0 and along[start] - along[max(0, start - WINDOW)] > MOVING_PX:
        start -= 1
    start = max(0, start - WINDOW)
    before = along[start]
    while start + 1 < established and along[start + 1] - before <= RELEASED_PX:
        start += 1
    end = len(rows) - 1
    if task.motion is Motion.FALL and rows[-1] < len(track.frames) - 1:
        # A ball that is lost has often hit the ground, and the last frame that shows it may contain that.
        end -= 1
    for row in range(established, len(rows) - 1):
        # The reversal of a fall is sharp. The frame next to an impact may lie after it.
        if task.motion is Motion.FALL and along[row + 1] - along[row] < -REVERSAL_PX:
            end = row - 1
            break
        later = min(row + WINDOW, len(rows) - 1)
        if later - row >= WINDOW // 2 and along[row + 1 : later + 1].max() - along[row] < MOVING_PX:
            # This frame shows it at rest, and the exposure of the one before may hold the stop.
            end = row - 2
            break
    if task.motion is Motion.SLIDE:
        end = min(end, _last_on_line(track, task, rows, start))
    return (start, end) if end - start >= 3 else None


def _last_on_line(track: Track, task: VideoTask, rows: NDArray[np.intp], start: int) -> int:
    """Return the last row before the object leaves the line of its motion."""
    assert task.direction is not None
    across = np.array([-task.direction[1], task.direction[0]])
    distance = np.abs((track.points_px[rows] - track.points_px[rows[start]]) @ across)
    off = np.flatnonzero(distance[start:] > OFF_LINE * task.size_px)
    return start + int(off[0]) - 1 if len(off) else len(rows) - 1


def _without_rest(values: FloatArray, threshold: float, *, keeps_end: bool) -> tuple[int, int] | None:
    """Return the first and last row without the rest before and, unless it is kept, after the motion."""
    moved = np.linalg.norm(values[WINDOW:] - values[:-WINDOW], axis=1) > threshold
    moving = np.flatnonzero(moved)
    if not len(moving):
        return None
    start = int(moving[0])
    rest = values[start]
    while start + 1 < len(values) and np.linalg.norm(values[start + 1] - rest) <= 0.4 * threshold:
        start += 1
    end = len(values) - 1 if keeps_end else int(moving[-1]) + WINDOW
    return (start, end) if end - start >= WINDOW else None
