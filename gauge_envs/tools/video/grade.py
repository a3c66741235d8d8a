"""Grade a clip: whether its object could be followed, and what happened to it."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

LEAST_RETAINED = 5
"""Fewest retained frames of a valid clip."""

MOST_MISSING, FATAL_MISSING = 0.15, 0.5
"""Share of frames without the object in the retained interval: of a valid clip, and of one that can be judged."""

MOST_SIZE_CHANGE = 0.2
"""Largest change of the apparent size of the object in a valid clip."""

LEAST_CONFIDENCE = 0.5
"""Smallest mean confidence of a valid clip."""


class Grade(StrEnum):
    """Whether the metrics of a clip can be trusted."""

    VALID = "valid"
    """The object was followed through the motion."""
    DOUBTFUL = "doubtful"
    """Something happened that may change the metrics; the reasons name it."""
    INVALID = "invalid"
    """There is no motion of the task to judge."""


def grade_of(
    track: Track, task: VideoTask, span: tuple[int, int] | None, problem: str = ""
) -> tuple[Grade, tuple[str, ...]]:
    """Return the grade of a clip and its reasons, with frame numbers.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row; None when the object does not move.
        problem: Why the law could not be fitted; empty when it could.
    """
    if span is None:
        missing = _runs(track.frames[~track.is_found])
        seen = f"; it was not found in frames {missing}" if missing else ""
        causes = [one.text for one in track.events if one.kind in ("registration", "file")]
        return Grade.INVALID, (f"the object does not move{seen}", *causes)
    rows = np.arange(span[0], span[1] + 1)
    fatal, doubts = _missing_reasons(track, rows, task)
    if problem:
        fatal.insert(0, problem)
    if len(rows) < LEAST_RETAINED:
        fatal.append(f"only {len(rows)} frames are retained; a fit needs {LEAST_RETAINED}")
    found = rows[track.is_found[rows]]
    sizes = track.size_ratio[found]
    known = np.isfinite(sizes)
    usual = float(np.median(sizes[known])) if known.any() else 1.0
    odd = found[known & (np.abs(sizes / usual - 1.0) > MOST_SIZE_CHANGE)]
    if len(odd) > MOST_MISSING * len(rows):
        doubts.append(f"the object changes its size by more than 20 % in frames {_runs(track.frames[odd])}")
    confidence = float(track.confidence[found].mean()) if len(found) else 0.0
    if confidence < LEAST_CONFIDENCE:
        doubts.append(f"the mean confidence of the track is {confidence:.2f}, below {LEAST_CONFIDENCE:g}")
    inside = [one for one in track.events if one.first_frame <= track.frames[span[1]]]
    fatal += [one.text for one in inside if one.is_fatal]
    doubts += [one.text for one in inside if not (one.is_fatal or one.is_note)]
    notes = [one.text for one in inside if one.is_note]
    grade = Grade.INVALID if fatal else Grade.DOUBTFUL if doubts else Grade.VALID
    return grade, (*fatal, *doubts, *notes)


def _missing_reasons(track: Track, rows: NDArray[np.intp], task: VideoTask) -> tuple[list[str], list[str]]:
    # The outgoing ball of a cradle is looked for only where it swings out.
    if task.motion is Motion.CRADLE:
        return [], []
    lost = rows[~track.is_found[rows]]
    share = len(lost) / len(rows)
    text = f"the object is lost in {share:.0%} of the retained frames: {_runs(track.frames[lost])}"
    if share > FATAL_MISSING:
        return [text], []
    return [], [text] if share > MOST_MISSING else []


def _runs(frames: NDArray[np.int64]) -> str:
    """Return frame numbers as runs: `3 to 9, 14`."""
    if not len(frames):
        return ""
    parts = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1)
    texts = [f"{part[0]} to {part[-1]}" if len(part) > 1 else f"{part[0]}" for part in parts]
    shown = texts[:4]
    return ", ".join(shown) + (f" and {len(texts) - 4} more runs" if len(texts) > 4 else "")
