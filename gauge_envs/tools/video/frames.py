"""Read the frames of a video, and register them on the grid of the known first frames.

Each iteration decodes the video again: ten seconds of video at full size take gigabytes of memory.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.optional import needs_extra
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    MotionKind,
    VideoTask,
)


class _OpenCV:
    """OpenCV, imported on first use: it is optional and slow to import."""

    def __getattr__(self, name: str) -> Any:
        with needs_extra("OpenCV", "video"):
            import cv2
        return getattr(cv2, name)


cv2: Any = _OpenCV()

Picture: TypeAlias = NDArray[np.uint8]
"""A picture, blue, green and red, shape [height, width, 3]; on the reference grid [480, 832, 3]."""

Gray: TypeAlias = NDArray[np.float32]
"""Brightness or covered share of pixels, shape [height, width]."""

MIN_FPS, MAX_FPS = 5.0, 1000.0
"""Range of frame rates [1/s]: at lower rates, a fall may end between two frames."""


# --- reading ----------------------------------------------------------------------------------------------------------


class FileFrames:
    """Frames of a video file; they can be read repeatedly.

    Args:
        path: File that OpenCV can decode, such as MP4 or WebM.
        fps: Frames per second, instead of the rate of the file.

    Attributes:
        path: The file.
        fps: Frames per second.
        size_px: Width and height of the video [px].

    Raises:
        VideoError: The file is missing or cannot be decoded, or its frame rate is out of range.
    """

    def __init__(self, path: Path, *, fps: float | None = None) -> None:
        self.path = path
        if not path.is_file():
            raise VideoError(f"{path}: no such file")
        capture = self._opened()
        if not capture.grab():
            raise VideoError(
                f"{path}: OpenCV cannot decode it; convert it with ffmpeg -i {path.name} -c:v libx264 video.mp4"
            )
        width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        self.size_px = (width, height)
        self.fps = fps or capture.get(cv2.CAP_PROP_FPS)
        if not MIN_FPS <= self.fps <= MAX_FPS:
            raise VideoError(
                f"{path}: it has {self.fps:g} frames per second; the laws need {MIN_FPS:g} to {MAX_FPS:g}"
            )

    def __iter__(self) -> Iterator[Picture]:
        """Yield all pictures in the size of the video."""
        capture = self._opened()
        is_read, picture = capture.read()
        while is_read:
            yield picture
            is_read, picture = capture.read()

    def _opened(self) -> Any:
        # Errors of this package replace the warnings of OpenCV.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        return cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)


# --- the reference grid -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Registration:
    """Map from pixels of a video to the reference grid: `grid = scale * pixel + offset` on each axis.

    Coordinates start at the corner of a picture, so the centre of its first pixel is at 0.5.

    Attributes:
        scale_x: Horizontal pixels of the grid for each pixel of the video.
        scale_y: Vertical pixels of the grid for each pixel of the video.
        offset_x_px: Place of the left edge of the video on the grid [px].
        offset_y_px: Place of the top edge of the video on the grid [px].
        method: `stretch` scales width and height independently; `crop` and `pad` scale both by one factor, about the
            centre.
        support: Share of the outline that agrees, 1.
        problem: Why the registration is doubtful; empty if it is not.
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

    def applied(self, picture: Picture) -> Picture:
        """Return a picture of the video on the reference grid; its edge pixels fill the area outside it."""
        # Integer coordinates of OpenCV are centres of pixels.
        offset_px = self.offset_px + 0.5 * self.scale - 0.5
        matrix = np.column_stack([np.diag(self.scale), offset_px])
        return np.asarray(
            cv2.warpAffine(
                picture, matrix, REFERENCE_SIZE_PX, borderMode=cv2.BORDER_REPLICATE
            )
        )


def laid_out(size_px: tuple[int, int], method: str = "stretch") -> Registration:
    """Return the registration of a video by a method: `stretch`, as in the paper, `crop` or `pad`.

    Args:
        size_px: Width and height of the video [px].
        method: The method.
    """
    grid_px = np.array(REFERENCE_SIZE_PX)
    scale = grid_px / size_px
    if method != "stretch":
        scale[:] = scale.min() if method == "crop" else scale.max()
    offset_px = 0.5 * (grid_px - scale * size_px)
    return Registration(
        scale_x=float(scale[0]),
        scale_y=float(scale[1]),
        offset_x_px=float(offset_px[0]),
        offset_y_px=float(offset_px[1]),
        method=method,
    )


