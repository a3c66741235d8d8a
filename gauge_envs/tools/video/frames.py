"""Read the frames of a video, on the grid of the first frames, and write pictures as a video.

A source is read more than once, so frames are decoded again instead of being kept: ten seconds of video at full size
would take gigabytes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.files import MEGABYTE, os_errors
from gauge_envs.tools.video.grid import Picture, Registration, cv2, stretched

MOST_BYTES = 2000 * MEGABYTE
"""Largest size of a video file."""

MOST_PICTURE_BYTES = 64 * MEGABYTE
"""Largest size of a picture file."""

MOST_SIDE_PX = 8192
"""Largest width and height of a video [px]: 8K."""

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
    """

    name: str
    fps: float
    size_px: tuple[int, int]
    stated_count: int = 0

    @abstractmethod
    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in their own size: blue, green and red, shape [height, width, 3]."""

    @property
    def times_s(self) -> NDArray[np.float64] | None:
        """Times at which a file shows its frames [s], shape [frame_count]; None when they follow from the rate."""
        return None

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
            raise VideoError(f"{self.name}: its pictures have {width} x {height} pixels; at most {MOST_SIDE_PX} a side")
        if not LEAST_FPS <= self.fps <= MOST_FPS:
            raise VideoError(
                f"{self.name}: it states {self.fps:g} frames per second; the laws need {LEAST_FPS:g} to {MOST_FPS:g}"
            )


class FileFrames(Frames):
    """Frames of a video file.

    Args:
        path: File that OpenCV can decode, such as MP4 or WebM.
        fps: Frames per second, instead of the rate that the file states.
    """

    def __init__(self, path: Path, *, fps: float | None = None) -> None:
        self.name = str(path)
        self._path = path
        _check_size(path, MOST_BYTES, "cut the clip to the event")
        capture = self._opened()
        try:
            if not capture.isOpened():
                raise VideoError(f"{path}: OpenCV cannot decode it; give an MP4 or WebM video")
            stated = float(capture.get(cv2.CAP_PROP_FPS))
            self.stated_count = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
            self.size_px = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        finally:
            capture.release()
        self.fps = stated if fps is None else fps
        self._has_own_times = fps is None
        self._times_s: list[float] = []
        self._check()

    @property
    def times_s(self) -> NDArray[np.float64] | None:
        """Times at which the file shows its frames [s], shape [frame_count], known once it has been read.

        None when the rate was given instead.
        """
        return np.array(self._times_s) if self._has_own_times and self._times_s else None

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
                    raise VideoError(f"{self.name}: it has more than {MOST_FRAMES} frames; cut the clip to the event")
                yield picture
        finally:
            capture.release()
        if not times:
            raise VideoError(f"{self.name}: no frame can be decoded; give an MP4 or WebM video")
        self._times_s = times

    def _opened(self) -> Any:
        logging = cv2.utils.logging
        level = logging.getLogLevel()
        # The error of this package says more than the warnings of OpenCV.
        logging.setLogLevel(logging.LOG_LEVEL_ERROR)
        try:
            # Each thread of the decoder holds pictures of its own, which are large.
            return cv2.VideoCapture(self.name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
        finally:
            logging.setLogLevel(level)


class ArrayFrames(Frames):
    """Frames in memory.

    Args:
        frames: Pictures in red, green and blue, each of shape [height, width, 3] and type uint8.
        fps: Frames per second.
    """

    def __init__(self, frames: Sequence[NDArray[np.uint8]] | NDArray[np.uint8], *, fps: float) -> None:
        self.name = "frames"
        if not len(frames):
            raise VideoError("frames: there is no frame")
        first = np.asarray(frames[0])
        for number, frame in enumerate(frames):
            one = np.asarray(frame)
            if one.ndim != 3 or one.shape[2] != 3 or one.dtype != np.uint8 or one.shape != first.shape:
                raise VideoError(
                    f"frames[{number}]: shape {one.shape} and type {one.dtype}; all must be uint8 of one shape "
                    "[height, width, 3]"
                )
        self._frames = frames
        self.fps = float(fps)
        self.size_px = (first.shape[1], first.shape[0])
        self._check()

    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in their own size."""
        for frame in self._frames:
            yield np.ascontiguousarray(np.asarray(frame)[:, :, ::-1])


def _check_size(path: Path, most_bytes: int, advice: str) -> None:
    if not path.is_file():
        raise VideoError(f"{path}: there is no such file")
    if path.stat().st_size > most_bytes:
        raise VideoError(f"{path}: it is larger than {most_bytes // MEGABYTE} MB; {advice}")


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Return a picture from a file: blue, green and red, shape [height, width, 3]."""
    _check_size(path, MOST_PICTURE_BYTES, "give the first frame as PNG")
    picture = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise VideoError(f"{path}: OpenCV cannot decode it; give the first frame as PNG or JPEG")
    return np.asarray(picture)


def write_mp4(path: Path, pictures: Iterable[NDArray[np.uint8]], fps: float) -> None:
    """Write pictures in blue, green and red as MP4; the folder is created."""
    with os_errors(lambda cause: VideoError(f"{path}: cannot be written: {cause}")):
        path.parent.mkdir(parents=True, exist_ok=True)
    writer = None
    for picture in pictures:
        if writer is None:
            size = (picture.shape[1], picture.shape[0])
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), fps, size)
            if not writer.isOpened():
                raise VideoError(f"{path}: cannot be written as MP4; choose another folder or name")
        writer.write(picture)
    if writer is not None:
        writer.release()
