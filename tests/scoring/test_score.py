"""The score: distances known by hand, verdicts at their limits, scenes without a score, and stored forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from places import first_of_each_kind
from pydantic import TypeAdapter

from gauge_envs import Score, load_experiment, reference_band, variants
from gauge_envs.references.published import published_baselines
from gauge_envs.scoring.answers import Answer
from gauge_envs.scoring.estimates import ComparedQuantity
from gauge_envs.scoring.reference import refusal
from gauge_envs.scoring.trajectory import score_trajectory
from gauge_envs.scoring.user_file.likely_mistakes import start_values

NAMES = [variant.name for variant in variants()]


def still_score(experiment, band, **options):
    """Return the score of a scene in which nothing moves."""
    times_s = np.arange(experiment.frame_count) / 30.0
    markers = experiment.scene.markers
    markers_m = None
    if markers is not None:
        markers_m = np.tile(markers.positions_m, (len(times_s), 1, 1))
    return score_trajectory(
        experiment,
        band,
        times_s=times_s,
        values=np.tile(start_values(experiment), (len(times_s), 1)),
        markers_m=markers_m,
        **options,
    )


def score_of(name, *, shift_mm=0.0, sigmas=0.0, has_markers=True):
    """Return the band, and the score of its mean that is moved by mm or standard deviations of real trials."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    moved = np.nan_to_num(band.mean) + sigmas * np.nan_to_num(band.sigma)
    moved[:, 0] += shift_mm
    markers_m = None
    if has_markers and band.points is not None:
        places_mm = np.nan_to_num(band.points.mean).reshape(len(moved), -1, 3)
        markers_m = 1e-3 * np.add(places_mm, [shift_mm, 0.0, 0.0])
    return band, score_trajectory(
        experiment,
        band,
        times_s=np.arange(len(moved)) / 30.0,
        values=moved @ np.linalg.pinv(band.projection).T,
        markers_m=markers_m,
        is_checked=True,
    )


@pytest.mark.parametrize("name", ["Turntable-1-wood", "SlopeSlider-3-plastic"])
def test_3_mm_from_a_solution_are_3_mm_of_its_motion(name):
    band, score = score_of(name, shift_mm=3.0)
    size, half_width = band.zero_motion_distance, 1.96 * band.standard_uncertainty
    assert (score.rmse, score.distance) == pytest.approx((3.0, 3.0))
    assert score.dtw <= 3.0 + 1e-9
    assert (score.solution_distance, score.solution_motion) == (score.rmse, size)
    ends = [(3.0 - half_width) / size, (3.0 + half_width) / size]
    assert score.primary_interval == pytest.approx(ends)
    # 3 mm are more than 2 % of a motion of 97 or 53 mm.
    assert score.solves is Answer.NO
    experiment = load_experiment(name)
    assert "had noise" in still_score(experiment, band, is_moved=True).refused
    assert score_of(name)[1].solves is Answer.YES


def test_cloth_is_compared_by_markers_and_needs_them():
    band, score = score_of("TextileFlinging-satin", shift_mm=3.0)
    assert (score.distance, score.distance_unit) == (pytest.approx(3.0), "mm")
    ratio = 3.0 / band.zero_motion_distance
    assert score.primary_normalized == pytest.approx(ratio)
    _, without = score_of("TextileFlinging-satin", has_markers=False)
    assert without.distance is None and without.rmse == pytest.approx(0.0)
    assert "markers" in without.refused and without.solves is None


def test_a_motion_is_compared_with_the_scatter_of_real_trials():
    band, score = score_of("SlopeSlider-2-wood", sigmas=1.5)
    expected = np.sqrt(np.mean(np.square(1.5 * band.sigma)))
    assert score.rmse == pytest.approx(expected)
    for metric, row in published_baselines("SlopeSlider-2-wood").items():
        ratio = getattr(score, metric) / row.mean
        assert getattr(score, f"{metric}_normalized") == pytest.approx(ratio)
    assert score.primary == "rmse_aligned" and score.compared_frames == 19
    of_trials = band.trial_rmse_aligned
    assert score.real_limit == of_trials.max()
    ratio = score.rmse_aligned / of_trials.mean()
    assert score.primary_normalized == pytest.approx(ratio)
    low, high = score.primary_interval
    assert low <= ratio < high


