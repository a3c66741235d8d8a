"""Solve Funnel by geometry: how far the ball draws the cloth over the board.

    python studies/solutions/funnel.py [FOLDER]

A warp or weft line through the middle of the cloth stays in its vertical plane and does not stretch. It lies flat on
the board to the edge of the hole, goes straight from there to the ball, and lies on the ball to its lowest point.
What is longer than the radius of the hole came from the board, so it moved a marker inward.

The solution has the mean over opposite markers of the four on these lines that stay on the board. It ends where the
centre of the ball is level with the board: deeper, folds between ball and hole can hold cloth that no line needs, and
the shortest line is a lower bound alone. u is what geometry leaves out, each with a rectangular distribution (JCGM
100, 4.3.7):

- Stretch under the weight that hangs over the board, friction on the board and over both edges (Capstan equation),
  twice that of a strip, as a line at the marker draws on half of its length at the hole.
- Slack: before the ball touches it, the cloth sags into the hole until its tension overcomes the same friction.
- Inertia: the way on which friction brakes the cloth.
"""

import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from store import store_solution

from gauge_envs import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.scene import Cloth, ConvexUnion, Scene, Sphere
from gauge_envs.scene.timing import FRAME_RATE_HZ

FABRICS = ("rayon", "satin", "uniform", "nylon", "oxford", "leather")
MARKER_DISTANCE_M = 0.2
"""Distance of the four markers from the middle of the cloth."""

CONVERGENCE = MARKER_DISTANCE_M / 0.1
"""Length around the middle at the markers over that at the hole."""

Array = NDArray[np.float64]


def hole_and_half_width_m(scene: Scene) -> tuple[float, float]:
    """Return the radius of the hole along the lines, and half of the width of the board."""
    board = scene.body("board")
    assert isinstance(board.shape, ConvexUnion)
    corners_m = np.concatenate([np.array(piece) for piece in board.shape.pieces_m])
    on_line_m = corners_m[np.abs(corners_m[:, 1]) < 1e-9, 0]
    return float(np.abs(on_line_m).min()), float(np.abs(corners_m[:, 0]).max())


def line_m(height_m: Array, hole_m: float, ball_m: float) -> tuple[Array, Array]:
    """Return the length of a line from the edge of the hole to the axis, and its angle below the board at the edge.

    Args:
        height_m: Height of the ball's centre over the edge, at most the radius of the ball.
        hole_m: Radius of the hole.
        ball_m: Radius of the ball.
    """
    distance_m = np.hypot(hole_m, height_m)
    straight_m = np.sqrt(distance_m**2 - ball_m**2)
    bend_rad = np.arctan2(-height_m, hole_m) + np.arcsin(ball_m / distance_m)
    return straight_m + ball_m * bend_rad, bend_rad


def drawn_m(scene: Scene, times_s: Array) -> tuple[Array, Array]:
    """Return how far the ball draws a line inward [m], and the angle of the line below the board, each of shape [T].

    Both are NaN once the centre of the ball is below the board.
    """
    (cloth,), ball = scene.deformables, scene.body("ball")
    assert isinstance(cloth, Cloth)
    assert isinstance(ball.shape, Sphere)
    hole_m, _ = hole_and_half_width_m(scene)
    ball_m = ball.shape.radius_m + 0.5 * cloth.thickness_m
    ball_z_m = scene.drivers[0].path(ball.pose, times_s)[:, 2]
    height_m = ball_z_m - cloth.pose.position_m[2]
    height_m[height_m < 0.0] = np.nan
    length_m, bend_rad = line_m(np.minimum(height_m, ball_m), hole_m, ball_m)
    return length_m - hole_m, bend_rad


def left_out_m(scene: Scene, times_s: Array) -> Array:
    """Return the standard uncertainty of the drawn length [m], shape [T]: stretch, slack and inertia."""
    (cloth,) = scene.deformables
    assert isinstance(cloth, Cloth)
    moved_m, bend_rad = drawn_m(scene, times_s)
    hole_m, board_m = hole_and_half_width_m(scene)
    friction = scene.contacts[0].friction
    gravity = scene.gravity_m_per_s2
    weight_n_per_m2 = cloth.areal_density_kg_per_m2 * gravity
    hanging_m = 0.5 * cloth.size_m[0] - board_m
    over_edge_m = hanging_m * math.exp(friction * math.pi / 2.0)
    # Tension at the hole of a strip that slips inward, over its weight per area [m].
    pull_m = over_edge_m + friction * (board_m - hole_m)
    pull_n_per_m = weight_n_per_m2 * pull_m * np.exp(friction * bend_rad)
    strain = CONVERGENCE * pull_n_per_m / cloth.stretch_stiffness_n_per_m
    stretch_m = np.where(moved_m > 0.0, strain * MARKER_DISTANCE_M, 0.0)
    # A shallow sag s over a span L has the length L + 8 s^2 / (3 L), with s = L^2 weight / (8 tension).
    span_m = 2.0 * hole_m
    sag_m = span_m**2 / (8.0 * pull_m)
    slack_m = np.maximum(4.0 * sag_m**2 / (3.0 * span_m) - moved_m, 0.0)
    speed_m_per_s = np.diff(moved_m, prepend=0.0) * FRAME_RATE_HZ
    coast_m = speed_m_per_s**2 / (2.0 * friction * gravity)
    squares_m2 = stretch_m**2 + slack_m**2 + coast_m**2
    return np.sqrt(squares_m2 / 3.0)


def solve(folder: Path, variant: str) -> None:
    """Write the reference of one fabric."""
    experiment = load_experiment(variant)
    scene = experiment.scene
    times_s = np.arange(experiment.frame_count) / FRAME_RATE_HZ
    moved_m, _ = drawn_m(scene, times_s)
    (cloth,) = scene.deformables
    middle_m = np.array(cloth.pose.position_m)
    from_middle_m = np.array(scene.markers.positions_m) - middle_m
    distances_m = np.linalg.norm(from_middle_m, axis=1)
    on_line = np.isclose(distances_m, MARKER_DISTANCE_M)
    # The mean over opposite markers does not change when the cloth slides as a whole.
    projection = np.zeros((2, from_middle_m.size))
    for axis in range(2):
        for marker in np.flatnonzero(on_line & (from_middle_m[:, axis] != 0.0)):
            inward = -np.sign(from_middle_m[marker, axis])
            projection[axis, 3 * marker + axis] = 0.5 * inward
    start_mm = projection @ (middle_m + from_middle_m).ravel() * 1e3
    mean_mm = start_mm + 1e3 * moved_m[:, None]
    uncertainty_mm = np.repeat(1e3 * left_out_m(scene, times_s)[:, None], 2, axis=1)
    store_solution(
        folder / variant,
        kind="analytic",
        coordinates=["inward-x", "inward-y"],
        source=(
            "markers on the lines through the middle of the cloth: a line that does not stretch goes straight from the "
            "hole's edge to the ball and around it, until the ball's centre is level with the board; u is the line's "
            "stretch, slack and inertia"
        ),
        mean=mean_mm,
        uncertainty=uncertainty_mm,
        projection=projection,
    )


if __name__ == "__main__":
    target = Path(sys.argv[1]) if sys.argv[1:] else data_folder("scoring") / "bands"
    for fabric in FABRICS:
        solve(target, f"Funnel-{fabric}")
