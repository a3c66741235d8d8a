"""Follow an object through a video: a moving patch before a still background, a dark disk, or a turning face.

Each follower returns where the object is in each frame, how sure that is, and what happened to it. None uses a learned
model, so a text prompt is not needed: the first frame of each task is known.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2
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


# --- followers --------------------------------------------------------------------------------------------------------


LEAST_DIFFERENCE = 14.0
"""Smallest difference from the background that counts as an object, in grey values of 255."""

NOISE_FACTOR = 5.0
"""That difference in standard deviations of the noise, where the noise is larger."""

LEAST_AREA, MOST_AREA = 0.35, 4.0
"""Range of the area of a patch, against that of the object, in which it can be the object."""

CUT = 0.95
"""Share of its usual area below which a patch at the border of the picture is a part of the object."""

GATE = 1.6
"""Distance from the predicted place in which the object is looked for, in its sizes."""

LOST_GROWTH = 0.5
"""Growth of that distance for each frame in which the object was not found, in its sizes."""


@dataclass(kw_only=True)
class Sight:
    """What was seen of the object in one frame.

    Attributes:
        x_px: Horizontal position [px]; NaN when not found.
        y_px: Vertical position [px]; NaN when not found.
        confidence: Confidence from 0 to 1.
        size_ratio: Apparent size against that in the first frame.
        twins: Other patches of the same size and colour in the picture.
    """

    x_px: float = math.nan
    y_px: float = math.nan
    confidence: float = 0.0
    size_ratio: float = math.nan
    twins: int = 0


@dataclass(kw_only=True)
class _Motion:
    """Last place and velocity of an object, which predict where it is looked for."""

    place: FloatArray
    velocity: FloatArray = field(default_factory=lambda: np.zeros(2))
    lost_count: int = 0

    def predicted(self) -> FloatArray:
        return self.place + self.velocity * (self.lost_count + 1)

    def update(self, place: FloatArray | None) -> None:
        if place is None:
            self.lost_count += 1
            return
        self.velocity = (place - self.place) / (self.lost_count + 1)
        self.place = place
        self.lost_count = 0


class PatchFollower:
    """Follows an object that differs from a still background.

    Args:
        background: Background of the video.
        centre_px: Centre of the object in the first frame [px], shape [2].
        size_px: Width of the object [px].
        area_px: Area of the object [px^2].
    """

    def __init__(self, background: Background, *, centre_px: FloatArray, size_px: float, area_px: float) -> None:
        self._background = background
        self._size_px = size_px
        self._area_px = area_px
        self._motion = _Motion(place=centre_px.astype(float))
        self._colour: FloatArray | None = None
        self._areas: list[float] = []

    def see(self, picture: Picture) -> Sight:
        """Return where the object is in the next frame."""
        difference = self._background.difference(picture)
        # Most pixels do not move, so the median gives the standard deviation of the noise.
        threshold = max(LEAST_DIFFERENCE, NOISE_FACTOR * float(np.median(difference)) / 0.6745)
        mask = (difference > threshold).astype(np.uint8)
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
        count, labels, stats, centroids = cv2.connectedComponentsWithStats(mask, connectivity=8)
        ratios = stats[1:, cv2.CC_STAT_AREA] / self._area_px
        possible = [i + 1 for i in range(count - 1) if LEAST_AREA <= ratios[i] <= MOST_AREA]
        predicted = self._motion.predicted()
        gate = self._size_px * (GATE + LOST_GROWTH * self._motion.lost_count)
        gate += 0.5 * float(np.linalg.norm(self._motion.velocity))
        scored = []
        for label in possible:
            distance = float(np.linalg.norm(centroids[label] - predicted))
            colour = _mean_colour(picture, labels, stats[label], label)
            likeness = 1.0 if self._colour is None else math.exp(-float(np.abs(colour - self._colour).max()) / 60.0)
            shape = math.exp(-abs(math.log(ratios[label - 1])))
            scored.append((shape * likeness * math.exp(-0.5 * (distance / gate) ** 2), distance, label, colour))
        near = [one for one in scored if one[1] <= gate]
        moving = cv2.dilate(mask, np.ones((15, 15), np.uint8)).astype(bool)
        self._background.follow(picture, moving)
        if not near:
            self._motion.update(None)
            return Sight()
        score, _, label, colour = max(near, key=lambda one: one[0])
        if self._is_cut(stats[label], mask.shape):
            # The centre of the part that is left is not that of the object.
            self._motion.update(None)
            return Sight()
        weights = np.where(labels == label, difference, 0.0)
        ys, xs = np.nonzero(weights)
        place = np.array([np.average(xs), np.average(ys)])
        self._motion.update(place)
        self._colour = colour if self._colour is None else 0.9 * self._colour + 0.1 * colour
        area = float(stats[label, cv2.CC_STAT_AREA])
        self._areas.append(area)
        twins = sum(
            1
            for other in scored
            if other[2] != label
            and 0.6 < ratios[other[2] - 1] * self._area_px / area < 1.6
            and float(np.abs(other[3] - colour).max()) < 25.0
        )
        return Sight(
            x_px=float(place[0]),
            y_px=float(place[1]),
            confidence=min(1.0, score**0.5),
            size_ratio=math.sqrt(area / self._area_px),
            twins=twins,
        )

    def _is_cut(self, box: NDArray[np.int32], shape: tuple[int, ...]) -> bool:
        """Return whether a patch at the border of the picture is smaller than the object was."""
        left, top, width, height, area = (int(value) for value in box)
        at_border = left == 0 or top == 0 or left + width == shape[1] or top + height == shape[0]
        return at_border and bool(self._areas) and area < CUT * float(np.median(self._areas))


def _mean_colour(picture: Picture, labels: NDArray[np.int32], box: NDArray[np.int32], label: int) -> FloatArray:
    """Return the mean colour of a component, from its bounding box: left, top, width, height, area."""
    left, top, width, height = (int(value) for value in box[:4])
    part = np.s_[top : top + height, left : left + width]
    return picture[part][labels[part] == label].mean(axis=0)


class DiskFollower:
    """Follows a dark disk before a light background; where the background is dark, the picture says nothing.

    Args:
        background: Background of the video.
        diameter_px: Diameter of the disk [px].
        centre_px: Centre of the disk in the first frame [px], shape [2].
        pivot_px: Point about which it swings [px], shape [2].
        reach_px: Smallest and largest distance from the pivot at which it is looked for [px].
        sector_rad: Smallest and largest angle from the vertical at which it is looked for [rad].
    """

    LIGHT = 45.0
    """Brightness above that of the disk from which a background is light."""

    LEAST_RESPONSE = 0.45
    """Smallest difference of the dark share in the disk and around it that is a disk."""

    LEAST_LIGHT_SHARE = 0.25
    """Smallest share of the disk before a light background."""

    def __init__(
        self,
        background: Background,
        *,
        diameter_px: float,
        centre_px: FloatArray,
        pivot_px: FloatArray,
        reach_px: tuple[float, float],
        sector_rad: tuple[float, float] = (-math.pi, math.pi),
    ) -> None:
        self._background = background
        self._motion = _Motion(place=centre_px.astype(float))
        radius = 0.5 * diameter_px
        half = math.ceil(1.6 * radius)
        y, x = np.mgrid[-half : half + 1, -half : half + 1]
        distance = np.hypot(x, y)
        self._disk = (distance <= radius).astype(np.float32)
        self._ring = ((distance > 1.12 * radius) & (distance <= 1.5 * radius)).astype(np.float32)
        height, width = background.grey.shape
        rows, columns = np.mgrid[0:height, 0:width]
        away = np.hypot(columns - pivot_px[0], rows - pivot_px[1])
        angle = np.arctan2(columns - pivot_px[0], rows - pivot_px[1])
        in_sector = (angle >= sector_rad[0]) & (angle <= sector_rad[1])
        allowed = (away >= reach_px[0]) & (away <= reach_px[1]) & in_sector
        # Only the part of the picture that the disk can cover is filtered.
        seen_rows, seen_columns = np.flatnonzero(allowed.any(axis=1)), np.flatnonzero(allowed.any(axis=0))
        top, bottom = max(0, seen_rows[0] - half), min(height, seen_rows[-1] + half + 1)
        left, right = max(0, seen_columns[0] - half), min(width, seen_columns[-1] + half + 1)
        self._part = np.s_[top:bottom, left:right]
        self._corner = np.array([float(left), float(top)])
        self._allowed = allowed[self._part]
        self._dark = 25.0

    def see(self, picture: Picture) -> Sight:
        """Return where the disk is in the next frame."""
        light_grey = np.ascontiguousarray(self._background.grey[self._part])
        grey = brightness(picture[self._part].astype(np.float32))
        valid = (light_grey > self._dark + self.LIGHT).astype(np.float32)
        darkness = np.clip((light_grey - grey) / np.maximum(light_grey - self._dark, 1.0), 0.0, 1.0) * valid
        inside_valid = cv2.filter2D(valid, -1, self._disk, borderType=cv2.BORDER_CONSTANT)
        around_valid = cv2.filter2D(valid, -1, self._ring, borderType=cv2.BORDER_CONSTANT)
        inside = cv2.filter2D(darkness, -1, self._disk, borderType=cv2.BORDER_CONSTANT) / np.maximum(inside_valid, 1.0)
        around = cv2.filter2D(darkness, -1, self._ring, borderType=cv2.BORDER_CONSTANT) / np.maximum(around_valid, 1.0)
        seen = inside_valid >= self.LEAST_LIGHT_SHARE * float(self._disk.sum())
        response = np.where(self._allowed & seen, inside - around, -1.0).astype(np.float32)
        best = float(response.max())
        moving = np.ones(picture.shape[:2], dtype=bool)
        moving[self._part] = cv2.dilate((darkness > 0.3).astype(np.uint8), np.ones((15, 15), np.uint8)).astype(bool)
        self._background.follow(picture, moving)
        if best < self.LEAST_RESPONSE:
            self._motion.update(None)
            return Sight()
        # Of several equal peaks, the one nearest to the predicted place is the object.
        rows, columns = np.nonzero(response > best - 0.12)
        predicted = self._motion.predicted() - self._corner
        distances = np.hypot(columns - predicted[0], rows - predicted[1])
        reach = 3.0 * self._disk.shape[0] * (1 + self._motion.lost_count)
        value = response[rows, columns] - 0.25 * np.minimum(distances / reach, 1.0)
        pick = int(value.argmax())
        place = _refined(response, int(rows[pick]), int(columns[pick])) + self._corner
        self._motion.update(place)
        return Sight(
            x_px=float(place[0]),
            y_px=float(place[1]),
            confidence=float(min(1.0, max(0.0, response[rows[pick], columns[pick]]))),
            size_ratio=1.0,
        )


class FaceFollower:
    """Follows a face that moves and turns, by its texture and its edge.

    Args:
        picture: The first frame.
        centre_px: Centre of the face in it [px], shape [2].
        size_px: Edge of the face [px].
    """

    TURNS_DEG = (-12.0, -8.0, -4.0, -2.0, 0.0, 2.0, 4.0, 8.0, 12.0)
    """Rotations from frame to frame that are tried [degrees]."""

    LEAST_CORRELATION = 0.35
    """Smallest normalized correlation with the face that is found."""

    RENEWAL = 0.15
    """Share of the sight of each frame that the remembered face takes over."""

    def __init__(self, picture: Picture, *, centre_px: FloatArray, size_px: float) -> None:
        self._half = math.ceil(0.64 * size_px)
        self._size_px = size_px
        self._motion = _Motion(place=centre_px.astype(float))
        self._angle_deg = 0.0
        self._face = self._cut(picture, self._motion.place, 0.0)

    def see(self, picture: Picture) -> Sight:
        """Return where the face is in the next frame."""
        predicted = self._motion.predicted()
        reach = int(self._size_px * (0.35 + 0.35 * min(self._motion.lost_count, 6)))
        reach += int(np.linalg.norm(self._motion.velocity))
        side = self._half + reach
        window = _window(picture, predicted, side)
        best: tuple[float, float, FloatArray] = (-1.0, 0.0, predicted)
        turns = self.TURNS_DEG if self._motion.lost_count < 3 else tuple(np.arange(-45.0, 45.0, 6.0))
        for turn in turns:
            face, mask = self._turned(self._angle_deg + turn)
            response = np.nan_to_num(_centred_correlation(window, face, mask), nan=-1.0, posinf=-1.0, neginf=-1.0)
            row, column = np.unravel_index(int(response.argmax()), response.shape)
            value = float(response[row, column])
            if value > best[0]:
                place = _refined(response, int(row), int(column)) + predicted - side + self._half
                best = (value, turn, place)
        value, turn, place = best
        if value < self.LEAST_CORRELATION:
            self._motion.update(None)
            return Sight(confidence=0.0)
        self._angle_deg += turn
        self._motion.update(place)
        seen = self._cut(picture, place, self._angle_deg)
        self._face = (1.0 - self.RENEWAL) * self._face + self.RENEWAL * seen
        return Sight(x_px=float(place[0]), y_px=float(place[1]), confidence=max(0.0, value), size_ratio=1.0)

    def _cut(self, picture: Picture, place: FloatArray, angle_deg: float) -> NDArray[np.float32]:
        """Return the surroundings of a place, turned back by an angle."""
        matrix = cv2.getRotationMatrix2D((float(place[0]), float(place[1])), angle_deg, 1.0)
        matrix[:, 2] += self._half - place
        side = 2 * self._half + 1
        cut = cv2.warpAffine(
            picture.astype(np.float32), matrix, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(cut, dtype=np.float32)

    def _turned(self, angle_deg: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the remembered face turned by an angle, and the mask of its pixels."""
        centre = (float(self._half), float(self._half))
        matrix = cv2.getRotationMatrix2D(centre, -angle_deg, 1.0)
        side = 2 * self._half + 1
        face = cv2.warpAffine(self._face, matrix, (side, side), flags=cv2.INTER_LINEAR)
        square = np.zeros((side, side), dtype=np.float32)
        low, high = self._half - int(0.56 * self._size_px), self._half + int(0.56 * self._size_px) + 1
        square[max(0, low) : high, max(0, low) : high] = 1.0
        mask = cv2.warpAffine(square, matrix, (side, side), flags=cv2.INTER_NEAREST)
        return np.asarray(face, dtype=np.float32), np.asarray(mask, dtype=np.float32)


