"""Vector environments: worlds are single environments to the bit, and scores arrive in every mode."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from opengl import needs_opengl

from gauge_envs import GaugeEnv, Score
from gauge_envs.envs.vector import GaugeVectorEnv, ScoreEpisodes
from gauge_envs.errors import (
    ActionError,
    EpisodeError,
    ParameterError,
    UnsupportedSceneError,
)

RIGID, DRIVEN, SOFT = "SlopeSlider-2-wood", "SlopeSlider-3-metal", "StickStack-soft"
ALL_KINDS = (RIGID, DRIVEN, SOFT)
# Alike in spaces but for their bounds, and unlike in length.
SIX = (
    "SlopeContact-wood",
    "SlopeContact-plastic",
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-2-metal",
    "BouncingBall-rubber",
)
NEWTON_RIGID = "NonsmoothContact-1-wood"
COARSE = {"timestep_s": 1 / 900}
"""A step for what does not depend on it."""


def zeros(envs: VectorEnv) -> Any:
    return np.zeros(envs.action_space.shape, dtype=envs.action_space.dtype)


def run_to_end(
    envs: VectorEnv, actions: Callable[[], Any] | None = None
) -> list[tuple]:
    """Steps until every world's episode is over."""
    steps, over = [], np.zeros(envs.num_envs, dtype=bool)
    while not over.all():
        steps.append(envs.step(zeros(envs) if actions is None else actions()))
        over |= steps[-1][2] | steps[-1][3]
    return steps


def blow_up(envs: VectorEnv, number: int) -> None:
    """Give a world's body a speed that nothing in the scene can give it."""
    envs.unwrapped.worlds.worlds[number].data.qvel[0] = 900.0


# --- native ---


def test_make_vec_makes_the_native_one_by_default() -> None:
    envs = gymnasium.make_vec(f"GAUGE/{RIGID}", num_envs=2)
    assert isinstance(envs, ScoreEpisodes)
    assert isinstance(envs.unwrapped, GaugeVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.metadata["render_fps"] == 30
    assert envs.unwrapped.spec.id == f"GAUGE/{RIGID}"


@pytest.mark.parametrize(
    ("name", "steps"),
    [
        *((name, 9) for name in ALL_KINDS),
        ("Pendulum-metal", 9),
        ("FoamStretching-soft", 2),
    ],
)
def test_worlds_are_single_environments_bit_for_bit(name: str, steps: int) -> None:
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=2, settings=COARSE)
    options = {} if name.endswith("-soft") else {"jitter": True}
    batches = [envs.reset(seed=5, options=options)]
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(steps)]
    batches += [envs.step(action) for action in actions]
    for number in range(2):
        env = gymnasium.make(f"GAUGE/{name}", settings=COARSE)
        singles = [env.reset(seed=5 + number, options=options)]
        singles += [env.step(action[number]) for action in actions]
        for batch, single in zip(batches, singles, strict=True):
            assert batch[0].keys() == single[0].keys()
            assert all(
                np.array_equal(batch[0][key][number], single[0][key])
                for key in single[0]
            )
            assert [part[number] for part in batch[1:-1]] == list(single[1:-1])
            assert {key: batch[-1][key][number] for key in single[-1]} == single[-1]
        world = envs.unwrapped.episodes[number].trajectory()
        assert np.array_equal(world.samples, env.unwrapped.trajectory().samples)
    starts = batches[0][0]["observable"]
    assert np.array_equal(starts[0], starts[1]) == (not options)


@pytest.mark.slow
@pytest.mark.parametrize("name", [RIGID, NEWTON_RIGID, "TextileFlinging-satin"])
def test_worlds_of_one_newton_model_are_single_environments(name: str) -> None:
    pytest.importorskip("newton")
    envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=2, backend="newton")
    env = gymnasium.make(f"GAUGE/{name}", backend="newton")
    envs.reset(seed=0)
    env.reset(seed=0)
    action = zeros(envs)
    for _ in range(6):
        batch, single = envs.step(action), env.step(action[0])
        for number in range(2):
            assert all(
                np.array_equal(batch[0][key][number], single[0][key])
                for key in single[0]
            )
            assert batch[1][number] == single[1]


