"""Find the printed board of a film: in which frames, by which lens, and how the camera sees the plane of motion."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from PIL import Image
from scipy.optimize import minimize_scalar

from gauge_envs.errors import ParameterError, VideoError
from gauge_envs.files import os_errors
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Frames, cv2
from gauge_envs.tools.video.plane import Board, CameraFile, Lens, homogeneous

SQUARES = np.array([7, 5])
"""Squares of the board across and down."""

DPI = 300
"""Least resolution of the printed board [dots per inch]."""

LEAST_CORNERS, MOST_UNSEEN = 8, 0.3
"""Fewest corners of the board by which a frame is placed, and largest share of frames without them."""

MOST_CALIBRATED = 30
"""Most frames from which the lens is found."""

CORNER_SIGMA_PX = 0.2
"""Standard uncertainty of a corner of the board [px]: that of one frame, 0.1, is in part that of the next."""

PHONE_FOCAL_LENGTH, PHONE_SIGMA = 0.85, 0.25
"""Focal length of a phone's main camera that films, in widths of its picture, and the standard deviation of its
logarithm: 24 to 28 mm on a film of 36 mm, of which stabilization crops up to a fifth."""


def charuco() -> Any:
    """Return OpenCV's board with squares of length 1."""
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.CharucoBoard(tuple(map(int, SQUARES)), 1.0, 0.75, words)