# --- registration by the outline --------------------------------------------------------------------------------------
# Video models produce other sizes than the 832 x 480 pixels of the first frames, by different methods. With the right
# registration, edges of the picture lie on the known outline of the object.

UNSEEN = "the object is not visible at its place in the known first frame"
"""Problem of a clip without the outline in its first frame."""

CLOSE_PX, SEARCH_PX = 2, 10
"""Distance of an agreeing edge from the known outline, and search distance for the strongest edge [px]."""

MIN_SUPPORT = {
    MotionKind.SLIDE: 0.61,
    MotionKind.FALL: 0.78,
    MotionKind.TURN: 0.75,
    MotionKind.CRADLE: 0.6,
    MotionKind.PENDULUM: 0.78,
}
"""Smallest support of an agreeing registration. Published clips have at least 0.64, 0.90, 0.86, 0.63 and 0.88. Random
places and scales in these clips have at most 0.62, 0.68, 0.52, 0.52 and 0.65 (95 %)."""

CLEAR = 0.04
"""Smallest difference of the supports of two registrations if one is clearly better."""

MIN_VISIBLE_SHARE = 0.5
"""Smallest visible share of the outline in a crop."""


def registration_by_outline(picture: Picture, task: VideoTask) -> Registration:
    """Return the registration of a first frame from the known outline of the task's object.

    Args:
        picture: First frame of the video in its size, shape [height, width, 3].
        task: The task.
    """
    size_px = (picture.shape[1], picture.shape[0])
    outline = _outline(task)
    candidates = []
    for method in ("stretch", "crop", "pad"):
        layout = laid_out(size_px, method)
        support = _support(layout, picture, outline)
        candidates.append(replace(layout, support=support))
    best = max(layout.support for layout in candidates)
    if best < MIN_SUPPORT[task.motion]:
        return replace(candidates[0], problem=UNSEEN)
    # The paper scales width and height independently: another method must be clearly better.
    return next(layout for layout in candidates if best - layout.support < CLEAR)


def _support(registration: Registration, picture: Picture, outline: BoolArray) -> float:
    """Return the mean strength of edges on the outline, relative to the strongest edges near it."""
    points = np.argwhere(outline)[:, ::-1] + 0.5
    pixels = (points - registration.offset_px) / registration.scale
    is_seen = ((pixels > 0.0) & (pixels < picture.shape[1::-1])).all(axis=1)
    if is_seen.mean() < MIN_VISIBLE_SHARE:
        return 0.0
    light = cv2.GaussianBlur(registration.applied(picture), (0, 0), 1.0).max(axis=2)
    edges = cv2.morphologyEx(light, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    close, near = (
        cv2.dilate(edges, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
        for side in (2 * CLOSE_PX + 1, 2 * SEARCH_PX + 1)
    )
    shares = close[outline] / np.maximum(near[outline], 1.0)
    return float(shares[is_seen].mean())


def _outline(task: VideoTask) -> BoolArray:
    """Return the pixels of the grid on the known outlines of a task, shape [480, 832]."""
    drawn = np.zeros(REFERENCE_SIZE_PX[::-1], np.uint8)
    size_px = task.size_px
    if task.motion is MotionKind.SLIDE:
        box = (task.centre_px, (size_px, size_px), task.angle_deg)
        corners = np.rint(cv2.boxPoints(box)).astype(int)
        cv2.polylines(drawn, [corners], True, 1)
        return drawn > 0
    circles = [(*task.centre_px, 0.5 * size_px)]
    if task.motion is MotionKind.TURN and task.pivot_px is not None:
        circles = [(*task.pivot_px, PLATE_RADIUS_PX)]
    if task.rest_px is not None:
        # The hanging balls of the cradle touch each other.
        x, y = task.rest_px
        circles += [(x - ball * size_px, y, 0.5 * size_px) for ball in range(4)]
    for x, y, radius in circles:
        cv2.circle(drawn, (round(x), round(y)), round(radius), 1)
    return drawn > 0
