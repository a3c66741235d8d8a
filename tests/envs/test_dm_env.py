"""The suite behind dm_env's interface, checked by dm_env's own tests and against Gymnasium."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation, TimeLimit
from programs import run_python

from gauge_envs import GaugeEnv

dm_env = pytest.importorskip("dm_env", reason="extra 'dm' is not installed")

from absl.testing import absltest  # noqa: E402  comes with dm_env
from dm_env import specs, test_utils  # noqa: E402

from gauge_envs.envs.dm_env import DmEnvironment, load  # noqa: E402

RIGID, DRIVEN, SOFT = "SlopeSlider-2-wood", "SlopeSlider-3-metal", "StickStack-soft"


class Suite(test_utils.EnvironmentTestMixin):
    """dm_env's own tests, each on episodes that reach their end."""

    name: str

    def make_object_under_test(self):
        return load(self.name)

    def make_action_sequence(self):
        for _ in range(GaugeEnv(self.name).experiment.frame_count + 5):
            yield self.make_action()


class TestRigid(Suite, absltest.TestCase):
    name = RIGID


class TestDriven(Suite, absltest.TestCase):
    name = DRIVEN


class TestSoft(Suite, absltest.TestCase):
    name = SOFT


def run_to_end(env):
    """An episode of zero actions."""
    spec = env.action_spec()
    steps = [env.reset()]
    while not steps[-1].last():
        steps.append(env.step(np.zeros(spec.shape, spec.dtype)))
    return steps


@pytest.mark.parametrize("name", [RIGID, DRIVEN])
def test_an_episode_is_that_of_gymnasium(name):
    steps = run_to_end(env := load(name))
    other = gymnasium.make(f"GAUGE/{name}")
    observation, _ = other.reset(seed=0)
    zero = np.zeros(other.action_space.shape, dtype=other.action_space.dtype)
    for number, step in enumerate(steps):
        if number:
            observation, reward, _, truncated, info = other.step(zero)
            assert (step.reward, step.discount, step.last()) == (reward, 1.0, truncated)
        assert step.observation.keys() == observation.keys()
        assert all(
            np.array_equal(step.observation[key], observation[key])
            for key in observation
        )
    assert env.score == info["score"]
    assert env.info["frame"] == info["frame"]


def test_specs_have_names_shapes_types_and_bounds():
    env = load(DRIVEN)
    observation = env.observation_spec()
    assert {
        name: (spec.name, spec.shape, spec.dtype) for name, spec in observation.items()
    } == {
        "observable": ("observable", (3,), np.float64),
        "bodies": ("bodies", (1, 13), np.float64),
        "driver": ("driver", (1, 13), np.float64),
        "time": ("time", (1,), np.float64),
    }
    assert observation["time"].minimum == 0.0
    assert observation["time"].maximum == pytest.approx([59 / 30])
    action = env.action_spec()
    assert (action.name, action.shape, action.dtype) == ("action", (1,), np.float32)
    assert (action.minimum, action.maximum) == (-1.0, 1.0)
    assert env.reward_spec().maximum == 0.0
    assert env.discount_spec().minimum == 0.0
    choice = load(RIGID).action_spec()
    assert isinstance(choice, specs.DiscreteArray)
    assert choice.num_values == 1


def test_a_divergence_ends_with_a_discount_of_zero_and_the_next_step_starts_over():
    gym_env = gymnasium.make("GAUGE/BouncingBall-rubber", disable_env_checker=True)
    env = DmEnvironment(gym_env)
    assert env.step(0).first()
    gym_env.unwrapped.rollout.simulation.data.qvel[0] = 900.0
    step = env.step(0)
    assert step.last()
    assert step.discount == 0.0
    assert "m/s" in env.info["diverged"]
    assert env.score.rmse is None
    assert env.step("ignored").first()


def test_the_score_is_that_of_the_last_episode_that_ended():
    env = load(RIGID)
    assert env.score is None
    run_to_end(env)
    score = env.score
    assert score.kind == "trials"
    env.step(0)
    env.step(0)
    assert env.score == score


def test_each_episode_starts_elsewhere_where_starts_scatter():
    envs = [load(RIGID, seed=seed, options={"jitter": True}) for seed in (3, 3, 4)]
    starts = [
        [env.reset().observation["observable"].tolist() for _ in range(2)]
        for env in envs
    ]
    assert starts[0] == starts[1]
    assert starts[0][0] != starts[0][1]
    assert starts[2][0] == starts[0][1]


def test_load_takes_names_ids_and_arguments_of_make():
    env = load(f"GAUGE/{RIGID}", parameters={"cube.friction": 0.2})
    run_to_end(env)
    assert env.score.signed_error[0] > 0.0


def test_wrapped_environments_keep_what_the_wrapper_does():
    env = DmEnvironment(FlattenObservation(gymnasium.make(f"GAUGE/{RIGID}")))
    assert env.observation_spec().shape == env.reset().observation.shape == (17,)
    short = DmEnvironment(TimeLimit(GaugeEnv(RIGID), 5))
    assert len(run_to_end(short)) == 6
    assert short.score is None
    bare = DmEnvironment(GaugeEnv(RIGID))
    run_to_end(bare)
    assert bare.score.kind == "trials"


def test_without_dm_env_the_extra_is_named():
    code = "import sys; sys.modules['dm_env'] = None; import gauge_envs; import gauge_envs.envs.dm_env"
    run = run_python("-c", code)
    assert run.returncode != 0
    assert "gauge_envs.errors.MissingExtraError" in run.stderr
    assert "pip install 'gauge-envs[dm]'" in run.stderr
