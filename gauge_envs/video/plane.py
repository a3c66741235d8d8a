"""Map a track from an oblique view onto the plane of the motion, by four known points or a calibrated camera.

A view file states one of both. Lengths are in the plane: x to the right and y down; for a slide x is down the slope.
The origin is the pivot of a swing, the axis of a turntable, or the first place of the object.

    size_px = [1280, 720]          # pictures in which the pixels were read
    scale_sigma = 0.01             # relative standard uncertainty of lengths in the plane

    [[points]]                     # four or more known points of the plane
    pixel = [412.0, 610.5]
    plane_m = [0.0, 0.0]

or, for a calibrated camera with the projection of OpenCV,

    [camera]
    matrix = [[766.0, 0.0, 657.0], [0.0, 766.0, 347.0], [0.0, 0.0, 1.0]]
    distortion = [0.10, -0.10]     # k1, k2 and, if known, p1, p2, k3
    rotation = [0.96, 1.70, -1.45] # rotation vector from world to camera
    translation_m = [-0.44, 0.16, 1.54]

    [plane]
    origin_m = [0.42, 0.44, 0.45]
    x_axis = [0.7, -0.7, 0.0]
    y_axis = [0.0, 0.0, -1.0]
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from gauge_envs.errors import VideoError
from gauge_envs.files import MEGABYTE, read_regular, toml_document
from gauge_envs.references.tables import FileModel
from gauge_envs.video.frames import opencv
from gauge_envs.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask
from gauge_envs.video.track import Track

__all__ = ["PlaneView", "read_plane_view"]

FloatArray = NDArray[np.float64]

LEAST_POINTS = 4
"""Fewest points that fix a view of a plane."""

ON_A_LINE = 0.02
"""Least distance of the points from a line that fixes a view, against their extent."""

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0.0)]


class KnownPoint(FileModel):
    """Point of the plane of the motion.

    Attributes:
        pixel: Where it is in the picture [px].
        plane_m: Where it is in the plane [m].
    """

    pixel: Pair
    plane_m: Pair


class Camera(FileModel):
    """Calibrated camera with the projection of OpenCV.

    Attributes:
        matrix: Camera matrix [px], shape [3, 3].
        distortion: k1, k2 and, if known, p1, p2 and k3.
        rotation: Rotation vector from the world to the camera [rad].
        translation_m: Translation from the world to the camera [m].
    """

    matrix: tuple[Triple, Triple, Triple]
    distortion: Annotated[tuple[float, ...], Field(max_length=5)] = ()
    rotation: Triple
    translation_m: Triple


class MotionPlane(FileModel):
    """Plane of the motion in the world of the camera.

    Attributes:
        origin_m: Its origin [m].
        x_axis: Direction to the right, or down the slope.
        y_axis: Direction down the picture; made perpendicular to `x_axis`.
    """

    origin_m: Triple
    x_axis: Triple
    y_axis: Triple

    @model_validator(mode="after")
    def _spans_a_plane(self) -> MotionPlane:
        if np.linalg.norm(np.cross(self.x_axis, self.y_axis)) < 1e-9:
            raise ValueError("x_axis and y_axis must have different directions and a length")
        return self


class PlaneView(FileModel):
    """View of the plane of the motion; the module describes its file.

    Attributes:
        size_px: Width and height of the pictures [px].
        scale_sigma: Relative standard uncertainty of lengths in the plane.
        points: Known points of the plane; empty with a camera.
        camera: Calibrated camera; None with points.
        plane: Plane of the motion; None with points.
    """

    size_px: tuple[Positive, Positive]
    scale_sigma: Annotated[float, Field(ge=0.0, le=0.5)] = 0.01
    points: tuple[KnownPoint, ...] = ()
    camera: Camera | None = None
    plane: MotionPlane | None = None

    @model_validator(mode="after")
    def _is_one_of_both(self) -> PlaneView:
        if bool(self.points) == (self.camera is not None) or (self.camera is None) != (self.plane is None):
            raise ValueError("state either [[points]], or both [camera] and [plane]")
        if self.points:
            if len(self.points) < LEAST_POINTS:
                raise ValueError(f"{len(self.points)} points: a view of a plane needs {LEAST_POINTS}")
            for name in ("pixel", "plane_m"):
                values = np.array([getattr(point, name) for point in self.points])
                # No three of four points may be on a line; for more points, not all but one.
                if any(_flatness(np.delete(values, row, axis=0)) < ON_A_LINE for row in range(len(values))):
                    raise ValueError(f"points: all but one {name} are on a line, which does not fix a view")
        return self

    def plane_m(self, pixels: FloatArray) -> FloatArray:
        """Return where points of the picture are in the plane of the motion [m].

        Args:
            pixels: Points in pictures of `size_px` [px], shape [point_count, 2]; NaN is kept.
        """
        if self.camera is None or self.plane is None:
            return _homogeneous(self._homography(), pixels)
        camera = np.array(self.camera.matrix)
        rays = _undistorted(pixels, camera, np.array(self.camera.distortion))
        rotation = Rotation.from_rotvec(self.camera.rotation)
        eye = -rotation.inv().apply(self.camera.translation_m)
        directions = rotation.inv().apply(np.column_stack([rays, np.ones(len(rays))]))
        x_axis, y_axis = _axes(self.plane)
        # Where the ray from the camera meets the plane.
        normal = np.cross(x_axis, y_axis)
        origin = np.array(self.plane.origin_m)
        reach = ((origin - eye) @ normal) / (directions @ normal)
        away = eye + reach[:, None] * directions - origin
        return np.column_stack([away @ x_axis, away @ y_axis])

    def pixels(self, plane_m: FloatArray) -> FloatArray:
        """Return where points of the plane are in the picture [px], shape [point_count, 2]; undoes `plane_m`."""
        if self.camera is None or self.plane is None:
            return _homogeneous(np.asarray(np.linalg.inv(self._homography()), dtype=np.float64), plane_m)
        x_axis, y_axis = _axes(self.plane)
        world = np.array(self.plane.origin_m) + plane_m @ np.stack([x_axis, y_axis])
        cv2 = opencv()
        rotation, translation = np.array(self.camera.rotation), np.array(self.camera.translation_m)
        found, _ = cv2.projectPoints(
            world, rotation, translation, np.array(self.camera.matrix), _five(np.array(self.camera.distortion))
        )
        return np.asarray(found.reshape(-1, 2), dtype=np.float64)

    def on_reference_grid(self, track: Track, task: VideoTask) -> Track:
        """Return a track as the camera of the task's first frame would have seen it.

        Args:
            track: Track on the reference grid of the oblique pictures, as a tracker returns it.
            task: The task.
        """
        to_picture = np.array(self.size_px) / np.array(REFERENCE_SIZE_PX)
        metres = self.plane_m(track.points_px * to_picture)
        return replace(track, points_px=_anchor_px(task) + metres / task.scale_m_per_px @ _turn(task).T)

    def in_oblique_view(self, task: VideoTask, start: tuple[float, float, float]) -> VideoTask:
        """Return a task whose object starts at a place of the oblique pictures.

        Args:
            task: The task.
            start: Centre and size of the object in the first picture [px].

        Raises:
            VideoError: The object of the task swings or turns, and needs a track.
        """
        if task.motion not in (Motion.SLIDE, Motion.FALL):
            raise VideoError(
                f"{task.id}: only a slide and a fall are followed in an oblique view; give a track, as --track"
            )
        to_grid = np.array(REFERENCE_SIZE_PX) / np.array(self.size_px)
        x, y = np.array(start[:2]) * to_grid
        size_px = start[2] * float(np.sqrt(to_grid.prod()))
        return replace(task, centre_px=(float(x), float(y)), size_px=size_px)

    def _homography(self) -> FloatArray:
        cv2 = opencv()
        before = np.array([point.pixel for point in self.points])
        after = np.array([point.plane_m for point in self.points])
        matrix, _ = cv2.findHomography(before, after)
        if matrix is None:
            raise VideoError("points: they do not fix a view of the plane; measure others")
        return np.asarray(matrix, dtype=np.float64)


def read_plane_view(path: Path | str) -> PlaneView:
    """Return the view of a TOML file.

    Raises:
        VideoError: The file cannot be read, lacks a key, or does not fix a view; the message names the key.
    """
    path = Path(path)
    try:
        return PlaneView(**toml_document(read_regular(path, MEGABYTE)))
    except OSError as error:
        raise VideoError(f"{path}: cannot be read: {error.strerror}") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "(file)"
        raise VideoError(f"{path}: {place}: {first['msg'].removeprefix('Value error, ')}") from None
    except (ValueError, TypeError) as error:
        raise VideoError(f"{path}: is no TOML file of a view: {error}") from None


def _anchor_px(task: VideoTask) -> FloatArray:
    """Return where the origin of the plane is in the first frame [px]."""
    if task.motion in (Motion.SLIDE, Motion.FALL):
        return np.array(task.centre_px)
    assert task.pivot_px is not None
    return np.array(task.pivot_px)


def _turn(task: VideoTask) -> FloatArray:
    """Return the rotation from the plane to the picture: x of a slide is down its slope, shape [2, 2]."""
    if task.motion is not Motion.SLIDE:
        return np.eye(2)
    assert task.direction is not None
    x, y = task.direction
    return np.array([[x, -y], [y, x]])


def _axes(plane: MotionPlane) -> tuple[FloatArray, FloatArray]:
    x_axis = np.array(plane.x_axis) / np.linalg.norm(plane.x_axis)
    y_axis = np.array(plane.y_axis) - (np.array(plane.y_axis) @ x_axis) * x_axis
    return x_axis, y_axis / np.linalg.norm(y_axis)


def _undistorted(pixels: FloatArray, matrix: FloatArray, distortion: FloatArray) -> FloatArray:
    """Return the directions of pixels before the camera, x and y at depth 1; NaN is kept."""
    cv2 = opencv()
    found = np.full(pixels.shape, np.nan)
    seen = np.isfinite(pixels).all(axis=1)
    if seen.any():
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
        rays = cv2.undistortPoints(pixels[seen][:, None], matrix, _five(distortion), criteria=stop)
        found[seen] = rays[:, 0]
    return found


def _five(distortion: FloatArray) -> FloatArray:
    return np.concatenate([distortion, np.zeros(5 - len(distortion))])


def _homogeneous(matrix: FloatArray, points: FloatArray) -> FloatArray:
    mapped = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:], dtype=np.float64)


def _flatness(points: FloatArray) -> float:
    """Return the extent of points across the line through them, against that along it."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(values[-1] / max(values[0], 1e-300))
