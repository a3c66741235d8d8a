"""The track of an object in a video: what every tracker writes, and all that the physics is judged by."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from gauge_envs.errors import VideoError, first_fault
from gauge_envs.files import csv_text, os_errors, write_whole
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Registration, stretched
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

MOST_NUMBER = 1e12
"""Largest magnitude of a number; a clock may count seconds since 1970."""

LAST_FRAME = 10**9
"""Largest number of a frame."""

LEAST_NOISE_PX = 0.1
"""Smallest scatter of a tracker from frame to frame that is assumed [px]."""

GIVEN = "the track is as given: no picture was looked at"
"""What is said of a track from a file."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something in a video that makes its track doubtful.

    Attributes:
        kind: `given`, `camera`, `scene`, `registration`, `picture`, `cadence`, `time`, `file`.
        first_frame: First frame of it.
        last_frame: Last frame of it.
        text: Description with numbers.
        is_note: Whether it is stated of a track that may be sound.
    """

    kind: str
    first_frame: int
    last_frame: int
    text: str
    is_note: bool = False

    @classmethod
    def over(
        cls, kind: str, frames: Sequence[int], text: str, *, is_note: bool = False
    ) -> "Event":
        """Return an event that was seen in some frames, in order, with the first and the last of them in its text."""
        first, last = frames[0], frames[-1]
        return cls(
            kind=kind,
            first_frame=first,
            last_frame=last,
            text=f"{text} (frames {first} to {last})",
            is_note=is_note,
        )


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
        return (
            self.points_px
            if move is None
            else self.points_px @ move[:, :2].T + move[:, 2]
        )

    def noise_px(self, span: tuple[int, int]) -> float:
        """Return the scatter from frame to frame [px] in some rows, by third differences: smooth motions have none."""
        points = self.points_px[span[0] : span[1] + 1]
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) < 8:
            return LEAST_NOISE_PX
        third = np.diff(points, n=3, axis=0)
        deviation = np.median(np.abs(third - np.median(third, axis=0)))
        # The median deviation of normal noise is 0.6745 of its scatter; third differences have 20 times its variance.
        return max(float(deviation) / 0.6745 / math.sqrt(20.0), LEAST_NOISE_PX)

    @property
    def times_s(self) -> FloatArray:
        """Times of the frames [s], shape [frame_count]."""
        return self.frames / self.fps if self.clock_s is None else self.clock_s


_or_none = BeforeValidator(lambda text: (text or "").strip() or None)
Cell: TypeAlias = Annotated[
    Annotated[float, Field(ge=-MOST_NUMBER, le=MOST_NUMBER)] | None, _or_none
]
"""Number of a cell; None for an empty one, to which no limit applies."""


class _Row(BaseModel):
    """Row of a track; other columns are ignored."""

    time: Cell = None
    frame: Annotated[
        Annotated[float, Field(ge=0, le=LAST_FRAME, multiple_of=1)] | None, _or_none
    ] = None
    x: Cell = None
    y: Cell = None
    x_grid: Cell = None
    y_grid: Cell = None
    x_mm: Cell = None
    y_mm: Cell = None
    size: Annotated[Annotated[float, Field(gt=0, le=MOST_NUMBER)] | None, _or_none] = (
        None
    )
    confidence: Annotated[Annotated[float, Field(ge=0, le=1)] | None, _or_none] = None


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
    if fps is not None and not (math.isfinite(fps) and fps > 0.0):
        raise VideoError(
            f"fps is {fps}: state the frame rate of the video, as --fps 30"
        )
    rows = _rows(path)
    names = rows[0].model_fields_set
    unit = next((u for u in ("_mm", "_grid") if {f"x{u}", f"y{u}"} <= names), "")
    missing = sorted({f"x{unit}", f"y{unit}"} - names)
    if missing or not names & {"time", "frame"}:
        raise VideoError(
            f"{path}: there is no column {', '.join(missing) or 'time'}; the first line must name time or frame, then "
            "x and y, x_grid and y_grid, or x_mm and y_mm"
        )
    # An empty cell is NaN.
    values = {
        name: np.array([getattr(row, name) for row in rows], dtype=float)
        for name in _Row.model_fields
    }
    numbers = values["frame"] if "frame" in names else np.arange(len(rows))
    if not np.isfinite(numbers).all() or not (np.diff(numbers) > 0.0).all():
        raise VideoError(f"{path}: frame must increase from row to row")
    frames = numbers.astype(np.int64)
    clock_s = None
    if {"time", "frame"} & names == {"time"} and fps is not None:
        raise VideoError(f"{path}: its times state the rate: leave out --fps")
    if "time" in names and fps is None:
        clock_s = values["time"]
        if len(rows) < 2 or not (np.diff(clock_s) > 0.0).all():
            raise VideoError(f"{path}: time must increase from row to row [s]")
        fps = 1.0 / float(np.median(np.diff(clock_s) / np.diff(frames)))
        clock_s = clock_s - clock_s[0]
    if fps is None:
        raise VideoError(
            f"{path}: it has no column time: give the frame rate, as --fps 30"
        )
    places = np.column_stack([values[f"x{unit}"], values[f"y{unit}"]])
    is_found = np.isfinite(places).all(axis=1)
    places[~is_found] = np.nan
    if not unit:
        if ((places < 0.0) | (places > size_px)).any():
            width, height = size_px
            raise VideoError(
                f"{path}: x, y leave the picture of {width} x {height} pixels: put the video of another size beside "
                "it, and leave cells empty where the object is not seen"
            )
        places = places * np.array(REFERENCE_SIZE_PX) / np.array(size_px, dtype=float)
    sizes = values["size"]
    unknown = np.zeros(len(rows))
    known = sizes[np.isfinite(sizes) & is_found]
    return Track(
        frames=frames,
        fps=fps,
        points_px=places,
        confidence=is_found * np.nan_to_num(values["confidence"], nan=1.0),
        size_ratio=sizes / known[0] if len(known) else sizes,
        misfit=unknown,
        tint=unknown,
        other_likeness=unknown,
        events=(
            Event(
                kind="given",
                first_frame=0,
                last_frame=LAST_FRAME,
                text=GIVEN,
                is_note=True,
            ),
        ),
        clock_s=clock_s,
        is_metric=unit == "_mm",
        registration=None
        if unit == "_mm"
        else stretched(REFERENCE_SIZE_PX if unit else size_px),
    )


def save_track(track: Track, path: Path) -> Path:
    """Write a track as the CSV that `read_track` reads, on the grid or in millimetres, and return its path."""
    unit = "mm" if track.is_metric else "grid"
    lines = [f"frame,time,x_{unit},y_{unit},size,confidence"]
    for frame, time_s, place, size, sure in zip(
        track.frames,
        track.times_s,
        track.points_px,
        track.size_ratio,
        track.confidence,
        strict=True,
    ):
        cells = [
            "" if np.isnan(value) else f"{value:.4f}" for value in (*place, size, sure)
        ]
        lines.append(f"{frame},{time_s:.6f},{','.join(cells)}")
    with os_errors(lambda cause: VideoError(f"{path}: cannot be written: {cause}")):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, ("\n".join(lines) + "\n").encode())
    return path


def _rows(path: Path) -> list[_Row]:
    """Return the rows of a CSV file."""
    with os_errors(lambda cause: VideoError(f"{path}: cannot be read: {cause}")):
        content = path.read_bytes()
    rows: list[_Row] = []
    try:
        for cells in csv.DictReader(csv_text(content)):
            if None in cells:
                raise ValueError(f"line {len(rows) + 2} has more cells than line 1")
            rows.append(_Row.model_validate(cells))
    except ValidationError as error:
        name, cause = first_fault(error)
        raise VideoError(f"{path}: line {len(rows) + 2}: {name}: {cause}") from None
    except (ValueError, csv.Error) as error:
        raise VideoError(f"{path}: it is no CSV: {error}") from error
    if not rows:
        raise VideoError(f"{path}: there is no row below the names of the columns")
    return rows
