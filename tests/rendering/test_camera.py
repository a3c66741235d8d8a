"""The camera shows all moving bodies as large as possible."""

from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
import pytest
from opengl import pixels_of
from scipy.spatial.transform import Rotation

from gauge_envs import GaugeEnv
from gauge_envs.experiments.variants import beyond_variants, variants
from gauge_envs.fixtures.parts import driver as driver_of, ground, ramp
from gauge_envs.references.tables import read_toml, scoring_folder
from gauge_envs.rendering.camera import (
    FIELD_OF_VIEW_DEG,
    CameraFile,
    experiment_view,
    scene_view,
)
from gauge_envs.rendering.reference_path import reference_path
from gauge_envs.scene import Box, Hinge, Motion, Pose, RigidBody, Rod, Scene

SIZE = (640, 480)

QUICK = (
    "BouncingBall-rubber",
    "NonsmoothContact-1-wood",
    "SlopeSlider-2-wood",
    "Turntable-2-metal",
    "NewtonsCradle-metal",
    "Pendulum-metal",
    "CubeToss-acrylic",
)
LONG = (
    "WallBreaking-wood",
    "RopeWinding-rubber",
    "TextileFlinging-satin",
    "TableclothPulling-metal",
    "FoamTwisting-soft",
    "StickStack-soft",
    "CantileverBeam-soft",
)


@pytest.mark.parametrize(
    "name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in LONG)]
)
def test_moving_bodies_are_in_the_picture_and_fill_half_of_it(name):
    env = GaugeEnv(name)
    env.reset(seed=0)
    experiment = env.rollout.experiment
    scene = experiment.scene
    path = reference_path(experiment, env.band)
    places_m = None if path is None else path.places_m
    view = experiment_view(experiment, places_m=places_m)
    zero = np.zeros(env.action_space.shape, dtype=env.action_space.dtype)
    last = min(env.experiment.frame_count - 1, 120)
    seen = []
    for frame in range(last + 1):
        if frame in (0, last // 2, last):
            points = list(env.rollout.nodes_m().values())
            for body, pose in env.rollout.poses().items():
                rotation = Rotation.from_quat(pose[3:], scalar_first=True)
                corners_m = scene.body(body).shape.corners_m
                points.append(pose[:3] + rotation.apply(corners_m))
            points_m = np.concatenate(points)
            seen.append(pixels_of(view, points_m, width=SIZE[0], height=SIZE[1]))
        if frame < last:
            env.step(zero)
    env.close()
    pixels = np.concatenate(seen)
    assert ((pixels >= 0.0) & (pixels <= SIZE)).all()
    assert (np.ptp(pixels, axis=0) / SIZE).max() >= 0.5


def test_every_id_has_a_camera_and_every_camera_an_id():
    names = [variant.name for variant in variants()]
    beyond = [variant.name for variant in beyond_variants()]
    patterns = list(read_toml(scoring_folder("cameras.toml"), CameraFile).camera)
    for name in names:
        assert sum(fnmatchcase(name, pattern) for pattern in patterns) == 1
    for pattern in patterns:
        assert any(fnmatchcase(name, pattern) for name in names + beyond)


START = Pose(position_m=(0.3, -0.2, 1.0))
CUBE = RigidBody(
    name="cube",
    shape=Box(size_m=(0.2, 0.4, 0.6)),
    motion=Motion.DYNAMIC,
    pose=START,
    mass_kg=1.0,
)
CORNERS_M = np.array([[-0.1, -0.2, -0.3], [0.1, 0.2, 0.3]])
PUSH = driver_of(
    "cube",
    "translate",
    (0.0, 1.0, 0.0),
    ramp(0.5, start_s=0.0, duration_s=0.8, ramp_s=0.2),
)
HINGE = Hinge(body="cube", axis=(1.0, 0.0, 0.0), anchor_m=(0.3, -0.2, 1.7))
ROD = Rod(
    name="rod",
    pose=START,
    length_m=0.8,
    radius_m=0.01,
    mass_kg=0.1,
    young_modulus_pa=1e6,
    poisson_ratio=0.3,
)


def floor(height_m: float) -> RigidBody:
    """Return a fixed plane at a height [m]."""
    return replace(ground(), pose=Pose(position_m=(0.0, 0.0, height_m)))


@pytest.mark.parametrize(
    ("parts", "ends", "azimuth_deg"),
    [
        # A body that can fall: over a near floor, and over one that is too far below.
        ({"bodies": (CUBE, floor(0.11))}, [*CORNERS_M, [0.0, 0.0, -0.89]], 125.0),
        ({"bodies": (CUBE, floor(0.09))}, CORNERS_M, 125.0),
        # A swing with an arm of 0.7 m does not fall.
        (
            {"bodies": (CUBE, floor(0.2)), "joints": (HINGE,)},
            [*CORNERS_M, [-0.7, -0.7, 0.0], [0.7, 0.7, 0.7]],
            20.0,
        ),
        # A driven body at the end of its displacement.
        (
            {"bodies": (replace(CUBE, motion=Motion.KINEMATIC),), "drivers": (PUSH,)},
            [*CORNERS_M, [0.1, 0.7, 0.3]],
            125.0,
        ),
        (
            {"bodies": (), "deformables": (ROD,)},
            [[0.0, 0.0, -0.4], [0.0, 0.0, 0.4]],
            125.0,
        ),
    ],
)
def test_a_scene_without_a_camera_shows_start_and_motion(
    parts: dict[str, Any], ends: list[list[float]], azimuth_deg: float
) -> None:
    """The sphere around the box of all places fills 1 / 1.25 of the height; ends are relative to the body."""
    low_m, high_m = np.min(ends, axis=0), np.max(ends, axis=0)
    view = scene_view(Scene(duration_s=1.0, **parts))
    assert view.target_m == pytest.approx(START.position_m + 0.5 * (low_m + high_m))
    radius_m = 0.5 * np.linalg.norm(high_m - low_m)
    sine = np.sin(np.radians(0.5 * FIELD_OF_VIEW_DEG))
    assert radius_m / view.distance_m == pytest.approx(sine / 1.25)
    assert (view.azimuth_deg, view.elevation_deg) == pytest.approx((azimuth_deg, -18.0))
