"""Marker proxies on a sheet of nodes with prescribed motion."""

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


class Sheet:
    """Stands for a simulation: nodes of a regular grid, moved by a function of time."""

    def __init__(self, cloth, cell_m, motion=lambda points, t: points):
        counts = [round(edge / cell_m) + 1 for edge in cloth.size_m]
        axes = [
            np.linspace(-0.5 * edge, 0.5 * edge, n)
            for edge, n in zip(cloth.size_m, counts, strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, [0.0], indexing="ij"), axis=-1).reshape(
            -1, 3
        )
        self._rest = cloth.pose.to_world(grid)
        self._motion = motion
        self.time_s = 0.0

    def nodes(self, name):
        return self._motion(self._rest, self.time_s)[None]

    def track(self, name, points_m):
        return None

    def advance(self, seconds):
        self.time_s += seconds


def flinging():
    scene = load_experiment("TextileFlinging-satin").scene
    return scene, scene.deformables[0]


def test_material_points_are_exact_where_nodes_are_not():
    scene, cloth = flinging()
    # A stretch that is linear in space: interpolation is exact, a proxy 5 mm away is 5 mm times the strain off.
    sheet = Sheet(
        cloth, 0.5 / 41, lambda points, t: points * np.array([1.0 + t, 1.0, 1.0 - t])
    )
    targets = np.asarray(scene.markers.positions_m) * np.array([1.1, 1.0, 0.9])
    errors = {}
    for proxy in MarkerProxy:
        sheet.time_s = 0.0
        observer = ObserverMarkers(scene, Observable.MARKER_POSITION, sheet, proxy)
        apart_m = {
            MarkerProxy.NODE: cdist(
                scene.markers.positions_m, sheet.nodes(cloth.name)[0]
            )
            .min(axis=1)
            .max(),
            MarkerProxy.MATERIAL: 0.0,
        }[proxy]
        assert observer.largest_distance_m == pytest.approx(apart_m, abs=1e-9)
        sheet.advance(0.1)
        g, markers_m = observer.observe(sheet)
        assert markers_m.shape == (1, 63, 3)
        moved = g.reshape(-1, 3)
        errors[proxy] = np.abs(moved - 1e3 * targets).max()
    assert errors[MarkerProxy.MATERIAL] < 1e-6
    assert 0.5 < errors[MarkerProxy.NODE] < 11.0


def test_mesh_too_coarse_for_the_markers_is_refused():
    scene, cloth = flinging()
    with pytest.raises(ShapeError, match="marker"):
        ObserverMarkers(
            scene, Observable.CURVATURE, Sheet(cloth, 0.125), MarkerProxy.NODE
        )


def test_marker_off_the_material_is_refused():
    scene, cloth = flinging()
    shifted = Sheet(cloth, 0.025, lambda points, t: points + np.array([0.0, 0.02, 0.0]))
    with pytest.raises(ShapeError, match=r"20\.0 mm"):
        ObserverMarkers(scene, Observable.CURVATURE, shifted, MarkerProxy.MATERIAL)


def test_missing_markers_stay_missing():
    scene, _ = flinging()
    positions = np.asarray(scene.markers.positions_m)[None].copy()
    positions[0, 10] = np.nan
    curvature = observe_markers(positions, scene.markers, Observable.CURVATURE)
    assert np.isnan(curvature[0, 10])
    assert np.isfinite(np.delete(curvature[0], 10)).all()


@pytest.mark.parametrize(
    ("name", "width"),
    [
        ("TextileStretching-satin", 25),
        ("TextileBending-satin", 10),
        ("FoamTwisting-soft", 24),
        ("StickStack-soft", 12),
    ],
)
def test_width_of_each_observable(name, width):
    found = load_experiment(name)
    positions = np.asarray(found.scene.markers.positions_m)[None]
    assert observe_markers(
        positions, found.scene.markers, found.spec.score.observable
    ).shape == (1, width)
