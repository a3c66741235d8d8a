"""Build the picture of a scene without the moving object, and see where a frame differs from it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video.grid import Picture, cv2
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX

Region: TypeAlias = tuple[int, int, int, int]
"""Left, top, right and bottom of a part of a picture [px]."""

MOST_SAMPLED = 80
"""Most frames from which the background is built; they are spread over the video."""

CHANGED = 30
"""Difference of a colour channel with which a pixel has changed since the first frame."""

LEAST_CHANGED = 2
"""Fewest sampled frames without the object from which the background behind it is known."""

ADAPTATION = 0.05
"""Share of a frame that the background takes over where nothing moves: generated scenes drift."""


class Background:
    """Background that follows slow drifts of a scene.

    Args:
        picture: Picture of the scene without the object.
    """

    def __init__(self, picture: Picture) -> None:
        self._picture = picture.astype(np.float32)

    @property
    def grey(self) -> NDArray[np.float32]:
        """Brightness of the background, shape [480, 832], 0 to 255."""
        return brightness(self._picture)

    def difference(self, picture: Picture) -> NDArray[np.float32]:
        """Return the largest difference of the three colour channels at each pixel, shape [480, 832], smoothed."""
        blue, green, red = cv2.split(cv2.absdiff(picture.astype(np.float32), self._picture))
        difference = cv2.max(cv2.max(blue, green), red)
        return np.asarray(cv2.GaussianBlur(difference, (5, 5), 0), dtype=np.float32)

    def follow(self, picture: Picture, moving: NDArray[np.bool_]) -> None:
        """Take over a share of a picture where nothing moves."""
        cv2.accumulateWeighted(picture, self._picture, ADAPTATION, mask=(~moving).astype(np.uint8))


def background(first: Picture, pictures: Iterator[Picture], frame_count: int, occupied: Region) -> Background:
    """Return the background of a video.

    The first frame shows the scene; only the object hides a part of it. That part is the median of the frames in which
    the middle of it has changed.

    Args:
        first: The first frame.
        pictures: Pictures of the video, the first one included.
        frame_count: Their number.
        occupied: Part of the first frame that the object and its shadow may hide.
    """
    left, top, right, bottom = occupied
    stride = max(1, frame_count // MOST_SAMPLED)
    sampled = islice(pictures, stride, None, stride)
    parts = [picture[top:bottom, left:right].copy() for picture in sampled]
    if len(parts) < LEAST_CHANGED:
        return Background(first)
    stack = np.stack(parts)
    hidden = first[top:bottom, left:right]
    has_changed = np.abs(stack.astype(np.int16) - hidden).max(axis=3) > CHANGED
    height, width = has_changed.shape[1:]
    core = has_changed[:, height // 3 : 2 * height // 3, width // 3 : 2 * width // 3].mean(axis=(1, 2))
    left_at = np.flatnonzero(core > 0.5)
    result = first.copy()
    if len(left_at) >= LEAST_CHANGED:
        # The object passes other pixels for a moment only, so the median after its start shows what it hid.
        result[top:bottom, left:right] = np.median(stack[left_at], axis=0).astype(np.uint8)
    else:
        # An object that never leaves hides its background; the surroundings stand in for it.
        mask = np.zeros(REFERENCE_SIZE_PX[::-1], dtype=np.uint8)
        mask[top:bottom, left:right] = 255
        result = np.asarray(cv2.inpaint(first, mask, 3, cv2.INPAINT_TELEA))
    return Background(result)


def brightness(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean of the three colour channels of a picture, shape [height, width]."""
    return np.asarray(cv2.transform(picture, np.full((1, 3), 1.0 / 3.0, dtype=np.float32)), dtype=np.float32)


def noise_level(difference: NDArray[np.float32]) -> float:
    """Return the standard deviation of the noise of a difference, from its median: most pixels do not move."""
    return float(np.median(difference)) / 0.6745
