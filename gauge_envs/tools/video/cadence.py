"""Find when the frames of a video were taken: stated times, and pictures that are shown more than once.

A film of 25 pictures a second that is shown at 30 repeats every sixth frame. Judged as it is, its object would halt and
jump. An object at rest repeats pictures too, but without a rhythm that goes on while it moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video.frames import Frames
from gauge_envs.tools.video.grid import cv2

SMALL_PX = (208, 120)
"""Width and height to which pictures are averaged before they are compared [px]."""

LEAST_MOTION = 12.0
"""Largest difference of the brightness of two such pictures from which something moves, in grey values of 255."""

REPEAT_SHARE = 0.25
"""Difference of a repeated picture, against those of its neighbours; compression leaves up to a tenth."""

REACH = 5
"""Frames on both sides within which something must move, so that a repeat is no rest."""

MOST_PERIOD = 12
"""Longest rhythm of repeats, in frames."""

CLEAR_SHARE = 0.8
"""Share of the frames in one place of the rhythm that must repeat, or be new."""

LEAST_REPEATS = 3
"""Fewest repeats while something moves."""

MOST_JITTER = 0.2
"""Difference of a stated time from a uniform rate that is rounding, in frames."""


@dataclass(frozen=True, kw_only=True)
class Cadence:
    """When the pictures of a video were taken.

    Attributes:
        is_new: Whether a frame shows a new picture, shape [frame_count].
        times_s: Times of the new pictures [s], shape [new_count].
        fps: New pictures per second, on average.
        text: What differs from the stated rate; empty when nothing does.
    """

    is_new: NDArray[np.bool_]
    times_s: NDArray[np.float64]
    fps: float
    text: str = ""


def read_cadence(frames: Frames) -> Cadence:
    """Read a video once, and return when its pictures were taken.

    Args:
        frames: The video.
    """
    differences: list[float] = []
    before: NDArray[np.float32] | None = None
    for picture in frames.native():
        small = cv2.cvtColor(cv2.resize(picture, SMALL_PX, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        small = np.asarray(small, dtype=np.float32)
        differences.append(np.inf if before is None else float(np.abs(small - before).max()))
        before = small
    return cadence_of(np.array(differences), frames.fps, frames.times_s)


def cadence_of(differences: NDArray[np.float64], fps: float, times_s: NDArray[np.float64] | None = None) -> Cadence:
    """Return when pictures were taken, from their differences and the times that the file states.

    Args:
        differences: Largest difference of each picture from the one before, shape [frame_count]; the first is infinite.
        fps: Frames per second.
        times_s: Times that the file states [s], shape [frame_count]; None where it states a rate alone.
    """
    count = len(differences)
    every = np.ones(count, dtype=bool)
    if times_s is not None and len(times_s) == count and count > 1:
        steps = np.diff(times_s)
        is_uniform = np.abs(times_s - times_s[0] - np.arange(count) / fps).max() * fps <= MOST_JITTER
        if not is_uniform and (steps > 0.0).all():
            rate = (count - 1) / float(times_s[-1] - times_s[0])
            shortest, longest = 1000.0 * steps.min(), 1000.0 * steps.max()
            text = f"frames last {shortest:.0f} to {longest:.0f} ms: the times that the file states are used"
            return Cadence(is_new=every, times_s=times_s - times_s[0], fps=rate, text=text)
    rhythm = _rhythm(differences)
    if rhythm is None:
        return Cadence(is_new=every, times_s=np.arange(count) / fps, fps=fps)
    period = len(rhythm)
    is_new = ~np.resize(rhythm, count)
    is_new[0] = True
    rate = fps * float((~rhythm).sum()) / period
    text = (
        f"{int(rhythm.sum())} of every {period} frames show the picture before again: "
        f"the {int(is_new.sum())} new pictures count, at {rate:.4g} per second"
    )
    return Cadence(is_new=is_new, times_s=np.arange(int(is_new.sum())) / rate, fps=rate, text=text)


def _rhythm(differences: NDArray[np.float64]) -> NDArray[np.bool_] | None:
    """Return which frames of one period repeat the one before, shape [period]; None without a rhythm."""
    values = np.array(differences)
    values[0] = 0.0
    moves = values > LEAST_MOTION
    count = len(values)
    near = [values[max(0, row - 2) : row + 3].max() for row in range(count)]
    repeats = values < REPEAT_SHARE * np.array(near)
    # Only frames with motion before and after say something: a body at rest repeats pictures without a rhythm.
    counts = np.array(
        [moves[max(0, row - REACH) : row].any() and moves[row + 1 : row + 1 + REACH].any() for row in range(count)]
    )
    for period in range(2, MOST_PERIOD + 1):
        places = [np.flatnonzero(counts & (np.arange(count) % period == phase)) for phase in range(period)]
        if min(len(place) for place in places) < 2:
            break
        shares = np.array([repeats[place].mean() for place in places])
        rhythm = shares >= CLEAR_SHARE
        is_clear = (rhythm | (shares <= 1.0 - CLEAR_SHARE)).all()
        if (
            is_clear
            and not rhythm.all()
            and sum(int(repeats[places[i]].sum()) for i in np.flatnonzero(rhythm)) >= (LEAST_REPEATS)
        ):
            return rhythm
    return None
