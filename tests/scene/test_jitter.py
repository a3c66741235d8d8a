"""Random initial states: only in the directions that contacts and joints allow, with the given standard deviations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from rigid import plane_deg, scene_of, solid
from scipy.spatial.distance import pdist

from gauge_envs import Jitter, load_experiment
from gauge_envs.errors import ParameterError
from gauge_envs.fixtures.parts import contact
from gauge_envs.scene import Box, Motion, Sphere, Tether
from gauge_envs.scene.contact_faces import face_normal
from gauge_envs.scene.jitter import JITTER_FORMAT, perturbed_states
from gauge_envs.scene.states import scene_at

PUSHES = Jitter(velocity_m_per_s=0.2, angular_velocity_rad_per_s=0.5)


def scene_named(name):
    return load_experiment(name).scene


def jittered(scene, jitter, *, seed):
    """Return the scene at a random start."""
    return scene_at(scene, perturbed_states(scene, jitter, seed=seed))


def drawn(scene, name, jitter=PUSHES, count=500):
    """Return shifts [m] and rotation vectors [rad] of a body, and its velocities, each of shape [count, 3]."""
    start = scene.body(name).pose
    bodies = [jittered(scene, jitter, seed=seed).body(name) for seed in range(count)]
    shifts_m = np.array([body.pose.position_m for body in bodies]) - start.position_m
    rotations = [
        (body.pose.rotation * start.rotation.inv()).as_rotvec() for body in bodies
    ]
    linear = [body.linear_velocity_m_per_s for body in bodies]
    angular = [body.angular_velocity_rad_per_s for body in bodies]
    return shifts_m, np.array(rotations), np.array(linear), np.array(angular)


def test_a_cube_on_a_slope_moves_along_it_and_rotates_about_its_normal():
    scene = scene_named("SlopeSlider-2-wood")
    cube = scene.body("cube").pose
    normal = face_normal(cube)
    assert normal == pytest.approx([0.5, 0.0, math.sqrt(0.75)])
    stds = (1e-3, math.radians(0.5), 0.2, 0.5)
    for index, (vectors, std) in enumerate(
        zip(drawn(scene, "cube", count=1000), stds, strict=True)
    ):
        local = vectors @ cube.matrix
        # Translations in the plane, rotations about its normal.
        is_rotation = index % 2
        closed = local[:, :2] if is_rotation else local[:, 2:]
        open_ = local[:, 2:] if is_rotation else local[:, :2]
        assert np.abs(closed).max() < 1e-9
        assert open_.std(axis=0) == pytest.approx(np.full(len(open_[0]), std), rel=0.07)


def test_a_ball_in_the_air_moves_in_all_directions():
    scene = scene_named("BouncingBall-rubber")
    shifts, _, linear, angular = drawn(scene, "ball", count=1000)
    for vectors, std in ((shifts, 1e-3), (linear, 0.2), (angular, 0.5)):
        assert vectors.std(axis=0) == pytest.approx([std] * 3, rel=0.07)


def test_a_hinged_ball_rotates_about_its_hinge():
    scene = scene_named("Pendulum-metal")
    (hinge,) = scene.joints
    arm = np.subtract(scene.body("ball").pose.position_m, hinge.anchor_m)
    shifts, rotations, linear, angular = drawn(scene, "ball")
    arms, axis = arm + shifts, np.array(hinge.axis)
    length = np.linalg.norm(arm)
    assert np.linalg.norm(arms, axis=1) == pytest.approx(np.full(500, length))
    assert np.abs(np.cross(rotations, axis)).max() < 1e-9
    assert (rotations @ axis).std() == pytest.approx(math.radians(0.5), rel=0.1)
    assert linear == pytest.approx(np.cross(angular, arms), abs=1e-12)
    # A linear velocity along the circle is also a rate of rotation.
    rate = math.hypot(0.5, 0.2 / length)
    assert (angular @ axis).std() == pytest.approx(rate, rel=0.1)


def test_a_tether_stays_tight():
    ball = solid("ball", Sphere(radius_m=0.05), (0.3, 0.0, 0.6))
    tether = Tether(body="ball", anchor_m=(0.0, 0.0, 1.0), length_m=0.5)
    shifts, rotations, linear, angular = drawn(
        scene_of(ball, joints=(tether,)), "ball", count=100
    )
    arms, length = np.add(shifts, [0.3, 0.0, -0.4]), 0.5
    assert np.linalg.norm(arms, axis=1) == pytest.approx(np.full(100, length))
    assert rotations.std(axis=0) == pytest.approx([math.radians(0.5)] * 3, rel=0.25)
    assert np.abs((arms * linear).sum(axis=1)).max() < 1e-12
    # The ball swings about its anchor at the random rate, and has a random velocity along the sphere.
    along = linear - np.cross(angular, arms)
    assert np.square(along).sum(axis=1).mean() == pytest.approx(2 * 0.2**2, rel=0.25)


def test_fixed_and_driven_bodies_stay_and_free_cloth_keeps_its_plane():
    scene = scene_named("RotatingBall-rayon")
    noisy = jittered(scene, Jitter(), seed=1)
    assert noisy.bodies == scene.bodies
    cloth, moved = scene.deformables[0].pose, noisy.deformables[0].pose
    assert moved.position_m[:2] != cloth.position_m[:2]
    assert moved.position_m[2] == pytest.approx(cloth.position_m[2], abs=1e-12)
    assert face_normal(moved) == pytest.approx(face_normal(cloth), abs=1e-12)
    turntable = scene_named("Turntable-1-wood")
    for before, after in zip(
        turntable.bodies, jittered(turntable, PUSHES, seed=3).bodies, strict=True
    ):
        assert (before == after) == (before.motion is not Motion.DYNAMIC)


@pytest.mark.parametrize(
    ("name", "body", "moved_um"),
    [
        ("SlopeContact-wood", "teh", [-259.988, -132.105, 367.679]),
        ("WallBreaking-wood", "brick-1", [1243.478, -642.988, 0.0]),
        ("BouncingBall-rubber", "ball", [125.73, -132.105, 640.423]),
        ("Pendulum-metal", "ball", [0.162, 0.0, 294.643]),
    ],
)
def test_the_start_of_a_seed_does_not_depend_on_random_velocities(name, body, moved_um):
    """Sweeps store JITTER_FORMAT in their keys. If the draw changes, the format must change too."""
    assert JITTER_FORMAT == 3
    scene = scene_named(name)
    for jitter in (Jitter(), PUSHES):
        moved = jittered(scene, jitter, seed=0).body(body)
        shift_m = np.subtract(moved.pose.position_m, scene.body(body).pose.position_m)
        assert 1e6 * shift_m == pytest.approx(moved_um, abs=2e-3)
        assert moved.starts_at_rest == (jitter != PUSHES)


def test_noise_that_moves_nothing_or_is_not_a_number_is_rejected():
    with pytest.raises(ParameterError, match="nothing to jitter"):
        jittered(scene_named("CantileverBeam-soft"), Jitter(), seed=0)
    for values in ({"position_m": -1e-3}, {"angle_rad": math.nan}):
        with pytest.raises(ParameterError, match="jitter"):
            Jitter(**values)
    assert Jitter().to_dict() == {"position_m": 1e-3, "angle_rad": math.radians(0.5)}
    assert Jitter(**PUSHES.to_dict()) == PUSHES


@pytest.mark.parametrize("name", ["SlopeContact-wood", "SlopeContact-plastic"])
def test_a_tetrahedron_on_a_seam_keeps_its_contact(name):
    """The face on the seam makes equal angles with the edges of a cube."""
    scene = scene_named(name)
    normal = np.array([math.sqrt(2.0), 0.0, 1.0]) / math.sqrt(3.0)
    shifts, rotations, *_ = drawn(scene, "teh", Jitter())
    assert np.abs(shifts @ normal).max() < 1e-12
    along = np.array([[0.0, 1.0, 0.0], np.cross([0.0, 1.0, 0.0], normal)])
    assert (shifts @ along.T).std(axis=0) == pytest.approx([1e-3] * 2, rel=0.1)
    assert np.abs(np.cross(rotations, normal)).max() < 1e-9
    assert (rotations @ normal).std() == pytest.approx(math.radians(0.5), rel=0.1)


@pytest.mark.parametrize("count", [2, 12])
def test_bricks_that_touch_move_as_one_rigid_body(count):
    scene = scene_named("WallBreaking-wood")
    bricks = [body.name for body in scene.bodies if body.name.startswith("brick")]
    left_out = bricks[count:]
    bodies = [body for body in scene.bodies if body.name not in left_out]
    scene, bricks = replace(scene, bodies=tuple(bodies)), bricks[:count]
    noisy = jittered(scene, PUSHES, seed=4)
    before, after = ([state.body(name) for name in bricks] for state in (scene, noisy))
    places, moved = (
        np.array([body.pose.position_m for body in bodies])
        for bodies in (before, after)
    )
    assert pdist(moved) == pytest.approx(pdist(places), abs=1e-12)
    assert moved[:, 2] == pytest.approx(places[:, 2], abs=1e-12)
    angular = np.array([body.angular_velocity_rad_per_s for body in after])
    linear = np.array([body.linear_velocity_m_per_s for body in after])
    assert angular == pytest.approx(np.tile(angular[0], (len(bricks), 1)))
    expected = linear[0] + np.cross(angular, moved - moved[0])
    assert linear == pytest.approx(expected, abs=1e-12)
    assert np.linalg.norm(angular[0]) > 1e-3


def test_a_body_in_a_corner_moves_along_it_and_does_not_rotate():
    cube = solid("cube", Box(size_m=(0.05, 0.05, 0.05)), (0.025, 0.0, 0.025))
    planes = plane_deg(), plane_deg(90.0, "wall")
    contacts = [contact("cube", plane.name, friction=0.3) for plane in planes]
    corner = scene_of(cube, *planes, contacts=tuple(contacts))
    shifts, rotations, linear, angular = drawn(corner, "cube")
    for vectors, std in ((shifts, 1e-3), (linear, 0.2)):
        assert np.abs(vectors[:, [0, 2]]).max() < 1e-15
        assert vectors[:, 1].std() == pytest.approx(std, rel=0.1)
    assert max(np.abs(rotations).max(), np.abs(angular).max()) < 1e-12
