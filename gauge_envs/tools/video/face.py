"""Detect the face of a cube on a turntable in the frames of a video."""

import math

import numpy as np

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Gray, Picture, cv2
from gauge_envs.tools.video.shape import (
    Detection,
    aligned,
    colour_at,
    likeness_of,
    rotation_of,
    tint_of,
    turned_square,
)
from gauge_envs.tools.video.tasks import PLATE_RADIUS_PX, VideoTask

FACE, WINDOW = 0.6, 0.4
"""Half side of the followed square, and search distance for the next square, in sizes of the object."""

RENEWAL = 0.2
"""Weight of each frame in the template: the brightness of metal changes as it rotates to the lamp."""

MIN_CORRELATION = 0.5
"""Smallest correlation of the object with the template."""

SEARCHED_RAD = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8)
"""Angles about the axis for the search of a lost object [rad]."""

SMOOTH_PX = 3.0
"""Width of the grain that is smoothed before faces are compared [px]."""


class FaceDetector:
    """Detect the face of a cube on a turntable by a template that rotates with it and is updated in each frame.

    The search starts at the place and angle predicted by the last two frames, then continues around the axis.
    Reflections change the brightness of metal, so only its tint is compared.

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

    def candidates(self, picture: Picture) -> list[Detection]:
        """Return the detection of the object in the next frame; empty if the object is lost."""
        grey = _grey(picture)
        guesses = [self._pose + self._step]
        guesses += [self._swung(angle_rad) for angle_rad in SEARCHED_RAD]
        matches = (self._matched(picture, grey, guess) for guess in guesses)
        match = next((match for match in matches if match[1] >= MIN_CORRELATION), None)
        if match is None:
            self._step = np.zeros(3)
            return []
        pose, value = match
        self._step, self._pose = pose - self._pose, pose
        face = turned_square(grey, pose, self._half)
        self._template = (1.0 - RENEWAL) * self._template + RENEWAL * face
        if not self._is_shiny:
            # The updated template would follow a melting cube, so compare with the first face. Metal has reflections.
            value = max(0.0, float((_normed(face) * self._face).mean())) ** 2
        return [Detection(pose[1:], min(1.0, value))]

    def _matched(
        self, picture: Picture, grey: Gray, guess: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return the pose near a guess with the largest likeness to the template, and this likeness."""
        wide = self._half + int(WINDOW * self._size_px)
        window = turned_square(grey, guess, wide)
        value, warp = aligned(self._template, window, cv2.MOTION_EUCLIDEAN)
        angle_rad = math.atan2(warp[1, 0], warp[0, 0])
        move_px = warp @ [self._half, self._half, 1.0] - wide
        pose = guess + np.array([angle_rad, *(rotation_of(guess[0]) @ move_px)])
        is_on_plate = math.dist(pose[1:], self._pivot_px) < PLATE_RADIUS_PX
        # Correlation ignores colour, and an edge of the plate resembles an edge of the object.
        colour = colour_at(picture, pose[1:], self._size_px)
        return pose, is_on_plate * value * likeness_of(tint_of(colour, self._colour))

    def _swung(self, angle_rad: float) -> FloatArray:
        """Return the pose after a rotation about the axis of the plate."""
        arm_px = self._pose[1:] - self._pivot_px
        place_px = self._pivot_px + rotation_of(angle_rad) @ arm_px
        return np.array([self._pose[0] + angle_rad, *place_px])


def _grey(picture: Picture) -> Gray:
    """Return the brightness of a picture."""
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.float32)


def _normed(grey: Gray) -> Gray:
    """Return a smoothed picture with mean 0 and standard deviation 1."""
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
    return (smooth - smooth.mean()) / max(float(smooth.std()), 1e-9)