def test_observations_are_in_the_batched_space() -> None:
    envs = gymnasium.make_vec(f"GAUGE/{DRIVEN}", num_envs=3)
    observation, infos = envs.reset(seed=0)
    assert observation in envs.observation_space
    assert infos["frame"].tolist() == [0, 0, 0]
    observation, rewards, *_ = envs.step(envs.action_space.sample())
    assert observation in envs.observation_space
    assert rewards.shape == (3,)


def test_observations_are_not_overwritten_by_the_next_step() -> None:
    envs = gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=2)
    first, _ = envs.reset(seed=0)
    kept = first["observable"].copy()
    envs.step(zeros(envs))
    assert np.array_equal(first["observable"], kept)


def test_each_world_takes_its_own_seed_and_the_calibrated_start_comes_back() -> None:
    envs = gymnasium.make_vec(f"GAUGE/{RIGID}", num_envs=3)
    calibrated = envs.reset(seed=0)[0]["bodies"]
    together = envs.reset(seed=7, options={"jitter": True})[0]["bodies"]
    assert envs.unwrapped.seeds_used == (7, 8, 9)
    chosen = envs.reset(seed=[9, 7, 8], options={"jitter": True})[0]["bodies"]
    assert np.array_equal(chosen, together[[2, 0, 1]])
    assert np.array_equal(envs.reset(seed=7)[0]["bodies"], calibrated)


def test_the_step_after_the_end_starts_the_next_episode() -> None:
    envs = gymnasium.make_vec(f"GAUGE/{RIGID}", num_envs=2)
    start, _ = envs.reset(seed=0)
    *_, truncations, infos = run_to_end(envs)[-1]
    assert truncations.all()
    assert infos["_score"].tolist() == [True, True]
    observation, rewards, terminations, truncations, infos = envs.step(zeros(envs))
    assert np.array_equal(observation["observable"], start["observable"])
    assert not (rewards.any() or terminations.any() or truncations.any())
    assert infos["frame"].tolist() == [0, 0]
    assert "score" not in infos


def test_native_sync_and_async_agree_over_two_episodes() -> None:
    episodes = []
    for mode in ("vector_entry_point", "sync", "async"):
        envs = gymnasium.make_vec(
            f"GAUGE/{RIGID}", num_envs=2, vectorization_mode=mode, settings=COARSE
        )
        envs.reset(seed=0)
        steps = [envs.step(zeros(envs)) for _ in range(2 * 19)]
        envs.close()
        episodes.append(steps)
    for steps in zip(*episodes, strict=True):
        for other in steps[1:]:
            assert all(
                np.array_equal(steps[0][0][key], other[0][key]) for key in other[0]
            )
            assert all(
                np.array_equal(a, b)
                for a, b in zip(steps[0][1:4], other[1:4], strict=True)
            )
            assert json.dumps(steps[0][4], default=str, sort_keys=True) == json.dumps(
                other[4], default=str, sort_keys=True
            )


def test_a_world_that_diverges_ends_alone_and_waits_for_the_others() -> None:
    envs = gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=3)
    single = gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=1)
    envs.reset(seed=0)
    single.reset(seed=0)
    envs.step(zeros(envs))
    blow_up(envs, 1)
    last, _, terminations, truncations, infos = envs.step(zeros(envs))
    assert terminations.tolist() == [False, True, False]
    assert not truncations.any()
    assert (
        infos["_diverged"].tolist() == infos["_score"].tolist() == [False, True, False]
    )
    assert "m/s" in infos["diverged"][1]
    assert infos["score"][1].rmse is None
    steps = run_to_end(envs)
    expected = run_to_end(single)
    for observation, rewards, terminations, _, infos in steps:
        assert np.array_equal(observation["bodies"][1], last["bodies"][1])
        assert rewards[1] == 0.0
        assert terminations.tolist() == [False, True, False]
        assert infos["_frame"].tolist() == [True, False, True]
        assert "diverged" not in infos
    assert steps[-1][3].tolist() == [True, False, True]
    assert steps[-1][4]["_score"].tolist() == [True, False, True]
    assert [steps[-1][4]["score"][number] for number in (0, 2)] == [
        expected[-1][4]["score"][0]
    ] * 2
    restarted = envs.step(zeros(envs))
    assert not restarted[2].any()
    assert restarted[4]["frame"].tolist() == [0, 0, 0]
    assert all(step[4]["_score"].all() for step in run_to_end(envs)[-1:])


