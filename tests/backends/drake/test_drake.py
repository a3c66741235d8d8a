"""The Drake backend against closed forms, and the choices of its presets."""

from dataclasses import replace

import numpy as np
import pytest
from rigid import FRICTION, SLIDE_M_PER_S2, plane_deg, scene_of, slide, solid, states
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment
from gauge_envs.errors import ParameterError
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Box,
    ConvexUnion,
    Cylinder,
    Motion,
    Scene,
    Sphere,
)

pytest.importorskip("pydrake")

from pydrake.multibody.plant import DiscreteContactApproximation

from gauge_envs.backends import backend
from gauge_envs.backends.drake.contacts import PHASES, impact_constants, rebound
from gauge_envs.backends.drake.model import inner_radius_m
from gauge_envs.backends.drake.settings import (
    impact_speed_m_per_s,
    settings_for,
)
from gauge_envs.scene.meshes import hull_faces
from gauge_envs.tools.bench.parts import contact

DRAKE = backend("drake")
APPROXIMATIONS = [
    name
    for name in ("tamsi", "sap", "similar", "lagged")
    if hasattr(DiscreteContactApproximation, f"k{name.title()}")
]
"""Approximations that the installed Drake has; 1.58 has no TAMSI."""
G = GRAVITY_M_PER_S2


GROUND = plane_deg()


# --- impacts ---------------------------------------------------------------------------------------------------------


def rebounded(restitution, speed, gap_m, settings, *, mass_kg=0.1, gravity_m_per_s2=G):
    """Speed of a ball, as it was at the ground, over that at which it came; 0 if it stays; and its simulation."""
    ball = solid(
        "ball",
        Sphere(radius_m=0.03),
        (0.0, 0.0, 0.03 + gap_m),
        linear_velocity_m_per_s=(0.0, 0.0, -speed),
        mass_kg=mass_kg,
    )
    touch = contact("ball", "ground", friction=0.5, restitution=restitution)
    scene = Scene(
        bodies=(GROUND, ball),
        contacts=(touch,),
        duration_s=0.1,
        gravity_m_per_s2=gravity_m_per_s2,
    )
    simulation = DRAKE.build(scene, settings)
    for _ in range(36):
        simulation.advance(1 / 180)
        height, outgoing = simulation.body_states(["ball"])[0, 0, [2, 9]]
        if outgoing > 0.0 and height > 0.03:
            fallen = 2.0 * gravity_m_per_s2 * (height - 0.03)
            return float(np.sqrt(outgoing**2 + fallen)) / speed, simulation
    return 0.0, simulation


def impact(approximation, restitution, phase, speed, **settings):
    """Rebound of a ball without gravity, whose first step in touch has a depth of `phase` times its step."""
    step_s = 1 / 9000
    given = {
        "approximation": approximation,
        "contact_model": "point",
        "timestep_s": step_s,
        "impact_rate": 0.1,
    }
    gap_m = (2.0 - phase) * step_s * speed
    return rebounded(restitution, speed, gap_m, given | settings, gravity_m_per_s2=0.0)[
        0
    ]


@pytest.mark.parametrize("approximation", APPROXIMATIONS)
@pytest.mark.parametrize("restitution", [0.2, 0.577, 0.95])
def test_the_scheme_of_an_impact_is_drakes(approximation, restitution):
    law = "relaxation" if approximation == "sap" else "hunt_crossley"
    expected = rebound(law, *impact_constants(law, restitution, 0.1))
    for index in (0, 7):
        measured = impact(
            approximation, restitution, PHASES[index], 1.0, impact_speed_m_per_s=1.0
        )
        assert measured == pytest.approx(expected[index], abs=1e-6)


@pytest.mark.parametrize("law", ["relaxation", "hunt_crossley"])
@pytest.mark.parametrize("restitution", [0.05, 0.3, 0.577, 0.75, 0.95])
def test_fitted_constants_have_the_restitution(law, restitution):
    ratios = rebound(law, *impact_constants(law, restitution, 0.03))
    assert ratios.mean() == pytest.approx(restitution, abs=1e-6)
    assert np.abs(ratios - restitution).max() < (
        0.0055 if law == "relaxation" else 0.0006
    )


