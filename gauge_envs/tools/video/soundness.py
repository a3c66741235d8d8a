"""Say why a track does not follow the object, or does not follow it all the time."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import binary_closing

from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

MAX_ODD_SHARE = 0.15
"""Largest share of the retained frames of a sound track that does not show the object as it was."""

MAX_SIZE_CHANGE = 0.3
"""Largest relative change of the apparent size of an object that is the same one."""

MAX_MISFIT = 0.25
"""Largest difference from the shape in the first frame, in parts of the area.
A disk in the place of its square differs by 0.21, a square in that of its disk by 0.27, and their sides add to it."""

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

STRAIGHT, CURVED = (4, 2), (6, 3)
"""Frames on either side of a cut by which it is judged, and degree of the polynomial that a smooth motion follows."""

MAX_MISSING = 8
"""Largest number of missing frames at a cut that is tried."""

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
    last_watched = min(last + WINDOW, len(track.frames) - 1)
    faults = [
        event.text
        for event in track.events
        if event.first_frame <= track.frames[last_watched]
    ]
    if span is not None:
        faults += _clock_fault(track, task, rows)
    is_cradle = task.motion is Motion.CRADLE
    min_likeness = MIN_CRADLE_TWIN_LIKENESS if is_cradle else MIN_TWIN_LIKENESS
    is_twin = track.other_likeness >= min_likeness
    if is_twin.sum() >= MIN_TWIN_FRAMES:
        where = _range_text(track.frames[is_twin])
        faults.append(
            f"a second object of the same shape and colour is seen in {where}"
        )
    else:
        # Two alike objects that meet are seen as one, of another size and shape.
        faults += _changes(track, task, rows)
    if task.rest_px is not None:
        # The outgoing ball is looked for only where it swings out; a post may hide it for some frames.
        is_swinging = binary_closing(track.is_found, np.ones(MAX_HIDDEN + 1))
        places_px = np.where(is_swinging[:, None], track.points_px, task.rest_px)
        return [*faults, *_jump(track, task, places_px, MAX_BESIDE)]
    lost = rows[~track.is_found[rows]]
    if len(lost) > MAX_ODD_SHARE * len(rows):
        share, where = len(lost) / len(rows), _range_text(track.frames[lost])
        faults.append(f"the object is lost in {share:.0%} of the frames, in {where}")
    if track.is_found.any():
        faults += _ends(track, task, span)
        faults += _jump(track, task, track.points_px[: last_watched + 1], MAX_JUMP)
    return faults


def _range_text(frames: IntArray) -> str:
    """Return the first and the last of some frames, and their number."""
    return f"{len(frames)} frames from {frames[0]} to {frames[-1]}"


def _changes(track: Track, task: VideoTask, rows: IntArray) -> Iterator[str]:
    """Yield by how much the object changes its size, shape, colour and look, in more frames than a few."""
    found = rows[track.is_found[rows]]
    # A cradle's ball is first seen when it has swung out. Blur makes it less like itself at its largest speed.
    count = len(found if task.motion is Motion.CRADLE else rows)
    # Blur alone changes a shape for some frames, and the retained ones may be few.
    is_reshaped = (track.misfit > MAX_MISFIT).mean() > MAX_ODD_SHARE
    for text, changes, limit, among in (
        (
            "changes its size by up to {:+.0%}",
            track.size_ratio - 1.0,
            MAX_SIZE_CHANGE,
            count,
        ),
        (
            "changes its shape by up to {:.0%}",
            track.misfit * is_reshaped,
            MAX_MISFIT,
            count,
        ),
        ("has another look", 1.0 - track.confidence, 1.0 - MIN_CONFIDENCE, len(rows)),
    ):
        odd = found[np.abs(changes[found]) > limit]
        if len(odd) > MAX_ODD_SHARE * among:
            largest = text.format(max(changes[odd], key=abs))
            yield f"the object {largest} in {_range_text(track.frames[odd])}"


def _ends(track: Track, task: VideoTask, span: tuple[int, int] | None) -> Iterator[str]:
    """Yield how far from its known place an object is first seen, and where it vanishes while it slides or falls."""
    rows = np.flatnonzero(track.is_found)
    away_px = np.linalg.norm(track.points_px[rows] - task.centre_px, axis=1)
    first_away, last_away = (away_px[[0, -1]] / task.size_px).tolist()
    if first_away > MAX_JUMP:
        yield f"the object is first seen {first_away:.1f} of its size from its place in the known first frame"
    if task.direction is None:
        return
    is_at_end = len(track.frames) - 1 - rows[-1] <= MAX_HIDDEN
    is_retained = span is None or rows[-1] <= span[1] + 1
    if last_away <= CLEAR_WAY and is_retained and not is_at_end:
        yield f"the object vanishes on its way: frame {track.frames[rows[-1]]} is the last that shows it"


def _jump(
    track: Track, task: VideoTask, places_px: FloatArray, max_jump: float
) -> Iterator[str]:
    """Yield where the object jumps: farther than the speeds before and after explain.

    Args:
        track: The track.
        task: The task.
        places_px: Places by row, shape [row_count, 2]; NaN where the object is lost.
        max_jump: Largest distance that the speeds do not explain, in sizes.
    """
    rows = np.flatnonzero(np.isfinite(places_px).all(axis=1))
    steps_px = np.linalg.norm(np.diff(places_px[rows], axis=0), axis=1)
    gaps = np.diff(rows)
    # The object rests before its first step and after its last one.
    speeds_px = np.pad(steps_px / gaps, 1)
    fastest_px = np.maximum(speeds_px[:-2], speeds_px[2:])
    excess = (steps_px - gaps * fastest_px) / task.size_px
    if excess.max(initial=0.0) > max_jump:
        worst = int(excess.argmax())
        first, last = track.frames[rows[[worst, worst + 1]]]
        yield f"the object jumps by {excess[worst]:.1f} of its size between frames {first} and {last}"


def _clock_fault(track: Track, task: VideoTask, rows: IntArray) -> Iterator[str]:
    """Yield where frames are missing.

    Across a cut, a smooth curve leaves a large residual. The residual is small once the later frames are moved in time
    by whole frames. A body that jumps or brakes seldom does that.

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
    # A track that knows of a gap has another clock already.
    steps_s = np.diff(track.times_s[windows], axis=1)
    windows = windows[np.ptp(steps_s, axis=1) < MAX_UNEVEN_FRAMES / track.fps]
    times = np.arange(2.0 * side) - side
    residuals_px = np.array(
        [
            _residuals_px(
                track.points_px[windows], times + missing * (times >= 0), degree
            )
            for missing in range(MAX_MISSING + 1)
        ]
    )
    is_cut = residuals_px[0] > MIN_BROKEN * scatter_px
    residuals_px[:, ~is_cut] = np.inf
    if residuals_px.min(initial=np.inf) <= MAX_WHOLE * scatter_px:
        missing, window = np.unravel_index(residuals_px.argmin(), residuals_px.shape)
        frame = track.frames[windows[window, side]]
        yield f"frames seem to be missing, {missing} before frame {frame}"


def _residuals_px(places_px: FloatArray, times: FloatArray, degree: int) -> FloatArray:
    """Return the residual of a polynomial in each window [px], of places of shape [window_count, frame_count, 2]."""
    basis = np.vander(times / len(times), degree + 1)
    left_px = places_px - basis @ np.linalg.pinv(basis) @ places_px
    return np.asarray(np.sqrt((left_px**2).sum(axis=(1, 2)) / len(times)))
