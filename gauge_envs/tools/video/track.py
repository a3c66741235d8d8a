"""Hold the track of an object in a video, and read one that another tracker has made."""

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.files import MEGABYTE, read_regular
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Registration
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

MOST_TRACK_BYTES = 16 * MEGABYTE
"""Largest size of a track file."""

LAST_FRAME = 10**9
"""Largest number of a frame."""

COLUMNS = ("frame", "x", "y")
"""Columns that a track file must have; `confidence` is optional."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something in a video that makes its track doubtful.

    Attributes:
        kind: `duplicated`, `camera`, `scene`, `registration`, `picture`, `look`, `cadence` or `file`.
        first_frame: First frame of it.
        last_frame: Last frame of it.
        text: Description with numbers.
        is_fatal: Whether the clip cannot be judged with this event inside of the retained interval.
        is_note: Whether it is stated without lowering the grade.
    """

    kind: str
    first_frame: int
    last_frame: int
    text: str
    is_fatal: bool = False
    is_note: bool = False


@dataclass(frozen=True, kw_only=True)
class Track:
    """Centre of an object, frame by frame, on the reference grid.

    Attributes:
        frames: Frame numbers, shape [frame_count], increasing.
        fps: Frames per second.
        points_px: Centres [px], shape [frame_count, 2]; NaN where the object was not found.
        confidence: Likeness to the object of the first frame, 0 to 1, shape [frame_count]; 0 where it was not found.
        size_ratio: Apparent size divided by that in the first frame, shape [frame_count]; NaN where unknown.
        events: What happened in the video.
        clock_s: Times of the frames [s], shape [frame_count]; None where they follow from the rate.
        registration: How the video lies on the grid; None for a track from a file.
    """

    frames: NDArray[np.int64]
    fps: float
    points_px: FloatArray
    confidence: FloatArray
    size_ratio: FloatArray
    events: tuple[Event, ...] = ()
    clock_s: FloatArray | None = None
    registration: Registration | None = None

    @property
    def is_found(self) -> NDArray[np.bool_]:
        """Whether the object was found, shape [frame_count]."""
        return np.asarray(np.isfinite(self.points_px).all(axis=1))

    @property
    def times_s(self) -> FloatArray:
        """Times of the frames [s], shape [frame_count]."""
        return self.frames / self.fps if self.clock_s is None else self.clock_s


def read_track(
    path: Path | str, *, fps: float, size_px: tuple[int, int] = REFERENCE_SIZE_PX
) -> Track:
    """Return a track from a CSV file with the columns frame, x, y and optionally confidence.

    Args:
        path: The file. Rows without a position have empty cells, or are left out.
        fps: Frames per second of the video.
        size_px: Width and height of the pictures in which the positions are measured [px].

    Raises:
        VideoError: The file cannot be read, lacks a column, or has a cell that is no finite number.
    """
    path = Path(path)
    if not (math.isfinite(fps) and fps > 0.0):
        raise VideoError(
            f"fps is {fps}: state the frame rate of the video, as --fps 30"
        )
    try:
        text = read_regular(path, MOST_TRACK_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise VideoError(
            f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from None
    found: dict[int, tuple[float, float, float]] = {}
    for number, row in enumerate(_rows(path, text), start=2):
        frame = _number(path, number, "frame", row["frame"])
        if frame is None or frame != int(frame) or not 0 <= frame <= LAST_FRAME:
            raise VideoError(
                f"{path}: line {number}: frame is {row['frame']!r}; it must be a whole number from 0 to {LAST_FRAME}"
            )
        if int(frame) in found:
            raise VideoError(
                f"{path}: line {number}: frame {int(frame)} stands there twice"
            )
        x, y = (_number(path, number, name, row[name]) for name in ("x", "y"))
        sure = _number(path, number, "confidence", row.get("confidence") or "1")
        place = (
            (math.nan, math.nan, 0.0)
            if x is None or y is None
            else (x, y, 1.0 if sure is None else sure)
        )
        found[int(frame)] = place
    if not found:
        raise VideoError(f"{path}: there is no row below the names of the columns")
    frames = np.array(sorted(found), dtype=np.int64)
    values = np.array([found[int(frame)] for frame in frames])
    to_grid = np.array(REFERENCE_SIZE_PX) / np.array(size_px, dtype=float)
    return Track(
        frames=frames,
        fps=fps,
        points_px=values[:, :2] * to_grid,
        confidence=np.clip(values[:, 2], 0.0, 1.0),
        size_ratio=np.full(len(frames), np.nan),
    )


def _rows(path: Path, text: str) -> Iterator[dict[str, str]]:
    """Yield the rows of a track."""
    try:
        rows = csv.DictReader(io.StringIO(text, newline=""))
        missing = [name for name in COLUMNS if name not in (rows.fieldnames or ())]
        if missing:
            raise VideoError(
                f"{path}: there is no column {', '.join(missing)}; the first line must name frame, x, y"
            )
        yield from rows
    except csv.Error as error:
        raise VideoError(f"{path}: it is no CSV: {error}") from error


def _number(path: Path, line: int, name: str, text: str | None) -> float | None:
    """Return the number of a cell; None for an empty one."""
    if text is None or not text.strip():
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise VideoError(
            f"{path}: line {line}: {name} is {text!r}; it must be a finite number or empty"
        )
    return value
