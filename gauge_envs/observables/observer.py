"""Observe the generalized trajectory g(t) of a running simulation, from body positions or markers.

Nodes of a simulated body do not coincide with its markers. The marker proxy is by default the material point of the
marker, interpolated between nodes. The paper uses the nearest node, which moves markers by up to 5 mm on a foam of the
default mesh; its scores then measure the mesh.
"""

from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from functools import lru_cache, partial
from typing import Protocol

import numpy as np

from gauge_envs.backends.world import Simulation, World
from gauge_envs.backends.worlds import Worlds
from gauge_envs.errors import ShapeError
from gauge_envs.observables.functions import (
    angle_deficit_curvature,
    assign_markers,
    face_areas_mm2,
    line_turning_angle,
)
from gauge_envs.observables.kinds import Observable
from gauge_envs.scene import Cloth, Deformable, Markers, Scene
from gauge_envs.scene.geometry import FloatArray, IntArray, length_of

MARKER_REACH_M = 0.01
"""Largest distance between a marker and its proxy (paper, simulation and track: below 1 cm)."""


class MarkerProxy(StrEnum):
    """Marker proxy: the tracked point of the simulation that is compared with a marker."""

    MATERIAL = "material"
    """The material point of the marker, interpolated between the nodes of its element; the default."""
    NODE = "node"
    """The nearest node, each used once (Hungarian algorithm), as in the paper."""


class Observer(Protocol):
    """Observer of one kind of generalized trajectory.

    Attributes:
        width: Number of coordinates of g(t).
        markers_m: Marker positions at the last observation [m], shape [marker_count, 3]; empty for rigid bodies.
    """

    width: int
    markers_m: FloatArray

    def now(self, world: World) -> FloatArray:
        """Return g(t) now, shape [width]."""

    def sample(
        self, simulation: Simulation, count: int, interval_s: float
    ) -> FloatArray:
        """Advance `count` intervals and return g(t) after each, shape [count, width]."""


class ObserverPositions:
    """Observer of the positions of rigid bodies [mm]."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self.width = 3 * len(self._names)
        self.markers_m = np.zeros((0, 3))

    def now(self, world: World) -> FloatArray:
        """Return the positions now, shape [width]."""
        return 1e3 * world.body_states(self._names)[:, :3].ravel()

    def sample(
        self, simulation: Simulation, count: int, interval_s: float
    ) -> FloatArray:
        """Advance `count` intervals and return g(t) after each, shape [count, width]."""
        positions = simulation.sample_positions(self._names, count, interval_s)
        return 1e3 * positions.reshape(count, self.width)


class ObserverMarkers:
    """Observer of markers on deformable bodies: their positions, curvature or triangle areas.

    Args:
        scene: Scene with the positions of the markers at rest.
        observable: Kind of generalized trajectory.
        world: World at the start, which gives the nodes.
        proxy: Marker proxy.

    Attributes:
        markers_m: Marker positions at the last observation [m], shape [marker_count, 3].
        largest_distance_m: Distance of the worst marker from its proxy at rest.
        bodies: Names of the bodies with markers.
        observed: Function that returns g(t) of marker positions; see `observe_markers`.
        read: The engine's reader of all markers; None if they are interpolated between nodes, as `indices` and
            `weights` state, shape [marker_count, k] each.
    """

    def __init__(
        self, scene: Scene, observable: Observable, world: World, proxy: MarkerProxy
    ) -> None:
        if scene.markers is None:
            raise ShapeError(
                f"observable {observable.value!r} needs markers, and the scene has none"
            )
        self.bodies = scene.markers.bodies
        self.observed = partial(
            observe_markers, markers=scene.markers, observable=observable
        )
        now_m = np.asarray(scene.markers.positions_m)
        rest = {name: world.nodes(name) for name in self.bodies}
        stated = scene.stated
        if stated is not None and stated.markers is not None:
            # A rigid motion keeps the material points, but not which of equal triangles rounding finds first.
            found = {name: world.stated_nodes(name) for name in self.bodies}
            before = {name: one for name, one in found.items() if one is not None}
            if len(before) == len(rest):
                scene, rest = stated, before
        assert scene.markers is not None
        targets = np.asarray(scene.markers.positions_m)
        self.read = (
            _tracker(world, rest, targets) if proxy is MarkerProxy.MATERIAL else None
        )
        if proxy is MarkerProxy.NODE:
            nodes = np.concatenate(list(rest.values()))
            self.indices = assign_markers(
                targets, nodes, max_distance_m=MARKER_REACH_M
            )[:, None]
            self.weights = np.ones((len(targets), 1))
        elif self.read is None:
            deformables = {body.name: body for body in scene.deformables}
            self.indices, self.weights = material_points(targets, rest, deformables)
        self.markers_m = self._marker_positions(world)
        self.largest_distance_m = float(
            np.linalg.norm(self.markers_m - now_m, axis=1).max()
        )
        self.width = len(self.observed(self.markers_m[None])[0])

    def now(self, world: World) -> FloatArray:
        """Return g(t) now, shape [width]."""
        self.markers_m = self._marker_positions(world)
        return self.observed(self.markers_m[None])[0]

    def sample(
        self, simulation: Simulation, count: int, interval_s: float
    ) -> FloatArray:
        """Advance `count` intervals and return g(t) after each, shape [count, width]."""
        markers = np.empty((count, *self.markers_m.shape))
        for row in markers:
            simulation.advance(interval_s)
            row[:] = self._marker_positions(simulation)
        self.markers_m = markers[-1].copy()
        return self.observed(markers)

    def _marker_positions(self, world: World) -> FloatArray:
        if self.read is not None:
            return self.read()
        nodes = np.concatenate([world.nodes(name) for name in self.bodies])
        return _interpolated(nodes, self.indices.T, self.weights.T)


class MarkersOfWorlds:
    """Observer of the markers of many worlds at once.

    Args:
        observers: The observer of each world.
        worlds: The worlds.
    """

    def __init__(self, observers: Sequence[ObserverMarkers], worlds: Worlds) -> None:
        first = observers[0]
        self._worlds = worlds
        self._bodies = first.bodies
        self.observed = first.observed
        self._readers = [one.read for one in observers if one.read is not None]
        if not self._readers:
            # Rows of the nodes of all worlds.
            count = sum(len(worlds.worlds[0].nodes(name)) for name in first.bodies)
            self._rows = np.concatenate(
                [count * number + one.indices for number, one in enumerate(observers)]
            ).T.copy()
            self._weights = np.concatenate([one.weights for one in observers]).T.copy()

    def positions(self) -> FloatArray:
        """Return the positions of the markers [m], shape [world_count, marker_count, 3]."""
        if self._readers:
            return np.stack([read() for read in self._readers])
        parts = [self._worlds.nodes(name) for name in self._bodies]
        nodes = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        markers_m = _interpolated(nodes.reshape(-1, 3), self._rows, self._weights)
        return markers_m.reshape(len(nodes), -1, 3)


def _interpolated(
    nodes_m: FloatArray, rows: IntArray, weights: FloatArray
) -> FloatArray:
    """Return weighted sums of nodes [m], shape [point_count, 3].

    Args:
        nodes_m: Positions of nodes [m], shape [node_count, 3].
        rows: Nodes of each point, shape [k, point_count].
        weights: Their weights, shape [k, point_count].
    """
    points_m = weights[0][:, None] * nodes_m.take(rows[0], axis=0)
    for row, weight in zip(rows[1:], weights[1:], strict=True):
        points_m += weight[:, None] * nodes_m.take(row, axis=0)
    return points_m


def _tracker(
    world: World, names: Iterable[str], targets_m: FloatArray
) -> Callable[[], FloatArray] | None:
    """Return the engine's tracker of all markers, or None if the engine has none."""
    refusal = None
    for name in names:
        try:
            return world.track(name, targets_m)
        except ShapeError as error:
            refusal = error
    raise refusal or ShapeError("the markers are on no body")


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
    if observable is Observable.CURVATURE:
        return angle_deficit_curvature(
            markers_m, markers.faces, corner=markers.corner, edge=markers.edge
        )
    if observable is Observable.LINE_CURVATURE:
        return line_turning_angle(markers_m, markers.lines)
    if observable is Observable.FACE_AREA:
        return face_areas_mm2(markers_m, markers.faces)
    return 1e3 * np.asarray(markers_m).reshape(len(markers_m), -1)


