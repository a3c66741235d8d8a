"""The camera: it sees all that moves, as large as it fits, and the motion from the side."""

from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import gymnasium
import numpy as np
import pytest
from opengl import needs_opengl
from scipy.spatial.transform import Rotation

from gauge_envs import GaugeEnv, load_experiment
from gauge_envs.experiments.tables import CameraFile
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.references.tables import read_toml, scoring_folder
from gauge_envs.rendering.camera import (
    FIELD_OF_VIEW_DEG,
    View,
    experiment_view,
    scene_view,
)
from gauge_envs.rendering.overlay import Overlay
from gauge_envs.rendering.reference_path import reference_path
from gauge_envs.rendering.renderer import SceneRenderer
from gauge_envs.scene import (
    Attachment,
    Box,
    Cloth,
    Hinge,
    Motion,
    Pose,
    Region,
    RigidBody,
    Rod,
    Rope,
    Scene,
    Tether,
)
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.bench.parts import driver as driver_of, ground, ramp
from gauge_envs.tools.control.env import ControlEnv

SIZE = (640, 480)

LEAST_SHARE = 0.5
"""Smallest share of the width or of the height that the box around all places of what moves fills."""

QUICK = (
    "BouncingBall-rubber",
    "SlopeContact-wood",
    "NonsmoothContact-1-wood",
    "NonsmoothContact-3-plastic",
    "SlopeSlider-1-metal",
    "SlopeSlider-2-wood",
    "SlopeSlider-3-metal",
    "Turntable-2-metal",
    "NewtonsCradle-metal",
    "Pendulum-metal",
    "CubeToss-acrylic",
)
LONG = (
    "WallBreaking-wood",
    "RopeWinding-rubber",
    "TextileFlinging-satin",
    "TextileBending-oxford",
    "TableclothPulling-metal",
    "FoamTwisting-soft",
    "FoamBending-hard",
    "StickStack-soft",
    "CantileverBeam-soft",
)
MOST_FRAMES = 120


def rollout_pixels(name):
    """Return where corners and nodes of all that moves are in the pictures at start, middle and end of an episode."""
    env = GaugeEnv(name)
    env.reset(seed=0)
    experiment, scene = env.episode.experiment, env.episode.experiment.scene
    view = experiment_view(experiment, reference=reference_path(experiment, env.band))
    zero = (
        0
        if isinstance(env.action_space, gymnasium.spaces.Discrete)
        else np.zeros(env.action_space.shape)
    )
    last = min(experiment.frame_count - 1, MOST_FRAMES)
    seen = []
    for frame in range(last + 1):
        if frame in (0, last // 2, last):
            points = list(env.episode.nodes_m().values())
            for body, pose in env.episode.poses().items():
                turn = Rotation.from_quat(pose[3:], scalar_first=True)
                points.append(pose[:3] + turn.apply(scene.body(body).shape.corners_m))
            seen.append(
                view.pixels(np.concatenate(points), width=SIZE[0], height=SIZE[1])
            )
        if frame < last:
            env.step(zero)
    env.close()
    return seen


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in LONG)]
)
def test_what_moves_is_in_the_picture_and_fills_it(name):
    seen = rollout_pixels(name)
    for pixels in seen:
        assert ((pixels >= 0.0) & (pixels <= SIZE)).all()
    everything = np.concatenate(seen)
    assert (np.ptp(everything, axis=0) / SIZE).max() >= LEAST_SHARE


@pytest.mark.parametrize(
    "task",
    [
        "Carry-Limit-wood",
        "Push-Limit-wood",
        "Throw-Limit-rubber",
        "Pendulum-Limit-metal",
    ],
)
def test_a_body_that_actions_drive_stays_in_the_picture(task):
    env = gymnasium.make(f"GAUGE/{task}").unwrapped
    assert isinstance(env, ControlEnv)
    reach = env.reach()
    view = (
        experiment_view(env.experiment)
        if reach is None
        else scene_view(env.experiment.scene, reference=reach)
    )
    seen = []
    for seed in range(4):
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, terminated, truncated, _ = env.step(env.law_action(0.95))
            over = terminated or truncated
            seen.append(
                view.pixels(
                    np.array([pose[:3] for pose in env.moving_poses().values()]),
                    width=SIZE[0],
                    height=SIZE[1],
                )
            )
    env.close()
    assert ((np.concatenate(seen) >= 0.0) & (np.concatenate(seen) <= SIZE)).all()


def test_every_id_has_a_camera_and_every_camera_an_id():
    names = [variant.name for variant in variants()]
    others = [variant.name for variant in beyond_variants()]
    patterns = list(read_toml(scoring_folder("cameras.toml"), CameraFile).camera)
    for name in names:
        assert sum(fnmatchcase(name, pattern) for pattern in patterns) == 1
    for pattern in patterns:
        assert any(fnmatchcase(name, pattern) for name in names + others)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 4.0 / 3.0, 3.0])
