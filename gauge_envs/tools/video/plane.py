"""Turn pixels of an oblique recording into metres in the plane of the motion, with the uncertainty of the calibration.

A camera file describes the plane in one of two ways: at least four points of it whose pixels and metres are known, or a
calibrated camera and the plane in its world. Both give a homography from pictures without lens distortion to the plane.
Hartley and Zisserman, Multiple View Geometry (2004), sections 4.1 and 8.1.1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.files import MEGABYTE, json_document, read_regular, toml_document
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import cv2
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask
from gauge_envs.tools.video.track import Track

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
    distortion: FloatArray = field(default_factory=lambda: np.zeros(2))
    focal_sigma: float = 0.0

    def straight(self, points_px: FloatArray) -> FloatArray:
        """Return normalized coordinates without distortion of pixels, both of shape [count, 2]."""
        bent = _homogeneous(np.linalg.inv(self.matrix), points_px)
        straight = bent
        # A fixed point; OpenCV's five iterations leave 0.01 px at the corners of a wide lens.
        for _ in range(20):
            square = (straight**2).sum(axis=1, keepdims=True)
            straight = bent / (1.0 + self.distortion[0] * square + self.distortion[1] * square**2)
        return straight

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
        homography, _ = cv2.findHomography(straight, self.points_m)
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
        return np.asarray(cv2.Rodrigues(self.rvec)[0], dtype=float)

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
        turned = cv2.Rodrigues(rng.normal(0.0, self.rotation_sigma_rad, 3))[0] @ rotation
        normal = self.normal / np.linalg.norm(self.normal)
        return replace(
            self,
            rvec=np.asarray(cv2.Rodrigues(turned)[0], dtype=float)[:, 0],
            tvec=-turned @ camera,
            point_m=self.point_m + rng.normal(0.0, self.sigma_m) * normal,
        )


@dataclass(frozen=True, kw_only=True)
class Board:
    """Printed board beside the motion, in every frame of a film, whose upper edge is level.

    Attributes:
        square_m: Edge of a square as measured on the print [m].
        sigma_m: Standard uncertainty of its corners: print and flatness [m].
        offset_m: Distance of the plane of the motion from the board, towards the camera [m].
        offset_sigma_m: Its standard uncertainty [m].
    """

    square_m: float
    sigma_m: float = 0.0003
    offset_m: float = 0.0
    offset_sigma_m: float = 0.002

    def to_plane(self, lens: Lens | None) -> FloatArray:
        """Raise an error: the place of a board is found in a film."""
        raise VideoError("[board] needs the film that shows it; a track goes with [points] or [pose]")

    def drawn(self, rng: np.random.Generator) -> Board:
        """Return the board itself."""
        return self


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
    source: PointPairs | Pose | Board
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
        if self.lens is None:
            return straight
        bent, none = np.array([*self.lens.distortion, 0.0, 0.0]), np.zeros(3)
        rays = np.column_stack([straight, np.ones(len(straight))])
        return np.asarray(cv2.projectPoints(rays, none, none, self.lens.matrix, bent)[0][:, 0], dtype=float)

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


# --- camera file -----------------------------------------------------------------------------------------------------

SHAPES: dict[str, dict[str, tuple[int | None, ...]]] = {
    "board": {"square_m": (), "sigma_m": (), "offset_m": (), "offset_sigma_m": ()},
    "points": {"px": (None, 2), "m": (None, 2), "sigma_px": (), "sigma_m": ()},
    "lens": {"matrix": (3, 3), "distortion": (2,), "focal_sigma": ()},
    "pose": {"rvec": (3,), "tvec": (3,), "position_sigma_m": (), "rotation_sigma_rad": ()},
    "plane": {"point_m": (3,), "normal": (3,), "up": (3,), "sigma_m": ()},
    "motion": {"pivot_m": (2,), "pivot_sigma_m": (), "length_m": (), "release_height_m": (), "direction": (2,)},
}
"""Shape of the numbers under each key of a table; None stands for any length. A pivot in a world has three."""

OPTIONAL = {"distortion", "focal_sigma", "position_sigma_m", "rotation_sigma_rad", *SHAPES["motion"]}
OPTIONAL |= {"board.sigma_m", "board.offset_m", "board.offset_sigma_m"}
DIRECTIONS = {"normal", "up", "direction"}

LARGEST = 1e300
"""Bound of numbers: an integer of a file may have more digits than any other type holds."""

LEAST_SPREAD = 0.02
"""Smallest ratio of the shorter to the longer spread of the points: below, they lie on a line and span no plane."""


def read_camera(path: Path | str) -> PlaneView:
    """Return the view that a camera file describes.

    The keys are on the page "World models": `size_px`, then either `[points]` or `[lens]`, `[pose]` and `[plane]`, and
    `[motion]`. Lengths are in metres, pixels in pictures of the stated size.

    Args:
        path: The file; one that ends in `.json` is JSON, any other is TOML.

    Raises:
        VideoError: The file cannot be read, a key is missing, unknown or of another shape, or the points span no plane.
        MissingExtraError: OpenCV is not installed.
    """
    path = Path(path)
    is_json = path.suffix == ".json"
    try:
        content = read_regular(path, MEGABYTE).removeprefix(b"\xef\xbb\xbf")
        values = json_document(content) if is_json else toml_document(content)
    except (OSError, UnicodeDecodeError) as error:
        raise VideoError(f"{path}: cannot be read as text: {getattr(error, 'strerror', None) or error}") from None
    except ValueError as error:
        raise VideoError(f"{path}: is no {'JSON' if is_json else 'TOML'}: {error}") from None
    _check_keys(path, "", values, {"size_px", *SHAPES})
    size = _numbers(path, "size_px", values.get("size_px"), (2,))
    if (size < 1).any() or (size != np.round(size)).any():
        raise VideoError(f"{path}: size_px is {size.tolist()}; give width and height in whole pixels, as [1280, 720]")
    if len(values.keys() & {"points", "pose", "board"}) != 1:
        raise VideoError(f"{path}: give either [board], or [points], or [lens], [pose] and [plane]")
    if "pose" in values and "lens" not in values:
        raise VideoError(f"{path}: [pose] needs [lens] with the camera matrix")
    shapes = SHAPES | {"motion": SHAPES["motion"] | {"pivot_m": (3 if "pose" in values else 2,)}}
    tables = {name: _table(path, name, table, shapes[name]) for name, table in values.items() if name in shapes}
    source: PointPairs | Pose | Board
    if "board" in values:
        source = Board(**tables["board"])
    elif "points" in values:
        source = _points(path, tables["points"])
    else:
        source = _pose(path, tables["pose"], tables.get("plane"))
    motion = tables.get("motion", {})
    if "pivot_m" in motion:
        if isinstance(source, Pose):
            motion["pivot_m"] = source.axes @ (motion["pivot_m"] - source.point_m)
        motion["pivot_sigma_m"] = _number(path, "motion.pivot_sigma_m", motion.get("pivot_sigma_m"))
    lens = _lens(path, tables["lens"]) if "lens" in tables else None
    return PlaneView(size_px=(int(size[0]), int(size[1])), source=source, lens=lens, **motion)


def _table(path: Path, name: str, values: Any, shapes: dict[str, tuple[int | None, ...]]) -> dict[str, Any]:
    """Return the numbers of a table of the file by key."""
    _check_keys(path, name, values, set(shapes))
    found: dict[str, Any] = {}
    for key, shape in shapes.items():
        place, value = f"{name}.{key}", values.get(key)
        if key in values or not {key, place} & OPTIONAL:
            found[key] = _numbers(path, place, value, shape) if shape else _number(path, place, value)
        if key in DIRECTIONS and key in found and not np.linalg.norm(found[key]) > 0.0:
            raise VideoError(f"{path}: {name}.{key} is zero; give a direction")
    return found


def _check_keys(path: Path, name: str, values: Any, known: set[str]) -> None:
    if not isinstance(values, dict):
        raise VideoError(f"{path}: {name or 'the file'} must be a table of keys and values")
    if unknown := sorted(set(values) - known):
        key = f"{name}.{unknown[0]}".lstrip(".")
        raise VideoError(f"{path}: there is no key {key}; known: {', '.join(sorted(known))}")


def _numbers(path: Path, key: str, value: Any, shape: tuple[int | None, ...]) -> FloatArray:
    shown = " x ".join("n" if one is None else str(one) for one in shape)
    if value is None:
        raise VideoError(f"{path}: there is no {key}; give {shown} numbers")
    try:
        numbers = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        numbers = np.full(1, np.nan)
    fits = numbers.ndim == len(shape) and all(s is None or s == n for s, n in zip(shape, numbers.shape, strict=True))
    if not fits or not np.isfinite(numbers).all():
        raise VideoError(f"{path}: {key} must be {shown} finite numbers")
    return numbers


def _number(path: Path, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < LARGEST:
        raise VideoError(f"{path}: {key} must be a finite number from 0")
    return float(value)


def _lens(path: Path, table: dict[str, Any]) -> Lens:
    matrix = table["matrix"]
    if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0 or list(matrix[2]) != [0.0, 0.0, 1.0]:
        raise VideoError(f"{path}: lens.matrix is no camera matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    return Lens(**table)


def _points(path: Path, table: dict[str, Any]) -> PointPairs:
    points_px, points_m = table.pop("px"), table.pop("m")
    if len(points_px) != len(points_m) or len(points_px) < 4:
        raise VideoError(
            f"{path}: points.px has {len(points_px)} and points.m {len(points_m)} points; give at least 4 "
            "of each, in the same order"
        )
    for name, points in (("px", points_px), ("m", points_m)):
        if _least_spread(points) < LEAST_SPREAD:
            raise VideoError(f"{path}: points.{name} has three of four points on a line: they span no plane")
    return PointPairs(points_px=points_px, points_m=points_m, **table)


def _least_spread(points: FloatArray) -> float:
    """Return the smallest ratio of spreads over the points without any one of them: a plane needs three off a line."""
    ratios = []
    for left_out in range(len(points)):
        kept = np.delete(points, left_out, axis=0)
        spreads = np.linalg.svd(kept - kept.mean(axis=0), compute_uv=False)
        ratios.append(float(spreads[1] / spreads[0]) if spreads[0] > 0.0 else 0.0)
    return min(ratios)


def _pose(path: Path, pose: dict[str, Any], plane: dict[str, Any] | None) -> Pose:
    if plane is None:
        raise VideoError(f"{path}: there is no table [plane]")
    normal, up = plane["normal"], plane["up"]
    if np.linalg.norm(np.cross(normal, up)) < 0.1 * np.linalg.norm(normal) * np.linalg.norm(up):
        raise VideoError(f"{path}: plane.up is along plane.normal; give a direction within the plane")
    return Pose(**pose, **plane)
