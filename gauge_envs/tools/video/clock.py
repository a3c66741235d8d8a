"""Find where frames of a film are missing or repeated, or where its speed changes."""

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.tasks import VideoTask
from gauge_envs.tools.video.track import Track

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


def clock_fault(
    track: Track, task: VideoTask, span: tuple[int, int], noise_px: float
) -> str:
    """Return where frames are missing or the speed of a film changes; empty where its clock is that of the motion.

    Across a cut, a smooth curve leaves a large residual. The residual is small once the later frames are moved in time
    by whole frames, or run at another speed. A body that jumps or brakes seldom does that.

    Args:
        track: The track.
        task: The task.
        span: First and last retained row.
        noise_px: Scatter of the track from frame to frame [px].
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
    scatter_px = max(MIN_SCATTER_PX, noise_px)
    residuals_px = _residuals_px(places_px, times, degree)
    is_cut = is_even & (residuals_px > MIN_BROKEN * scatter_px)
    if not is_cut.any():
        return ""
    clocks = {
        f"frames seem to be missing, {count} before frame": times + count * is_later
        for count in range(1, MAX_MISSING + 1)
    }
    clocks["a frame seems to be shown again at frame"] = times - is_later
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
