"""Turn pixels of an oblique recording into metres in the plane of the motion, with the uncertainty of the calibration.

A camera file names four points or more whose pixels and metres are known, or a board that the film shows. Both give a
homography from pictures without lens distortion to the plane. Hartley and Zisserman, Multiple View Geometry (2004),
section 4.1.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    NonNegativeFloat,
    PositiveFloat,
    field_validator,
    model_validator,
)

from gauge_envs.errors import VideoError
from gauge_envs.files import MEGABYTE, toml_document
from gauge_envs.references.tables import FileModel, Model, faults_of, read_content
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import cv2
from gauge_envs.tools.video.tasks import REFERENCE_SIZE_PX, Motion, VideoTask
from gauge_envs.tools.video.track import Track

ORIGIN_PX = 0.5 * np.array(REFERENCE_SIZE_PX)
"""Place of the origin of the plane in the frontal picture [px]."""

LEAST_SPREAD = 0.02
"""Smallest ratio of the shorter to the longer spread of the points: below, they lie on a line and span no plane."""

Pair: TypeAlias = tuple[float, float]
Triple: TypeAlias = tuple[float, float, float]
Side: TypeAlias = Annotated[int, Field(ge=1, le=65536)]


class Lens(FileModel):
    """Camera matrix and radial distortion, as in OpenCV.

    Attributes:
        matrix: Camera matrix [px].
        distortion: Radial coefficients k1 and k2.
    """

    matrix: tuple[Triple, Triple, Triple]
    distortion: Pair = (0.0, 0.0)

    @field_validator("matrix")
    @classmethod
    def _is_camera(cls, matrix: tuple[Triple, ...]) -> tuple[Triple, ...]:
        if min(matrix[0][0], matrix[1][1]) <= 0.0 or matrix[2] != (0.0, 0.0, 1.0):
            raise ValueError("no camera matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        return matrix

    @property
    def coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Camera matrix, shape [3, 3], and coefficients of the distortion, shape [4], for OpenCV."""
        return np.array(self.matrix), np.array([*self.distortion, 0.0, 0.0])

    def straight(self, points_px: FloatArray) -> FloatArray:
        """Return normalized coordinates without distortion of pixels, both of shape [count, 2]."""
        return np.asarray(
            cv2.undistortPoints(points_px[:, None], *self.coefficients)[:, 0],
            dtype=float,
        )


class PointPairs(FileModel):
    """Points of the plane whose place is known in the picture and in metres: table `[points]` of a camera file.

    Attributes:
        px: Places in the picture [px], at least four.
        m: Places in the plane [m], in the same order: to the right and, in a vertical plane, up.
        sigma_px: Standard uncertainty of each pixel coordinate [px].
        sigma_m: Standard uncertainty of each metric coordinate [m].
    """

    px: list[Pair]
    m: list[Pair]
    sigma_px: NonNegativeFloat
    sigma_m: NonNegativeFloat

    @model_validator(mode="after")
    def _span_a_plane(self) -> Self:
        """Check that points span a plane: without any one of them, the others are no line."""
        if not len(self.px) == len(self.m) >= 4:
            raise ValueError(
                f"px has {len(self.px)} and m {len(self.m)} points; give at least 4 of each, in the same order"
            )
        for name, places in (("px", self.px), ("m", self.m)):
            for left_out in range(len(places)):
                kept = np.delete(places, left_out, axis=0)
                spreads = np.linalg.svd(kept - kept.mean(axis=0), compute_uv=False)
                if spreads[1] <= LEAST_SPREAD * spreads[0]:
                    raise ValueError(
                        f"{name} has three of four points on a line: they span no plane"
                    )
        return self

    def to_plane(self, lens: Lens | None) -> FloatArray:
        """Return the homography from straight coordinates to the plane, shape [3, 3]."""
        px = np.array(self.px)
        homography, _ = cv2.findHomography(
            px if lens is None else lens.straight(px), np.array(self.m)
        )
        return np.asarray(homography, dtype=float)

    def drawn(self, rng: np.random.Generator) -> Self:
        """Return the points moved within their uncertainty."""
        drawn = {
            "px": rng.normal(self.px, self.sigma_px),
            "m": rng.normal(self.m, self.sigma_m),
        }
        return self.model_copy(update=drawn)


class Board(FileModel):
    """Printed board beside the motion, in every frame of a film, whose upper edge is level.

    Attributes:
        square_m: Edge of a square as measured on the print [m].
        sigma_m: Standard uncertainty of its corners: print and flatness [m].
        offset_m: Distance of the middle of the object from the board, towards the camera [m].
        offset_sigma_m: Its standard uncertainty [m].
    """

    square_m: PositiveFloat
    sigma_m: NonNegativeFloat = 0.0003
    offset_m: float
    offset_sigma_m: NonNegativeFloat = 0.002

    def to_plane(self, lens: Lens | None) -> FloatArray:
        """Raise an error: the place of a board is found in a film."""
        raise VideoError(
            "[board] needs the film that shows it; a track goes with [points]"
        )


