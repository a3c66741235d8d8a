"""Read the frames of a video, put them on the grid of the known first frames, and find when they were taken.

A source is decoded each time that it is read: ten seconds of video at full size would take gigabytes of memory.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, maximum_filter1d

from gauge_envs.errors import VideoError, needs_extra
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX


class _OpenCV:
    """OpenCV, which is imported when one of its names is used: it is optional, and slow to import."""

    def __getattr__(self, name: str) -> Any:
        with needs_extra("OpenCV", "video"):
            import cv2
        return getattr(cv2, name)


cv2: Any = _OpenCV()

Picture: TypeAlias = NDArray[np.uint8]
"""A picture on the reference grid, blue, green and red, shape [480, 832, 3]."""

MIN_FRAMES = 8
"""Smallest number of frames of a video that can be judged."""

MIN_FPS, MAX_FPS = 5.0, 1000.0
"""Range of frame rates [1/s]: with fewer pictures, a fall is over between two of them."""

MIN_LINEAR_SCALE = 0.5
"""Scale below which linear interpolation skips pixels, so that pictures are averaged first."""


@dataclass(frozen=True, kw_only=True)
class Registration:
    """How the pixels of a video lie on the reference grid: `grid = scale * pixel + offset` on each axis.

    Coordinates count from the corner of a picture, so the middle of its first pixel is at 0.5.

    Attributes:
        scale_x: Pixels of the grid for each pixel of the video, horizontally.
        scale_y: The same vertically.
        offset_x_px: Place of the left edge of the video on the grid [px].
        offset_y_px: Place of the top edge of the video on the grid [px].
        method: `stretch`: width and height are scaled independently; `crop` and `pad`: both by one factor, about the
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
        """Return a picture of the video on the reference grid; its edge pixels fill the area outside it.

        Args:
            picture: Picture of the video, shape [height, width, 3].
        """
        size_px = np.array(picture.shape[1::-1])
        if self.scale.min() < MIN_LINEAR_SCALE:
            small_px = np.maximum(np.rint(size_px * self.scale), 1).astype(int)
            picture = cv2.resize(
                picture, small_px.tolist(), interpolation=cv2.INTER_AREA
            )
        scale = self.scale * size_px / picture.shape[1::-1]
        # Integer coordinates of OpenCV are the middles of pixels.
        offset_px = self.offset_px + 0.5 * scale - 0.5
        matrix = np.column_stack([np.diag(scale), offset_px])
        return np.asarray(
            cv2.warpAffine(
                picture, matrix, REFERENCE_SIZE_PX, borderMode=cv2.BORDER_REPLICATE
            )
        )


def laid_out(size_px: tuple[int, int], method: str = "stretch") -> Registration:
    """Return the registration of a video of a size by a method: `stretch`, as in the paper, `crop` or `pad`.

    Args:
        size_px: Width and height of the video [px].
        method: The method.
    """
    grid_px = np.array(REFERENCE_SIZE_PX)
    scale = grid_px / size_px
    if method != "stretch":
        scale[:] = scale.min() if method == "crop" else scale.max()
    x_px, y_px = (0.5 * (grid_px - scale * size_px)).tolist()
    scale_x, scale_y = scale.tolist()
    return Registration(
        scale_x=scale_x,
        scale_y=scale_y,
        offset_x_px=x_px,
        offset_y_px=y_px,
        method=method,
    )


# --- reading ----------------------------------------------------------------------------------------------------------


class Frames(ABC):
    """Frames of a video that can be read repeatedly.

    Args:
        name: Name for messages.
        fps: Frames per second.
        size_px: Width and height of the video [px].

    Attributes:
        times_s: Times at which a file shows its frames [s], shape [frame_count]. They are known after the first read;
            None when they follow from the rate.

    Raises:
        VideoError: The frame rate is out of range.
    """

    def __init__(self, name: str, fps: float, size_px: tuple[int, int]) -> None:
        self.name, self.fps, self.size_px = name, fps, size_px
        self.times_s: FloatArray | None = None
        if not MIN_FPS <= fps <= MAX_FPS:
            raise VideoError(
                f"{name}: it has {fps:g} frames per second; the laws need {MIN_FPS:g} to {MAX_FPS:g}"
            )

    @abstractmethod
    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in the size of the video: blue, green and red, shape [height, width, 3]."""

    def pictures(self, registration: Registration | None = None) -> Iterator[Picture]:
        """Yield all pictures on the reference grid.

        Args:
            registration: How the video lies on the grid; None stretches it.
        """
        registration = registration or laid_out(self.size_px)
        return map(registration.applied, self.native())


class FileFrames(Frames):
    """Frames of a video file.

    Args:
        path: File that OpenCV can decode, such as MP4 or WebM.
        fps: Frames per second, instead of the rate of the file.

    Raises:
        VideoError: The file is missing or cannot be decoded, or its frame rate is out of range.
    """

    def __init__(self, path: Path, *, fps: float | None = None) -> None:
        self._path = path
        self._uses_file_times = fps is None
        if not path.is_file():
            raise VideoError(f"{path}: there is no such file")
        capture = self._opened()
        if not capture.grab():
            raise VideoError(
                f"{path}: OpenCV cannot decode it; convert it by ffmpeg -i {path.name} -c:v libx264 video.mp4"
            )
        width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        super().__init__(str(path), fps or rate, (width, height))

    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in the size of the video."""
        capture = self._opened()
        times_ms: list[float] = []
        is_read, picture = capture.read()
        while is_read:
            times_ms.append(capture.get(cv2.CAP_PROP_POS_MSEC))
            yield picture
            is_read, picture = capture.read()
        if self._uses_file_times:
            self.times_s = 1e-3 * np.array(times_ms)

    def _opened(self) -> Any:
        # The error of this package says more than the warnings of OpenCV.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        return cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)


