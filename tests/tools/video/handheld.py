"""Films of a slide, a roll, a drop and a swing beside a board by a camera held by hand, whose constants are known.

A pinhole camera with distortion moves and turns slowly. The board hangs on a wall, and the motion has its middle 35 mm
before it. Each frame is the mean over its exposure, with noise and MPEG-4 compression.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video.board import SQUARES, charuco

FloatArray = NDArray[np.float64]

SIZE_PX = (1280, 720)
PX_PER_M = 1250.0
WALL_M = np.array([1.9, 1.3])
SQUARE_M, OFFSET_M, OFFSET_SIGMA_M, EDGE_M = 0.035, 0.035, 0.002, 0.05
EXPOSURES = 3
LEVEL_SIGMA_RAD = math.radians(0.3)
G = 9.80665


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A film on disk.

    Attributes:
        video: The film.
        camera: Its camera file.
        box_px: Box around the object in the first frame: left, top, width, height.
        name: What the film tells of the material.
        truth: Its true value.
    """

    video: Path
    camera: Path
    box_px: tuple[float, ...]
    name: str
    truth: float


def shot(motion, seed, folder, *, fps=30.0):
    """Write a film with random constants, camera and light, and return it with the truth.

    Args:
        motion: `slide`, `roll`, `fall` or `pendulum`.
        seed: Seed of all constants.
        folder: Where film and camera file are written.
        fps: Frames per second.
    """
    rng = np.random.default_rng(seed)
    motions = {"fall": _fall, "pendulum": _swing}
    place, name, truth, lasts_s, pivot = (
        motions[motion](rng) if motion in motions else _descent(rng, *DESCENTS[motion])
    )
    camera, focal = _camera(rng, lasts_s), rng.uniform(950.0, 1250.0)
    bent = np.array([rng.uniform(-0.06, 0.06), 0.0, 0.0, 0.0])
    lens = (np.array([[focal, 0.0, 639.5], [0.0, focal, 359.5], [0.0, 0.0, 1.0]]), bent)
    wall, offset = _wall(motion, rng, place), OFFSET_M + rng.normal(0.0, OFFSET_SIGMA_M)
    # Straight rays of all pixels.
    grid = np.stack(
        np.meshgrid(*(np.arange(one, dtype=np.float32) for one in SIZE_PX)), axis=-1
    )
    rays = cv2.undistortPoints(grid.reshape(-1, 1, 2), *lens).reshape(
        *SIZE_PX[::-1], 1, 2
    )
    video = folder / f"{motion}_{seed}.mp4"
    if not video.exists():
        writer = cv2.VideoWriter(
            str(video), cv2.VideoWriter_fourcc(*"mp4v"), fps, SIZE_PX
        )
        grain = rng.normal(0.0, 2.5, (SIZE_PX[1] + 64, SIZE_PX[0] + 64, 3)).astype(
            np.float32
        )
        for number in range(int(lasts_s * fps)):
            total = np.zeros((*SIZE_PX[::-1], 3), np.float32)
            for part in range(EXPOSURES):
                time_s = (number + 0.5 * (part / (EXPOSURES - 1) - 0.5)) / fps
                seen = (*place(time_s), offset, pivot)
                total += _picture(wall, rays, lens, camera(time_s), motion, seen)
            # One sheet of grain is shifted from frame to frame, which is cheaper than a new one.
            x, y = rng.integers(0, 64, 2)
            noisy = total / EXPOSURES + grain[y : y + SIZE_PX[1], x : x + SIZE_PX[0]]
            writer.write(np.clip(noisy, 0, 255).astype(np.uint8))
        writer.release()
    outline = _outline(motion, *place(0.0))
    corners = np.insert(outline, 2, offset + 0.5 * EDGE_M, axis=1)
    seen = cv2.projectPoints(corners, *camera(0.0), *lens)[0]
    low, high = seen[:, 0].min(axis=0), seen[:, 0].max(axis=0)
    toml = folder / f"{motion}_{seed}.toml"
    swing = (
        ""
        if pivot is None
        else f"[motion]\npivot_m = {pivot.tolist()}\npivot_sigma_m = 0.002\n"
    )
    roll = "[motion]\ninertia_factor = 0.4\n" if motion == "roll" else ""
    board = f"[board]\nsquare_m = {SQUARE_M}\noffset_m = {OFFSET_M}\noffset_sigma_m = {OFFSET_SIGMA_M}\n"
    toml.write_text(f"size_px = {list(SIZE_PX)}\n{board}{swing}{roll}")
    return Shot(
        video=video,
        camera=toml,
        box_px=(*low, *(high - low)),
        name=name,
        truth=truth,
    )


