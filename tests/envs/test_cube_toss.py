"""Cube tosses as an environment: starts, seeds, scores, and free flight on every engine."""

import gymnasium
import numpy as np
import pytest

from gauge_envs import load_experiment, reference_band
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.kind import Kind
from gauge_envs.references.single_shot import single_shots
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import run_episodes
from gauge_envs.runs.request import RunRequest
from gauge_envs.scoring.reference import reference_kind

ID = "GAUGE/CubeToss-acrylic"
NAME = "CubeToss-acrylic"


def test_a_trial_starts_as_measured():
    shots = single_shots(NAME)
    env = gymnasium.make(ID)
    for trial in (0, 41):
        observation, info = env.reset(options={"trial": trial})
        shot, state = shots.shot(trial), observation["bodies"][0]
        assert info["trial"] == trial
        rates = [*shot.velocity_m_per_s, *shot.angular_velocity_rad_per_s]
        assert state[:3] == pytest.approx(shot.positions_m[0], abs=1e-9)
        assert state[7:] == pytest.approx(rates, abs=1e-9)
        assert abs(state[3:7] @ shot.quaternions[0]) == pytest.approx(1.0, abs=1e-12)
    env.close()


def test_the_seed_selects_the_trial():
    env = gymnasium.make(ID)
    assert env.reset(seed=7)[1]["trial"] == 7
    assert env.reset(seed=475)[1]["trial"] == 1
    assert env.reset()[1]["trial"] == 0
    with pytest.raises(ParameterError, match="trial 499 does not exist"):
        env.reset(options={"trial": 499})
    env.close()


def test_the_score_is_against_the_own_trial():
    env = gymnasium.make(ID)
    env.reset(options={"trial": 5})
    inner = env.unwrapped
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(0)
    score = info["score"]
    assert (score.kind, score.primary, score.time_offset_s) == (
        "trials",
        "rmse",
        None,
    )
    shots = single_shots(NAME)
    recorded = 1e3 * shots.shot(5).poses_at(np.arange(31) / 30.0)[0]
    errors = np.linalg.norm(inner.trajectory().frames - recorded, axis=1)
    assert score.rmse == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert 2.0 < score.rmse < 20.0
    assert reference_kind(NAME) is Kind.TRIALS
    env.close()


def test_overridden_starts_have_no_reference():
    assert (
        reference_band(load_experiment(NAME, {"cube.position_m": (0.0, 0.0, 0.5)}))
        is None
    )
    assert reference_band(load_experiment(NAME, {"cube.friction": 0.3})) is not None
    with pytest.raises(ParameterError, match="no single-shot trials"):
        with_trial(load_experiment("BouncingBall-rubber"), 0)


def test_worlds_and_repeats_toss_one_trial_each():
    results = run_episodes(RunRequest(NAME, seed=3, repeats=2))
    assert [result.jitter for result in results] == [{"trial": 3}, {"trial": 4}]
    worlds = gymnasium.make_vec(ID, num_envs=2)
    _, infos = worlds.reset(seed=3)
    assert infos["trial"].tolist() == [3, 4]
    truncated = np.zeros(2, dtype=bool)
    while not truncated.any():
        *_, truncated, infos = worlds.step(np.zeros(2, dtype=np.int64))
    assert [score.rmse for score in infos["score"]] == [
        result.score.rmse for result in results
    ]
    worlds.close()


def test_stored_repeats_are_found_again(tmp_path):
    request = RunRequest(NAME, seed=1, repeats=2)
    first = list(run_many([request], isolate=False, out=tmp_path))
    notes = []
    again = list(
        run_many(
            [request], isolate=False, out=tmp_path, resume=True, notify=notes.append
        )
    )
    assert [result.jitter for result in again] == [{"trial": 1}, {"trial": 2}]
    assert [result.created for result in again] == [result.created for result in first]
    assert not notes
