"""Copies among recorded tosses: recordings that are one toss, laid elsewhere on the table.

    python scripts/toss_copies.py VARIANT [--parts 10]      counts pairs of tosses by their distance

A toss may be turned about the vertical, mirrored, shifted along the table and in time, and its corners may be named in
another order, as by a symmetry of the body. None of that changes the heights of its corners, sorted in each frame. So
the root mean square difference of sorted heights is at most the distance of the corners themselves in the best of
these positions, and a search below a tolerance misses no copy. What it finds is then laid over the other toss.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.single_shot import single_shots
from gauge_envs.scene import Box

__all__ = ["TOLERANCE_M", "copies", "height_distances_m", "placed_distance_m"]

FloatArray = NDArray[np.float64]

TOLERANCE_M = 1e-4
"""Distance below which two tosses are copies."""

WINDOW = 40
"""Frames that are compared: 0.27 s, in which a toss flies and strikes."""

EDGES_MM = (0.0, 0.01, 0.1, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, np.inf)


def height_distances_m(
    corners_m: Sequence[FloatArray], *, parts: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Return how far the sorted heights of the corners of tosses are apart, root mean square.

    The first `WINDOW` frames of one toss are compared with each stretch of the other one.

    Args:
        corners_m: Corners of each toss, shape [T, V, 3], with the same V.
        parts: Parts of a frame by which a toss is shifted in time.

    Returns:
        Distances [m], shape [N, N], infinite on the diagonal; and the frame of the toss of the column at which that of
        the row begins, of the same shape. Tosses with fewer frames than the window are infinitely far.
    """
    heights = []
    for corners in corners_m:
        times = np.arange(parts * (len(corners) - 1) + 1) / parts
        heights.append(
            np.sort(
                CubicSpline(np.arange(len(corners)), corners[:, :, 2])(times), axis=1
            )
        )
    span, count = parts * (WINDOW - 1) + 1, len(heights)
    size = WINDOW * heights[0].shape[1]
    whole = [place for place, one in enumerate(heights) if len(one) >= span]
    first = np.array([heights[place][:span:parts].ravel() for place in whole])
    nearest, shift = np.full((count, count), np.inf), np.zeros((count, count))
    for begin in range(max(map(len, heights)) - span + 1):
        long = [place for place in whole if len(heights[place]) >= begin + span]
        later = np.array(
            [heights[place][begin : begin + span : parts].ravel() for place in long]
        )
        square = (
            np.sum(first**2, axis=1)[:, None]
            + np.sum(later**2, axis=1)
            - 2.0 * first @ later.T
        )
        found, cells = np.sqrt(np.maximum(square, 0.0) / size), np.ix_(whole, long)
        closer = found < nearest[cells]
        nearest[cells] = np.where(closer, found, nearest[cells])
        shift[cells] = np.where(closer, begin / parts, shift[cells])
    np.fill_diagonal(nearest, np.inf)
    return nearest, shift


def placed_distance_m(one_m: FloatArray, other_m: FloatArray) -> float:
    """Return the largest distance of a corner from the closest one of the other toss, laid over the first one.

    The other toss is turned about the vertical, mirrored or not, and shifted along the table, so that the middles of
    the corners pass closest in all frames.

    Args:
        one_m: Corners of a toss, shape [T, V, 3].
        other_m: Corners of the other one in as many frames.
    """
    found = []
    for sign in (1.0, -1.0):
        flat, placed = (
            corners[..., 0] + 1j * corners[..., 1]
            for corners in (one_m, other_m * [1.0, sign, 1.0])
        )
        flat, placed = flat - flat.mean(), placed - placed.mean()
        placed = placed * np.exp(
            1j * np.angle(np.sum(flat.mean(axis=1) * np.conj(placed.mean(axis=1))))
        )
        clouds = [
            np.stack([at.real, at.imag, up[..., 2]], -1)
            for at, up in ((flat, one_m), (placed, other_m))
        ]
        found.append(
            max(
                cKDTree(here).query(there)[0].max()
                for here, there in zip(*clouds, strict=True)
            )
        )
    return float(min(found))


def copies(corners_m: Sequence[FloatArray]) -> dict[int, int]:
    """Return the tosses that repeat an earlier one, shifted in time by whole frames or not, and which one they repeat.

    Args:
        corners_m: Corners of each toss, shape [T, V, 3], with the same V.

    Raises:
        ValueError: The heights of two tosses agree, but not all their corners.
    """
    distances, shifts = height_distances_m(corners_m)
    found: dict[int, int] = {}
    for one, other in np.argwhere(
        np.triu(np.minimum(distances, distances.T) < TOLERANCE_M)
    ).tolist():
        # The toss whose first frames are compared begins later.
        late, early = (
            (one, other)
            if distances[one, other] <= distances[other, one]
            else (other, one)
        )
        rows = corners_m[early][round(float(shifts[late, early])) :]
        length = min(len(rows), len(corners_m[late]))
        apart_m = placed_distance_m(corners_m[late][:length], rows[:length])
        if apart_m > TOLERANCE_M:
            raise ValueError(
                f"tosses {one} and {other} have equal heights, but are {1e3 * apart_m:.3g} mm apart"
            )
        found.setdefault(other, found.get(one, one))
    return found


def recorded_corners_m(variant: str) -> list[FloatArray]:
    """Return the corners of all recorded bodies in each toss of a variant, shape [T, V, 3]."""
    shots = single_shots(variant)
    if shots is None:
        raise SystemExit(f"{variant} has no recorded tosses")
    scene, found = load_experiment(variant).scene, []
    for trial in range(len(shots)):
        clouds = []
        for shot in (shots.shot(trial, body) for body in shots.sidecar.bodies):
            shape = scene.body(shot.body).shape
            assert isinstance(shape, Box)
            turned = np.einsum(
                "tij,vj->tvi", shot.rotations.as_matrix(), shape.corners_m
            )
            clouds.append(shot.positions_m[:, None] + turned)
        found.append(np.concatenate(clouds, axis=1))
    return found


def main() -> None:
    """Print how many pairs of tosses are how far apart."""
    parser = argparse.ArgumentParser(
        description="Count pairs of recorded tosses by their distance."
    )
    parser.add_argument("variant")
    parser.add_argument(
        "--parts",
        type=int,
        default=10,
        help="parts of a frame by which tosses are shifted in time",
    )
    options = parser.parse_args()
    corners_m = recorded_corners_m(options.variant)
    repeats = copies(corners_m)
    distances, _ = height_distances_m(corners_m, parts=options.parts)
    pairs_mm = 1e3 * np.sort(
        np.minimum(distances, distances.T)[np.triu_indices(len(corners_m), 1)]
    )
    print(f"{len(corners_m)} tosses, {len(repeats)} of them copies: {repeats}")
    print(
        f"closest pairs: {', '.join(f'{value:.4f}' for value in pairs_mm[: len(repeats) + 3])} mm"
    )
    for low, high, count in zip(
        EDGES_MM, EDGES_MM[1:], np.histogram(pairs_mm, EDGES_MM)[0], strict=False
    ):
        print(f"{low} to {high} mm: {count} pairs")


if __name__ == "__main__":
    main()
