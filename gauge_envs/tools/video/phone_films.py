"""Judge a film of a phone: a frontal picture of the plane of motion, made by a board in the film.

With a ChArUco board in every frame the camera may be held by hand: its lens follows from the film, and its pose from
each frame. What is judged is the object in a box of the first frame.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError, UnknownNameError, VideoError
from gauge_envs.evaluation.estimators import restitution_of_flights, slide_friction
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video import laws
from gauge_envs.tools.video.board import board_poses, outer_corners
from gauge_envs.tools.video.frames import Frames, Picture, cv2
from gauge_envs.tools.video.plane import Calibration, CameraFile, main_direction
from gauge_envs.tools.video.scoring import (
    VideoScore,
    score_track,
    swing_of,
)
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    Motion,
    VideoTask,
    video_task,
)
from gauge_envs.tools.video.track import Track
from gauge_envs.tools.video.tracker import track_object

SLOPE = "SlopeSlider-2-wood"
MOTIONS = {
    "slide": SLOPE,
    "roll": SLOPE,
    "fall": "BouncingBall-rubber",
    "pendulum": "Pendulum-metal",
}
"""Tasks whose laws judge films of a phone, by the name of the motion."""

MOST_COARSE = 1.5
"""Largest size of a pixel of the frontal picture, in pixels of the reference grid at the middle of the film."""

LEVEL_SIGMA_RAD = math.radians(0.3)
"""Standard uncertainty of the slope of a slide: that of a level, or of the upper edge of the board."""

LEAST_FALL, REACH = 0.05, 4
"""Share of the drop that a fall and a rebound have at least, and frames beside an impact in which it shows."""

DRAWS = 40
"""Simulated tracks from which the interval of a material's constant is taken."""

MOST_GRAVITY = 0.2
"""Largest share by which the gravity of a fall or a swing differs: a swing of a radian takes 0.12."""

MOST_SLOPE_DEG = 1.5
"""Largest difference of the slope of a motion beside the board from the stated one: five times that of a level."""

LEAST_FLIGHT = 5
"""Fewest frames of a flight between two impacts."""


def box_corners(box_px: Sequence[float]) -> FloatArray:
    """Return the corners of a box of left, top, width and height [px], around it, shape [4, 2]."""
    left, top, width, height = box_px
    right, bottom = left + width, top + height
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def _area(corners: FloatArray) -> float:
    """Return the area that points span, shape [count, 2]."""
    return float(cv2.contourArea(cv2.convexHull(corners.astype(np.float32))))


