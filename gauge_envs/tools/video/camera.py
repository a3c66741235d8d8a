"""Find the motion of the camera since the first frame, and whether the scene is still the same."""

import math

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2
from gauge_envs.tools.video.sight import BLACK_LEVEL, shrunk
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX
from gauge_envs.tools.video.track import Event

CHANGED_LEVELS = 30.0
"""Difference of the brightness with which a place has changed since the first frame."""

MAX_CHANGED_SHARE = 0.2
"""Share of the picture that must change for the scene to be another one."""

STILL_PX = 0.5
"""Mean shift of the corners of the picture up to which a camera counts as still [px]: compression stays below it."""

MAX_SHIFT_PX, MAX_ZOOM = 60.0, 0.1
"""Largest shift [px] and change of the scale that can be subtracted from a flat scene; depth shows beyond them."""

MAX_UNKNOWN_SHARE = 0.1
"""Largest share of the frames in which the motion of the camera is not found."""

MIN_POINTS, MIN_AGREEING_SHARE = 12, 0.4
"""Smallest number of points of the scene, and their smallest share, that must agree on the motion of the camera."""


class SceneWatch:
    """Compare the scene of each frame with the first one, and subtract the motion of the camera.

    Corners of the scene are followed by optical flow (Lucas and Kanade, 1981); a shift, a rotation and a scale are
    fitted to them by random samples (RANSAC).

    Args:
        first: The first frame.
        moving: Part of the picture that moves on purpose, shape [480, 832].

    Attributes:
        moves: Motion of the camera in each frame since the first one, shape [2, 3]; None where it stands or is unknown.
        differences: Largest difference of the brightness of each frame from the one before; the first is infinite.
    """

    def __init__(self, first: Picture, moving: NDArray[np.bool_]) -> None:
        self._grey = cv2.cvtColor(first, cv2.COLOR_BGR2GRAY)
        self._first = self._before = shrunk(self._grey)
        is_still = shrunk(moving.astype(np.uint8)) == 0
        is_lit = is_still & (self._first > BLACK_LEVEL)
        self._counted = is_lit if is_lit.any() else is_still
        mask = np.where(moving, 0, 255).astype(np.uint8)
        points = cv2.goodFeaturesToTrack(self._grey, 150, 0.02, 12, mask=mask)
        self._points = np.zeros((0, 1, 2), np.float32) if points is None else points
        self.moves: list[FloatArray | None] = []
        self.differences: list[float] = []
        self._is_unknown: list[bool] = []
        self._changed_shares: list[float] = []

    def look(self, picture: Picture) -> None:
        """Find the motion of the camera in the next frame, and how much the scene differs from before."""
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        small = shrunk(grey)
        change = float(np.abs(small - self._before).max())
        self.differences.append(change if self.moves else math.inf)
        self._before = small
        move = self._camera(grey)
        self._is_unknown.append(move is None)
        is_moved = move is not None and _shift_px(move) > STILL_PX
        self.moves.append(move if is_moved else None)
        steady = shrunk(self.steadied(grey, -1))[self._counted]
        first = self._first[self._counted]
        # A lamp that fades changes the brightness by a factor.
        lamp = np.clip(np.median(steady / np.maximum(first, 1.0)), 0.5, 2.0)
        is_changed = np.abs(steady - lamp * first) > CHANGED_LEVELS
        self._changed_shares.append(float(is_changed.mean()))

    def steadied(self, picture: NDArray[np.uint8], frame: int) -> NDArray[np.uint8]:
        """Return a frame as a camera that does not move would show it."""
        move = self.moves[frame]
        if move is None:
            return picture
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        edge = cv2.BORDER_REPLICATE
        return np.asarray(
            cv2.warpAffine(
                picture, move, REFERENCE_SIZE_PX, flags=flags, borderMode=edge
            )
        )

    def events(self) -> list[Event]:
        """Return what happened to the camera and the scene."""
        changed = np.array(self._changed_shares)
        moves = [np.eye(2, 3) if move is None else move for move in self.moves]
        shifts_px = np.array([_shift_px(move) for move in moves])
        zooms = np.array([np.hypot(*move[:, 0]) - 1.0 for move in moves])
        is_far = (shifts_px > MAX_SHIFT_PX) | (np.abs(zooms) > MAX_ZOOM)
        shift_px, zoom = shifts_px.max(), max(zooms, key=abs)
        outcome = "this is subtracted"
        if is_far.any():
            outcome = "more than a flat scene allows to subtract"
        is_unknown = np.array(self._is_unknown)
        is_unknown &= is_unknown.mean() > MAX_UNKNOWN_SHARE
        events = []
        for kind, is_seen, text in (
            (
                "scene",
                changed > MAX_CHANGED_SHARE,
                f"the scene is recomposed: up to {changed.max():.0%} of the picture differs from the first frame",
            ),
            (
                "camera",
                is_unknown,
                "the camera moves, or the background shows too little to tell that it stands",
            ),
            (
                "motion",
                shifts_px > 0.0,
                f"the camera moves by up to {shift_px:.1f} px and zooms by up to {zoom:+.1%}; {outcome}",
            ),
        ):
            if is_seen.any():
                first, last = np.flatnonzero(is_seen)[[0, -1]].tolist()
                events.append(
                    Event(
                        kind=kind,
                        first_frame=first,
                        last_frame=last,
                        text=f"{text} (frames {first} to {last})",
                        is_note=kind == "motion" and not is_far.any(),
                    )
                )
        return events

    def _camera(self, grey: NDArray[np.uint8]) -> FloatArray | None:
        """Return where the first frame is now, as shift, rotation and scale, shape [2, 3]; None if unknown."""
        if len(self._points) < MIN_POINTS:
            return None
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            self._grey, grey, self._points, None, winSize=(21, 21), maxLevel=3
        )
        is_found = status.ravel() == 1
        if is_found.sum() < MIN_POINTS:
            return None
        matrix, is_inlier = cv2.estimateAffinePartial2D(
            self._points[is_found], moved[is_found], ransacReprojThreshold=1.5
        )
        min_count = max(MIN_POINTS, MIN_AGREEING_SHARE * is_found.sum())
        return None if is_inlier.sum() < min_count else np.asarray(matrix)


def _shift_px(move: FloatArray) -> float:
    """Return the mean shift of the corners of the picture [px]."""
    width, height = REFERENCE_SIZE_PX
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]])
    shifts = corners @ move[:, :2].T + move[:, 2] - corners
    return float(np.linalg.norm(shifts, axis=1).mean())
