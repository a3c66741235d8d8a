"""The dm_env interface, checked by the tests of dm_env and against the numbers of Gymnasium."""

import gymnasium
import numpy as np
import pytest

from gauge_envs import GaugeEnv

dm_env = pytest.importorskip("dm_env", reason="extra 'dm' is not installed")

from absl.testing import absltest  # noqa: E402  comes with dm_env
from dm_env import specs, test_utils  # noqa: E402

from gauge_envs.envs.dm_env import DmEnvironment, load  # noqa: E402

RIGID, DRIVEN = "SlopeSlider-2-wood", "SlopeSlider-3-metal"
CONTROL = "GAUGE/Push-Limit-wood"


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


def run_to_end(env):
    """Return the steps of an episode of zero actions."""
    spec = env.action_spec()
    steps = [env.reset()]
    while not steps[-1].last():
        steps.append(env.step(np.zeros(spec.shape, spec.dtype)))
    return steps


def test_an_episode_equals_that_of_gymnasium():
    env = load(DRIVEN)
    steps = run_to_end(env)
    single = gymnasium.make(f"GAUGE/{DRIVEN}")
    single.reset(seed=0)
    for step in steps[1:]:
        observation, reward, _, truncated, info = single.step(np.zeros(1, np.float32))
        assert (step.reward, step.discount, step.last()) == (reward, 1.0, truncated)
        assert step.observation.keys() == observation.keys()
        for key, values in observation.items():
            assert np.array_equal(step.observation[key], values)
    assert env.score == info["score"]
    assert env.info["frame"] == info["frame"]


def test_specs_have_shapes_types_and_bounds():
    env = load(DRIVEN)
    shapes = {name: spec.shape for name, spec in env.observation_spec().items()}
    driver, body = (1, 13), (1, 13)
    expected = {"observable": (3,), "bodies": body, "driver": driver, "time": (1,)}
    assert shapes == expected
    time = env.observation_spec()["time"]
    assert (time.dtype, time.minimum) == (np.float64, 0.0)
    assert time.maximum == pytest.approx([59 / 30])
    action = env.action_spec()
    assert (action.shape, action.dtype) == ((1,), np.float32)
    assert (action.minimum, action.maximum) == (-1.0, 1.0)
    assert (env.reward_spec().maximum, env.discount_spec().minimum) == (0.0, 0.0)
    assert isinstance(load(RIGID).action_spec(), specs.DiscreteArray)


def test_a_divergence_ends_with_a_discount_of_zero_and_the_next_step_restarts():
    inner = gymnasium.make("GAUGE/BouncingBall-rubber", disable_env_checker=True)
    env = DmEnvironment(inner)
    assert env.step(0).first()
    inner.unwrapped.rollout.simulation.data.qvel[0] = 900.0
    step = env.step(0)
    assert step.last()
    assert step.discount == 0.0
    assert "m/s" in env.info["diverged"]
    assert env.score.rmse is None
    assert env.step("ignored").first()


def test_the_score_is_that_of_the_last_complete_episode():
    env = load(f"GAUGE/{RIGID}", parameters={"cube.friction": 0.2})
    assert env.score is None
    run_to_end(env)
    score = env.score
    assert score.estimates["friction"].value == pytest.approx(0.2, abs=0.02)
    env.step(0)
    env.step(0)
    assert env.score == score


def test_a_control_task_has_the_rewards_of_gymnasium_and_its_report():
    env = load(CONTROL)
    single = gymnasium.make(CONTROL)
    single.reset(seed=0)
    steps = run_to_end(env)
    for step in steps[1:]:
        action = np.zeros(env.action_spec().shape, np.float32)
        assert step.reward == single.step(action)[1]
    assert env.info["limit"].ending == "missed"
    assert env.reward_spec().maximum == np.inf
