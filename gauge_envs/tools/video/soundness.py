"""Find reasons why a track does not always follow the object."""

import math
from collections.abc import Iterator

import numpy as np

from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.video.tasks import MotionKind, VideoTask
from gauge_envs.tools.video.track import Track

MAX_ODD_SHARE = 0.15
"""Largest share of retained frames with a changed object in an accepted track."""

MAX_MISFIT = 0.25
"""Largest difference from size and shape in the first frame, relative to the area.

A disk instead of a square differs by 0.21, a square instead of a disk by 0.27, and visible sides add to it."""

MIN_CONFIDENCE = 0.5
"""Smallest likeness of a frame with the object."""

MIN_TWIN_LIKENESS = 0.7
"""Smallest likeness of a second object. Other places in accepted published clips stay below 0.7."""

MIN_TWIN_FRAMES = 3
"""Smallest number of frames with a second object."""

MAX_JUMP = 1.0
"""Largest distance that the speeds before and after do not explain, in sizes. A larger one means another object."""

WINDOW = 6
"""Number of checked frames after the retained ones: cuts and jumps end a slide or a fall, like rebounds."""

MAX_HIDDEN = 3
"""Largest number of frames without the object at the end of a film."""

CLEAR_PATH = 7.0
"""Distance from the first place in which a sliding cube or a falling ball is always visible, in sizes."""

STRAIGHT, CURVED = (4, 2), (6, 3)
"""Number of frames on either side of a possible cut, and degree of the polynomial of a smooth motion."""

MAX_MISSING = 8
"""Largest tested number of missing frames at a cut."""

MIN_BROKEN, MAX_WHOLE = 5.0, 2.0
"""Smallest residual of a broken motion, and largest residual of a whole motion, relative to the scatter."""

MIN_SCATTER_PX = 0.2
"""Smallest assumed scatter [px]."""


def faults_of(track: Track, task: VideoTask, span: tuple[int, int] | None) -> list[str]:
    """Return why a track is rejected, independent of the law of the motion.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row; None if the object does not move.
    """
    first, last = span or (0, len(track.frames) - 1)
    rows = np.arange(first, last + 1)
    faults = [*track.events]
    if span is not None:
        faults += _clock_fault(track, task, rows)
    is_twin = track.other_likeness >= MIN_TWIN_LIKENESS
    if is_twin.sum() >= MIN_TWIN_FRAMES:
        where = _range_text(track.frames[is_twin])
        faults.append(
            f"a second object of the same shape and colour is visible in {where}"
        )
    else:
        # Two equal objects that meet look like one object of another size and shape.
        faults += _changes(track, task, rows)
    if task.motion is MotionKind.CRADLE:
        # The outgoing ball is detected only during its swing.
        return faults
    lost = rows[~track.is_found[rows]]
    if len(lost) > MAX_ODD_SHARE * len(rows):
        faults.append(f"the object is lost in {_range_text(track.frames[lost])}")
    if track.is_found.any():
        faults += _ends(track, task, last)
        faults += _jump(track, task, last + WINDOW)
    return faults


def _range_text(frames: IntArray) -> str:
    """Return the number of frames, and the first and last frame."""
    return f"{len(frames)} frames from {frames[0]} to {frames[-1]}"


def _changes(track: Track, task: VideoTask, rows: IntArray) -> Iterator[str]:
    """Yield changes of size, shape and look that occur in many frames."""
    visible = rows[track.is_found[rows]]
    # The ball of a cradle is visible only during its swing.
    count = len(visible if task.motion is MotionKind.CRADLE else rows)
    # Blur changes the shape for some frames, and few frames may be retained.
    is_reshaped = (track.misfit > MAX_MISFIT).mean() > MAX_ODD_SHARE
    for text, changes, limit, row_count in (
        ("size or shape", track.misfit * is_reshaped, MAX_MISFIT, count),
        # At its largest speed, blur reduces the likeness of the ball of a cradle.
        ("look", 1.0 - track.confidence, 1.0 - MIN_CONFIDENCE, len(rows)),
    ):
        odd = visible[changes[visible] > limit]
        if len(odd) > MAX_ODD_SHARE * row_count:
            where = _range_text(track.frames[odd])
            yield f"the object changes its {text} by up to {changes[odd].max():.0%} in {where}"


