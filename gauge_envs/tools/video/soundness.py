"""Say why a track does not follow the object, or does not follow it all the time."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.laws import displacement_px
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
    if span is not None:
        faults += _clock_fault(track, task, span)
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
    if task.rest_px is not None:
        # The outgoing ball is looked for only where it swings out; a post may hide it for some frames.
        is_swinging = binary_closing(track.is_found, np.ones(MAX_HIDDEN + 1))
        places_px = np.where(is_swinging[:, None], track.points_px, task.rest_px)
        return [*faults, *_jump(track, task, places_px, MAX_BESIDE, (1,))]
    lost = rows[~track.is_found[rows]]
    if len(lost) > MAX_ODD_SHARE * len(rows):
        share, where = len(lost) / len(rows), _runs_text(track.frames[lost])
        faults.append(
            f"the object is lost in {share:.0%} of the frames in frames {where}"
        )
    if track.is_found.any():
        faults += _ends(track, task, last)
        faults += _jump(track, task, track.points_px[: watched[-1] + 1], MAX_JUMP)
        if span is None and task.direction is not None:
            away = float(np.nanmax(displacement_px(track, task))) / task.size_px
            if away > MIN_MOTION:
                faults.append(
                    f"the object moves by {away:.1f} of its size, in too few frames to be judged"
                )
    return faults


def _runs_text(frames: NDArray[np.int64]) -> str:
    """Return frame numbers as runs: `3 to 9, 14`."""
    runs = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1)
    texts = [f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs]
    more = f" and {len(texts) - 4} more runs" if len(texts) > 4 else ""
    return ", ".join(texts[:4]) + more


def _changes(track: Track, task: VideoTask, rows: NDArray[np.intp]) -> Iterator[str]:
    """Yield by how much the object changes its size, shape, colour and look, in more frames than a few."""
    found = rows[track.is_found[rows]]
    # A cradle's ball is first seen when it has swung out. Blur makes it less like itself at its largest speed.
    count = len(found if task.motion is Motion.CRADLE else rows)
    # Blur alone changes a shape for some frames, and the retained ones may be few.
    is_reshaped = (track.misfit > MAX_MISFIT).mean() > MAX_ODD_SHARE
    sizes, shapes = track.size_ratio - 1.0, track.misfit * is_reshaped
    unlikeness = 1.0 - track.confidence
    for text, changes, limit, among in (
        ("changes its size by up to {:+.0%}", sizes, MAX_SIZE_CHANGE, count),
        ("changes its shape by up to {:.0%}", shapes, MAX_MISFIT, count),
        (
            "changes its colour by up to {:.0f} levels of 255",
            track.tint,
            MAX_TINT,
            count,
        ),
        ("has another look", unlikeness, 1.0 - MIN_CONFIDENCE, len(rows)),
    ):
        odd = found[np.abs(changes[found]) > limit]
        if len(odd) > MAX_ODD_SHARE * among:
            largest = text.format(max(changes[odd], key=abs))
            yield f"the object {largest} in frames {_runs_text(track.frames[odd])}"


def _ends(track: Track, task: VideoTask, last: int) -> Iterator[str]:
    """Yield how far from its known place an object is first seen, and where it vanishes while it slides or falls."""
    rows = np.flatnonzero(track.is_found)[[0, -1]]
    away_px = np.linalg.norm(track.points_px[rows] - task.centre_px, axis=1)
    first_away, last_away = (away_px / task.size_px).tolist()
    if track.registration is not None and first_away > MAX_JUMP:
        yield f"the object is first seen {first_away:.1f} of its size from its place in the known first frame"
    is_at_end = len(track.frames) - 1 - rows[1] <= MAX_HIDDEN
    # A fall is retained up to the last frame but one.
    is_retained = rows[1] <= last + 1
    is_clear = task.direction is not None and last_away <= CLEAR_WAY
    if is_clear and is_retained and not is_at_end:
        yield f"the object vanishes on its way: frame {track.frames[rows[1]]} is the last that shows it"


def _jump(
    track: Track,
    task: VideoTask,
    places_px: FloatArray,
    max_jump: float,
    strides: tuple[int, ...] = (1, 2),
) -> Iterator[str]:
    """Yield where the object jumps: farther than the speeds before and after explain.

    A blend of two pictures spreads a jump over two steps, so that pairs of steps are checked too.

    Args:
        track: The track.
        task: The task.
        places_px: Places by row, shape [row_count, 2]; NaN where the object is lost.
        max_jump: Largest distance that the speeds do not explain, in sizes.
        strides: Numbers of steps over which a jump is looked for.
    """
    rows = np.flatnonzero(np.isfinite(places_px).all(axis=1))
    places_px = places_px[rows]
    steps_px = np.linalg.norm(np.diff(places_px, axis=0), axis=1)
    # The object rests before its first step and after its last one.
    speeds_px = np.pad(steps_px / np.diff(rows), 1)
    for steps in strides:
        # Within two steps a motion may begin or end too.
        start = np.arange(steps - 1, len(rows) - 2 * steps + 1)
        end = start + steps
        way_px = np.linalg.norm(places_px[end] - places_px[start], axis=1)
        fastest_px = np.maximum(speeds_px[start], speeds_px[end + 1])
        excess = (way_px - (rows[end] - rows[start]) * fastest_px) / task.size_px
        if excess.max(initial=0.0) > max_jump:
            worst = int(excess.argmax())
            first, last = track.frames[rows[[start[worst], end[worst]]]]
            yield f"the object jumps by {excess[worst]:.1f} of its size between frames {first} and {last}"
            return


def _clock_fault(track: Track, task: VideoTask, span: tuple[int, int]) -> Iterator[str]:
    """Yield where frames are missing or the speed of a film changes.

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
        return
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
        return
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
    if best_px <= MAX_WHOLE * scatter_px:
        yield f"{text} {track.frames[windows[window, side]]}"


def _residuals_px(places_px: FloatArray, times: FloatArray, degree: int) -> FloatArray:
    """Return the residual of a polynomial in each window [px], of places of shape [window_count, frame_count, 2]."""
    basis = np.vander(times / len(times), degree + 1)
    left_px = places_px - basis @ np.linalg.pinv(basis) @ places_px
    return np.asarray(np.sqrt((left_px**2).sum(axis=(1, 2)) / len(times)))
