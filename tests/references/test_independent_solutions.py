"""Stored solutions against independent solutions: ordinary differential equations by SciPy.

A stored solution has a standard uncertainty u. It lies within 1.96 u of the exact solution in 95 % of cases.
"""

import gymnasium as gym
import numpy as np
import pytest
from episodes import run_to_end
from scipy.integrate import solve_bvp, solve_ivp

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.band import load_band
from gauge_envs.scoring.trajectory import score_trajectory


def friction_between(scene, first, second):
    (contact,) = [
        pair
        for pair in scene.contacts
        if {first, second} == {*pair.first, *pair.second}
    ]
    return contact.friction


def distance_in_u(name, exact_mm):
    """Return the distance of the stored solution from an exact one, over its u."""
    band = load_band(name)
    return band.length(exact_mm - band.mean) / band.standard_uncertainty


# --- dragged rod -----------------------------------------------------------------------------------------------------


def dragged_rod_lag_m(scene):
    """Return heights over the foot, and the lag of the rod behind its top at these heights [m], while the foot slides.

    The unloaded rod reaches from its top to the board. Its weight stretches it, so the board carries a force N.
    Friction mu N bends the rod, and a bent rod is shorter. With s from the foot and the tension T = w s - N:

        E I x''' = T x' - mu N,    x'' = 0 at the foot,    x = x' = 0 at the top,
        integral of T / (E A) - x'^2 / 2 = 0,    as the foot stays on the board.
    """
    (rod,) = scene.deformables
    friction = friction_between(scene, "rod", "board")
    stretch_n = rod.young_modulus_pa * np.pi * rod.radius_m**2
    bend_n_m2 = rod.young_modulus_pa * 0.25 * np.pi * rod.radius_m**4
    weight_n = rod.mass_kg * scene.gravity_m_per_s2

    def slopes(share, state, unknown):
        _, slope, curvature, _ = state
        borne_n = unknown[0] * weight_n
        tension_n = weight_n * share - borne_n
        change = (tension_n * slope - friction * borne_n) / bend_n_m2
        rise = tension_n / stretch_n - 0.5 * slope**2
        return rod.length_m * np.array([slope, curvature, change, rise])

    def ends(foot, top, _):
        return np.array([foot[2], top[0], top[1], foot[3], top[3]])

    share = np.linspace(0.0, 1.0, 101)
    start = np.zeros((4, len(share)))
    solution = solve_bvp(slopes, ends, share, start, p=[0.2], tol=1e-9)
    assert solution.success
    # A straight rod would rest with half of its weight on the board.
    assert 0.0 < solution.p[0] < 0.5
    return solution.x * rod.length_m, np.abs(solution.y[0])


@pytest.mark.parametrize("name", ["StickStack-soft", "StickStack-hard"])
def test_a_dragged_rod_trails_as_a_rod_that_stretches(name):
    scene = load_experiment(name).scene
    (rod,), band = scene.deformables, load_band(name)
    rest_mm = 1e3 * np.array(scene.markers.positions_m)
    # The foot slides steadily in the second half, and the top moves at constant speed.
    frames = np.arange(60, 120)
    speed_mm_s = 1e3 * scene.drivers[0].motions[0].rate(2.0)
    places_mm = band.mean[frames, ::3]
    moved_mm = places_mm - rest_mm[:, 0]
    lag_mm = (speed_mm_s * frames[:, None] / 30.0 - moved_mm).mean(axis=0)
    heights_m, exact_m = dragged_rod_lag_m(scene)
    foot_m = rod.pose.position_m[2] - 0.5 * rod.length_m
    exact_mm = 1e3 * np.interp(1e-3 * rest_mm[:, 2] - foot_m, heights_m, exact_m)
    u_mm = band.uncertainty[frames, ::3].mean(axis=0)
    assert np.all(np.abs(lag_mm - exact_mm) < 1.96 * u_mm)
    # The interval above could be wide; the lag must also agree within a tenth.
    assert lag_mm == pytest.approx(exact_mm, rel=0.1)


# --- cube on a tilting board -----------------------------------------------------------------------------------------

STEPS_A_SAMPLE = 50


