"""Checks of start velocities and contacts of a scene, its bounds of speed and height, and its differences."""

import math
from dataclasses import replace

import pytest
from rigid import plane_deg, scene_of, solid

from gauge_envs.errors import ParameterError
from gauge_envs.fixtures.parts import contact, driver, ramp
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Box,
    Hinge,
    Motion,
    Pose,
    Region,
    Rope,
    Sphere,
)
from gauge_envs.scene.diff import scene_changes

LINEAR, ANGULAR = (1.2, -0.8, 0.5), (2.0, 5.0, -3.0)
THROWN = solid(
    "thrown",
    Box(size_m=(0.1, 0.06, 0.03)),
    (0.2, 0.1, 1.0),
    linear_velocity_m_per_s=LINEAR,
    angular_velocity_rad_per_s=ANGULAR,
)
HINGE = Hinge(body="thrown", anchor_m=(0.2, 0.1, 1.3), axis=(0.0, 1.0, 0.0))
ROPE = Rope(
    name="rope",
    pose=Pose(position_m=(0.0, 0.0, 1.0)),
    length_m=0.5,
    radius_m=0.004,
    mass_kg=0.02,
    young_modulus_pa=1e8,
)
CUBE = solid("cube", Sphere(radius_m=0.1), (0.0, 0.0, 1.9))
GROUND = plane_deg()
CONTACT = contact("cube", "ground", friction=0.1)


# --- what a scene accepts --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("linear", "angular", "is_accepted"),
    [
        ((-0.6, 0.0, 0.0), (0.0, 2.0, 0.0), True),
        ((0.0, 0.0, 0.0), (0.0, 2.0, 0.0), False),
        ((-0.6, 0.0, 0.0), (0.0, 2.0, 0.1), False),
        ((-0.6, 0.1, 0.0), (0.0, 2.0, 0.0), False),
    ],
)
def test_a_hinged_body_rotates_about_its_hinge(linear, angular, is_accepted):
    """0.3 m below its hinge, at 2 rad/s, it moves at 0.6 m/s."""
    body = replace(
        THROWN, linear_velocity_m_per_s=linear, angular_velocity_rad_per_s=angular
    )
    if is_accepted:
        assert scene_of(body, joints=(HINGE,)).body("thrown") == body
        return
    with pytest.raises(ParameterError, match=r"linear velocity \(-0\.6"):
        scene_of(body, joints=(HINGE,))


@pytest.mark.parametrize(
    ("bodies", "parts", "reason"),
    [
        ([replace(THROWN, motion=Motion.FIXED)], {}, "'thrown' is fixed and has"),
        (
            [replace(THROWN, linear_velocity_m_per_s=(math.nan, 0.0, 0.0))],
            {},
            "'thrown' is not finite",
        ),
        (
            [THROWN],
            {
                "deformables": (ROPE,),
                "attachments": (
                    Attachment(
                        deformable="rope",
                        region=Region(axis="x", side="low"),
                        to="thrown",
                    ),
                ),
            },
            "'thrown' has a start velocity and is attached",
        ),
        (
            [CUBE],
            {"joints": (replace(HINGE, body="cube"), replace(HINGE, body="cube"))},
            "'cube' has 2 hinges",
        ),
        (
            [CUBE, GROUND],
            {
                "contacts": (
                    CONTACT,
                    replace(CONTACT, first=("ground",), second=("cube",)),
                )
            },
            "two contacts list the pair 'cube' and 'ground'",
        ),
        (
            [CUBE, GROUND],
            {"contacts": (replace(CONTACT, friction=0.0, rolling_m=1e-3),)},
            "rolling friction without sliding friction",
        ),
    ],
)
def test_a_contradictory_scene_is_rejected(bodies, parts, reason):
    with pytest.raises(ParameterError, match=reason):
        scene_of(*bodies, **parts)


# --- bounds and differences ------------------------------------------------------------------------------------------


def test_the_bounds_of_a_scene_follow_from_a_fall_with_the_fastest_start():
    """Three times the speed after a fall of 2 m; and a start of 3.2 m/s, with 0.2 m/s from the spin."""
    fall_m_per_s = math.sqrt(2.0 * GRAVITY_M_PER_S2 * 2.0)
    resting = scene_of(CUBE, GROUND)
    assert resting.floor_height_m == 0.0
    assert resting.speed_limit_m_per_s == pytest.approx(3.0 * fall_m_per_s)
    spin = 0.2 / math.sqrt(3.0 * 0.1**2)
    fast = replace(
        CUBE,
        linear_velocity_m_per_s=(0.0, 3.0, 0.0),
        angular_velocity_rad_per_s=(spin, 0.0, 0.0),
    )
    thrown = scene_of(fast, GROUND)
    expected = 3.0 * math.hypot(fall_m_per_s, 3.2)
    assert thrown.speed_limit_m_per_s == pytest.approx(expected)
    # An elastic hit by a driven body gives a light body twice the speed of the driven body.
    plate = replace(GROUND, name="plate", motion=Motion.KINEMATIC)
    lift = driver(
        "plate",
        "translate",
        (0.0, 0.0, 1.0),
        ramp(1.5, start_s=0.0, duration_s=2.0, ramp_s=0.5),
    )
    driven = scene_of(fast, GROUND, plate, drivers=(lift,))
    assert driven.speed_limit_m_per_s == pytest.approx(expected + 2.0)
    # A leaning plane stops no fall.
    slope = scene_of(fast, plane_deg(2.0), seconds=0.5)
    fallen_m = 3.2 * 0.5 + 0.5 * GRAVITY_M_PER_S2 * 0.5**2
    assert slope.floor_height_m == pytest.approx(-fallen_m)


def test_differences_name_what_changed():
    before = scene_of(CUBE, GROUND, contacts=(CONTACT,))
    assert list(scene_changes(before, before)) == []
    moved = replace(CUBE, linear_velocity_m_per_s=LINEAR, mass_kg=0.25)
    after = scene_of(
        moved,
        replace(GROUND, name="floor"),
        contacts=(replace(CONTACT, friction=0.2),),
        gravity_m_per_s2=1.62,
    )
    assert {*map(str, scene_changes(before, after))} == {
        "cube: mass_kg 0.1 -> 0.25",
        "cube: linear_velocity_m_per_s (0, 0, 0) -> (1.2, -0.8, 0.5)",
        "ground: removed",
        "floor: added",
        "contact cube/ground: friction 0.1 -> 0.2",
        "scene: gravity_m_per_s2 9.80665 -> 1.62",
    }
    swapped = replace(before, bodies=(GROUND, CUBE))
    (change,) = scene_changes(before, swapped)
    assert str(change) == "bodies: order (cube, ground) -> (ground, cube)"
