"""Cube tosses as an environment: starts, seeds, scores, and free flight on every engine."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gauge_envs import load_experiment, reference_band
from gauge_envs.backends import backend_for, backend_names
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.errors import MissingExtraError, ParameterError
from gauge_envs.evaluation.reference import band_grade
from gauge_envs.experiments.resolve import with_trial
from gauge_envs.references.grades import BandGrade
from gauge_envs.references.single_shot import single_shots
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.episodes import run_episodes
from gauge_envs.runs.request import RunRequest

ID = "GAUGE/CubeToss-acrylic"
NAME = "CubeToss-acrylic"
ENGINES = tuple(
    name
    for name in backend_names()
    if name in ("mujoco", "rapier", "pybullet", "physx")
)


def test_a_trial_starts_as_measured():
    shots = single_shots(NAME)
    assert shots is not None
    env = gymnasium.make(ID)
    for trial in (0, 41):
        observation, info = env.reset(options={"trial": trial})
        shot = shots.shot(trial)
        assert info["trial"] == trial
        np.testing.assert_allclose(
            observation["bodies"][0, :3], shot.positions_m[0], atol=1e-9
        )
        np.testing.assert_allclose(
            observation["bodies"][0, 7:10], shot.velocity_m_per_s, atol=1e-9
        )
        np.testing.assert_allclose(
            observation["bodies"][0, 10:], shot.angular_velocity_rad_per_s, atol=1e-9
        )
        turned = Rotation.from_quat(observation["bodies"][0, 3:7], scalar_first=True)
        assert (
            turned * Rotation.from_quat(shot.quaternions[0], scalar_first=True).inv()
        ).magnitude() < 1e-7
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
    assert isinstance(inner, GaugeEnv)
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(0)
    score = info["score"]
    assert (score.grade, score.primary, score.release_offset_s) == (
        "trials",
        "rmse",
        None,
    )
    shots = single_shots(NAME)
    assert shots is not None
    recorded = 1e3 * shots.shot(5).poses_at(np.arange(31) / 30.0)[0]
    errors = np.linalg.norm(inner.trajectory().frames - recorded, axis=1)
    assert score.rmse == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert 2.0 < score.rmse < 20.0
    assert band_grade(NAME) is BandGrade.TRIALS
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


@pytest.mark.parametrize("engine", [*ENGINES, "drake"])
@pytest.mark.parametrize("inertia", [8.1e-4, 1.6e-3])
def test_an_impact_depends_on_the_stated_moment_of_inertia(engine, inertia):
    """A drop on one corner without friction: an impulse J at the arm r changes the spin by r x J / I."""
    start = {
        "cube.position_m": (0.0, 0.0, 0.3),
        "cube.euler_deg": (35.0, 25.0, 0.0),
        "cube.friction": 0.0,
    }
    experiment = load_experiment(
        NAME, {"cube.inertia_kg_m2": inertia, "cube.restitution": 0.5, **start}
    )
    try:
        world = backend_for(engine, None).build(experiment.scene)
    except MissingExtraError:
        pytest.skip(f"{engine} is not installed")
    world.reset(0)
    states = [world.body_states(("cube",))[0]]
    for _ in range(60):
        world.advance(1.0 / 180.0)
        states.append(world.body_states(("cube",))[0])
    world.close()
    spins = np.array([state[10:] for state in states])
    speeds = np.array([state[9] for state in states]) + 9.80665 * np.arange(61) / 180.0
    hit = int(np.argmax(np.abs(np.diff(speeds)) > 0.05))
    before, after = hit, hit + 1
    assert np.abs(spins[:before]).max() < 1e-9
    impulse = 0.37 * (speeds[after] - speeds[before])
    gained = spins[after] - spins[before]
    corners = Rotation.from_quat(states[before][3:7], scalar_first=True).apply(
        experiment.scene.body("cube").shape.corners_m
    )
    arm = corners[np.argmin(corners[:, 2])]
    expected = np.cross(arm, [0.0, 0.0, impulse]) / inertia
    assert np.linalg.norm(gained - expected) < 0.05 * np.linalg.norm(expected)
