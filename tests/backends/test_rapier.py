"""Traps of Rapier: choices of the default preset, friction of the Coulomb model, errors on its page, forks.

Expected values follow from Coulomb's law, Newton's rule of impact, and the energy of a pendulum.
"""

import multiprocessing

import numpy as np
import pytest
from rigid import plane_deg, scene_of, solid, states

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.fixtures.parts import ball, box, contact, fixed_box
from gauge_envs.scene import GRAVITY_M_PER_S2, Cylinder, Hinge, Pose
from gauge_envs.tools.conformance import run_checks

pytest.importorskip("rapier3d")

from gauge_envs.backends.rapier import model
from gauge_envs.backends.rapier.settings import PRESETS

RAPIER = backend("rapier")
G = GRAVITY_M_PER_S2
GROUND = plane_deg()


def course(scene, name, seconds, *, timestep_s=1 / 1800, **settings):
    """Return times, shape [n], and states of a body, shape [n, 13], at the start and after each step."""
    settings |= {"timestep_s": timestep_s, "drive_interval_s": timestep_s}
    rows = states(RAPIER, scene, [name], seconds, interval_s=timestep_s, **settings)
    return timestep_s * np.arange(len(rows)), rows[:, 0]


def measured(check, **settings):
    """Return the result of a conformance check with settings."""
    (result,) = run_checks("rapier", only=[check], settings=settings)
    return result


SOFT = {"contact_frequency_hz": 30.0, "static_contact_frequency_hz": 10.0}


@pytest.mark.parametrize(
    ("settings", "check"),
    [
        ({"contact_recycling": True}, "carry-turn"),
        ({"sleep": True}, "glide-speed"),
        ({"hinge_damping_n_m_s": 0.1}, "pendulum-energy"),
        (SOFT | {"timestep_s": 1 / 180}, "rest-heights"),
    ],
)
def test_each_choice_of_the_default_preset_is_needed(settings, check):
    assert measured(check, **settings).is_bad


# --- friction and restitution ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate_hz", "iterations"), [(180, 4), (3600, 1)])
def test_a_slide_has_coulombs_acceleration_at_every_step(rate_hz, iterations):
    result = measured("slide", timestep_s=1 / rate_hz, solver_iterations=iterations)
    assert result.measured == pytest.approx(result.expected, rel=1e-3)


def test_the_coulomb_model_loses_friction_by_the_angle_between_impulse_and_slip():
    """The impulse of a corner is along K^-1 v. For a cube K is [[4, 1.5], [1.5, 4]] / m; lateral parts cancel."""
    result = measured("slide", friction_model="coulomb")
    assert result.measured == pytest.approx(4.0 / np.hypot(4.0, 1.5), rel=2e-3)


def dropped(body, restitution):
    touch = contact("body", "ground", friction=0.3, restitution=restitution)
    return scene_of(body, GROUND, contacts=(touch,))


@pytest.mark.parametrize(("restitution", "rate_hz"), [(0.2, 180), (0.9, 1800)])
def test_the_speed_of_a_rebound_is_exact_at_every_step(restitution, rate_hz):
    scene = dropped(ball("body", (0.0, 0.0, 0.52), radius_m=0.02), restitution)
    _, rows = course(scene, "body", 0.4, timestep_s=1 / rate_hz)
    speeds = rows[:, 9]
    hit = int(np.argmax(speeds > 0.0))
    assert speeds[hit] == pytest.approx(-restitution * speeds[hit - 1], rel=1e-4)


# --- errors of the engine on its page --------------------------------------------------------------------------------


def test_a_flat_impact_spins_a_box():
    scene = dropped(box("body", (0.0, 0.0, 0.22), (0.1, 0.06, 0.04)), 0.5)
    _, rows = course(scene, "body", 0.35)
    hit = int(np.argmax(rows[:, 9] > 0.0))
    assert np.linalg.norm(rows[hit + 5, 10:]) == pytest.approx(6.9, abs=0.3)
    rebound = np.sqrt((rows[hit:, 2].max() - 0.02) / 0.2)
    assert rebound == pytest.approx(0.35, abs=0.01)


