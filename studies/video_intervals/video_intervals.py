"""Which frames of a video reproduce the published acceleration and QFI, and what each open choice of the law changes.

    python studies/video_intervals/video_intervals.py DIR [--first-frames DIR]

DIR holds MODEL/TASK.mp4, where MODEL is a column of the published table, as seedance2. The study explains, and nothing
in the package is set by it. For each slide and fall it prints, as Markdown:

- the interval of the package with its acceleration and QFI, and the intervals in which the plain fit of rounded
  centroids gives both published numbers;
- acceleration and QFI with each choice that the paper leaves open;
- how many clips the best rule of the paper's form explains. A motion starts at the first or the last frame of the first
  window of six that moves by a threshold. It ends at the first or the last frame of the first later one that does not.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video import Motion, Track, VideoTask, score_track, video_task
from gauge_envs.tools.video.frames import FileFrames
from gauge_envs.tools.video.laws import WINDOW, fit_constant_acceleration
from gauge_envs.tools.video.tasks import published_results
from gauge_envs.tools.video.tracker import track_object
from gauge_envs.tools.video.words import find_videos

FEWEST = 6
"""Fewest frames of an interval."""

NEAR = 0.03
"""Largest relative difference of both numbers that reproduces them."""

STARTS_PX = (
    0.3,
    0.5,
    0.75,
    1.0,
    1.5,
    2.0,
    3.0,
    4.0,
    5.0,
    6.0,
    8.0,
    10.0,
    12.0,
    15.0,
    20.0,
)
ENDS_PX = (-3.0, -2.0, -1.0, -0.5, 0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)
"""Thresholds of the displacement in a window, at the start and at the end [px]."""


@dataclass(frozen=True)
class Clip:
    """A track, what the package makes of it, and what is published."""

    model: str
    task: VideoTask
    track: Track
    span: tuple[int, int] | None
    published: tuple[float, float]

    @property
    def rows(self) -> NDArray[np.intp]:
        """Rows of the frames in which the object was found."""
        return np.flatnonzero(self.track.is_found)

    def along_m(self, *, is_rounded: bool) -> NDArray[np.float64]:
        """Return the displacement of the found frames, of whole pixels of the video where it is rounded."""
        points = self.track.points_px[self.rows]
        one = self.track.registration
        if is_rounded and one is not None:
            scale, offset = (
                np.array([one.scale_x, one.scale_y]),
                np.array([one.offset_x_px, one.offset_y_px]),
            )
            points = np.round((points + 0.5 - offset) / scale - 0.5) * scale
        return (
            np.asarray(points @ np.array(self.task.direction))
            * self.task.scale_m_per_px
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first-frames", type=Path)
    arguments = parser.parse_args()
    clips = read_clips(arguments.folder, arguments.first_frames)
    intervals = [all_intervals(one) for one in clips]
    print(
        "| clip | published a, QFI | package: frames, a, QFI | frames that give both published numbers |"
    )
    print("|---|---|---|---|")
    for one, found in zip(clips, intervals, strict=True):
        print(
            f"| {one.model}, {one.task.id} | {pair(*one.published)} | {own(one)} | {reproducing(one, found)} |"
        )
    print()
    print_choices(clips)
    print()
    print_rules(clips, intervals)


def read_clips(folder: Path, first_frames: Path | None) -> list[Clip]:
    published = published_results()
    clips = []
    for model, task_id, file in find_videos(folder)[0]:
        task = video_task(task_id)
        if task.motion not in (Motion.SLIDE, Motion.FALL):
            continue
        first_frame = None if first_frames is None else first_frames / f"{task_id}.png"
        track = track_object(FileFrames(file), task, first_frame=first_frame)
        known = published[model.replace("-", "_")]
        numbers = known[task_id, "a_m_s2"], known[task_id, "qfi"]
        assert None not in numbers
        clips.append(
            Clip(model, task, track, score_track(track, task).interval_frames, numbers)
        )
    return clips


def all_intervals(one: Clip) -> NDArray[np.float64]:
    """Return the first and last row, acceleration and QFI of the paper's fit in every interval, shape [count, 4]."""
    times, values = one.track.times_s[one.rows], one.along_m(is_rounded=True)
    found = []
    for first in range(len(times) - FEWEST + 1):
        u, y = (times[first:] - times[first]) ** 2, values[first:] - values[first]
        counts = np.arange(1, len(u) + 1)
        unit = np.maximum(u, 1e-12)
        power = [
            counts.astype(float),
            *(np.cumsum(u**n) / unit**n for n in range(1, 5)),
        ]
        product = [np.cumsum(y * u**n) / unit**n for n in range(3)]
        last = np.arange(FEWEST - 1, len(u))
        matrix = np.array(
            [[power[i + j][last] for j in range(3)] for i in range(3)]
        ).transpose(2, 0, 1)
        right = np.array([product[i][last] for i in range(3)]).T[..., None]
        linear = np.linalg.solve(matrix[:, :2, :2], right[:, :2])[..., 0]
        full = np.linalg.solve(matrix, right)[..., 0]
        total = np.cumsum(y**2)[last]
        sse_linear = total - (linear * right[:, :2, 0]).sum(axis=1)
        sse_full = np.maximum(total - (full * right[..., 0]).sum(axis=1), 1e-12)
        qfi = (sse_linear - sse_full) / (sse_full / (last + 1 - 3))
        found.append(
            np.column_stack(
                [
                    np.full(len(last), first),
                    first + last,
                    2.0 * linear[:, 1] / unit[last],
                    qfi,
                ]
            )
        )
    return np.vstack(found)


