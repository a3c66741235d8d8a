"""Read how an own recording sees the plane of its motion, from a TOML or JSON file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import VideoError
from gauge_envs.files import MEGABYTE, json_document, read_regular, toml_document
from gauge_envs.tools.video.plane import Lens, PlaneView, PointPairs, Pose

FloatArray: TypeAlias = NDArray[np.float64]

TOP = {"size_px", "points", "lens", "pose", "plane", "motion"}
POINTS = {"px", "m", "sigma_px", "sigma_m"}
LENS = {"matrix", "distortion", "focal_sigma"}
POSE = {"rvec", "tvec", "position_sigma_m", "rotation_sigma_rad"}
PLANE = {"point_m", "normal", "up", "sigma_m"}
MOTION = {"pivot_m", "pivot_sigma_m", "length_m", "release_height_m", "direction"}
"""Keys of the file and of each of its tables."""

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
    try:
        content = read_regular(path, MEGABYTE).removeprefix(b"\xef\xbb\xbf")
        values = json_document(content) if path.suffix == ".json" else toml_document(content)
    except (OSError, UnicodeDecodeError) as error:
        raise VideoError(f"{path}: cannot be read as text: {getattr(error, 'strerror', None) or error}") from None
    except ValueError as error:
        raise VideoError(f"{path}: is no {'JSON' if path.suffix == '.json' else 'TOML'}: {error}") from None
    file = _Table(path, "", values, TOP)
    size = file.numbers("size_px", (2,))
    if (size < 1).any() or (size != np.round(size)).any():
        raise VideoError(f"{path}: size_px is {size.tolist()}; give width and height in whole pixels, as [1280, 720]")
    has_points, has_pose = "points" in file.values, "pose" in file.values
    if has_points == has_pose:
        raise VideoError(f"{path}: give either [points], or [lens], [pose] and [plane]")
    if has_pose and "lens" not in file.values:
        raise VideoError(f"{path}: [pose] needs [lens] with the camera matrix")
    lens = _lens(file.table("lens", LENS)) if "lens" in file.values else None
    source = _points(file.table("points", POINTS)) if has_points else _pose(file)
    return _view((int(size[0]), int(size[1])), source, lens, file)


def _view(size_px: tuple[int, int], source: PointPairs | Pose, lens: Lens | None, file: _Table) -> PlaneView:
    motion = file.table("motion", MOTION) if "motion" in file.values else _Table(file.path, "motion", {}, MOTION)
    pivot = None
    if "pivot_m" in motion.values:
        if isinstance(source, Pose):
            pivot = source.axes @ (motion.numbers("pivot_m", (3,)) - source.point_m)
        else:
            pivot = motion.numbers("pivot_m", (2,))
    return PlaneView(
        size_px=size_px,
        source=source,
        lens=lens,
        pivot_m=pivot,
        pivot_sigma_m=0.0 if pivot is None else motion.number("pivot_sigma_m"),
        length_m=motion.number("length_m") if "length_m" in motion.values else None,
        release_height_m=motion.number("release_height_m") if "release_height_m" in motion.values else None,
        direction=motion.direction("direction", 2) if "direction" in motion.values else None,
    )


def _lens(table: _Table) -> Lens:
    distortion = table.numbers("distortion", (2,)) if "distortion" in table.values else np.zeros(2)
    matrix = table.numbers("matrix", (3, 3))
    if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0 or list(matrix[2]) != [0.0, 0.0, 1.0]:
        raise VideoError(f"{table.path}: lens.matrix is no camera matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    return Lens(matrix=matrix, distortion=distortion, focal_sigma=table.number("focal_sigma", 0.0))


def _points(table: _Table) -> PointPairs:
    points_px, points_m = table.numbers("px", (None, 2)), table.numbers("m", (None, 2))
    if len(points_px) != len(points_m) or len(points_px) < 4:
        raise VideoError(
            f"{table.path}: points.px has {len(points_px)} and points.m {len(points_m)} points; give at least 4 "
            "of each, in the same order"
        )
    for name, points in (("px", points_px), ("m", points_m)):
        if _least_spread(points) < LEAST_SPREAD:
            raise VideoError(f"{table.path}: points.{name} has three of four points on a line: they span no plane")
    return PointPairs(
        points_px=points_px, points_m=points_m, sigma_px=table.number("sigma_px"), sigma_m=table.number("sigma_m")
    )


def _least_spread(points: FloatArray) -> float:
    """Return the smallest ratio of spreads over the points without any one of them: a plane needs three off a line."""
    ratios = []
    for left_out in range(len(points)):
        kept = np.delete(points, left_out, axis=0)
        spreads = np.linalg.svd(kept - kept.mean(axis=0), compute_uv=False)
        ratios.append(float(spreads[1] / spreads[0]) if spreads[0] > 0.0 else 0.0)
    return min(ratios)


def _pose(file: _Table) -> Pose:
    pose, plane = file.table("pose", POSE), file.table("plane", PLANE)
    normal, up = plane.direction("normal", 3), plane.direction("up", 3)
    if np.linalg.norm(np.cross(normal, up)) < 0.1 * np.linalg.norm(normal) * np.linalg.norm(up):
        raise VideoError(f"{file.path}: plane.up is along plane.normal; give a direction within the plane")
    return Pose(
        rvec=pose.numbers("rvec", (3,)),
        tvec=pose.numbers("tvec", (3,)),
        point_m=plane.numbers("point_m", (3,)),
        normal=normal,
        up=up,
        sigma_m=plane.number("sigma_m"),
        position_sigma_m=pose.number("position_sigma_m", 0.0),
        rotation_sigma_rad=pose.number("rotation_sigma_rad", 0.0),
    )


class _Table:
    """One table of a camera file, with messages that name its keys."""

    def __init__(self, path: Path, name: str, values: Any, known: set[str]) -> None:
        self.path = path
        self._name = name
        if not isinstance(values, dict):
            raise VideoError(f"{path}: {name or 'the file'} must be a table of keys and values")
        unknown = sorted(set(values) - known)
        if unknown:
            raise VideoError(f"{path}: there is no key {self._key(unknown[0])}; known: {', '.join(sorted(known))}")
        self.values = values

    def _key(self, key: str) -> str:
        return f"{self._name}.{key}" if self._name else key

    def table(self, key: str, known: set[str]) -> _Table:
        if key not in self.values:
            raise VideoError(f"{self.path}: there is no table [{key}]")
        return _Table(self.path, key, self.values[key], known)

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> FloatArray:
        """Return a value of a shape, in which None stands for any length."""
        shown = " x ".join("n" if one is None else str(one) for one in shape)
        if key not in self.values:
            raise VideoError(f"{self.path}: there is no {self._key(key)}; give {shown} numbers")
        try:
            value = np.array(self.values[key], dtype=float)
        except (TypeError, ValueError, OverflowError):
            value = np.full(1, np.nan)
        fits = value.ndim == len(shape) and all(s is None or s == n for s, n in zip(shape, value.shape, strict=True))
        if not fits or not np.isfinite(value).all():
            raise VideoError(f"{self.path}: {self._key(key)} must be {shown} finite numbers")
        return value

    def direction(self, key: str, count: int) -> FloatArray:
        value = self.numbers(key, (count,))
        if not np.linalg.norm(value) > 0.0:
            raise VideoError(f"{self.path}: {self._key(key)} is zero; give a direction")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a number that is not negative."""
        if key not in self.values and default is not None:
            return default
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < LARGEST:
            raise VideoError(f"{self.path}: {self._key(key)} must be a finite number from 0")
        return float(value)
