"""Interpolation between scattered material points, for every engine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEIGHBOURS = 24
"""Number of material points from which a tracked point is interpolated."""


def linear_weights(
    sources_m: NDArray[np.float64], points_m: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the nearest sources of each point and moving-least-squares weights that reproduce linear functions.

    Returns:
        Indices of the sources and their weights, both of shape [point_count, NEIGHBOURS].
    """
    distance, nearest = cKDTree(sources_m).query(points_m, k=NEIGHBOURS)
    # The weight falls to 2 % at the farthest neighbour.
    near = np.exp(-4.0 * np.square(distance / distance[:, -1:]))
    offsets = sources_m[nearest] - points_m[:, None]
    basis = np.concatenate([np.ones_like(offsets[..., :1]), offsets / distance[:, -1:, None]], axis=-1)
    moments = np.einsum("pk,pki,pkj->pij", near, basis, basis)
    # The value at the point itself is the first coefficient.
    first = np.linalg.solve(moments, np.broadcast_to(np.eye(4)[:, :1], (len(points_m), 4, 1)))[..., 0]
    return nearest, near * np.einsum("pki,pi->pk", basis, first)
