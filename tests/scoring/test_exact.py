"""The exact motion of a scene against closed forms of the tests, and the constants estimated from their motion.

Real frictions and restitutions are from `scoring/facts`, computed from the published trials.
"""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from closed_forms import ball_mm, slide_mm
from scipy.optimize import least_squares

from gauge_envs import load_experiment, variants
from gauge_envs.files import data_folder
from gauge_envs.scene import Pose
from gauge_envs.scoring.exact import exact_motion
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.trajectory import score_trajectory

SETS = ("published", "measured")
SLIDES = tuple(f"SlopeSlider-2-{name}" for name in ("wood", "plastic", "metal"))
BALL = "BouncingBall-rubber"
RATES_HZ = (30, 60, 90, 180, 1000)

PUBLISHED_SCORES = {
    SLIDES[0]: 4.950,
    SLIDES[1]: 3.579,
    SLIDES[2]: 1.064,
    BALL: 17.403,
}
"""Scores of the closed forms with the published constants at 180 Hz, to three digits after the point."""


def sample_times_s(experiment, rate_hz=180):
    """Return the times of the samples at a rate; the frames are among them."""
    frames_s = np.arange(experiment.frame_count) / 30.0
    samples_s = np.arange(round(frames_s[-1] * rate_hz) + 1) / rate_hz
    times_s = np.union1d(frames_s, samples_s[samples_s < frames_s[-1]])
    return times_s[np.append(True, np.diff(times_s) > 1e-9)]


def start_m(experiment, body):
    return np.array(experiment.scene.body(body).pose.position_m)


def closed_form_mm(experiment, times_s, **changes):
    """Return the closed form of an experiment with its own constants, or with changed ones."""
    contact = experiment.scene.contacts[0]
    if experiment.name == BALL:
        constants = {"restitution": contact.restitution}
        constants["plane_m"] = start_m(experiment, "ground")[2]
        start = start_m(experiment, "ball")
        return ball_mm(start, times_s, **(constants | changes))
    constants = {"friction": contact.friction}
    start = start_m(experiment, "cube")
    return slide_mm(start, times_s, **(constants | changes))


def scored(experiment, times_s, values_mm, **options):
    band = reference_band(experiment)
    return score_trajectory(
        experiment, band, times_s=times_s, values=values_mm, **options
    )


def summary(name):
    """Return a summary of real trials."""
    file = data_folder("scoring") / "facts" / f"{name}_summary.toml"
    return tomllib.loads(file.read_text())


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("parameters", SETS)
@pytest.mark.parametrize("name", [*SLIDES, BALL])
def test_a_closed_form_scores_as_the_exact_motion_at_each_rate(
    name, parameters, rate_hz
):
    experiment = load_experiment(name, parameters)
    times_s = sample_times_s(experiment, rate_hz)
    score = scored(experiment, times_s, closed_form_mm(experiment, times_s))
    assert score.primary_normalized == pytest.approx(score.exact, rel=0.01)
    if rate_hz == 180 and parameters == "published":
        assert score.exact == pytest.approx(PUBLISHED_SCORES[name], abs=6e-4)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        (SLIDES[0], {"cube.friction": 0.1}),
        (SLIDES[1], {"cube.friction": 0.234, "cube.mass_kg": 0.2}),
        (SLIDES[2], {"cube.friction": 0.58}),
        (SLIDES[0], {"scene.gravity_m_per_s2": 1.62}),
        (BALL, {"ball.restitution": 0.9}),
        (BALL, {"ball.restitution": 1.0}),
        (BALL, {"ball.position_m": [0.41, 0.43, 0.46]}),
        (BALL, {"scene.gravity_m_per_s2": 3.71, "ground.position_m": [0, 0, 0.1]}),
    ],
)
def test_the_exact_motion_has_the_constants_and_the_start_of_the_scene(
    name, parameters
):
    experiment = load_experiment(name, parameters)
    times_s = np.linspace(-0.5, 2.0, 501)
    gravity = experiment.scene.gravity_m_per_s2
    expected = closed_form_mm(experiment, times_s, gravity=gravity)
    np.testing.assert_allclose(exact_motion(experiment, times_s), expected, atol=1e-6)


