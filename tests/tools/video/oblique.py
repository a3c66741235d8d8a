"""Known motions in a plane, as an oblique camera with lens distortion sees them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from clips import motion_on_grid
from numpy.typing import NDArray

from gauge_envs.tools.video import PlaneView, video_task
from gauge_envs.tools.video.plane import Lens, PointPairs
from gauge_envs.tools.video.tasks import Motion

FloatArray = NDArray[np.float64]
SIZE_PX = (1280, 720)
FPS = 50.0
POINTS_SIGMA_PX = 0.3


@dataclass(frozen=True)
class ObliqueClip:
    """Places in the picture, the true values, and a view as stated: off the truth by its uncertainty."""

    task: str
    truth: dict[str, float]
    camera: Camera
    from_points: PlaneView
    places_px: FloatArray


@dataclass(frozen=True)
class Camera:
    """A calibrated camera and a plane in its world, in OpenCV's conventions.

    Attributes:
        axes: Directions to the right and up in the plane, shape [2, 3].
    """

    rvec: FloatArray
    tvec: FloatArray
    matrix: FloatArray
    distortion: FloatArray
    point_m: FloatArray
    axes: FloatArray

    def to_picture_px(self, points_m):
        """Return places in the picture [px] of places in the plane [m], both of shape [count, 2]."""
        world = self.point_m + points_m @ self.axes
        bent = np.array([*self.distortion, 0.0, 0.0])
        return np.asarray(
            cv2.projectPoints(world, self.rvec, self.tvec, self.matrix, bent)[0][:, 0],
            dtype=float,
        )

    def view(self, *, sigma_px=0.0, sigma_m=0.0, **motion):
        """Return the view by the corners of a rectangle in the plane."""
        corners = np.array([[-0.3, -0.22], [0.3, -0.22], [0.3, 0.22], [-0.3, 0.22]])
        places = self.to_picture_px(corners)
        pairs = PointPairs(
            px=places.tolist(), m=corners.tolist(), sigma_px=sigma_px, sigma_m=sigma_m
        )
        lens = Lens(matrix=self.matrix.tolist(), distortion=tuple(self.distortion))
        return PlaneView(size_px=SIZE_PX, points=pairs, lens=lens, motion=motion)


def oblique_clip(name, rng):
    """Return a clip of a task from a random camera, 20 to 43 degrees off the normal of the plane."""
    task = video_task(name)
    place, truth, duration_s = motion_on_grid(task, rng)
    # A fit of noisy places explains less than all of them.
    truth.pop("r2", None)
    times = np.arange(int(duration_s * FPS)) / FPS
    grid_px = np.array([place(time_s)[0] for time_s in times])
    origin_px = 0.5 * (grid_px.min(axis=0) + grid_px.max(axis=0))
    middle_m, motion = np.zeros(2), {}
    if task.motion in (Motion.PENDULUM, Motion.CRADLE):
        origin_px = task.pivot_px
        middle_m = np.array([0.0, 0.18 if task.motion is Motion.PENDULUM else 0.07])
        motion = {"pivot_m": tuple(middle_m), "pivot_sigma_m": 0.0005}
    if task.motion is Motion.CRADLE:
        length_px = np.linalg.norm(np.subtract(task.rest_px, task.pivot_px))
        motion["length_m"] = float(length_px * task.scale_m_per_px)
    places_m = (grid_px - origin_px) * task.scale_m_per_px * [1.0, -1.0] + middle_m
    camera = _camera(task.motion, rng)
    # A user has read four points of the plane in the picture, and measured the pivot.
    view = camera.view(sigma_px=POINTS_SIGMA_PX, sigma_m=0.0005, **motion)
    return ObliqueClip(
        task=name,
        truth=truth,
        camera=camera,
        from_points=view.drawn(rng),
        places_px=camera.to_picture_px(places_m),
    )


def _camera(motion, rng):
    """Return a camera that looks at the origin of a vertical plane or, for a turntable, of a horizontal one."""
    azimuth, height = (
        rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(15, 35)),
        np.radians(rng.uniform(10, 25)),
    )
    away = np.array(
        [
            np.sin(azimuth) * np.cos(height),
            -np.cos(azimuth) * np.cos(height),
            np.sin(height),
        ]
    )
    normal, up = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    if motion is Motion.TURN:
        away = np.array(
            [
                np.sin(azimuth) * np.sin(height),
                -np.sin(height + 0.3),
                np.cos(height + 0.3),
            ]
        )
        normal, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    eye = rng.uniform(1.1, 1.4) * away / np.linalg.norm(away)
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    matrix = np.array(
        [[rng.uniform(1000, 1150), 0.0, 640.0], [0.0, 0.0, 360.0], [0.0, 0.0, 1.0]]
    )
    matrix[1, 1] = matrix[0, 0]
    return Camera(
        rvec=cv2.Rodrigues(rotation)[0][:, 0],
        tvec=-rotation @ eye,
        matrix=matrix,
        distortion=np.array([rng.uniform(-0.12, 0.12), rng.uniform(-0.05, 0.05)]),
        point_m=np.zeros(3),
        axes=np.array([np.cross(up, normal), up]),
    )
