"""Recorded tosses of a cube: their conventions against free flight, finite differences and the size of the cube."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment, reference_band
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.single_shot import single_shots
from gauge_envs.scene.geometry import CORNER_SIGNS

NAME = "CubeToss-acrylic"
HALF_WIDTH_M = 0.0524
GRAVITY = 9.80665
SHOTS = single_shots(NAME)


def flights(half):
    """Return trials, each with its rotations and the number of frames before the cube is near the table."""
    trials = []
    for trial in SHOTS.trials(half)[::4]:
        shot = SHOTS.shot(trial)
        rotations = Rotation.from_quat(shot.quaternions, scalar_first=True)
        corners_m = HALF_WIDTH_M * CORNER_SIGNS @ rotations.as_matrix()[:, 2].T
        lowest_m = shot.positions_m[:, 2] + corners_m.min(axis=0)
        count = int(np.argmax(lowest_m < 0.005))
        if count >= 8:
            trials.append((shot, rotations, count))
    assert len(trials) > 40
    return trials


@pytest.mark.parametrize("half", ["fit", "judge"])
def test_recorded_flights_follow_the_closed_form(half):
    """Equal moments of inertia: a constant angular velocity, and a parabola with gravity.

    The scale of lengths does not use the judging half.
    """
    drifts, falls = [], []
    for shot, rotations, count in flights(half):
        time_s = shot.times_s[count - 1]
        place = shot.positions_m[0] + shot.start[7:10] * time_s
        place[2] -= 0.5 * GRAVITY * time_s**2
        turned = Rotation.from_rotvec(shot.start[10:] * time_s)
        apart = turned * rotations[0] * rotations[count - 1].inv()
        distance_m = np.linalg.norm(place - shot.positions_m[count - 1])
        drifts.append((distance_m, np.degrees(apart.magnitude())))
        heights_m = shot.positions_m[:count, 2]
        falls.append(-2.0 * np.polyfit(shot.times_s[:count], heights_m, 2)[0])
    assert (np.median(drifts, axis=0) < (0.3e-3, 0.3)).all()
    # Three standard errors of a median.
    error = 1.25 * np.std(falls) / np.sqrt(len(falls))
    assert np.median(falls) == pytest.approx(GRAVITY, abs=3.0 * error)


def test_the_height_of_the_resting_cube_gives_the_scale_a_second_time():
    nuisances = SHOTS.metadata["nuisances"]
    rest_m = [SHOTS.shot(trial).positions_m[-1, 2] for trial in SHOTS.trials("judge")]
    assert np.median(rest_m) == pytest.approx(HALF_WIDTH_M, abs=1e-4)
    unscaled_m = np.median(rest_m) - nuisances["height_offset_m"]
    scale = HALF_WIDTH_M * nuisances["length_scale"] / unscaled_m
    assert scale == pytest.approx(nuisances["length_scale"], abs=4e-3)
    cube = load_experiment(NAME).scene.body("cube")
    assert cube.inertia_kg_m2 == pytest.approx(0.295 * HALF_WIDTH_M**2, rel=1e-3)


def test_trials_of_a_half_are_independent_and_a_copy_gives_its_original():
    fit, judge = set(SHOTS.trials("fit")), set(SHOTS.trials("judge"))
    counts = len(SHOTS), len(SHOTS.trials()), len(fit), len(judge)
    assert counts == (499, 474, 238, 236)
    assert fit | judge == set(SHOTS.trials()) == set(range(499)) - set(SHOTS.copies)
    assert {trial % 2 for trial in fit} == {0}
    band = reference_band(with_trial(load_experiment(NAME), 123))
    assert band.source.startswith("trial 123 (the same recording as trial 49) of ")
    assert SHOTS.arrays["source_number"][[49, 123]].tolist() == [56, 140]


def test_a_band_of_a_trial_has_its_places_and_the_noise_of_measuring_them():
    shot, nuisances = SHOTS.shot(3), SHOTS.metadata["nuisances"]
    band = SHOTS.band(3, 60)
    for coordinate, places_m in zip(band.mean.T, shot.positions_m.T, strict=True):
        spline = CubicSpline(shot.times_s, places_m)
        times_s = np.minimum(np.arange(60) / 30.0, shot.times_s[-1])
        assert coordinate == pytest.approx(1e3 * spline(times_s))
    assert band.measured.sum() == np.floor(30.0 * shot.times_s[-1] + 1e-6) + 1
    noise = np.hypot(nuisances["position_noise_m"], nuisances["rest_height_std_m"])
    assert band.sigma == pytest.approx(1e3 * noise)
    with pytest.raises(ParameterError, match=r"trial 499 does not exist: .* 0 to 498"):
        SHOTS.shot(499)
