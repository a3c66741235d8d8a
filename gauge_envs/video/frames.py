"""Read the frames of a video, on the grid of the first frames.

A source is read more than once, so frames are decoded again instead of being kept: ten seconds of video at full size
would take gigabytes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import MissingExtraError, VideoError
from gauge_envs.files import MEGABYTE
from gauge_envs.video.tasks import REFERENCE_SIZE_PX

__all__ = ["ArrayFrames", "FileFrames", "Frames", "Picture", "opencv"]

Picture: TypeAlias = NDArray[np.uint8]
"""A picture on the reference grid, blue, green and red, shape [480, 832, 3]."""

MOST_BYTES = 2000 * MEGABYTE
"""Largest size of a video file."""

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
    """

    name: str
    fps: float
    size_px: tuple[int, int]

    @abstractmethod
    def pictures(self) -> Iterator[Picture]:
        """Yield all pictures on the reference grid."""

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

    Raises:
        MissingExtraError: OpenCV is not installed.
        VideoError: The file is missing, too large or no video, or its size or rate is out of range.
    """

    def __init__(self, path: Path, *, fps: float | None = None) -> None:
        self.name = str(path)
        self._path = path
        if not path.is_file():
            raise VideoError(f"{path}: there is no such file")
        if path.stat().st_size > MOST_BYTES:
            raise VideoError(f"{path}: it is larger than {MOST_BYTES // MEGABYTE} MB; cut the clip to the event")
        cv2 = opencv()
        capture = cv2.VideoCapture(str(path))
        try:
            if not capture.isOpened():
                raise VideoError(f"{path}: OpenCV cannot decode it; give an MP4 or WebM video")
            stated = float(capture.get(cv2.CAP_PROP_FPS))
            self.size_px = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        finally:
            capture.release()
        self.fps = stated if fps is None else fps
        self._check()

    def pictures(self) -> Iterator[Picture]:
        """Yield all pictures on the reference grid.

        Raises:
            VideoError: There are too many frames, or none can be decoded.
        """
        cv2 = opencv()
        capture = cv2.VideoCapture(self.name)
        count = 0
        try:
            while True:
                is_read, picture = capture.read()
                if not is_read:
                    break
                count += 1
                if count > MOST_FRAMES:
                    raise VideoError(f"{self.name}: it has more than {MOST_FRAMES} frames; cut the clip to the event")
                yield _on_reference_grid(picture)
        finally:
            capture.release()
        if not count:
            raise VideoError(f"{self.name}: no frame can be decoded; give an MP4 or WebM video")


class ArrayFrames(Frames):
    """Frames in memory.

    Args:
        frames: Pictures in red, green and blue, each of shape [height, width, 3] and type uint8.
        fps: Frames per second.

    Raises:
        VideoError: There is no frame, a frame has another shape or type, or size or rate is out of range.
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

    def pictures(self) -> Iterator[Picture]:
        """Yield all pictures on the reference grid."""
        for frame in self._frames:
            yield _on_reference_grid(np.asarray(frame)[:, :, ::-1])


def opencv() -> Any:
    """Return OpenCV.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("OpenCV", "video", error) from error
    return cv2


def _on_reference_grid(picture: NDArray[np.uint8]) -> Picture:
    """Return a picture with its width and height scaled to the reference grid, each on its own."""
    cv2 = opencv()
    width, height = REFERENCE_SIZE_PX
    if picture.shape[:2] == (height, width):
        return np.ascontiguousarray(picture)
    is_larger = picture.shape[1] >= width
    method = cv2.INTER_AREA if is_larger else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, (width, height), interpolation=method))
