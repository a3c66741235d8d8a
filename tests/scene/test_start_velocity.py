"""Start velocities: what a scene accepts, its limits, differences, jitter, and both engines."""

import math
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from gauge_envs import Jitter, load_experiment
from gauge_envs.backends import backend
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Box,
    ConvexUnion,
    Hinge,
    Motion,
    Plane,
    Pose,
    Region,
    RigidBody,
    Rope,
    Scene,
    Sphere,
    Tether,
)
from gauge_envs.scene.contact_faces import face_normal
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.jitter import perturbed_states
from gauge_envs.scene.states import scene_at
from gauge_envs.tools.bench.parts import body, contact

LEANING = Pose.from_euler_deg((0.2, 0.1, 1.0), (50.0, -20.0, 70.0))
BRICK = Box(size_m=(0.1, 0.06, 0.03))
CORNERED = ConvexUnion(
    pieces_m=(
        tuple(
            (x, y, z)
            for x, y, z in np.add(BRICK.corners_m, (0.05, 0.03, 0.015)).tolist()
        ),
    )
)
RAMP_DEG = 30.0
LINEAR, ANGULAR = (1.2, -0.8, 0.5), (2.0, 5.0, -3.0)

ENGINES = [
    "mujoco",
    pytest.param(
        "newton",
        marks=pytest.mark.skipif(
            find_spec("newton") is None, reason="extra 'newton' is absent"
        ),
    ),
]


def thrown(shape=BRICK, **changes):
    given = {
        "name": "thrown",
        "shape": shape,
        "motion": Motion.DYNAMIC,
        "pose": LEANING,
        "mass_kg": 0.4,
        "linear_velocity_m_per_s": LINEAR,
        "angular_velocity_rad_per_s": ANGULAR,
    }
    return RigidBody(**(given | changes))


def ramp_scene(friction):
    """A box that slides down a leaning plane for 1 s."""
    lean = Pose.from_euler_deg((0.0, 0.0, 0.0), (RAMP_DEG, 0.0, 0.0))
    above = replace(lean, position_m=vector(lean.rotation.apply((0.0, 0.0, 0.015))))
    return Scene(
        bodies=(
            body("ramp", Plane(), lean, motion=Motion.FIXED),
            body("box", BRICK, above, mass_kg=0.4),
        ),
        contacts=(contact("box", "ramp", friction=friction),),
        duration_s=1.0,
    )


def jittered(scene, jitter, *, seed):
    """Return the scene at a random start."""
    return scene_at(scene, perturbed_states(scene, jitter, seed=seed))


def flight(body, **changes):
    return Scene(**({"bodies": (body,), "duration_s": 0.5} | changes))


# --- what a scene accepts --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [Motion.FIXED, Motion.KINEMATIC])
def test_only_dynamic_bodies_start_with_velocity(motion):
    with pytest.raises(
        ParameterError, match=f"'thrown' is {motion.value} and has a start velocity"
    ):
        flight(thrown(motion=motion))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_velocity_is_finite(bad):
    with pytest.raises(ParameterError, match="'thrown' is not finite"):
        flight(thrown(linear_velocity_m_per_s=(bad, 0.0, 0.0)))