# --- motions ---------------------------------------------------------------------------------------------------------

Place = Callable[[float], tuple[FloatArray, float]]
"""Place of the object on its plane, from the middle of the board [m], and its rotation [rad], at a time [s]."""


DESCENTS = {
    "slide": ("friction", (24.0, 34.0), (0.1, 0.35), 1.0),
    "roll": ("rolling_resistance", (8.0, 16.0), (0.0, 0.04), 1.4),
}
"""What a descent tells, ranges of its slope [degrees] and value, and its inertia in that of a slide."""


def _descent(rng, name, slopes_deg, values, inertia):
    slope, truth = math.radians(rng.uniform(*slopes_deg)), rng.uniform(*values)
    a, release = (
        G * (math.sin(slope) - truth * math.cos(slope)) / inertia,
        rng.uniform(0.3, 0.6),
    )
    reach = 0.42
    lasts = math.sqrt(2.0 * reach / a)
    # The board is level within its uncertainty.
    slope += rng.spawn(1)[0].normal(0.0, LEVEL_SIGMA_RAD)
    down = np.array([-math.cos(slope), -math.sin(slope)])
    start = np.array([0.62, 0.13])

    def place(time_s):
        since = min(max(time_s - release, 0.0), lasts)
        return start + 0.5 * a * since**2 * down, slope

    return place, name, truth, release + lasts + 0.2, None


def _fall(rng):
    e, release, height = rng.uniform(0.55, 0.85), rng.uniform(0.3, 0.5), 0.42
    impacts = [math.sqrt(2.0 * height / G)]
    for bounce in range(1, 5):
        impacts.append(impacts[-1] + 2.0 * e**bounce * impacts[0])

    def place(time_s):
        since = max(time_s - release, 0.0)
        count = sum(since >= one for one in impacts)
        if count == 0:
            return np.array([0.3, 0.22 - 0.5 * G * since**2]), 0.0
        late = since - impacts[count - 1]
        rise = e**count * G * impacts[0] * late - 0.5 * G * late**2
        return np.array([0.3, 0.22 - height + max(rise, 0.0)]), 0.0

    return place, "restitution", e, release + impacts[2], None


def _swing(rng):
    damping, length, amplitude = (
        rng.uniform(0.05, 0.3),
        rng.uniform(0.3, 0.36),
        rng.uniform(0.25, 0.45),
    )
    omega, pivot = math.sqrt(G / length), np.array([0.38, 0.2])

    def place(time_s):
        angle = amplitude * math.exp(-damping * time_s) * math.cos(omega * time_s)
        return pivot + length * np.array([math.sin(angle), -math.cos(angle)]), angle

    return place, "damping_per_s", damping, 5.0, pivot


# --- pictures --------------------------------------------------------------------------------------------------------