def test_a_ball_without_restitution_stays_where_it_lands():
    experiment = load_experiment(BALL, {"ball.restitution": 0.0})
    heights_mm = exact_motion(experiment, np.array([0.0, 1.0, 5.0]))[:, 2]
    assert heights_mm == pytest.approx([451.023, 43.297, 43.297], abs=1e-9)


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_a_cube_holds_on_a_board_of_10_degrees(material):
    experiment = load_experiment(f"SlopeSlider-1-{material}")
    times_s = sample_times_s(experiment)
    motion = exact_motion(experiment, times_s)
    np.testing.assert_array_equal(motion, np.tile(motion[0], (len(times_s), 1)))
    assert scored(experiment, times_s, motion).exact == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        # Driven bodies, a solution, deformable bodies, and trials of the user without a law.
        ("SlopeSlider-3-metal", "published"),
        ("Turntable-3-metal", "published"),
        ("Pendulum-metal", "published"),
        ("SiliconeBeam-0g-silicone", "published"),
        # The cube starts above the board, in it, or beside it; the ball starts in the ground.
        (SLIDES[0], {"cube.position_m": [0.097247, 0.406934, 0.37]}),
        (SLIDES[0], {"cube.position_m": [0.097247, 0.406934, 0.35]}),
        (SLIDES[0], {"cube.position_m": [0.097247, 0.306934, 0.359354]}),
        (BALL, {"ball.position_m": [0.418911, 0.435316, 0.03]}),
    ],
)
def test_a_scene_outside_the_limits_of_a_law_has_no_exact_motion(name, parameters):
    experiment = load_experiment(name, parameters)
    assert exact_motion(experiment, np.arange(3) / 30.0) is None


def test_a_body_that_starts_moving_or_tilted_has_no_exact_motion():
    experiment = load_experiment(SLIDES[0])
    (cube,) = [body for body in experiment.scene.bodies if body.name == "cube"]
    tilted = replace(cube, pose=Pose(position_m=cube.pose.position_m))
    pushed = replace(cube, linear_velocity_m_per_s=(0.1, 0.0, 0.0))
    for changed in (tilted, pushed):
        bodies = tuple(
            changed if body is cube else body for body in experiment.scene.bodies
        )
        scene = replace(experiment.scene, bodies=bodies)
        moved = replace(experiment, scene=scene)
        assert exact_motion(moved, np.arange(3) / 30.0) is None


@pytest.mark.parametrize("name", SLIDES)
@pytest.mark.parametrize("friction", [0.0, 0.05, 0.1, 0.15, 0.2])
def test_a_slide_past_the_end_of_its_board_solves_the_scene_up_to_there(name, friction):
    experiment = load_experiment(name, {"cube.friction": friction})
    times_s = sample_times_s(experiment)
    fallen, wrong = (
        closed_form_mm(load_experiment(name, {"cube.friction": mu}), times_s)
        for mu in (friction, friction + 0.06)
    )
    # The cube falls freely after its centre has passed the lower edge of the board.
    board = experiment.scene.body("board")
    along_m = (
        np.abs(board.pose.to_body(fallen / 1e3))[:, 0] - 0.5 * board.shape.size_m[0]
    )
    passed = np.flatnonzero(along_m > 0.0)
    if len(passed):
        since_s = np.maximum(times_s - times_s[passed[0]], 0.0)
        slope = np.radians(30.0)
        dropped = 9.80665 * np.cos(slope) * (np.cos(slope) + friction * np.sin(slope))
        fallen[:, 2] -= 500.0 * dropped * since_s**2
    score = scored(experiment, times_s, fallen)
    assert score.solves == "yes"
    assert score.cause == "constants"
    assert score.estimates["friction"].value == pytest.approx(friction, abs=0.01)
    assert scored(experiment, times_s, wrong).solves == "no"