def test_a_recording_of_a_driven_scene_is_compared_without_a_shift():
    band, score = score_of("Turntable-3-metal", shift_mm=50.0)
    u = band.standard_uncertainty
    assert (score.primary, score.rmse) == ("rmse", pytest.approx(50.0))
    baseline = published_baselines("Turntable-3-metal")["rmse"].mean
    low, high = score.primary_interval
    assert low < (50.0 - 1.96 * u) / baseline < (50.0 + 1.96 * u) / baseline < high
    assert score.real_limit == pytest.approx(1.96 * u)
    assert score.like_reality is Answer.NO


def test_the_interval_of_two_trials_is_students():
    band, score = score_of("SiliconeBeam-0g-silicone", shift_mm=1.0)
    assert len(band.trials) == 2
    scatter = band.length(band.sigma)
    # Student's t for one degree of freedom is 12.7; one more trial scatters around the mean of two.
    assert score.real_limit == pytest.approx(12.706 * scatter * 1.5**0.5, rel=1e-3)
    assert score.like_reality is Answer.CANNOT_TELL


def test_an_exact_pendulum_has_the_recorded_event_without_the_recorded_loss():
    event = score_of("Pendulum-metal")[1].events["turning_ratio"]
    assert event.value == pytest.approx(1.0, abs=0.01)
    assert (event.real, event.answer) == (0.925, Answer.NO)


@pytest.mark.parametrize("name", first_of_each_kind(NAMES))
def test_every_id_scores_a_scene_in_which_nothing_moves(name):
    experiment = load_experiment(name)
    band = reference_band(experiment)
    score = still_score(experiment, band)
    stored = json.loads(json.dumps(score.to_dict()))
    assert TypeAdapter(Score).validate_python(stored) == score
    assert score.summary().endswith(".") and len(repr(score).splitlines()) <= 10
    if band is not None and not name.startswith("SlopeSlider-1"):
        answer = score.solves if band.kind.is_solution else score.like_reality
        assert answer is Answer.NO
        distance = pytest.approx(band.zero_motion_distance, rel=0.2)
        assert score.distance == distance or score.primary.startswith("rmse")


@pytest.mark.parametrize(
    ("name", "parameters", "part"),
    [
        ("SlopeSlider-2-wood", {"scene.gravity_m_per_s2": 1.62}, "gravity"),
        ("SlopeSlider-2-wood", {"cube.friction": 0.2}, None),
        ("SlopeSlider-3-wood", "measured", "friction"),
    ],
)
def test_a_scene_that_the_reference_cannot_score_has_a_reason(name, parameters, part):
    """Real trials score any constants in the real geometry; a solution scores only the scene of the task file."""
    experiment = load_experiment(name, parameters)
    band = reference_band(experiment)
    score = still_score(experiment, band)
    assert score.refused == refusal(experiment, band)
    if part is None:
        assert score.refused is None and score.rmse is not None
        # Trials score a start with noise; solutions do not.
        assert still_score(experiment, band, is_moved=True).refused is None
    else:
        assert part in score.refused
        assert (score.rmse, score.solves) == (None, None)


def test_the_published_energy_loss_is_an_ideal_and_a_period_is_real():
    loss = ComparedQuantity(value=0.034, unit="1", real=0.0)
    events = {"pd": EVENT, "el": loss}
    score = Score(kind="analytic", unit="mm", events=events)
    said = replace(score, like_reality=Answer.NO).summary()
    assert "energy loss 0.034 (ideal 0)" in said
    assert (
        "Unlike" not in said
        and "unlike reality: period 1.19 s (real 1 +- 0.1 s)" in said
    )


EVENT = ComparedQuantity(value=1.19, unit="s", real=1.0, real_uncertainty=0.1)


def test_an_event_is_real_within_1_96_of_its_uncertainty():
    assert EVENT.answer is Answer.YES and EVENT.over_real == pytest.approx(1.19)
    assert replace(EVENT, value=1.2).answer is Answer.NO
    assert replace(EVENT, value=0.8).answer is Answer.NO
    assert replace(EVENT, value=None).answer is Answer.NO
    assert replace(EVENT, real_uncertainty=None).answer is None
    # 1.96 u above 20 % of the value is consistent with an error of 20 %.
    wide = replace(EVENT, value=1.1, real_uncertainty=0.15)
    assert wide.answer is Answer.CANNOT_TELL
