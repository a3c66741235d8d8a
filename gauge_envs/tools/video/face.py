"""Detect the face of a cube that rides a turntable in the frames of a video."""

import math

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2
from gauge_envs.tools.video.sight import (
    COARSE,
    Detection,
    aligned,
    colour_at,
    likeness_of,
    rotation_of,
    shrunk,
    tint_of,
    turned_square,
)
from gauge_envs.tools.video.tasks import PLATE_RADIUS_PX, VideoTask

FACE, WINDOW = 0.6, 0.4
"""Half of the followed square, and how far around it the next one is looked for, in sizes of the object."""

RENEWAL = 0.2
"""Share of a frame that the template takes over: metal changes its brightness as it turns to the lamp."""

MIN_CORRELATION = 0.5
"""Smallest correlation with the template that shows the object."""

SEARCHED_RAD = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8)
"""Angles about the axis at which an object that was lost is looked for [rad]."""

SMOOTH_PX = 3.0
"""Width of the grain that does not count in the likeness of a face [px]."""

MIN_CONTRAST = 80.0
"""Distance of the colours of plate and object from which its area is known: a plate of wood has veins."""

TINT_GAIN, DARK_LEVEL = 768.0, 20.0
"""Factor that makes tints as large as colours, and brightness below which they are noise."""

RIM = 0.95
"""Part of the plate inside its rim, in its radius."""

MIN_TWIN_AREA = 0.4
"""Smallest area of a second object, relative to the first."""