HINGE = Hinge(body="thrown", anchor_m=(0.2, 0.1, 1.3), axis=(0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("linear", "angular"),
    [
        ((0.0, 0.0, 0.0), (0.0, 2.0, 0.0)),
        ((-0.6, 0.0, 0.0), (0.0, 2.0, 0.1)),
        ((-0.6, 0.1, 0.0), (0.0, 2.0, 0.0)),
    ],
)
def test_a_hinged_body_rotates_about_its_hinge(linear, angular):
    accepted = thrown(
        linear_velocity_m_per_s=(-0.6, 0.0, 0.0),
        angular_velocity_rad_per_s=(0.0, 2.0, 0.0),
    )
    flight(accepted, joints=(HINGE,))
    with pytest.raises(
        ParameterError,
        match=r"does not rotate the body about its hinge.*linear velocity \(-0\.6",
    ):
        flight(
            thrown(linear_velocity_m_per_s=linear, angular_velocity_rad_per_s=angular),
            joints=(HINGE,),
        )


def test_what_is_attached_to_a_deformable_body_starts_at_rest():
    rope = Rope(
        name="rope",
        pose=LEANING,
        length_m=0.5,
        radius_m=0.004,
        mass_kg=0.02,
        young_modulus_pa=1e8,
    )
    ends = (
        Attachment(deformable="rope", region=Region(axis="x", side="low"), to="thrown"),
    )
    with pytest.raises(
        ParameterError, match="'thrown' has a start velocity and is attached"
    ):
        flight(thrown(), deformables=(rope,), attachments=ends)


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_body_may_slide_down_a_leaning_plane(friction):
    ramp = ramp_scene(friction)
    simulation = backend("mujoco").build(ramp)
    for _ in range(round(ramp.duration_s * 180)):
        simulation.advance(1 / 180)
    fallen_m = (
        ramp.body("box").pose.position_m[2] - simulation.body_states(["box"])[0, 0, 2]
    )
    lean = math.radians(RAMP_DEG)
    expected = (
        0.5
        * GRAVITY_M_PER_S2
        * (math.sin(lean) - friction * math.cos(lean))
        * ramp.duration_s**2
    )
    assert fallen_m == pytest.approx(expected * math.sin(lean), rel=0.01)


def test_the_speed_limit_is_three_times_the_speed_of_a_fall_from_the_highest_point():
    top_m = 2.0
    ball = thrown(
        Sphere(radius_m=0.1),
        pose=Pose(position_m=(0.0, 0.0, top_m - 0.1)),
        linear_velocity_m_per_s=(0.0, 0.0, 0.0),
        angular_velocity_rad_per_s=(0.0, 0.0, 0.0),
    )
    level = body(
        "ground", Plane(), Pose(position_m=(0.0, 0.0, 0.0)), motion=Motion.FIXED
    )
    scene = Scene(bodies=(ball, level), duration_s=1.0)
    fall_m_per_s = math.sqrt(2.0 * GRAVITY_M_PER_S2 * top_m)
    assert scene.speed_limit_m_per_s == pytest.approx(3.0 * fall_m_per_s)


# --- differences -----------------------------------------------------------------------------------


def test_differences_name_the_velocities():
    before = flight(thrown(angular_velocity_rad_per_s=(0.0, 0.0, 0.0)))
    assert list(scene_changes(before, flight(thrown()))) == [
        "thrown: angular_velocity_rad_per_s (0, 0, 0) -> (2, 5, -3)"
    ]


# --- jitter ----------------------------------------------------------------------------------------------------------


def velocities(scene, jitter, count=500):
    bodies = [jittered(scene, jitter, seed=seed).bodies[0] for seed in range(count)]
    return np.array(
        [
            [body.linear_velocity_m_per_s, body.angular_velocity_rad_per_s]
            for body in bodies
        ]
    )


PUSHES = Jitter(velocity_m_per_s=0.2, angular_velocity_rad_per_s=0.5)


def test_a_ball_gets_a_velocity_in_all_directions_beside_its_own():
    drawn = velocities(flight(thrown(Sphere(radius_m=0.03))), PUSHES, count=2000)
    assert drawn.mean(axis=0) == pytest.approx(np.array([LINEAR, ANGULAR]), abs=0.05)
    assert drawn.std(axis=0) == pytest.approx(
        np.array([[0.2] * 3, [0.5] * 3]), rel=0.07
    )


def test_a_brick_stays_on_its_face():
    rest = thrown(
        linear_velocity_m_per_s=(0.0, 0.0, 0.0),
        angular_velocity_rad_per_s=(0.0, 0.0, 0.0),
    )
    drawn = velocities(flight(rest), PUSHES)
    normal = face_normal(LEANING)
    assert np.abs(drawn[:, 0] @ normal).max() < 1e-12
    assert np.abs(np.cross(drawn[:, 1], normal)).max() < 1e-12
    assert (drawn[:, 1] @ normal).std() == pytest.approx(0.5, rel=0.1)


def test_hinged_bodies_get_a_rate_and_tethers_stay_tight():
    moving = thrown(
        linear_velocity_m_per_s=(-0.6, 0.0, 0.0),
        angular_velocity_rad_per_s=(0.0, 2.0, 0.0),
    )
    # The scene would refuse a velocity that does not fit the hinge.
    rates = velocities(flight(moving, joints=(HINGE,)), PUSHES)[:, 1, 1]
    assert rates.std() == pytest.approx(math.hypot(0.5, 0.2 / 0.3), rel=0.1)
    tether = Tether(body="thrown", anchor_m=(0.2, 0.1, 1.3), length_m=0.3)
    resting = replace(
        moving,
        linear_velocity_m_per_s=(0.0, 0.0, 0.0),
        angular_velocity_rad_per_s=(0.0, 0.0, 0.0),
    )
    for seed in range(50):
        body = jittered(flight(resting, joints=(tether,)), PUSHES, seed=seed).bodies[0]
        arm = np.subtract(body.pose.position_m, tether.anchor_m)
        assert abs(arm @ body.linear_velocity_m_per_s) < 1e-12
        assert np.linalg.norm(body.linear_velocity_m_per_s) > 1e-3


def test_poses_do_not_depend_on_drawn_velocities():
    scene = load_experiment("NewtonsCradle-metal").scene
    for seed in range(3):
        still, pushed = (
            jittered(scene, jitter, seed=seed) for jitter in (Jitter(), PUSHES)
        )
        assert [body.pose for body in still.bodies] == [
            body.pose for body in pushed.bodies
        ]
        assert all(body.starts_at_rest for body in still.bodies)
        assert not any(body.starts_at_rest for body in pushed.dynamic_bodies)


def test_a_result_records_velocities_only_if_they_were_drawn():
    assert Jitter().to_dict() == {"position_m": 1e-3, "angle_rad": math.radians(0.5)}
    assert PUSHES.to_dict()["velocity_m_per_s"] == 0.2
    assert Jitter(**PUSHES.to_dict()) == PUSHES


# --- engines ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["TextileBending-rayon", "CantileverBeam-soft", "RopeWinding-rubber"]
)
@pytest.mark.parametrize("engine", ENGINES)
def test_a_thrown_ball_flies_beside_deformable_bodies(engine, name):
    """Deformable bodies have solvers of their own, which take the start velocities too."""
    scene = load_experiment(name).scene
    ball = thrown(Sphere(radius_m=0.03), pose=Pose(position_m=(3.0, 3.0, 3.0)))
    scene = replace(
        scene, bodies=(*scene.bodies, ball), contacts=(), gravity_m_per_s2=0.0
    )
    simulation = backend(engine).build(scene)
    for _ in range(2):
        assert simulation.body_states(["thrown"])[0, 0, 7:] == pytest.approx(
            [*LINEAR, *ANGULAR], abs=1e-6
        )
        for _ in range(2):
            simulation.advance(1 / 180)
        moved = simulation.body_states(["thrown"])[0, 0, :3] - 3.0
        assert moved == pytest.approx(np.array(LINEAR) / 90, abs=1e-5)
        simulation.reset()


def test_a_body_has_one_hinge():
    hinges = [
        Hinge(body="bar", anchor_m=(0.0, 0.0, 0.0), axis=axis)
        for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    ]
    with pytest.raises(ParameterError, match="'bar' hangs on 2 hinges"):
        Scene(bodies=(), joints=tuple(hinges), duration_s=1.0)
