"""Compute generalized trajectories g(t) from markers: curvature and face areas.

All functions are pure and vectorized over frames. Input is in metres, with NaN for a missing marker. Output is in the
units of the published scores: mm, rad and mm^2.
"""

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike

from gauge_envs.errors import ShapeError
from gauge_envs.scene.geometry import FloatArray, IntArray

MAX_MARKER_DISTANCE_M = 0.01
"""Largest distance between a marker and its proxy (paper, simulation and track: below 1 cm)."""


class AngleDeficits:
    """Discrete Gaussian curvature at each marker of one textile (paper, appendix on metrics, K).

    k_i is the full angle of a flat sheet at the marker minus the sum of the angles of its faces there. The full angle
    is 2 pi inside, pi on an edge and pi/2 in a corner. As in the paper, the sum skips faces with a missing or a
    coincident vertex, so k_i grows by their angles. The index arrays and the matrix depend on the textile alone.

    Args:
        faces: Marker indices of the triangles, shape [face_count, 3].
        marker_count: Number of markers.
        corner: Indices of the markers in a corner of the sheet.
        edge: Indices of the markers on a straight edge; all others are inside.
    """

    def __init__(
        self,
        faces: ArrayLike,
        marker_count: int,
        *,
        corner: Collection[int],
        edge: Collection[int],
    ) -> None:
        table = np.asarray(faces)
        # Own, next and previous marker of each corner.
        turned = [np.roll(table, shift, axis=1).ravel() for shift in (0, -1, 1)]
        self._corners = np.array(turned)
        self._full_angle = np.full(marker_count, 2 * np.pi)
        self._full_angle[list(edge)] = np.pi
        self._full_angle[list(corner)] = np.pi / 2
        self._incidence = np.zeros((table.size, marker_count))
        self._incidence[np.arange(table.size), table.ravel()] = 1.0

    def __call__(self, markers_m: FloatArray) -> FloatArray:
        """Return the curvature [rad], shape [frame_count, marker_count]; NaN where the marker itself is missing.

        Args:
            markers_m: Marker positions [m], shape [frame_count, marker_count, 3]; NaN where missing.
        """
        corners = _axes(markers_m).take(self._corners, axis=2)
        own = corners[:, :, 0]
        angles = _angle_between(corners[:, :, 1] - own, corners[:, :, 2] - own)
        is_missing = np.isnan(markers_m).any(axis=-1)
        if is_missing.any():
            angles[np.isnan(angles)] = 0.0
        # A product with the incidence matrix sums the angles of a frame, with the same bits in any batch. The angle at
        # coincident vertices is 0.
        sums = np.matmul(angles[:, None], self._incidence)[:, 0]
        curvature: FloatArray = self._full_angle - sums
        curvature[is_missing] = np.nan
        return curvature


def line_turning_angle(markers_m: ArrayLike, lines: ArrayLike) -> FloatArray:
    """Return the turning angle at the inner markers of polylines, for a textile with lines of markers and no faces.

    Textile bending publishes `lines`, pairs of consecutive markers along two rows. The turning angle is the angle
    between the two segments that meet at a marker; it is 0 for a straight row. Markers at the end of a row have none.

    Args:
        markers_m: Marker positions, shape [frame_count, marker_count, 3], m; NaN where missing.
        lines: Marker indices of consecutive segments, from and to, shape [line_count, 2].

    Returns:
        Angles in [0, pi] at the markers where one segment ends and another starts, in order of the marker indices,
        shape [frame_count, inner_count], rad; NaN where a neighbour is missing or coincident.
    """
    markers_m = np.asarray(markers_m)
    pairs = np.asarray(lines).tolist()
    before = {end: start for start, end in pairs}
    after = dict(pairs)
    if len(before) < len(pairs) or len(after) < len(pairs):
        raise ShapeError(
            "lines: a marker starts, or ends, more than one segment; rows must neither branch nor double"
        )
    inner = sorted(before.keys() & after.keys())
    if not inner:
        raise ShapeError("lines: no marker has a segment on both sides")
    incoming = markers_m[:, inner] - markers_m[:, [before[i] for i in inner]]
    outgoing = markers_m[:, [after[i] for i in inner]] - markers_m[:, inner]
    coincident = (incoming == 0).all(axis=-1) | (outgoing == 0).all(axis=-1)
    angles = _angle_between(_axes(incoming), _axes(outgoing))
    return np.where(coincident, np.nan, angles)


def face_areas_mm2(markers_m: ArrayLike, faces: ArrayLike) -> FloatArray:
    """Return the areas of the triangles between neighbouring markers of a deformable body (paper, g(t) = A).

    Args:
        markers_m: Marker positions, shape [frame_count, marker_count, 3], m; NaN where missing.
        faces: Marker indices of the triangles, shape [face_count, 3].

    Returns:
        Areas, shape [frame_count, face_count], mm^2; NaN where a vertex is missing.
    """
    markers_m = np.asarray(markers_m, dtype=np.float64)
    axes = 1e3 * _axes(markers_m)
    a, b, c = (axes.take(vertex, axis=2) for vertex in np.asarray(faces).T)
    return 0.5 * _cross_length(b - a, c - a)


def assign_markers(markers_m: ArrayLike, nodes_m: ArrayLike) -> IntArray:
    """Return the node of a simulated mesh that is the proxy of each marker.

    Each node is used once, and the summed distance is the smallest (Hungarian algorithm).

    Args:
        markers_m: Initial marker positions, shape [marker_count, 3], m.
        nodes_m: Initial node positions of the mesh, shape [node_count, 3], m.

    Returns:
        Node index of each marker, shape [marker_count].
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    distances = cdist(markers_m, nodes_m)
    markers, nodes = linear_sum_assignment(distances)
    if len(nodes) < len(distances):
        raise ShapeError(
            f"{len(nodes)} nodes are too few for {len(distances)} markers; refine the mesh"
        )
    assigned = distances[markers, nodes]
    worst = int(np.argmax(assigned))
    if assigned[worst] > MAX_MARKER_DISTANCE_M:
        raise ShapeError(
            f"marker {worst} is {1e3 * assigned[worst]:.1f} mm from its node {nodes[worst]}; "
            f"the limit is {1e3 * MAX_MARKER_DISTANCE_M:.1f} mm"
        )
    return nodes


def _axes(vectors: FloatArray) -> FloatArray:
    """Return arrays of x, y and z, shape [3, frame_count, count], from vectors of shape [frame_count, count, 3].

    They are several times as fast as vectors, with the same bits.
    """
    return np.ascontiguousarray(vectors.transpose(2, 0, 1))


def _angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angle in [0, pi] between vectors of the first axis, 0 for a zero vector.

    atan2 is precise near 0 and pi; arccos is not.
    """
    (x, y, z), (u, v, w) = a, b
    product = x * u + y * v + z * w
    # The product of a zero vector may be -0.0, whose angle would be pi; the sum with 0.0 is +0.0.
    return np.asarray(np.arctan2(_cross_length(a, b), product + 0.0))


def _cross_length(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the length of the cross product of vectors of the first axis."""
    (x, y, z), (u, v, w) = a, b
    p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
    return np.asarray(np.sqrt(p * p + q * q + r * r))
