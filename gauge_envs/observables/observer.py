"""Observe the generalized trajectory g(t) of a running simulation, from body positions or markers.

Nodes of a simulated body do not coincide with its markers. By default, the marker proxy is the material point of the
marker, interpolated between nodes. The paper uses the nearest node. This shifts markers by up to 5 mm on a foam with
the default mesh, so its scores depend on the mesh.
"""

from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from functools import lru_cache, partial

import numpy as np

from gauge_envs.backends.simulation import Sampler, Simulation
from gauge_envs.errors import ShapeError
from gauge_envs.observables.functions import (
    MAX_MARKER_DISTANCE_M,
    AngleDeficits,
    assign_markers,
    face_areas_mm2,
    line_turning_angle,
)
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene import Cloth, Deformable, Markers, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray


class MarkerProxy(StrEnum):
    """Marker proxy: the point of the simulation that stands for a marker."""

    MATERIAL = "material"
    """The material point of the marker, interpolated between the nodes of its element; the default."""
    NODE = "node"
    """The nearest node, each used once (Hungarian algorithm), as in the paper."""


class ObserverPositions:
    """Observer of the positions of rigid bodies [mm]."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)

    def read(self, simulation: Simulation) -> FloatArray:
        """Return the states of the bodies now, shape [N, count, 13]."""
        return simulation.body_states(self._names)

    def sampler(self, simulation: Simulation, rows: FloatArray) -> Sampler:
        """Return a sampler of these states."""
        return simulation.sampler(self._names, rows)

    def points(self, readings: FloatArray) -> FloatArray:
        """Return the positions of states."""
        return readings[..., :3]

    def observe(self, points_m: FloatArray) -> FloatArray:
        """Return the positions [mm], shape [..., width]."""
        return 1e3 * points_m.reshape(*points_m.shape[:-2], -1)


class ObserverMarkers:
    """Observer of markers on deformable bodies: their positions, curvature or triangle areas.

    Args:
        scene: Scene with the positions of the markers at rest.
        observable: Kind of generalized trajectory.
        simulation: Worlds at the nominal start, for the nodes at rest.
        proxy: Marker proxy.

    Attributes:
        indices: Nodes of each marker, shape [marker_count, k]; not set if the engine tracks material points.
        weights: Weights of these nodes, of the same shape.
    """

    def __init__(
        self,
        scene: Scene,
        observable: Observable,
        simulation: Simulation,
        proxy: MarkerProxy,
    ) -> None:
        if scene.markers is None:
            raise ShapeError(
                f"observable {observable.value!r} needs markers, but the scene has none"
            )
        self._bodies = scene.markers.bodies
        targets_m = np.asarray(scene.markers.positions_m)
        self.marker_count = len(targets_m)
        self._formula = formula_of(scene.markers, observable)
        self._track: Callable[[], FloatArray] | None = None
        if proxy is MarkerProxy.MATERIAL:
            self._track = _tracker(simulation, self._bodies, targets_m)
        if self._track is not None:
            return
        rest = {name: simulation.nodes(name)[0] for name in self._bodies}
        if proxy is MarkerProxy.NODE:
            nearest = assign_markers(targets_m, np.concatenate([*rest.values()]))
            self.indices, self.weights = nearest[:, None], np.ones((len(nearest), 1))
        else:
            deformables = {body.name: body for body in scene.deformables}
            self.indices, self.weights = material_points(targets_m, rest, deformables)
        self._columns = np.flatnonzero(self.weights.any(axis=0)).tolist()

    def markers(self, simulation: Simulation) -> FloatArray:
        """Return the markers now [m], shape [N, marker_count, 3]."""
        return self.points(self.read(simulation))

    def read(self, simulation: Simulation) -> FloatArray:
        """Return the tracked markers, or the nodes of all bodies with markers, now [m]."""
        if self._track is not None:
            return self._track()
        parts = [simulation.nodes(name) for name in self._bodies]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def sampler(self, simulation: Simulation, rows: FloatArray) -> Sampler:
        """Return a sampler of these markers or nodes."""
        return Sampler(partial(self.read, simulation), rows)

    def points(self, readings: FloatArray) -> FloatArray:
        """Return the markers [m]: those read, or the weighted nodes of each."""
        if self._track is not None:
            return readings
        markers_m = np.zeros((*readings.shape[:-2], self.marker_count, 3))
        # Cloth has three nodes for each marker, and a fourth without weight.
        for column in self._columns:
            weights = self.weights[:, column, None]
            markers_m += weights * readings.take(self.indices[:, column], axis=-2)
        return markers_m

    def observe(self, points_m: FloatArray) -> FloatArray:
        """Return g(t) of markers [m], shape [..., width]."""
        g = self._formula(points_m.reshape(-1, self.marker_count, 3))
        return g.reshape(*points_m.shape[:-2], -1)


Observer = ObserverPositions | ObserverMarkers
"""Observer of one kind of generalized trajectory in N worlds.

