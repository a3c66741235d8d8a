"""Say how a clip meets the values that are published for it, whose frames are not published."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.tools.video import laws
from gauge_envs.tools.video.scoring import (
    LEAST_RETAINED,
    Metrics,
    VideoScore,
    paper_metrics,
)
from gauge_envs.tools.video.tasks import Motion, VideoTask

CLOSE = 0.1
"""Largest relative difference with which a value agrees with a published one."""

MOST_SHIFT = 24
"""Frames by which an interval is moved at either end in search of published values."""


@dataclass(frozen=True, kw_only=True)
class _Interval:
    """Metrics in an interval, and by how many frames its ends differ from the retained one."""

    frames: tuple[int, int]
    moved: tuple[int, int]
    metrics: Metrics

    @property
    def is_near(self) -> bool:
        """Whether the paper's window may have chosen it: a release within six frames, and an earlier end."""
        return abs(self.moved[0]) <= laws.WINDOW >= self.moved[1]


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
        return _difference(result, task, published)
    intervals = sorted(
        _intervals(result, task),
        key=lambda one: abs(one.moved[0]) + abs(one.moved[1]),
    )
    near = [one for one in intervals if one.is_near]
    for searched, words in ((near, ""), (intervals, "weak: only ")):
        found = [one for one in searched if _is_close(one.metrics, published)]
        if found:
            met = [
                any(_is_close(one.metrics, other) for one in searched)
                for other in others
            ]
            (first, last), moved = found[0].frames, found[0].moved
            return (
                f"{words}in frames {first} to {last}, {moved[0]:+d} and {moved[1]:+d} from those here; so are "
                f"{sum(met)} of {len(met)} values of other clips"
            )
    counts = []
    for name, value in published.items():
        count = sum(_is_close(one.metrics, {name: value}) for one in intervals)
        counts.append(f"{name} holds in {count}")
    return f"in no frames within {MOST_SHIFT}: of {len(intervals)}, {', '.join(counts)}"


def _intervals(result: VideoScore, task: VideoTask) -> Iterator[_Interval]:
    """Yield the metrics in each interval whose release is near the retained one, or whose ends both are."""
    assert result.interval_frames is not None
    track = result.track
    start, end = np.searchsorted(track.frames, result.interval_frames)
    row_count = len(track.frames)
    for first in range(max(0, start - MOST_SHIFT), min(row_count, start + MOST_SHIFT)):
        is_release = abs(first - start) <= laws.WINDOW
        earliest = first + LEAST_RETAINED + 1
        if not is_release:
            earliest = max(earliest, end - MOST_SHIFT)
        for last in range(earliest, min(row_count, end + MOST_SHIFT)):
            try:
                metrics, _ = paper_metrics(
                    track, task, (first, last), task.scale_m_per_px
                )
            except ParameterError:
                continue
            yield _Interval(
                frames=(int(track.frames[first]), int(track.frames[last])),
                moved=(int(first - start), int(last - end)),
                metrics=metrics,
            )


def _difference(result: VideoScore, task: VideoTask, published: Metrics) -> str:
    """Return the numbers by which a motion that is not straight differs from what is published."""
    if task.motion is Motion.TURN:
        return _slip(result, task, published["de"])
    if task.motion is Motion.CRADLE:
        return _apices(result, task)
    return "differs"


def _slip(result: VideoScore, task: VideoTask, de_n: float) -> str:
    """Return by how much the published place must slip in one frame to give a dynamic error that the track has not."""
    track = result.track
    limit_m_s2 = task.friction * laws.GRAVITY_M_PER_S2
    largest_m_s2 = result.details["largest_a_m_s2"]
    if largest_m_s2 > limit_m_s2:
        share = result.details["exceeding_share"]
        return f"differs: the force here is that of {share:.1%} of the frames, up to {largest_m_s2:.1f} m/s^2"
    # A slip by d changes the second difference by 2 d.
    per_px_m_s2 = 2.0 * task.scale_m_per_px * track.fps**2
    slip_px = max(0.0, limit_m_s2 - largest_m_s2) / per_px_m_s2
    return (
        f"friction holds up to {limit_m_s2:.2f} m/s^2, and the largest acceleration here is {largest_m_s2:.2f}: "
        f"{de_n:g} N needs a mask that slips by {slip_px:.0f} px in one frame"
    )


def _apices(result: VideoScore, task: VideoTask) -> str:
    """Return between which efficiencies the apices of a cradle lie, and how many swings have none that is seen."""
    if result.metrics["mte"] is None:
        return "differs: no apex is seen here"
    low, high = result.details["least_event"], result.details["largest_event"]
    unseen = len(laws.swings_without_apex(result.track, task))
    return f"differs: apices give {low:.2f} to {high:.2f} here, and {unseen} swings have none that is seen"


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