class FrontalFilm(Frames):
    """Frontal picture of the plane of motion in a film, on the reference grid.

    Args:
        source: The film.
        camera: The camera file.

    Attributes:
        motion: What the camera file says of the motion.
        poses: How each frame sees the board; None where it does not.
        first: How the first frame sees it.
        calibration: By which points of the plane it places the frontal picture.
    """

    def __init__(self, source: Frames, camera: CameraFile) -> None:
        if source.size_px != camera.size_px:
            raise VideoError(
                f"{source.name}: it has {source.size_px} pixels, and the camera file states {camera.size_px}"
            )
        self.name = source.name
        self.fps = source.fps
        self.size_px = REFERENCE_SIZE_PX
        self._source = source
        self.motion = camera.motion
        self.poses = board_poses(source, camera)
        self.times_s = source.times_s
        if None in self.poses:
            kept = np.array([one is not None for one in self.poses])
            rated_s = np.arange(len(kept)) / self.fps
            self.times_s = (rated_s if self.times_s is None else self.times_s)[kept]
        first = self.poses[0]
        assert first is not None
        self.first = first
        width, height = source.size_px
        border = np.array(
            [[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]]
        ) * (width, height)
        places_m = first.to_plane_m(border)
        extent_m = places_m.max(axis=0) - places_m.min(axis=0)
        # What a slanted view shows far away would leave few pixels for the rest.
        pixel = box_corners((0.5 * width, 0.5 * height, 1.0, 1.0))
        m_per_px = math.sqrt(_area(first.to_plane_m(pixel)))
        finest_m_per_px = m_per_px * width / REFERENCE_SIZE_PX[0]
        whole_m_per_px = float((extent_m / REFERENCE_SIZE_PX).max())
        self.scale = min(whole_m_per_px, MOST_COARSE * finest_m_per_px)
        self._blur_px = (
            0.4 * self.scale / finest_m_per_px * width / REFERENCE_SIZE_PX[0]
        )
        middle_m = first.to_plane_m(border.mean(axis=0, keepdims=True))[0]
        self._origin_px = (
            0.5 * np.array(REFERENCE_SIZE_PX) - middle_m * (1.0, -1.0) / self.scale
        )
        corners_m, sigma_m = outer_corners(first)
        self.calibration = Calibration(
            points_px=self._on_grid_px(corners_m), sigma_px=sigma_m / self.scale
        )
        self._canvas: Picture = np.zeros((*REFERENCE_SIZE_PX[::-1], 3), np.uint8)
        # What a moving camera uncovers is seen from the start, so that the scene stays the same.
        for _ in self.native():
            pass

    def native(self) -> Iterator[Picture]:
        """Yield the frontal pictures of the frames that show the board; what a frame does not show stays."""
        frontal = np.array(
            [
                [1.0 / self.scale, 0.0, self._origin_px[0]],
                [0.0, -1.0 / self.scale, self._origin_px[1]],
                [0, 0, 1],
            ]
        )
        for pose, picture in zip(self.poses, self._source.native(), strict=True):
            if pose is None:
                continue
            maps = cv2.initUndistortRectifyMap(
                *pose.lens.coefficients,
                pose.to_plane,
                frontal,
                REFERENCE_SIZE_PX,
                cv2.CV_32FC1,
            )
            smooth = (
                cv2.GaussianBlur(picture, (0, 0), self._blur_px)
                if self._blur_px > 0.5
                else picture
            )
            cv2.remap(
                smooth,
                *maps,
                cv2.INTER_LINEAR,
                dst=self._canvas,
                borderMode=cv2.BORDER_TRANSPARENT,
            )
            yield self._canvas.copy()

    def to_grid_px(self, points_px: FloatArray) -> FloatArray:
        """Return places on the frontal grid of places in the first frame [px], both of shape [count, 2]."""
        return self._on_grid_px(self.first.to_plane_m(points_px))

    def to_picture_px(self, points_px: FloatArray) -> FloatArray:
        """Return places in the first frame of places on the frontal grid [px], both of shape [count, 2]."""
        return self.first.to_picture_px(self._in_plane_m(points_px))

    def in_plane(self, track: Track) -> Track:
        """Return a track of the frontal film in millimetres of the plane of motion, from the pivot of a swing."""
        pivot_m = self.motion.pivot_m or (0.0, 0.0)
        places_m = self._in_plane_m(track.points_px) - pivot_m
        return replace(track, points_px=1e3 * places_m, is_metric=True)

    def task(self, motion: str, box_px: Sequence[float]) -> VideoTask:
        """Return the task of an object in a box of the first frame: left, top, width and height [px]."""
        if motion not in MOTIONS:
            raise UnknownNameError("motion of a film", motion, list(MOTIONS))
        places = self.to_grid_px(box_corners(box_px))
        size = math.sqrt(_area(places))
        centre, swing = places.mean(axis=0), self.motion
        pivot_px = None
        if swing.pivot_m is not None:
            x, y = self._on_grid_px(np.array([swing.pivot_m]))[0]
            pivot_px = (float(x), float(y))
        elif motion == "pendulum":
            raise VideoError(
                f"{self.name}: a swing needs motion.pivot_m in the camera file: the pivot about which it swings"
            )
        return replace(
            video_task(MOTIONS[motion]),
            id=motion,
            size_m=size * self.scale,
            size_px=size,
            centre_px=(float(centre[0]), float(centre[1])),
            pivot_px=pivot_px,
            pivot_sigma_px=(swing.pivot_sigma_m or 0.0) / self.scale,
            law={},
        )

    def _on_grid_px(self, places_m: FloatArray) -> FloatArray:
        """Return places on the frontal grid [px] of places in the plane [m], both of shape [count, 2]."""
        return places_m * (1.0, -1.0) / self.scale + self._origin_px

    def _in_plane_m(self, points_px: FloatArray) -> FloatArray:
        """Return places in the plane [m] of places on the frontal grid [px], both of shape [count, 2]."""
        return (points_px - self._origin_px) * (self.scale, -self.scale)