def tilted_cube_mm(experiment):
    """Return the centre of a cube that sticks to a turning board and slides on it, 180 times a second [mm].

    In the frame of the board, which turns by phi about y, the cube is at xi along it and at a constant height eta:

        xi'' = g sin(phi) + xi phi'^2 - eta phi'' - f,
        N / m = g cos(phi) - 2 xi' phi' - xi phi'' - eta phi'^2,    |f| <= mu N / m.
    """
    scene = experiment.scene
    (rotation,) = scene.drivers[0].motions
    friction = friction_between(scene, "cube", "board")
    gravity = scene.gravity_m_per_s2
    step_s = 1.0 / (180.0 * STEPS_A_SAMPLE)
    count = 6 * (experiment.frame_count - 1) * STEPS_A_SAMPLE + 1
    angles = np.array([rotation.value(step_s * step) for step in range(count)])
    rates = np.array([rotation.rate(step_s * step) for step in range(count)])
    gains = np.gradient(rates, step_s)
    cube = scene.body("cube")
    along, _, height = np.array(cube.pose.position_m) - rotation.point_m
    speed, places = 0.0, []
    for index, (angle, rate, gain) in enumerate(zip(angles, rates, gains, strict=True)):
        sine, cosine = np.sin(angle), np.cos(angle)
        if index % STEPS_A_SAMPLE == 0:
            x = along * cosine + height * sine
            z = height * cosine - along * sine
            places.append(
                [
                    rotation.point_m[0] + x,
                    cube.pose.position_m[1],
                    rotation.point_m[2] + z,
                ]
            )
        pressed = (
            gravity * cosine - 2.0 * speed * rate - along * gain - height * rate**2
        )
        pulled = gravity * sine + along * rate**2 - height * gain
        friction_limit = friction * pressed
        if speed == 0.0:
            speed = step_s * np.sign(pulled) * max(abs(pulled) - friction_limit, 0.0)
        else:
            faster = speed + step_s * (pulled - np.sign(speed) * friction_limit)
            speed = faster if faster * speed > 0.0 else 0.0
        along += step_s * speed
    return 1e3 * np.array(places)


@pytest.mark.parametrize("material", ["wood", "plastic"])
def test_a_cube_on_a_tilting_board_slides_by_coulombs_law(material):
    """The stored solution is 0.16 and 0.18 mm off, 0.2 u; without friction the cube would be 450 mm off."""
    name = f"SlopeSlider-3-{material}"
    assert distance_in_u(name, tilted_cube_mm(load_experiment(name))[::6]) < 1.0


@pytest.mark.parametrize("parameters", ["published", "measured"])
def test_the_distance_of_mujoco_from_a_recording_follows_coulombs_law(parameters):
    """Both score 1.52 and 1.50; the slip of MuJoCo's soft contacts moves the score by 0.4 %."""
    experiment = load_experiment("SlopeSlider-3-metal", parameters)
    values = tilted_cube_mm(experiment)
    times_s = np.arange(len(values)) / 180.0
    band = load_band(experiment.name)
    score = score_trajectory(experiment, band, times_s=times_s, values=values)
    env = gym.make(experiment.id, parameters=parameters)
    simulated = run_to_end(env)[1]["score"]
    assert simulated.rmse_normalized == pytest.approx(score.rmse_normalized, rel=0.01)
    # The board is driven, so the acceleration of the slide is not uniform.
    assert score.estimates == {}


# --- cube on a turning plate -----------------------------------------------------------------------------------------

CREEP_M_PER_S = 1e-5
"""Speed at which friction has 71 % of its limit: a cube that sticks creeps by less than 0.04 mm in an episode."""


@pytest.mark.parametrize("material", ["wood", "plastic"])
def test_a_cube_on_a_turning_plate_slides_by_coulombs_law(material):
    """A point mass, which neither tips nor rotates, is 0.8 mm off, 0.6 u; without friction it would be 100 mm off."""
    experiment = load_experiment(f"Turntable-3-{material}")
    scene = experiment.scene
    (rotation,) = scene.drivers[0].motions
    limit = scene.gravity_m_per_s2 * friction_between(scene, "cube", "plate")

    def slopes(time_s, state):
        arm, velocity = state[:2] - rotation.point_m[:2], state[2:]
        slip = velocity - rotation.rate(time_s) * np.array([-arm[1], arm[0]])
        pull = -limit * slip / np.hypot(np.linalg.norm(slip), CREEP_M_PER_S)
        return np.concatenate([velocity, pull])

    times_s = np.arange(experiment.frame_count) / 30.0
    x, y, z = scene.body("cube").pose.position_m
    path = solve_ivp(
        slopes,
        (0.0, times_s[-1]),
        [x, y, 0.0, 0.0],
        method="LSODA",
        t_eval=times_s,
        rtol=1e-7,
        atol=1e-9,
        max_step=1e-3,
    ).y
    exact_mm = 1e3 * np.column_stack([path[0], path[1], np.full_like(times_s, z)])
    assert distance_in_u(experiment.name, exact_mm) < 1.0
