"""Worlds that advance together: arrays in place of a loop change no number of an episode."""

import threading
from dataclasses import replace

import gymnasium
import mujoco
import numpy as np
import pytest

from benchmarks.worlds import measured
from gauge_envs.backends.mujoco import worlds
from gauge_envs.envs import stepper
from gauge_envs.envs.at_once import EpisodesAtOnce
from gauge_envs.envs.divergence import RigidBoundsOfWorlds
from gauge_envs.envs.lockstep import EpisodesOneByOne
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.resolve import load_experiment


def zeros(envs):
    return np.zeros(envs.action_space.shape, dtype=np.int64)


@pytest.mark.parametrize(
    "name",
    ["GAUGE/SlopeSlider-3-metal", "GAUGE/FoamShearing-soft", "GAUGE/Push-Limit-wood"],
)
def test_worlds_in_threads_have_the_bits_of_one_thread(name, monkeypatch):
    """And the threads are used: the first waits for a second, which a pool begins only if the first is at work."""
    steps, used = {}, set()
    advance = mujoco.mj_step
    second = threading.Event()
    second.set()

    def noted(*arguments, **keywords):
        used.add(threading.get_ident())
        if len(used) > 1:
            second.set()
        assert second.wait(timeout=60.0)
        advance(*arguments, **keywords)

    monkeypatch.setattr(mujoco, "mj_step", noted)
    for count in (1, 3):
        for module in (stepper, worlds):
            monkeypatch.setattr(module, "processors", lambda count=count: count)
        envs = gymnasium.make_vec(name, num_envs=3)
        envs.reset(seed=1)
        used.clear()
        if count > 1:
            second.clear()
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


@pytest.mark.slow
def test_newton_reads_all_worlds_with_the_values_of_each():
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


def test_driven_and_soft_experiments_run_in_a_loop(together):
    for name in ("SlopeSlider-3-metal", "StickStack-soft"):
        envs = gymnasium.make_vec(f"GAUGE/{name}", num_envs=1).unwrapped
        assert isinstance(envs._lockstep, EpisodesOneByOne)


def test_scores_as_arrays_are_those_of_each_world(together):
    envs = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=3, score_arrays=True)
    envs.reset(seed=1, options={"jitter": True})
    for _ in range(18):
        *_, infos = envs.step(zeros(envs))
    assert "score" not in infos
    scores = envs.unwrapped.scores()
    for key, expected in {
        "rmse": [score.rmse for score in scores],
        "rmse_normalized": [score.rmse_normalized for score in scores],
        "rmse_aligned_normalized": [score.rmse_aligned_normalized for score in scores],
        "time_offset_s": [score.time_offset_s for score in scores],
    }.items():
        assert infos[f"_{key}"].all()
        assert infos[key] == pytest.approx(expected, rel=1e-6, abs=2e-6)


def test_training_leaves_scores_out():
    envs = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=2, score=False)
    single = gymnasium.make("GAUGE/SlopeSlider-2-wood", score=False)
    for one, action in ((envs, zeros(envs)), (single, 0)):
        one.reset(seed=0)
        for _ in range(18):
            *_, truncated, infos = one.step(action)
        assert np.all(truncated) and "score" not in infos
    for other in ({"score_arrays": True}, {"mode": "device"}):
        with pytest.raises(ParameterError, match="score=False"):
            gymnasium.make_vec(
                "GAUGE/SlopeSlider-2-wood", num_envs=2, score=False, **other
            )


@pytest.mark.parametrize(
    ("name", "place_m"),
    [("SlopeSlider-2-wood", None), ("Turntable-1-wood", (0.46, 0.40688, 0.213902))],
)
def test_separate_simulations_give_the_same_arrays(name, place_m):
    """A world that starts elsewhere than the solution has no score, in arrays and alone."""
    constants = [{}, {"cube.position_m": place_m}] if place_m else None
    envs = gymnasium.make_vec(
        f"GAUGE/{name}", num_envs=2, world_parameters=constants, score_arrays=True
    )
    envs.reset(seed=1)
    infos = {}
    while "rmse" not in infos:
        *_, infos = envs.step(zeros(envs))
    expected = [score.rmse for score in envs.unwrapped.scores()]
    assert (expected[1] is None) == bool(place_m)
    expected = np.array(expected, dtype=float)
    assert infos["rmse"] == pytest.approx(expected, rel=1e-9, nan_ok=True)


def test_worlds_that_diverged_have_no_scores(together):
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


def test_records_are_parts_of_shared_arrays(together):
    envs = gymnasium.make_vec("GAUGE/SlopeSlider-2-wood", num_envs=2).unwrapped
    envs.reset(seed=0)
    envs.step(zeros(envs))
    times_s, samples = envs._lockstep.trajectories()
    assert samples.shape == (2, len(times_s), 3)
    assert np.isfinite(samples[:, :7]).all()
    assert np.isnan(samples[:, 7:]).all()
    assert np.array_equal(samples[1, :7], envs.episodes[1].trajectory().samples)


def test_the_benchmark_of_worlds_times_each_part():
    row = measured("mujoco", 2, {}, repeats=1)
    assert row.worlds == 2
    assert min(row.engine_us, row.host_us, row.run_on_us, row.scoring_us) > 0.0
    assert row.steps_per_s == pytest.approx(
        1e6 / (row.engine_us + row.host_us + row.run_on_us + row.scoring_us), rel=1e-9
    )


def test_each_world_is_judged_by_its_own_masses():
    scene = load_experiment("BouncingBall-rubber").scene
    heavy = replace(
        scene,
        bodies=tuple(
            replace(one, mass_kg=1e3 * one.mass_kg)
            if one in scene.dynamic_bodies
            else one
            for one in scene.bodies
        ),
    )
    states = np.zeros((2, 1, 13))
    states[:, 0, 3] = 1.0
    own, of_the_first = (
        RigidBoundsOfWorlds([scene, heavy]),
        RigidBoundsOfWorlds([scene, scene]),
    )
    of_the_first.energies_j = own.energies_j
    # Twice the energy that the heavy ball may have.
    states[1, 0, 7] = 2.0 * np.sqrt(own.energies_j[1] / heavy.dynamic_bodies[0].mass_kg)
    assert own.suspects(states).tolist() == [False, True]
    assert of_the_first.suspects(states).tolist() == [False, False]
