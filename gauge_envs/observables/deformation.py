"""Compute the deformation of a marked solid: strain, and the ratio of areas.

The markers at rest and after deformation define a least-squares affine map, x = F X + c. F is the mean deformation
gradient of the marked material. Its stretch U = (F^T F)^(1/2) does not contain the rotation. The Biot strain U - 1 is
the elongation per length in each direction.
"""

import math
from collections.abc import Mapping

import numpy as np

from gauge_envs.scene import Scene, SoftBody
from gauge_envs.scene.geometry import FloatArray

MIN_EXTENT_M = 2e-3
"""Root-mean-square extent of the markers [m] below which they do not determine F; placement errors reach 0.9 mm."""

SPANNED_COSINE = 0.98
"""Smallest projection of a unit axis on the span of the markers that gives a strain along the axis."""


def solid_axes(scene: Scene) -> FloatArray:
    """Return the axes of the solid that carries the markers, in the world frame as columns, shape [3, 3]."""
    marked = () if scene.markers is None else scene.markers.bodies
    pose = next(
        body.pose
        for body in scene.deformables
        if isinstance(body, SoftBody) and body.name in marked
    )
    return (pose.to_world(np.eye(3)) - np.asarray(pose.position_m)).T


def deformation(
    rest_m: FloatArray, deformed_m: FloatArray, axes: FloatArray
) -> Mapping[str, float]:
    """Return the deformation of a solid by name; NaN if the markers do not determine a quantity.

    - `strain_zz`, `strain_xz`: components of the Biot strain in the axes of the solid, if the markers span these axes.
    - `area_ratio`: area over area at rest, for markers in a plane.

    Args:
        rest_m: Marker positions at rest [m], shape [marker_count, 3].
        deformed_m: Marker positions of the deformed solid [m], shape [marker_count, 3].
        axes: Axes of the solid, see `solid_axes`.
    """
    before, after = rest_m - rest_m.mean(axis=0), deformed_m - deformed_m.mean(axis=0)
    _, extents, directions = np.linalg.svd(before, full_matrices=False)
    span = directions[extents > MIN_EXTENT_M * math.sqrt(len(before))]
    gradient = (np.linalg.pinv(before @ span.T) @ after).T @ span
    squares, vectors = np.linalg.eigh(gradient.T @ gradient)
    squares = np.maximum(squares, 0.0)
    stretch = vectors * np.sqrt(squares) @ vectors.T
    strain = axes.T @ (stretch - span.T @ span) @ axes
    is_spanned = np.linalg.norm(span @ axes, axis=0) >= SPANNED_COSINE
    strain[~np.outer(is_spanned, is_spanned)] = math.nan
    is_plane = len(span) == 2
    return {
        "strain_zz": float(strain[2, 2]),
        "strain_xz": float(strain[0, 2]),
        "area_ratio": math.sqrt(squares[1] * squares[2]) if is_plane else math.nan,
    }
