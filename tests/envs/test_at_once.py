"""Worlds that advance together: arrays in place of a loop change no number of an episode."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv, VectorEnv

from benchmarks.worlds import measured
from gauge_envs import GaugeEnv
from gauge_envs.backends.base import Simulation, World, Worlds
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.envs import stepper
from gauge_envs.envs.at_once import EpisodesAtOnce
from gauge_envs.envs.lockstep import EpisodesOneByOne
from gauge_envs.envs.vector import ScoreEpisodes
from gauge_envs.errors import ActionError, EpisodeError, ParameterError
from gauge_envs.scene import Scene

NAMES = ("SlopeSlider-2-wood", "BouncingBall-rubber", "NonsmoothContact-1-wood")


class OneOfMany(World):
    """A world that is no simulation of its own, as those of Newton."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.settings = simulation.settings

    def drive(self, *arguments: Any) -> None:
        self.simulation.drive(*arguments)

    def body_states(self, names: Sequence[str]) -> np.ndarray:
        return self.simulation.body_states(names)

    def nodes(self, name: str) -> np.ndarray:
        return self.simulation.nodes(name)

    def track(self, name: str, points_m: np.ndarray) -> Any:
        return self.simulation.track(name, points_m)


class Together(Worlds):
    """MuJoCo simulations that advance in one call."""

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self.worlds = [OneOfMany(simulation) for simulation in simulations]

    def reset(self, seed: int) -> None:
        for world in self.worlds:
            world.simulation.reset(seed)

    def advance(self, seconds: float) -> None:
        for world in self.worlds:
            world.simulation.advance(seconds)

    def close(self) -> None:
        for world in self.worlds:
            world.simulation.close()