class ArrayFrames(Frames):
    """Frames in memory.

    Args:
        frames: Pictures in red, green and blue, each of shape [height, width, 3] and type uint8.
        fps: Frames per second.

    Raises:
        VideoError: There is no frame, shapes or types differ, or the frame rate is out of range.
    """

    def __init__(
        self, frames: Sequence[NDArray[np.uint8]] | NDArray[np.uint8], *, fps: float
    ) -> None:
        self._frames = [np.asarray(frame) for frame in frames]
        shapes = {frame.shape for frame in self._frames}
        types = {frame.dtype.name for frame in self._frames}
        if types != {"uint8"} or [(*s[:2], 3) for s in shapes] != [*shapes]:
            raise VideoError(
                f"frames: {len(frames)} frames have shapes {shapes} and types {types}; "
                "all must be uint8 of one shape [height, width, 3]"
            )
        height, width, _ = self._frames[0].shape
        super().__init__("frames", fps, (width, height))

    def native(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all pictures in the size of the video."""
        return (np.ascontiguousarray(frame[:, :, ::-1]) for frame in self._frames)


# --- cadence ----------------------------------------------------------------------------------------------------------
# A film of 25 pictures a second that is shown at 30 repeats every sixth frame: its object would halt and jump. An
# object at rest repeats pictures too, but in no rhythm that goes on while it moves.

MIN_MOTION = 12.0
"""Largest difference of the brightness of two pictures, at a quarter of their size, from which something moves."""

MAX_REPEAT_SHARE = 0.25
"""Largest difference of a repeated picture, relative to its neighbours; compression leaves up to a tenth."""

MOTION_REACH = 5
"""Frames on both sides within which something must move, so that a repeat is no rest."""

MAX_PERIOD = 12
"""Longest rhythm of repeats, in frames."""

MIN_CLEAR_SHARE = 0.8
"""Share of the frames at one place of the rhythm that must repeat, or be new."""

MIN_REPEATS = 3
"""Smallest number of repeats while something moves."""


@dataclass(frozen=True, kw_only=True)
class Cadence:
    """When the pictures of a video were taken.

    Attributes:
        is_new: Whether a frame shows a new picture, shape [frame_count].
        times_s: Times of the new pictures [s], shape [new_count].
        fps: New pictures per second, on average.
        text: Which frames repeat a picture; empty when none does.
    """

    is_new: NDArray[np.bool_]
    times_s: FloatArray
    fps: float
    text: str = ""


def cadence_of(
    differences: FloatArray, fps: float, times_s: FloatArray | None = None
) -> Cadence:
    """Return when pictures were taken, from their differences and the times in the file.

    Args:
        differences: Largest difference of each picture from the one before, shape [frame_count]; the first is infinite.
        fps: Frames per second.
        times_s: Times in the file [s], shape [frame_count]; None where it has a rate alone.
    """
    count = len(differences)
    is_new = np.ones(count, dtype=bool)
    is_repeat = _rhythm(np.r_[0.0, differences[1:]])
    if is_repeat is None:
        clock_s = np.arange(count) / fps
        if times_s is not None and (np.diff(times_s) > 0.0).all() and count > 1:
            clock_s = times_s - times_s[0]
            fps = (count - 1) / float(clock_s[-1])
        return Cadence(is_new=is_new, times_s=clock_s, fps=fps)
    is_new = ~np.resize(is_repeat, count)
    is_new[0] = True
    new_count = int(is_new.sum())
    rate = fps * float((~is_repeat).mean())
    text = (
        f"{is_repeat.sum()} of every {len(is_repeat)} frames show the picture before again: "
        f"the {new_count} new pictures count, at {rate:.4g} per second"
    )
    return Cadence(
        is_new=is_new, times_s=np.arange(new_count) / rate, fps=rate, text=text
    )


def _rhythm(values: FloatArray) -> NDArray[np.bool_] | None:
    """Return which frames of one period repeat the one before, shape [period]; None without a rhythm."""
    # The grain of a body at rest is far below its motion.
    moves = values > max(MIN_MOTION, MAX_REPEAT_SHARE * float(values.max()))
    repeats = values < MAX_REPEAT_SHARE * maximum_filter1d(values, 5)
    is_amid_motion = binary_closing(moves, np.ones(2 * MOTION_REACH))
    for period in range(2, MAX_PERIOD + 1):
        phases = np.arange(len(values)) % period
        seen = np.bincount(phases, is_amid_motion, period)
        repeated = np.bincount(phases, is_amid_motion & repeats, period)
        if seen.min() < 2:
            break
        rhythm = repeated >= MIN_CLEAR_SHARE * seen
        is_new = repeated <= (1.0 - MIN_CLEAR_SHARE) * seen
        is_clear = (rhythm | is_new).all() and not rhythm.all()
        if is_clear and repeated[rhythm].sum() >= MIN_REPEATS:
            return np.asarray(rhythm)
    return None
