"""Compute statistics of the deformation of a solid from its markers: strain, volume ratio, non-affine residual.

The markers of a solid at rest and now define a least-squares affine map, x = F X + c. F is the mean deformation
gradient of the marked material. Its stretch U = (F^T F)^(1/2) is free of the rotation. The Biot strain U - 1 is the
elongation per length in each direction. What the map leaves is the non-affine residual.

Placement errors of markers hardly enter: strain is relative to the markers' own places at rest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.errors import ShapeError
from gauge_envs.scene import Scene, SoftBody
from gauge_envs.scene.geometry import BoolArray, FloatArray, IntArray

STATISTICS = (
    "strain.xx",
    "strain.yy",
    "strain.zz",
    "strain.xy",
    "strain.xz",
    "strain.yz",
    "strain.lateral",
    "volume_ratio",
    "area_ratio",
    "non_affine",
)
"""Names of the statistics, in the order of the columns of `deformation_statistics`."""

LEAST_EXTENT_M = 2e-3
"""Root-mean-square extent of the markers [m] below which they do not determine F; placement errors reach 0.9 mm."""

SPANNED_COSINE = 0.98
"""Least length of the projection of a unit axis on the span of the markers, for strain along that axis."""

NORMAL_MEDIAN = 0.674489750196
"""Median of the absolute value of a standard normal variable."""

SHEARS = ((0, 1), (0, 2), (1, 2))


def statistic_unit(name: str) -> str:
    """Return the unit of a statistic: mm for the non-affine residual, 1 for strain and ratios."""
    return "mm" if name == "non_affine" else "1"


@dataclass(frozen=True, kw_only=True, eq=False)
class AffineMap:
    """Least-squares affine map of markers from rest to each frame.

    Attributes:
        gradient: F, shape [frame_count, 3, 3]; its null space is what the markers do not span at rest. NaN where too
            few markers are left.
        span: Projector on the directions that the markers span at rest, shape [frame_count, 3, 3].
        rank: Number of these directions, shape [frame_count]: 3 in space, 2 in a plane, 1 on a line.
        residual_m: Position less its image under the map [m], shape [frame_count, marker_count, 3]; NaN where missing.
    """

    gradient: FloatArray
    span: FloatArray
    rank: IntArray
    residual_m: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkedSolid:
    """The solid that carries the markers of a scene.

    Attributes:
        axes: Axes of the block in the world frame as columns, shape [3, 3].
        long_axis: Index of the block's longest axis; None if two are equally long.
    """

    axes: FloatArray
    long_axis: int | None


def marked_solid(scene: Scene) -> MarkedSolid | None:
    """Return the solid that carries the markers; None for markers on cloth, lines, or blocks turned differently.

    Several parallel blocks count as one solid.
    """
    if scene.markers is None:
        return None
    blocks = [body for body in scene.deformables if body.name in scene.markers.bodies]
    solids = [body for body in blocks if isinstance(body, SoftBody)]
    if not solids or len(solids) < len(blocks):
        return None
    axes = [
        (one.pose.to_world(np.eye(3)) - np.asarray(one.pose.position_m)).T
        for one in solids
    ]
    if any(np.abs(other - axes[0]).max() > 1e-9 for other in axes):
        return None
    sizes = np.max([solid.shape.size_m for solid in solids], axis=0)
    longest = np.flatnonzero(sizes > 0.999 * sizes.max())
    return MarkedSolid(
        axes=axes[0], long_axis=int(longest[0]) if len(longest) == 1 else None
    )


def affine_map(rest_m: ArrayLike, markers_m: ArrayLike) -> AffineMap:
    """Return the least-squares affine map of markers from rest to each frame.

    A direction in which the markers extend by less than 2 mm (root mean square) is left out: F is then the
    pseudo-inverse solution in the plane, or on the line, that remains. Markers that are missing at rest or in a frame
    are left out of that frame.

    Args:
        rest_m: Marker positions at rest [m], shape [marker_count, 3]; NaN where missing.
        markers_m: Marker positions [m], shape [frame_count, marker_count, 3]; NaN where missing.
    """
    rest, markers = (
        np.asarray(rest_m, dtype=np.float64),
        np.asarray(markers_m, dtype=np.float64),
    )
    if rest.ndim != 2 or rest.shape[1] != 3:
        raise ShapeError(f"rest_m has shape {rest.shape}; [marker_count, 3] is needed")
    if markers.ndim != 3 or markers.shape[1:] != rest.shape:
        raise ShapeError(
            f"markers_m has shape {markers.shape}; [frame_count, {len(rest)}, 3] is needed"
        )
    frame_count = len(markers)
    gradient, span = np.full((2, frame_count, 3, 3), np.nan)
    rank, residual = (
        np.zeros(frame_count, dtype=np.intp),
        np.full(markers.shape, np.nan),
    )
    seen = np.isfinite(rest).all(axis=1) & np.isfinite(markers).all(axis=2)
    # Frames with the same markers share the inverse of the rest positions.
    patterns, pattern_of = np.unique(seen, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        if not pattern.any():
            continue
        frames = np.flatnonzero(pattern_of.ravel() == number)
        before = rest[pattern] - rest[pattern].mean(axis=0)
        after = markers[frames][:, pattern]
        after = after - after.mean(axis=1, keepdims=True)
        _, extents, directions = np.linalg.svd(before, full_matrices=False)
        kept = directions[extents > LEAST_EXTENT_M * np.sqrt(len(before))]
        if not len(kept):
            continue
        maps = np.linalg.pinv(before @ kept.T) @ after  # [frame, kept, xyz]
        gradient[frames] = np.einsum("fkc,kd->fcd", maps, kept)
        span[frames] = kept.T @ kept
        rank[frames] = len(kept)
        residual[np.ix_(frames, np.flatnonzero(pattern))] = (
            after - (before @ kept.T) @ maps
        )
    return AffineMap(gradient=gradient, span=span, rank=rank, residual_m=residual)


def deformation_statistics(
    rest_m: ArrayLike,
    markers_m: ArrayLike,
    solid: MarkedSolid,
    *,
    noise_m: ArrayLike | None = None,
) -> FloatArray:
    """Return the statistics of the deformation of a solid at each frame, in the order of `STATISTICS`.

    - `strain.xx` to `strain.yz`: components of the Biot strain U - 1 in the axes of the block. A component is reported
      if the markers span both of its axes.
    - `strain.lateral`: mean of the two normal strains across the block's longest axis.
    - `volume_ratio`: det F, for markers in space.
    - `area_ratio`: area over area at rest, for markers in a plane.
    - `non_affine`: root-mean-square distance of the markers from the affine map. The share that noise is expected to
      have is subtracted in squares; a negative rest is reported as 0.

    Args:
        rest_m: Marker positions at rest [m], shape [marker_count, 3]; NaN where missing.
        markers_m: Marker positions [m], shape [frame_count, marker_count, 3]; NaN where missing.
        solid: The marked solid.
        noise_m: Independent 1-sigma error patterns of the displacements [m], shape [pattern_count, marker_count, 3], as
            `independent_noise` returns; None for exact positions.

    Returns:
        Statistics, shape [frame_count, 10]: strain and ratios without unit, `non_affine` in mm; NaN where the markers
        do not determine a statistic.
    """
    fit = affine_map(rest_m, markers_m)
    values = np.full((len(fit.rank), len(STATISTICS)), np.nan)
    known = fit.rank > 0
    stretch, squares = (
        np.full(fit.gradient.shape, np.nan),
        np.full((len(known), 3), np.nan),
    )
    squares[known], vectors = np.linalg.eigh(
        np.swapaxes(fit.gradient[known], 1, 2) @ fit.gradient[known]
    )
    squares = np.maximum(squares, 0.0)
    stretch[known] = np.einsum(
        "fik,fk,fjk->fij", vectors, np.sqrt(squares[known]), vectors
    )
    strain = np.einsum("ia,fij,jb->fab", solid.axes, stretch - fit.span, solid.axes)
    spanned = (
        np.linalg.norm(fit.span @ solid.axes, axis=1) >= SPANNED_COSINE
    )  # [frame, axis]
    for axis in range(3):
        values[:, axis] = np.where(spanned[:, axis], strain[:, axis, axis], np.nan)
    for column, (first, second) in enumerate(SHEARS, start=3):
        values[:, column] = np.where(
            spanned[:, first] & spanned[:, second], strain[:, first, second], np.nan
        )
    if solid.long_axis is not None:
        across = [axis for axis in range(3) if axis != solid.long_axis]
        values[:, 6] = values[:, across].mean(axis=1)
    solid_frames = fit.rank == 3
    values[solid_frames, 7] = np.linalg.det(fit.gradient[solid_frames])
    values[:, 8] = np.where(
        fit.rank == 2, np.sqrt(squares[:, 2] * squares[:, 1]), np.nan
    )
    values[:, 9] = 1e3 * np.sqrt(
        np.maximum(_mean_square(fit) - _noise_mean_square(rest_m, fit, noise_m), 0.0)
    )
    return values


def _mean_square(fit: AffineMap) -> FloatArray:
    """Return the mean square distance from the map [m^2], shape [frame_count]; NaN where the map fits any positions."""
    counts = np.isfinite(fit.residual_m).all(axis=2).sum(axis=1)
    sums = np.square(np.nan_to_num(fit.residual_m)).sum(axis=(1, 2))
    return np.divide(
        sums, counts, out=np.full(len(sums), np.nan), where=counts > fit.rank + 1
    )


def noise_residuals(
    rest_m: ArrayLike, noise_m: FloatArray, seen: BoolArray
) -> FloatArray:
    """Return what the affine map leaves of each error pattern [m], shape [pattern_count, marker_count, 3]."""
    rest = np.where(seen[:, None], np.asarray(rest_m, dtype=np.float64), np.nan)
    return np.nan_to_num(affine_map(rest, noise_m).residual_m)


def _noise_mean_square(
    rest_m: ArrayLike, fit: AffineMap, noise_m: ArrayLike | None
) -> FloatArray:
    expected = np.zeros(len(fit.rank))
    if noise_m is None:
        return expected
    noise = np.asarray(noise_m, dtype=np.float64)
    seen = np.isfinite(fit.residual_m).all(axis=2)
    patterns, pattern_of = np.unique(seen, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        left = noise_residuals(rest_m, noise, pattern)
        expected[pattern_of.ravel() == number] = np.square(left).sum() / max(
            int(pattern.sum()), 1
        )
    return expected


def independent_noise(sigma_m: ArrayLike) -> FloatArray:
    """Return the error patterns of markers whose coordinates have independent errors.

    Args:
        sigma_m: Standard deviation of each coordinate [m], shape [marker_count, 3].

    Returns:
        One pattern for each coordinate [m], shape [3 * marker_count, marker_count, 3].
    """
    sigma = np.asarray(sigma_m, dtype=np.float64)
    return np.diag(sigma.ravel()).reshape(sigma.size, *sigma.shape)


def white_noise_m(markers_m: ArrayLike) -> float:
    """Return the white noise of each coordinate of a captured trajectory [m, 1 sigma], from its sixth differences.

    Motion that changes slowly between frames cancels in them; independent errors add to sqrt(924) of one. The median
    leaves jumps out. Noise that is correlated between frames is not seen.

    Args:
        markers_m: Marker positions at evenly spaced frames [m], shape [frame_count, marker_count, 3]; NaN: missing.

    Returns:
        Standard deviation [m]; 0 for fewer than seven frames in a row.
    """
    differences = np.abs(np.diff(np.asarray(markers_m, dtype=np.float64), n=6, axis=0))
    known = differences[np.isfinite(differences)]
    return (
        float(np.median(known) / NORMAL_MEDIAN / np.sqrt(924.0)) if known.size else 0.0
    )


def trial_statistics(markers_m: ArrayLike, solid: MarkedSolid) -> FloatArray:
    """Return the statistics of deformation of a captured trial; its first frame is rest.

    The non-affine residual is corrected for the white noise of the trial, which the frame and the rest both have.

    Args:
        markers_m: Marker positions at the frames of the trial [m], shape [frame_count, marker_count, 3]; NaN: missing.
        solid: The marked solid.

    Returns:
        Statistics as from `deformation_statistics`, shape [frame_count, 10].
    """
    markers = np.asarray(markers_m, dtype=np.float64)
    noise = independent_noise(
        np.full(markers.shape[1:], np.sqrt(2.0) * white_noise_m(markers))
    )
    return deformation_statistics(markers[0], markers, solid, noise_m=noise)
