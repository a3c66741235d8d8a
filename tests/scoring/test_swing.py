"""Estimators of the swing metrics that the paper leaves open, event times, and an independent chain of collisions."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chain import event_driven_chain, simultaneous_impact

from gauge_envs import Score, load_experiment
from gauge_envs.backends import backend
from gauge_envs.errors import ReferenceFileError
from gauge_envs.files import data_folder
from gauge_envs.references import tables
from gauge_envs.references.published import published_baselines, recorded_events
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.scoring.implied import implied_parameters
from gauge_envs.scoring.events import momentum_transfer_efficiency
from gauge_envs.scoring.score import score_trajectory
from gauge_envs.scoring.swing import EventTime, event_intervals, swing_notes
from gauge_envs.tools.run.words import estimator_lines

CALIBRATED, EFFECTIVE = 0.202387, 0.9641474137084098


@pytest.fixture(scope="module")
def cradles() -> dict[str, Score]:
    return {
        name: run_episode(RunRequest("NewtonsCradle-metal", parameters=name)).score
        for name in ("calibrated", "effective")
    }


# Longest stationary duration


def test_the_speed_decides_the_longest_rest(cradles: dict[str, Score]) -> None:
    """With 93 % of the momentum handed on, the last ball drifts at 6 to 46 mm/s: it rests in height, not in space."""
    score = cradles["effective"]
    assert score.lsd_s == pytest.approx(13 / 30)
    assert score.lsd_central_s == pytest.approx(11 / 30)
    assert score.lsd_speed_3d_s == pytest.approx(2 / 30)
    assert score.lsd_dropped_rests_s == pytest.approx((7 / 30, 0.0))
    assert score.lsd_speed_3d_normalized == pytest.approx(2 / 30 / 0.38)
    assert score.lsd_central_normalized == pytest.approx(11 / 30 / 0.38)


def test_the_calibrated_cradle_rests_for_a_step_or_not_at_all(
    cradles: dict[str, Score],
) -> None:
    """The published engines hand on the same momentum and have an LSD of 0, as with central differences."""
    score, published = cradles["calibrated"], published_baselines("NewtonsCradle-metal")
    assert score.mte_normalized == pytest.approx(
        published["mte"].engines["newton"], abs=0.005
    )
    assert published["lsd"].engines["newton"] == 0.0
    assert score.lsd_central_s == 0.0
    assert score.lsd_s == pytest.approx(2 / 30)
    assert max(score.lsd_dropped_rests_s or ()) > 0.2


# Period


def test_the_period_is_between_the_bins_or_on_one(rollout: Callable) -> None:
    score = rollout("Pendulum-metal", settings={"timestep_s": 1 / 360})[2]["score"]
    assert score.pd_s == pytest.approx(1.2303, abs=2e-4)
    assert score.pd_fft_s == pytest.approx(10 / 8)
    assert (
        round(score.pd_fft_normalized, 2)
        == published_baselines("Pendulum-metal")["pd"].engines["isaacsim"]
    )
    (line,) = estimator_lines("Pendulum-metal", score)
    assert "1.230 s (1.08)" in line and "1.250 s (1.10)" in line


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_period_and_decay_do_not_depend_on_the_axis_nor_on_the_place(axis: str) -> None:
    experiment = load_experiment("Pendulum-metal")
    experiment = replace(
        experiment, score=experiment.score.model_copy(update={"period_axis": axis})
    )
    times_s = np.arange(18000) / 180.0
    along_mm = 200.0 * np.exp(-0.03 * times_s) * np.cos(2.0 * np.pi * times_s / 1.04)
    anchor_mm = 1e3 * np.array(experiment.scene.joints[0].anchor_m)
    values = np.tile(anchor_mm, (len(times_s), 1))
    values[:, "xyz".index(axis)] += along_mm
    period, decay = implied_parameters(experiment, None, times_s=times_s, values=values)
    assert (period.parameter, decay.parameter) == ("period", "decay_rate")
    assert period.value == pytest.approx(1.04, rel=1e-3)
    assert decay.value == pytest.approx(0.03, rel=1e-3)
    notes = swing_notes(experiment, values[::6], times_s=times_s, values=values)
    # A bin of ten seconds is a whole number of periods.
    assert 10.0 / notes["pd_fft_s"] == pytest.approx(round(10.0 / 1.04), abs=1e-9)
    mean_s = experiment.baselines["pd"].mean
    assert notes["pd_fft_normalized"] == pytest.approx(notes["pd_fft_s"] / mean_s)


@pytest.mark.parametrize("other_s", [1.3, 1.9])
@pytest.mark.parametrize(
    ("metric", "other", "frames"),
    [("pd", "pd_fft_s", 0.0), ("lsd", "lsd_central_s", 1.0)],
)
def test_an_interval_of_an_event_is_by_the_guide(
    metric: str, other: str, frames: float, other_s: float
) -> None:
    """A rectangle between the estimators, one of a frame, and the standard error of twenty trials (GUM 4.3.7)."""
    line = replace(published_baselines("Pendulum-metal")["pd"], mean=1.6, std=0.4)
    intervals = event_intervals({metric: 1.3}, {other: other_s}, {metric: line})
    of_estimator = np.hypot(other_s - 1.3, 0.5 * frames / 30.0) / 3**0.5 / 1.6
    of_trials = 0.4 / 20**0.5 * 1.3 / 1.6**2
    half = 1.959964 * np.hypot(of_estimator, of_trials)
    assert intervals == {
        f"{metric}_normalized_95": pytest.approx(
            (1.3 / 1.6 - half, 1.3 / 1.6 + half), rel=1e-6
        )
    }


# Events


def test_events_stand_beside_those_of_the_recording(cradles: dict[str, Score]) -> None:
    events = cradles["effective"].events
    assert events is not None
    assert [(event.quantity, event.number) for event in events] == [
        (quantity, number)
        for quantity in ("leaves", "returns", "rests")
        for number in (1, 2, 3)
    ]
    rests = [event for event in events if event.quantity == "rests"]
    assert [event.recorded_s for event in rests] == [0.41, 0.37, 0.33]
    assert [event.simulated_s for event in rests] == pytest.approx(
        [0.44, 0.43, 0.43], abs=0.01
    )
    returns, leaves = (
        [event.simulated_s for event in events if event.quantity == name]
        for name in ("returns", "leaves")
    )
    assert rests[0].simulated_s == pytest.approx(leaves[1] - returns[0])
    # The first swing agrees with the recording, and later ones fall behind: the real row no longer stays still.
    assert abs(leaves[0] - 0.20) < 0.05 < abs(leaves[2] - 1.78)


def test_events_survive_json_and_are_printed(cradles: dict[str, Score]) -> None:
    score = cradles["calibrated"]
    again = Score.from_dict(json.loads(json.dumps(score.to_dict())))
    assert again == score
    assert again.events is not None and isinstance(again.events[0], EventTime)
    lines = list(estimator_lines("NewtonsCradle-metal", score))
    assert len(lines) == 4
    assert "0.067 s (0.18). With central differences it is 0.000 s (0.00)" in lines[0]
    assert "last ball rests [s], simulated / recorded (+- 0.04)" in lines[3]


def test_a_ball_that_stays_has_no_simulated_events() -> None:
    experiment = load_experiment("NewtonsCradle-metal")
    still = np.tile(
        1e3 * np.array(experiment.scene.body("ball-5").pose.position_m),
        (experiment.frame_count, 1),
    )
    times_s = np.arange(len(still)) / 30
    score = score_trajectory(
        experiment, None, times_s=times_s, values=still, is_checked=True
    )
    assert score.events is not None and {
        event.simulated_s for event in score.events
    } == {None}
    assert score.lsd_dropped_rests_s == pytest.approx((1027 / 30, 1027 / 30))
    assert score.lsd_s == 0.0


def test_other_experiments_have_no_events(rollout: Callable) -> None:
    score = rollout("SlopeSlider-2-wood")[2]["score"]
    assert (score.events, score.lsd_dropped_rests_s, score.pd_fft_s) == (
        None,
        None,
        None,
    )
    assert recorded_events("SlopeSlider-2-wood") == ()
    assert list(estimator_lines("SlopeSlider-2-wood", score)) == []


def test_damaged_events_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "scoring" / "bands"
    folder.mkdir(parents=True)
    text = (data_folder("scoring") / "bands" / "events.toml").read_text()
    (folder / "events.toml").write_text(text.replace("0.37", "-0.37"))
    monkeypatch.setattr(tables, "data_folder", lambda name: tmp_path / name)
    with pytest.raises(
        ReferenceFileError, match=r"events\.2\.values_s\.1: .*given: -0\.37"
    ):
        recorded_events("NewtonsCradle-metal")


# An independent chain of collisions


def test_chains_of_elastic_and_plastic_balls_are_known() -> None:
    assert event_driven_chain(1.0) == pytest.approx([0, 0, 0, 0, 1])
    assert event_driven_chain(0.0) == pytest.approx(np.full(5, 0.2), abs=1e-9)
    assert event_driven_chain(EFFECTIVE)[-1] == pytest.approx(
        ((1 + EFFECTIVE) / 2) ** 4
    )
    for restitution in (0.0, CALIBRATED, 0.7, EFFECTIVE):
        assert event_driven_chain(restitution).sum() == pytest.approx(1.0)
        assert simultaneous_impact(restitution).sum() == pytest.approx(1.0)


def test_the_calibrated_chain_hands_on_a_fifth() -> None:
    """After some 260 collisions all balls move together, so that restitution has no effect any more."""
    assert event_driven_chain(CALIBRATED) == pytest.approx(np.full(5, 0.2), abs=1e-9)
    assert simultaneous_impact(CALIBRATED)[-1] == pytest.approx(0.2405, abs=1e-4)


def test_touching_balls_share_one_impact(cradles: dict[str, Score]) -> None:
    """The resting row is in contact and moves on as one body, which gives (1 + e) / 5 in place of a fifth."""
    assert cradles["calibrated"].mte == pytest.approx(
        simultaneous_impact(CALIBRATED)[-1], rel=0.01
    )


def transfer(
    gap_m: float, *, steps_per_s: int, restitution: float | None = None
) -> float:
    """Return the momentum that the first impact hands on in MuJoCo, with gaps between neighbours."""
    scene = load_experiment("NewtonsCradle-metal").scene
    anchors = {joint.body: joint.anchor_m for joint in scene.joints}
    balls = [f"ball-{number}" for number in range(1, 6)]
    overrides: dict[str, Any] = {}
    for number, ball in enumerate(balls):
        x, y, z = anchors[ball]
        overrides[f"{ball}.hangs_from_m"] = (x, y + number * gap_m, z)
    if restitution is not None:
        # The contacts of all balls have that of the first.
        overrides[f"{balls[0]}.restitution"] = restitution
    scene = load_experiment("NewtonsCradle-metal", overrides).scene
    simulation = backend("mujoco").build(scene, {"timestep_s": 1.0 / steps_per_s})
    simulation.reset(0)
    heights_mm = []
    # The last ball turns within 0.6 s for every gap.
    for _ in range(round(0.6 / SAMPLE_INTERVAL_S)):
        heights_mm.append(1e3 * simulation.body_states([balls[-1]])[0, 2])
        simulation.advance(SAMPLE_INTERVAL_S)
    rest_mm = 1e3 * scene.body(balls[-1]).pose.position_m[2]
    return momentum_transfer_efficiency(
        np.array(heights_mm),
        drop_height_mm=1e3 * anchors[balls[-1]][2] - rest_mm,
        rest_height_mm=rest_mm,
    )


def test_balls_with_a_gap_collide_one_after_another() -> None:
    """A gap that takes many steps to close separates the collisions, and the simulation finds those of the chain."""
    assert transfer(1e-3, steps_per_s=36000) == pytest.approx(
        event_driven_chain(CALIBRATED)[-1], rel=0.005
    )
    assert transfer(1e-3, steps_per_s=1800) == pytest.approx(0.206, abs=0.002)


def test_the_effective_chain_does_not_depend_on_the_gap() -> None:
    expected = event_driven_chain(EFFECTIVE)[-1]
    for gap_m in (0.0, 1e-3):
        assert transfer(
            gap_m, steps_per_s=9000, restitution=EFFECTIVE
        ) == pytest.approx(expected, rel=0.003)