def score_phone_film(
    film: FrontalFilm,
    motion: str,
    box_px: Sequence[float],
    *,
    angle_deg: float | None = None,
) -> VideoScore:
    """Follow the object in a box of the first frame, and judge its motion with what it says of the material.

    Args:
        film: The film.
        motion: `slide`, `roll`, `fall` or `pendulum`.
        box_px: Left, top, width and height of the box [px].
        angle_deg: Slope of a slide or roll [degrees]; that of its motion in the plane if None.

    Returns:
        The result; its track is on the grid of the frontal film. It is not sound if it has another gravity than the
        Earth's, or a constant that no material has: the rate or the calibration is wrong.
    """
    task = film.task(motion, box_px)
    inertia = film.motion.inertia_factor
    if (motion == "roll") != (inertia is not None):
        raise VideoError(
            f"{film.name}: a roll, and no other motion, needs motion.inertia_factor in the camera file"
        )
    track = track_object(film, task)
    if task.motion is Motion.SLIDE and track.is_found.any():
        task = replace(task, direction=main_direction(track))
    result = score_track(track, task, name=film.name, calibration=film.calibration)
    if result.interval_frames is None:
        return result
    if task.motion is Motion.SLIDE:
        name = "friction" if inertia is None else "rolling_resistance"
        value, interval = resistance(result, task, angle_deg, inertia or 0.0)
    else:
        name = "restitution" if task.motion is Motion.FALL else "damping_per_s"
        value, interval = _drawn(result, task, film.calibration)
    gravity = (
        result.metrics["acceleration_m_s2"]
        if task.motion is Motion.FALL
        else laws.GRAVITY_M_PER_S2
    )
    if task.pivot_px is not None and (period_s := result.metrics["pd"]):
        arms_px = track.points_px[track.is_found] - task.pivot_px
        length_m = film.scale * float(np.linalg.norm(arms_px, axis=1).mean())
        gravity = (2.0 * math.pi / period_s) ** 2 * length_m
    faults = [f"{name} is below 0"] if interval and interval[1] < 0.0 else []
    if (
        gravity is not None
        and abs(gravity / laws.GRAVITY_M_PER_S2 - 1.0) > MOST_GRAVITY
    ):
        faults.append(f"gravity is {gravity:.3g} m/s^2")
    reasons = [
        f"{one}: give --fps of the camera if the film is in slow motion, and check the camera file"
        for one in faults
    ]
    if task.motion is Motion.SLIDE and angle_deg is not None:
        slope_deg = math.degrees(_slope_rad(task))
        if abs(slope_deg - angle_deg) > MOST_SLOPE_DEG:
            reasons.append(
                f"the motion descends by {slope_deg:.1f} degrees beside the board, and --angle states {angle_deg:g}: "
                "is the board level, upright and parallel to the motion?"
            )
    return replace(
        result,
        is_sound=result.is_sound and not reasons,
        reasons=(*reasons, *result.reasons),
        metrics={**result.metrics, name: value},
        uncertainty={**result.uncertainty, name: interval},
    )


Estimate: TypeAlias = tuple[float | None, tuple[float, float] | None]
"""A value and its interval of 95 %; None where the film does not show it."""


