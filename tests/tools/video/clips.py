"""Draw clips with known motion: simple scenes on the grid of the first frames, with blur, noise and compression."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from gauge_envs.tools.video import Track, score
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX, MotionKind, video_task

SHIFT = 4
"""Bits of the pixel fractions in OpenCV: 1/16 px."""

EXPOSURES = 4
"""Number of averaged pictures per frame, over half of its time."""

RAMP_S = 0.4
"""Acceleration time of a turntable [s]."""


@dataclass(frozen=True)
class Clip:
    """Frames in blue, green and red, and the true values of the metrics."""

    task: str
    frames: list[np.ndarray]
    fps: float
    truth: dict[str, float]


def clip(name, rng, *, fps=30.0, calibration_sigma=0.0):
    """Return a clip of a task with random constants, a release between two frames, and the truth.

    `calibration_sigma` is the relative standard deviation of the true size of a pixel from the nominal size.
    """
    task = video_task(name)
    place, truth, duration_s = motion_on_grid(task, rng)
    share = 1.0 + rng.normal(0.0, calibration_sigma)
    powers = {"acceleration_m_s2": 1.0, "mte": 0.5}
    truth = {
        metric: value * share ** powers.get(metric, 0.0)
        for metric, value in truth.items()
    }
    scene = _scene(task, rng)
    frames = []
    sheet = rng.normal(0.0, 3.0, scene.shape)
    for number in range(int(duration_s * fps)):
        exposed = np.zeros(scene.shape, dtype=np.float64)
        for part in range(EXPOSURES):
            time_s = (number + (part - 0.5 * (EXPOSURES - 1)) / EXPOSURES * 0.5) / fps
            picture = scene.copy()
            _draw(task, picture, *place(time_s))
            exposed += picture
        # Shifting one sheet of grain is faster than drawing a new one for each frame.
        grain = np.roll(sheet, rng.integers(0, 400, 2), axis=(0, 1))
        frame = np.clip(exposed / EXPOSURES + grain, 0, 255).astype(np.uint8)
        _, packed = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 80])
        frames.append(cv2.imdecode(packed, cv2.IMREAD_COLOR))
    return Clip(task=name, frames=frames, fps=fps, truth=truth)


def scored(frames, fps, task):
    """Return the score of frames in a lossless film."""
    with TemporaryDirectory() as folder:
        return score(written(frames, Path(folder, "film.avi"), fps, "FFV1"), None, task)


def written(frames, path, fps=30.0, code="mp4v"):
    """Write frames as a film, and return its path."""
    size = frames[0].shape[1::-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), fps, size)
    for frame in frames:
        writer.write(np.ascontiguousarray(frame))
    writer.release()
    return path


# --- motions: numbers over time, of a scalar or an array ----------------------------------------------------------


def slid_m(times_s, release_s, a, duration_s, bounce=0.0):
    """Return the displacement from rest with constant acceleration until an end, where a ball may bounce."""
    since = np.clip(times_s - release_s, 0.0, duration_s)
    late = np.maximum(times_s - release_s - duration_s, 0.0)
    displacement = 0.5 * a * since**2
    if bounce:
        back = bounce * a * duration_s * late - 0.5 * a * late**2
        displacement = np.where(
            late > 0.0, np.maximum(displacement - back, 0.0), displacement
        )
    return displacement


def turned_rad(times_s, release_s, rate):
    """Return the angle of a plate that accelerates slowly: a sudden start would exceed the friction."""
    since = np.maximum(times_s - release_s, 0.0)
    ramp = np.minimum(since, RAMP_S)
    return rate * (0.5 * ramp**2 / RAMP_S + since - ramp)


def swung_rad(times_s, amplitude, damping, period):
    phase = 2.0 * np.pi * times_s / period
    return amplitude * np.exp(-damping * times_s) * np.cos(phase)


def struck_rad(times_s, peaks):
    """Return swings of 0.4 s that begin every 0.9 s."""
    angle = 0.0 * times_s
    for number, peak in enumerate(peaks):
        since = np.clip(times_s - 0.4 - 0.9 * number, 0.0, 0.4)
        angle = angle + peak * np.sin(np.pi * since / 0.4)
    return angle


def motion_on_grid(task, rng):
    """Return the place and rotation of the object at a time, the truth, and the duration [s]."""
    start, scale = np.array(task.centre_px), task.scale_m_per_px
    release = float(rng.uniform(0.2, 0.5))
    if task.motion in (MotionKind.SLIDE, MotionKind.FALL):
        is_slide = task.motion is MotionKind.SLIDE
        a = float(rng.uniform(0.6, 4.0) if is_slide else rng.uniform(1.0, 9.81))
        lasts = (2.0 * (0.38 if is_slide else 0.44) / a) ** 0.5
        direction = np.array(task.direction)

        def straight(time_s):
            bounce = 0.0 if is_slide else 0.6
            displacement = slid_m(time_s, release, a, lasts, bounce)
            return start + direction * displacement / scale, 31.6

        rest = 0.3 if is_slide else 0.2
        return straight, {"acceleration_m_s2": a}, release + lasts + rest
    pivot = np.array(task.pivot_px)
    if task.motion is MotionKind.TURN:
        rate = float(rng.uniform(1.0, 2.5))

        def turning(time_s):
            angle = turned_rad(time_s, release, rate)
            c, s = np.cos(angle), np.sin(angle)
            rotation = np.array([[c, -s], [s, c]])
            return pivot + rotation @ (start - pivot), -float(np.degrees(angle))

        return turning, {"de": 0.0}, release + 1.5
    if task.motion is MotionKind.PENDULUM:
        period, damping = float(rng.uniform(0.8, 2.2)), float(rng.uniform(0.0, 0.2))
        amplitude = float(np.arctan2(*(start - pivot)))
        length = float(np.linalg.norm(start - pivot))
        truth, duration_s = {"pd": period, "r2": 1.0}, 4.0

        def angle_at(time_s):
            return swung_rad(time_s, amplitude, damping, period)

    else:
        length = float(np.linalg.norm(np.array(task.rest_px) - pivot))
        ratios = float(rng.uniform(0.3, 0.95)) * np.array([1.1, 0.9])
        peaks = np.arccos(1.0 - ratios**2 * task.release_height_m / scale / length)
        truth, duration_s = {"mte": float(ratios.mean())}, 2.0

        def angle_at(time_s):
            return struck_rad(time_s, peaks)

    def swinging(time_s):
        angle = angle_at(time_s)
        return pivot + length * np.array([np.sin(angle), np.cos(angle)]), 0.0

    return swinging, truth, duration_s


def _scene(task, rng):
    """Return the surroundings of the object in the first frames, in plain colours with some texture."""
    width, height = REFERENCE_SIZE_PX
    is_dark = (
        task.id in ("SlopeSlider-2-wood", "SlopeSlider-2-metal")
        or task.motion is MotionKind.TURN
    )
    scene = np.full((height, width, 3), 30 if is_dark else 205, dtype=np.uint8)
    if task.motion is MotionKind.SLIDE:
        cv2.line(scene, (670, 72), (150, 392), (150, 185, 215), 16, cv2.LINE_AA)
    elif task.motion is MotionKind.FALL:
        cv2.rectangle(scene, (230, 410), (640, 445), (120, 170, 215), -1)
    elif task.motion is MotionKind.TURN:
        centre = tuple(int(value) for value in task.pivot_px or (0, 0))
        # The tint distinguishes metal from the plate.
        plate = (140, 165, 185) if task.is_shiny else (185, 205, 215)
        cv2.circle(scene, centre, 225, plate, -1, cv2.LINE_AA)
    elif task.motion is MotionKind.PENDULUM:
        cv2.rectangle(scene, (400, 50), (426, 440), (28, 28, 28), -1)
        cv2.rectangle(scene, (0, 330), (width, height), (35, 35, 35), -1)
        # The holes of the table show that the camera is fixed.
        scene[350:480:20, 10:380:20] = scene[350:480:20, 450:820:20] = 90
    else:
        cv2.rectangle(scene, (0, 275), (width, height), (95, 95, 95), -1)
        for x in (367.0, 404.0, 440.5):
            _disk(scene, np.array([x, 347.0]), 18.6, (25, 25, 25))
    texture = cv2.GaussianBlur(rng.normal(0.0, 60.0, scene.shape), (0, 0), 5)
    return np.clip(scene + texture, 0, 255).astype(np.uint8)


def _draw(task, picture, place, angle_deg):
    if task.motion in (MotionKind.SLIDE, MotionKind.TURN):
        colour = {
            "wood": (105, 150, 195),
            "plastic": (40, 35, 25),
            "metal": (190, 185, 190),
        }[task.id.rsplit("-", 1)[1]]
        half = 0.5 * task.size_px
        corners = cv2.boxPoints(((0.0, 0.0), (2 * half, 2 * half), -angle_deg))
        points = np.round((corners + place) * (1 << SHIFT)).astype(np.int32)
        cv2.fillPoly(picture, [points], colour, cv2.LINE_AA, SHIFT)
        inner = np.round((0.5 * corners + place) * (1 << SHIFT)).astype(np.int32)
        cv2.polylines(picture, [inner[:3]], False, (60, 60, 90), 2, cv2.LINE_AA, SHIFT)
        return
    _disk(picture, place, 0.5 * task.size_px, (22, 22, 22))


def track_of(places_px, fps):
    """Return a track with a place on the reference grid in each frame."""
    frames = np.arange(len(places_px))
    ones, zeros = np.ones(len(places_px)), np.zeros(len(places_px))
    return Track(
        frames=frames,
        times_s=frames / fps,
        fps=fps,
        points_px=places_px,
        confidence=ones,
        misfit=zeros,
        other_likeness=zeros,
    )


def driven(name, a_m_s2, *, fps=30.0, release_s=10.3 / 30.0):
    """Return a track of 40 frames from rest with constant acceleration along the direction of a task."""
    task = video_task(name)
    since_s = np.maximum(np.arange(40) / fps - release_s, 0.0)[:, None]
    along_px = 0.5 * a_m_s2 * since_s**2 / task.scale_m_per_px
    return track_of(task.centre_px + along_px * np.array(task.direction), fps)


def _disk(picture, place, radius, colour):
    centre = tuple(round(value * (1 << SHIFT)) for value in place)
    cv2.circle(
        picture, centre, round(radius * (1 << SHIFT)), colour, -1, cv2.LINE_AA, SHIFT
    )
