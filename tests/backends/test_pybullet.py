"""Traps of Bullet: products of the values of bodies, the friction cone, driven bodies, springs, foam and ropes.

Expected values follow from Coulomb's law, springs, pendulums and free fall.
"""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from rigid import plane_deg, scene_of, solid, states, target

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.pybullet.contacts import (
    moved_values,
)
from gauge_envs.backends.pybullet.settings import settings_for
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.fixtures.parts import ball, contact, driven_box, fixed_box
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Attachment,
    Box,
    Pose,
    Region,
    Rope,
    SoftBody,
)
from gauge_envs.scene.geometry import vector

pytest.importorskip("pybullet")

from gauge_envs.backends.pybullet.deformables import SOFT_MARGIN_M
from gauge_envs.backends.pybullet.model import ModelPyBullet

ENGINE = backend("pybullet")
G = GRAVITY_M_PER_S2


# --- contact constants of pairs --------------------------------------------------------------------------------------


def test_products_of_bodies_are_the_values_of_pairs():
    pairs = {("a", "b"): 0.3, ("b", "c"): 0.1, ("c", "d"): 0.8, ("a", "d"): 2.4}
    values = moved_values(pairs, set(), "friction")
    products = {pair: values[pair[0]] * values[pair[1]] for pair in pairs}
    assert products == pytest.approx(pairs, rel=1e-9)
    with pytest.raises(UnsupportedSceneError, match="'a' and 'b' has the friction 0"):
        moved_values(pairs | {("a", "d"): 0.5}, set(), "friction")


def test_a_pair_of_value_zero_has_a_millionth_if_its_bodies_have_other_pairs():
    pairs = {("ball", "one"): 0.22, ("ball", "two"): 0.22, ("one", "two"): 0.0}
    values = moved_values(pairs, set(), "restitution")
    assert values["ball"] * values["one"] == pytest.approx(0.22, rel=1e-9)
    assert values["one"] * values["two"] <= 1.000001e-6
    pairs = {("cube", "brick"): 0.0, ("cube", "ground"): 0.25}
    assert moved_values(pairs, {"ground"}, "restitution") == {"brick": 0.0, "cube": 1.0}


def test_the_step_of_foam_is_below_the_time_of_a_wave_through_a_tetrahedron():
    scene = load_experiment("FoamStretching-soft").scene
    # A pressure wave of 87 m/s takes 136 us through 16.7 mm / sqrt(2).
    assert settings_for(scene).timestep_s == 1 / 18000
    assert settings_for(scene, {"cell_m": 0.0334}).timestep_s == 1 / 9000
    assert settings_for(scene, {"timestep_s": 1 / 1800}).timestep_s == 1 / 1800


# --- rigid bodies ----------------------------------------------------------------------------------------------------


def test_a_correction_of_penetrations_by_velocity_would_add_to_a_rebound():
    touch = contact("ball", "plate", friction=0.5, restitution=0.5)
    plate = fixed_box("plate", (0.0, 0.0, -0.01), (0.5, 0.5, 0.02))
    scene = scene_of(ball("ball", (0.0, 0.0, 0.43)), plate, contacts=(touch,))
    ratios = []
    for settings in ({}, {"split_impulse": "none"}):
        rows = states(ENGINE, scene, ["ball"], 2 / 3, **settings)[:, 0]
        heights_m, speeds = rows[:, 2] - 0.03, rows[:, 9]
        first = np.argmax((speeds > 0.1) & (heights_m > 1e-3))
        energy = speeds[first] ** 2 + 2.0 * G * heights_m[first]
        ratios.append(np.sqrt(energy / (2.0 * G * 0.4)))
    assert ratios[0] == pytest.approx(0.5, abs=0.005)
    assert ratios[1] > 0.55


