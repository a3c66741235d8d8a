"""Films of one's own: the camera file, and how far the places in their plane may be off."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    NonNegativeFloat,
    field_validator,
    model_validator,
)

from gauge_envs.errors import VideoError
from gauge_envs.files import MEGABYTE, toml_document
from gauge_envs.references.tables import FileModel, Model, faults_of, read_content
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import cv2
from gauge_envs.tools.video.tasks import Motion, VideoTask
from gauge_envs.tools.video.track import Track

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


class Board(FileModel):
    """Printed board beside the motion, in every frame of a film, whose upper edge is level.

    Attributes:
        square_m: Edge of a square as measured on the print [m], at most 1 m.
        sigma_m: Standard uncertainty of its corners: print and flatness [m].
        offset_m: Distance of the middle of the object from the board, towards the camera [m].
        offset_sigma_m: Its standard uncertainty [m].
    """

    square_m: Annotated[float, Field(gt=0.0, le=1.0)]
    sigma_m: NonNegativeFloat = 0.0003
    offset_m: float
    offset_sigma_m: NonNegativeFloat = 0.002


class Swing(FileModel):
    """What is known of the motion in the plane: table `[motion]` of a camera file.

    Attributes:
        pivot_m: Pivot of a swing [m]; None where there is none.
        pivot_sigma_m: Standard uncertainty of each of its coordinates [m].
        inertia_factor: Moment of inertia of a rolling body, in its mass times squared radius; None where none rolls.
    """

    pivot_m: Pair | None = None
    pivot_sigma_m: NonNegativeFloat | None = None
    inertia_factor: Annotated[float, Field(gt=0.0, le=1.0)] | None = None

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if (self.pivot_m is None) != (self.pivot_sigma_m is None):
            raise ValueError("pivot_m and pivot_sigma_m go together: give both or none")
        return self


class CameraFile(FileModel):
    """How a film of one's own was made.

    Attributes:
        size_px: Width and height of the film [px].
        board: Board beside the motion.
        lens: Lens; found from the film if None.
        motion: What is known of the motion.
    """

    size_px: tuple[Side, Side]
    board: Board
    lens: Lens | None = None
    motion: Swing = Swing()


def homogeneous(matrix: NDArray[np.floating], points: FloatArray) -> FloatArray:
    """Return points that a homography moves, both of shape [count, 2]."""
    return np.asarray(cv2.perspectiveTransform(points[:, None], matrix)[:, 0])


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Points by which a frontal picture of the plane is placed on the grid, and how far off they may be.

    Attributes:
        points_px: Their places on the grid [px], shape [count, 2].
        sigma_px: Standard uncertainty of each coordinate [px]; 0 for places that are exact.
    """

    points_px: FloatArray
    sigma_px: float

    def drawn(self, places_px: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return places [px], shape [count, 2], where points that are moved by their uncertainty put them."""
        if self.sigma_px == 0.0:
            return places_px
        moved_px = rng.normal(self.points_px, self.sigma_px)
        homography, _ = cv2.findHomography(self.points_px, moved_px)
        return homogeneous(homography, places_px)


def main_direction(track: Track) -> Pair:
    """Return the direction in the picture in which a track spreads most, away from its first place."""
    places = track.points_px[track.is_found]
    x, y = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][0]
    sign = float(np.sign((places[-1] - places[0]) @ [x, y]) or 1.0)
    return sign * float(x), sign * float(y)


LEAST_SLOPE = 0.1
"""Smallest sine of a slope."""

METRIC_AXES = "x_mm and y_mm are in millimetres, to the right and up"

MOST_ARM_ERROR = 0.3
"""Largest relative error of the length of a swing in a track in millimetres; another unit is off by more."""


def metric_on_grid(
    track: Track, task: VideoTask
) -> tuple[Track, VideoTask, Calibration]:
    """Return a track in millimetres on the grid, its task there, and that its places are exact.

    A swing counts from its pivot; a slide has any direction that leads down.

    Raises:
        VideoError: The object goes up, or is not on the string or rod of a swing: the axes or the unit are others.
    """
    origin_px = np.array(task.pivot_px or task.centre_px)
    places_px = 1e-3 * track.points_px * [1.0, -1.0] / task.scale_m_per_px + origin_px
    track = replace(track, points_px=places_px, is_metric=False)
    if task.motion is Motion.SLIDE:
        task = replace(task, direction=main_direction(track))
        found_px = places_px[track.is_found]
        away, down = found_px[-1] - found_px[0]
        if math.hypot(away, down) > max(task.size_px, down / LEAST_SLOPE):
            raise VideoError(f"the object does not go down: {METRIC_AXES}")
    if task.motion in (Motion.CRADLE, Motion.PENDULUM):
        arms_px = places_px[track.is_found] - origin_px
        hanging_px = np.subtract(task.rest_px or task.centre_px, origin_px)
        share = np.median(np.hypot(*arms_px.T)) / math.hypot(*hanging_px)
        if abs(share - 1.0) > MOST_ARM_ERROR or np.median(arms_px[:, 1]) < 0.0:
            raise VideoError(
                f"the object is not {1e3 * task.scale_m_per_px * math.hypot(*hanging_px):.0f} mm below the pivot of "
                f"its swing: {METRIC_AXES}, from the pivot"
            )
    exact = Calibration(points_px=places_px[:0], sigma_px=0.0)
    return track, replace(task, pivot_sigma_px=0.0), exact


# --- camera file -----------------------------------------------------------------------------------------------------


def read_camera(path: Path | str) -> CameraFile:
    """Return what a camera file says.

    The keys are on the page "World models": `size_px`, `[board]`, `[lens]` and `[motion]`. Lengths are in metres,
    pixels in pictures of the stated size.

    Args:
        path: The file, TOML.

    Raises:
        ReferenceFileError: The file cannot be read, or a key is missing, unknown or of another shape.
    """
    return read_model(Path(path), CameraFile)


def read_model(path: Path, model: type[Model]) -> Model:
    """Return the content of a TOML file."""
    with faults_of(path):
        return model.model_validate(toml_document(read_content(path, MEGABYTE)))