def _window(picture: Picture, place: FloatArray, side: int) -> NDArray[np.float32]:
    """Return the part of a picture around a place with fractions of pixels, shape [2 side + 1, 2 side + 1, 3]."""
    matrix = np.array([[1.0, 0.0, side - place[0]], [0.0, 1.0, side - place[1]]])
    size = (2 * side + 1, 2 * side + 1)
    cut = cv2.warpAffine(picture.astype(np.float32), matrix, size, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cut, dtype=np.float32)


def _centred_correlation(
    window: NDArray[np.float32], face: NDArray[np.float32], mask: NDArray[np.float32]
) -> FloatArray:
    """Return the normalized correlation of a face with each place of a window, without means, all channels."""
    count = float(mask.sum())
    product = np.zeros((window.shape[0] - face.shape[0] + 1, window.shape[1] - face.shape[1] + 1))
    square, energy = product.copy(), 0.0
    for channel in range(3):
        part = np.ascontiguousarray(window[:, :, channel])
        centred = (face[:, :, channel] - (face[:, :, channel] * mask).sum() / count) * mask
        product += cv2.matchTemplate(part, centred, cv2.TM_CCORR)
        total = cv2.matchTemplate(part, mask, cv2.TM_CCORR)
        square += cv2.matchTemplate(part * part, mask, cv2.TM_CCORR) - total**2 / count
        energy += float((centred**2).sum())
    return product / np.sqrt(np.maximum(square, 1e-6) * max(energy, 1e-6))


def _refined(response: NDArray[np.floating], row: int, column: int) -> FloatArray:
    """Return a peak with fractions of pixels, by a parabola in each direction, as x and y."""
    place = np.array([float(column), float(row)])
    for axis, (r, c) in enumerate(((0, 1), (1, 0))):
        if not (0 < row < response.shape[0] - 1 and 0 < column < response.shape[1] - 1):
            break
        before, peak, after = response[row - r, column - c], response[row, column], response[row + r, column + c]
        curvature = before - 2.0 * peak + after
        if curvature < 0.0 and before > -1.0 and after > -1.0:
            place[axis] += float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))
    return place