@pytest.mark.parametrize(("support", "ratio"), [("plane", 1.0), ("slab", 1.2)])
def test_a_cylinder_rolls_too_fast_on_a_box_and_right_on_a_plane(support, ratio):
    slope_deg, radius_m = 3.6, 0.03
    sine, cosine = np.sin(np.radians(slope_deg)), np.cos(np.radians(slope_deg))
    start = (radius_m * sine, 0.0, radius_m * cosine)
    pose = Pose.from_euler_deg(start, (90.0, 0.0, 0.0))
    roller = solid("roller", Cylinder(radius_m=radius_m, length_m=0.06), pose=pose)
    below, lean = (-0.05 * sine, 0.0, -0.05 * cosine), (0.0, slope_deg, 0.0)
    ground = plane_deg(slope_deg)
    if support == "slab":
        ground = fixed_box("ground", below, (3.0, 1.0, 0.1), euler_deg=lean)
    touch = contact("roller", "ground", friction=0.5)
    scene = scene_of(roller, ground, contacts=(touch,))
    times_s, rows = course(scene, "roller", 0.8)
    late, down_m = times_s > 0.1, rows[:, :3] @ [cosine, 0.0, -sine]
    acceleration = 2.0 * np.polyfit(times_s[late], down_m[late], 2)[0]
    assert acceleration / (2.0 / 3.0 * G * sine) == pytest.approx(ratio, abs=0.02)


def test_impulse_hinges_lose_energy_in_the_stabilization():
    """A swing from 90 degrees has 1.96 J/kg in its motion."""
    hinge = Hinge(body="bob", anchor_m=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
    bob = ball("bob", (0.2, 0.0, 0.0), radius_m=0.02)
    impulse = {"hinge_joint": "impulse", "timestep_s": 1 / 180, "solver_iterations": 4}

    def energies(**settings):
        scene = scene_of(bob, joints=(hinge,))
        _, rows = course(scene, "bob", 20.0, **impulse, **settings)
        speeds = np.square(rows[:, 7:10]).sum(axis=1)
        spins = np.square(rows[:, 10:]).sum(axis=1)
        return G * rows[:, 2] + 0.5 * speeds + 0.2 * 0.02**2 * spins

    assert energies()[-1] == pytest.approx(-0.95, abs=0.05)
    assert np.abs(energies(stabilization_iterations=0)).max() < 0.01


# --- pairs, settings and forks ---------------------------------------------------------------------------------------


def test_each_setting_reaches_the_engine():
    """A change of a setting changes the parameters of the world or a body."""
    scene, plain = load_experiment("Turntable-1-wood").scene, PRESETS["default"]
    elsewhere = {"preset", "timestep_s", "drive_interval_s", "threads"}

    def parameters(**changes):
        settings = plain.model_copy(update=changes)
        world, layout = model.build_world(scene, settings)
        body = world.rigid_bodies[layout["cube"].handle]
        sleeps = body.activation.linear_threshold
        return world.integration_parameters.to_bytes(), body.ccd_enabled, sleeps

    for name, value in plain.model_dump().items():
        if name in elsewhere or name.startswith("hinge"):
            continue
        if isinstance(value, str):
            changed = "coulomb"
        elif isinstance(value, bool):
            changed = not value
        else:
            changed = 2 * value + 1
        assert parameters(**{name: changed}) != parameters(), name


def _falls():
    simulation = RAPIER.build(dropped(ball("body", (0.0, 0.0, 0.5)), 0.5))
    simulation.advance(0.1)


def test_a_forked_process_builds_and_steps_worlds_after_its_parent_did():
    """Without a pool of its own the child waits for threads that a fork does not copy."""
    _falls()
    child = multiprocessing.get_context("fork").Process(target=_falls)
    child.start()
    child.join(timeout=20.0)
    exit_code = child.exitcode
    child.kill()
    assert exit_code == 0
