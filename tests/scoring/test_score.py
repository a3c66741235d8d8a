"""The flat score: distances known in closed form, verdicts, refusals, words and stored forms."""

import json
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from places import one_of_a_kind

from gauge_envs import Score, load_experiment, reference_band, variants
from gauge_envs.errors import ResultFileError
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import parse_result
from gauge_envs.runs.score_file import score_file
from gauge_envs.scoring.estimates import Measured
from gauge_envs.scoring.likely_mistakes import start_values
from gauge_envs.scoring.reference import refusal
from gauge_envs.scoring.score import score_trajectory

NAMES = [one.name for one in variants()]


def still(experiment):
    """Times of the frames and g(t) of a scene in which nothing moves."""
    times_s = np.arange(experiment.frame_count) / 30.0
    values = np.tile(start_values(experiment), (len(times_s), 1))
    markers = experiment.scene.markers
    if markers is None:
        return times_s, values, None
    return times_s, values, np.tile(markers.positions_m, (len(times_s), 1, 1))


def score_of(name, *, shift_mm=0.0):
    """Score of the mean of a reference, moved along x by a number of mm."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    times_s, _, _ = still(experiment)
    values = np.nan_to_num(band.mean).copy()
    values[:, 0] += shift_mm
    markers_m = None
    if band.points is not None:
        markers_m = 1e-3 * np.nan_to_num(band.points.mean).reshape(len(times_s), -1, 3)
        markers_m[:, :, 0] += 1e-3 * shift_mm
    return score_trajectory(
        experiment,
        band,
        times_s=times_s,
        values=values,
        markers_m=markers_m,
        is_checked=True,
    )


@pytest.mark.parametrize("name", ["Turntable-1-wood", "SlopeSlider-3-plastic"])
def test_a_shift_of_3_mm_is_a_distance_of_3_mm(name):
    band, score = reference_band(load_experiment(name)), score_of(name, shift_mm=3.0)
    assert (score.rmse, score.distance) == pytest.approx((3.0, 3.0))
    u = band.standard_uncertainty
    assert score.over_uncertainty == pytest.approx(3.0 / u)
    assert score.rmse_95 == pytest.approx((max(3.0 - 1.96 * u, 0.0), 3.0 + 1.96 * u))
    assert score.verdict == ("outside" if 1.96 * u < 3.0 else "inside")
    assert score_of(name).verdict == "inside"


def test_cloth_is_compared_by_markers_and_needs_them():
    score = score_of("TextileFlinging-satin", shift_mm=3.0)
    assert score.marker_rmse_mm == pytest.approx(3.0)
    assert (score.distance, score.distance_unit) == (score.marker_rmse_mm, "mm")
    experiment = load_experiment("TextileFlinging-satin")
    band = reference_band(experiment)
    without = score_trajectory(
        experiment,
        band,
        times_s=still(experiment)[0],
        values=np.nan_to_num(band.mean),
        is_checked=True,
    )
    assert without.over_uncertainty is None and without.rmse == 0.0
    assert "markers" in without.refused and without.verdict == "no reference"


@pytest.mark.parametrize("name", one_of_a_kind(NAMES))
def test_every_id_answers_in_one_sentence_and_ten_lines(name):
    experiment = load_experiment(name)
    times_s, values, markers_m = still(experiment)
    score = score_trajectory(
        experiment,
        reference_band(experiment),
        times_s=times_s,
        values=values,
        markers_m=markers_m,
    )
    assert score.summary().endswith(".") and "\n" not in score.summary()
    assert len(repr(score).splitlines()) <= 10
    assert Score.from_dict(json.loads(json.dumps(score.to_dict()))) == score
    has_reference = reference_band(experiment) is not None
    if has_reference and not name.startswith("SlopeSlider-1"):
        assert score.verdict == "outside"
        assert score.distance == pytest.approx(
            reference_band(experiment).zero_motion_distance, rel=0.2
        ) or score.primary.startswith("rmse")


@pytest.mark.parametrize(
    ("name", "parameters", "part"),
    [
        ("SlopeSlider-2-wood", {"scene.gravity_m_per_s2": 1.62}, "gravity"),
        ("SlopeSlider-2-wood", {"cube.position_m": [0.1, 0.4, 0.5]}, "position_m"),
        ("SlopeSlider-2-wood", {"cube.position_m": [0.1, 0.4, 0.36]}, None),
        ("BouncingBall-rubber", "recorded", None),
        ("SlopeSlider-2-wood", {"cube.friction": 0.2}, None),
        ("SlopeSlider-2-wood", "effective", None),
        ("Pendulum-metal", {"scene.gravity_m_per_s2": 9.0}, "gravity"),
        ("SlopeSlider-3-wood", {"cube.friction": 0.2}, "friction"),
        ("SlopeSlider-3-wood", "effective", "friction"),
        (
            "TextileFlinging-satin",
            {"textile.areal_density_kg_per_m2": 0.2},
            "areal_density",
        ),
    ],
)
def test_what_a_reference_cannot_judge_has_no_score_and_one_reason(
    name, parameters, part
):
    experiment = load_experiment(name, parameters)
    band = reference_band(experiment)
    reason = refusal(experiment, band)
    assert (reason is None) == (part is None)
    times_s, values, markers_m = still(experiment)
    score = score_trajectory(
        experiment, band, times_s=times_s, values=values, markers_m=markers_m
    )
    assert score.refused == reason
    if part is not None:
        assert part in reason and "differs" in reason
        assert (score.rmse, score.verdict) == (None, "no reference")


@pytest.mark.parametrize(
    ("name", "is_refused"),
    [("SlopeSlider-3-wood", True), ("SlopeSlider-2-wood", False)],
)
def test_a_scattered_start_is_scored_against_trials_alone(name, is_refused):
    env = gymnasium.make(f"GAUGE/{name}")
    env.reset(seed=1, options={"jitter": True})
    rewards, over = [], False
    while not over:
        _, reward, _, over, info = env.step(env.action_space.sample() * 0)
        rewards.append(reward)
    assert (info["score"].refused is not None) == is_refused
    # A reward follows the reference also where the score is refused.
    assert any(rewards)


def test_a_stored_result_of_cloth_keeps_its_marker_distance(tmp_path):
    result = run_episode(RunRequest("FoamStretching-soft"))
    cloth = run_episode(RunRequest("FoamShearing-soft", parameters="calibrated"))
    for number, one in enumerate((result, cloth)):
        file = tmp_path / f"{number}.json"
        file.write_text(json.dumps(one.to_dict()))
        again, _ = score_file(file)
        assert again.score.over_uncertainty == pytest.approx(
            one.score.over_uncertainty, rel=1e-4
        )
        assert again.score.verdict == one.score.verdict
    assert cloth.score.marker_rmse_mm is not None
    content = json.loads(file.read_text())
    content["score"] = {"grade": "model", "unit": "mm^2"}
    with pytest.raises(ResultFileError, match=r"0\.3 or earlier: `gauge score FILE`"):
        parse_result(json.dumps(content).encode(), "old.json")


def test_an_event_is_inside_within_its_uncertainty_and_decides_without_a_reference():
    event = Measured(value=1.2, unit="s", real=1.0, real_uncertainty=0.1)
    assert event.is_inside is False and event.over_real == pytest.approx(1.2)
    near = replace(event, value=1.19)
    assert near.is_inside is True and replace(event, value=None).is_inside is False
    assert replace(event, real_uncertainty=None).is_inside is None
    score = Score(kind="none", unit="mm", events={"period": near})
    assert score.verdict == "inside"
    assert replace(score, events={"period": event}).verdict == "outside"
    assert replace(score, events={}).verdict == "no reference"
