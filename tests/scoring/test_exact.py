"""What exact solutions score is recomputed from closed forms and an ODE, without any engine."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

from gauge_envs import load_experiment
from gauge_envs.references.band import load_band
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import score_trajectory

SETS = ("calibrated", "effective")


def sample_times_s(experiment):
    """Return the times of an episode's samples, 180 Hz until 10 frames after the last one."""
    return np.arange((experiment.frame_count + 9) * 6 + 1) / 180.0


def score(experiment, times_s, positions_m):
    band = reference_band(experiment)
    values = 1e3 * positions_m
    found = score_trajectory(experiment, band, times_s=times_s, values=values)
    return found.primary_normalized


def start_m(experiment, body):
    return np.array(experiment.scene.body(body).pose.position_m)


@pytest.mark.parametrize("parameters", [*SETS, "recorded"])
def test_ball_in_free_fall_with_ideal_rebounds(parameters):
    experiment = load_experiment("BouncingBall-rubber", parameters)
    gravity = experiment.scene.gravity_m_per_s2
    start = start_m(experiment, "ball")
    rest = start_m(experiment, "ground")[2] + 0.03
    impact_s = np.sqrt(2.0 * (start[2] - rest) / gravity)
    speed = gravity * impact_s
    times_s = sample_times_s(experiment)
    heights = start[2] - 0.5 * gravity * times_s**2
    while impact_s < times_s[-1]:
        speed *= experiment.scene.contacts[0].restitution
        since = times_s - impact_s
        rebound = rest + speed * since - 0.5 * gravity * since**2
        heights = np.where(since > 0.0, rebound, heights)
        impact_s += 2.0 * speed / gravity
    positions = np.tile(start, (len(times_s), 1))
    positions[:, 2] = heights
    exact = load_band("BouncingBall-rubber").exact[parameters]
    assert score(experiment, times_s, positions) == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize("parameters", SETS)
@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_cube_slides_down_the_fixed_board(material, parameters):
    name = f"SlopeSlider-2-{material}"
    experiment = load_experiment(name, parameters)
    friction = experiment.scene.contacts[0].friction
    sine, cosine = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))
    gravity = experiment.scene.gravity_m_per_s2
    acceleration = gravity * (sine - friction * cosine)
    times_s = sample_times_s(experiment)
    travel = 0.5 * acceleration * times_s**2
    offsets = np.outer(travel, [cosine, 0.0, -sine])
    found = score(experiment, times_s, start_m(experiment, "cube") + offsets)
    assert found == pytest.approx(load_band(name).exact[parameters], rel=0.01)


@pytest.mark.parametrize("parameters", SETS)
def test_cube_slips_on_the_tilting_board(parameters):
    """The cube's place along the board, in the frame of its axle, is the state; it does not stop once it slips."""
    experiment = load_experiment("SlopeSlider-3-metal", parameters)
    gravity = experiment.scene.gravity_m_per_s2
    friction = experiment.scene.contacts[0].friction
    (motion,) = experiment.scene.drivers[0].motions
    (profile,) = motion.profiles
    angle = PchipInterpolator(profile.times_s, profile.values)
    rate, acceleration = angle.derivative(), angle.derivative(2)
    arm = start_m(experiment, "cube") - motion.point_m
    along, height = arm[0], arm[2]

    def pull_and_press(time_s, place, speed):
        """Return forces along and normal to the board over the mass, without friction [m/s^2]."""
        turn, turn_rate, turn_up = angle(time_s), rate(time_s), acceleration(time_s)
        pull = gravity * np.sin(turn) + place * turn_rate**2 - height * turn_up
        press = gravity * np.cos(turn) - 2.0 * speed * turn_rate
        return pull, press - place * turn_up - height * turn_rate**2

    def motion_of(time_s, state):
        pull, press = pull_and_press(time_s, *state)
        return state[1], pull - friction * press

    times_s = sample_times_s(experiment)
    times_s = times_s[times_s < profile.times_s[-1]]
    fine_s = np.arange(0.0, times_s[-1], 1e-5)
    pull, press = pull_and_press(fine_s, along, 0.0)
    slip_s = fine_s[np.argmax(pull > friction * press)]
    sliding = times_s[times_s > slip_s]
    options = {"rtol": 1e-10, "atol": 1e-12, "max_step": 1e-3, "t_eval": sliding}
    ends_s = (slip_s, times_s[-1])
    solved = solve_ivp(motion_of, ends_s, [along, 0.0], **options)
    places = np.full(len(times_s), along)
    places[times_s > slip_s] = solved.y[0]
    sine, cosine = np.sin(angle(times_s)), np.cos(angle(times_s))
    offsets = np.column_stack(
        [places * cosine + height * sine, 0.0 * sine, height * cosine - places * sine]
    )
    found = score(experiment, times_s, motion.point_m + offsets)
    exact = load_band("SlopeSlider-3-metal").exact[parameters]
    assert found == pytest.approx(exact, rel=0.01)


def test_an_exact_solution_is_of_the_start_that_the_scene_states():
    experiment = load_experiment("BouncingBall-rubber")
    times_s = sample_times_s(experiment)
    band = reference_band(experiment)
    values = np.tile(1e3 * start_m(experiment, "ball"), (len(times_s), 1))
    found = [
        score_trajectory(
            experiment, band, times_s=times_s, values=values, is_moved=is_moved
        ).exact
        for is_moved in (False, True)
    ]
    assert found == [band.exact["calibrated"], None]