def test_a_cube_that_does_not_slide_is_said_where_the_real_one_does():
    for name in SLIDES:
        experiment = load_experiment(name, {"cube.friction": 0.9})
        times_s = sample_times_s(experiment)
        still = closed_form_mm(experiment, times_s)
        friction = scored(experiment, times_s, still).estimates["friction"]
        assert (friction.value, friction.answer) == (None, "no")
        assert friction.real > 0.2
    held = load_experiment("SlopeSlider-1-wood")
    times_s = sample_times_s(held)
    assert not scored(held, times_s, exact_motion(held, times_s)).estimates


def test_a_start_with_noise_has_no_exact_score():
    experiment = load_experiment(BALL)
    times_s = sample_times_s(experiment)
    motion = closed_form_mm(experiment, times_s)
    score = scored(experiment, times_s, motion)
    moved = scored(experiment, times_s, motion, is_moved=True)
    assert (moved.exact, moved.cause) == (None, None)
    assert moved.rmse == score.rmse


@pytest.mark.parametrize("parameters", SETS)
def test_the_restitution_of_an_exact_ball_is_that_of_its_scene(parameters):
    experiment = load_experiment(BALL, parameters)
    times_s = sample_times_s(experiment)
    score = scored(experiment, times_s, closed_form_mm(experiment, times_s))
    estimate = score.estimates["restitution"]
    restitution = experiment.scene.contacts[0].restitution
    assert estimate.value == pytest.approx(restitution, rel=1e-6)
    real = summary("bouncing_ball")["rebound_ratio"]
    assert estimate.real == pytest.approx(real["mean"], rel=1e-3)
    expected = real["std"] / math.sqrt(22)
    assert estimate.real_uncertainty == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("parameters", SETS)
@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_friction_of_an_exact_slide_is_that_of_its_scene(material, parameters):
    experiment = load_experiment(f"SlopeSlider-2-{material}", parameters)
    times_s = sample_times_s(experiment)
    score = scored(experiment, times_s, closed_form_mm(experiment, times_s))
    estimate = score.estimates["friction"]
    friction = experiment.scene.contacts[0].friction
    assert estimate.value == pytest.approx(friction, rel=1e-6)
    real = summary("slope_slider_30deg")[material]
    assert estimate.real == pytest.approx(real["friction"]["mean"], abs=1e-3)
    # The scatter of the mean, and 0.3 degrees of tilt: mu = tan - a / (g cos).
    scatter = real["friction"]["std"] / math.sqrt(real["trial_count"])
    sine, cosine = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))
    tilt = math.radians(0.3) * (1.0 + estimate.real * sine / cosine)
    expected = math.hypot(scatter, tilt)
    assert estimate.real_uncertainty == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_measured_friction_is_nearest_to_the_recorded_slides(material):
    """Friction and release time by least squares; the task file has four digits of the friction."""
    experiment = load_experiment(f"SlopeSlider-2-{material}", "measured")
    band = reference_band(experiment)
    frames_s = np.arange(experiment.frame_count) / 30.0

    def deviation_mm(parameters):
        friction, release_s = parameters
        motion = closed_form_mm(
            experiment, frames_s, friction=friction, late_s=release_s
        )
        return (band.project(motion) - band.mean)[:, 0]

    fit = least_squares(deviation_mm, [0.3, 0.01])
    friction = experiment.scene.contacts[0].friction
    assert friction == pytest.approx(fit.x[0], abs=1e-4)


def test_an_exact_motion_with_measured_constants_is_nowhere_farther():
    compared = []
    for variant in variants():
        band = reference_band(load_experiment(variant.name))
        if band is None or band.exact_law is None:
            continue
        exact = {}
        for parameters in SETS:
            experiment = load_experiment(variant.name, parameters)
            times_s = sample_times_s(experiment)
            motion = exact_motion(experiment, times_s)
            exact[parameters] = scored(experiment, times_s, motion).exact
        assert exact["measured"] <= exact["published"], variant.name
        compared.append(variant.name)
    assert len(compared) == 7
