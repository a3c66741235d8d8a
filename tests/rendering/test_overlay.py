"""Overlays of pictures: drawn where their points are, and only where they are asked for."""

from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from opengl import needs_opengl

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.envs.pictures import episode_overlay
from gauge_envs.errors import ParameterError, UnknownNameError
from gauge_envs.experiments.resolve import shots_of
from gauge_envs.rendering.camera import experiment_view
from gauge_envs.rendering.overlay import (
    RECORDED_COLOR,
    Overlay,
    between,
    tracked_overlay,
)
from gauge_envs.rendering.reference_path import reference_path
from gauge_envs.rendering.renderer import SceneRenderer
from gauge_envs.scoring.reference import reference_band

SIZE = {"width": 240, "height": 180}


def changed(one, other):
    """Return which pixels differ clearly, shape [height, width]."""
    return np.abs(one.astype(int) - other).max(axis=2) > 40


def drawn(name, width=240, height=180):
    """Return the scene of an id and its renderer."""
    experiment = load_experiment(name)
    view = experiment_view(experiment)
    return experiment.scene, SceneRenderer(
        experiment.scene, {}, width, height, view=view
    )


@needs_opengl
def test_balls_and_tubes_are_drawn_in_their_colour_where_their_points_are():
    scene, renderer = drawn("BouncingBall-rubber", 480, 360)
    plain = renderer.picture({}, {})
    place = np.array(scene.body("ball").pose.position_m) - [0.0, 0.0, 0.15]
    line = place + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.1]])
    marked = renderer.picture({}, {}, Overlay(markers_m=place[None]))
    with_path = renderer.picture({}, {}, Overlay(recorded_paths=(line,)))
    again = renderer.picture({}, {})
    renderer.close()
    assert not changed(plain, again).any()
    ball, tube = changed(plain, marked), changed(plain, with_path)
    assert (marked[ball][:, 2].astype(int) - marked[ball][:, 0] > 60).mean() > 0.6
    assert (with_path[tube][:, 0].astype(int) - with_path[tube][:, 1] > 60).mean() > 0.6
    # The tube starts at the ball and goes down from there.
    row, column = (np.flatnonzero(ball.any(axis=axis)).mean() for axis in (1, 0))
    rows, columns = np.flatnonzero(tube.any(axis=1)), np.flatnonzero(tube.any(axis=0))
    assert abs(rows.min() - row) <= 3
    assert rows.max() > row + 10
    assert abs(columns.mean() - column) <= 2


@needs_opengl
def test_a_ghost_has_the_shape_of_its_body_and_lets_it_shine_through():
    scene, renderer = drawn("NonsmoothContact-1-wood")
    body = scene.dynamic_bodies[0]
    pose = np.array([*body.pose.position_m, *body.pose.quaternion])
    # To the right of the picture, clear of the body.
    away = pose + np.array([*(0.1 * renderer.camera.axes[0]), 0.0, 0.0, 0.0, 0.0])
    plain, moved = renderer.picture({}, {}), renderer.picture({body.name: away}, {})
    ghost = renderer.picture({body.name: pose}, {}, Overlay(ghosts={body.name: away}))
    with pytest.raises(UnknownNameError, match="no-body"):
        renderer.picture({}, {}, Overlay(ghosts={"no-body": pose}))
    renderer.close()
    # Moving the body also uncovers its old place and moves its shadow, where the ghost adds nothing.
    shown = np.abs(ghost.astype(int) - plain).max(axis=2) > 10
    arrived = np.abs(moved.astype(int) - plain).max(axis=2) > 10
    right_of_it = renderer.camera.pixels(
        (pose[:3] + 0.5 * (away - pose)[:3])[None], width=240, height=180
    )[0, 0]
    assert shown.sum() > 200
    assert (shown & arrived).sum() > 0.95 * shown.sum()
    assert np.flatnonzero(shown.any(axis=0)).min() > right_of_it - 30
    ground = np.median(plain.reshape(-1, 3), axis=0)
    inside = np.median(ghost[shown], axis=0)
    # The ground shines through: the colour is between that of the ground and the green of ghosts.
    assert 255.0 * RECORDED_COLOR[1] + 60.0 < inside[1] < ground[1] - 30.0


