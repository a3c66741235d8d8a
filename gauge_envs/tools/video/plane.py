"""Turn pixels of an oblique recording into metres in the plane of the motion, with the uncertainty of the calibration.

A camera file describes the plane in one of two ways: at least four points of it whose pixels and metres are known, or a
calibrated camera and the plane in its world. Both give a homography from pictures without lens distortion to the plane.
Hartley and Zisserman, Multiple View Geometry (2004), sections 4.1 and 8.1.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video.grid import opencv
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask
from gauge_envs.tools.video.track import Track

FloatArray: TypeAlias = NDArray[np.float64]

ORIGIN_PX = 0.5 * np.array(REFERENCE_SIZE_PX)
"""Place of the origin of the plane in the frontal picture [px]."""


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Camera matrix and radial distortion, as in OpenCV.

    Attributes:
        matrix: Camera matrix [px], shape [3, 3].
        distortion: Radial coefficients k1 and k2, shape [2].
        focal_sigma: Relative standard uncertainty of the focal length.
    """

    matrix: FloatArray
    distortion: FloatArray
    focal_sigma: float = 0.0

    def straight(self, points_px: FloatArray) -> FloatArray:
        """Return normalized coordinates without distortion of pixels, both of shape [count, 2]."""
        bent = _homogeneous(np.linalg.inv(self.matrix), points_px)
        straight = bent
        # A fixed point; OpenCV's five iterations leave 0.01 px at the corners of a wide lens.
        for _ in range(20):
            straight = bent / self._stretch(straight)
        return straight

    def pixels(self, normalized: FloatArray) -> FloatArray:
        """Return the pixels of normalized coordinates, both of shape [count, 2]."""
        return _homogeneous(self.matrix, normalized * self._stretch(normalized))

    def _stretch(self, normalized: FloatArray) -> FloatArray:
        """Return the factor by which distortion moves points from the centre, shape [count, 1]."""
        square = (normalized**2).sum(axis=1, keepdims=True)
        return np.asarray(1.0 + self.distortion[0] * square + self.distortion[1] * square**2)

    def drawn(self, rng: np.random.Generator) -> Lens:
        """Return the lens with a focal length within its uncertainty."""
        matrix = self.matrix.copy()
        matrix[[0, 1], [0, 1]] *= 1.0 + rng.normal(0.0, self.focal_sigma)
        return replace(self, matrix=matrix)


