"""Read the frames of a video, on the grid of the first frames, and their times.

A source is read more than once, so frames are decoded again instead of being kept: ten seconds of video at full size
would take gigabytes.
"""

import subprocess
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError, needs_extra
from gauge_envs.files import os_errors
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

Picture: TypeAlias = NDArray[np.uint8]
"""A picture on the reference grid, blue, green and red, shape [480, 832, 3]."""

SKIPPING = 0.5
"""Scale below which interpolation skips pixels, so that pictures are averaged, which takes four times as long."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """How the pixels of a video lie on the reference grid: `grid = scale * pixel + offset` on each axis.

    Coordinates count from the corner of a picture, so the middle of its first pixel is at 0.5.

    Attributes:
        scale_x: Pixels of the grid for each pixel of the video, horizontally.
        scale_y: The same vertically.
        offset_x_px: Place of the left edge of the video on the grid [px].
        offset_y_px: Place of the top edge of the video on the grid [px].
        method: `stretch`: width and height are scaled each on its own; `crop` and `pad`: both by one factor, about the
            middle.
        support: Share of the outline that agrees, 1.
        problem: Why the registration is doubtful; empty when it is not.
    """

    scale_x: float
    scale_y: float
    offset_x_px: float = 0.0
    offset_y_px: float = 0.0
    method: str = "stretch"
    support: float = 1.0
    problem: str = ""

    @property
    def scale(self) -> FloatArray:
        """Pixels of the grid for each pixel of the video, horizontally and vertically, shape [2]."""
        return np.array([self.scale_x, self.scale_y])

    @property
    def offset_px(self) -> FloatArray:
        """Place of the corner of the video on the grid [px], shape [2]."""
        return np.array([self.offset_x_px, self.offset_y_px])

    def applied(self, picture: NDArray[np.uint8]) -> Picture:
        """Return a picture of the video on the reference grid; beyond its edges, the edge repeats.

        Args:
            picture: Picture of the video, shape [height, width, 3].
        """
        if self.method == "stretch":
            return _resized(picture, REFERENCE_SIZE_PX)
        size = np.array(picture.shape[1::-1])
        # Large pictures are averaged to the size of the grid first.
        near = picture
        if self.scale.min() < SKIPPING:
            width, height = np.maximum(np.rint(size * self.scale), 1).astype(int)
            near = _resized(picture, (int(width), int(height)))
        scale = self.scale * size / near.shape[1::-1]
        offset = self.offset_px + 0.5 * scale - 0.5
        matrix = np.column_stack([np.diag(scale), offset])
        return np.asarray(
            cv2.warpAffine(
                near, matrix, REFERENCE_SIZE_PX, borderMode=cv2.BORDER_REPLICATE
            )
        )


def stretched(size_px: tuple[int, int]) -> Registration:
    """Return the plain scaling of width and height of a video, each on its own, as in the paper."""
    width, height = REFERENCE_SIZE_PX
    return Registration(scale_x=width / size_px[0], scale_y=height / size_px[1])


class _OpenCV:
    """OpenCV, which is imported when one of its names is used: it is optional, and slow to import."""

    def __getattr__(self, name: str) -> Any:
        with needs_extra("OpenCV", "video"):
            import cv2
        return getattr(cv2, name)


cv2: Any = _OpenCV()


def _resized(picture: NDArray[np.uint8], size_px: tuple[int, int]) -> Picture:
    if (picture.shape[1], picture.shape[0]) == size_px:
        return np.ascontiguousarray(picture)
    is_much_larger = size_px[0] < SKIPPING * picture.shape[1]
    method = cv2.INTER_AREA if is_much_larger else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size_px, interpolation=method))


# --- reading ----------------------------------------------------------------------------------------------------------


MOST_BYTES = 2_000_000_000
"""Largest size of a video file."""

MOST_SIDE_PX = 8192
"""Largest width and height of a video [px]: 8K."""

HEAD_BYTES = 4096
"""Bytes at the start of a file, among which each container of videos has a zero."""

MOST_FRAMES = 20_000
"""Most frames of a video."""

LEAST_FRAMES = 8
"""Fewest frames of a video that can be judged."""

LEAST_FPS, MOST_FPS = 5.0, 1000.0
"""Range of frame rates [1/s]: with fewer pictures, a fall is over between two of them."""


class Frames(ABC):
    """Frames of a video that can be read again and again.

    Attributes:
        name: Name for messages.
        fps: Frames per second.
        size_px: Width and height of the video itself [px].
        stated_count: Number of frames that a file states; 0 where it states none.
        times_s: Times at which a file shows its frames [s], shape [frame_count], known once it has been read; None
            when they follow from the rate.
    """

    name: str
    fps: float
    size_px: tuple[int, int]
    stated_count: int = 0
    times_s: FloatArray | None = None

    @abstractmethod
    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in their own size: blue, green and red, shape [height, width, 3]."""

    def pictures(self, registration: Registration | None = None) -> Iterator[Picture]:
        """Yield all pictures on the reference grid.

        Args:
            registration: How they lie on the grid; width and height are scaled each on its own if None.
        """
        chosen = registration or stretched(self.size_px)
        for picture in self.native():
            yield chosen.applied(picture)

    def _check(self) -> None:
        width, height = self.size_px
        if not (1 <= width <= MOST_SIDE_PX and 1 <= height <= MOST_SIDE_PX):
            raise VideoError(
                f"{self.name}: its pictures have {width} x {height} pixels; at most {MOST_SIDE_PX} a side"
            )
        if not LEAST_FPS <= self.fps <= MOST_FPS:
            raise VideoError(
                f"{self.name}: it states {self.fps:g} frames per second; the laws need {LEAST_FPS:g} to {MOST_FPS:g}"
            )


