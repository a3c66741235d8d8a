"""Detect the face of a cube that rides a turntable in the frames of a video."""

import math

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Gray, Picture, cv2
from gauge_envs.tools.video.shape import (
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
        self._template = turned_square(_grey(first), self._pose, self._half)
        self._face = _normed(self._template)
        self._colour = colour_at(first, self._pose[1:], task.size_px)
        small = shrunk(first)
        disk = np.zeros(first.shape[:2], np.uint8)
        pivot_px = self._pivot_px.astype(int).tolist()
        cv2.circle(disk, pivot_px, int(RIM * PLATE_RADIUS_PX), 1, -1)
        self._is_plate = shrunk(disk) > 0.5
        plate = np.median(small[self._is_plate], axis=0)
        place = COARSE * self._pose[1:]
        cube = colour_at(small, place, COARSE * task.size_px)
        self._middle, self._contrast = 0.5 * (plate + cube), cube - plate

    def candidates(self, picture: Picture) -> list[Detection]:
        """Return the detection of the object in the next frame, then those of others; none where it is lost."""
        grey = _grey(picture)
        starts = [self._pose + self._step]
        starts += [self._swung(angle_rad) for angle_rad in SEARCHED_RAD]
        matches = (self._matched(picture, grey, start) for start in starts)
        match = next((match for match in matches if match[1] >= MIN_CORRELATION), None)
        if match is None:
            self._step = np.zeros(3)
            return []
        pose, value = match
        self._step, self._pose = pose - self._pose, pose
        face = turned_square(grey, pose, self._half)
        self._template = (1.0 - RENEWAL) * self._template + RENEWAL * face
        if not self._is_shiny:
            # The renewed template would follow a cube that melts. Reflections change the face of metal.
            value = max(0.0, float((_normed(face) * self._face).mean())) ** 2
        return [Detection(pose[1:], min(1.0, value)), *self._areas(picture)]

    def _areas(self, picture: Picture) -> list[Detection]:
        """Return all areas of the plate with the colour of the cube that are as large as a second object."""
        if self._is_shiny or np.linalg.norm(self._contrast) <= MIN_CONTRAST:
            return []
        is_cube = (shrunk(picture) - self._middle) @ self._contrast > 0.0
        covered = (is_cube & self._is_plate).astype(np.uint8)
        covered = cv2.morphologyEx(covered, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        _, _, stats, middles = cv2.connectedComponentsWithStats(covered)
        min_area_px2 = MIN_TWIN_AREA * (COARSE * self._size_px) ** 2
        # The first area is the background.
        is_large = stats[1:, cv2.CC_STAT_AREA] > min_area_px2
        return [Detection(middle / COARSE, 1.0) for middle in middles[1:][is_large]]

    def _matched(
        self, picture: Picture, grey: Gray, start: FloatArray
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


def _grey(picture: Picture) -> Gray:
    """Return the brightness of a picture."""
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.float32)


def _normed(grey: Gray) -> Gray:
    """Return a picture without its grain, at the mean 0 and the standard deviation 1."""
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
    return (smooth - smooth.mean()) / max(float(smooth.std()), 1e-9)
