"""Draw a track into its video: where the object was seen, which frames count, and what the law gives."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gauge_envs.tools.video.frames import FileFrames, Frames, Picture, cv2, write_mp4
from gauge_envs.tools.video.scoring import VideoScore

COUNTED = (80, 200, 80)
DROPPED = (150, 150, 150)
MARKED = (60, 60, 230)
"""Colours in blue, green and red: of retained places, of dropped ones, and of the present place."""


def save_overlay(source: FileFrames, result: VideoScore, path: Path) -> Path:
    """Write a video with the track, and return its path; its folder is created.

    Args:
        source: The video that was scored.
        result: Its result.
        path: File to write, MP4.
    """
    write_mp4(path, drawn_frames(source, result), source.fps)
    return path


def drawn_frames(source: Frames, result: VideoScore) -> Iterator[Picture]:
    """Yield the frames of a video on the reference grid, with the track drawn into them."""
    for number, picture in enumerate(source.pictures(result.track.registration)):
        yield _drawn(picture, result, number)


def _drawn(picture: Picture, result: VideoScore, number: int) -> Picture:
    drawn = picture.copy()
    track, span = result.track, result.interval_frames
    # A frame that repeats a picture shows the place of the one before.
    row = max(0, int(np.searchsorted(track.frames, number, side="right")) - 1)
    for frame, place in zip(track.frames[: row + 1], track.points_px[: row + 1], strict=True):
        if np.isfinite(place).all():
            counts = span is not None and span[0] <= frame <= span[1]
            cv2.circle(drawn, (round(place[0]), round(place[1])), 2, COUNTED if counts else DROPPED, -1)
    if np.isfinite(track.points_px[row]).all():
        x, y = track.points_px[row]
        cv2.drawMarker(drawn, (round(x), round(y)), MARKED, cv2.MARKER_CROSS, 22, 2)
    values = [f"{name} {value:.3g}" for name, value in result.metrics.items() if value is not None]
    is_counted = span is not None and span[0] <= number <= span[1]
    state = "counted" if is_counted else "dropped"
    seen = f"frame {number}, {state}, confidence {track.confidence[row]:.2f}"
    lines = [seen, f"{result.grade.value}: {', '.join(values)}"]
    for line, text in enumerate(lines):
        place = (10, drawn.shape[0] - 30 + 20 * line)
        cv2.putText(drawn, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(drawn, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return drawn