@needs_opengl
@pytest.mark.parametrize("name", ["SlopeSlider-2-wood", "NonsmoothContact-1-wood"])
def test_a_ghost_that_coincides_with_its_body_is_drawn_alike_in_each_picture(name):
    scene, renderer = drawn(name)
    body = scene.dynamic_bodies[0]
    pose = np.array([*body.pose.position_m, *body.pose.quaternion])
    plain = renderer.picture({body.name: pose}, {}).astype(int)
    rng = np.random.default_rng(0)
    pictures = []
    for _ in range(5):
        # A thousandth of a pixel at most: what a resting body moves by in simulations and recordings.
        shift = np.array([*rng.uniform(-1e-6, 1e-6, 3), 0.0, 0.0, 0.0, 0.0])
        overlay = Overlay(
            ghosts={body.name: pose + shift}, recorded_m=(pose + shift)[None, :3]
        )
        pictures.append(renderer.picture({body.name: pose}, {}, overlay).astype(int))
    away = {body.name: np.array([0.0, 0.0, 10.0, 1.0, 0.0, 0.0, 0.0])}
    empty, alone = (
        renderer.picture(away, {}, one).astype(int) for one in (None, overlay)
    )
    renderer.close()
    assert max(np.abs(one - other).max() for one, other in pairwise(pictures)) <= 1
    # The whole ghost is to be seen, as it is without its body.
    with_body, without = (
        np.abs(one - other).max(axis=2) > 5
        for one, other in ((pictures[-1], plain), (alone, empty))
    )
    assert without.sum() > 150
    assert (with_body & without).sum() > 0.97 * without.sum()


@needs_opengl
def test_markers_that_coincide_keep_the_colour_of_the_simulation():
    scene, renderer = drawn("BouncingBall-rubber")
    place = np.array([scene.body("ball").pose.position_m]) - [0.0, 0.0, 0.15]
    alone = renderer.picture({}, {}, Overlay(markers_m=place)).astype(int)
    for shift in (-1e-6, 1e-6):
        both = renderer.picture(
            {}, {}, Overlay(markers_m=place, recorded_m=place + shift)
        ).astype(int)
        assert np.abs(both - alone).max() <= 1
    renderer.close()


@pytest.mark.parametrize("count", [1, 2, 239, 240, 241, 480, 481, 3001])
def test_a_path_has_its_ends_and_at_most_240_places_between(count: int) -> None:
    """Each k-th place with the smallest k that leaves as few."""
    experiment = load_experiment("NonsmoothContact-1-wood")
    bodies = len(experiment.recorded)
    samples = np.arange(3.0 * bodies * count).reshape(count, -1)
    overlay = tracked_overlay(
        experiment,
        None,
        time_s=0.0,
        samples=samples,
        markers_m=np.zeros((0, 3)),
        poses={},
    )
    kept = [*range(0, count - 1, max(np.ceil(count / 240).astype(int), 1)), count - 1]
    expected_m = 1e-3 * samples.reshape(count, bodies, 3)
    assert overlay.markers_m == pytest.approx(expected_m[-1])
    assert len(overlay.paths) == bodies
    for number, path in enumerate(overlay.paths):
        assert path == pytest.approx(expected_m[kept, number])
    assert overlay.geom_count == bodies * len(kept)


@pytest.mark.parametrize("at", [0.0, 0.25, 1.0, 1.75, 2.0, 2.5])
def test_a_place_between_two_frames_is_on_the_line_between_them(at: float) -> None:
    points = np.array([[[0.0, 1.0, 2.0]], [[4.0, 1.0, 0.0]], [[5.0, 9.0, -2.0]]])
    expected = [np.interp(at, np.arange(3), column) for column in points[:, 0].T]
    assert between(points, at)[0] == pytest.approx(expected)


@needs_opengl
def test_paths_of_any_length_fit_into_a_picture():
    scene = load_experiment("BouncingBall-rubber").scene
    renderer = SceneRenderer(scene, {}, 64, 48)
    points = np.array(scene.body("ball").pose.position_m) + np.linspace(0.0, 0.3, 3001)[
        :, None
    ] * [0.0, 0.0, -1.0]
    points[1500] = np.nan
    with_path = renderer.picture({}, {}, Overlay(paths=(points,)))
    plain = renderer.picture({}, {})
    renderer.close()
    assert changed(plain, with_path).any()


