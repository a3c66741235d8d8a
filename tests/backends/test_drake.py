"""Traps of Drake: dissipation of its contact laws in discrete time, lift of convex approximations, heavy bodies.

Expected values are closed forms of a spring with damping and of Hunt and Crossley's law, and Coulomb's law.
"""

import numpy as np
import pytest
from rigid import (
    FRICTION,
    SLIDE_M_PER_S2,
    plane_deg,
    scene_of,
    slide,
    solid,
    states,
    target,
)

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.errors import ParameterError
from gauge_envs.fixtures.parts import contact
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    Motion,
    Pose,
    Sphere,
)

pytest.importorskip("pydrake")

from pydrake.multibody.plant import DiscreteContactApproximation

from gauge_envs.backends.drake.contacts import PHASES, impact_constants, rebound
from gauge_envs.backends.drake.settings import impact_speed_m_per_s

DRAKE = backend("drake")
HAS_TAMSI = hasattr(DiscreteContactApproximation, "kTamsi")
"""Whether the installed Drake has the approximation; 1.58 has none."""
G = GRAVITY_M_PER_S2
GROUND = plane_deg()


# --- impacts ---------------------------------------------------------------------------------------------------------


def impact(approximation, restitution, phase, speed, impact_speed=1.0):
    """Rebound of a ball without gravity, whose first step in touch has a depth of `phase` times its step."""
    step_s = 1 / 9000
    settings = {
        "approximation": approximation,
        "contact_model": "point",
        "timestep_s": step_s,
        "impact_rate": 0.1,
        "impact_speed_m_per_s": impact_speed,
    }
    gap_m = (2.0 - phase) * step_s * speed
    ball = solid(
        "ball",
        Sphere(radius_m=0.03),
        (0.0, 0.0, 0.03 + gap_m),
        linear_velocity_m_per_s=(0.0, 0.0, -speed),
    )
    touch = contact("ball", "ground", friction=0.5, restitution=restitution)
    scene = scene_of(GROUND, ball, contacts=(touch,), gravity_m_per_s2=0.0)
    return states(DRAKE, scene, ["ball"], 0.2, **settings)[-1, 0, 9] / speed


@pytest.mark.parametrize("approximation", ["sap", "similar", "lagged"])
@pytest.mark.parametrize("restitution", [0.2, 0.577])
def test_the_scheme_of_an_impact_equals_drakes(approximation, restitution):
    law = "relaxation" if approximation == "sap" else "hunt_crossley"
    expected = rebound(law, *impact_constants(law, restitution, 0.1))
    for index in (0, 7):
        measured = impact(approximation, restitution, PHASES[index], 1.0)
        assert measured == pytest.approx(expected[index], abs=1e-6)


@pytest.mark.parametrize(
    ("law", "spread"), [("relaxation", 0.0055), ("hunt_crossley", 0.0006)]
)
@pytest.mark.parametrize("restitution", [0.05, 0.577, 0.95])
def test_fitted_constants_have_the_restitution(law, spread, restitution):
    ratios = rebound(law, *impact_constants(law, restitution, 0.03))
    assert ratios.mean() == pytest.approx(restitution, abs=1e-6)
    assert np.abs(ratios - restitution).max() < spread
    # Gravity during the contact is made up for.
    weight = G / 72000 / 2.8
    fitted = impact_constants(law, restitution, 0.03, weight)
    assert rebound(law, *fitted, weight).mean() == pytest.approx(restitution, abs=1e-6)


def test_constants_follow_their_closed_forms_for_short_steps():
    """Hunt and Crossley: u - ln(1 + u) is the same for u = d v0 and u = -d e v0. The other law is a damped spring."""
    _, dissipation = impact_constants("hunt_crossley", 0.5, 0.005)
    approach = dissipation - np.log1p(dissipation)
    departure = -0.5 * dissipation - np.log1p(-0.5 * dissipation)
    assert approach == pytest.approx(departure, rel=0.02)
    _, steps = impact_constants("relaxation", 0.577, 0.005)
    ratio = 0.5 * 0.005 * steps
    root = np.sqrt(1.0 - ratio**2)
    end_rad = np.arctan2(2.0 * ratio * root, 2.0 * ratio**2 - 1.0)
    assert np.exp(-ratio / root * end_rad) == pytest.approx(0.577, abs=0.005)
    without = impact_constants("hunt_crossley", 0.0, 0.1)
    assert rebound("hunt_crossley", *without).max() < 1e-5


def test_linear_dissipation_has_the_restitution_at_any_speed_and_hunt_crossley_at_one():
    linear = [impact("sap", 0.577, PHASES[6], speed) for speed in (0.1, 4.0)]
    assert np.ptp(linear) < 1e-6
    # Three tenths of the speed have three tenths of the dissipation.
    slow = impact("lagged", 0.577, PHASES[6], 0.6, impact_speed=2.0)
    _, dissipation = impact_constants("hunt_crossley", 0.577, 0.1)
    expected = rebound("hunt_crossley", 0.1, 0.3 * dissipation)[6]
    assert slow == pytest.approx(expected, abs=1e-6)
    assert slow > 0.7


