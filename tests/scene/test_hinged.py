"""Hinges between two bodies: what a scene refuses, their frames, trees, and changes of a scene."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    BodyHinge,
    Box,
    Contact,
    Hinge,
    JointDynamics,
    Motion,
    Pose,
    RigidBody,
    Scene,
    Tether,
)
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scene.geometry import vector
from gauge_envs.scene.hinged import (
    hinge_angle_rad,
    hinge_frames,
    hinge_trees,
    parent_hinges,
)
from gauge_envs.scene.jitter import Jitter, jittered, tilted

SHAPE = Box(size_m=(0.1, 0.05, 0.05))


def block(name, x, **values):
    given = {
        "name": name,
        "shape": SHAPE,
        "motion": Motion.DYNAMIC,
        "mass_kg": 0.3,
    } | values
    return RigidBody(pose=Pose(position_m=(x, 0.0, 0.5)), **given)


def hinge(
    first,
    second,
    x,
    axis=(0.0, 1.0, 0.0),
):
    return BodyHinge(first=first, second=second, anchor_m=(x, 0.0, 0.5), axis=axis)


def wall(body):
    dynamics = JointDynamics(dry_friction_n_m=0.01)
    return Hinge(
        body=body, anchor_m=(0.0, 0.0, 1.0), axis=(0.0, 1.0, 0.0), dynamics=dynamics
    )


PAIR = Scene(
    bodies=(block("a", 0.0), block("b", 0.12)),
    body_hinges=(hinge("a", "b", 0.06),),
    duration_s=1.0,
)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"body_hinges": (hinge("a", "c", 0.06),)}, "no rigid body 'c'; known: a, b"),
        (
            {"body_hinges": (hinge("a", "b", 0.06, (0.0, 2.0, 0.0)),)},
            "not a unit vector",
        ),
        ({"body_hinges": (hinge("a", "a", 0.06),)}, "closes a loop"),
        (
            {"body_hinges": (hinge("a", "b", 0.06), hinge("b", "a", 0.06))},
            "closes a loop",
        ),
        (
            {"bodies": (block("a", 0.0), block("b", 0.12, motion=Motion.FIXED))},
            "'b' is fixed",
        ),
        (
            {"joints": (Tether(body="a", anchor_m=(0.0, 0.0, 1.0), length_m=0.5),)},
            "has a string or an attachment",
        ),
        ({"joints": (wall("a"), wall("b"))}, "two hinges to the world"),
        (
            {
                "contacts": (
                    Contact(first=("a",), second=("b",), friction=0.3, restitution=0.0),
                )
            },
            "remove the pair from the contact",
        ),
        (
            {
                "bodies": (
                    block("a", 0.0),
                    block("b", 0.12, linear_velocity_m_per_s=(0.0, 0.0, 1.0)),
                )
            },
            "start with 1 m/s",
        ),
        (
            {
                "bodies": (
                    block("a", 0.0),
                    block(
                        "b",
                        0.12,
                        angular_velocity_rad_per_s=(2.0, 0.0, 0.0),
                    ),
                )
            },
            "axes with 2 rad/s",
        ),
    ],
)
def test_a_scene_refuses_what_contradicts_a_hinge(changes, message):
    with pytest.raises(ParameterError, match=message):
        replace(PAIR, **changes)


def test_velocities_that_turn_the_hinge_are_accepted():
    turning = block(
        "b",
        0.12,
        angular_velocity_rad_per_s=(0.0, 2.0, 0.0),
        linear_velocity_m_per_s=(0.0, 0.0, -0.12),
    )
    scene = replace(PAIR, bodies=(block("a", 0.0), turning))
    assert scene.body("b") == turning


def test_angles_follow_a_known_rotation():
    first = Pose.from_euler_deg((0.1, 0.2, 0.3), (20.0, 30.0, 40.0))
    second = Pose.from_euler_deg((0.2, 0.2, 0.3), (50.0, -10.0, 5.0))
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    frames = hinge_frames(
        BodyHinge(first="a", second="b", anchor_m=(0.1, 0.1, 0.1), axis=vector(axis)),
        first,
        second,
    )
    np.testing.assert_allclose(first.to_world(frames.first_anchor_m), [0.1, 0.1, 0.1])
    np.testing.assert_allclose(second.to_world(frames.second_anchor_m), [0.1, 0.1, 0.1])
    carried = Rotation.from_rotvec([0.3, 0.4, -0.5])
    angles = np.array([0.0, 0.4, -2.5, 3.0, 3.5])
    turned = carried * Rotation.from_rotvec(np.outer(angles, axis)) * second.rotation
    firsts = Rotation.concatenate([carried * first.rotation] * len(angles))
    wrapped = np.array([0.0, 0.4, -2.5, 3.0, 3.5 - 2.0 * np.pi])
    np.testing.assert_allclose(
        hinge_angle_rad(frames, firsts, turned), wrapped, atol=1e-12
    )


def test_trees_start_at_the_first_body_of_the_first_hinge():
    hinges = (hinge("b", "c", 0.2), hinge("d", "e", 0.5), hinge("a", "b", 0.1))
    assert hinge_trees(hinges) == [(hinges[0], hinges[2]), (hinges[1],)]
    assert parent_hinges(hinges) == {"c": hinges[0], "a": hinges[2], "e": hinges[1]}


def test_changes_name_both_bodies():
    moved = replace(
        PAIR, body_hinges=(replace(PAIR.body_hinges[0], anchor_m=(0.07, 0.0, 0.5)),)
    )
    assert list(scene_changes(PAIR, moved)) == [
        "hinge of a and b: anchor_m (0.06, 0, 0.5) -> (0.07, 0, 0.5)"
    ]
    assert list(scene_changes(PAIR, replace(PAIR, body_hinges=()))) == [
        "hinge of a and b: removed"
    ]


def gap_m(scene):
    """Return how far the ends of the hinge are apart, from its frames in the untouched scene."""
    frames = hinge_frames(PAIR.body_hinges[0], *(body.pose for body in PAIR.bodies))
    ends = [
        scene.body("a").pose.to_world(frames.first_anchor_m),
        scene.body("b").pose.to_world(frames.second_anchor_m),
        np.asarray(scene.body_hinges[0].anchor_m),
    ]
    axes = [
        scene.body("a").pose.rotation.apply(frames.first_axis),
        scene.body("b").pose.rotation.apply(frames.second_axis),
        np.asarray(scene.body_hinges[0].axis),
    ]
    return max(
        float(np.abs(np.diff(one, axis=0)).max())
        for one in (np.array(ends), np.array(axes))
    )


def test_a_leaning_scene_keeps_the_hinge_closed():
    assert gap_m(tilted(PAIR, (0.1, 0.2, 0.3), (0.5, 0.5, 0.0))) < 1e-12


def test_random_starts_keep_the_hinge_closed():
    jitter = Jitter(velocity_m_per_s=0.1, angular_velocity_rad_per_s=0.5)
    for seed in range(5):
        scene = jittered(PAIR, jitter, seed=seed)
        assert gap_m(scene) < 1e-12
        assert scene.body("a").pose != PAIR.body("a").pose
        assert not scene.body("b").starts_at_rest


def test_random_starts_of_a_chain_swing_it_about_its_hinge_to_the_world():
    chain = replace(PAIR, joints=(wall("b"),))
    for seed in range(5):
        scene = jittered(chain, Jitter(angular_velocity_rad_per_s=0.5), seed=seed)
        assert scene.joints == chain.joints
        assert gap_m(scene) < 1e-12
        turns = [scene.body(name).pose.rotation.as_rotvec() for name in "ab"]
        np.testing.assert_allclose(turns[0], turns[1], atol=1e-12)
        assert (
            np.linalg.norm(np.cross(turns[0], (0.0, 1.0, 0.0)))
            < 1e-12
            < np.linalg.norm(turns[0])
        )
        before, after = (
            one.body("b").pose.to_body(np.array([0.0, 0.0, 1.0]))
            for one in (chain, scene)
        )
        np.testing.assert_allclose(after, before, atol=1e-12)
