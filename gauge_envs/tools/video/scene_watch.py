"""Watch the surroundings of an object: whether the camera moves or zooms, and whether the scene stays the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video.grid import Picture, cv2
from gauge_envs.tools.video.track import Event

STRIDE = 3
"""Frames from one look to the next."""

SHRINKAGE = 4
"""Factor by which pictures are made smaller before they are compared."""

CHANGED = 30.0
"""Difference of the brightness with which a place has changed since the first frame."""

RECOMPOSED_SHARE = 0.2
"""Share of the picture that must change for the scene to be another one."""

MOST_SHIFT_PX = 4.0
"""Largest shift of the picture of a still camera [px]; compression and texture that swims stay below it."""

MOST_ZOOM = 0.02
"""Largest change of the scale of a still camera."""

SURE = 4.0
"""Standard uncertainties by which a shift or a zoom must exceed its limit."""

LEAST_LOOKS = 2
"""Fewest looks that must show it."""

LEAST_POINTS = 12
"""Fewest points of the scene that must be found again for a statement on the camera."""


@dataclass(frozen=True, kw_only=True)
class _Look:
    frame: int
    shift_px: float
    zoom: float
    changed_share: float


class SceneWatch:
    """Compares the scene of each frame with the first one.

    Args:
        first: The first frame.
        ignored: Part of the picture that moves on purpose, shape [480, 832].
    """

    def __init__(self, first: Picture, ignored: NDArray[np.bool_]) -> None:
        self._grey = cv2.cvtColor(first, cv2.COLOR_BGR2GRAY)
        self._counted = ~self._small(ignored.astype(np.float32)).astype(bool)
        self._first = self._small(self._grey.astype(np.float32))
        mask = np.where(ignored, 0, 255).astype(np.uint8)
        points = cv2.goodFeaturesToTrack(self._grey, 150, 0.02, 12, mask=mask)
        self._points = np.zeros((0, 1, 2), np.float32) if points is None else points
        self._looks: list[_Look] = []
        self._frame = 0

    def look(self, picture: Picture) -> None:
        """Compare the next frame."""
        if self._frame % STRIDE == 0:
            self._looks.append(self._compare(picture))
        self._frame += 1

    def events(self) -> list[Event]:
        """Return what happened to the camera and the scene."""
        found = []
        recomposed = [one for one in self._looks if one.changed_share > RECOMPOSED_SHARE]
        if recomposed:
            worst = max(one.changed_share for one in recomposed)
            text = f"the scene is recomposed: up to {worst:.0%} of the picture differs from the first frame"
            found.append(_event("scene", recomposed, text))
        zoomed = [one for one in self._looks if abs(one.zoom) > MOST_ZOOM]
        if len(zoomed) >= LEAST_LOOKS:
            worst = max((one.zoom for one in zoomed), key=abs)
            found.append(_event("camera", zoomed, f"the camera zooms by up to {worst:+.1%}"))
        shifted = [one for one in self._looks if one.shift_px > MOST_SHIFT_PX]
        if len(shifted) >= LEAST_LOOKS:
            worst = max(one.shift_px for one in shifted)
            found.append(_event("camera", shifted, f"the camera moves by up to {worst:.0f} px"))
        return found

    def _compare(self, picture: Picture) -> _Look:
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        difference = np.abs(self._small(grey.astype(np.float32)) - self._first)
        share = float((difference[self._counted] > CHANGED).mean()) if self._counted.any() else 0.0
        shift, zoom = self._camera(grey) if share <= RECOMPOSED_SHARE else (0.0, 0.0)
        return _Look(frame=self._frame, shift_px=shift, zoom=zoom, changed_share=share)

    def _camera(self, grey: NDArray[np.uint8]) -> tuple[float, float]:
        """Return the shift at the centre of the picture [px] and the relative change of the scale."""
        if len(self._points) < LEAST_POINTS:
            return 0.0, 0.0
        moved, status, _ = cv2.calcOpticalFlowPyrLK(self._grey, grey, self._points, None, winSize=(21, 21), maxLevel=3)
        is_found = status.ravel() == 1
        if is_found.sum() < LEAST_POINTS:
            return 0.0, 0.0
        matrix, inliers = cv2.estimateAffinePartial2D(
            self._points[is_found], moved[is_found], method=cv2.RANSAC, ransacReprojThreshold=1.5
        )
        if matrix is None or inliers.sum() < max(LEAST_POINTS, 0.4 * is_found.sum()):
            return 0.0, 0.0
        agreed = inliers.ravel() == 1
        before, after = self._points[is_found][agreed][:, 0], moved[is_found][agreed][:, 0]
        middle = before.mean(axis=0)
        residual = after - before @ matrix[:, :2].T - matrix[:, 2]
        scatter = float(np.sqrt((residual**2).mean()))
        spread = float(np.sqrt(((before - middle) ** 2).sum()))
        zoom = float(np.hypot(matrix[0, 0], matrix[1, 0])) - 1.0
        shift = float(np.linalg.norm(matrix[:, :2] @ middle + matrix[:, 2] - middle))
        # What the scatter of the points can feign is no motion of the camera.
        zoom = float(np.sign(zoom)) * max(0.0, abs(zoom) - SURE * scatter / max(spread, 1.0))
        return max(0.0, shift - SURE * scatter / len(before) ** 0.5), zoom

    @staticmethod
    def _small(picture: NDArray[np.float32]) -> NDArray[np.float32]:
        height, width = picture.shape[:2]
        size = (width // SHRINKAGE, height // SHRINKAGE)
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _event(kind: str, looks: list[_Look], text: str) -> Event:
    first, last = looks[0].frame, looks[-1].frame
    return Event(kind=kind, first_frame=first, last_frame=last, text=f"{text} (frames {first} to {last})")
