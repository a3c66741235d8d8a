"""The track of an object in a video: what each tracker writes, and what the physics is judged by."""

import csv
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.files import csv_text, os_errors, write_whole
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Registration, laid_out
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

LIMITS = dict.fromkeys(
    ["time", "x", "y", "x_grid", "y_grid", "x_mm", "y_mm"], (-1e12, 1e12)
) | {"frame": (0.0, 1e9), "size": (1e-12, 1e12), "confidence": (0.0, 1.0)}
"""Columns of a file with a track, and the range of their numbers."""

GIVEN = "the track is as given: no picture was looked at"
"""Note on a track from a file."""

MIN_NOISE_PX = 0.1
"""Smallest scatter of a tracker from frame to frame that is assumed [px]."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something in a video that makes its track doubtful.

    Attributes:
        kind: `given`, `registration`, `cadence`, `scene`, `camera`, and `motion` of a
            camera that is known.
        text: Description with numbers.
        first_frame: Its first frame.
        last_frame: Its last frame; a number beyond all frames for the whole video.
        is_note: Whether the track may be sound all the same.
    """

    kind: str
    text: str
    first_frame: int = 0
    last_frame: int = 10**9
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
        misfit: Difference from the shape in the first frame, in parts of the area, shape [frame_count].
        tint: Difference from the colour in the first frame, in levels of 255, shape [frame_count].
        other_likeness: Largest likeness of another place to the object, 0 to 1, shape [frame_count].
        events: What happened in the video.
        clock_s: Times of the frames [s], shape [frame_count]; None where they follow from the rate.
        registration: How the video lies on the grid; None for a track in millimetres.
        is_metric: Whether the places are in millimetres, to the right and up in the plane of the motion.
        moves: Motion of the camera since the first frame that was subtracted, shape [2, 3] each; None where it stood.
    """

    frames: NDArray[np.int64]
    fps: float
    points_px: FloatArray
    confidence: FloatArray
    size_ratio: FloatArray
    misfit: FloatArray
    tint: FloatArray
    other_likeness: FloatArray
    events: tuple[Event, ...] = ()
    clock_s: FloatArray | None = None
    registration: Registration | None = None
    is_metric: bool = False
    moves: tuple[FloatArray | None, ...] = ()

    @property
    def is_found(self) -> NDArray[np.bool_]:
        """Whether the object was found, shape [frame_count]."""
        return np.asarray(np.isfinite(self.points_px).all(axis=1))

    @property
    def times_s(self) -> FloatArray:
        """Times of the frames [s], shape [frame_count]."""
        return self.frames / self.fps if self.clock_s is None else self.clock_s

    def in_whole_px(self) -> "Track":
        """Return the track in whole pixels of the video, as the paper stores centroids, where its grid is known."""
        if self.registration is None:
            return self
        scale, offset_px = self.registration.scale, self.registration.offset_px
        whole = np.floor((self.points_px - offset_px) / scale)
        return replace(self, points_px=whole * scale + offset_px)

    def shown_px(self, row: int) -> FloatArray:
        """Return all places as the camera of a row sees them [px], shape [frame_count, 2]."""
        move = self.moves[row] if self.moves else None
        if move is None:
            return self.points_px
        return self.points_px @ move[:, :2].T + move[:, 2]

    def noise_px(self, span: tuple[int, int]) -> float:
        """Return the scatter from frame to frame [px] in a range of rows.

        Third differences of a smooth motion vanish; those of noise have 20 times its variance. The median deviation of
        normal noise is 0.6745 of its standard deviation.
        """
        points = self.points_px[span[0] : span[1] + 1]
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) < 8:
            return MIN_NOISE_PX
        third = np.diff(points, n=3, axis=0)
        deviation = np.median(np.abs(third - np.median(third, axis=0)))
        return max(float(deviation) / 0.6745 / math.sqrt(20.0), MIN_NOISE_PX)


# --- files ------------------------------------------------------------------------------------------------------------


def read_track(
    path: Path | str,
    *,
    fps: float | None = None,
    size_px: tuple[int, int] = REFERENCE_SIZE_PX,
) -> Track:
    """Return a track from a CSV file, of any tracker.

    Columns: `time` [s] or `frame`; `x` and `y` in pixels of the video, from its top left corner, or `x_grid` and
    `y_grid` in those of the known first frame, or `x_mm` and `y_mm` to the right and up in the plane of the motion,
    from the pivot of a swing; optionally `size` in any unit, whose ratio to the first row counts, and `confidence`
    from 0 to 1. Other columns are ignored. Rows without a position have empty cells, or are left out.

    Args:
        path: The file.
        fps: Frames per second of the video; needed where there is no column `time`.
        size_px: Width and height of the video [px].

    Raises:
        VideoError: The file cannot be read, lacks a column or the rate, states both rate and times, or has a cell that
            is no finite number or a place outside of the video.
    """
    path = Path(path)
    values = _columns(path)
    unit = next((u for u in ("_mm", "_grid") if {f"x{u}", f"y{u}"} <= {*values}), "")
    missing = [name for name in (f"x{unit}", f"y{unit}") if name not in values]
    if missing or not values.keys() & {"time", "frame"}:
        raise VideoError(
            f"{path}: there is no column {', '.join(missing) or 'time'}; the first line must name time or frame, then "
            "x and y, x_grid and y_grid, or x_mm and y_mm"
        )
    places = np.column_stack([values[f"x{unit}"], values[f"y{unit}"]])
    is_found = np.isfinite(places).all(axis=1)
    places[~is_found] = np.nan
    frames, clock_s, fps = _clock(path, values, fps)
    registration = laid_out(REFERENCE_SIZE_PX if unit else size_px)
    if not unit:
        if ((places < 0.0) | (places > size_px)).any():
            width, height = size_px
            raise VideoError(
                f"{path}: x, y leave the picture of {width} x {height} pixels: put the video of another size beside "
                "it, and leave cells empty where the object is not seen"
            )
        places = places * registration.scale
    unknown = np.full(len(places), np.nan)
    sizes = values.get("size", unknown)
    known_sizes = sizes[np.isfinite(sizes) & is_found]
    confidence = np.nan_to_num(values.get("confidence", unknown), nan=1.0)
    zeros = np.zeros(len(places))
    return Track(
        frames=frames,
        fps=fps,
        points_px=places,
        confidence=is_found * confidence,
        size_ratio=sizes / known_sizes[0] if len(known_sizes) else unknown,
        misfit=zeros,
        tint=zeros,
        other_likeness=zeros,
        events=(Event(kind="given", text=GIVEN, is_note=True),),
        clock_s=clock_s,
        is_metric=unit == "_mm",
        registration=None if unit == "_mm" else registration,
    )


def save_track(track: Track, path: Path) -> Path:
    """Write a track as the CSV that `read_track` reads, on the grid or in millimetres, and return its path."""
    unit = "mm" if track.is_metric else "grid"
    text = f"frame,time,x_{unit},y_{unit},size,confidence\n"
    numbers = np.column_stack([track.points_px, track.size_ratio, track.confidence])
    for frame, time_s, row in zip(track.frames, track.times_s, numbers, strict=True):
        cells = ["" if np.isnan(value) else f"{value:.4f}" for value in row]
        text += f"{frame},{time_s:.6f},{','.join(cells)}\n"
    with os_errors(lambda cause: VideoError(f"{path}: cannot be written: {cause}")):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    return path


def _columns(path: Path) -> dict[str, FloatArray]:
    """Return the known columns of a CSV file by name; empty cells are NaN."""
    with os_errors(lambda cause: VideoError(f"{path}: cannot be read: {cause}")):
        content = path.read_bytes()
    try:
        rows = list(csv.DictReader(csv_text(content)))
    except (ValueError, csv.Error) as error:
        raise VideoError(f"{path}: it is no CSV: {error}") from error
    if not rows:
        raise VideoError(f"{path}: there is no row below the names of the columns")
    return {
        name: np.array(
            [
                _number(row[name], name, f"{path}: line {line}")
                for line, row in enumerate(rows, start=2)
            ]
        )
        for name in LIMITS.keys() & rows[0].keys()
    }


def _number(text: str | None, name: str, place: str) -> float:
    """Return the number in a cell; NaN for an empty one."""
    if not text or text.isspace():
        return math.nan
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    low, high = LIMITS[name]
    if not low <= number <= high:
        raise VideoError(
            f"{place}: {name} is {text[:40]!r}; it must be a number from {low:g} to {high:g}"
        )
    return number


def _clock(
    path: Path, values: dict[str, FloatArray], fps: float | None
) -> tuple[NDArray[np.int64], FloatArray | None, float]:
    """Return frame numbers, times [s] where the file has them and no rate is given, and the frame rate [1/s]."""
    times_s = values.get("time")
    numbers = values.get("frame")
    if numbers is None:
        numbers = np.arange(float(len(next(iter(values.values())))))
        if fps is not None:
            raise VideoError(f"{path}: its times state the rate: leave out --fps")
    if not (np.diff(numbers, prepend=-1.0) > 0.0).all() or (numbers % 1.0).any():
        raise VideoError(f"{path}: frame must increase from row to row, by integers")
    frames = numbers.astype(np.int64)
    if fps is not None:
        return frames, None, fps
    if times_s is None:
        raise VideoError(
            f"{path}: it has no column time: give the frame rate, as --fps 30"
        )
    steps_s = np.diff(times_s)
    if not (steps_s > 0.0).all() or not len(steps_s):
        raise VideoError(f"{path}: time must increase from row to row [s]")
    rate = 1.0 / float(np.median(steps_s / np.diff(frames)))
    return frames, times_s - times_s[0], rate
