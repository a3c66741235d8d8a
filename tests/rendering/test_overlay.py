"""Overlays of pictures: tracked points, their paths and the reference, drawn in front of the scene."""

import numpy as np
import pytest
from opengl import needs_opengl, pixels_of

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.rendering.camera import experiment_view
from gauge_envs.rendering.overlay import Overlay, tracked_overlay
from gauge_envs.rendering.reference_path import reference_path
from gauge_envs.rendering.renderer import SceneRenderer
from gauge_envs.scoring.reference import reference_band

SIZE = {"width": 240, "height": 180}


def changed(first, second):
    """Return which pixels differ clearly, shape [height, width]."""
    return np.abs(first.astype(int) - second).max(axis=2) > 40


@needs_opengl
def test_points_and_paths_are_drawn_in_front_of_the_scene_and_cast_no_shadow():
    experiment = load_experiment("SlopeSlider-2-wood")
    view = experiment_view(experiment)
    renderer = SceneRenderer(
        experiment.scene, {}, 240, 180, view=view, materials=experiment.materials
    )
    centre_m = np.array([experiment.scene.body("cube").pose.position_m])
    path_m = centre_m + np.linspace(0.0, 0.1, 2000)[:, None] * view.axes[0]
    path_m[1000] = np.nan
    plain = renderer.picture({}, {})
    marker = renderer.picture({}, {}, Overlay(markers_m=centre_m))
    both = renderer.picture({}, {}, Overlay(markers_m=centre_m, recorded_m=centre_m))
    path = renderer.picture({}, {}, Overlay(recorded_paths=(path_m,)))
    assert not changed(plain, renderer.picture({}, {})).any()
    renderer.close()
    # The marker of the simulation covers the marker of the reference.
    assert np.abs(marker.astype(int) - both).max() <= 1
    rows, columns = np.nonzero(changed(plain, marker))
    expected = pixels_of(view, centre_m, **SIZE)[0]
    assert [columns.mean() + 0.5, rows.mean() + 0.5] == pytest.approx(expected, abs=1.0)
    assert 20 < len(rows) < 80
    ends = pixels_of(view, path_m[[0, -1]], **SIZE)[:, 0]
    shown = changed(plain, path)
    rows, columns = np.nonzero(shown)
    assert [columns.min(), columns.max()] == pytest.approx(ends, abs=3.0)
    assert np.ptp(rows) <= 6
    colors = path[shown].astype(int)
    assert (colors[:, 0] - colors[:, 1] > 60).mean() > 0.6


def overlay_at_frame(name, frame_count):
    """Return experiment, reference, samples and overlay of an episode with zero actions after some frames."""
    env = GaugeEnv(name)
    env.reset(seed=0)
    for _ in range(frame_count):
        env.step(0)
    trajectory = env.trajectory()
    overlay = tracked_overlay(
        env.experiment,
        env.band,
        time_s=frame_count / 30.0,
        samples=trajectory.samples,
        markers_m=trajectory.markers_m[-1],
    )
    env.close()
    return env.experiment, env.band, trajectory.samples, overlay


def test_the_overlay_of_an_episode_shows_the_compared_positions():
    experiment, band, samples, overlay = overlay_at_frame("SlopeSlider-2-wood", 5)
    (path_m,) = overlay.paths
    assert 1e3 * path_m == pytest.approx(samples)
    assert overlay.markers_m == pytest.approx(path_m[-1:])
    # The band has the position along the slope, and the drawn reference has the same position in each frame.
    places_m = reference_path(experiment, band).places_m
    assert band.project(1e3 * places_m.reshape(len(places_m), -1)) == pytest.approx(
        band.mean, nan_ok=True
    )
    assert overlay.recorded_m == pytest.approx(places_m[5])
    assert overlay.recorded_paths[0] == pytest.approx(places_m[:, 0])


def test_an_episode_of_a_soft_body_shows_only_its_markers():
    experiment, _, _, overlay = overlay_at_frame("FoamTwisting-soft", 0)
    expected_m = np.array(experiment.scene.markers.positions_m)
    assert overlay.markers_m == pytest.approx(expected_m, abs=1e-6)
    assert not overlay.paths and not overlay.recorded_paths


def test_a_reference_of_other_quantities_has_no_path():
    experiment = load_experiment("FoamTwisting-soft")
    band = reference_band(experiment)
    assert band.unit == "mm^2"
    assert reference_path(experiment, band) is None