@pytest.mark.parametrize(("acceleration", "aside"), [(5.0, -0.15), (60.0, -1.2)])
def test_a_cube_that_a_bar_pushes_and_slips_along_stays_on_the_edge_of_the_friction_cone(
    acceleration, aside
):
    """While the bar slips, m (a, -mu a) is the bar's force less friction along the velocity (1, -mu)."""
    friction, step_s = 0.3, 1 / 180
    scene = scene_of(
        solid("cube", Box(size_m=(0.05, 0.05, 0.05)), (0.0, 0.0, 0.025)),
        fixed_box("board", (0.0, 0.0, -0.01), (2.0, 2.0, 0.02)),
        driven_box("bar", (-0.035, 0.0, 0.025), (0.02, 0.12, 0.03)),
        contacts=(contact("cube", ("board", "bar"), friction=friction),),
    )
    place_m = np.array(scene.body("bar").pose.position_m)
    velocity = np.array([0.0, aside, 0.0, 0.0, 0.0, 0.0])
    change = np.array([acceleration, 0.0, 0.0, 0.0, 0.0, 0.0])
    with closing(ENGINE.build(scene)) as simulation:
        for _ in range(9):
            pose = Pose(position_m=vector(place_m))
            simulation.drive("bar", target(pose, velocity, change))
            simulation.advance(step_s)
            place_m += (velocity + 0.5 * change * step_s)[:3] * step_s
            velocity = velocity + change * step_s
        speed = simulation.body_states(["cube"])[0, 0, 7:9]
    assert speed[0] == pytest.approx(velocity[0], rel=0.002)
    assert speed[1] / speed[0] == pytest.approx(-friction, rel=0.005)


def test_springs_of_contacts_carry_and_throw_back_a_cube():
    """Four corners on springs: depth at rest m g / 4 k, and depth v sqrt(m / 4 k) of a fast impact.

    Bullet integrates the spring implicitly, which damps it by the ratio w h / 2. Gravity adds the depth at rest.
    """
    stiffness_n_per_m, mass_kg, half_m = 1e4, 0.37, 0.0524

    def lowest_m(start_m, damping, seconds):
        start = {
            "cube.euler_deg": (0.0, 0.0, 0.0),
            "cube.restitution": 0.0,
            "cube.position_m": (0.0, 0.0, start_m),
        }
        settings = {
            "split_impulse": "none",
            "contact_stiffness_n_per_m": stiffness_n_per_m,
            "contact_damping_n_s_per_m": damping,
            "drive_interval_s": 1 / 900,
        }
        scene = load_experiment("CubeToss-acrylic", start).scene
        rows = states(ENGINE, scene, ["cube"], seconds, interval_s=1 / 900, **settings)
        return half_m - rows[:, 0, 2]

    at_rest_m = lowest_m(half_m, 30.0, 0.3)[-1]
    assert at_rest_m == pytest.approx(mass_kg * G / (4.0 * stiffness_n_per_m), rel=0.01)
    deepest_m = lowest_m(half_m + 0.05, 1e-6, 0.15).max()
    rate_per_s = np.sqrt(4.0 * stiffness_n_per_m / mass_kg)
    damped = np.exp(-0.25 * np.pi * rate_per_s / 9000.0)
    impact_m = np.sqrt(2.0 * G * 0.05) / rate_per_s * damped
    assert deepest_m == pytest.approx(impact_m + at_rest_m, rel=0.01)


def test_a_body_beyond_the_plane_ends_the_episode():
    runner = replace(
        ball("ball", (7.5, 0.0, 0.03)), linear_velocity_m_per_s=(3.0, 0.0, 0.0)
    )
    touch = contact("ball", "ground", friction=0.5)
    scene = scene_of(plane_deg(), runner, contacts=(touch,))
    with closing(ENGINE.build(scene)) as simulation:
        assert simulation.diverged() == {}
        simulation.advance(0.5)
        assert "ends at 8 m" in simulation.diverged()[0]