class Swing(FileModel):
    """What is known of the motion in the plane: table `[motion]` of a camera file.

    Attributes:
        pivot_m: Pivot of a swing [m]; None where there is none.
        pivot_sigma_m: Standard uncertainty of each of its coordinates [m].
        length_m: Distance of the ball's centre from the pivot [m]; None where it is not needed.
        release_height_m: Height from which the incoming ball of a cradle is released [m]; the task's if None.
        direction: Direction of a slide; fitted to the track if None.
        inertia_factor: Moment of inertia of a rolling body, in its mass times squared radius; None where none rolls.
    """

    pivot_m: Pair | None = None
    pivot_sigma_m: NonNegativeFloat | None = None
    length_m: PositiveFloat | None = None
    release_height_m: PositiveFloat | None = None
    direction: Pair | None = None
    inertia_factor: Annotated[float, Field(gt=0.0, le=1.0)] | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.pivot_m is None) != (self.pivot_sigma_m is None):
            raise ValueError("pivot_m and pivot_sigma_m go together: give both or none")
        if self.direction is not None and not any(self.direction):
            raise ValueError("direction is zero")
        return self


class PlaneView(FileModel):
    """How a recording sees the plane of the motion: a camera file.

    Attributes:
        size_px: Width and height of the pictures in which the calibration is stated [px].
        points: Points of the plane that are known, or None.
        board: Board beside the motion, or None.
        lens: Lens; None for pictures without distortion, of point pairs alone.
        motion: What is known of the motion.
        readout_s: Time from the first to the last row of a picture, by a rolling shutter [s].
    """

    size_px: tuple[Side, Side]
    points: PointPairs | None = None
    board: Board | None = None
    lens: Lens | None = None
    motion: Swing = Swing()
    readout_s: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0

    @model_validator(mode="after")
    def _has_a_source(self) -> Self:
        if (self.points is None) == (self.board is None):
            raise ValueError("give either [points] or [board]")
        return self

    @property
    def source(self) -> PointPairs | Board:
        """Where the plane lies."""
        source = self.points or self.board
        assert source is not None
        return source

    @property
    def pivot_m(self) -> FloatArray | None:
        """Pivot of a swing in the plane [m], shape [2]; None where there is none."""
        return None if self.motion.pivot_m is None else np.array(self.motion.pivot_m)

    def to_plane_m(self, points_px: FloatArray) -> FloatArray:
        """Return places in the plane [m] of places in the picture [px], both of shape [count, 2]."""
        straight = points_px if self.lens is None else self.lens.straight(points_px)
        return _homogeneous(self.source.to_plane(self.lens), straight)

    def to_picture_px(self, points_m: FloatArray) -> FloatArray:
        """Return places in the picture [px] of places in the plane [m], both of shape [count, 2]."""
        straight = _homogeneous(
            np.linalg.inv(self.source.to_plane(self.lens)), points_m
        )
        if self.lens is None:
            return straight
        rays = np.column_stack([straight, np.ones(len(straight))])
        return np.asarray(
            cv2.projectPoints(rays, np.zeros(3), np.zeros(3), *self.lens.coefficients)[
                0
            ][:, 0]
        )

    def drawn(self, rng: np.random.Generator) -> Self:
        """Return the view with calibration and pivot moved within their uncertainty."""
        moved: dict[str, Any] = {}
        pivot_m, sigma_m = self.motion.pivot_m, self.motion.pivot_sigma_m
        if pivot_m is not None and sigma_m is not None:
            pivot = {"pivot_m": tuple(rng.normal(pivot_m, sigma_m))}
            moved["motion"] = self.motion.model_copy(update=pivot)
        if self.points is not None:
            moved["points"] = self.points.drawn(rng)
        return self.model_copy(update=moved)

    def grid_to_plane_m(self, points_px: FloatArray) -> FloatArray:
        """Return places in the plane [m] of places on the reference grid [px]; NaN stays NaN."""
        places = np.full(points_px.shape, np.nan)
        is_known = np.isfinite(points_px).all(axis=1)
        places[is_known] = self.to_plane_m(points_px[is_known] * self._from_grid)
        return places

    def grid_scale_m_per_px(self, points_px: FloatArray) -> FloatArray:
        """Return the size of a pixel of the reference grid in the plane [m], shape [count]: root of its area."""
        steps = [
            self.grid_to_plane_m(points_px + step)
            for step in ([-1, 0], [1, 0], [0, -1], [0, 1])
        ]
        across, down = 0.5 * (steps[1] - steps[0]), 0.5 * (steps[3] - steps[2])
        return np.asarray(
            np.sqrt(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]))
        )

    @property
    def _from_grid(self) -> FloatArray:
        return np.array(self.size_px, dtype=float) / np.array(REFERENCE_SIZE_PX)