def test_a_narrow_picture_shows_as_much_as_a_usual_one(aspect):
    experiment = load_experiment("SlopeSlider-2-wood")
    body = experiment.scene.dynamic_bodies[0]
    corners = body.pose.to_world(body.shape.corners_m)
    share = experiment_view(experiment, aspect=aspect).pixels(
        corners, width=aspect * 100.0, height=100.0
    )
    assert share.min() >= 0.0
    assert (share <= [aspect * 100.0, 100.0]).all()


UPRIGHT = Pose(position_m=(0.3, -0.2, 1.0))
ENDS = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
CUBE = RigidBody(
    name="cube",
    shape=Box(size_m=(0.2, 0.4, 0.6)),
    motion=Motion.DYNAMIC,
    pose=UPRIGHT,
    mass_kg=1.0,
)
CUBE_ENDS = ENDS * [0.1, 0.2, 0.3]
CARRIER = replace(CUBE, motion=Motion.KINEMATIC)
PUSH = driver_of(
    "cube",
    "translate",
    (0.0, 1.0, 0.0),
    ramp(0.5, start_s=0.0, duration_s=0.8, ramp_s=0.2),
)
LINE = {"pose": UPRIGHT, "length_m": 0.8, "radius_m": 0.01, "mass_kg": 0.1}
SHEET = Cloth(
    name="soft",
    pose=UPRIGHT,
    size_m=(0.9, 0.5),
    mass_kg=0.1,
    areal_density_kg_per_m2=0.1,
    thickness_m=1e-3,
    stretch_stiffness_n_per_m=1e3,
    shear_stiffness_n_per_m=1e3,
    bend_stiffness_n_m_per_rad=1e-3,
)
BOLT = {"body": "cube", "anchor_m": (0.3, -0.2, 1.7)}
GRIP = Attachment(deformable="soft", region=Region(axis="x", side="low"), to="cube")


def floor(height_m: float) -> RigidBody:
    """Return a fixed plane at a height [m]."""
    return replace(ground(), pose=Pose(position_m=(0.0, 0.0, height_m)))


STILL = replace(CUBE, motion=Motion.FIXED)


@pytest.mark.parametrize(
    ("parts", "ends", "azimuth_deg"),
    [
        # Nothing: the least sphere about the origin.
        ({"bodies": ()}, [[-0.3, 0.2, -1.0]], 125.0),
        ({"bodies": (STILL, floor(0.5))}, CUBE_ENDS, 125.0),
        # A body that can fall, over a floor 0.59 m and 0.61 m below it, and on it.
        ({"bodies": (CUBE, floor(0.11))}, [*CUBE_ENDS, [-0.1, -0.2, -0.89]], 125.0),
        ({"bodies": (CUBE, floor(0.09))}, CUBE_ENDS, 125.0),
        ({"bodies": (CUBE, floor(0.7))}, CUBE_ENDS, 125.0),
        # What hangs does not fall; it reaches 0.7 m to both sides of its axis, and down.
        (
            {
                "bodies": (CUBE, floor(0.2)),
                "joints": (Hinge(axis=(1.0, 0.0, 0.0), **BOLT),),
            },
            [*CUBE_ENDS, [0.0, -0.7, 0.7], [0.0, 0.7, 0.7]],
            20.0,
        ),
        (
            {"bodies": (CUBE,), "joints": (Tether(length_m=0.7, **BOLT),)},
            [*CUBE_ENDS, [-0.7, 0.0, 0.7], [0.7, 0.0, 0.7]],
            110.0,
        ),
        # Driven bodies, and what they carry, at the end of their way.
        (
            {"bodies": (CARRIER,), "drivers": (PUSH,)},
            [*CUBE_ENDS, [0.1, 0.7, 0.3]],
            125.0,
        ),
        (
            {
                "bodies": (CARRIER,),
                "drivers": (PUSH,),
                "deformables": (SHEET,),
                "attachments": (GRIP,),
            },
            [*CUBE_ENDS, [0.45, -0.25, 0.0], [-0.45, 0.75, 0.0]],
            125.0,
        ),
        (
            {"bodies": (CARRIER,), "drivers": (PUSH,), "deformables": (SHEET,)},
            [*CUBE_ENDS, [-0.45, -0.25, 0.0], [0.45, 0.7, 0.0]],
            125.0,
        ),
        (
            {
                "bodies": (),
                "deformables": (Rope(name="soft", young_modulus_pa=1e6, **LINE),),
            },
            ENDS * [0.4, 0.0, 0.0],
            125.0,
        ),
        (
            {
                "bodies": (),
                "deformables": (
                    Rod(name="soft", young_modulus_pa=1e6, poisson_ratio=0.3, **LINE),
                ),
            },
            ENDS * [0.0, 0.0, 0.4],
            125.0,
        ),
    ],
)
def test_the_rule_frames_the_box_around_start_and_reach(
    parts: dict[str, Any], ends: list[list[float]], azimuth_deg: float
) -> None:
    """The sphere around the box fills 1 / 1.25 of the height; ends are relative to the place of the body."""
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    radius_m = max(0.5 * np.linalg.norm(high - low), 0.04)
    view = scene_view(Scene(duration_s=1.0, **parts))
    assert view.target_m == pytest.approx(UPRIGHT.position_m + 0.5 * (low + high))
    assert radius_m / view.distance_m == pytest.approx(
        np.sin(np.radians(0.5 * FIELD_OF_VIEW_DEG)) / 1.25
    )
    assert (view.azimuth_deg, view.elevation_deg) == pytest.approx((azimuth_deg, -18.0))


