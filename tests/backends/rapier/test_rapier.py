"""The Rapier backend against closed forms, and the choices of its default preset."""

import multiprocessing
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from rigid import plane_deg, scene_of, solid, states

from gauge_envs import load_experiment
from gauge_envs.scene import (
    GRAVITY_M_PER_S2,
    Cylinder,
    Hinge,
    Pose,
)

pytest.importorskip("rapier3d")

from gauge_envs.backends import backend
from gauge_envs.backends.rapier.contacts import LARGEST_CONTACT_COUNT, collider_layers
from gauge_envs.tools.bench.parts import ball, box, contact, fixed_box
from gauge_envs.tools.conformance import run_checks

RAPIER = backend("rapier")
G = GRAVITY_M_PER_S2

GROUND = plane_deg()


def course(scene, name, seconds, *, timestep_s=1 / 1800, **settings):
    """Times, shape [n], and states of a body, shape [n, 13], from the start on, at each step."""
    settings |= {"timestep_s": timestep_s, "drive_interval_s": timestep_s}
    rows = states(RAPIER, scene, [name], seconds, interval_s=timestep_s, **settings)
    return timestep_s * np.arange(len(rows)), rows[:, 0]


def measured(check, **settings):
    """Return the result of a conformance check with settings."""
    (result,) = run_checks("rapier", only=[check], settings=settings)
    return result


# --- conformance ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "check"),
    [
        ({"contact_recycling": True}, "rest-heights"),
        ({"contact_recycling": True}, "carry-turn"),
        ({"friction_model": "coulomb"}, "slide"),
        ({"sleep": True}, "glide-speed"),
        ({"hinge_damping_n_m_s": 0.1}, "pendulum-energy"),
        (
            {
                "timestep_s": 1 / 180,
                "contact_frequency_hz": 30.0,
                "static_contact_frequency_hz": 10.0,
            },
            "rest-heights",
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else value,
)
def test_each_choice_of_the_default_preset_is_needed(settings, check):
    assert measured(check, **settings).is_bad


# --- friction and restitution -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_hz", "iterations"), [(180, 1), (180, 4), (1800, 2), (3600, 1)]
)
def test_a_slide_has_coulombs_acceleration_at_every_step(rate_hz, iterations):
    found = measured("slide", timestep_s=1 / rate_hz, solver_iterations=iterations)
    assert found.measured == pytest.approx(found.expected, rel=1e-3)


def test_the_coulomb_model_loses_friction_by_the_angle_between_impulse_and_slip():
    # The impulse of a corner is along K^-1 v. For a cube K is [[4, 1.5], [1.5, 4]] / m, and the lateral parts cancel.
    share = 4.0 / np.hypot(4.0, 1.5)
    found = measured("slide", friction_model="coulomb")
    assert found.measured == pytest.approx(share, rel=2e-3)


def dropped(restitution):
    touch = contact("ball", "ground", friction=0.3, restitution=restitution)
    one = ball("ball", (0.0, 0.0, 0.52), radius_m=0.02)
    return scene_of(one, GROUND, contacts=(touch,))


@pytest.mark.parametrize(
    ("restitution", "rate_hz"), list(product((0.2, 0.576733, 0.9), (180, 900, 1800)))
)
def test_the_speed_of_a_rebound_is_exact_at_every_step(restitution, rate_hz):
    _, rows = course(dropped(restitution), "ball", 0.4, timestep_s=1 / rate_hz)
    speed = rows[:, 9]
    hit = int(np.argmax(speed > 0.0))
    assert speed[hit] == pytest.approx(-restitution * speed[hit - 1], rel=1e-4)


# --- errors of the engine that the page states ------------------------------------------------------------------------