def difference(one: Clip, found: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the larger of the relative differences of the two numbers, shape [count]."""
    a, qfi = one.published
    return np.maximum(np.abs(found[:, 2] / a - 1.0), np.abs(found[:, 3] / qfi - 1.0))


def reproducing(one: Clip, found: NDArray[np.float64]) -> str:
    frames = one.track.frames[one.rows]
    away = difference(one, found)
    order = [row for row in np.argsort(away) if away[row] <= NEAR][:3]
    text = [
        f"{frames[int(found[row, 0])]}-{frames[int(found[row, 1])]}: {pair(*found[row, 2:])}"
        for row in order
    ]
    if not text:
        row = int(np.argmin(away))
        start, end = (frames[int(found[row, column])] for column in (0, 1))
        text = [
            f"none; nearest {start}-{end}: {pair(*found[row, 2:])}, {away[row]:.0%} away"
        ]
    return "; ".join(text)


def own(one: Clip) -> str:
    if one.span is None:
        return "none"
    fit = fitted(one, 0, 0, is_rounded=False, is_released=True)
    return f"{one.span[0]}-{one.span[1]}: {pair(*fit)}"


def fitted(
    one: Clip, later: int, earlier: int, *, is_rounded: bool, is_released: bool
) -> tuple[float, float]:
    """Return acceleration and QFI in the package's interval, with its start later and its end earlier [frames]."""
    assert one.span is not None
    frames = one.track.frames[one.rows]
    kept = np.flatnonzero((frames >= one.span[0]) & (frames <= one.span[1]))
    kept = kept[later : len(kept) - earlier]
    times, values = (
        one.track.times_s[one.rows][kept],
        one.along_m(is_rounded=is_rounded)[kept],
    )
    fit = fit_constant_acceleration(
        times, values, release_within_s=1.0 / one.track.fps if is_released else 0.0
    )
    return fit.a_m_per_s2, fit.qfi


def print_choices(clips: list[Clip]) -> None:
    choices = {
        "package": {"is_released": True},
        "paper's clock": {},
        "rounded centroids": {"is_rounded": True},
        "one window later": {"later": WINDOW},
        "two frames later": {"later": 2},
        "end two frames earlier": {"earlier": 2},
    }
    print(f"| clip | {' | '.join(choices)} |")
    print("|---|" + "---|" * len(choices))
    for one in clips:
        if one.span is None:
            continue
        cells = []
        for choice in choices.values():
            options = {
                "later": 0,
                "earlier": 0,
                "is_rounded": False,
                "is_released": False,
                **choice,
            }
            cells.append(pair(*fitted(one, **options)))
        print(f"| {one.model}, {one.task.id} | {' | '.join(cells)} |")


def print_rules(clips: list[Clip], intervals: list[NDArray[np.float64]]) -> None:
    """Print the rules of the paper's form that explain most clips."""
    found = []
    for start, is_last, end, is_end_last in itertools.product(
        STARTS_PX, (False, True), ENDS_PX, (False, True)
    ):
        both, acceleration = 0, 0
        for one, fits in zip(clips, intervals, strict=True):
            span = ruled(one, start, is_last=is_last, end=end, is_end_last=is_end_last)
            row = (
                fits[(fits[:, 0] == span[0]) & (fits[:, 1] == span[1])]
                if span
                else fits[:0]
            )
            if len(row):
                both += bool(difference(one, row)[0] <= 0.1)
                acceleration += bool(abs(row[0, 2] / one.published[0] - 1.0) <= 0.1)
        found.append((both, acceleration, start, is_last, end, is_end_last))
    print(f"Rules: {len(found)}; clips: {len(clips)}.")
    for key, name in ((0, "both numbers"), (1, "the acceleration")):
        best = max(found, key=lambda one: (one[key], one[1 - key]))
        print(
            f"Most clips with {name} within 10 %: {best[key]}, with a start at {best[2]:g} px "
            f"({'last' if best[3] else 'first'} frame) and an end at {best[4]:g} px "
            f"({'last' if best[5] else 'first'} frame)."
        )


def ruled(
    one: Clip, start: float, *, is_last: bool, end: float, is_end_last: bool
) -> tuple[int, int] | None:
    along = one.along_m(is_rounded=True) / one.task.scale_m_per_px
    moved = along[WINDOW:] - along[:-WINDOW]
    moving = np.flatnonzero(moved > start)
    if not len(moving):
        return None
    stops = np.flatnonzero(moved[moving[0] + 1 :] < end)
    last = (
        len(along) - 1
        if not len(stops)
        else int(moving[0] + 1 + stops[0]) + (WINDOW if is_end_last else 0)
    )
    return int(moving[0]) + (WINDOW if is_last else 0), last


def pair(a: float, qfi: float) -> str:
    return f"{a:.3g}, {qfi:.3g}"


if __name__ == "__main__":
    main()
