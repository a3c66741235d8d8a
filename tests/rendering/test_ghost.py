"""The ghost of a recorded mean: it has the mean in the measured coordinates, and the simulation in the others."""

import numpy as np
import pytest

from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.reference_path import (
    ghost_trajectory,
    reference_path,
    reference_text,
    reference_words,
)
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.references.bands import Band
from gauge_envs.references.grades import BandGrade


def band_along(direction, mean):
    count = len(mean)
    return Band(
        grade=BandGrade.TRIALS,
        unit="mm",
        coordinates=("along",),
        projection=np.array([direction]),
        mean=np.array(mean)[:, None],
        sigma=np.ones((count, 1)),
        measured=np.ones(count, dtype=bool),
        trial_count=3,
        source="a test",
    )


def test_only_the_measured_direction_moves():
    ghost = ghost_trajectory(
        band_along([0.6, 0.0, -0.8], [10.0, 20.0]),
        np.array([[0.0, 5.0, 0.0], [1.0, 6.0, 2.0]]),
    )
    # Along the direction, the second sample is at 0.6 - 1.6 = -1 mm, so 21 mm are missing.
    assert ghost == pytest.approx(
        np.array([[6.0, 5.0, -8.0], [1.0 + 0.6 * 21.0, 6.0, 2.0 - 0.8 * 21.0]])
    )


def test_frames_without_a_mean_have_no_ghost():
    ghost = ghost_trajectory(
        band_along([1.0, 0.0, 0.0], [3.0, np.nan]), np.zeros((3, 3))
    )
    assert ghost[0].tolist() == [3.0, 0.0, 0.0]
    assert np.isnan(ghost[1:, 0]).all()
    assert np.isnan(ghost[2]).all()


@pytest.mark.parametrize(
    "name", ["SlopeSlider-2-wood", "BouncingBall-rubber", "Turntable-1-wood"]
)
def test_a_ghost_has_the_mean_of_its_band(name):
    band = reference_band(load_experiment(name))
    g = np.random.default_rng(0).normal(size=(len(band.mean), band.projection.shape[1]))
    ghost = ghost_trajectory(band, g)
    known = np.isfinite(band.mean).all(axis=1)
    assert band.project(ghost[known]) == pytest.approx(band.mean[known])


def test_a_mean_is_named_by_the_number_of_its_trials():
    one, many, some = (reference_words(BandGrade.TRIALS, n) for n in (1, 20, None))
    assert "one" in one and "20 " in many
    assert some == many.replace("20 ", "the ") != one


def test_the_text_says_when_a_reference_ends_before_the_pictures():
    experiment = load_experiment("SlopeContact-wood")
    band = reference_band(experiment)
    path = reference_path(experiment, band)
    assert band is not None and path is not None
    # The law holds while the body slides down the seam: for 5 of 10 frames.
    assert np.isfinite(band.mean).all(axis=1).tolist() == [True] * 5 + [False] * 5
    assert path.last_s == pytest.approx(4 / 30)
    assert reference_text(band, path, end_s=0.3).endswith(", until 0.13 s")
    assert "until" not in reference_text(band, path, end_s=4 / 30)