def test_hunt_crossley_follows_its_closed_form_when_the_step_is_short():
    # Work of k x^n (1 + d v) over the impact: u - ln(1 + u) is the same for u = d v0 and u = -d e v0.
    _, dissipation = impact_constants("hunt_crossley", 0.5, 0.005)
    inside, outside = (
        dissipation - np.log1p(dissipation),
        -0.5 * dissipation - np.log1p(-0.5 * dissipation),
    )
    assert inside == pytest.approx(outside, rel=0.02)


def test_relaxation_follows_its_closed_form_when_the_step_is_short():
    _, steps = impact_constants("relaxation", 0.577, 0.002)
    ratio = 0.5 * 0.002 * steps
    ending = np.arctan2(2.0 * ratio * np.sqrt(1.0 - ratio**2), 2.0 * ratio**2 - 1.0)
    assert np.exp(-ratio / np.sqrt(1.0 - ratio**2) * ending) == pytest.approx(
        0.577, abs=0.002
    )


def test_linear_dissipation_has_the_restitution_at_any_speed_and_hunt_crossley_at_one():
    linear = [impact("sap", 0.577, PHASES[6], speed) for speed in (0.1, 1.0, 4.0)]
    assert np.ptp(linear) < 1e-6
    # Three tenths of the speed have a third of the dissipation.
    slow = impact("lagged", 0.577, PHASES[6], 0.6, impact_speed_m_per_s=2.0)
    _, dissipation = impact_constants("hunt_crossley", 0.577, 0.1)
    assert slow == pytest.approx(
        rebound("hunt_crossley", 0.1, 0.3 * dissipation)[6], abs=1e-6
    )
    assert slow > 0.7


@pytest.mark.parametrize(
    ("speed", "mass_kg", "expected"),
    [
        (2.8, 0.001, 0.577),
        (2.8, 10.0, 0.577),
        (6.0, 0.1, 0.5775),
        (1.0, 0.1, 0.5754),
        (0.3, 0.1, 0.5692),
    ],
)
def test_the_page_has_the_restitution_of_impacts_of_other_speeds(
    speed, mass_kg, expected
):
    settings = {"impact_speed_m_per_s": 2.8}
    ratio, simulation = rebounded(
        0.577, speed, 1.5 / 72000 * speed, settings, mass_kg=mass_kg
    )
    assert simulation.settings["preset"] == "impact"
    assert ratio == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("preset", ["default", "point"])
@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.8])
def test_a_box_that_lands_flat_rebounds(preset, restitution):
    box = solid("box", Box(size_m=(0.1, 0.05, 0.02)), (0.0, 0.0, 0.21))
    touch = contact("box", "ground", friction=0.3, restitution=restitution)
    scene = scene_of(GROUND, box, contacts=(touch,))
    found = states(DRAKE, scene, ["box"], 70 / 180, preset=preset)
    heights = found[1:, 0, 2] - 0.01
    landed = int(np.argmax(np.diff(heights) > 0.0))
    assert np.sqrt(max(heights[landed:]) / 0.2) == pytest.approx(restitution, rel=0.015)


def test_gravity_during_the_contact_is_made_up_for():
    weight = G / 72000 / 2.8
    fitted = impact_constants("relaxation", 0.2, 0.03, weight)
    assert rebound("relaxation", *fitted, weight).mean() == pytest.approx(0.2, abs=1e-6)
    assert (
        rebound("relaxation", *impact_constants("relaxation", 0.2, 0.03), weight).mean()
        < 0.198
    )


def test_perfect_restitution_and_none():
    assert rebound(
        "relaxation", *impact_constants("relaxation", 1.0, 0.03)
    ).mean() == pytest.approx(0.999, abs=1e-4)
    assert (
        rebound("hunt_crossley", *impact_constants("hunt_crossley", 0.0, 0.1)).max()
        < 1e-5
    )