def test_a_box_that_lands_flat_rebounds():
    box = solid("box", Box(size_m=(0.1, 0.05, 0.02)), (0.0, 0.0, 0.21))
    touch = contact("box", "ground", friction=0.3, restitution=0.5)
    scene = scene_of(GROUND, box, contacts=(touch,))
    heights_m = (
        states(DRAKE, scene, ["box"], 70 / 180, preset="default")[1:, 0, 2] - 0.01
    )
    landed = int(np.argmax(np.diff(heights_m) > 0.0))
    ratio = np.sqrt(heights_m[landed:].max() / 0.2)
    assert ratio == pytest.approx(0.5, rel=0.015)


def test_the_impact_speed_comes_from_the_scene():
    start = {"ball.position_m": (0.0, 0.0, 0.33)}
    scene = load_experiment("BouncingBall-rubber", start).scene
    (ball,) = scene.dynamic_bodies
    fall_m = 0.33 - ball.shape.radius_m - scene.floor_height_m
    assert impact_speed_m_per_s(scene) == pytest.approx(np.sqrt(2.0 * G * fall_m))
    thrown = {"ball.velocity_m_per_s": (3.0, 0.0, 0.0)}
    faster = load_experiment("BouncingBall-rubber", start | thrown).scene
    expected = np.sqrt(9.0 + 2.0 * G * fall_m)
    assert impact_speed_m_per_s(faster) == pytest.approx(expected)


# --- friction and driven bodies --------------------------------------------------------------------------------------


@pytest.mark.parametrize("approximation", ["lagged", "sap", "similar"])
def test_convex_approximations_lift_a_sliding_box(approximation):
    """They let a sliding touch open with friction times the sliding speed, which throws the box up."""
    convex = {"contact_model": "point", "sustained_rate": 2.0}
    settings = {} if approximation == "lagged" else convex
    given = {"approximation": approximation, "timestep_s": 1 / 1800} | settings
    ratio, rise_m = slide(DRAKE, 0.4, **given)
    speed = FRICTION * SLIDE_M_PER_S2 * 0.4
    thrown_m = speed**2 / (2.0 * G * np.cos(np.pi / 6))
    if approximation == "lagged":
        assert ratio == pytest.approx(1.0, abs=1e-4)
        assert rise_m < 1e-6
    else:
        assert 0.5 * thrown_m < rise_m < 1.3 * thrown_m
        assert ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("settings", "low", "high"),
    [
        ({}, 0.995, 1.005),
        ({"surface": "polygon"}, 0.0, 0.8),
        ({"sustained_rate": 4.0}, -0.5, 0.5),
    ],
)
def test_lagged_contacts_that_are_too_stiff_or_have_few_points_stick(
    settings, low, high
):
    """Acceleration of the prism of SlopeContact-wood over Coulomb's on a slope of the base."""
    scene = load_experiment("SlopeContact-wood").scene
    (prism,) = scene.dynamic_bodies
    places_m = states(DRAKE, scene, [prism.name], 25 / 180, **settings)[5:, 0, :3]
    travelled_m = np.linalg.norm(places_m - places_m[0], axis=1)
    acceleration = 2.0 * np.polyfit(np.arange(21) / 180, travelled_m, 2)[0]
    # Faces of the base lean like the faces of a cube on its corner.
    slope_rad = np.arctan(np.sqrt(2.0))
    friction = scene.contacts[0].friction
    law = G * (np.sin(slope_rad) - friction * np.cos(slope_rad))
    assert low < acceleration / law < high


def test_a_driven_plate_of_huge_mass_carries_nothing():
    """The solver stops at an error relative to the momentum of all bodies, which is far above the cube's momentum."""
    flat = Box(size_m=(0.5, 0.3, 0.02))
    plate = solid("plate", flat, (0.0, 0.0, 0.5), motion=Motion.KINEMATIC)
    cube = solid("cube", Box(size_m=(0.05, 0.05, 0.05)), (0.0, 0.0, 0.535))
    touch = contact("cube", "plate", friction=0.4)
    settings = {"driven_mass_ratio": 1e9, "timestep_s": 1 / 9000}
    simulation = DRAKE.build(scene_of(plate, cube, contacts=(touch,)), settings)
    change = np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for time_s in np.arange(36) / 180:
        pose = Pose(position_m=(float(time_s**2), 0.0, 0.5))
        simulation.drive("plate", target(pose, time_s * change, change))
        simulation.advance(1 / 180)
    ((plate_m, cube_m),) = simulation.body_states(["plate", "cube"])[:, :, 0]
    assert plate_m == pytest.approx(0.04, abs=1e-9)
    assert cube_m - plate_m < -0.02


# --- shapes, presets and versions ------------------------------------------------------------------------------------


@pytest.mark.skipif(HAS_TAMSI, reason="this Drake has TAMSI")
def test_an_approximation_that_drake_lacks_is_an_error():
    with pytest.raises(ParameterError, match="sap, similar, lagged"):
        DRAKE.build(load_experiment("SlopeSlider-2-wood").scene, {"preset": "tamsi"})
