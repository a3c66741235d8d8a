"""Say why a track does not follow the object, or does not follow it all the time."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

MAX_ODD_SHARE = 0.15
"""Largest share of the retained frames of a sound track that does not show the object as it was."""

MAX_SIZE_CHANGE = 0.3
"""Largest relative change of the apparent size of an object that is the same one."""

MAX_MISFIT = 0.25
"""Largest difference from the shape in the first frame, in parts of the area.
A disk in the place of its square differs by 0.21, a square in that of its disk by 0.27, and their sides add to it."""

MAX_TINT = 7.0
"""Largest difference from the colour in the first frame, at any brightness, in levels of 255."""

MIN_CONFIDENCE = 0.5
"""Smallest likeness of a frame that shows the object."""

FIRST_SIZES, FIRST_SHAPES = 12, 3
"""Frames whose median is the size that an object has, and those whose median is the misfit of its shape."""

MIN_TWIN_LIKENESS, MIN_CRADLE_TWIN_LIKENESS = 0.65, 0.7
"""Likeness from which another place shows a second object. Other places of sound published clips stay below 0.60, and
beside the ball of a cradle, which has neighbours, below 0.7."""

MIN_TWIN_FRAMES = 3
"""Smallest number of frames with a second object that are no accident."""

MAX_JUMP = 1.0
"""Largest distance that the speeds before and after do not explain, in sizes; beyond it, another object is followed."""

WINDOW = 6
"""Frames after the retained ones that count: a cut or a jump back ends a slide or a fall, as a rebound does."""

MAX_BESIDE, MAX_HIDDEN = 1.25, 3
"""Largest distance from its row, less the step of a frame, at which a ball of a cradle is first or last seen, in its
sizes, since it is not detected beside its neighbours; and frames in which a post may hide it."""

CLEAR_WAY = 7.0
"""Distance from its first place, in its sizes, within which nothing hides a cube on its board or a ball that falls, and
the picture does not end."""

MIN_MOTION = 0.25
"""Smallest distance from its first place of an object that moves, in its sizes."""


STRAIGHT, CURVED = (4, 2), (6, 3)
"""Frames on either side of a cut by which it is judged, and degree of the polynomial that a smooth motion follows."""

MAX_MISSING = 8
"""Largest number of missing frames at a cut that is tried."""

SPEEDS = (0.33, 0.4, 0.5, 0.6, 0.7, 1.4, 1.7, 2.0, 2.5, 3.0)
"""Speeds after a cut that are tried, relative to that before it."""

MIN_BROKEN, MAX_WHOLE = 5.0, 2.0
"""Residual across a cut, relative to the scatter of the track, from which a motion is broken there, and up to which
another clock makes it whole."""

MAX_UNEVEN_FRAMES = 0.2
"""Difference of the steps between frames, in frames, from which the track has a gap that it knows of."""

MIN_SCATTER_PX = 0.2
"""Smallest scatter that is assumed [px]."""


def faults_of(track: Track, task: VideoTask, span: tuple[int, int] | None) -> list[str]:
    """Return why a track is not sound; the law of the motion plays no part.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row; None when the object does not move.
    """
    first, last = span or (0, len(track.frames) - 1)
    rows = np.arange(first, last + 1)
    watched = np.arange(first, min(last + 1 + WINDOW, len(track.frames)))
    faults = [
        event.text
        for event in track.events
        if not event.is_note and event.first_frame <= track.frames[watched[-1]]
    ]
    if span is None:
        faults.append(_short_motion(track, task))
    else:
        faults.append(_clock_fault(track, task, span))
    is_cradle = task.motion is Motion.CRADLE
    min_likeness = MIN_CRADLE_TWIN_LIKENESS if is_cradle else MIN_TWIN_LIKENESS
    is_twin = track.other_likeness >= min_likeness
    if is_twin.sum() >= MIN_TWIN_FRAMES:
        where = _runs_text(track.frames[is_twin])
        faults.append(
            f"a second object of the same shape and colour is seen in frames {where}"
        )
    else:
        # Two alike objects that meet are seen as one, of another size and shape.
        faults += _changes(track, task, rows)
    if is_cradle:
        # The outgoing ball is looked for only where it swings out.
        faults += _appearances(track, task)
    else:
        faults.append(_loss(track, rows))
        faults.append(_first_place(track, task))
        faults.append(_last_place(track, task, last))
        faults.append(_jump(track, task, watched[track.is_found[watched]]))
    return [fault for fault in faults if fault]


def _short_motion(track: Track, task: VideoTask) -> str:
    """Return how far an object gets that slides or falls in too few frames to be judged; empty if it rests."""
    if task.direction is None or not track.is_found.any():
        return ""
    places_px = track.points_px[track.is_found]
    along_px = (places_px - places_px[0]) @ np.array(task.direction)
    away = float(along_px.max()) / task.size_px
    if away <= MIN_MOTION:
        return ""
    return f"the object moves by {away:.1f} of its size, in too few frames to be judged"


def _runs_text(frames: NDArray[np.int64]) -> str:
    """Return frame numbers as runs: `3 to 9, 14`."""
    runs = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1)
    texts = [f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs]
    more = f" and {len(texts) - 4} more runs" if len(texts) > 4 else ""
    return ", ".join(texts[:4]) + more


def _loss(track: Track, rows: NDArray[np.intp]) -> str:
    """Return in which frames the object is lost; empty where these are few."""
    lost = rows[~track.is_found[rows]]
    share = len(lost) / len(rows)
    if share <= MAX_ODD_SHARE:
        return ""
    where = _runs_text(track.frames[lost])
    return f"the object is lost in {share:.0%} of the frames in frames {where}"


def _changes(track: Track, task: VideoTask, rows: NDArray[np.intp]) -> Iterator[str]:
    """Yield by how much the object changes its size, shape, colour and look, in more frames than a few."""
    is_cradle = task.motion is Motion.CRADLE
    found = rows[track.is_found[rows]]
    max_odd = MAX_ODD_SHARE * len(found if is_cradle else rows)
    sizes = track.size_ratio[np.isfinite(track.size_ratio)][:FIRST_SIZES]
    # A cradle's ball is first seen when it has swung out.
    first_size = float(np.median(sizes)) if len(sizes) and not is_cradle else 1.0
    # A background that is never seen is estimated, and so is what differs from it.
    first = track.misfit[track.is_found][:FIRST_SHAPES]
    first_misfit = min(float(np.median(first)), MAX_MISFIT) if len(first) else 0.0
    misfits = np.where(track.is_found, track.misfit - first_misfit, 0.0)
    if (misfits > MAX_MISFIT).mean() <= MAX_ODD_SHARE:
        # Blur alone changes a shape for some frames, and the retained ones may be few.
        misfits[:] = 0.0
    unlikeness = 1.0 - track.confidence
    for text, changes, limit in (
        (
            "changes its size by up to {:+.0%}",
            track.size_ratio / first_size - 1.0,
            MAX_SIZE_CHANGE,
        ),
        (
            "changes its shape by up to {:.0%}",
            misfits,
            MAX_MISFIT,
        ),
        ("changes its colour by up to {:.0f} levels of 255", track.tint, MAX_TINT),
        ("has another look", unlikeness, 1.0 - MIN_CONFIDENCE),
    ):
        odd = found[np.abs(changes[found]) > limit]
        if len(odd) > max_odd:
            largest = text.format(max(changes[odd], key=abs))
            yield f"the object {largest} in frames {_runs_text(track.frames[odd])}"


def _first_place(track: Track, task: VideoTask) -> str:
    """Return how far from its known place an object is first seen; empty where it is near."""
    if track.registration is None or not track.is_found.any():
        return ""
    place = track.points_px[track.is_found][0]
    away = math.dist(place, task.centre_px) / task.size_px
    if away <= MAX_JUMP:
        return ""
    return f"the object is first seen {away:.1f} of its size from its place in the known first frame"


def _last_place(track: Track, task: VideoTask, last: int) -> str:
    """Return where an object is seen for the last time, while it slides or falls, though nothing hides it there."""
    if task.direction is None or not track.is_found.any():
        return ""
    row = int(np.flatnonzero(track.is_found)[-1])
    away = math.dist(track.points_px[row], task.centre_px) / task.size_px
    is_at_end = len(track.frames) - 1 - row <= MAX_HIDDEN
    # A fall is retained up to the last frame but one.
    if is_at_end or row > last + 1 or away > CLEAR_WAY:
        return ""
    return f"the object vanishes on its way: frame {track.frames[row]} is the last that shows it"


def _jump(track: Track, task: VideoTask, rows: NDArray[np.intp]) -> str:
    """Return where the object jumps: farther than the speeds before and after explain; empty where it does not.

    A blend of two pictures spreads a jump over two steps, so pairs of steps are checked too.
    """
    places_px = track.points_px[rows]
    steps_px = np.linalg.norm(np.diff(places_px, axis=0), axis=1)
    # The object rests before its first step and after its last one.
    speeds_px = np.pad(steps_px / np.diff(rows), 1)
    for steps in (1, 2):
        # Within two steps a motion may begin or end too.
        start = np.arange(steps - 1, len(rows) - 2 * steps + 1)
        end = start + steps
        way_px = np.linalg.norm(places_px[end] - places_px[start], axis=1)
        fastest_px = np.maximum(speeds_px[start], speeds_px[end + 1])
        excess = (way_px - (rows[end] - rows[start]) * fastest_px) / task.size_px
        if excess.max(initial=0.0) > MAX_JUMP:
            worst = int(excess.argmax())
            first, last = track.frames[rows[[start[worst], end[worst]]]]
            return (
                f"the object jumps by {excess[worst]:.1f} of its size "
                f"between frames {first} and {last}"
            )
    return ""


def _appearances(track: Track, task: VideoTask) -> Iterator[str]:
    """Yield where the ball of a cradle is first or last seen farther from its row than it moves in a frame."""
    assert task.rest_px is not None
    rows = np.flatnonzero(track.is_found)
    away_px = np.linalg.norm(track.points_px - task.rest_px, axis=1)
    for swing in np.split(rows, np.flatnonzero(np.diff(rows) > MAX_HIDDEN + 1) + 1):
        for row, next_row in (swing[:2], swing[:-3:-1]) if len(swing) > 1 else ():
            step_px = math.dist(track.points_px[row], track.points_px[next_row])
            away = (away_px[row] - step_px) / task.size_px
            if 0 < row < len(track.frames) - 1 and away > MAX_BESIDE:
                yield f"the ball appears or vanishes {away:.1f} of its size from its row in frame {track.frames[row]}"


def _clock_fault(track: Track, task: VideoTask, span: tuple[int, int]) -> str:
    """Return where frames are missing or the speed of a film changes; empty where its clock is that of the motion.

    Across a cut, a smooth curve leaves a large residual. The residual is small once the later frames are moved in time
    by whole frames, or run at another speed. A body that jumps or brakes seldom does that.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row.
    """
    side, degree = CURVED if task.direction is None else STRAIGHT
    rows = np.arange(span[0], span[1] + 1)
    rows = rows[track.is_found[rows]]
    if len(rows) < 2 * side:
        return ""
    windows = np.lib.stride_tricks.sliding_window_view(rows, 2 * side)
    places_px = track.points_px[windows]
    steps_s = np.diff(track.times_s[windows], axis=1)
    is_even = np.ptp(steps_s, axis=1) < MAX_UNEVEN_FRAMES / track.fps
    times = np.arange(2.0 * side) - side
    is_later = times >= 0.0
    scatter_px = max(MIN_SCATTER_PX, track.noise_px(span))
    residuals_px = _residuals_px(places_px, times, degree)
    is_cut = is_even & (residuals_px > MIN_BROKEN * scatter_px)
    if not is_cut.any():
        return ""
    clocks = {
        f"frames seem to be missing, {count} before frame": times + count * is_later
        for count in range(1, MAX_MISSING + 1)
    }
    clocks["a frame seems to be shown again at frame"] = times - is_later
    if is_cut.sum() < 2 * side:
        # One change of speed breaks no more windows than those that contain it; a jerky motion breaks more.
        clocks |= {
            f"the speed of the film seems to change by {speed:g} at frame": np.where(
                is_later, speed * times, times
            )
            for speed in SPEEDS
        }
    best_px, text, window = min(
        (residual_px, text, int(row))
        for text, clock in clocks.items()
        for row, residual_px in zip(
            np.flatnonzero(is_cut),
            _residuals_px(places_px[is_cut], clock, degree),
            strict=True,
        )
    )
    if best_px > MAX_WHOLE * scatter_px:
        return ""
    return f"{text} {track.frames[windows[window, side]]}"


def _residuals_px(places_px: FloatArray, times: FloatArray, degree: int) -> FloatArray:
    """Return the residual of a polynomial in each window [px], of places of shape [window_count, frame_count, 2]."""
    basis = np.vander(times / len(times), degree + 1)
    left_px = places_px - basis @ np.linalg.pinv(basis) @ places_px
    return np.asarray(np.sqrt((left_px**2).sum(axis=(1, 2)) / len(times)))