# --- friction --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "approximation", [name for name in APPROXIMATIONS if name in ("tamsi", "lagged")]
)
def test_tamsi_and_lagged_slide_by_coulombs_law(approximation):
    ratio, rise_m = slide(DRAKE, 0.4, approximation=approximation, timestep_s=1 / 1800)
    assert ratio == pytest.approx(1.0, abs=1e-4)
    assert rise_m < 1e-6


@pytest.mark.parametrize("approximation", ["sap", "similar"])
def test_convex_approximations_lift_a_sliding_box(approximation):
    # They let a sliding touch open with friction times the sliding speed, which throws the box up.
    ratio, rise_m = slide(
        DRAKE,
        0.4,
        approximation=approximation,
        timestep_s=1 / 1800,
        contact_model="point",
        sustained_rate=2.0,
    )
    speed = FRICTION * SLIDE_M_PER_S2 * 0.4
    thrown_m = speed**2 / (2.0 * G * np.cos(np.pi / 6))
    assert 0.5 * thrown_m < rise_m < 1.3 * thrown_m
    assert ratio == pytest.approx(1.0, abs=0.02)


def slide_of_prism(**settings):
    """Acceleration of the prism of SlopeContact-wood on its slope in 24/180 s [m/s^2]."""
    scene = load_experiment("SlopeContact-wood").scene
    (prism,) = scene.dynamic_bodies
    found = states(DRAKE, scene, [prism.name], 25 / 180, **settings)
    places = found[5:, 0, :3]
    travelled = np.linalg.norm(places - places[0], axis=1)
    return float(2.0 * np.polyfit(np.arange(21) / 180, travelled, 2)[0])


def test_lagged_contacts_that_are_too_stiff_or_have_few_points_stick():
    base = load_experiment("SlopeContact-wood").scene
    friction = base.contacts[0].friction
    directions = [
        np.cross(*np.diff(face, axis=0)[:2]) for face in _faces(base.body("base").shape)
    ]
    steepest = [abs(d[2]) / np.linalg.norm(d) for d in directions]
    cosine = min((c for c in steepest if 0.1 < c < 0.95), default=0.0)
    law = G * (np.sqrt(1.0 - cosine**2) - friction * cosine)
    assert slide_of_prism() == pytest.approx(law, rel=0.005)
    assert slide_of_prism(surface="polygon") < 0.8 * law
    assert slide_of_prism(sustained_rate=4.0) < 0.5 * law


def _faces(shape):
    points = [np.asarray(piece) for piece in shape.pieces_m]
    return [piece[list(face)] for piece in points for face in hull_faces(piece)]


# --- driven bodies ---------------------------------------------------------------------------------------------------


def carried(**settings):
    """Displacement of a cube on a plate that accelerates with 2 m/s^2 for 0.25 s [m]."""
    plate = solid(
        "plate", Box(size_m=(0.5, 0.3, 0.02)), (0.0, 0.0, 0.5), motion=Motion.KINEMATIC
    )
    cube = solid("cube", Box(size_m=(0.05, 0.05, 0.05)), (0.0, 0.0, 0.535))
    touch = contact("cube", "plate", friction=0.4)
    scene = Scene(bodies=(plate, cube), contacts=(touch,), duration_s=1.0)
    simulation = DRAKE.build(scene, settings)
    targets = np.zeros((1, 19))
    targets[0, 2:4] = 0.5, 1.0
    targets[0, 13] = 2.0
    for number in range(45):
        start_s = number / 180
        targets[0, [0, 7]] = start_s**2, 2.0 * start_s
        simulation.drive("plate", targets)
        simulation.advance(1 / 180)
    ((plate, cube),) = simulation.body_states(["plate", "cube"])
    assert plate[0] == pytest.approx(0.0625, abs=1e-9)
    return float(cube[0] - plate[0])


def test_a_driven_plate_of_huge_mass_carries_nothing():
    # Drake's solver stops at an error relative to the momentum of all bodies, beside which the cube's is none.
    assert carried(driven_mass_ratio=1e9, timestep_s=1 / 9000) < -0.03


# --- settings and support --------------------------------------------------------------------------------------------


