"""Find the motion of the camera against the first frame, and whether the scene is still the same."""

import math

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2
from gauge_envs.tools.video.sight import shrunk
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX
from gauge_envs.tools.video.track import Event

STRIDE = 3
"""Frames from one look to the next."""

CHANGED = 30.0
"""Difference of the brightness with which a place has changed since the first frame."""

BLACK = 16.0
"""Brightness that no row or column of a bar beside the picture exceeds."""

RECOMPOSED_SHARE = 0.2
"""Share of the picture that must change for the scene to be another one."""

STILL_PX = 0.5
"""Mean shift of the corners of the picture up to which a camera counts as still [px]: compression stays below it."""

MOST_SHIFT_PX, MOST_ZOOM = 60.0, 0.1
"""Largest shift [px] and change of the scale that can be subtracted from a flat scene; depth shows beyond them."""

MOST_UNKNOWN = 0.1
"""Largest share of the frames in which neither the motion of the camera is found nor that it stands."""

LEAST_POINTS, LEAST_AGREEING = 12, 0.4
"""Fewest points of the scene, and smallest share of them, that must agree on the motion of the camera."""


SCALE, BLUR_PX = 0.5, 1.5
"""Scale and blur [px] at which a background without clear points is compared."""

RIM_PX = 6
"""Width of the edge of the part that moves which counts as background [px]: of a plate before an even table, the rim
alone tells that the camera stands."""

NEAR_PX = 2.0
"""Shift whose change of the brightness is looked at, and not taken for that of an object that passes [px]."""

MOST_SIGMA_PX = 0.25
"""Largest standard uncertainty of the shift of a background that is known to stand [px]."""

LIKE_NOISE, ROUNDING, NOISE_PATCH = 4.0, 0.3, 8.0
"""Difference from the first frame that is no noise, in its standard deviations; the deviation of rounding, in levels of
brightness; and neighbouring pixels that share their noise."""


class SceneWatch:
    """Compares the scene of each frame with the first one, and subtracts the motion of the camera.

    Args:
        first: The first frame.
        ignored: Part of the picture that moves on purpose, shape [480, 832].

    Attributes:
        moves: Motion of the camera in each frame since the first one, shape [2, 3]; None where it stands or is unknown.
        differences: Largest difference of the brightness of each frame from the one before; the first is infinite.
    """

    def __init__(self, first: Picture, ignored: NDArray[np.bool_]) -> None:
        self._grey = cv2.cvtColor(first, cv2.COLOR_BGR2GRAY)
        self._first = shrunk(self._grey)
        self._before = self._first
        # Black bars beside the picture are no part of the scene: a model may fill them.
        lit = self._first > BLACK
        self._counted = shrunk(ignored.astype(np.uint8)) == 0
        self._counted &= lit.any(axis=1, keepdims=True) & lit.any(axis=0, keepdims=True)
        rows, columns = np.indices(self._first.shape) / len(self._first)
        self._sides = np.stack([np.ones_like(rows), columns, rows], axis=-1)
        mask = np.where(ignored, 0, 255).astype(np.uint8)
        points = cv2.goodFeaturesToTrack(self._grey, 150, 0.02, 12, mask=mask)
        self._points = np.zeros((0, 1, 2), np.float32) if points is None else points
        self._background = _Background(self._grey, ignored)
        self.moves: list[FloatArray | None] = []
        self.differences: list[float] = []
        self._unknown: list[int] = []
        self._changed: dict[int, float] = {}

    def look(self, picture: Picture) -> None:
        """Find the motion of the camera in the next frame, and how much it differs from the one before."""
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        small = shrunk(grey)
        change = float(np.abs(small - self._before).max())
        self._before = small
        move = self._camera(grey)
        shift_px = math.inf if move is None else _shift_px(move)
        # Points that move may be those of a plate that turns, which the background contradicts.
        is_doubtful = shift_px > STILL_PX + 2.0 * MOST_SIGMA_PX
        if shift_px <= STILL_PX or (is_doubtful and self._background.stands(grey)):
            move = None
        elif move is None:
            self._unknown.append(len(self.moves))
        self.differences.append(change if self.moves else math.inf)
        self.moves.append(move)

    def steadied(self, picture: Picture, frame: int) -> Picture:
        """Return a frame as a camera that does not move would show it."""
        move = self.moves[frame]
        if move is None:
            return picture
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = REFERENCE_SIZE_PX
        return np.asarray(
            cv2.warpAffine(
                picture, move, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
            )
        )

    def compare(self, picture: Picture, frame: int) -> None:
        """Compare the scene of a steadied frame with that of the first one."""
        if frame % STRIDE == 0:
            grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            small = shrunk(grey)
            # A lamp that moves or fades changes the brightness by a factor, which is even or rises to one side.
            lit = self._sides[self._counted] * self._first[self._counted, None]
            factors = np.linalg.lstsq(lit, small[self._counted], rcond=None)[0]
            difference = np.abs(small - (self._sides @ factors) * self._first)
            self._changed[frame] = (
                float((difference[self._counted] > CHANGED).mean())
                if self._counted.any()
                else 0.0
            )

    def events(self) -> list[Event]:
        """Return what happened to the camera and the scene."""
        found = []
        recomposed = [
            frame for frame, share in self._changed.items() if share > RECOMPOSED_SHARE
        ]
        if recomposed:
            worst = max(self._changed.values())
            text = f"the scene is recomposed: up to {worst:.0%} of the picture differs from the first frame"
            found.append(Event.over("scene", recomposed, text))
        if len(self._unknown) > MOST_UNKNOWN * len(self.moves):
            text = "the camera moves, or the background shows too little to tell that it stands"
            found.append(Event.over("camera", self._unknown, text))
        moved = {n: move for n, move in enumerate(self.moves) if move is not None}
        if not moved:
            return found
        shift = max(map(_shift_px, moved.values()))
        zooms = [float(np.hypot(*move[:, 0])) - 1.0 for move in moved.values()]
        zoom = max(zooms, key=abs)
        is_too_far = shift > MOST_SHIFT_PX or abs(zoom) > MOST_ZOOM
        what = (
            "more than a flat scene allows to subtract"
            if is_too_far
            else "this is subtracted"
        )
        text = f"the camera moves by up to {shift:.1f} px and zooms by up to {zoom:+.1%}; {what}"
        found.append(Event.over("camera", list(moved), text, is_note=not is_too_far))
        return found

    def _camera(self, grey: NDArray[np.uint8]) -> FloatArray | None:
        """Return where the first frame is now, as shift, rotation and scale, shape [2, 3]; None if unknown."""
        if len(self._points) < LEAST_POINTS:
            return None
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            self._grey, grey, self._points, None, winSize=(21, 21), maxLevel=3
        )
        is_found = status.ravel() == 1
        if is_found.sum() < LEAST_POINTS:
            return None
        before, after = self._points[is_found], moved[is_found]
        matrix, inliers = cv2.estimateAffinePartial2D(
            before, after, method=cv2.RANSAC, ransacReprojThreshold=1.5
        )
        if matrix is None or inliers.sum() < max(
            LEAST_POINTS, LEAST_AGREEING * len(before)
        ):
            return None
        return np.asarray(matrix)


