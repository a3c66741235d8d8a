"""Starts that scatter, and repeats that run together."""

import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from gauge_envs import Jitter, load_experiment
from gauge_envs.errors import ParameterError
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import run_episode, run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene import Motion, Plane, Pose
from gauge_envs.scene.jitter import JITTER_FORMAT, perturbed_states
from gauge_envs.scene.states import scene_at

STILL = Jitter(position_m=0.0, angle_rad=0.0)


def jittered(scene, jitter, *, seed):
    """Return the scene at a random start."""
    return scene_at(scene, perturbed_states(scene, jitter, seed=seed))


def starts(name, body, jitter, count=2000):
    """Start positions of a body over seeds [m], shape [count, 3], and the scene."""
    scene = load_experiment(name).scene
    return np.array(
        [
            jittered(scene, jitter, seed=k).body(body).pose.position_m
            for k in range(count)
        ]
    ), scene


def test_a_cube_on_a_slope_slides_and_turns_on_it():
    positions, scene = starts("SlopeSlider-2-wood", "cube", Jitter())
    start = scene.body("cube").pose
    moved = start.rotation.apply(positions - np.asarray(start.position_m), inverse=True)
    # The cube's z is the slope's normal.
    assert np.abs(moved[:, 2]).max() < 1e-12
    assert moved[:, :2].std(axis=0) == pytest.approx([1e-3, 1e-3], rel=0.05)
    turned = [
        jittered(scene, Jitter(), seed=k).body("cube").pose.rotation for k in range(500)
    ]
    angles = np.array([(start.rotation.inv() * one).as_rotvec() for one in turned])
    assert np.abs(angles[:, :2]).max() < 1e-9
    assert angles[:, 2].std() == pytest.approx(math.radians(0.5), rel=0.1)


def test_a_ball_in_the_air_moves_in_all_directions():
    positions, _ = starts("BouncingBall-rubber", "ball", Jitter(position_m=2e-3))
    assert positions.std(axis=0) == pytest.approx([2e-3] * 3, rel=0.06)


def test_a_hinged_ball_turns_about_its_hinge():
    positions, scene = starts("Pendulum-metal", "ball", Jitter(), count=200)
    hinge = scene.joints[0]
    start = np.asarray(scene.body("ball").pose.position_m)
    arms, arm = (
        positions - np.asarray(hinge.anchor_m),
        start - np.asarray(hinge.anchor_m),
    )
    assert np.linalg.norm(arms, axis=1) == pytest.approx(
        np.full(200, np.linalg.norm(arm)), abs=1e-12
    )
    assert np.ptp(arms @ np.asarray(hinge.axis)) < 1e-12
    assert np.linalg.norm(arms - arm, axis=1).max() > 1e-3


@pytest.mark.slow
def test_a_tether_stays_tight():
    positions, scene = starts("WallBreaking-wood", "ball", Jitter(), count=50)
    tether = next(joint for joint in scene.joints if joint.body == "ball")
    start = np.linalg.norm(
        np.asarray(scene.body("ball").pose.position_m) - tether.anchor_m
    )
    assert np.linalg.norm(positions - tether.anchor_m, axis=1) == pytest.approx(
        np.full(50, start), abs=1e-12
    )


def test_what_is_fixed_or_driven_stays_and_free_cloth_keeps_its_plane():
    scene = load_experiment("RotatingBall-rayon").scene
    other = jittered(scene, Jitter(), seed=1)
    assert other.bodies == scene.bodies
    cloth, moved = scene.deformables[0], other.deformables[0]
    assert moved != cloth and moved.pose.position_m[2] == pytest.approx(
        cloth.pose.position_m[2], abs=1e-12
    )
    turntable = load_experiment("Turntable-1-wood").scene
    kept = [
        body
        for body in jittered(turntable, Jitter(), seed=3).bodies
        if body.motion is not Motion.DYNAMIC
    ]
    assert kept == [
        body for body in turntable.bodies if body.motion is not Motion.DYNAMIC
    ]


