"""Detect an object with known outline and colour on a known background, in the frames of a video.

The first frame of each task is known, so no learned model and no text prompt are needed.
"""

import math
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.tools.video.frames import Gray, Picture, cv2
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX, MotionKind, VideoTask

COARSE = 0.25
"""Scale for searching and comparing whole pictures."""

BLACK_LEVEL = 16.0
"""Largest brightness of black bars at the sides of a picture."""

TINT, TINT_RANGE = 10.0, 20.0
"""Accepted tint difference of the object, and extra difference that reduces the likeness to 1/e."""


class Detection(NamedTuple):
    """Possible place of the object in one frame.

    Attributes:
        place_px: Horizontal and vertical position [px], shape [2]; NaN if not visible.
        likeness: Likeness of shape and colour to the object in the first frame, from 0 to 1.
        misfit: Difference from size and shape in the first frame, relative to the area.
    """

    place_px: FloatArray
    likeness: float
    misfit: float = 0.0


LOST = Detection(np.full(2, np.nan), 0.0)
"""Detection of a frame without the object."""


def shrunk(picture: NDArray[Any]) -> Gray:
    """Return a picture at the scale `COARSE`."""
    small = cv2.resize(
        picture, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, dtype=np.float32)


def aligned(
    template: Gray,
    window: Gray,
    motion: int,
    known: Gray | None = None,
) -> tuple[float, FloatArray]:
    """Return the largest correlation of a template with a larger window (Evangelidis and Psarakis, 2008).

    Args:
        template: The template, shape [side, side].
        window: The window, with an equal margin on each side of the template.
        motion: `cv2.MOTION_TRANSLATION` or `cv2.MOTION_EUCLIDEAN`.
        known: Relevant pixels of the window; None for all pixels.

    Returns:
        The correlation, 0 if the search does not converge, and the matrix from the template to the window, shape
        [2, 3].
    """
    warp = np.eye(2, 3, dtype=np.float32)
    warp[:, 2] = (len(window) - len(template)) // 2
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-4)
    mask = None if known is None else known.astype(np.uint8)
    correlation = 0.0
    # The search does not converge if the window shows something else.
    with suppress(cv2.error):
        correlation, warp = cv2.findTransformECC(
            template, window, warp, motion, stop, mask, 5
        )
    return correlation, np.asarray(warp, dtype=np.float64)


def colour_at(
    picture: NDArray[Any], place_px: FloatArray, size_px: float
) -> FloatArray:
    """Return the mean colour at the centre of an object, shape [3]."""
    side = 2 * int(0.25 * size_px) + 1
    middle = cv2.getRectSubPix(picture, (side, side), place_px.tolist())
    return np.asarray(middle.mean(axis=(0, 1)))


def tint_of(colour: FloatArray, known: FloatArray) -> float:
    """Return the largest difference of a channel from a known colour at any brightness, in levels of 255."""
    gain = np.clip(colour @ known / max(float(known @ known), 1.0), 0.5, 2.0)
    return float(np.abs(colour - gain * known).max())


def likeness_of(tint: float) -> float:
    """Return the likeness of a colour with a tint difference, from 0 to 1."""
    return math.exp(-max(0.0, tint - TINT) / TINT_RANGE)


def rotation_of(angle_rad: float) -> FloatArray:
    """Return the matrix of a rotation, shape [2, 2]."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def turned_square(picture: Gray, pose: FloatArray, half: int) -> Gray:
    """Return a rotated square around a place, shape [2 half + 1, 2 half + 1].

    Args:
        picture: The picture.
        pose: Angle [rad] and place [px], shape [3].
        half: Half side of the square [px].
    """
    matrix = np.column_stack([rotation_of(pose[0]), pose[1:]])
    matrix[:, 2] -= matrix[:, :2] @ [half, half]
    size = (2 * half + 1, 2 * half + 1)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    edge = cv2.BORDER_REPLICATE
    return np.asarray(
        cv2.warpAffine(picture, matrix, size, flags=flags, borderMode=edge)
    )


# --- outlines --------------------------------------------------------------------------------------------------------

REFINEMENT_PX = 8
"""Search distance around a place from the coarse scale [px]."""

MIN_CONTRAST = 40.0
"""Smallest distance of the colours of background and object at which a pixel shows its origin."""

NOISE_SHARE = 0.15
"""Covered share of the background by noise and texture."""

MAX_CANDIDATES = 6
"""Maximum number of possible places of the object in a frame."""

MIN_RESPONSE = 0.4
"""Smallest difference between the covered shares inside and around the outline of an object."""

GAP, AROUND = 1.12, 1.5
"""Inner and outer outline of the surroundings, in sizes of the object."""

MIN_KNOWN_SHARE = 0.25
"""Smallest share of the outline on a background of another colour."""

LINE, NEAR_LINE, MIN_KNOWN_LINE = 1.5, 0.75, 0.9
"""Lines along the motion that measure size and shape: half length, half length at the object, and known share.