def _ends(track: Track, task: VideoTask, last: int) -> Iterator[str]:
    """Yield a wrong first place, and the frame in which an object vanishes during a slide or fall."""
    first_px, size_px = track.points_px[track.is_found][0], task.size_px
    away = math.dist(first_px, task.centre_px) / size_px
    if away > MAX_JUMP:
        yield f"the object first appears {away:.1f} of its size from its place in the known first frame"
    is_clear = math.dist(track.points_px[last], task.centre_px) < CLEAR_PATH * size_px
    is_found = track.is_found[last + 1 : last + 1 + WINDOW]
    if (
        task.direction
        and is_clear
        and len(is_found) > MAX_HIDDEN
        and not is_found.any()
    ):
        yield f"the object vanishes after frame {track.frames[last]}"


def _jump(track: Track, task: VideoTask, last: int) -> Iterator[str]:
    """Yield the largest jump that exceeds the speeds before and after it.

    Args:
        track: The track.
        task: The task.
        last: Last checked row.
    """
    rows = np.flatnonzero(track.is_found[: last + 1])
    steps_px = np.linalg.norm(np.diff(track.points_px[rows], axis=0), axis=1)
    gaps = np.diff(rows)
    # The object rests before its first step and after its last one.
    speeds_px = np.pad(steps_px / gaps, 1)
    fastest_px = np.maximum(speeds_px[:-2], speeds_px[2:])
    excess = (steps_px - gaps * fastest_px) / task.size_px
    if excess.max(initial=0.0) > MAX_JUMP:
        worst = int(excess.argmax())
        first, last = track.frames[rows[[worst, worst + 1]]]
        yield f"the object jumps by {excess[worst]:.1f} of its size between frames {first} and {last}"


def _clock_fault(track: Track, task: VideoTask, rows: IntArray) -> Iterator[str]:
    """Yield the place of missing frames.

    At a cut, a smooth curve has a large residual, which becomes small if the later frames are delayed by whole frames.
    A body that jumps or brakes seldom has this property.

    Args:
        track: The track.
        task: The task.
        rows: The retained rows.
    """
    side, degree = CURVED if task.direction is None else STRAIGHT
    scatter_px = max(MIN_SCATTER_PX, track.noise_px((rows[0], rows[-1])))
    rows = rows[track.is_found[rows]]
    if len(rows) < 2 * side:
        return
    windows = np.lib.stride_tricks.sliding_window_view(rows, 2 * side)
    # Known gaps are not cuts.
    windows = windows[np.ptp(track.frames[windows], axis=1) < 2 * side]
    times = np.arange(2.0 * side) - side
    residuals_px = np.array(
        [
            _residuals_px(track.points_px[windows], times + gap * (times >= 0), degree)
            for gap in range(MAX_MISSING + 1)
        ]
    )
    is_cut = residuals_px[0] > MIN_BROKEN * scatter_px
    residuals_px[:, ~is_cut] = np.inf
    if residuals_px.min(initial=np.inf) <= MAX_WHOLE * scatter_px:
        missing, window = np.unravel_index(residuals_px.argmin(), residuals_px.shape)
        frame = track.frames[windows[window, side]]
        yield f"frames seem to be missing, {missing} before frame {frame}"


def _residuals_px(places_px: FloatArray, times: FloatArray, degree: int) -> FloatArray:
    """Return the residual of a polynomial in each window [px], for places of shape [window_count, frame_count, 2]."""
    basis = np.vander(times / len(times), degree + 1)
    left_px = places_px - basis @ np.linalg.pinv(basis) @ places_px
    return np.asarray(np.sqrt((left_px**2).sum(axis=(1, 2)) / len(times)))
