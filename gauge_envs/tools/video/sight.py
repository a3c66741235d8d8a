"""Where an object may be in one frame, and what tells it from its background: colours, covered areas and correlation.

No learned model is used, so a text prompt is not needed: the first frame of each task is known.
"""

import math
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2

COARSE = 0.25
"""Scale at which the whole picture is searched."""

LEAST_CONTRAST = 40.0
"""Distance of the colours of background and object from which a pixel says which of both it shows."""

NOISE_SHARE = 0.15
"""Covered share that noise and texture leave to the bare background."""

TINT, TINT_RANGE = 10.0, 20.0
"""Difference of a colour, at any brightness, that is still the object's, and that at which likeness falls to 1/e."""


@dataclass(kw_only=True)
class Sight:
    """Where the object may be in one frame.

    Attributes:
        place: Horizontal and vertical position [px], shape [2]; NaN when not found.
        likeness: Likeness of shape and colour to the object in the first frame, from 0 to 1.
        size_ratio: Apparent size against that in the first frame.
        misfit: Difference of its profile across the motion from that of its outline, in parts of the area.
        tint: Difference of its colour from the object's in the first frame at any brightness, in levels of 255.
    """

    place: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
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


def matched(
    template: NDArray[np.floating],
    window: NDArray[np.float32],
    margin: int,
    motion: int,
    known: NDArray[np.float32] | None = None,
) -> tuple[float, NDArray[np.float32]]:
    """Return the correlation of a template with a part of a window, and where it is largest (Evangelidis and Psarakis).

    Args:
        template: The template, shape [side, side].
        window: Picture around it that is wider by a margin on each side.
        margin: The margin [px].
        motion: `cv2.MOTION_TRANSLATION` or `cv2.MOTION_EUCLIDEAN`.
        known: Pixels of the window that say something; all if None.

    Returns:
        The correlation, 0 where none is found, and the matrix from the template to the window, shape [2, 3].
    """
    warp = np.eye(2, 3, dtype=np.float32)
    warp[:, 2] = margin
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-4)
    mask = None if known is None else known.astype(np.uint8)
    small = template.astype(np.float32)
    try:
        return cv2.findTransformECC(small, window, warp, motion, stop, mask, 5)
    except cv2.error:
        # It does not converge: the window shows something else.
        return 0.0, warp


def covered_share(
    picture: NDArray[Any], bare: NDArray[np.float32], colour: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return which share of each pixel is covered by an object of a colour, and whether the pixel says so."""
    span = bare - colour
    length = np.sqrt((span * span).sum(axis=2))
    change = bare - picture
    covered = (change * span).sum(axis=2) / np.maximum(length**2, 1.0)
    covered = np.clip((covered - NOISE_SHARE) / (1.0 - 2.0 * NOISE_SHARE), 0.0, 1.0)
    return covered.astype(np.float32), (length > LEAST_CONTRAST).astype(np.float32)


Areas: TypeAlias = tuple[NDArray[np.int32], NDArray[np.int32], FloatArray]
"""Labels of connected areas in a small picture, their sizes and their middles."""


def areas_of(covered: NDArray[np.float32]) -> Areas:
    """Return the connected areas of a small picture that are covered, without what is thin."""
    whole = (covered > 0.5).astype(np.uint8)
    whole = cv2.morphologyEx(whole, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, stats, middles = cv2.connectedComponentsWithStats(whole)
    return labels, stats[:, cv2.CC_STAT_AREA], middles


def area_at(areas: Areas, place: FloatArray) -> tuple[float, float, FloatArray]:
    """Return the largest covered area that a place of the whole picture is in or beside.

    Returns:
        Its size, 0 where there is none; the ratio of its axes; and its middle, from the place [px].
    """
    column, row = (COARSE * place).astype(int)
    labels = np.unique(cut_around(areas[0], column, row, 2)[0])
    sizes = areas[1] * np.isin(np.arange(len(areas[1])), labels[labels > 0])
    if not sizes.any():
        return 0.0, 1.0, np.zeros(2)
    largest = sizes.argmax()
    one = cv2.moments((areas[0] == largest).astype(np.uint8), binaryImage=True)
    spreads = [[one["mu20"], one["mu11"]], [one["mu11"], one["mu02"]]]
    shorter, longer = np.linalg.eigvalsh(spreads)
    ratio = math.sqrt(longer / max(shorter, 1e-9))
    return float(sizes.max()), ratio, areas[2][largest] / COARSE - place


def look_of(picture: NDArray[Any], place: FloatArray, size_px: float) -> FloatArray:
    """Return the mean colour of the middle of an object."""
    part, _ = cut_around(picture, place[0], place[1], max(1, int(0.25 * size_px)))
    return np.asarray(part.reshape(-1, 3).mean(axis=0), dtype=float)


def tint_of(colour: FloatArray, known: FloatArray) -> float:
    """Return the largest difference of a channel from a known colour at any brightness."""
    gain = np.clip(colour @ known / max(float(known @ known), 1.0), 0.5, 2.0)
    return float(np.abs(colour - gain * known).max())


def likeness_of(tint: float) -> float:
    """Return the likeness of a colour that differs by a tint, from 0 to 1."""
    return math.exp(-max(0.0, tint - TINT) / TINT_RANGE)


def cut_around(
    picture: NDArray[Any], x: float, y: float, half: int
) -> tuple[NDArray[Any], FloatArray]:
    """Return the part of a picture around a pixel, its edges repeated, and the place of its corner."""
    left, top = round(x) - half, round(y) - half
    columns = np.clip(np.arange(left, left + 2 * half + 1), 0, picture.shape[1] - 1)
    rows = np.clip(np.arange(top, top + 2 * half + 1), 0, picture.shape[0] - 1)
    return picture[rows[:, None], columns], np.array([float(left), float(top)])


def grey_of(picture: Picture) -> NDArray[np.float32]:
    """Return the brightness of a picture."""
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.float32)


def rotation_of(angle_rad: float) -> FloatArray:
    """Return the matrix that turns a place by an angle, shape [2, 2]."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def turned_square(
    grey: NDArray[np.float32], pose: FloatArray, half: int
) -> NDArray[np.float32]:
    """Return the square around a pose that has its angle, shape [2 half + 1, 2 half + 1]."""
    matrix = np.column_stack([rotation_of(pose[0]), pose[1:]])
    matrix[:, 2] -= matrix[:, :2] @ [half, half]
    side = 2 * half + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(
            grey, matrix, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
    )