def material_points(
    targets_m: FloatArray,
    rest: dict[str, FloatArray],
    deformables: dict[str, Deformable],
) -> tuple[IntArray, FloatArray]:
    """Return the nodes and weights that interpolate each marker at rest; cloth uses three of the four.

    Many worlds have the same ones, which are computed once; the arrays are read-only.

    Args:
        targets_m: Marker positions at rest [m], shape [marker_count, 3].
        rest: Node positions at rest [m] of each body with markers, shape [node_count, 3].
        deformables: Deformable bodies of the scene by name.

    Returns:
        Node indices over the bodies of `rest` in their order, shape [marker_count, 4], and weights of the same shape.
    """
    nodes = tuple(
        (name, one.tobytes(), deformables[name]) for name, one in rest.items()
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
        nodes = np.frombuffer(content).reshape(-1, 3)
        points, queries = nodes, targets_m
        if isinstance(body, Cloth):
            points, queries = (
                body.pose.to_body(nodes)[:, :2],
                body.pose.to_body(targets_m)[:, :2],
            )
        for marker, (simplex, share) in enumerate(_barycentric(name, points, queries)):
            missed = length_of(share @ nodes[simplex] - targets_m[marker])
            if missed < best[marker]:
                best[marker] = missed
                indices[marker], weights[marker] = 0, 0.0
                indices[marker, : len(simplex)], weights[marker, : len(simplex)] = (
                    first + simplex,
                    share,
                )
        first += len(nodes)
    if best.max() > MARKER_REACH_M:
        worst = int(best.argmax())
        raise ShapeError(
            f"marker {worst} is {1e3 * best[worst]:.1f} mm from the material, more than {1e3 * MARKER_REACH_M:.0f} mm"
        )
    for array in (indices, weights):
        array.flags.writeable = False
    return indices, weights


def _barycentric(
    name: str, points: FloatArray, queries: FloatArray
) -> list[tuple[IntArray, FloatArray]]:
    """Return simplex and weights of each query; a query outside is moved to the surface of the nearest simplex."""
    from scipy.spatial import Delaunay, QhullError

    try:
        mesh = Delaunay(points)
    except QhullError as error:
        raise ShapeError(
            f"{name}: its nodes span no area or volume to interpolate in"
        ) from error
    centres = points[mesh.simplices].mean(axis=1)
    found = mesh.find_simplex(queries, tol=1e-9)
    outside = found < 0
    found[outside] = (
        ((queries[outside, None] - centres[None]) ** 2).sum(axis=2).argmin(axis=1)
    )
    results = []
    for query, simplex in zip(queries, found, strict=True):
        transform = mesh.transform[simplex]
        share = transform[:-1] @ (query - transform[-1])
        share = np.clip(np.append(share, 1.0 - share.sum()), 0.0, None)
        results.append((mesh.simplices[simplex], share / share.sum()))
    return results