@pytest.mark.parametrize(
    ("name", "body", "moved_um"),
    [
        ("SlopeSlider-2-wood", "cube", [-183.013, -132.105, 105.663]),
        ("SlopeContact-wood", "teh", [-259.988, -132.105, 367.679]),
        ("WallBreaking-wood", "ball", [271.043, -497.083, -155.749]),
        ("WallBreaking-wood", "brick-1", [1243.478, -642.988, 0.0]),
        ("BouncingBall-rubber", "ball", [125.73, -132.105, 640.423]),
        ("Pendulum-metal", "ball", [0.162, 0.0, 294.643]),
    ],
)
def test_another_way_to_draw_starts_needs_another_format(name, body, moved_um):
    """The keys of sweeps hold the format: with the same one, old repeats would count as those of the new way."""
    assert JITTER_FORMAT == 3
    scene = load_experiment(name).scene
    start, moved = (
        scene.body(body).pose,
        jittered(scene, Jitter(), seed=0).body(body).pose,
    )
    assert 1e6 * (np.subtract(moved.position_m, start.position_m)) == pytest.approx(
        moved_um, abs=2e-3
    )


def test_nothing_to_jitter_is_said():
    for name in ("TextileFlinging-satin", "CantileverBeam-soft"):
        with pytest.raises(ParameterError, match="nothing to jitter"):
            jittered(load_experiment(name).scene, Jitter(), seed=0)


@pytest.mark.parametrize("values", [{"position_m": -1e-3}, {"angle_rad": math.nan}])
def test_impossible_scatter_is_refused(values):
    with pytest.raises(ParameterError, match="jitter"):
        Jitter(**values)


def test_repeats_without_scatter_are_the_single_run():
    single = run_episode(RunRequest("Turntable-2-metal"))
    for result in run_episodes(
        RunRequest("Turntable-2-metal", repeats=3, jitter=STILL)
    ):
        assert result.trajectory == single.trajectory
        assert result.score == single.score


def test_repeats_scatter_about_the_single_run_and_keep_its_reference():
    single = run_episode(RunRequest("SlopeSlider-2-metal")).score.rmse
    results = run_episodes(RunRequest("SlopeSlider-2-metal", repeats=8, seed=10))
    assert [result.seed for result in results] == list(range(10, 18))
    assert results[0].jitter == {"position_m": 1e-3, "angle_rad": math.radians(0.5)}
    errors = np.array([result.score.rmse for result in results])
    # A start 1 mm further downhill is at most 1 mm in E_RMSE.
    assert 0.05 < errors.std() < 2.0
    assert abs(errors.mean() - single) < 2.0
    assert (
        run_episodes(RunRequest("SlopeSlider-2-metal", jitter=Jitter(), seed=12))[
            0
        ].trajectory
        == results[2].trajectory
    )


def test_repeats_are_files_of_their_own_and_resume(tmp_path):
    requests = [RunRequest("SlopeSlider-1-wood", repeats=3)]
    first = list(run_many(requests, out=tmp_path))
    assert len(list(tmp_path.glob("*.json"))) == 3
    again = list(run_many(requests, out=tmp_path, resume=True))
    assert [one.created for one in again] == [one.created for one in first]
    assert (
        next(
            iter(
                run_many([RunRequest("SlopeSlider-1-wood")], resume=True, out=tmp_path)
            )
        ).jitter
        == {}
    )
    assert len(list(tmp_path.glob("*.json"))) == 4


def test_repeats_of_clamped_bodies_start_alike_and_a_jitter_is_declined():
    repeats = run_many([RunRequest("FoamCompressing-soft", repeats=2)])
    first, second = (result.trajectory for result in repeats)
    assert first == second
    request = RunRequest("FoamCompressing-soft", jitter=Jitter())
    (declined,) = run_many([request])
    assert declined.outcome == "declined"
    assert "moves no body" in declined.error


def test_reset_with_jitter_and_back():
    env = gymnasium.make("GAUGE/SlopeSlider-2-wood")
    start, _ = env.reset(seed=3)
    moved, _ = env.reset(seed=3, options={"jitter": True})
    scene = jittered(load_experiment("SlopeSlider-2-wood").scene, Jitter(), seed=3)
    assert moved["bodies"][0, :3] == pytest.approx(
        scene.body("cube").pose.position_m, abs=1e-12
    )
    assert np.linalg.norm(moved["bodies"] - start["bodies"]) > 1e-5
    back, _ = env.reset(seed=3)
    assert (back["bodies"] == start["bodies"]).all()
    wide, _ = env.reset(seed=3, options={"jitter": Jitter(position_m=0.01)})
    assert np.linalg.norm(wide["bodies"][0, :2] - start["bodies"][0, :2]) > 5e-3


