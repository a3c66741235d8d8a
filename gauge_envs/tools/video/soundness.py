"""Say why what a track follows is not the object, or not all the time."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.clock import clock_fault
from gauge_envs.tools.video.laws import ESTABLISHED, WINDOW, displacement_px
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

MOST_ODD = 0.15
"""Largest share of the retained frames of a sound track that does not show the object as it was."""

MOST_SIZE_CHANGE = 0.3
"""Largest change of the apparent size of an object that is the same one."""

MOST_MISFIT = 0.25
"""Largest difference from the shape in the first frame, in parts of the area.
A disk in the place of its square differs by 0.21, a square in that of its disk by 0.27, and their sides add to it."""

MOST_TINT = 7.0
"""Largest difference from the colour in the first frame, at any brightness, in levels of 255."""

FIRST_SIZES, FIRST_SHAPES = 12, 3
"""Frames whose median is the size that an object has, and those whose median is the misfit of its shape."""

LEAST_CONFIDENCE = 0.5
"""Smallest confidence of a frame that shows the object, which is the likeness to it in the first frame."""

TWIN_LIKENESS, LEAST_TWIN_FRAMES = 0.7, 3
"""Likeness from which another place shows a second object, and fewest frames with it that are no accident."""

JUMP = 1.0
"""Distance from where an object that goes on, stops or turns can be when it is seen next, in its sizes, after which
another one may be followed."""

FIRM_PX = 1e6
"""Weight of what must hold exactly among distances in a picture [px]."""

MOST_BESIDE, MOST_HIDDEN = 1.25, 3
"""Largest distance from its row, less the way of a frame, at which a ball of a cradle is first or last seen, in its
sizes, as beside its neighbours it is not told from them; and frames in which a post may hide it meanwhile."""

FREE = 7.0
"""Distance from its first place, in its sizes, within which nothing hides a cube on its board or a ball that falls, and
the picture does not end."""


def faults_of(track: Track, task: VideoTask, span: tuple[int, int] | None) -> list[str]:
    """Return why a track is not sound; the law of the motion plays no part.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row; None when the object does not move.
    """
    first, last = span or (0, len(track.frames) - 1)
    rows = np.arange(first, last + 1)
    found = rows[track.is_found[rows]]
    is_cradle = task.motion is Motion.CRADLE
    faults = [
        one.text
        for one in track.events
        if not one.is_note and one.first_frame <= track.frames[last]
    ]
    if span is None:
        faults.append(short_motion(track, task))
    else:
        faults.append(_end_on_way(track, task, span))
        faults.append(clock_fault(track, task, span, track.noise_px(span)))
    # The outgoing ball of a cradle is looked for only where it swings out.
    if not is_cradle:
        faults.append(_loss(track, rows))
    twin = _twin(track)
    faults.append(twin)
    # Two alike objects that meet are seen as one, of another size and shape.
    if not twin:
        faults += _changes(track, rows, is_cradle=is_cradle)
    faults.append(_other_look(track, found, MOST_ODD * len(rows)))
    if is_cradle:
        faults += _vanishing(track, task)
    else:
        faults.append(_other_place(track, task))
        # A jump back ends a slide or a fall as a rebound does.
        watched = np.flatnonzero(track.is_found[: last + 1 + WINDOW])
        faults.append(_jump(track, task, watched[watched >= first]))
    return [one for one in faults if one]


def _loss(track: Track, rows: NDArray[np.intp]) -> str:
    """Return in which frames the object is lost; empty where these are few."""
    is_lost = ~track.is_found
    share = float(is_lost[rows].mean())
    if share <= MOST_ODD:
        return ""
    return (
        f"the object is lost in {share:.0%} of the frames{_where(track, rows, is_lost)}"
    )


def _twin(track: Track) -> str:
    """Return where a second object is seen, in any frames: it is seen when it has parted; empty where none is."""
    is_alike = track.other_likeness >= TWIN_LIKENESS
    if np.count_nonzero(is_alike) < LEAST_TWIN_FRAMES:
        return ""
    where = _where(track, np.arange(len(is_alike)), is_alike)
    return f"a second object of the same shape and colour is seen{where}"


def _other_look(track: Track, found: NDArray[np.intp], most_odd: float) -> str:
    """Return where the object has another look, in more frames than a few; empty where it has not."""
    is_unlike = track.confidence < LEAST_CONFIDENCE
    if np.count_nonzero(is_unlike[found]) <= most_odd:
        return ""
    least = track.confidence[found].min()
    return (
        f"the object has another look{_where(track, found, is_unlike)}: its confidence falls to "
        f"{least:.2f}"
    )


def _other_place(track: Track, task: VideoTask) -> str:
    """Return how far from its known place an object is first seen; empty where it is near."""
    # Law, scale and direction are those of the known first frame.
    if track.registration is None or not track.is_found.any():
        return ""
    place = track.points_px[track.is_found][0]
    away = math.dist(place, task.centre_px) / task.size_px
    if away <= JUMP:
        return ""
    return f"the object is first seen {away:.1f} of its size from its place in the known first frame"


def _changes(track: Track, rows: NDArray[np.intp], *, is_cradle: bool) -> Iterator[str]:
    """Yield by how much the object changes its size, its shape and its colour, in more frames than a few."""
    is_found = track.is_found
    found = rows[is_found[rows]]
    # A cradle's ball is not looked for in its row, and first seen when it has swung out.
    most_odd = MOST_ODD * len(found if is_cradle else rows)
    early = track.size_ratio[np.isfinite(track.size_ratio)][:FIRST_SIZES]
    usual_size = float(np.median(early)) if len(early) and not is_cradle else 1.0
    size_changes = np.nan_to_num(track.size_ratio / usual_size - 1.0)
    # A background that is never seen is guessed, and so is what stands out from it.
    first_misfits = track.misfit[is_found][:FIRST_SHAPES]
    usual_misfit = float(np.median(first_misfits)) if len(first_misfits) else 0.0
    misfits = np.maximum(track.misfit - min(usual_misfit, MOST_MISFIT), 0.0)
    # Blur alone may change a shape for some frames, and the retained ones may be few.
    everywhere = misfits[is_found] if is_cradle else misfits * is_found
    usual_change = _exceeded(everywhere, MOST_ODD * len(everywhere))
    for name, changes, bound, most_change, unit in (
        ("size", size_changes, MOST_SIZE_CHANGE, math.inf, "{:+.0%}"),
        ("shape", misfits, MOST_MISFIT, usual_change, "{:.0%}"),
        ("colour", track.tint, MOST_TINT, math.inf, "{:.0f} levels of 255"),
    ):
        amounts = np.abs(changes)
        if min(_exceeded(amounts[found], most_odd), most_change) > bound:
            largest = unit.format(max(changes[found], key=abs))
            where = _where(track, found, amounts > bound)
            yield f"the object changes its {name} by up to {largest}{where}"


def _exceeded(values: FloatArray, count: float) -> float:
    """Return the value that more than a count of values reach."""
    rank = int(count) + 1
    return float(np.sort(values)[-rank]) if rank <= len(values) else 0.0


def _jump(track: Track, task: VideoTask, rows: NDArray[np.intp]) -> str:
    """Return where the object jumps: the speeds before and after do not explain its way; empty where it does not.

    An object that is lost for some frames has gone on, stopped or turned: its mean velocity meanwhile lies between
    those before and after and zero. So does that of two steps, over which a blend of two pictures spreads a jump.
    """
    if len(rows) < 3:
        return ""
    places_px = track.points_px[rows]
    speeds_px = np.diff(places_px, axis=0) / np.diff(rows)[:, None]
    # The object rests before its first step and after its last one.
    around_px = np.pad(speeds_px, ((1, 1), (0, 0)))
    for steps in (1, 2):
        aways = {}
        # Within two steps a motion may begin or end too.
        for start in range(steps - 1, len(rows) - 2 * steps + 1):
            end = start + steps
            corners_px = (rows[end] - rows[start]) * around_px[[start, end + 1]]
            away_px = _from_triangle_px(places_px[end] - places_px[start], *corners_px)
            aways[start, end] = away_px / task.size_px
        ends = max(aways, key=aways.__getitem__, default=(0, 0))
        away = aways.get(ends, 0.0)
        if away > JUMP:
            first, last = track.frames[rows[list(ends)]]
            return f"the object jumps by {away:.1f} of its size between frames {first} and {last}"
    return ""


def _vanishing(track: Track, task: VideoTask) -> Iterator[str]:
    """Yield where the ball of a cradle is first or last seen farther from its row than it moves in a frame."""
    assert task.rest_px is not None
    rows, places = np.flatnonzero(track.is_found), track.points_px
    swings = np.split(rows, np.flatnonzero(np.diff(rows) > MOST_HIDDEN + 1) + 1)
    for swing in (one for one in swings if len(one) > 1):
        for row, inner in (swing[:2], swing[:-3:-1]):
            step_px = math.dist(places[row], places[inner])
            away = (math.dist(places[row], task.rest_px) - step_px) / task.size_px
            if 0 < row < len(places) - 1 and away > MOST_BESIDE:
                yield f"the ball appears or vanishes {away:.1f} of its size from its row in frame {track.frames[row]}"


def _end_on_way(track: Track, task: VideoTask, span: tuple[int, int]) -> str:
    """Return where an object is seen for the last time, while it slides or falls, though nothing hides it there."""
    if task.motion not in (Motion.SLIDE, Motion.FALL):
        return ""
    row = int(np.flatnonzero(track.is_found)[-1])
    away = math.dist(track.points_px[row], task.centre_px) / task.size_px
    is_short = len(track.frames) - 1 - row <= MOST_HIDDEN
    # A fall is retained up to the last frame but one.
    if is_short or row > span[1] + 1 or away > FREE:
        return ""
    return f"the object vanishes on its way: frame {track.frames[row]} is the last that shows it"


def short_motion(track: Track, task: VideoTask) -> str:
    """Return how far an object gets that slides or falls in too few frames to be judged; empty if it rests."""
    if task.direction is None or not track.is_found.any():
        return ""
    away = float(np.nanmax(displacement_px(track, task))) / task.size_px
    if away <= ESTABLISHED:
        return ""
    return f"the object moves by {away:.1f} of its size, in too few frames to be judged"


def _from_triangle_px(place: FloatArray, one: FloatArray, other: FloatArray) -> float:
    """Return the distance of a place from the triangle of zero and two others, all of shape [2]."""
    # Shares of the three corners are not negative, and their sum is held to 1.
    corners = np.column_stack([one, other, np.zeros(2)])
    _, away_px = nnls(np.vstack([corners, np.full(3, FIRM_PX)]), [*place, FIRM_PX])
    return float(away_px)


def _where(track: Track, rows: NDArray[np.intp], is_odd: NDArray[np.bool_]) -> str:
    """Return in which of the frames of some rows something is odd: ` in frames 3 to 9, 14`; empty where in none."""
    runs = runs_text(track.frames[rows[is_odd[rows]]])
    return f" in frames {runs}" if runs else ""


def runs_text(frames: NDArray[np.int64]) -> str:
    """Return frame numbers as runs: `3 to 9, 14`."""
    if not len(frames):
        return ""
    parts = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1)
    texts = [
        f"{part[0]} to {part[-1]}" if len(part) > 1 else f"{part[0]}" for part in parts
    ]
    shown = texts[:4]
    return ", ".join(shown) + (
        f" and {len(texts) - 4} more runs" if len(texts) > 4 else ""
    )