Lengths are in sizes. The known share is the smallest share of the part at the object on a background of another colour.
"""

CORE = 0.3
"""Half width of the lines across the motion that show a cube without its shadow, in sizes."""

HIDDEN = 1.1
"""Half side of the part of the first frame that an object and its shadow may hide, in sizes."""

CHANGED_LEVELS = 30
"""Smallest difference of a colour after an object leaves its first place."""


class ShapeDetector:
    """Detect the place where an object with known outline and colour covers a known background.

    A pixel between the colours of background and object is partly covered, so motion blur keeps the centre. Pixels with
    equal colours of background and object are ignored. Colour and outline always come from the first frame.

    Args:
        first: The first frame.
        last: The last frame; it shows the background behind the object in the first frame.
        task: The task; a cube on a slope keeps its direction.
    """

    def __init__(self, first: Picture, last: Picture, task: VideoTask) -> None:
        self._task, self._size_px = task, task.size_px
        self._start_px = np.array(task.rest_px or task.centre_px)
        self._direction = np.array(task.direction or (0.0, 0.0))
        self._added_share = 0.0
        self._colour = colour_at(first, self._start_px, task.size_px)
        is_cradle = task.motion is MotionKind.CRADLE
        background = first if is_cradle else _background(first, last, task)
        self._background = background.astype(np.float32)
        # Black bars and edges of the picture hide parts of the object, and so shift its visible centre.
        is_bright = first.max(axis=2) > BLACK_LEVEL
        *low_px, width, height = cv2.boundingRect(is_bright.astype(np.uint8))
        self._low_px = np.array(low_px)
        self._high_px = self._low_px + np.array([width, height]) - 1
        contrast = self._background - self._colour.astype(np.float32)
        square = (contrast**2).sum(axis=2)
        self._known = (square > MIN_CONTRAST**2).astype(np.float32)
        self._slope = contrast / np.maximum(square, 1.0)[..., None]
        self._outline = _filled(task, 1.0)
        self._around = np.maximum(_filled(task, AROUND) - _filled(task, GAP), 0.0)
        middle_px = np.full(2, len(self._outline) // 2)
        self._profile_px = self._lines(self._outline, middle_px).sum(axis=1)
        if not is_cradle:
            self._take_first(self._covered(first))

    def _take_first(self, covered: Gray) -> None:
        """Store outline and width of the object from the first frame, which also shows its sides."""
        first, known = self._cuts(covered, self._start_px, len(self._outline))
        self._outline = np.where(known > 0.5, first, self._outline)
        self._around = np.maximum(self._around - self._outline, 0.0)
        profile_px, is_known = self._profile(covered, self._start_px)
        self._profile_px[is_known] = profile_px[is_known]
        if self._task.motion is MotionKind.SLIDE:
            # A pinhole camera shows the side of a cube with a width proportional to the distance from the centre of the
            # picture. So the centre of face and side moves less than the face.
            middle_px = 0.5 * np.array(REFERENCE_SIZE_PX) - self._start_px
            half, core = len(profile_px) // 2, int(CORE * self._size_px)
            wide_px = float(self._profile_px[half - core : half + core + 1].mean())
            side_px = max(wide_px - self._size_px, 0.0)
            self._added_share = 0.5 * side_px / abs(middle_px @ self._direction)

    def candidates(self, picture: Picture) -> list[Detection]:
        """Return the detections of a frame that may be the object."""
        covered = self._covered(picture)
        response = _response(
            shrunk(covered),
            shrunk(self._known),
            shrunk(self._outline),
            shrunk(self._around),
        )
        side = 2 * int(0.25 * self._size_px * COARSE) + 3
        highest = cv2.dilate(response, np.ones((side, side), np.uint8))
        is_peak = (response >= highest) & (response > MIN_RESPONSE)
        corners = np.argwhere(is_peak)[:, ::-1]
        values = response[is_peak]
        half = 0.5 * round(COARSE * len(self._outline))
        return [
            self._detection(picture, covered, (corners[row] + half) / COARSE - 0.5)
            for row in np.argsort(-values)[:MAX_CANDIDATES]
        ]

    def _detection(
        self, picture: Picture, covered: Gray, coarse_px: FloatArray
    ) -> Detection:
        """Return the detection near a coarse place."""
        side = len(self._outline)
        middle_px = np.rint(coarse_px)
        window, known = self._cuts(covered, middle_px, side + 2 * REFINEMENT_PX)
        _, warp = aligned(self._outline, window, cv2.MOTION_TRANSLATION, known)
        place_px = middle_px + warp[:, 2] - REFINEMENT_PX
        cut, known = self._cuts(covered, place_px, side)
        value = float(_response(cut, known, self._outline, self._around)[0, 0])
        edge_px = np.minimum(place_px - self._low_px, self._high_px - place_px)
        if value < MIN_RESPONSE or edge_px.min() < 0.5 * self._size_px:
            return LOST
        profile_px, is_known = self._profile(covered, place_px)
        moved_px = (place_px - self._start_px) @ self._direction
        place_px = place_px + self._added_share * moved_px * self._direction
        tint = tint_of(colour_at(picture, place_px, self._size_px), self._colour)
        likeness = min(1.0, value) * likeness_of(tint)
        expected_px, seen_px = self._profile_px[is_known], profile_px[is_known]
        area_px2 = float(expected_px.sum())
        if area_px2 <= MIN_KNOWN_SHARE * self._size_px**2:
            return Detection(place_px, likeness)
        misfit = float(np.abs(seen_px - expected_px).sum()) / area_px2
        return Detection(place_px, likeness, misfit)

    def _covered(self, picture: Picture) -> Gray:
        """Return the share of each pixel that the object covers; 0 if the background has the same colour."""
        share = np.einsum("ijk,ijk->ij", self._background - picture, self._slope)
        share = (share - NOISE_SHARE) / (1.0 - 2.0 * NOISE_SHARE)
        return np.clip(share, 0.0, 1.0) * self._known

    def _cuts(
        self,
        covered: Gray,
        place_px: FloatArray,
        side: int,
    ) -> tuple[Gray, Gray]:
        """Return squares around a place: covered share, and whether it is known."""
        size, place = (side, side), place_px.tolist()
        return (
            cv2.getRectSubPix(covered, size, place),
            cv2.getRectSubPix(self._known, size, place),
        )

    def _profile(
        self, covered: Gray, place_px: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return the covered length of each line along the motion [px], and whether its background is known.

        The exposure blurs an object only along its motion, so the covered length of a line stays constant.
        """
        lines = self._lines(self._known, place_px)
        half, near = len(lines) // 2, int(NEAR_LINE * self._size_px)
        is_known = lines[:, half - near : half + near + 1].mean(axis=1) > MIN_KNOWN_LINE
        return self._lines(covered, place_px).sum(axis=1), is_known

    def _lines(self, picture: Gray, place_px: FloatArray) -> Gray:
        """Return a square around a place, with rows along the motion."""
        x, y = self._direction
        if self._task.pivot_px is not None:
            y, x = (place_px - self._task.pivot_px) * [-1.0, 1.0]
        pose = np.array([math.atan2(y, x), *place_px])
        return turned_square(picture, pose, int(LINE * self._size_px))