def _camera(rng, lasts_s):
    """Return rotation vector and translation from the board to a camera that a hand moves, at a time."""
    eye = np.array([0.25, 0.0, 0.0]) + rng.uniform(
        [-0.25, -0.1, 1.05], [0.25, 0.2, 1.25]
    )
    target = np.array([0.22, -0.03, 0.0])
    waves = rng.uniform(0.3, 2.5, (6, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    sizes = np.array([0.008, 0.008, 0.006, 0.012, 0.012, 0.01])[:, None] / waves
    roll = rng.normal(0.0, 0.03)

    def pose(time_s):
        sway = (sizes * np.sin(2.0 * np.pi * waves * time_s + phases)).sum(axis=1)
        place = eye + sway[:3]
        forward = target - place
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        level = np.array([right, np.cross(forward, right), forward])
        rotation = cv2.Rodrigues(sway[3:] + np.array([0.0, 0.0, roll]))[0] @ level
        return cv2.Rodrigues(rotation)[0], -rotation @ place

    return pose


def _wall(motion, rng, place):
    """Return the wall with the board and what stands still, from the left top corner."""
    width, height = (WALL_M * PX_PER_M).astype(int)
    light = cv2.resize(
        rng.normal(0.0, 1.0, (6, 9, 3)), (width, height), interpolation=cv2.INTER_CUBIC
    )
    wall = np.clip(rng.uniform(150, 215) + 12.0 * light, 0, 255).astype(np.uint8)
    side = round(SQUARE_M * PX_PER_M * 4)
    large = charuco().generateImage(tuple(map(int, SQUARES * side)))
    extent = SQUARES * SQUARE_M
    low = _wall_px(np.array([[-0.5 * extent[0], 0.5 * extent[1]]]))[0]
    scale = np.array(
        [
            [SQUARE_M * PX_PER_M / side, 0.0, low[0] - 0.5],
            [0.0, SQUARE_M * PX_PER_M / side, low[1] - 0.5],
        ]
    )
    scale[:, 2] += 0.5 * scale[0, 0]
    small = cv2.GaussianBlur(large, (0, 0), 1.6)
    paper = (
        _wall_px(np.array([[-0.5, 0.5], [0.5, -0.5]]) * (extent + 0.02))
        .round()
        .astype(int)
    )
    cv2.rectangle(
        wall, tuple(map(int, paper[0])), tuple(map(int, paper[1])), (245, 245, 245), -1
    )
    cv2.warpAffine(
        cv2.cvtColor(small, cv2.COLOR_GRAY2BGR),
        scale,
        (width, height),
        dst=wall,
        borderMode=cv2.BORDER_TRANSPARENT,
    )
    if motion in ("slide", "roll"):
        start, slope = place(0.0)
        along = np.array([math.cos(slope), math.sin(slope)])
        up = np.array([-along[1], along[0]])
        ends = [
            start + 0.08 * along - 0.5 * EDGE_M * up,
            start - 0.62 * along - 0.5 * EDGE_M * up,
        ]
        board = np.array([*ends, ends[1] - 0.02 * up, ends[0] - 0.02 * up])
        cv2.fillPoly(
            wall,
            [_wall_px(board).round().astype(np.int32)],
            (105, 150, 190),
            cv2.LINE_AA,
        )
    for _ in range(12):
        x, y = rng.uniform([0, 0], [width, 0.2 * height])
        cv2.circle(
            wall,
            (int(x), int(y)),
            int(rng.uniform(4, 14)),
            rng.uniform(60, 180, 3).tolist(),
            -1,
            cv2.LINE_AA,
        )
    return wall


def _wall_px(points_m):
    return (points_m * [1.0, -1.0] + [0.55, 0.5 * WALL_M[1]]) * PX_PER_M


def _outline(motion, centre, tilt):
    """Return points of the outline of the object on its plane [m], shape [count, 2]."""
    if motion == "slide":
        c, s = math.cos(tilt), math.sin(tilt)
        square = 0.5 * EDGE_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return centre + square @ np.array([[c, s], [-s, c]])
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    return centre + 0.5 * EDGE_M * np.column_stack([np.cos(angles), np.sin(angles)])


def _picture(wall, rays, lens, pose, motion, seen):
    """Return the picture at one moment: the wall, and the object with its place, tilt, offset and pivot."""
    (rvec, tvec), (centre, tilt, offset_m, pivot) = pose, seen
    rotation = cv2.Rodrigues(rvec)[0]
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], tvec])
    middle = [0.55 * PX_PER_M - 0.5, 0.5 * WALL_M[1] * PX_PER_M - 0.5]
    to_wall = np.array(
        [[PX_PER_M, 0.0, middle[0]], [0.0, -PX_PER_M, middle[1]], [0.0, 0.0, 1.0]]
    )
    maps = cv2.perspectiveTransform(
        rays.reshape(-1, 1, 2), to_wall @ np.linalg.inv(plane)
    ).reshape(-1, SIZE_PX[0], 2)
    picture = cv2.remap(
        wall, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )

    def drawn(points_m, colour, *depths_m):
        """Fill what points enclose that lie at each depth."""
        world = [np.insert(points_m, 2, depth, axis=1) for depth in depths_m]
        places = cv2.projectPoints(np.vstack(world), rvec, tvec, *lens)[0][:, 0]
        hull = cv2.convexHull((places * 16).round().astype(np.int32))
        cv2.fillConvexPoly(picture, hull, colour, cv2.LINE_AA, 4)

    outline = _outline(motion, centre, tilt)
    front_m = offset_m + (0.5 * EDGE_M if motion == "slide" else 0.0)
    if pivot is not None:
        across = 0.0015 * np.array([math.cos(tilt), math.sin(tilt)])
        rod = [pivot - across, pivot + across, centre + across, centre - across]
        drawn(rod, (90, 90, 90), offset_m)
    if motion == "slide":
        # The sides of the cube behind its face are seen where the camera is not before it.
        drawn(outline, (40, 60, 90), front_m, front_m - EDGE_M)
    drawn(outline, (60, 95, 140) if motion == "slide" else (35, 30, 40), front_m)
    return picture.astype(np.float32)