def save_board(path: Path, square_mm: float) -> Path:
    """Write the board, PNG or PDF in its true size, and return its path."""
    if path.suffix not in (".png", ".pdf") or not 5.0 <= square_mm <= 200.0:
        raise ParameterError(
            f"{path}, --square {square_mm:g}: give a .png or .pdf, and squares of 5 to 200 mm"
        )
    side = math.ceil(DPI * square_mm / 25.4)
    sheet = cv2.copyMakeBorder(
        charuco().generateImage(tuple(map(int, SQUARES * side))),
        *[side // 2] * 4,
        0,
        value=255,
    )
    dpi = 25.4 * side / square_mm
    with os_errors(lambda cause: VideoError(f"{path}: cannot be written: {cause}")):
        Image.fromarray(sheet).save(path, dpi=(dpi, dpi), resolution=dpi)
    return path


Corners: TypeAlias = tuple[FloatArray, FloatArray]
"""Corners of the board in a frame: places on the board [m], shape [count, 3], and in the picture [px], [count, 2]."""


@dataclass(frozen=True, kw_only=True)
class BoardPose:
    """How a frame sees the board.

    Attributes:
        lens: Lens of the film.
        focal_sigma: Relative standard uncertainty of its focal length; 0 for a stated lens.
        board: The board, behind the plane of the motion.
        corners: The corners that are seen.
        rotation_rad: Rotation vector from the board to the camera, as in OpenCV, shape [3].
        translation_m: Middle of the board in the frame of the camera [m], shape [3].
    """

    lens: Lens
    focal_sigma: float
    board: Board
    corners: Corners
    rotation_rad: FloatArray
    translation_m: FloatArray

    @property
    def distance_m(self) -> float:
        """Distance of the middle of the board from the camera [m]."""
        return float(np.linalg.norm(self.translation_m))

    @property
    def to_plane(self) -> FloatArray:
        """Homography from straight coordinates to the plane of the motion, shape [3, 3]."""
        rotation, _ = cv2.Rodrigues(self.rotation_rad)
        right, up, towards = rotation.T
        middle = self.translation_m + self.board.offset_m * towards
        return np.asarray(np.linalg.inv(np.column_stack([right, up, middle])))

    def to_plane_m(self, points_px: FloatArray) -> FloatArray:
        """Return places in the plane [m] of places in the picture [px], both of shape [count, 2]."""
        return homogeneous(self.to_plane, self.lens.straight(points_px))

    def to_picture_px(self, points_m: FloatArray) -> FloatArray:
        """Return places in the picture [px] of places in the plane [m], both of shape [count, 2]."""
        offsets_m = np.full(len(points_m), self.board.offset_m)
        return self.seen_px(np.column_stack([points_m, offsets_m]))

    def seen_px(self, places_m: FloatArray) -> FloatArray:
        """Return where the camera sees places on the board [m], shape [count, 3], in the picture [px], [count, 2]."""
        places_px, _ = cv2.projectPoints(
            places_m, self.rotation_rad, self.translation_m, *self.lens.coefficients
        )
        return np.asarray(places_px[:, 0])


def corners_of_print(board: Board) -> FloatArray:
    """Return the inner corners of a board [m], to the right and up from its middle, and towards the camera."""
    middle = np.array([*(0.5 * SQUARES), 0.0])
    inner = charuco().getChessboardCorners()
    return np.asarray((inner - middle) * [1.0, -1.0, 0.0] * board.square_m)


def board_poses(source: Frames, camera: CameraFile) -> list[BoardPose | None]:
    """Return how each frame sees the board; None where it does not.

    Raises:
        VideoError: The first frame, or too many of the others, do not show it.
    """
    found = _board_corners(source, corners_of_print(camera.board))
    seen = [corners for corners in found if corners is not None]
    lens, focal_sigma = (
        _calibrated(seen, source.size_px) if camera.lens is None else (camera.lens, 0.0)
    )
    poses: list[BoardPose | None] = []
    for corners in found:
        if corners is None:
            poses.append(None)
            continue
        _, turn, away = cv2.solvePnP(*corners, *lens.coefficients)
        poses.append(
            BoardPose(
                lens=lens,
                focal_sigma=focal_sigma,
                board=camera.board,
                corners=corners,
                rotation_rad=turn.ravel(),
                translation_m=away.ravel(),
            )
        )
    return poses


def outer_corners(pose: BoardPose) -> tuple[FloatArray, float]:
    """Return four places in the plane by which a frame places it [m], shape [4, 2], and their uncertainty [m]."""
    board = pose.board
    outer_m = corners_of_print(board)[[0, SQUARES[0] - 2, -1, 1 - SQUARES[0]], :2]
    places_m, places_px = pose.corners
    missed_px = float((pose.seen_px(places_m) - places_px).std())
    # What is before the board looks larger, by its share of the distance, which grows with the focal length.
    depth_sigma_m = math.hypot(board.offset_sigma_m, board.offset_m * pose.focal_sigma)
    tilt = depth_sigma_m / pose.distance_m
    # Each of four points is drawn on its own, so an error that all share is counted twice as large.
    shared_m = 2.0 * math.hypot(board.sigma_m, tilt * np.linalg.norm(outer_m[0]))
    m_per_px = pose.distance_m / pose.lens.matrix[0][0]
    return outer_m, math.hypot(shared_m, missed_px * m_per_px)


def _board_corners(source: Frames, corners_m: FloatArray) -> list[Corners | None]:
    """Return the corners of the board in each frame; None where too few are seen."""
    detector = cv2.aruco.CharucoDetector(charuco())
    found: list[Corners | None] = []
    for picture in source.native():
        places, ids, *_ = detector.detectBoard(
            cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        )
        if ids is None or len(ids) < LEAST_CORNERS:
            found.append(None)
        else:
            found.append((corners_m[ids.ravel()], places.reshape(-1, 2).astype(float)))
    unseen = [str(number) for number, corners in enumerate(found) if corners is None]
    if found[0] is None or len(unseen) > MOST_UNSEEN * len(found):
        raise VideoError(
            f"{source.name}: {LEAST_CORNERS} corners of the board must be seen in the first frame and in "
            f"{1.0 - MOST_UNSEEN:.0%} of all; {len(unseen)} of {len(found)} lack them: {', '.join(unseen[:9])}"
        )
    return found


def _calibrated(seen: list[Corners], size_px: tuple[int, int]) -> tuple[Lens, float]:
    """Return the lens by which a film sees the board, and the relative standard uncertainty of its focal length.

    A camera on a stand that faces the board cannot tell its focal length from its distance. What the corners do not
    say, the lenses of phones do: the logarithm of the focal length has the larger of two probabilities together.

    Args:
        seen: Corners of the board in the frames that show it.
        size_px: Width and height of the film [px].
    """
    chosen = seen[:: math.ceil(len(seen) / MOST_CALIBRATED)]
    objects, pictures = (
        [one[part].astype(np.float32) for one in chosen] for part in (0, 1)
    )
    corner_count = sum(map(len, objects))
    names = (
        "USE_INTRINSIC_GUESS",
        "FIX_FOCAL_LENGTH",
        "FIX_PRINCIPAL_POINT",
        "ZERO_TANGENT_DIST",
        "FIX_K2",
        "FIX_K3",
    )
    fixed = sum(getattr(cv2, f"CALIB_{name}") for name in names)
    usual = math.log(PHONE_FOCAL_LENGTH * size_px[0])

    def fitted(log_focal: float) -> tuple[float, Lens]:
        """Return half the weighted square of all misfits, and the lens."""
        focal_px = math.exp(log_focal)
        matrix = (
            (focal_px, 0.0, 0.5 * size_px[0]),
            (0.0, focal_px, 0.5 * size_px[1]),
            (0.0, 0.0, 1.0),
        )
        misfit_px, _, bent, *_ = cv2.calibrateCamera(
            objects, pictures, size_px, np.array(matrix), None, flags=fixed
        )
        corners = corner_count * (misfit_px / CORNER_SIGMA_PX) ** 2
        phones = ((log_focal - usual) / PHONE_SIGMA) ** 2
        lens = Lens(matrix=matrix, distortion=(float(bent.flat[0]), 0.0))
        return 0.5 * (corners + phones), lens

    reach = 4.0 * PHONE_SIGMA
    best = minimize_scalar(
        lambda log_focal: fitted(log_focal)[0],
        bounds=(usual - reach, usual + reach),
        method="bounded",
        options={"xatol": 1e-3},
    )
    middle, lens = fitted(best.x)
    step = 0.1 * PHONE_SIGMA
    around = fitted(best.x - step)[0] + fitted(best.x + step)[0]
    curvature = max((around - 2.0 * middle) / step**2, 1.0 / PHONE_SIGMA**2)
    return lens, 1.0 / math.sqrt(curvature)
