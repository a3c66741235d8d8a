"""Known motions in a plane, as an oblique camera with lens distortion sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video import PlaneView, video_task
from gauge_envs.tools.video.plane import Lens, PointPairs, Pose
from gauge_envs.tools.video.tasks import Motion

FloatArray = NDArray[np.float64]
SIZE_PX = (1280, 720)
FPS = 50.0
POINTS_SIGMA_PX = 0.3
POSITION_SIGMA_M = 0.002
ROTATION_SIGMA_RAD = 0.001


@dataclass(frozen=True)
class ObliqueClip:
    """Places in the picture, the true values, and views as stated: off the truth by their uncertainty."""

    task: str
    truth: dict[str, float]
    true_view: PlaneView
    from_pose: PlaneView
    from_points: PlaneView
    times_s: FloatArray
    places_px: FloatArray


def to_picture_px(view: PlaneView, points_m: FloatArray) -> FloatArray:
    """Return places in the picture of a calibrated camera [px] of places in the plane [m], both of shape [count, 2]."""
    assert isinstance(view.source, Pose) and view.lens is not None
    matrix = np.linalg.inv(view.source.to_plane(view.lens))
    straight = np.column_stack([points_m, np.ones(len(points_m))]) @ matrix.T
    normalized = straight[:, :2] / straight[:, 2:]
    square = (normalized**2).sum(axis=1, keepdims=True)
    bent = normalized * (1.0 + view.lens.distortion[0] * square + view.lens.distortion[1] * square**2)
    return np.asarray(bent @ view.lens.matrix[:2, :2].T + view.lens.matrix[:2, 2])


def oblique_clip(name: str, rng: np.random.Generator) -> ObliqueClip:
    """Return a clip of a task from a random camera, 20 to 43 degrees off the normal of the plane."""
    task = video_task(name)
    place, truth, duration_s, motion = _motion(name, rng)
    true_view = replace(_camera(task.motion, rng), **motion)
    times = np.arange(int(duration_s * FPS)) / FPS
    places = to_picture_px(true_view, np.array([place(t)[0] for t in times]))
    return ObliqueClip(
        task=name,
        truth=truth,
        true_view=true_view,
        from_pose=true_view.drawn(rng),
        from_points=_from_points(true_view, rng),
        times_s=times,
        places_px=places,
    )


def _camera(motion: Motion, rng: np.random.Generator) -> PlaneView:
    """Return a camera that looks at the origin of a vertical plane or, for a turntable, of a horizontal one."""
    azimuth, height = rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(15, 35)), np.radians(rng.uniform(10, 25))
    away = np.array([np.sin(azimuth) * np.cos(height), -np.cos(azimuth) * np.cos(height), np.sin(height)])
    normal, up = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    if motion is Motion.TURN:
        away = np.array([np.sin(azimuth) * np.sin(height), -np.sin(height + 0.3), np.cos(height + 0.3)])
        normal, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    eye = rng.uniform(1.1, 1.4) * away / np.linalg.norm(away)
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    pose = Pose(
        rvec=cv2.Rodrigues(rotation)[0][:, 0],
        tvec=-rotation @ eye,
        point_m=np.zeros(3),
        normal=normal,
        up=up,
        sigma_m=0.001,
        position_sigma_m=POSITION_SIGMA_M,
        rotation_sigma_rad=ROTATION_SIGMA_RAD,
    )
    matrix = np.array([[rng.uniform(1000, 1150), 0.0, 640.0], [0.0, 0.0, 360.0], [0.0, 0.0, 1.0]])
    matrix[1, 1] = matrix[0, 0]
    distortion = np.array([rng.uniform(-0.12, 0.12), rng.uniform(-0.05, 0.05)])
    return PlaneView(size_px=SIZE_PX, source=pose, lens=Lens(matrix=matrix, distortion=distortion, focal_sigma=0.001))


def _from_points(view: PlaneView, rng: np.random.Generator) -> PlaneView:
    """Return the view of a user who has read four points of the plane in the picture."""
    corners = np.array([[-0.3, -0.22], [0.3, -0.22], [0.3, 0.22], [-0.3, 0.22]])
    pairs = PointPairs(
        points_px=to_picture_px(view, corners), points_m=corners, sigma_px=POINTS_SIGMA_PX, sigma_m=0.0005
    )
    return replace(view, source=pairs.drawn(rng))


def _motion(
    name: str, rng: np.random.Generator
) -> tuple[Callable[[float], tuple[FloatArray, float]], dict[str, float], float, dict[str, object]]:
    """Return place [m] and rotation [rad] at a time, the truth, the duration [s], and what the view states of it."""
    motion, release = video_task(name).motion, float(rng.uniform(0.2, 0.4))
    if motion in (Motion.SLIDE, Motion.FALL):
        is_slide = motion is Motion.SLIDE
        a = float(rng.uniform(1.0, 4.0) if is_slide else rng.uniform(4.0, 9.81))
        tilt = float(rng.uniform(0.4, 0.6)) if is_slide else 0.5 * np.pi
        direction = np.array([-np.cos(tilt), -np.sin(tilt)])
        reach = 0.4
        lasts = float(np.sqrt(2.0 * reach / a))

        def straight(time_s: float) -> tuple[FloatArray, float]:
            since = min(max(0.0, time_s - release), lasts)
            return direction * (0.5 * a * since**2 - 0.5 * reach), tilt

        return straight, {"a_m_s2": a}, release + lasts + 0.2, {}
    if motion is Motion.TURN:
        rate = float(rng.uniform(1.0, 2.5))

        def turning(time_s: float) -> tuple[FloatArray, float]:
            since = max(0.0, time_s - release)
            angle = rate * (0.5 * since**2 / 0.4 if since < 0.4 else since - 0.2)
            return 0.074 * np.array([-np.cos(angle), -np.sin(angle)]), angle

        return turning, {"de_n": 0.0}, release + 1.5, {}
    pivot = np.array([0.0, 0.18])
    if motion is Motion.PENDULUM:
        period, damping, swing = (
            float(rng.uniform(0.9, 1.5)),
            float(rng.uniform(0.0, 0.1)),
            float(rng.uniform(0.3, 0.9)),
        )

        def swinging(time_s: float) -> tuple[FloatArray, float]:
            angle = swing * np.exp(-damping * time_s) * np.cos(2.0 * np.pi * time_s / period)
            return pivot + 0.27 * np.array([np.sin(angle), -np.cos(angle)]), 0.0

        return swinging, {"pd_s": period}, 3.0, {"pivot_m": pivot, "pivot_sigma_m": 0.001}
    length, mte = 0.138, float(rng.uniform(0.5, 0.95))
    ratios = mte * np.array([1.04, 0.96])
    peaks = np.arccos(1.0 - ratios**2 * video_task(name).release_height_m / length)
    pivot = np.array([0.0, 0.07])

    def outgoing(time_s: float) -> tuple[FloatArray, float]:
        angle = 0.0
        for number, peak in enumerate(peaks):
            since = time_s - 0.4 - 0.9 * number
            if 0.0 < since < 0.4:
                angle = float(peak * np.sin(np.pi * since / 0.4))
        return pivot + length * np.array([np.sin(angle), -np.cos(angle)]), 0.0

    return outgoing, {"mte": mte}, 2.0, {"pivot_m": pivot, "pivot_sigma_m": 0.0005, "length_m": length}
