"""Find where the clock of a film is not that of the motion: frames are missing, or its speed changes."""

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.tasks import VideoTask
from gauge_envs.tools.video.track import Track

STRAIGHT, CURVED = (4, 2), (6, 3)
"""Frames on either side of a cut by which it is judged, and degree of the polynomial that a smooth motion follows."""

MOST_MISSING = 8
"""Most frames that are missing at a cut."""

SPEEDS = (0.33, 0.4, 0.5, 0.6, 0.7, 1.4, 1.7, 2.0, 2.5, 3.0)
"""Speeds after a cut that are tried, in that before it."""

BROKEN, WHOLE = 5.0, 2.0
"""Residual across a cut, in the scatter of the track, from which a motion is broken there, and up to which another
clock makes it whole."""

UNEVEN = 0.2
"""Difference of the steps between frames, in frames, from which the track itself has a gap."""

LEAST_PX = 0.2
"""Smallest scatter that is assumed [px]."""


def clock_fault(
    track: Track, task: VideoTask, span: tuple[int, int], noise_px: float
) -> str:
    """Return where frames are missing or the speed of a film changes; empty where its clock is that of the motion.

    Across a cut, a smooth curve leaves a large residual, and a small one once the later frames are moved in time by
    whole frames, or run at another speed. A body that jumps or brakes seldom does that.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row.
        noise_px: Scatter of the track from frame to frame [px].
    """
    side, degree = CURVED if task.direction is None else STRAIGHT
    rows = np.arange(span[0], span[1] + 1)
    rows = rows[track.is_found[rows]]
    window_count = len(rows) - 2 * side + 1
    if window_count < 1:
        return ""
    windows = np.arange(window_count)[:, None] + np.arange(2 * side)
    places_px = track.points_px[rows[windows]]
    steps_s = np.diff(track.times_s[rows[windows]], axis=1)
    # A frame in which the object is not found is a gap that the track knows of.
    is_even = np.ptp(steps_s, axis=1) < UNEVEN / track.fps
    times = np.arange(2.0 * side) - side
    is_later = times >= 0.0
    clocks = {"": times}
    clocks["a frame seems to be shown again at frame"] = times - is_later
    for missing in range(1, MOST_MISSING + 1):
        text = f"frames seem to be missing, {missing} before frame"
        clocks[text] = times + missing * is_later
    for speed in SPEEDS:
        text = f"the speed of the film seems to change by {speed:g} at frame"
        clocks[text] = np.where(is_later, speed * times, times)
    residuals = {
        text: _residuals_px(places_px, one, degree) for text, one in clocks.items()
    }
    usual_px = max(LEAST_PX, noise_px)
    broken_px = residuals.pop("")
    best = {
        text: np.where(is_even & (broken_px > BROKEN * usual_px), one, np.inf)
        for text, one in residuals.items()
    }
    text = min(best, key=lambda one: float(best[one].min()))
    cut = int(best[text].argmin())
    if best[text][cut] > WHOLE * usual_px:
        return ""
    return f"{text} {track.frames[rows[cut + side]]}"


def _residuals_px(places_px: FloatArray, times: FloatArray, degree: int) -> FloatArray:
    """Return the residual of a polynomial in each window [px], of places of shape [window_count, frame_count, 2]."""
    basis = np.vander(times / len(times), degree + 1)
    projected = np.eye(len(times)) - basis @ np.linalg.pinv(basis)
    left = np.einsum("ij,wjk->wik", projected, places_px)
    return np.asarray(np.sqrt((left**2).sum(axis=(1, 2)) / len(times)))