def test_a_cylinder_gets_the_preset_of_what_rolls():
    cylinder = solid("can", Cylinder(radius_m=0.03, length_m=0.1), (0.0, 0.0, 0.05))
    touch = contact("can", "ground", friction=0.5)
    assert (
        settings_for(
            Scene(bodies=(GROUND, cylinder), contacts=(touch,), duration_s=1.0)
        ).preset
        == "rolling"
    )


def sinking_corner_mm(preset):
    """Return how deep a cube of 105 mm sinks in that strikes on one corner, without friction."""
    start = {
        "cube.position_m": (0.0, 0.0, 0.2),
        "cube.euler_deg": (35.0, 25.0, 0.0),
        "cube.friction": 0.0,
    }
    scene = load_experiment(
        "CubeToss-acrylic", {"cube.restitution": 0.5, **start}
    ).scene
    simulation = DRAKE.build(scene, {"preset": preset})
    corners, lowest_m = scene.body("cube").shape.corners_m, 0.0
    for _ in range(108):
        simulation.advance(1 / 540)
        state = simulation.body_states(("cube",))[0, 0]
        turned = Rotation.from_quat(state[3:7], scalar_first=True).apply(corners)
        lowest_m = min(lowest_m, float(turned[:, 2].min() + state[2]))
    return -1e3 * lowest_m


def test_a_hydroelastic_corner_sinks_in_as_its_cubic_force_says():
    """The force of a corner is c d^3: pressure in proportion to the depth below the nearest face, on a triangle.

    Integrated over the triangle of this corner, c is 0.607 times modulus over half width. Dissipation makes the depth
    smaller than that of energy alone.
    """
    mass_kg, inertia, half_m, speed = (
        0.37,
        8.1e-4,
        0.0524,
        np.sqrt(2.0 * GRAVITY_M_PER_S2 * (0.2 - 0.0883)),
    )
    arm = np.array([0.0166, -0.0129])  # The corner beside the centre, horizontally.
    reduced_kg = 1.0 / (1.0 / mass_kg + float(arm @ arm) / inertia)
    face_n_per_m = mass_kg * (0.1 * 3600.0) ** 2
    cubic = 0.607 * face_n_per_m / (2.0 * half_m) ** 2
    deepest_mm = 1e3 * (2.0 * reduced_kg * speed**2 / cubic) ** 0.25
    assert 0.8 * deepest_mm < sinking_corner_mm("default") < deepest_mm
    assert sinking_corner_mm("corners") < 0.06 * deepest_mm


def test_the_impact_speed_is_that_of_the_scene():
    scene = load_experiment("BouncingBall-rubber").scene
    (ball,) = scene.dynamic_bodies
    fall_m = ball.pose.position_m[2] - ball.shape.radius_m - scene.floor_height_m
    assert impact_speed_m_per_s(scene) == pytest.approx(np.sqrt(2.0 * G * fall_m))
    thrown = replace(ball, linear_velocity_m_per_s=(3.0, 0.0, 0.0))
    faster = replace(
        scene, bodies=tuple(thrown if body is ball else body for body in scene.bodies)
    )
    assert impact_speed_m_per_s(faster) == pytest.approx(
        np.sqrt(9.0 + 2.0 * G * fall_m)
    )


@pytest.mark.skipif("tamsi" in APPROXIMATIONS, reason="this Drake has TAMSI")
def test_an_approximation_that_drake_has_dropped_is_an_error():
    with pytest.raises(ParameterError, match="sap, similar, lagged"):
        DRAKE.build(load_experiment("SlopeSlider-2-wood").scene, {"preset": "tamsi"})


def test_the_inner_radius_of_a_solid():
    box = Box(size_m=(0.1, 0.04, 0.06))
    union = ConvexUnion(pieces_m=(tuple(map(tuple, box.corners_m.tolist())),))
    assert inner_radius_m(box) == pytest.approx(0.02)
    assert inner_radius_m(union) == pytest.approx(0.02)
    assert inner_radius_m(Cylinder(radius_m=0.03, length_m=0.1)) == pytest.approx(0.03)
