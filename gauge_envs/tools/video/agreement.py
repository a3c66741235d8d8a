"""Say how a clip meets the values that are published for it, whose frames are not published."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.tools.video import laws
from gauge_envs.tools.video.scoring import (
    LEAST_RETAINED,
    Metrics,
    VideoScore,
    paper_metrics,
)
from gauge_envs.tools.video.tasks import VideoTask

CLOSE = 0.1
"""Largest relative difference with which a value agrees with a published one."""

DETAILS = {
    "largest_a_m_s2": "an acceleration of at most {:.3g} m/s^2",
    "exceeding_share": "more than friction holds in {:.1%} of the frames",
    "damping_per_s": "a swing whose amplitude decays by {:.3g} a second",
    "event_count": "{:.0f} apices",
    "least_event": "an efficiency of {:.3g} in the worst swing",
    "largest_event": "{:.3g} in the best",
}
"""Words for the details of motions that are not straight."""


def agreement(
    result: VideoScore,
    task: VideoTask,
    published: Metrics,
    others: Sequence[Metrics] = (),
) -> str:
    """Return how the metrics of a clip agree with published ones, or the reason in numbers why they do not.

    The paper does not state which frames it took. Values that hold in an interval near the retained one say that it
    took that one, the more so the fewer values of other clips do.

    Args:
        result: The result.
        task: The task.
        published: Published metrics of the same clip.
        others: Those of other clips of the same task.
    """
    if not result.is_sound:
        return f"track not sound: {result.reasons[0]}" if result.reasons else ""
    if _is_close(result.metrics, published):
        return "agrees"
    if result.interval_frames is None:
        return "no motion is found"
    if _is_within(result, published):
        return "within the interval"
    if task.direction is None:
        shown = [DETAILS[name].format(value) for name, value in result.details.items()]
        return f"differs: the track shows {', '.join(shown)}"
    intervals = sorted(_intervals(result, task), key=lambda one: sum(map(abs, one[0])))
    for (later_start, later_end), (first, last), metrics in intervals:
        if _is_close(metrics, published):
            met = [
                any(_is_close(found, other) for *_, found in intervals)
                for other in others
            ]
            return (
                f"in frames {first} to {last}, {later_start:+d} and {later_end:+d} from those here; so are "
                f"{sum(met)} of {len(met)} values of other clips"
            )
    counts = []
    for name, value in published.items():
        count = sum(_is_close(found, {name: value}) for *_, found in intervals)
        counts.append(f"{name} holds in {count}")
    return f"in none of {len(intervals)} intervals: {', '.join(counts)}"


Span: TypeAlias = tuple[int, int]
"""First and last frame, or by how many frames both are later."""


def _intervals(
    result: VideoScore, task: VideoTask
) -> Iterator[tuple[Span, Span, Metrics]]:
    """Yield the intervals that the paper's window may have chosen, and their metrics.

    They have a release within its six frames of the retained one, and an end that is no more than six later.
    """
    assert result.interval_frames is not None
    track = result.track
    start, end = np.searchsorted(track.frames, result.interval_frames)
    row_count = len(track.frames)
    window = laws.WINDOW
    for first in range(max(0, start - window), start + window + 1):
        for last in range(first + LEAST_RETAINED + 1, min(row_count, end + window + 1)):
            try:
                metrics, _ = paper_metrics(
                    track, task, (first, last), task.scale_m_per_px
                )
            except ParameterError:
                continue
            later = (int(first - start), int(last - end))
            frames = (int(track.frames[first]), int(track.frames[last]))
            yield later, frames, metrics


def _is_within(result: VideoScore, published: Metrics) -> bool:
    for name, value in published.items():
        ends = result.uncertainty[name]
        if ends is None or not ends[0] <= value <= ends[1]:
            return False
    return True


def _is_close(metrics: Mapping[str, float | None], published: Metrics) -> bool:
    return all(
        abs((metrics.get(name) or 0.0) - value) <= CLOSE * abs(value)
        for name, value in published.items()
    )
