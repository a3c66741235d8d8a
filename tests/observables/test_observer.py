"""Markers on deformable bodies: material points are exact in a linear deformation, and nodes are not."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from gauge_envs import load_experiment
from gauge_envs.errors import ShapeError
from gauge_envs.observables.kinds import Observable
from gauge_envs.observables.observer import (
    MarkerProxy,
    ObserverMarkers,
    observe_markers,
)


class Nodes:
    """Fake simulation: nodes of a regular grid in a body, deformed linearly."""

    def __init__(self, body, size_m, cell_m, shift_m=(0.0, 0.0, 0.0)):
        axes = [
            np.linspace(-0.5 * edge, 0.5 * edge, round(edge / cell_m) + 1)
            for edge in size_m
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self.rest_m = body.pose.to_world(grid) + shift_m
        self.gradient = np.eye(3)

    def nodes(self, name):
        return (self.rest_m @ self.gradient.T)[None]

    def track(self, name, points_m):
        return None


STRETCH = np.array([[1.1, 0.2, 0.0], [0.0, 1.0, 0.1], [0.0, 0.0, 0.9]])


def of_cloth(cell_m, **changes):
    scene = load_experiment("TextileFlinging-satin").scene
    cloth = scene.deformables[0]
    return scene, Nodes(cloth, (*cloth.size_m, 0.0), cell_m, **changes)


def of_foam(cell_m):
    scene = load_experiment("FoamTwisting-soft").scene
    foam = scene.deformables[0]
    return scene, Nodes(foam, foam.shape.size_m, cell_m)


@pytest.mark.parametrize("case", [of_cloth(0.5 / 41), of_foam(0.011)])
def test_material_points_are_exact_where_nodes_are_not(case):
    scene, simulation = case
    targets_m = np.asarray(scene.markers.positions_m)
    apart_m = cdist(targets_m, simulation.rest_m).min(axis=1).max()
    for proxy, distance_m in (
        (MarkerProxy.MATERIAL, 0.0),
        (MarkerProxy.NODE, apart_m),
    ):
        simulation.gradient = np.eye(3)
        kind = Observable.MARKER_POSITION
        observer = ObserverMarkers(scene, kind, simulation, proxy)
        offsets_m = observer.markers(simulation)[0] - targets_m
        largest_m = np.linalg.norm(offsets_m, axis=1).max()
        assert largest_m == pytest.approx(distance_m, abs=1e-9)
        simulation.gradient = STRETCH
        markers_m = observer.markers(simulation)[0]
        g = observer.observe(markers_m[None])
        assert g.ravel() == pytest.approx(1e3 * markers_m.ravel())
        error_m = np.abs(markers_m - targets_m @ STRETCH.T).max()
        assert 0.2 * distance_m <= error_m <= 1.2 * distance_m + 1e-9


@pytest.mark.parametrize(
    ("cell_m", "shift_m", "proxy", "message"),
    [
        (0.125, (0.0, 0.0, 0.0), MarkerProxy.NODE, "marker"),
        (0.025, (0.0, 0.02, 0.0), MarkerProxy.MATERIAL, r"20\.0 mm .* limit is 10 mm"),
    ],
)
def test_a_marker_that_is_far_from_the_material_is_named(
    cell_m, shift_m, proxy, message
):
    scene, simulation = of_cloth(cell_m, shift_m=shift_m)
    with pytest.raises(ShapeError, match=message):
        ObserverMarkers(scene, Observable.CURVATURE, simulation, proxy)


@pytest.mark.parametrize(
    ("name", "names", "unit", "width"),
    [
        ("SlopeSlider-2-wood", ("cube.x", "cube.y", "cube.z"), "mm", 3),
        ("TextileStretching-satin", ("marker-0", "marker-1"), "rad", 25),
        ("TextileBending-satin", ("marker-2", "marker-3"), "rad", 10),
        ("FoamTwisting-soft", ("face-0", "face-1"), "mm^2", 24),
        ("StickStack-soft", ("marker-0.x", "marker-0.y", "marker-0.z"), "mm", 12),
    ],
)
def test_the_coordinates_of_every_observable_have_names_and_a_unit(
    name, names, unit, width
):
    experiment = load_experiment(name)
    observable, markers = experiment.score.observable, experiment.scene.markers
    assert experiment.coordinates[: len(names)] == names
    assert (observable.unit, len(experiment.coordinates)) == (unit, width)
    if markers is not None:
        positions_m = np.array(markers.positions_m)[None]
        assert observe_markers(positions_m, markers, observable).shape == (1, width)
