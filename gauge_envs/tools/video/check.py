"""Look at a film of one's own before anything is measured: what its first frame shows, and what to mend."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import VideoError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.board import SQUARES, BoardPose
from gauge_envs.tools.video.frames import Frames, Picture, cv2
from gauge_envs.tools.video.phone_films import FrontalFilm, box_corners
from gauge_envs.tools.video.plane import CameraFile

LEAST_SQUARE_PX = 15.0
"""Edge of a square of the board in the first frame [px]: the marker of 6 x 6 cells fills three quarters of it."""

MOST_BLUR = 0.1
"""Largest blur of its edges, as the standard deviation of a Gaussian, in squares."""

MOST_ROLL_DEG = 2.0
"""Turn of the board in the picture. A board that is off level by it changes a friction near 0.13 by 0.04."""

MOST_YAW_DEG = 15.0
"""Turn of the board about the vertical against the camera."""

MOST_AWAY = 6.0
"""Distance of the object from the middle of the board, in half widths of the board; films up to 5.2 were tried."""

MOST_SCALE_SIGMA = 0.005
"""Largest standard uncertainty of the scale in the plane of the motion by the focal length."""

AXIS_M = 0.1
"""Length of the axes that are drawn on the board [m]."""

CHANGED = 40.0
"""Change of the brightest channel with which a place of the first frame shows the object."""

LATER_FRAMES = 25
"""Last frames of a film, by whose median the object is seen to have left its place."""

LEAST_OBJECT_PX = 30
"""Fewest pixels of an object on the frontal grid."""

GREEN, RED = (60, 200, 60), (40, 40, 230)
"""Colours of the board and the object: blue, green, red."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a film shows of one thing.

    Attributes:
        name: The thing.
        text: What was found, with numbers.
        advice: What to mend; empty when nothing is.
    """

    name: str
    text: str
    advice: str = ""


Box = Sequence[float]
"""Left, top, width and height [px]."""


def check_film(
    source: Frames, camera: CameraFile, box_px: Box | None = None
) -> tuple[list[Finding], Picture]:
    """Return what a film shows before anything is measured, and its first frame with that drawn in.

    Args:
        source: The film.
        camera: The camera file.
        box_px: Box around the object in the first frame; where something moves away from if None.
    """
    picture = next(source.native()).copy()
    frame_count = sum(1 for _ in source.native())
    width, height = source.size_px
    text = f"{width} x {height} pixels, {frame_count} frames, {source.fps:.4g} a second as stated"
    findings = [Finding(name="film", text=text)]
    try:
        film = FrontalFilm(source, camera)
    except VideoError as error:
        fault = str(error).removeprefix(f"{source.name}: ")
        findings.append(Finding(name="board", text="it cannot be placed", advice=fault))
        return findings, picture
    findings += _board_findings(picture, film)
    is_proposed = box_px is None
    box = moved_box(film) if box_px is None else box_px
    findings += _object_findings(film, box, is_proposed=is_proposed)
    _draw(picture, film.first, box)
    return findings, picture


def _board_findings(picture: Picture, film: FrontalFilm) -> list[Finding]:
    """Return what the first frame shows of the board."""
    first, board = film.first, film.first.board
    places_m, places_px = first.corners
    poses = film.poses
    seen = sum(pose is not None for pose in poses)
    corner_count = int((SQUARES - 1).prod())
    blur_px = edge_blur_px(picture, places_px)
    roll, yaw, pitch = board_angles_deg(first)
    distance_m = first.distance_m
    focal_px = first.lens.matrix[0][0]
    square_px = board.square_m * focal_px / distance_m
    field_deg = math.degrees(2.0 * math.atan(0.5 * picture.shape[1] / focal_px))
    return [
        Finding(
            name="board",
            text=f"{len(places_m)} of {corner_count} corners in the first frame; {seen} of {len(poses)} frames show it",
        ),
        Finding(
            name="square",
            text=f"{square_px:.0f} px; edges blurred by {blur_px:.1f} px",
            advice="go nearer, or print larger squares"
            if square_px < LEAST_SQUARE_PX
            else "focus, and give more light"
            if blur_px > MOST_BLUR * square_px
            else "",
        ),
        Finding(
            name="camera",
            text=f"{distance_m:.2f} m away; its picture is {field_deg:.0f} degrees wide, its focal length uncertain by "
            f"{first.focal_sigma:.0%}",
            advice="state its [lens], or let it look from the side"
            if board.offset_m * first.focal_sigma > MOST_SCALE_SIGMA * distance_m
            else "",
        ),
        Finding(
            name="level",
            text=f"the board is turned by {roll:.1f} degrees in the picture"
            + (
                ": is the camera turned, or the board, whose upper edge must be level?"
                if abs(roll) > MOST_ROLL_DEG
                else ""
            ),
        ),
        Finding(
            name="parallel",
            text=f"the camera looks at it from {abs(yaw):.0f} degrees to the {'right' if yaw > 0.0 else 'left'} and "
            f"{abs(pitch):.0f} degrees {'above' if pitch > 0.0 else 'below'}"
            + (
                ": if it faces the motion, the board is not parallel to it"
                if abs(yaw) > MOST_YAW_DEG
                else ""
            ),
        ),
    ]


def _object_findings(
    film: FrontalFilm, box_px: Box | None, *, is_proposed: bool
) -> list[Finding]:
    """Return what the first frame shows of the object."""
    if box_px is None:
        advice = "state the box around the object with --object"
        return [
            Finding(
                name="object", text="nothing moves away from its place", advice=advice
            )
        ]
    places_m = film.first.to_plane_m(box_corners(box_px))
    low, high = places_m.min(axis=0), places_m.max(axis=0)
    size_mm, centre_m = 1e3 * (high - low), 0.5 * (low + high)
    box = ",".join(f"{value:.0f}" for value in box_px)
    asked = ": is this the object, whole and alone?" if is_proposed else ""
    size_px = 1e-3 * size_mm.mean() / film.scale
    right_mm, up_mm = 1e3 * centre_m
    away_m = float(np.linalg.norm(centre_m))
    half_width_m = 0.5 * SQUARES[0] * film.first.board.square_m
    return [
        Finding(
            name="object",
            text=f"--object {box}, {size_mm[0]:.0f} x {size_mm[1]:.0f} mm, {size_px:.0f} px when judged{asked}",
        ),
        Finding(
            name="side",
            text=f"{right_mm:+.0f} mm to the right and {up_mm:+.0f} mm up from the middle of the board",
            advice="bring the board nearer to the motion, or print a larger one"
            if away_m > MOST_AWAY * half_width_m
            else "",
        ),
    ]


def edge_blur_px(picture: Picture, corners_px: FloatArray) -> float:
    """Return the blur of the edges of the board as the standard deviation of a Gaussian [px].

    A step of height h that is blurred has the slope h / (s sqrt(2 pi)) in its middle.

    Args:
        picture: The picture, shape [height, width, 3].
        corners_px: Corners of the board [px], shape [count, 2].
    """
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
    low = np.maximum(np.floor(corners_px.min(axis=0)).astype(int), 0)
    high = np.ceil(corners_px.max(axis=0)).astype(int)
    part = grey[low[1] : high[1], low[0] : high[0]]
    dark, bright = np.percentile(part, [5.0, 95.0])
    slope = np.hypot(*np.gradient(part))
    steepest = float(np.percentile(slope, 97.0))
    return float(bright - dark) / (math.sqrt(2.0 * math.pi) * max(steepest, 1e-6))


def board_angles_deg(pose: BoardPose) -> tuple[float, float, float]:
    """Return how a board is turned: in the picture clockwise, and where the camera is, to its right and above it [deg].

    Args:
        pose: How a frame sees the board.
    """
    rotation, _ = cv2.Rodrigues(pose.rotation_rad)
    # The board points to the right, up and towards the camera; the camera to the right, down and away.
    (pitch, yaw, roll), *_ = cv2.RQDecomp3x3(rotation @ np.diag([1.0, -1.0, -1.0]))
    return roll, yaw, pitch


def moved_box(film: FrontalFilm) -> tuple[float, ...] | None:
    """Return the box in the first frame around what is elsewhere at the end of a film; None where nothing is.

    The board is left out: it lies behind the plane of the motion, so that it moves with a camera held by hand.
    """
    pictures = film.native()
    first = next(pictures).astype(np.float32)
    later = deque(pictures, maxlen=LATER_FRAMES)
    if not later:
        return None
    change = np.abs(first - np.median(np.stack(later), axis=0)).max(axis=2)
    is_changed = (change > CHANGED).astype(np.uint8)
    corners = film.to_grid_px(film.first.corners[1])
    middle = corners.mean(axis=0)
    # The inner corners span two squares less than the board; a third one is its paper.
    outline = middle + (corners - middle) * ((SQUARES + 1) / (SQUARES - 2))
    hull = cv2.convexHull(outline.round().astype(np.int32))
    cv2.fillConvexPoly(is_changed, hull, 0)
    # Thin rods and wires go, and what is broader stays.
    is_changed = cv2.morphologyEx(is_changed, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(is_changed)
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    is_object = labels == largest
    if is_object.sum() < LEAST_OBJECT_PX:
        return None
    # Blurred edges end where half of the change is left.
    is_object &= change > 0.5 * np.percentile(change[is_object], 90.0)
    left, top, width, height = cv2.boundingRect(is_object.astype(np.uint8))
    places = film.to_picture_px(box_corners((left, top, width, height)))
    low, high = places.min(axis=0), places.max(axis=0)
    return (*low.tolist(), *(high - low).tolist())


def picture_bytes(picture: Picture) -> bytes:
    """Return a picture as PNG."""
    return bytes(cv2.imencode(".png", picture)[1])


def _draw(picture: Picture, first: BoardPose, box_px: Box | None) -> None:
    """Draw the corners of the board, axes from its middle to the right, up and off it, and the box of the object."""
    thick = max(1, picture.shape[1] // 640)
    seen = first.corners[1][:, None].astype(np.float32)
    cv2.aruco.drawDetectedCornersCharuco(picture, seen, cornerColor=GREEN)
    pose = (*first.lens.coefficients, first.rotation_rad, first.translation_m)
    cv2.drawFrameAxes(picture, *pose, AXIS_M, 2 * thick)
    if box_px is not None:
        corners = box_corners(box_px).round().astype(int)
        cv2.rectangle(picture, corners[0].tolist(), corners[2].tolist(), RED, 2 * thick)