@pytest.fixture
def together(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """MuJoCo with worlds that advance together."""

    def build_worlds(
        self: BackendMuJoCo,
        scenes: Sequence[Scene],
        settings: Mapping[str, Any] | None = None,
    ) -> Worlds:
        return Together([self.build(scene, settings) for scene in scenes])

    monkeypatch.setattr(BackendMuJoCo, "build_worlds", build_worlds)
    return


def zeros(envs: VectorEnv) -> np.ndarray:
    return np.zeros(envs.num_envs, dtype=np.int64)


def assert_same_steps(many: VectorEnv, loop: VectorEnv, count: int) -> None:
    for _ in range(count):
        ours, theirs = many.step(zeros(many)), loop.step(zeros(loop))
        assert all(np.array_equal(ours[0][key], theirs[0][key]) for key in theirs[0])
        assert all(
            np.array_equal(a, b) for a, b in zip(ours[1:4], theirs[1:4], strict=True)
        )
        assert json.dumps(ours[4], default=str, sort_keys=True) == json.dumps(
            theirs[4], default=str, sort_keys=True
        )


@pytest.mark.parametrize("name", NAMES)
def test_worlds_at_once_are_single_environments_bit_for_bit(
    name: str, together: None
) -> None:
    options = {"jitter": True}
    many = gymnasium.make_vec(f"GAUGE/{name}", num_envs=3)
    assert isinstance(many.unwrapped._lockstep, EpisodesAtOnce)
    singles = SyncVectorEnv([lambda: GaugeEnv(name)] * 3)
    loop = ScoreEpisodes(singles)
    many.reset(seed=4, options=options)
    loop.reset(seed=4, options=options)
    frames = many.unwrapped.experiment.frame_count
    # To the end with the scores, the restart, and into the next episode.
    assert_same_steps(many, loop, frames + 4)


@pytest.mark.parametrize(
    "name",
    [
        "Turntable-1-wood",
        "SlopeSlider-3-metal",
        "CubePush-light",
        "FoamShearing-soft",
        "TextileBending-satin",
    ],
)
def test_driven_and_deformable_worlds_at_once_are_single_environments(
    name: str, together: None
) -> None:
    """Also with actions, which differ between the worlds."""
    count = 2 if name.startswith("Textile") else 3
    many = gymnasium.make_vec(f"GAUGE/{name}", num_envs=count)
    assert isinstance(many.unwrapped._lockstep, EpisodesAtOnce)
    loop = SyncVectorEnv([lambda: GaugeEnv(name)] * count)
    many.reset(seed=4)
    loop.reset(seed=4)
    draw = np.random.default_rng(0)
    for frame in range(4):
        actions = draw.uniform(-1.0, 1.0, many.action_space.shape) * (frame > 0)
        actions[0] = 0.0
        ours, theirs = many.step(actions), loop.step(actions)
        assert ours[0].keys() == theirs[0].keys()
        assert all(np.array_equal(ours[0][key], theirs[0][key]) for key in theirs[0])
        assert all(
            np.array_equal(a, b) for a, b in zip(ours[1:4], theirs[1:4], strict=True)
        )
    for episode, env in zip(many.unwrapped.episodes, loop.envs, strict=True):
        mine, its = episode.trajectory(), env.unwrapped.trajectory()
        assert all(
            np.array_equal(getattr(mine, key), getattr(its, key)) for key in vars(mine)
        )


@pytest.mark.parametrize(
    "name",
    ["GAUGE/SlopeSlider-3-metal", "GAUGE/FoamShearing-soft", "GAUGE/Push-Limit-wood"],
)
def test_worlds_in_threads_have_the_bits_of_one_thread(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the threads are used."""
    steps, used = {}, set()
    advance = SimulationMuJoCo._step

    def noted(self: SimulationMuJoCo, count: int) -> None:
        used.add(threading.get_ident())
        advance(self, count)

    monkeypatch.setattr(SimulationMuJoCo, "_step", noted)
    for count in (1, 3):
        monkeypatch.setattr(stepper, "processors", lambda count=count: count)
        used.clear()
        envs = gymnasium.make_vec(name, num_envs=3)
        envs.reset(seed=1)
        actions = np.random.default_rng(0).uniform(
            -1.0, 1.0, (3, *envs.action_space.shape)
        )
        steps[count] = [
            envs.step(one.astype(envs.action_space.dtype))[:2] for one in actions
        ]
        assert (len(used) > 1) == (count > 1)
        envs.close()
    for (alone, reward), (shared, rewards) in zip(steps[1], steps[3], strict=True):
        same = (
            alone == shared
            if not isinstance(alone, dict)
            else {key: alone[key] == shared[key] for key in alone}
        )
        assert all(
            np.all(one) for one in (same.values() if isinstance(same, dict) else [same])
        )
        assert np.array_equal(reward, rewards)


def test_a_wrong_action_of_a_driven_world_at_once_is_named(together: None) -> None:
    many = gymnasium.make_vec("GAUGE/Turntable-1-wood", num_envs=2)
    many.reset(seed=0)
    for wrong in (
        np.full((2, 1), 1.5),
        np.full((2, 1), np.nan),
        np.zeros((2, 2)),
        [[0.0], ["x"]],
    ):
        with pytest.raises(ActionError):
            many.step(wrong)


def test_a_world_that_diverges_at_once_ends_alone(together: None) -> None:
    many = gymnasium.make_vec("GAUGE/BouncingBall-rubber", num_envs=3)
    loop = ScoreEpisodes(SyncVectorEnv([lambda: GaugeEnv("BouncingBall-rubber")] * 3))
    many.reset(seed=0)
    loop.reset(seed=0)
    assert_same_steps(many, loop, 2)
    many.unwrapped.worlds.worlds[1].simulation.data.qvel[0] = 900.0
    loop.unwrapped.envs[1].simulation.data.qvel[0] = 900.0
    last, _, terminations, truncations, infos = many.step(zeros(many))
    assert terminations.tolist() == [False, True, False]
    assert not truncations.any()
    assert (
        infos["_diverged"].tolist() == infos["_score"].tolist() == [False, True, False]
    )
    assert infos["diverged"][1] == loop.step(zeros(loop))[4]["diverged"][1]
    over = False
    while not over:
        observation, rewards, terminations, truncations, infos = many.step(zeros(many))
        assert np.array_equal(observation["bodies"][1], last["bodies"][1])
        assert rewards[1] == 0.0
        assert infos["_frame"].tolist() == [True, False, True]
        over = (terminations | truncations).all()
    assert [score is None for score in infos["score"]] == [False, True, False]
    assert many.step(zeros(many))[4]["frame"].tolist() == [0, 0, 0]


@pytest.mark.slow
def test_newton_reads_all_worlds_with_the_values_of_each() -> None:
    pytest.importorskip("newton")
    envs = gymnasium.make_vec(
        "GAUGE/NonsmoothContact-1-wood", num_envs=3, backend="newton"
    ).unwrapped
    assert isinstance(envs._lockstep, EpisodesAtOnce)
    envs.reset(seed=0, options={"jitter": True})
    for _ in range(5):
        envs.step(zeros(envs))
    names = [body.name for body in envs.experiment.scene.dynamic_bodies]
    states = envs.worlds.body_states(names)
    assert np.array_equal(
        states, np.stack([world.body_states(names) for world in envs.worlds.worlds])
    )
    assert np.array_equal(envs.worlds.body_positions(names), states[:, :, :3])
    # A fixed body is in no array of the engine.
    every = [body.name for body in envs.experiment.scene.bodies]
    assert envs.worlds.body_states(every).shape == (3, len(every), 13)


def test_wrong_actions_are_refused(together: None) -> None:
    many = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=2)
    many.reset(seed=0)
    for actions in (np.array([0, 1]), np.array([0.5, 0.0]), [0, 0, 0]):
        with pytest.raises(ActionError):
            many.step(actions)
    many.step([0, 0])


def test_driven_and_soft_experiments_run_in_a_loop(together: None) -> None:
    for name in ("SlopeSlider-3-metal", "StickStack-soft"):
        envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=1).unwrapped
        assert isinstance(envs._lockstep, EpisodesOneByOne)


def test_scores_as_arrays_are_those_of_each_world(together: None) -> None:
    envs = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=3, score_arrays=True)
    envs.reset(seed=1, options={"jitter": True})
    for _ in range(18):
        *_, infos = envs.step(zeros(envs))
    assert "score" not in infos
    scores = envs.unwrapped.scores()
    for key in (
        "rmse",
        "rmse_normalized",
        "rmse_aligned_normalized",
        "release_offset_s",
    ):
        assert infos[f"_{key}"].all()
        assert infos[key] == pytest.approx(
            [getattr(score, key) for score in scores], rel=1e-6, abs=2e-6
        )


def test_separate_simulations_give_the_same_arrays() -> None:
    envs = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=2, score_arrays=True)
    envs.reset(seed=1)
    for _ in range(18):
        *_, infos = envs.step(zeros(envs))
    assert infos["rmse"] == pytest.approx(
        [score.rmse for score in envs.unwrapped.scores()], rel=1e-9
    )


def test_worlds_that_diverged_have_no_scores(together: None) -> None:
    envs = gymnasium.make_vec(
        "GAUGE/BouncingBall-rubber", num_envs=2, score_arrays=True
    )
    envs.reset(seed=0)
    envs.unwrapped.worlds.worlds[0].simulation.data.qvel[0] = 900.0
    over = False
    while not over:
        *_, terminations, truncations, infos = envs.step(zeros(envs))
        over = (terminations | truncations).all()
    assert infos["_rmse"].tolist() == [False, True]
    assert np.isnan(infos["rmse"][0])


def test_arrays_need_a_native_environment_and_a_reference(together: None) -> None:
    with pytest.raises(ParameterError, match="expected a GaugeVectorEnv"):
        ScoreEpisodes(
            SyncVectorEnv([lambda: GaugeEnv("SlopeSlider-2-wood")]), arrays=True
        )
    envs = gymnasium.make_vec("GAUGE/RopeWinding-rubber", num_envs=1)
    with pytest.raises(EpisodeError, match="no reference"):
        envs.unwrapped.score_arrays()


def test_records_are_parts_of_shared_arrays(together: None) -> None:
    envs = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=2).unwrapped
    envs.reset(seed=0)
    envs.step(zeros(envs))
    times_s, samples = envs._lockstep.trajectories()
    assert samples.shape == (2, len(times_s), 3)
    assert np.isfinite(samples[:, :7]).all()
    assert np.isnan(samples[:, 7:]).all()
    assert np.array_equal(samples[1, :7], envs.episodes[1].trajectory().samples)


def test_the_benchmark_of_worlds_times_each_part() -> None:
    row = measured("mujoco", 2, {}, repeats=1)
    assert row.worlds == 2
    assert min(row.engine_us, row.host_us, row.run_on_us, row.scoring_us) > 0.0
    assert row.steps_per_s == pytest.approx(
        1e6 / (row.engine_us + row.host_us + row.run_on_us + row.scoring_us), rel=1e-9
    )