def test_a_flat_impact_spins_a_box():
    brick = box("ball", (0.0, 0.0, 0.22), (0.1, 0.06, 0.04))
    _, rows = course(replace(dropped(0.5), bodies=(brick, GROUND)), "ball", 0.35)
    hit = int(np.argmax(rows[:, 9] > 0.0))
    assert np.linalg.norm(rows[hit + 5, 10:]) == pytest.approx(6.9, abs=0.3)
    rebound = np.sqrt((rows[hit:, 2].max() - 0.02) / 0.2)
    assert rebound == pytest.approx(0.35, abs=0.01)


def test_a_cylinder_rolls_too_fast_on_a_box_and_right_on_a_plane():
    slope_deg, radius_m = 3.6, 0.03
    sine, cosine = np.sin(np.radians(slope_deg)), np.cos(np.radians(slope_deg))
    start = (radius_m * sine, 0.0, radius_m * cosine)
    roller = solid(
        "roller",
        Cylinder(radius_m=radius_m, length_m=0.06),
        pose=Pose.from_euler_deg(start, (90.0, 0.0, 0.0)),
    )
    below, lean = (-0.05 * sine, 0.0, -0.05 * cosine), (0.0, slope_deg, 0.0)
    slab = fixed_box("ground", below, (3.0, 1.0, 0.1), euler_deg=lean)
    ratios = []
    for support in (plane_deg(slope_deg), slab):
        touch = contact("roller", "ground", friction=0.5)
        times, rows = course(
            scene_of(roller, support, contacts=(touch,)), "roller", 0.8
        )
        late, down = times > 0.1, rows[:, :3] @ [cosine, 0.0, -sine]
        found = 2.0 * np.polyfit(times[late], down[late], 2)[0]
        ratios.append(found / (2.0 / 3.0 * G * sine))
    assert ratios == pytest.approx([1.0, 1.2], abs=0.02)


# --- pairs ------------------------------------------------------------------------------------------------------------


def test_bodies_have_a_collider_for_each_contact_and_meet_only_its_other_side():
    names = ("a", "b", "c")
    sustained = replace(contact(("b", "c"), "ground", friction=0.7), restitution=0.5)
    contacts = (
        contact(("a", "b"), ("a", "b"), friction=0.1, restitution=0.5),
        sustained,
        contact("c", "a", friction=0.4, restitution=0.2),
    )
    bodies = (ball(name, (0.0, 0.0, 0.0)) for name in names)
    scene = scene_of(*bodies, GROUND, contacts=contacts)
    layers = collider_layers(scene)
    listed = {
        frozenset(pair): (one.friction, 0.0 if one is sustained else one.restitution)
        for one in contacts
        for pair in scene.colliding_pairs(one)
    }
    # Rapier ignores pairs of colliders of one body.
    for one, other in permutations([*names, "ground"], 2):
        met = [
            {(layer.friction, layer.restitution) for layer in (mine, theirs)}
            for mine in layers[one]
            for theirs in layers[other]
            if mine.memberships & theirs.filter and theirs.memberships & mine.filter
        ]
        expected = listed.get(frozenset((one, other)))
        assert met == ([] if expected is None else [{expected}])


def test_as_many_contacts_as_there_are_groups_work():
    """One more is refused; see the refusals."""
    places = [(0.1 * index, 0.0, 0.02) for index in range(LARGEST_CONTACT_COUNT + 1)]
    balls = [
        ball(f"ball-{index}", place, radius_m=0.02)
        for index, place in enumerate(places)
    ]
    contacts = tuple(
        contact(one.name, "ground", friction=0.01 * (index + 1))
        for index, one in enumerate(balls[:-1])
    )
    scene, names = (
        scene_of(*balls, GROUND, contacts=contacts),
        [one.name for one in balls],
    )
    heights = states(RAPIER, scene, names, 0.2)[-1, :, 2]
    assert heights[:-1] == pytest.approx(0.02, abs=1e-4)
    assert heights[-1] < -0.1


# --- joints -----------------------------------------------------------------------------------------------------------