class FaceDetector:
    """Detect the face of a cube on a turntable by a template that rotates with it and is renewed in each frame.

    The search starts at the place and angle that the last two frames predict, and then goes around the axis. The area
    of the cube's colour shows its size and shape, and second objects, where the plate has another colour. Reflections
    change the brightness of metal, so its tint counts there.

    Args:
        first: The first frame.
        task: The task.
    """

    def __init__(self, first: Picture, task: VideoTask) -> None:
        assert task.pivot_px is not None
        self._size_px, self._is_shiny = task.size_px, task.is_shiny
        self._pivot_px = np.array(task.pivot_px)
        self._half = int(FACE * task.size_px)
        # Angle [rad] and place [px].
        self._pose, self._step = np.array([0.0, *task.centre_px]), np.zeros(3)
        self._drift_px = np.zeros(2)
        self._template = turned_square(_grey(first), self._pose, self._half)
        self._face = _normed(self._template)
        self._colour = colour_at(first, self._pose[1:], task.size_px)
        small = self._colours(first)
        disk = np.zeros(first.shape[:2], np.uint8)
        pivot_px = self._pivot_px.astype(int).tolist()
        cv2.circle(disk, pivot_px, int(RIM * PLATE_RADIUS_PX), 1, -1)
        self._is_plate = shrunk(disk) > 0.5
        plate = np.median(small[self._is_plate], axis=0)
        place = COARSE * self._pose[1:]
        cube = colour_at(small, place, COARSE * task.size_px)
        self._middle, self._contrast = 0.5 * (plate + cube), cube - plate
        self._first_cut: NDArray[np.float32] | None = None
        if np.linalg.norm(self._contrast) > MIN_CONTRAST:
            self._first_cut = self._cut(self._covered(first))

    def candidates(self, picture: Picture) -> list[Detection]:
        """Return the detection of the object in the next frame, then those of others; none where it is lost."""
        grey = _grey(picture)
        starts = [self._pose + self._step]
        starts += [self._swung(angle_rad) for angle_rad in SEARCHED_RAD]
        matches = (self._matched(picture, grey, start) for start in starts)
        match = next((one for one in matches if one[1] >= MIN_CORRELATION), None)
        if match is None:
            self._step = np.zeros(3)
            return []
        pose, value = match
        self._step, self._pose = pose - self._pose, pose
        face = turned_square(grey, pose, self._half)
        self._template = (1.0 - RENEWAL) * self._template + RENEWAL * face
        found = Detection(place_px=pose[1:], likeness=min(1.0, value))
        others = self._areas(picture, found)
        if not self._is_shiny:
            # The renewed template would follow a cube that melts. Reflections change the face of metal.
            found.likeness = max(0.0, float((_normed(face) * self._face).mean())) ** 2
            colour = colour_at(picture, pose[1:], self._size_px)
            found.tint = tint_of(colour, self._colour)
        return [found, *others]

    def _areas(self, picture: Picture, found: Detection) -> list[Detection]:
        """Set the size and shape of a detection, and return all areas as large as a second object."""
        if self._first_cut is None:
            return []
        covered = self._covered(picture)
        cut = self._cut(covered)
        area = float(self._first_cut.sum())
        if self._is_shiny and cut.any():
            # Reflections make the template drift, and tints do not.
            drift = _middle(cut) - _middle(self._first_cut)
            drift_px = rotation_of(self._pose[0]) @ drift / COARSE
            self._drift_px += RENEWAL * (drift_px - self._drift_px)
            found.place_px = self._pose[1:] + self._drift_px
        found.size_ratio = math.sqrt(float(cut.sum()) / area)
        if not self._is_shiny:
            # Reflections take parts from the area of metal.
            found.misfit = float(np.abs(cut - self._first_cut).sum()) / area
        _, _, stats, middles = cv2.connectedComponentsWithStats(covered)
        is_large = stats[:, cv2.CC_STAT_AREA] > MIN_TWIN_AREA * area
        # The first area is the background.
        is_large[0] = False
        return [
            Detection(place_px=middle / COARSE, likeness=1.0)
            for middle in middles[is_large]
        ]

    def _colours(self, picture: Picture) -> NDArray[np.float32]:
        """Return a small picture in colours, or of metal in tints: its brightness changes as it turns to the lamp."""
        small = shrunk(picture)
        if not self._is_shiny:
            return small
        brightness = small.mean(axis=2, keepdims=True)
        return TINT_GAIN * (small - brightness) / (brightness + DARK_LEVEL)

    def _covered(self, picture: Picture) -> NDArray[np.uint8]:
        """Return which pixels of the plate have the colour of the cube, in a small picture."""
        is_cube = (self._colours(picture) - self._middle) @ self._contrast > 0.0
        covered = (is_cube & self._is_plate).astype(np.uint8)
        return np.asarray(
            cv2.morphologyEx(covered, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        )

    def _cut(self, covered: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the square around the object that rotates with it, in a small picture."""
        pose = self._pose * [1.0, COARSE, COARSE]
        half = int(0.75 * COARSE * self._size_px)
        return turned_square(covered.astype(np.float32), pose, half)

    def _matched(
        self, picture: Picture, grey: NDArray[np.float32], start: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return the pose near another one at which the picture is most like the template, and the likeness there."""
        wide = self._half + int(WINDOW * self._size_px)
        window = turned_square(grey, start, wide)
        value, warp = aligned(self._template, window, cv2.MOTION_EUCLIDEAN)
        angle_rad = math.atan2(warp[1, 0], warp[0, 0])
        move_px = warp @ [self._half, self._half, 1.0] - wide
        pose = start + np.array([angle_rad, *(rotation_of(start[0]) @ move_px)])
        is_on_plate = math.dist(pose[1:], self._pivot_px) < PLATE_RADIUS_PX
        # Correlation does not depend on colour, and an edge of the plate is like one of the object.
        colour = colour_at(picture, pose[1:], self._size_px)
        return pose, is_on_plate * value * likeness_of(tint_of(colour, self._colour))

    def _swung(self, angle_rad: float) -> FloatArray:
        """Return the pose that has rotated about the axis of the plate."""
        arm_px = self._pose[1:] - self._pivot_px
        place_px = self._pivot_px + rotation_of(angle_rad) @ arm_px
        return np.array([self._pose[0] + angle_rad, *place_px])


def _middle(cut: NDArray[np.float32]) -> FloatArray:
    """Return the middle of an area, horizontally and vertically, shape [2]."""
    moments = cv2.moments(cut)
    return np.array([moments["m10"], moments["m01"]]) / moments["m00"]


def _grey(picture: Picture) -> NDArray[np.float32]:
    """Return the brightness of a picture."""
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.float32)


def _normed(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a picture without its grain, at the mean 0 and the standard deviation 1."""
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
    return (smooth - smooth.mean()) / max(float(smooth.std()), 1e-9)