@needs_opengl
def test_environments_draw_the_overlay_on_request_alone():
    pictures = {}
    for overlay in (False, True):
        env = gymnasium.make(
            "GAUGE/SlopeSlider-2-wood",
            render_mode="rgb_array",
            render_overlay=overlay,
            **SIZE,
        )
        env.reset(seed=0)
        for _ in range(8):
            env.step(0)
        pictures[overlay] = env.render()
        env.close()
    assert changed(pictures[False], pictures[True]).sum() > 20
    envs = gymnasium.make_vec(
        "GAUGE/SlopeSlider-2-wood",
        num_envs=2,
        render_mode="rgb_array",
        render_overlay=True,
        **SIZE,
    )
    envs.reset(seed=0)
    for _ in range(8):
        envs.step([0, 0])
    for picture in envs.render():
        assert np.abs(picture.astype(int) - pictures[True]).max() <= 2
    envs.close()


def test_the_overlay_of_an_episode_holds_what_its_score_compares():
    env = GaugeEnv("SlopeSlider-2-wood")
    env.reset(seed=0)
    for _ in range(5):
        env.step(0)
    overlay = episode_overlay(env.episode)
    assert 1e3 * overlay.markers_m.ravel() == pytest.approx(env.trajectory().frames[-1])
    assert len(overlay.paths) == len(overlay.recorded_paths) == 1
    # The band holds the place along the slope; the drawn reference has it, frame by frame.
    path = reference_path(env.experiment, env.band)
    assert env.band.project(
        1e3 * path.places_m.reshape(len(path.places_m), -1)
    ) == pytest.approx(env.band.mean, nan_ok=True)
    assert overlay.recorded_m == pytest.approx(path.places_m[5])
    # A mean has no orientation: its ghost turns as the simulated body.
    assert overlay.ghosts["cube"] == pytest.approx(
        [*path.places_m[5, 0], *env.episode.poses()["cube"][3:]]
    )
    env.close()


def test_a_recorded_toss_turns_its_ghost():
    env = GaugeEnv("CubeToss-acrylic")
    env.reset(seed=0, options={"trial": 0})
    for _ in range(12):
        env.step(0)
    ghost = episode_overlay(env.episode).ghosts["cube"]
    _, turns = shots_of(env.episode.experiment).shot(0).poses_at(np.array([0.4]))
    simulated = env.episode.poses()["cube"]
    env.close()
    assert abs(ghost[3:] @ turns[0].as_quat(scalar_first=True)) == pytest.approx(1.0)
    assert abs(ghost[3:] @ simulated[3:]) < 0.999


def test_an_episode_of_a_soft_body_shows_its_markers_alone():
    env = GaugeEnv("FoamTwisting-soft")
    env.reset(seed=0)
    overlay = episode_overlay(env.episode)
    assert overlay.markers_m == pytest.approx(
        np.array(env.experiment.scene.markers.positions_m), abs=1e-6
    )
    assert not overlay.paths and not overlay.recorded_paths and not overlay.ghosts
    env.close()


def test_a_reference_of_other_quantities_has_no_path():
    experiment = load_experiment("FoamTwisting-soft")
    band = reference_band(
        experiment,
    )
    assert band.unit == "mm^2"
    assert reference_path(experiment, band) is None


def test_render_overlay_is_true_or_false():
    with pytest.raises(ParameterError, match="render_overlay"):
        GaugeEnv("SlopeSlider-2-wood", render_overlay="yes")


def test_the_path_of_many_swings_stays_on_their_circle():
    experiment = load_experiment("Pendulum-metal")
    (hinge,) = experiment.scene.joints
    reference = reference_path(experiment, reference_band(experiment))
    places_mm = 1e3 * reference.places_m.reshape(len(reference.places_m), -1)
    overlay = tracked_overlay(
        experiment,
        reference,
        time_s=0.0,
        samples=places_mm,
        markers_m=np.zeros((0, 3)),
        poses={},
    )
    radius_m = np.linalg.norm(reference.places_m[0, 0] - hinge.anchor_m)
    for path in (*overlay.paths, *overlay.recorded_paths):
        middles_m = 0.5 * (path[1:] + path[:-1])
        distances_m = np.linalg.norm(middles_m - hinge.anchor_m, axis=1)
        distances_m = distances_m[np.isfinite(distances_m)]
        assert distances_m == pytest.approx(radius_m, rel=0.02)
        assert np.nanmax(path[:, 0]) - np.nanmin(path[:, 0]) > 1.3 * radius_m