def pendulum_energy_j_per_kg(seconds, **settings):
    """Kinetic and potential energy of a swing from 90 degrees, 0 at its start and 1.96 J/kg in its motion."""
    hinge = Hinge(body="bob", anchor_m=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    bob = ball("bob", (0.2, 0.0, 0.0), radius_m=0.02)
    _, rows = course(scene_of(bob, joints=(hinge,)), "bob", seconds, **settings)
    speeds, spins = (
        np.square(rows[:, a:b]).sum(axis=1) for a, b in ((7, 10), (10, 13))
    )
    return G * rows[:, 2] + 0.5 * speeds + 0.2 * 0.02**2 * spins


def test_impulse_hinges_lose_energy_in_the_stabilization():
    impulse = {"hinge_joint": "impulse", "timestep_s": 1 / 180, "solver_iterations": 4}
    assert pendulum_energy_j_per_kg(20.0, **impulse)[-1] == pytest.approx(
        -0.95, abs=0.05
    )
    assert (
        np.abs(
            pendulum_energy_j_per_kg(20.0, **impulse, stabilization_iterations=0)
        ).max()
        < 0.01
    )


# --- resets -----------------------------------------------------------------------------------------------------------


def test_a_body_whose_state_is_not_finite_has_diverged_until_a_reset():
    simulation = RAPIER.build(dropped(0.5))
    simulation.apply_wrench("ball", np.array([[np.nan, 0, 0, 0, 0, 0]]))
    simulation.advance(0.1)
    assert "'ball' is not finite" in simulation.diverged()[0]
    simulation.reset()
    assert simulation.diverged() == {}


# --- settings and installation ----------------------------------------------------------------------------------------


def test_every_setting_reaches_the_engine():
    """Each setting but the preset's name changes the engine's parameters, the bodies or the joints."""
    from gauge_envs.backends.rapier import model
    from gauge_envs.backends.rapier.settings import PRESETS

    changed = {
        "solver_iterations": 7,
        "pgs_iterations": 3,
        "stabilization_iterations": 5,
        "friction_model": "coulomb",
        "contact_frequency_hz": 55.0,
        "contact_damping_ratio": 4.0,
        "static_contact_frequency_hz": 66.0,
        "static_contact_damping_ratio": 3.0,
        "allowed_linear_error_m": 0.001,
        "max_corrective_velocity_m_per_s": 1.5,
        "prediction_distance_m": 0.011,
        "contact_clustering": False,
        "contact_recycling": True,
        "recycle_distance_m": 0.013,
        "warmstart_coefficient": 0.5,
        "warmstart_joints": True,
        "friction_in_bias_pass": True,
        "max_linear_velocity_m_per_s": 99.0,
    }
    scene = load_experiment("Turntable-1-wood").scene
    plain = PRESETS["default"]

    def held(settings):
        world, layout = model.build_world(scene, settings)
        body = world.rigid_bodies[layout["cube"].handle]
        return (
            world.integration_parameters.to_bytes(),
            body.ccd_enabled,
            body.activation.linear_threshold,
        )

    assert set(changed) <= set(type(plain).model_fields)
    for name, value in changed.items():
        assert held(plain.model_copy(update={name: value})) != held(plain), name
    for name in ("sleep", "ccd"):
        assert held(plain.model_copy(update={name: True}))[1:] != held(plain)[1:], name


def test_the_engine_has_the_threads_of_the_settings():
    simulation = RAPIER.build(dropped(0.5), {"threads": 2})
    simulation.reset()
    assert simulation._world.num_threads == 2


def _falls():
    simulation = RAPIER.build(dropped(0.5))
    simulation.reset()
    simulation.advance(0.1)


def test_a_forked_process_builds_and_steps_worlds_after_its_parent_did():
    """Planted: without the pool of its own the child waits for threads that a fork does not copy."""
    _falls()
    child = multiprocessing.get_context("fork").Process(target=_falls)
    child.start()
    child.join(timeout=20.0)
    ended = child.exitcode
    child.kill()
    assert ended == 0