@dataclass(frozen=True, kw_only=True)
class PointPairs:
    """Points of the plane whose place is known in the picture and in metres.

    Attributes:
        points_px: Places in the picture [px], shape [count, 2], at least four.
        points_m: Places in the plane [m], shape [count, 2]: to the right and, in a vertical plane, up.
        sigma_px: Standard uncertainty of each pixel coordinate [px].
        sigma_m: Standard uncertainty of each metric coordinate [m].
    """

    points_px: FloatArray
    points_m: FloatArray
    sigma_px: float
    sigma_m: float

    def to_plane(self, lens: Lens | None) -> FloatArray:
        """Return the homography from straight coordinates to the plane, shape [3, 3]."""
        straight = self.points_px if lens is None else lens.straight(self.points_px)
        homography, _ = opencv().findHomography(straight, self.points_m)
        return np.asarray(homography, dtype=float)

    def drawn(self, rng: np.random.Generator) -> PointPairs:
        """Return the points moved within their uncertainty."""
        return replace(
            self,
            points_px=self.points_px + rng.normal(0.0, self.sigma_px, self.points_px.shape),
            points_m=self.points_m + rng.normal(0.0, self.sigma_m, self.points_m.shape),
        )


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Pose of a calibrated camera and the plane of the motion, in one world frame.

    Attributes:
        rvec: Rotation vector from the world to the camera [rad], shape [3], as in OpenCV.
        tvec: Translation from the world to the camera [m], shape [3].
        point_m: Point of the plane, its origin [m], shape [3].
        normal: Normal of the plane, shape [3]; its sign does not matter.
        up: Direction that is up in the plane, shape [3].
        sigma_m: Standard uncertainty of the plane along its normal [m].
        position_sigma_m: Standard uncertainty of each coordinate of the camera's place [m].
        rotation_sigma_rad: Standard uncertainty of the camera's rotation about each axis [rad].
    """

    rvec: FloatArray
    tvec: FloatArray
    point_m: FloatArray
    normal: FloatArray
    up: FloatArray
    sigma_m: float
    position_sigma_m: float = 0.0
    rotation_sigma_rad: float = 0.0

    @property
    def rotation(self) -> FloatArray:
        """Rotation from the world to the camera, shape [3, 3]."""
        return np.asarray(opencv().Rodrigues(self.rvec)[0], dtype=float)

    @property
    def axes(self) -> FloatArray:
        """Directions to the right and up in the plane as the camera sees it, shape [2, 3]."""
        normal = self.normal / np.linalg.norm(self.normal)
        camera = -self.rotation.T @ self.tvec
        if (camera - self.point_m) @ normal < 0.0:
            normal = -normal
        up = self.up - (self.up @ normal) * normal
        up = up / np.linalg.norm(up)
        return np.array([np.cross(up, normal), up])

    def to_plane(self, lens: Lens | None) -> FloatArray:
        """Return the homography from straight coordinates to the plane, shape [3, 3]; the lens is already taken out."""
        rotation = self.rotation
        return np.linalg.inv(np.column_stack([*(rotation @ self.axes.T).T, rotation @ self.point_m + self.tvec]))

    def drawn(self, rng: np.random.Generator) -> Pose:
        """Return the pose and the plane moved within their uncertainty."""
        rotation = self.rotation
        camera = -rotation.T @ self.tvec + rng.normal(0.0, self.position_sigma_m, 3)
        turned = opencv().Rodrigues(rng.normal(0.0, self.rotation_sigma_rad, 3))[0] @ rotation
        normal = self.normal / np.linalg.norm(self.normal)
        return replace(
            self,
            rvec=np.asarray(opencv().Rodrigues(turned)[0], dtype=float)[:, 0],
            tvec=-turned @ camera,
            point_m=self.point_m + rng.normal(0.0, self.sigma_m) * normal,
        )


@dataclass(frozen=True, kw_only=True)
class PlaneView:
    """How a recording sees the plane of the motion.

    Attributes:
        size_px: Width and height of the pictures in which the calibration is stated [px].
        source: Where the plane lies.
        lens: Lens; None for pictures without distortion, of point pairs alone.
        pivot_m: Pivot of a swing in the plane [m], shape [2]; None where there is none.
        pivot_sigma_m: Standard uncertainty of each of its coordinates [m].
        length_m: Distance of the ball's centre from the pivot [m]; None where it is not needed.
        release_height_m: Height from which the incoming ball of a cradle is released [m]; the task's if None.
        direction: Direction of a slide in the plane, shape [2]; fitted to the track if None.
    """

    size_px: tuple[int, int]
    source: PointPairs | Pose
    lens: Lens | None = None
    pivot_m: FloatArray | None = None
    pivot_sigma_m: float = 0.0
    length_m: float | None = None
    release_height_m: float | None = None
    direction: FloatArray | None = None

    def to_plane_m(self, points_px: FloatArray) -> FloatArray:
        """Return places in the plane [m] of places in the picture [px], both of shape [count, 2]."""
        straight = points_px if self.lens is None else self.lens.straight(points_px)
        return _homogeneous(self.source.to_plane(self.lens), straight)

    def to_picture_px(self, points_m: FloatArray) -> FloatArray:
        """Return places in the picture [px] of places in the plane [m], both of shape [count, 2]."""
        straight = _homogeneous(np.linalg.inv(self.source.to_plane(self.lens)), points_m)
        return straight if self.lens is None else self.lens.pixels(straight)

    def drawn(self, rng: np.random.Generator) -> PlaneView:
        """Return the view with calibration and pivot moved within their uncertainty."""
        pivot = None if self.pivot_m is None else self.pivot_m + rng.normal(0.0, self.pivot_sigma_m, 2)
        lens = None if self.lens is None else self.lens.drawn(rng)
        return replace(self, source=self.source.drawn(rng), lens=lens, pivot_m=pivot)

    def grid_to_plane_m(self, points_px: FloatArray) -> FloatArray:
        """Return places in the plane [m] of places on the reference grid [px]; NaN stays NaN."""
        places = np.full(points_px.shape, np.nan)
        is_known = np.isfinite(points_px).all(axis=1)
        places[is_known] = self.to_plane_m(points_px[is_known] * self._from_grid)
        return places

    def grid_scale_m_per_px(self, points_px: FloatArray) -> FloatArray:
        """Return the size of a pixel of the reference grid in the plane [m], shape [count]: root of its area."""
        steps = [self.grid_to_plane_m(points_px + step) for step in ([-1, 0], [1, 0], [0, -1], [0, 1])]
        across, down = 0.5 * (steps[1] - steps[0]), 0.5 * (steps[3] - steps[2])
        return np.asarray(np.sqrt(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])))

    def plane_to_grid_px(self, points_m: FloatArray) -> FloatArray:
        """Return places on the reference grid [px] of places in the plane [m], both of shape [count, 2]."""
        return self.to_picture_px(points_m) / self._from_grid

    @property
    def _from_grid(self) -> FloatArray:
        return np.array(self.size_px, dtype=float) / np.array(REFERENCE_SIZE_PX)


def frontal_task(view: PlaneView, track: Track, task: VideoTask, *, scale_m_per_px: float | None = None) -> VideoTask:
    """Return the task as a frontal picture of the plane shows it.

    Its pixels are as large as those of the track, so thresholds in pixels mean the same for an oblique recording as for
    the known first frames.

    Args:
        view: How the recording sees the plane.
        track: Track on the reference grid, with at least one place.
        task: The task.
        scale_m_per_px: Size of its pixels [m]; the median of those of the track if None.
    """
    seen = track.points_px[track.is_found]
    scale = float(np.median(view.grid_scale_m_per_px(seen))) if scale_m_per_px is None else scale_m_per_px
    places_m = view.grid_to_plane_m(seen)
    pivot, rest = None, None
    if view.pivot_m is not None:
        pivot = _frontal_px(view.pivot_m, scale)
        if view.length_m is not None:
            rest = _frontal_px(view.pivot_m - [0.0, view.length_m], scale)
    direction = None
    if task.motion is Motion.FALL:
        direction = (0.0, 1.0)
    elif task.motion is Motion.SLIDE:
        along = _main_direction(places_m) if view.direction is None else view.direction
        along = along / np.linalg.norm(along)
        direction = (float(along[0]), float(-along[1]))
    return replace(
        task,
        size_px=task.size_m / scale,
        centre_px=_frontal_px(places_m[0], scale),
        direction=direction,
        pivot_px=pivot,
        rest_px=rest,
        release_height_m=task.release_height_m if view.release_height_m is None else view.release_height_m,
    )


def frontal_track(view: PlaneView, track: Track, task: VideoTask) -> Track:
    """Return a track as a frontal picture of the plane shows it.

    Args:
        view: How the recording sees the plane.
        track: Track on the reference grid.
        task: The task that `frontal_task` returned.
    """
    scale = task.scale_m_per_px
    places = view.grid_to_plane_m(track.points_px) * [1.0, -1.0] / scale + ORIGIN_PX
    sizes = track.size_ratio
    if np.isfinite(sizes).any():
        # What comes nearer to the camera grows in the picture, and keeps its size in the plane.
        sizes = sizes * view.grid_scale_m_per_px(track.points_px)
    return replace(track, points_px=places, size_ratio=sizes)


def _frontal_px(place_m: FloatArray, scale_m_per_px: float) -> tuple[float, float]:
    x, y = place_m * [1.0, -1.0] / scale_m_per_px + ORIGIN_PX
    return float(x), float(y)


def _main_direction(places_m: FloatArray) -> FloatArray:
    """Return the direction in which places spread most, away from the first one."""
    centred = places_m - places_m.mean(axis=0)
    direction: FloatArray = np.linalg.svd(centred, full_matrices=False)[2][0]
    return direction * float(np.sign((places_m[-1] - places_m[0]) @ direction) or 1.0)


def _homogeneous(matrix: NDArray[np.floating], points: FloatArray) -> FloatArray:
    moved = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(moved[:, :2] / moved[:, 2:])