It reads a simulation at each sample, and computes the observed points of many samples in one pass. `points` returns the
bodies or markers [m] of readings of shape [..., count, width], and `observe` returns their g(t)."""


def _tracker(
    simulation: Simulation, names: Iterable[str], targets_m: FloatArray
) -> Callable[[], FloatArray] | None:
    """Return the engine's tracker of all markers, or None if the engine has none."""
    fault = None
    for name in names:
        try:
            return simulation.track(name, targets_m)
        except ShapeError as error:
            fault = error
    raise fault or ShapeError("the markers are on no body")


def observe_markers(
    markers_m: FloatArray, markers: Markers, observable: Observable
) -> FloatArray:
    """Return g(t) of marker positions.

    Args:
        markers_m: Marker positions [m], shape [sample_count, marker_count, 3]; NaN for a missing marker.
        markers: Faces, lines, corners and edges of the marker set.
        observable: Kind of generalized trajectory.

    Returns:
        g(t) in the observable's unit, shape [sample_count, coordinate_count]; NaN where a marker is missing.
    """
    return formula_of(markers, observable)(np.asarray(markers_m))


def formula_of(
    markers: Markers, observable: Observable
) -> Callable[[FloatArray], FloatArray]:
    """Return the function that computes g(t) from marker positions [m], see `observe_markers`."""
    if observable is Observable.CURVATURE:
        marker_count = len(markers.positions_m)
        return AngleDeficits(
            markers.faces, marker_count, corner=markers.corner, edge=markers.edge
        )
    if observable is Observable.LINE_CURVATURE:
        return partial(line_turning_angle, lines=markers.lines)
    if observable is Observable.FACE_AREA:
        return partial(face_areas_mm2, faces=markers.faces)
    return lambda markers_m: 1e3 * markers_m.reshape(len(markers_m), -1)


def material_points(
    targets_m: FloatArray,
    rest: dict[str, FloatArray],
    deformables: dict[str, Deformable],
) -> tuple[IntArray, FloatArray]:
    """Return the nodes and weights that interpolate each marker at rest; cloth uses three of the four.

    They are computed once for many worlds; the arrays are read-only.

    Args:
        targets_m: Marker positions at rest [m], shape [marker_count, 3].
        rest: Node positions at rest [m] of each body with markers, shape [node_count, 3].
        deformables: Deformable bodies of the scene by name.

    Returns:
        Node indices over the bodies of `rest` in their order, shape [marker_count, 4], and weights of the same shape.
    """
    nodes = tuple(
        (name, nodes_m.tobytes(), deformables[name]) for name, nodes_m in rest.items()
    )
    return _material_points(targets_m.tobytes(), nodes)


@lru_cache(maxsize=8)
def _material_points(
    targets: bytes, bodies: tuple[tuple[str, bytes, Deformable], ...]
) -> tuple[IntArray, FloatArray]:
    targets_m = np.frombuffer(targets).reshape(-1, 3)
    indices = np.zeros((len(targets_m), 4), dtype=np.intp)
    weights = np.zeros((len(targets_m), 4))
    best = np.full(len(targets_m), np.inf)
    first = 0
    for name, content, body in bodies:
        nodes_m = np.frombuffer(content).reshape(-1, 3)
        points, queries = nodes_m, targets_m
        if isinstance(body, Cloth):
            points, queries = (
                body.pose.to_body(places_m)[:, :2] for places_m in (nodes_m, targets_m)
            )
        simplices, shares = _barycentric(name, points, queries)
        placed_m = np.einsum("mk,mkc->mc", shares, nodes_m[simplices])
        distances_m = np.linalg.norm(placed_m - targets_m, axis=1)
        is_nearer = distances_m < best
        best[is_nearer] = distances_m[is_nearer]
        corner_count = simplices.shape[1]
        indices[is_nearer], weights[is_nearer] = 0, 0.0
        indices[is_nearer, :corner_count] = first + simplices[is_nearer]
        weights[is_nearer, :corner_count] = shares[is_nearer]
        first += len(nodes_m)
    if best.max() > MAX_MARKER_DISTANCE_M:
        worst = int(best.argmax())
        raise ShapeError(
            f"marker {worst} is {1e3 * best[worst]:.1f} mm from the material; "
            f"the limit is {1e3 * MAX_MARKER_DISTANCE_M:.0f} mm"
        )
    for array in (indices, weights):
        array.flags.writeable = False
    return indices, weights


def _barycentric(
    name: str, points: FloatArray, queries: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the points of a simplex and their weights for each query, shape [query_count, corner_count] both.

    A query outside moves to the surface of the nearest simplex.
    """
    from scipy.spatial import Delaunay, QhullError
    from scipy.spatial.distance import cdist

    try:
        mesh = Delaunay(points)
    except QhullError as error:
        raise ShapeError(
            f"{name}: its nodes span no area or volume to interpolate in"
        ) from error
    simplices = mesh.find_simplex(queries, tol=1e-9)
    outside = simplices < 0
    centres = points[mesh.simplices].mean(axis=1)
    simplices[outside] = cdist(queries[outside], centres).argmin(axis=1)
    transforms = mesh.transform[simplices]
    arms = queries - transforms[:, -1]
    shares = np.einsum("qij,qj->qi", transforms[:, :-1], arms)
    shares = np.column_stack([shares, 1.0 - shares.sum(axis=1)]).clip(min=0.0)
    return mesh.simplices[simplices], shares / shares.sum(axis=1, keepdims=True)
