"""Scores of exact solutions, and the constants estimated from their motion: closed forms, no engine.

Real frictions and restitutions are from `scoring/facts`, computed from the published trials.
"""

import math
import tomllib

import numpy as np
import pytest
from scipy.optimize import least_squares

from gauge_envs import load_experiment, variants
from gauge_envs.files import data_folder
from gauge_envs.references.band import load_band
from gauge_envs.scoring.reference import reference_band
from gauge_envs.scoring.score import score_trajectory

SETS = ("published", "measured")


def sample_times_s(experiment):
    """Return the times of an episode's samples, 180 Hz until 10 frames after the last one."""
    return np.arange((experiment.frame_count + 9) * 6 + 1) / 180.0


def checked_score(experiment, times_s, positions_m):
    """Return the score of a solution after comparing it with the exact score in the band."""
    band = reference_band(experiment)
    score = score_trajectory(
        experiment, band, times_s=times_s, values=1e3 * positions_m
    )
    assert score.exact == band.exact[experiment.parameters]
    assert score.primary_normalized == pytest.approx(score.exact, rel=0.01)
    return score


def start_m(experiment, body):
    return np.array(experiment.scene.body(body).pose.position_m)


def summary(name):
    """Return a summary of real trials."""
    file = data_folder("scoring") / "facts" / f"{name}_summary.toml"
    return tomllib.loads(file.read_text())


@pytest.mark.parametrize("parameters", SETS)
def test_a_ball_in_free_fall_with_ideal_rebounds(parameters):
    experiment = load_experiment("BouncingBall-rubber", parameters)
    gravity = experiment.scene.gravity_m_per_s2
    restitution = experiment.scene.contacts[0].restitution
    start = start_m(experiment, "ball")
    rest = start_m(experiment, "ground")[2] + 0.03
    impact_s = np.sqrt(2.0 * (start[2] - rest) / gravity)
    speed = gravity * impact_s
    times_s = sample_times_s(experiment)
    heights = start[2] - 0.5 * gravity * times_s**2
    while impact_s < times_s[-1]:
        speed *= restitution
        since = times_s - impact_s
        rebound = rest + speed * since - 0.5 * gravity * since**2
        heights = np.where(since > 0.0, rebound, heights)
        impact_s += 2.0 * speed / gravity
    positions = np.tile(start, (len(times_s), 1))
    positions[:, 2] = heights
    score = checked_score(experiment, times_s, positions)
    estimate = score.estimates["restitution"]
    assert estimate.value == pytest.approx(restitution, rel=1e-6)
    real = summary("bouncing_ball")["rebound_ratio"]
    assert estimate.real == pytest.approx(real["mean"], rel=1e-3)
    expected = real["std"] / math.sqrt(22)
    assert estimate.real_uncertainty == pytest.approx(expected, rel=0.1)
    # The exact solution has the nominal start.
    moved = score_trajectory(
        experiment,
        load_band("BouncingBall-rubber"),
        times_s=times_s,
        values=1e3 * positions,
        is_moved=True,
    )
    assert moved.exact is None and moved.rmse == score.rmse


@pytest.mark.parametrize("parameters", SETS)
@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_a_cube_slides_down_the_fixed_board(material, parameters):
    experiment = load_experiment(f"SlopeSlider-2-{material}", parameters)
    friction = experiment.scene.contacts[0].friction
    sine, cosine = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))
    gravity = experiment.scene.gravity_m_per_s2
    acceleration = gravity * (sine - friction * cosine)
    times_s = sample_times_s(experiment)
    travel = 0.5 * acceleration * times_s**2
    offsets = np.outer(travel, [cosine, 0.0, -sine])
    score = checked_score(experiment, times_s, start_m(experiment, "cube") + offsets)
    estimate = score.estimates["friction"]
    assert estimate.value == pytest.approx(friction, rel=1e-6)
    real = summary("slope_slider_30deg")[material]
    assert estimate.real == pytest.approx(real["friction"]["mean"], abs=1e-3)
    # The scatter of the mean, and 0.3 degrees of tilt: mu = tan - a / (g cos).
    scatter = real["friction"]["std"] / math.sqrt(real["trial_count"])
    tilt = math.radians(0.3) * (1.0 + estimate.real * sine / cosine)
    expected = math.hypot(scatter, tilt)
    assert estimate.real_uncertainty == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("material", ["wood", "plastic", "metal"])
def test_the_measured_friction_is_nearest_to_the_recorded_slides(material):
    """Friction and release time by least squares; the task file has four digits of the friction."""
    experiment = load_experiment(f"SlopeSlider-2-{material}", "measured")
    band = load_band(experiment.name)
    sine, cosine = np.sin(np.radians(30.0)), np.cos(np.radians(30.0))
    start_mm = 1e3 * start_m(experiment, "cube") @ [cosine, 0.0, -sine]
    frames_s = np.arange(experiment.frame_count) / 30.0
    gravity_mm_per_s2 = 1e3 * experiment.scene.gravity_m_per_s2

    def deviation_mm(parameters):
        friction, release_s = parameters
        acceleration = gravity_mm_per_s2 * (sine - friction * cosine)
        sliding_s = np.maximum(frames_s - release_s, 0.0)
        return start_mm + 0.5 * acceleration * sliding_s**2 - band.mean[:, 0]

    fit = least_squares(deviation_mm, [0.3, 0.01])
    friction = experiment.scene.contacts[0].friction
    assert friction == pytest.approx(fit.x[0], abs=1e-4)


def test_an_exact_solution_with_measured_constants_is_nowhere_farther():
    compared = []
    for variant in variants():
        band = load_band(variant.name)
        if band is None or "measured" not in band.exact:
            continue
        assert band.exact["measured"] <= band.exact["published"], variant.name
        compared.append(variant.name)
    assert len(compared) == 8