class _Background:
    """Tells from the whole background, without clear points, whether the camera has neither shifted nor zoomed.

    Least squares explain the change since the first frame by the slopes of its brightness, as optical flow does, and by
    a lamp. Grain differs from frame to frame: only the slopes that both frames share are texture, so that an even wall
    says nothing. A turn is not looked for, since a round plate does not show it.

    Args:
        first: Brightness of the first frame, shape [480, 832].
        ignored: Part of the picture that moves on purpose, shape [480, 832].
    """

    def __init__(self, first: NDArray[np.uint8], ignored: NDArray[np.bool_]) -> None:
        rim = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)
        inner = cv2.erode(ignored.astype(np.uint8), rim)
        self._first = self._smooth(first)
        height, width = self._first.shape
        size = (width, height)
        self._counted = cv2.resize(inner, size, interpolation=cv2.INTER_NEAREST) == 0
        rows, columns = np.indices(self._first.shape)
        self._x, self._y = columns - 0.5 * width, rows - 0.5 * height
        # A lamp changes the brightness by a factor that is even or rises to one side.
        self._lit = [
            self._first,
            self._first * self._x / width,
            self._first * self._y / height,
        ]
        self._terms = self._slopes(self._first)

    def stands(self, grey: NDArray[np.uint8]) -> bool:
        """Return whether the background of a frame shows that the camera is where it was in the first one."""
        later = self._smooth(grey)
        change, slopes = self._first - later, self._slopes(later)
        misses = np.abs(change)
        # A camera that moves a little changes edges most: they would be left out without a look at the shift.
        edges = [np.linalg.norm(one[..., :2], axis=-1) for one in (self._terms, slopes)]
        allowed = NEAR_PX * np.maximum(*edges)
        for _ in range(4):
            noise = float(np.median(misses[self._counted])) / 0.6745 + ROUNDING
            # The object itself may pass before the background.
            used = self._counted & (misses < LIKE_NOISE * noise + allowed)
            allowed = np.zeros_like(allowed)
            before, now = self._terms[used], slopes[used]
            both = now.T @ before
            if np.linalg.matrix_rank(both) < both.shape[0]:
                return False
            inverse = np.linalg.inv(both)
            fit = inverse @ (now.T @ change[used])
            misses = np.abs(change - self._terms @ fit)
        spread = inverse @ (now.T @ now) @ inverse.T
        sigma_px = noise * np.sqrt(NOISE_PATCH * np.diag(spread)[:3].max())
        shift_px = np.linalg.norm(fit[:3])
        return bool(shift_px <= STILL_PX and sigma_px <= MOST_SIGMA_PX)

    @staticmethod
    def _smooth(grey: NDArray[np.uint8]) -> FloatArray:
        """Return a picture at the scale at which it is compared."""
        soft = cv2.GaussianBlur(grey, (0, 0), BLUR_PX).astype(float)
        return np.asarray(
            cv2.resize(soft, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_AREA)
        )

    def _slopes(self, smooth: FloatArray) -> FloatArray:
        """Return how a picture changes with a shift [1/px], a zoom and a lamp, shape [height, width, 6].

        A zoom counts as the shift of the corners of the picture [1/px].
        """
        # The weights of a Sobel kernel add up to 8.
        right, down = (
            cv2.Sobel(smooth, -1, *axes, scale=SCALE / 8.0) for axes in ((1, 0), (0, 1))
        )
        corner = math.hypot(self._x[0, 0], self._y[0, 0])
        zoom = (self._x * right + self._y * down) / corner
        return np.stack([right, down, zoom, *self._lit], axis=-1)


def _shift_px(move: FloatArray) -> float:
    """Return the mean shift of the corners of the picture [px]."""
    width, height = REFERENCE_SIZE_PX
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]])
    return float(
        np.linalg.norm(corners @ move[:, :2].T + move[:, 2] - corners, axis=1).mean()
    )