def _check_container(path: Path) -> None:
    """Check that a file has the size of a clip and holds its pictures: a playlist is a text that names other files."""
    if not path.is_file():
        fault = "it is a folder" if path.is_dir() else "there is no such file"
        raise VideoError(f"{path}: {fault}")
    if path.stat().st_size > MOST_BYTES:
        raise VideoError(
            f"{path}: it is larger than {MOST_BYTES // 10**6} MB; cut the clip to the event"
        )
    with (
        os_errors(lambda cause: VideoError(f"{path}: cannot be read: {cause}")),
        path.open("rb") as stream,
    ):
        head = stream.read(HEAD_BYTES)
    if b"\0" not in head:
        raise VideoError(
            f"{path}: it is a text and no video; give an MP4 or WebM video"
        )


class FileFrames(Frames):
    """Frames of a video file.

    Args:
        path: File that OpenCV or FFmpeg can decode, such as MP4 or WebM.
        fps: Frames per second, instead of the rate that the file states.
    """

    def __init__(self, path: Path, *, fps: float | None = None) -> None:
        self.name = str(path)
        self._file = path
        _check_container(path)
        capture = self._opened()
        try:
            if not capture.isOpened():
                raise VideoError(
                    f"{path}: OpenCV cannot decode it; give an MP4 or WebM video"
                )
            if not capture.grab():
                self._file = self._converted(path)
            stated = float(capture.get(cv2.CAP_PROP_FPS))
            self.stated_count = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
            self.size_px = (
                int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
                int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            )
        finally:
            capture.release()
        self.fps = stated if fps is None else fps
        self._has_own_times = fps is None
        self._check()

    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in their own size."""
        capture = self._opened()
        times: list[float] = []
        try:
            while True:
                is_read, picture = capture.read()
                if not is_read:
                    break
                times.append(0.001 * capture.get(cv2.CAP_PROP_POS_MSEC))
                if len(times) > MOST_FRAMES:
                    raise VideoError(
                        f"{self.name}: it has more than {MOST_FRAMES} frames; cut the clip to the event"
                    )
                yield picture
        finally:
            capture.release()
        if not times:
            raise VideoError(
                f"{self.name}: no frame can be decoded; give an MP4 or WebM video"
            )
        if self._has_own_times:
            self.times_s = np.array(times)

    def _converted(self, path: Path) -> Path:
        """Return a file without loss that FFmpeg makes of one whose codec OpenCV lacks, as AV1; it is temporary."""
        with needs_extra("a codec that OpenCV lacks", "video"):
            import imageio_ffmpeg
        self._folder = TemporaryDirectory()
        file = Path(self._folder.name) / "frames.mkv"
        given = ["-protocol_whitelist", "file", "-i", str(path.absolute())]
        options = ["-map", "0:v:0", "-fps_mode", "passthrough", "-c:v", "ffv1"]
        program = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "quiet"]
        subprocess.run(
            [*program, *given, *options, str(file)],
            check=False,
            stdin=subprocess.DEVNULL,
        )
        return file if file.exists() else path

    def _opened(self) -> Any:
        logging = cv2.utils.logging
        level = logging.getLogLevel()
        # The error of this package says more than the warnings of OpenCV.
        logging.setLogLevel(logging.LOG_LEVEL_ERROR)
        try:
            # Each thread of the decoder holds pictures of its own, which are large.
            return cv2.VideoCapture(
                str(self._file), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1]
            )
        finally:
            logging.setLogLevel(level)


class ArrayFrames(Frames):
    """Frames in memory.

    Args:
        frames: Pictures in red, green and blue, each of shape [height, width, 3] and type uint8.
        fps: Frames per second.
    """

    def __init__(
        self, frames: Sequence[NDArray[np.uint8]] | NDArray[np.uint8], *, fps: float
    ) -> None:
        self.name = "frames"
        if not len(frames):
            raise VideoError("frames: there is no frame")
        first = np.asarray(frames[0])
        shapes = {np.asarray(one).shape for one in frames}
        types = {np.asarray(one).dtype for one in frames}
        if shapes != {(*first.shape[:2], 3)} or types != {np.dtype(np.uint8)}:
            raise VideoError(
                f"frames: shapes {shapes} and types {types}; all must be uint8 of one shape [height, width, 3]"
            )
        self._frames = frames
        self.fps = float(fps)
        self.size_px = (first.shape[1], first.shape[0])
        self._check()

    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in their own size."""
        for frame in self._frames:
            yield np.ascontiguousarray(np.asarray(frame)[:, :, ::-1])


