"""Tracks of objects in videos: the output of trackers, and the input of the fits."""

import csv
import io
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import median_abs_deviation

from gauge_envs.errors import VideoError
from gauge_envs.pages.document import save_file
from gauge_envs.reading import reading
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray
from gauge_envs.text import csv_text, json_document
from gauge_envs.tools.video.frames import FileFrames, Registration, laid_out
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

COLUMNS = {"time", "frame", "x", "y", "x_grid", "y_grid"}
"""Known columns of a track file."""

VIDEO_SUFFIXES = (".mp4", ".webm", ".mkv", ".mov", ".avi")
"""Suffixes of videos."""

TRACK_SUFFIXES = (".csv", ".json")
"""Suffixes of tracks."""

GIVEN = "the track comes from a file: no picture was checked"
"""Note on a track from a file."""

GRID = laid_out(REFERENCE_SIZE_PX)
"""Registration of places on the reference grid."""

MIN_NOISE_PX = 0.1
"""Smallest assumed scatter of a tracker between frames [px]."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """Centre of an object, frame by frame, on the reference grid.

    Attributes:
        frames: Frame numbers, shape [frame_count], increasing.
        times_s: Times of the frames [s], shape [frame_count].
        fps: Frames per second.
        points_px: Centres [px], shape [frame_count, 2]; NaN if the object is not visible.
        confidence: Likeness to the object in the first frame, 0 to 1, shape [frame_count]; 0 if it is not visible.
        misfit: Difference from size and shape in the first frame, relative to the area, shape [frame_count].
        other_likeness: Largest likeness of another place to the object, 0 to 1, shape [frame_count].
        events: Events that make the track doubtful.
        notes: More observations.
        registration: Registration of the video on the grid.
    """

    frames: IntArray
    times_s: FloatArray
    fps: float
    points_px: FloatArray
    confidence: FloatArray
    misfit: FloatArray
    other_likeness: FloatArray
    events: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    registration: Registration = GRID

    @property
    def is_found(self) -> BoolArray:
        """Whether the object is visible, shape [frame_count]."""
        return np.asarray(np.isfinite(self.points_px).all(axis=1))

    def in_whole_px(self) -> "Track":
        """Return the track in whole pixels of the video, as the paper stores centroids."""
        scale, offset_px = self.registration.scale, self.registration.offset_px
        whole = np.floor((self.points_px - offset_px) / scale)
        return replace(self, points_px=whole * scale + offset_px)

    def noise_px(self, span: tuple[int, int]) -> float:
        """Return the scatter between frames in a range of rows [px].

        Third differences of a smooth motion vanish; third differences of noise have 20 times its variance. The median
        deviation ignores single frames.
        """
        rows = np.flatnonzero(self.is_found[: span[1] + 1])
        third = np.diff(self.points_px[rows[rows >= span[0]]], n=3, axis=0)
        if len(third) < 5:
            return MIN_NOISE_PX
        deviation = median_abs_deviation(third, axis=None, scale="normal")
        return max(float(deviation) / math.sqrt(20.0), MIN_NOISE_PX)


# --- files ------------------------------------------------------------------------------------------------------------


def video_of(track: Path) -> Path | None:
    """Return the video with the name of a track, if any."""
    videos = (track.with_suffix(suffix) for suffix in VIDEO_SUFFIXES)
    return next(filter(Path.exists, videos), None)


def read_track(path: Path | str, *, fps: float | None = None) -> Track:
    """Return a track from a CSV or JSON file of any tracker.

    The file has `time` [s] or `frame`. Pixels from the top left corner of the video with the same name, else of the
    known first frame, are in `x` and `y`. Pixels of the known first frame are in `x_grid` and `y_grid`. Other columns
    are ignored. Rows without a position have empty cells or are left out. A JSON file has the centre `[x, y]` of each
    frame by its number.

    Args:
        path: The file.
        fps: Frames per second; those of the video with the same name if None. Without both, times are required.

    Raises:
        VideoError: The file cannot be read, a column or the rate is missing, or a cell is not a number or not in the
            video.
    """
    values, video = _columns(Path(path)), video_of(Path(path))
    size_px = REFERENCE_SIZE_PX
    if video is not None:
        frames_of_video = FileFrames(video)
        size_px = frames_of_video.size_px
        if "time" not in values:
            fps = fps or frames_of_video.fps
    unit = "_grid" if "x_grid" in values else ""
    x, y = values.get(f"x{unit}"), values.get(f"y{unit}")
    if x is None or y is None or not values.keys() & {"time", "frame"}:
        raise VideoError(
            f"{path}: the first line must have the columns time or frame, and x and y or x_grid and y_grid"
        )
    places = np.column_stack([x, y])
    registration = GRID if unit else laid_out(size_px)
    if not unit and ((places < 0.0) | (places > size_px)).any():
        width, height = size_px
        raise VideoError(
            f"{path}: x, y are outside of the picture of {width} x {height} pixels: put a video of another size next "
            "to the file, and leave cells empty if the object is not visible"
        )
    count = len(places)
    frames = values.get("frame", np.arange(count)).astype(np.int64)
    if fps is None and "time" in values:
        times_s = values["time"] - values["time"][0]
    elif fps is not None and "frame" in values:
        times_s = frames / fps
    else:
        raise VideoError(
            f"{path}: give a column time [s], or frame and --fps, or the video with the same name"
        )
    steps_s, frame_steps = np.diff(times_s), np.diff(frames)
    if count < 2 or not (np.minimum(steps_s, frame_steps) > 0.0).all():
        raise VideoError(f"{path}: time and frame must increase from row to row")
    zeros = np.zeros(count)
    return Track(
        frames=frames,
        times_s=times_s,
        fps=fps or 1.0 / float(np.median(steps_s / frame_steps)),
        points_px=places * registration.scale,
        confidence=1.0 * np.isfinite(places[:, 0]),
        misfit=zeros,
        other_likeness=zeros,
        notes=(GIVEN,),
        registration=registration,
    )


def save_track(track: Track, path: Path) -> Path:
    """Write a track on the grid as CSV for `read_track`, and return its path."""
    stream = io.StringIO()
    np.savetxt(
        stream,
        np.column_stack([track.frames, track.times_s, track.points_px]),
        fmt=["%d", "%.6f", "%.4f", "%.4f"],
        delimiter=",",
        header="frame,time,x_grid,y_grid",
        comments="",
    )
    # Cells are empty if the object is not visible.
    return save_file(path, stream.getvalue().replace("nan", ""))


def _columns(path: Path) -> dict[str, FloatArray]:
    """Return the known columns of a file by name; empty cells are NaN."""
    if path.suffix.lower() == ".json":
        return _centres(path)
    with reading(path, VideoError, "a CSV file of numbers") as content:
        rows = list(csv.DictReader(csv_text(content)))
        names = COLUMNS & {*rows[0]} if rows else ()
        return {
            name: np.array([float(row[name] or "nan") for row in rows])
            for name in names
        }


def _centres(path: Path) -> dict[str, FloatArray]:
    """Return the columns of a JSON file that has the centre [x, y] of each frame by its number; null is NaN."""
    noun = 'a JSON object with a centre for each frame, as {"0": [412, 230], "1": null}'
    with reading(path, VideoError, noun) as content:
        centre_of = {
            int(frame): centre for frame, centre in json_document(content).items()
        }
        frames = sorted(centre_of)
        unseen = (math.nan, math.nan)
        centres = [
            unseen if centre_of[frame] is None else centre_of[frame] for frame in frames
        ]
        x, y = np.array(centres, dtype=float).T
    return {"frame": np.array(frames, dtype=float), "x": x, "y": y}