# --- foam and ropes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_foam_slides_by_the_law_one_margin_above_the_board(friction):
    middle_m, lean = 0.05 + 0.02 + SOFT_MARGIN_M, (0.0, 30.0, 0.0)
    slope = Pose.from_euler_deg((0.0, 0.0, 0.0), lean).rotation
    foam = SoftBody(
        name="foam",
        shape=Box(size_m=(0.04, 0.04, 0.04)),
        pose=Pose.from_rotation(vector(slope.apply([0.0, 0.0, middle_m])), slope),
        mass_kg=0.0064,
        young_modulus_pa=1e4,
        poisson_ratio=0.3,
    )
    scene = scene_of(
        fixed_box("board", (0.0, 0.0, 0.0), (2.0, 0.5, 0.1), euler_deg=lean),
        deformables=(foam,),
        contacts=(contact("foam", "board", friction=friction),),
    )
    places_m = []
    with closing(ENGINE.build(scene)) as simulation:
        for _ in range(60):
            simulation.advance(1 / 180)
            places_m.append(simulation.nodes("foam")[0].mean(axis=0))
    down_m, _, up_m = slope.apply(places_m, inverse=True).T
    acceleration = 2.0 * np.polyfit(np.arange(40) / 180, down_m[20:], 2)[0]
    assert acceleration == pytest.approx(G * (0.5 - friction * np.sqrt(0.75)), rel=1e-3)
    assert up_m[-1] == pytest.approx(middle_m, abs=1e-4)


def test_a_bob_on_a_light_rope_is_a_pendulum():
    """The bob's centre is at the rope's length plus its radius from the fixed end; the rope starts at 5 degrees."""
    pose = Pose.from_euler_deg((0.0, 0.0, 1.0), (0.0, 85.0, 0.0))
    rope = Rope(
        name="rope",
        pose=pose,
        length_m=0.3,
        radius_m=0.002,
        mass_kg=0.01,
        young_modulus_pa=1e6,
    )
    place_m = vector(pose.to_world(np.array([0.17, 0.0, 0.0])))
    scene = scene_of(
        ball("bob", place_m, radius_m=0.02, mass_kg=10.0),
        fixed_box("frame", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1)),
        deformables=(rope,),
        attachments=tuple(
            Attachment(deformable="rope", region=Region(axis="x", side=side), to=to)
            for side, to in (("low", "frame"), ("high", "bob"))
        ),
    )
    aside_m = states(ENGINE, scene, ["bob"], 1.5)[:, 0, 0]
    aside_m -= pose.to_world(np.array([-0.15, 0.0, 0.0]))[0]
    assert aside_m[0] == pytest.approx(0.32 * np.sin(np.radians(5.0)), rel=0.01)
    crossings = np.flatnonzero(np.diff(np.sign(aside_m)))
    half_period_s = np.pi * np.sqrt(0.32 / G)
    assert np.diff(crossings).mean() / 180 == pytest.approx(half_period_s, rel=0.01)


# --- settings --------------------------------------------------------------------------------------------------------


def test_out_of_box_has_bullets_defaults(monkeypatch):
    """The values of the preset are PyBullet's: a world to which they are not given moves as one to which they are."""
    scene = load_experiment("NonsmoothContact-1-wood").scene

    def without_parameters(model):
        model.client.setGravity(0.0, 0.0, -scene.gravity_m_per_s2)
        model.client.setPhysicsEngineParameter(
            fixedTimeStep=1 / 180, deterministicOverlappingPairs=1, enableFileCaching=0
        )

    def rollout(**changes):
        settings = {"preset": "out_of_box", "reduced_coordinates": False, **changes}
        return states(ENGINE, scene, ["pyramid"], 1 / 3, **settings)

    given = rollout()
    assert rollout(warm_starting=0.85) != pytest.approx(given, abs=1e-9)
    monkeypatch.setattr(ModelPyBullet, "_set_parameters", without_parameters)
    assert rollout() == pytest.approx(given, abs=1e-9)
