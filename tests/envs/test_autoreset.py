"""Each world restarts on its own: the three autoreset modes equal Gymnasium's `SyncVectorEnv` of single environments.

Worlds diverge by a kick, end early by their task, reach their last frame together, and restart.
"""

import gymnasium
import numpy as np
import pytest
from episodes import assert_same
from gymnasium.vector import AutoresetMode

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.errors import EpisodeError, ParameterError

COUNT = 3
MODES = list(AutoresetMode)
TRAINING = {"settings": {"preset": "training"}}
JITTERED = {"kicks": [(5, 2)], "jitter": True} | TRAINING
KICKED = {"kicks": [(9, 0)]} | TRAINING
SLOW = pytest.mark.slow


def vector_env(name, mode, **options):
    return gymnasium.make_vec(
        f"GAUGE/{name}", num_envs=COUNT, autoreset_mode=mode.value, **options
    )


def single_envs(name, mode, **options):
    return gymnasium.make_vec(
        f"GAUGE/{name}",
        num_envs=COUNT,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **options,
    )


def compare(name, mode, steps, *, kicks=(), **options):
    """Step both with the same actions; `kicks` gives (step, world) of a speed at which the simulation diverges.

    Returns:
        Number of episodes that ended in each world.
    """
    envs, singles = (make(name, mode, **options) for make in (vector_env, single_envs))
    space = singles.action_space
    space.seed(2)
    assert_same(envs.reset(seed=7)[0], singles.reset(seed=7)[0])
    ends = np.zeros(COUNT, dtype=int)
    for step in range(steps):
        for at, world in kicks:
            if at == step:
                batch = envs.unwrapped.rollout.simulation.datas[world]
                alone = singles.envs[world].unwrapped.rollout.simulation.data
                batch.qvel[0] = alone.qvel[0] = 900.0
        actions = space.sample()
        ours, theirs = envs.step(actions), singles.step(actions)
        for one, other in zip(ours, theirs, strict=True):
            assert_same(one, other)
        over = theirs[2] | theirs[3]
        ends += over
        if mode is AutoresetMode.DISABLED and over.any():
            starts = [
                each.reset(options={"reset_mask": over.copy()})
                for each in (envs, singles)
            ]
            for one, other in zip(*starts, strict=True):
                assert_same(one, other)
    envs.close()
    singles.close()
    return ends


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("name", "steps", "how"),
    [
        ("BouncingBall-rubber", 45, {"kicks": [(3, 1), (22, 0), (22, 2)]}),
        ("Throw-Limit-rubber", 70, {"jitter": "real", "kicks": [(9, 0)]} | TRAINING),
        pytest.param("SlopeSlider-3-wood", 70, JITTERED, marks=SLOW),
        pytest.param("Turntable-Limit-wood", 160, KICKED, marks=SLOW),
        pytest.param("Push-Limit-wood", 60, TRAINING, marks=SLOW),
        pytest.param("Carry-Limit-metal", 95, TRAINING, marks=SLOW),
        pytest.param("Pendulum-Limit-metal", 200, {"jitter": True}, marks=SLOW),
        pytest.param("SlopeSlider-Limit-metal", 160, TRAINING, marks=SLOW),
        pytest.param("Fling-Limit-satin", 125, TRAINING, marks=SLOW),
    ],
)
def test_worlds_restart_as_single_environments_do(name, mode, steps, how):
    how = dict(how)
    if "Limit" not in name:
        how["score"] = False
    assert compare(name, mode, steps, **how).min() >= 1


@pytest.mark.parametrize("mode", MODES)
def test_an_engine_that_cannot_restart_a_world_is_looped(mode, monkeypatch):
    monkeypatch.setattr(BackendMuJoCo, "restarts_worlds", False)
    options = {"score": False, "jitter": True}
    envs = vector_env("SlopeSlider-2-wood", mode, **options)
    singles = single_envs("SlopeSlider-2-wood", mode, **options)
    assert not hasattr(envs.unwrapped.rollout.simulation, "datas")
    envs.reset(seed=1), singles.reset(seed=1)
    mask = np.array([False, True, False])
    envs.step([0, 0, 0]), singles.step([0, 0, 0])
    for each in (envs, singles):
        each.reset(seed=9, options={"reset_mask": mask, "jitter": True})
    for one, other in zip(envs.step([0, 0, 0]), singles.step([0, 0, 0]), strict=True):
        assert_same(one, other)


def test_scores_of_each_episode_arrive_in_every_mode():
    for mode in MODES:
        envs = vector_env("BouncingBall-rubber", mode)
        envs.reset(seed=0)
        envs.step([0, 0, 0])
        envs.unwrapped.rollout.simulation.datas[1].qvel[0] = 900.0
        scores = []
        for _ in range(16):
            infos = envs.step([0, 0, 0])[4]
            over = infos.get("_score", np.zeros(COUNT, dtype=bool))
            scores += [infos["score"][world].rmse for world in np.flatnonzero(over)]
            if mode is AutoresetMode.DISABLED and over.any():
                envs.reset(options={"reset_mask": over})
        assert len(scores) == 3
        assert scores[0] is None
        assert scores[1] == scores[2] > 0.0


def test_mistakes_raise_an_error():
    envs = vector_env("BouncingBall-rubber", AutoresetMode.DISABLED)
    for mask in ([True, False], [1, 0, 0], [False] * 3, [True, False, False]):
        with pytest.raises(ParameterError, match=r"'reset_mask' is .* 3 booleans"):
            envs.reset(options={"reset_mask": np.array(mask)})
    envs.reset(seed=0)
    envs.unwrapped.rollout.simulation.datas[1].qvel[0] = 900.0
    envs.step([0, 0, 0])
    with pytest.raises(EpisodeError, match=r"worlds \[1\] are over"):
        envs.step([0, 0, 0])
    with pytest.raises(
        ParameterError, match="autoreset_mode 'soon': choose 'NextStep'"
    ):
        gymnasium.make_vec("GAUGE/BouncingBall-rubber", autoreset_mode="soon")