def test_when_all_have_diverged_the_next_step_starts_over() -> None:
    envs = gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=2)
    envs.reset(seed=0)
    blow_up(envs, 0)
    blow_up(envs, 1)
    assert envs.step(zeros(envs))[2].all()
    assert envs.step(zeros(envs))[4]["frame"].tolist() == [0, 0]


def test_episode_statistics_of_a_divergence() -> None:
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
def test_pictures_are_those_of_single_environments(name: str) -> None:
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


def test_spec_of_a_vector_environment_rebuilds_it() -> None:
    envs = gymnasium.make_vec(
        f"GAUGE/{RIGID}", num_envs=3, parameters={"cube.friction": np.float64(0.2)}
    )
    again = gymnasium.make_vec(EnvSpec.from_json(envs.unwrapped.spec.to_json()))
    assert again.num_envs == 3
    assert again.unwrapped.experiment.overrides == {"cube.friction": 0.2}


@pytest.mark.parametrize(
    "actions", [0, np.zeros(3, dtype=int), np.ones(2, dtype=int), [0, "up"], None]
)
def test_wrong_actions(actions: object) -> None:
    envs = gymnasium.make_vec(f"GAUGE/{RIGID}", num_envs=2)
    envs.reset(seed=0)
    with pytest.raises(ActionError):
        envs.step(actions)


def test_misuse_is_named() -> None:
    with pytest.raises(ParameterError, match="num_envs is 0"):
        GaugeVectorEnv(RIGID, 0)
    with pytest.raises(ParameterError, match="rgb_array"):
        GaugeVectorEnv(RIGID, render_mode="human")
    envs = GaugeVectorEnv(RIGID, 2)
    with pytest.raises(EpisodeError, match="reset"):
        envs.step([0, 0])
    with pytest.raises(ParameterError, match="3 seeds for 2 worlds"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(ParameterError, match="jitterr"):
        envs.reset(options={"jitterr": True})
    with pytest.raises(ParameterError, match="nothing to jitter"):
        GaugeVectorEnv(SOFT).reset(options={"jitter": True})


@pytest.mark.usefixtures("rigid_only")
def test_an_unsupported_id_says_so() -> None:
    with pytest.raises(UnsupportedSceneError, match="deformable body"):
        gymnasium.make_vec(f"GAUGE/{SOFT}", num_envs=2)


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
def test_scores_arrive_from_sub_environments(
    name: str, mode: str, autoreset: str
) -> None:
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
def test_bare_sub_environments_are_scored(vector: type) -> None:
    envs = ScoreEpisodes(vector([lambda: GaugeEnv(RIGID)] * 2))
    envs.reset(seed=0)
    scores = run_to_end(envs)[-1][4]["score"]
    assert [score.grade for score in scores] == ["trials"] * 2
    envs.close()
    envs = ScoreEpisodes(
        vector([lambda: GaugeEnv(RIGID)] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
    )
    envs.reset(seed=0)
    with pytest.raises(EpisodeError, match=r"gymnasium\.make"):
        run_to_end(envs)
    envs.close()


def test_episodes_that_are_cut_short_have_no_score() -> None:
    envs = ScoreEpisodes(SyncVectorEnv([lambda: TimeLimit(GaugeEnv(RIGID), 5)] * 2))
    envs.reset(seed=0)
    steps = run_to_end(envs)
    assert len(steps) == 5
    assert "score" not in steps[-1][4]


def test_six_ids_at_once_for_three_episodes() -> None:
    singles = {}
    for name in SIX:
        env = gymnasium.make(f"GAUGE/{name}", settings=COARSE)
        env.reset(seed=0)
        over = False
        while not over:
            *_, over, info = env.step(0)
        singles[name] = info["score"]
    envs = AsyncVectorEnv(
        [
            lambda name=name: gymnasium.make(f"GAUGE/{name}", settings=COARSE)
            for name in SIX
        ],
        observation_mode="different",
    )
    envs.reset(seed=0)
    scores: dict[str, list[Score]] = {name: [] for name in SIX}
    while min(map(len, scores.values())) < 3:
        *_, infos = envs.step(zeros(envs))
        for number in np.flatnonzero(infos.get("_score", [])):
            scores[SIX[number]].append(infos["score"][number])
    envs.close()
    for name in SIX:
        assert scores[name][:3] == [singles[name]] * 3
    assert len({score.rmse for score in singles.values()} - {None}) == 6


def test_no_warning_from_make_vec() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.make_vec(f"GAUGE/{DRIVEN}", num_envs=2).close()
