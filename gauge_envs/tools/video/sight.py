"""Measures that compare an object in a frame with the first frame: colour, correlation and rotated cuts.

No learned model is used, so a text prompt is not needed: the first frame of each task is known.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import cv2

COARSE = 0.25
"""Scale at which the whole picture is searched and compared."""

BLACK_LEVEL = 16.0
"""Largest brightness of black bars beside the picture, which a model may fill."""

TINT, TINT_RANGE = 10.0, 20.0
"""Difference of a colour, at any brightness, that is still the object's, and that at which likeness falls to 1/e."""


@dataclass(kw_only=True)
class Detection:
    """Where the object may be in one frame.

    Attributes:
        place_px: Horizontal and vertical position [px], shape [2]; NaN when not found.
        likeness: Likeness of shape and colour to the object in the first frame, from 0 to 1.
        size_ratio: Apparent size relative to that in the first frame.
        misfit: Difference from the shape in the first frame, in parts of the area.
        tint: Difference from the colour in the first frame at any brightness, in levels of 255.
    """

    place_px: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    likeness: float = 0.0
    size_ratio: float = math.nan
    misfit: float = 0.0
    tint: float = 0.0


def shrunk(picture: NDArray[Any]) -> NDArray[np.float32]:
    """Return a picture at the scale at which it is searched and compared."""
    small = cv2.resize(
        picture, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, dtype=np.float32)


def aligned(
    template: NDArray[np.float32],
    window: NDArray[np.float32],
    motion: int,
    known: NDArray[np.float32] | None = None,
) -> tuple[float, NDArray[np.float32]]:
    """Return the largest correlation of a template with a wider window (Evangelidis and Psarakis, 2008).

    Args:
        template: The template, shape [side, side].
        window: The window, with an equal margin on each side of the template.
        motion: `cv2.MOTION_TRANSLATION` or `cv2.MOTION_EUCLIDEAN`.
        known: Pixels of the window that count; None for all.

    Returns:
        The correlation, 0 where the search does not converge, and the matrix from the template to the window, shape
        [2, 3].
    """
    warp = np.eye(2, 3, dtype=np.float32)
    warp[:, 2] = (len(window) - len(template)) // 2
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-4)
    mask = None if known is None else known.astype(np.uint8)
    try:
        return cv2.findTransformECC(template, window, warp, motion, stop, mask, 5)
    except cv2.error:
        # It does not converge: the window shows something else.
        return 0.0, warp


def colour_at(
    picture: NDArray[Any], place_px: FloatArray, size_px: float
) -> FloatArray:
    """Return the mean colour of the middle of an object, shape [3]."""
    side = 2 * int(0.25 * size_px) + 1
    middle = cv2.getRectSubPix(picture, (side, side), place_px.tolist())
    return np.asarray(middle.mean(axis=(0, 1)))


def tint_of(colour: FloatArray, known: FloatArray) -> float:
    """Return the largest difference of a channel from a known colour at any brightness, in levels of 255."""
    gain = np.clip(colour @ known / max(float(known @ known), 1.0), 0.5, 2.0)
    return float(np.abs(colour - gain * known).max())


def likeness_of(tint: float) -> float:
    """Return the likeness of a colour that differs by a tint, from 0 to 1."""
    return math.exp(-max(0.0, tint - TINT) / TINT_RANGE)


def rotation_of(angle_rad: float) -> FloatArray:
    """Return the matrix of a rotation, shape [2, 2]."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def turned_square(
    picture: NDArray[np.float32], pose: FloatArray, half: int
) -> NDArray[np.float32]:
    """Return the square around a place that is rotated by an angle, shape [2 half + 1, 2 half + 1].

    Args:
        picture: The picture.
        pose: Angle [rad] and place [px], shape [3].
        half: Half of the side of the square [px].
    """
    matrix = np.column_stack([rotation_of(pose[0]), pose[1:]])
    matrix[:, 2] -= matrix[:, :2] @ [half, half]
    size = (2 * half + 1, 2 * half + 1)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    edge = cv2.BORDER_REPLICATE
    return np.asarray(
        cv2.warpAffine(picture, matrix, size, flags=flags, borderMode=edge)
    )