def gaps_mm(scene, first, second):
    """Gap between two convex bodies along the best separating face [mm], negative where they overlap."""
    corners = [
        scene.body(name).pose.to_world(scene.body(name).shape.corners_m)
        for name in (first, second)
    ]
    hulls = [ConvexHull(points).equations for points in corners]
    return 1e3 * max(
        (points @ hull[:, :3].T + hull[:, 3]).min(axis=0).max()
        for points, hull in zip(corners, reversed(hulls), strict=True)
    )


@pytest.mark.parametrize("name", ["SlopeContact-wood", "SlopeContact-plastic"])
def test_a_tetrahedron_on_a_seam_keeps_its_contact(name):
    positions, scene = starts(name, "teh", Jitter(), count=500)
    # The face that cuts the corner of a cube off makes equal angles with its edges.
    normal = np.array([1.0, 0.0, 0.0]) * math.sqrt(2.0 / 3.0) + np.array(
        [0.0, 0.0, 1.0]
    ) / math.sqrt(3.0)
    moved = positions - np.asarray(scene.body("teh").pose.position_m)
    assert np.abs(moved @ normal).max() < 1e-12
    along = np.array([[0.0, 1.0, 0.0], np.cross([0.0, 1.0, 0.0], normal)])
    assert (moved @ along.T).std(axis=0) == pytest.approx([1e-3, 1e-3], rel=0.1)
    start = gaps_mm(scene, "teh", "base")
    for seed in range(20):
        moved_scene = jittered(scene, Jitter(angle_rad=0.02), seed=seed)
        assert gaps_mm(moved_scene, "teh", "base") == pytest.approx(start, abs=1e-6)


def test_bricks_that_touch_move_as_one():
    scene = load_experiment("WallBreaking-wood").scene
    bricks = [body.name for body in scene.bodies if body.name.startswith("brick")]
    other = jittered(
        scene, Jitter(velocity_m_per_s=0.01, angular_velocity_rad_per_s=0.1), seed=4
    )
    turns = [
        (
            scene.body(one).pose.rotation.inv() * other.body(one).pose.rotation
        ).magnitude()
        for one in bricks
    ]
    assert (
        turns == pytest.approx(np.full(len(bricks), turns[0]), abs=1e-9)
        and turns[0] > 1e-4
    )
    before, after = (
        np.array([one.body(name).pose.position_m for name in bricks])
        for one in (scene, other)
    )
    assert pdist(after) == pytest.approx(pdist(before), abs=1e-12)
    assert after[:, 2] == pytest.approx(before[:, 2], abs=1e-12)
    # A rigid motion: the velocity between two bricks is across the line between them.
    velocity = np.array([other.body(name).linear_velocity_m_per_s for name in bricks])
    closing = (velocity[1:] - velocity[0]) * (after[1:] - after[0])
    assert np.abs(closing.sum(axis=1)).max() < 1e-12
    assert np.linalg.norm(velocity[1:] - velocity[0], axis=1).max() > 1e-3


def test_a_body_in_a_corner_moves_along_it_and_does_not_turn():
    scene = replace(load_experiment("SlopeSlider-2-wood").scene, drivers=())
    floor = replace(
        scene.body("board"), shape=Plane(), pose=Pose(position_m=(0.0, 0.0, 0.0))
    )
    wall = replace(
        floor, name="wall", pose=Pose.from_euler_deg((0.0, 0.0, 0.0), (0.0, 90.0, 0.0))
    )
    size_m = scene.body("cube").shape.size_m
    cube = replace(
        scene.body("cube"),
        pose=Pose(position_m=(0.5 * size_m[0], 0.0, 0.5 * size_m[2])),
    )
    contact = replace(scene.contacts[0], first=("cube",), second=("board", "wall"))
    corner = replace(scene, bodies=(cube, floor, wall), contacts=(contact,))
    moved = [
        jittered(corner, Jitter(), seed=seed).body("cube").pose for seed in range(200)
    ]
    shifts = np.array([pose.position_m for pose in moved]) - cube.pose.position_m
    assert np.abs(shifts[:, [0, 2]]).max() < 1e-15
    assert shifts[:, 1].std() == pytest.approx(1e-3, rel=0.15)
    assert all(
        pose.rotation.approx_equal(cube.pose.rotation, atol=1e-12) for pose in moved
    )


def test_a_start_off_the_seam_has_no_score_against_the_closed_form():
    results = run_episodes(RunRequest("SlopeContact-wood", repeats=4))
    assert [(result.outcome, result.score.kind) for result in results] == [
        ("finished", "analytic")
    ] * 4
    assert all("scattered" in result.score.refused for result in results)
