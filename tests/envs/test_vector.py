"""Vector environments: seeds, pictures, specs, and scores in every mode of autoreset."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from opengl import needs_opengl

from gauge_envs import GaugeEnv, Score
from gauge_envs.envs.vector import GaugeVectorEnv, ScoreEpisodes
from gauge_envs.errors import (
    EpisodeError,
)

RIGID, DRIVEN, SOFT = "SlopeSlider-2-wood", "SlopeSlider-3-metal", "StickStack-soft"
COARSE = {"timestep_s": 1 / 900}
"""A step for what does not depend on it."""


def zeros(envs):
    return np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)


def run_to_end(envs, actions=None):
    """Steps until every world's episode is over."""
    steps, over = [], np.zeros(envs.num_envs, dtype=bool)
    while not over.all():
        steps.append(envs.step(zeros(envs) if actions is None else actions()))
        over |= steps[-1][2] | steps[-1][3]
    return steps


def blow_up(envs, number):
    """Give a world's body a speed that nothing in the scene can give it."""
    envs.unwrapped.rollout.simulation.datas[number].qvel[0] = 900.0


# --- native ---


def test_make_vec_makes_the_native_one_by_default():
    envs = gymnasium.make_vec(f"GAUGE/{RIGID}", num_envs=2)
    assert isinstance(envs, ScoreEpisodes)
    assert isinstance(envs.unwrapped, GaugeVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.metadata["render_fps"] == 30
    assert envs.unwrapped.spec.id == f"GAUGE/{RIGID}"


def test_observations_are_in_the_batched_space():
    envs = gymnasium.make_vec(f"GAUGE/{DRIVEN}", num_envs=3)
    observation, infos = envs.reset(seed=0)
    assert observation in envs.observation_space
    assert infos["frame"].tolist() == [0, 0, 0]
    observation, rewards, *_ = envs.step(envs.action_space.sample())
    assert observation in envs.observation_space
    assert rewards.shape == (3,)


def test_observations_are_not_overwritten_by_the_next_step():
    envs = gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=2)
    first, _ = envs.reset(seed=0)
    kept = first["observable"].copy()
    envs.step(zeros(envs))
    assert np.array_equal(first["observable"], kept)


def test_each_world_takes_its_own_seed_and_the_calibrated_start_comes_back():
    envs = gymnasium.make_vec(f"GAUGE/{RIGID}", num_envs=3)
    calibrated = envs.reset(seed=0)[0]["bodies"]
    together = envs.reset(seed=7, options={"jitter": True})[0]["bodies"]
    assert envs.unwrapped.seeds_used == (7, 8, 9)
    chosen = envs.reset(seed=[9, 7, 8], options={"jitter": True})[0]["bodies"]
    assert np.array_equal(chosen, together[[2, 0, 1]])
    assert np.array_equal(envs.reset(seed=7)[0]["bodies"], calibrated)


def test_episode_statistics_of_a_divergence():
    envs = RecordEpisodeStatistics(
        gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=2)
    )
    envs.reset(seed=0)
    envs.step(zeros(envs))
    blow_up(envs, 0)
    assert envs.step(zeros(envs))[4]["episode"]["l"].tolist() == [2, 0]
    assert run_to_end(envs)[-1][4]["episode"]["l"].tolist() == [0, 17]


@needs_opengl
@pytest.mark.parametrize("name", [RIGID, SOFT])
def test_pictures_are_those_of_single_environments(name):
    size = {"render_mode": "rgb_array", "width": 80, "height": 60}
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=2, **size)
    env = gymnasium.make(f"GAUGE/{name}", **size)
    with pytest.raises(EpisodeError, match="reset"):
        envs.render()
    envs.reset(seed=0)
    env.reset(seed=0)
    action = zeros(envs)
    for _ in range(4):
        envs.step(action)
        env.step(action[0])
    expected = env.render()
    assert len(np.unique(expected)) > 10
    # The first picture of a renderer may differ in a rounding of its normals.
    assert all(
        np.abs(picture.astype(int) - expected).max() <= 1 for picture in envs.render()
    )
    envs.close()
    env.close()
    assert gymnasium.make_vec(f"GAUGE/{name}", num_envs=2).render() is None


def test_spec_of_a_vector_environment_rebuilds_it():
    envs = gymnasium.make_vec(
        f"GAUGE/{RIGID}", num_envs=3, parameters={"cube.friction": 0.2}
    )
    again = gymnasium.make_vec(EnvSpec.from_json(envs.unwrapped.spec.to_json()))
    assert again.num_envs == 3
    assert again.unwrapped.experiment.overrides == {"cube.friction": 0.2}


# --- sync and async ---


@pytest.mark.parametrize(
    ("name", "mode", "autoreset"),
    [
        (RIGID, "sync", "NextStep"),
        (RIGID, "async", "SameStep"),
        (DRIVEN, "sync", "SameStep"),
        (DRIVEN, "async", "NextStep"),
        pytest.param(SOFT, "sync", "SameStep", marks=pytest.mark.slow),
        pytest.param(SOFT, "async", "NextStep", marks=pytest.mark.slow),
    ],
)
def test_scores_arrive_from_sub_environments(name, mode, autoreset):
    count = 6 if (name, mode) == (RIGID, "sync") else 2
    envs = ScoreEpisodes(
        gymnasium.make_vec(
            f"GAUGE/{name}",
            num_envs=count,
            vectorization_mode=mode,
            vector_kwargs={"autoreset_mode": AutoresetMode(autoreset)},
            settings=COARSE,
        )
    )
    envs.reset(seed=0)
    for _ in range(2):
        steps = run_to_end(envs)
        infos = steps[-1][4]
        assert infos["_score"].all()
        assert all(isinstance(score, Score) for score in infos["score"])
        assert "score" not in steps[-2][4]
        if autoreset == "SameStep":
            assert infos["final_info"]["score"][0] == infos["score"][0]
        else:
            envs.step(zeros(envs))
    envs.close()


@pytest.mark.parametrize("vector", [SyncVectorEnv, AsyncVectorEnv])
def test_bare_sub_environments_are_scored(vector):
    envs = ScoreEpisodes(vector([lambda: GaugeEnv(RIGID)] * 2))
    envs.reset(seed=0)
    scores = run_to_end(envs)[-1][4]["score"]
    assert [score.kind for score in scores] == ["trials"] * 2
    envs.close()
    envs = ScoreEpisodes(
        vector([lambda: GaugeEnv(RIGID)] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    )
    envs.reset(seed=0)
    with pytest.raises(EpisodeError, match=r"gymnasium\.make"):
        run_to_end(envs)
    envs.close()


@pytest.mark.parametrize("autoreset", AutoresetMode)
def test_episodes_that_are_cut_short_have_no_score(autoreset):
    envs = ScoreEpisodes(
        SyncVectorEnv(
            [lambda: TimeLimit(GaugeEnv(RIGID), 5)] * 2, autoreset_mode=autoreset
        )
    )
    envs.reset(seed=0)
    steps = run_to_end(envs)
    assert len(steps) == 5
    assert "score" not in steps[-1][4]


def test_no_warning_from_make_vec():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.make_vec(f"GAUGE/{DRIVEN}", num_envs=2).close()