def _filled(task: VideoTask, share: float) -> Gray:
    """Return the filled outline of the object in a square, scaled by a share of the size, with a soft edge."""
    half_px = math.ceil(0.5 * AROUND * task.size_px) + 2
    size_px = share * task.size_px
    filled = np.zeros((2 * half_px + 1, 2 * half_px + 1), np.float32)
    # OpenCV counts sixteenths of pixels.
    if task.motion is MotionKind.SLIDE:
        box = ((half_px, half_px), (size_px, size_px), task.angle_deg)
        corners = np.rint(16.0 * cv2.boxPoints(box)).astype(np.int32)
        cv2.fillPoly(filled, [corners], 1.0, cv2.LINE_8, 4)
    else:
        middle = (16 * half_px, 16 * half_px)
        cv2.circle(filled, middle, round(8.0 * size_px), 1.0, -1, cv2.LINE_8, 4)
    return np.asarray(cv2.GaussianBlur(filled, (0, 0), 1.0))


def _response(
    covered: Gray,
    known: Gray,
    outline: Gray,
    around: Gray,
) -> Gray:
    """Return the covered share inside the outline minus the share around it, at each place."""
    shares, wholes = [], []
    for mask in (outline, around):
        wholes.append(cv2.matchTemplate(known, mask, cv2.TM_CCORR))
        share = cv2.matchTemplate(covered, mask, cv2.TM_CCORR)
        shares.append(share / np.maximum(wholes[-1], 1.0))
    is_known = wholes[0] >= MIN_KNOWN_SHARE * outline.sum()
    return np.where(is_known, shares[0] - shares[1], -1.0)


def _background(first: Picture, last: Picture, task: VideoTask) -> Picture:
    """Return the first frame without the object.

    The hidden part comes from the first or the last frame, pixel by pixel from the frame that differs more from the
    object. If both frames show the object, the surroundings are inpainted.
    """
    start_px, size_px = np.array(task.centre_px), task.size_px
    low, high = (start_px + HIDDEN * size_px * np.array([[-1.0], [1.0]])).astype(int)
    left, top = np.maximum(low, 0)
    hidden = np.s_[top : high[1], left : high[0]]
    colour, later = (colour_at(frame, start_px, size_px) for frame in (first, last))
    if np.abs(colour - later).max() > CHANGED_LEVELS:
        background = first.copy()
        before, after = (
            np.linalg.norm(frame[hidden] - colour, axis=2) for frame in (first, last)
        )
        is_before = (before > after)[..., None]
        background[hidden] = np.where(is_before, first[hidden], last[hidden])
        return background
    mask = np.zeros(first.shape[:2], np.uint8)
    mask[hidden] = 255
    return np.asarray(cv2.inpaint(first, mask, 3, cv2.INPAINT_TELEA))
