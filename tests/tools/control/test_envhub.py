"""The environment for LeRobot's EnvHub, with the keys that its evaluation reads."""

import runpy
from types import SimpleNamespace

import numpy as np
import pytest
from opengl import needs_opengl
from places import ROOT

make_env = runpy.run_path(str(ROOT / "packaging" / "hub" / "envhub" / "env.py"))[
    "make_env"
]


@needs_opengl
def test_a_policy_near_the_limit_succeeds_and_a_passive_one_does_not():
    configuration = SimpleNamespace(task="GAUGE/SlopeSlider-Limit-metal")
    suites = make_env(n_envs=2, cfg=configuration)
    (env,) = suites["gauge_limit"].values()
    observation, _ = env.reset(seed=[0, 1])
    assert observation["pixels"].shape == (2, 256, 256, 3)
    assert observation["pixels"].dtype == np.uint8
    assert observation["agent_pos"].shape[0] == 2
    assert all(isinstance(text, str) for text in env.call("task_description"))
    law_actions = env.envs[0].unwrapped
    for _ in range(env.call("_max_episode_steps")[0]):
        actions = np.zeros((2, 1), np.float32)
        actions[0] = law_actions.law_action(0.98)
        *_, truncated, info = env.step(actions)
    assert truncated.all()
    assert info["final_info"]["is_success"].tolist() == [True, False]
    env.close()


def test_an_unknown_task_is_an_error():
    with pytest.raises(ValueError, match="no control task matches 'Push'"):
        make_env(cfg=SimpleNamespace(task="Push"))