# --- cadence ----------------------------------------------------------------------------------------------------------
# A film of 25 pictures a second that is shown at 30 repeats every sixth frame. Judged as it is, its object would halt
# and jump. An object at rest repeats pictures too, but without a rhythm that goes on while it moves.


LEAST_MOTION = 12.0
"""Largest difference of the brightness of two pictures, at a quarter of their size, from which something moves."""

REPEAT_SHARE = 0.25
"""Difference of a repeated picture, against those of its neighbours; compression leaves up to a tenth."""

HALT_SHARE = 0.05
"""The same of a picture that is repeated without a rhythm: models let bodies halt, and leave more."""

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
        fault: Why the times of the pictures are not known; empty when they are.
    """

    is_new: NDArray[np.bool_]
    times_s: FloatArray
    fps: float
    text: str = ""
    fault: str = ""


def cadence_of(
    differences: FloatArray, fps: float, times_s: FloatArray | None = None
) -> Cadence:
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
        is_uniform = (
            np.abs(times_s - times_s[0] - np.arange(count) / fps).max() * fps
            <= MOST_JITTER
        )
        if not is_uniform and (steps > 0.0).all():
            rate = (count - 1) / float(times_s[-1] - times_s[0])
            shortest, longest = 1000.0 * steps.min(), 1000.0 * steps.max()
            text = f"frames last {shortest:.0f} to {longest:.0f} ms: the times that the file states are used"
            return Cadence(
                is_new=every, times_s=times_s - times_s[0], fps=rate, text=text
            )
    values = np.r_[0.0, differences[1:]]
    # The grain of a body at rest is far below its motion.
    moves = values > max(LEAST_MOTION, REPEAT_SHARE * float(values.max()))
    rhythm = _rhythm(values, moves)
    if rhythm is None:
        return Cadence(
            is_new=every,
            times_s=np.arange(count) / fps,
            fps=fps,
            fault=_halts(values, moves),
        )
    period = len(rhythm)
    is_new = ~np.resize(rhythm, count)
    is_new[0] = True
    rate = fps * float((~rhythm).sum()) / period
    text = (
        f"{int(rhythm.sum())} of every {period} frames show the picture before again: "
        f"the {int(is_new.sum())} new pictures count, at {rate:.4g} per second"
    )
    return Cadence(
        is_new=is_new, times_s=np.arange(int(is_new.sum())) / rate, fps=rate, text=text
    )


def _halts(values: FloatArray, moves: NDArray[np.bool_]) -> str:
    """Return which frames repeat a picture without a rhythm while something moves; empty for few."""
    halts = []
    for row in range(2, len(values) - 2):
        # One jump of everything beside it makes no repeat.
        usual = np.sort(values[row - 2 : row + 3])[-2]
        is_amid = moves[row - 2 : row].any() and moves[row + 1 : row + 3].any()
        if is_amid and values[row] < HALT_SHARE * usual:
            halts.append(row)
    if len(halts) < LEAST_REPEATS:
        return ""
    shown = ", ".join(map(str, halts[:9]))
    return f"{len(halts)} frames repeat a picture without a rhythm, so that times are unknown: {shown}"


def _rhythm(values: FloatArray, moves: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Return which frames of one period repeat the one before, shape [period]; None without a rhythm."""
    count = len(values)
    near = [values[max(0, row - 2) : row + 3].max() for row in range(count)]
    repeats = values < REPEAT_SHARE * np.array(near)
    # Only frames with motion before and after say something: a body at rest repeats pictures without a rhythm.
    counts = np.array(
        [
            moves[max(0, row - REACH) : row].any()
            and moves[row + 1 : row + 1 + REACH].any()
            for row in range(count)
        ]
    )
    for period in range(2, MOST_PERIOD + 1):
        phases = np.arange(count) % period
        seen = np.bincount(phases, counts, period)
        again = np.bincount(phases, counts & repeats, period)
        if seen.min() < 2:
            break
        rhythm = again >= CLEAR_SHARE * seen
        is_clear = (rhythm | (again <= (1.0 - CLEAR_SHARE) * seen)).all()
        if is_clear and not rhythm.all() and again[rhythm].sum() >= LEAST_REPEATS:
            return np.asarray(rhythm)
    return None