def frontal_task(
    view: PlaneView,
    track: Track,
    task: VideoTask,
    *,
    scale_m_per_px: float | None = None,
) -> VideoTask:
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
    scale = (
        float(np.median(view.grid_scale_m_per_px(seen)))
        if scale_m_per_px is None
        else scale_m_per_px
    )
    places_m = view.grid_to_plane_m(seen)
    pivot, rest, motion = None, None, view.motion
    if view.pivot_m is not None:
        pivot = _frontal_px(view.pivot_m, scale)
        if motion.length_m is not None:
            rest = _frontal_px(view.pivot_m - [0.0, motion.length_m], scale)
    direction = None
    if task.motion is Motion.FALL:
        direction = (0.0, 1.0)
    elif task.motion is Motion.SLIDE:
        along = np.array(motion.direction or _main_direction(places_m))
        along = along / np.linalg.norm(along)
        direction = (float(along[0]), float(-along[1]))
    return replace(
        task,
        size_px=task.size_m / scale,
        centre_px=_frontal_px(places_m[0], scale),
        direction=direction,
        pivot_px=pivot,
        rest_px=rest,
        release_height_m=motion.release_height_m or task.release_height_m,
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
    # A rolling shutter shows what is lower in the picture later; the clock is that of the middle row.
    row = np.where(
        track.is_found, track.points_px[:, 1] / REFERENCE_SIZE_PX[1] - 0.5, 0.0
    )
    clock = track.times_s + view.readout_s * row if view.readout_s else track.clock_s
    return replace(
        track, points_px=places, size_ratio=sizes, clock_s=clock, registration=None
    )


def metric_view(track: Track, task: VideoTask) -> tuple[Track, PlaneView]:
    """Return a track in millimetres on the reference grid, and the frontal view that sees it there; both are exact."""
    scale = task.scale_m_per_px
    corners_px = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * REFERENCE_SIZE_PX
    corners_m = (corners_px - ORIGIN_PX) * scale * [1.0, -1.0]
    places_m = 1e-3 * track.points_px
    # A swing counts from its pivot.
    motion = Swing(
        pivot_m=(0.0, 0.0),
        pivot_sigma_m=0.0,
        length_m=float(np.nanmedian(np.linalg.norm(places_m, axis=1))),
    )
    points = PointPairs(
        px=corners_px.tolist(), m=corners_m.tolist(), sigma_px=0.0, sigma_m=0.0
    )
    view = PlaneView(size_px=REFERENCE_SIZE_PX, points=points, motion=motion)
    places_px = places_m / scale * [1.0, -1.0] + ORIGIN_PX
    return replace(track, points_px=places_px, is_metric=False), view


def _frontal_px(place_m: FloatArray, scale_m_per_px: float) -> tuple[float, float]:
    x, y = place_m * [1.0, -1.0] / scale_m_per_px + ORIGIN_PX
    return float(x), float(y)


def _main_direction(places_m: FloatArray) -> Pair:
    """Return the direction in which places spread most, away from the first one."""
    centred = places_m - places_m.mean(axis=0)
    x, y = np.linalg.svd(centred, full_matrices=False)[2][0]
    sign = float(np.sign((places_m[-1] - places_m[0]) @ [x, y]) or 1.0)
    return sign * float(x), sign * float(y)


def _homogeneous(matrix: NDArray[np.floating], points: FloatArray) -> FloatArray:
    moved = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(moved[:, :2] / moved[:, 2:])


# --- camera file -----------------------------------------------------------------------------------------------------


def read_camera(path: Path | str) -> PlaneView:
    """Return the view that a camera file describes.

    The keys are on the page "World models": `size_px`, then `[points]` or `[board]`, `[lens]` and `[motion]`. Lengths
    are in metres, pixels in pictures of the stated size.

    Args:
        path: The file, TOML.

    Raises:
        ReferenceFileError: The file cannot be read, a key is missing, unknown or of another shape, or the points span
            no plane.
    """
    return read_model(Path(path), PlaneView)


def read_model(path: Path, model: type[Model]) -> Model:
    """Return the content of a TOML file."""
    with faults_of(path):
        return model.model_validate(toml_document(read_content(path, MEGABYTE)))