def resistance(
    result: VideoScore, task: VideoTask, angle_deg: float | None, inertia_factor: float
) -> Estimate:
    """Return the friction of a slide, or the rolling resistance of a body that rolls without slip, on its slope."""
    a, ends = (
        result.metrics["acceleration_m_s2"],
        result.uncertainty["acceleration_m_s2"],
    )
    if a is None or ends is None:
        return None, None
    angle = _slope_rad(task) if angle_deg is None else math.radians(angle_deg)

    # A body that rolls has the inertia m (1 + k): it slides like one under the gravity g / (1 + k).
    gravity = laws.GRAVITY_M_PER_S2 / (1.0 + inertia_factor)

    def friction(a_m_s2: float, more_rad: float = 0.0) -> float:
        return slide_friction(a_m_s2, angle + more_rad, gravity_m_per_s2=gravity)

    tilt = 1.96 * abs(friction(a, LEVEL_SIGMA_RAD) - friction(a))
    below, above = friction(a) - friction(ends[1]), friction(ends[0]) - friction(a)
    return friction(a), (
        friction(a) - math.hypot(below, tilt),
        friction(a) + math.hypot(above, tilt),
    )


def _slope_rad(task: VideoTask) -> float:
    """Return the slope of a motion in the plane [rad]; the direction of a picture has its second part down."""
    assert task.direction is not None
    return math.atan2(task.direction[1], abs(task.direction[0]))


def _drawn(result: VideoScore, task: VideoTask, calibration: Calibration) -> Estimate:
    """Return the restitution of a drop or the damping of a swing over simulated noise and calibrations."""
    from scipy.stats import median_abs_deviation

    assert result.interval_frames is not None
    track = result.track
    first, last = np.searchsorted(track.frames, result.interval_frames)
    rng, noise = np.random.default_rng(0), track.noise_px((first, last))

    found = {**result.metrics, **result.details}
    known = {name: value for name, value in found.items() if value is not None}
    if not known:
        return None, None

    def judged(points_px: FloatArray) -> float:
        sample = replace(track, points_px=points_px)
        swing = swing_of(sample, task, (first, last), known)
        return restitution(sample, task) if swing is None else swing.damping_per_s

    try:
        values = [judged(track.points_px)]
        for _ in range(DRAWS):
            moved_px = calibration.drawn(rng.normal(track.points_px, noise), rng)
            values.append(judged(moved_px + rng.normal(0.0, task.pivot_sigma_px, 2)))
    except ParameterError:
        return None, None
    # A few draws in which an impact is missed say nothing of the others: the scatter is that of the middle ones.
    half = 1.96 * float(median_abs_deviation(values[1:], scale="normal"))
    return values[0], (values[0] - half, values[0] + half)


def restitution(track: Track, task: VideoTask) -> float:
    """Return the mean ratio of the speeds after and before the impacts of a ball; see `restitution_of_flights`."""
    rows = np.flatnonzero(track.is_found)
    heights_m = -task.scale_m_per_px * track.points_px[rows, 1]
    flights = _flights(heights_m)
    if len(flights) < 2:
        raise ParameterError(
            f"restitution: two flights of {LEAST_FLIGHT} frames are needed"
        )
    return restitution_of_flights(track.times_s[rows], heights_m, flights)


def _flights(heights_m: FloatArray) -> list[NDArray[np.intp]]:
    """Return the samples of each flight of a ball between its impacts, up to the first flight that is too short."""
    from scipy.signal import find_peaks

    drop_m = float(np.ptp(heights_m))
    start = int(np.flatnonzero(heights_m < heights_m[0] - LEAST_FALL * drop_m)[0])
    impacts, _ = find_peaks(
        -heights_m[start:], prominence=LEAST_FALL * drop_m, wlen=2 * REACH + 1
    )
    cuts = [start - 2, *(start + impacts), len(heights_m) + 1]
    flights = []
    for low, high in pairwise(cuts):
        # The frames beside an impact may be exposed across it.
        flight = np.arange(low + 2, high - 1)
        if len(flight) < LEAST_FLIGHT:
            break
        flights.append(flight)
    return flights