def test_a_picture_has_its_pixels_by_similar_triangles() -> None:
    """Looking along x from 2 m away, half of a height of 100 pixels is tan(15 deg) of the depth."""
    view = View(
        target_m=(0.5, 0.2, 0.1), distance_m=2.0, azimuth_deg=0.0, elevation_deg=0.0
    )
    points_m = np.array([[0.5, 0.2, 0.1], [1.5, 0.2, 0.4], [0.0, 0.3, 0.0]])
    depth_m = points_m[:, 0] + 1.5
    pixel_m = depth_m * np.tan(np.radians(15.0)) / 50.0
    expected = np.column_stack(
        [
            60.0 - (points_m[:, 1] - 0.2) / pixel_m,
            50.0 - (points_m[:, 2] - 0.1) / pixel_m,
        ]
    )
    assert view.pixels(points_m, width=120, height=100) == pytest.approx(expected)
    camera = view.mujoco_camera()
    assert camera.lookat == pytest.approx(view.target_m)
    assert (camera.distance, camera.azimuth, camera.elevation) == (2.0, 0.0, 0.0)


def test_the_rule_frames_places_of_a_reference():
    experiment = load_experiment("CubeToss-acrylic")
    path = reference_path(experiment, reference_band(experiment))
    pixels = scene_view(experiment.scene, reference=path).pixels(
        path.places_m[:, 0], width=300.0, height=300.0
    )
    assert (pixels >= 0.0).all()
    assert (pixels <= 300.0).all()


@pytest.mark.parametrize(
    ("name", "way"),
    [("SlopeSlider-2-wood", (1.0, 0.0)), ("TextileFlinging-satin", (0.0, 1.0))],
)
def test_a_plane_motion_is_seen_from_the_side(name, way):
    forward = experiment_view(load_experiment(name)).axes[2]
    level = forward[:2] / np.hypot(*forward[:2])
    # Within 40 degrees of the normal of the motion, so that at least cos(40 deg) = 77 % of each way is seen.
    assert abs(level @ way) < np.sin(np.radians(40.0))


@needs_opengl
def test_pictures_show_points_where_the_view_says():
    scene = load_experiment("SlopeSlider-2-wood").scene
    view = View(
        target_m=(0.1, -0.2, 0.4), distance_m=1.3, azimuth_deg=33.0, elevation_deg=-21.0
    )
    renderer = SceneRenderer(scene, {}, 320, 240, view=view)
    for offset in ([0.0, 0.0, 0.0], [0.1, 0.1, 0.15], [-0.2, -0.1, 0.1]):
        point = np.add(view.target_m, offset)[None] - 0.3 * view.axes[2]
        picture = renderer.picture({}, {}, Overlay(markers_m=point)).astype(int)
        blue = picture[..., 2] - picture[..., 0] > 60
        row, column = (
            np.flatnonzero(blue.any(axis=axis)).mean() + 0.5 for axis in (1, 0)
        )
        assert [column, row] == pytest.approx(
            view.pixels(point, width=320, height=240)[0], abs=0.75
        )
    renderer.close()


@pytest.mark.parametrize("name", ["FoamTwisting-soft", "FoamCompressing-hard"])
def test_markers_are_on_the_sides_that_the_camera_sees(name):
    experiment = load_experiment(name)
    scene = experiment.scene
    foam, forward = scene.deformables[0], experiment_view(experiment).axes[2]
    places = foam.pose.to_body(np.array(scene.markers.positions_m)) / (
        0.5 * np.array(foam.shape.size_m)
    )
    normals = np.where(np.abs(places) > 0.99, np.sign(places), 0.0)[:, :2]
    towards = -foam.pose.rotation.apply(forward, inverse=True)[:2]
    # All markers are on two neighbouring sides.
    assert (normals @ towards > 0.0).all()
