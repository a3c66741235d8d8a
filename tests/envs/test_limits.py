"""Divergence by four rules: each ends an episode with its reason, and no more than the body or world that it names."""

import gymnasium
import numpy as np
import pytest

from gauge_envs import GaugeEnv
from gauge_envs.envs.limits import (
    DISTANCE_LIMIT_M,
    SPEED_LIMIT_M_PER_S,
    SPIN_LIMIT_RAD_PER_S,
    STATE_LIMITS,
    STRETCH_LIMIT,
    diverged_bodies,
    diverged_nodes,
)
from gauge_envs.errors import EpisodeError

STILL = np.array([0.0, 0.0, 1.0, 1.0, *[0.0] * 9])
CUBE_M = np.array(
    [[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]
)


@pytest.mark.parametrize(
    ("column", "limit", "words"),
    [
        (1, DISTANCE_LIMIT_M, "second is more than 100 m from the origin"),
        (8, SPEED_LIMIT_M_PER_S, "second moves faster than 50 m/s"),
        (12, SPIN_LIMIT_RAD_PER_S, "second spins faster than 10000 rad/s"),
    ],
)
def test_a_body_beyond_a_limit_has_diverged_in_its_world(column, limit, words):
    states = np.tile(STILL, (3, 2, 1))
    states[:, 1, column] = [0.999 * limit, -1.001 * limit, 0.0]
    assert diverged_bodies(["first", "second"], states) == {1: words}


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_has_diverged(value):
    for column in range(13):
        states = np.tile(STILL, (2, 1, 1))
        states[0, 0, column] = value
        words = "the state of ball is not finite"
        assert diverged_bodies(["ball"], states) == {0: words}


def test_a_deformable_body_may_span_three_times_its_start():
    rest_m = np.sqrt(3.0) * 0.1
    within, beyond = (CUBE_M * share * STRETCH_LIMIT for share in (0.999, 1.001))
    far = CUBE_M + DISTANCE_LIMIT_M * np.eye(3)[1]
    broken = np.full_like(CUBE_M, np.nan)
    found = diverged_nodes("foam", np.stack([within, beyond, far, broken]), rest_m)
    assert sorted(found) == [1, 2, 3]
    assert "3 times" in found[1] and "100 m" in found[2] and "not finite" in found[3]


def test_a_finite_explosion_terminates_and_says_why():
    env = gymnasium.make("GAUGE/BouncingBall-rubber")
    env.reset(seed=0)
    env.unwrapped.rollout.simulation.data.qvel[0] = 500.0
    *_, terminated, truncated, info = env.step(0)
    assert terminated and not truncated
    assert info["diverged"] == "ball moves faster than 50 m/s"
    assert info["score"].rmse is None
    with pytest.raises(EpisodeError, match="over"):
        env.step(0)


def test_what_the_engine_gave_up_is_named_by_the_engine():
    """MuJoCo puts a state back to its start after a velocity that is not finite."""
    env = GaugeEnv("BouncingBall-rubber")
    env.reset(seed=0)
    env.rollout.simulation.data.qvel[0] = np.nan
    *_, terminated, _, info = env.step(0)
    assert terminated
    assert "MuJoCo found a velocity" in info["diverged"]


def test_observations_are_bounded_by_the_limits():
    env = GaugeEnv("Turntable-1-wood")
    assert env.observation_space["bodies"].high == pytest.approx(STATE_LIMITS[None])
    assert env.observation_space["driver"].low == pytest.approx(-STATE_LIMITS[None])
    assert env.observation_space["observable"].high.max() == 1e3 * DISTANCE_LIMIT_M
