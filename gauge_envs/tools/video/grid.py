"""Map the pictures of a video to the grid of the first frames."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import MissingExtraError
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

Picture: TypeAlias = NDArray[np.uint8]
"""A picture on the reference grid, blue, green and red, shape [480, 832, 3]."""

EXACT = 1e-9
"""Largest difference with which a registration is the plain scaling of both axes."""


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
            middle; `first frame`: freely, by the points of the given first frame.
        inliers: Points of the outline, or of the first frame, that agree.
        support: Share of the points that agree, 1.
        problem: Why the registration is doubtful; empty when it is not.
    """

    scale_x: float
    scale_y: float
    offset_x_px: float = 0.0
    offset_y_px: float = 0.0
    method: str = "stretch"
    inliers: int = 0
    support: float = 1.0
    problem: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, JSON-ready."""
        return asdict(self)

    def applied(self, picture: NDArray[np.uint8]) -> Picture:
        """Return a picture of the video on the reference grid; beyond its edges, the edge repeats.

        Args:
            picture: Picture of the video, shape [height, width, 3].
        """
        height, width = picture.shape[:2]
        plain = stretched((width, height))
        place = (self.scale_x, self.scale_y, self.offset_x_px, self.offset_y_px)
        if np.allclose(place, (plain.scale_x, plain.scale_y, 0.0, 0.0), rtol=0.0, atol=EXACT):
            return _resized(picture, REFERENCE_SIZE_PX)
        # Large pictures are averaged to the size of the grid first, as interpolation would skip pixels.
        size = (max(1, round(width * self.scale_x)), max(1, round(height * self.scale_y)))
        near = _resized(picture, size) if min(self.scale_x, self.scale_y) < 1.0 else picture
        scale = np.array([self.scale_x * width / near.shape[1], self.scale_y * height / near.shape[0]])
        offset = np.array([self.offset_x_px, self.offset_y_px]) + 0.5 * scale - 0.5
        matrix = np.column_stack([np.diag(scale), offset])
        return np.asarray(cv2.warpAffine(near, matrix, REFERENCE_SIZE_PX, borderMode=cv2.BORDER_REPLICATE))


def stretched(size_px: tuple[int, int]) -> Registration:
    """Return the plain scaling of width and height of a video, each on its own, as in the paper."""
    width, height = REFERENCE_SIZE_PX
    return Registration(scale_x=width / size_px[0], scale_y=height / size_px[1])


class _OpenCV:
    """OpenCV, which is imported when one of its names is used: it is optional, and slow to import."""

    def __getattr__(self, name: str) -> Any:
        try:
            import cv2
        except ImportError as error:
            raise MissingExtraError("OpenCV", "video", error) from error
        return getattr(cv2, name)


cv2: Any = _OpenCV()


def _resized(picture: NDArray[np.uint8], size_px: tuple[int, int]) -> Picture:
    if (picture.shape[1], picture.shape[0]) == size_px:
        return np.ascontiguousarray(picture)
    method = cv2.INTER_AREA if picture.shape[1] >= size_px[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size_px, interpolation=method))
