"""Throw: an ideal ball on the best plate reaches the law's height, and so does the law's policy in engines."""

import csv
import math

import numpy as np
import pytest
from control_episodes import by_law, make, play, with_limit_of
from places import ROOT
from programs import printed

from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.control.task import Ending
from gauge_envs.tools.control.throw import SPEED_M_PER_S, STROKE_M, highest_m

THROW = "Throw-Limit-rubber"


@pytest.fixture(scope="module")
def env():
    return make(THROW, settings={"timestep_s": 1 / 1800})


@pytest.mark.parametrize("restitution", [0.3, 0.9])
def test_height_is_the_best_of_all_places(restitution):
    """Against all combinations of 101 places at each of three impacts."""
    places = np.linspace(-STROKE_M, STROKE_M, 101)
    heights = np.array([0.26])
    for _ in range(3):
        drops_m = np.clip(heights[:, None] - places, 0.0, None)
        comes = np.sqrt(2.0 * GRAVITY_M_PER_S2 * drops_m)
        leaves = restitution * comes + (1.0 + restitution) * SPEED_M_PER_S
        heights = (places + leaves**2 / (2.0 * GRAVITY_M_PER_S2)).ravel()
    highest = highest_m(0.26, restitution, GRAVITY_M_PER_S2)
    assert highest == pytest.approx(heights.max(), rel=1e-4)


def test_the_uncertainty_comes_from_restitution_and_start(env):
    known, drop = 0.576733, 0.451023 - 0.013297 - 0.15 - 0.03
    value = highest_m(drop, known, GRAVITY_M_PER_S2)
    by_restitution = highest_m(drop, known + 0.1602, GRAVITY_M_PER_S2) - value
    by_start = highest_m(drop + 0.001, known, GRAVITY_M_PER_S2) - value
    assert env.task.limits[0] == pytest.approx(value)
    assert env.task.sigmas[0] == pytest.approx(
        math.hypot(by_restitution, by_start), rel=1e-3
    )


def test_the_laws_policy_throws_nearly_as_high():
    env = make(THROW)
    paid, report = by_law(env)
    assert report.ending is Ending.REACHED
    # It meets the ball 2 cm below the top of the stroke, and starts its stroke at a frame.
    assert 0.95 < report.ratio < 1.0
    gain = (report.reached - 0.257726) / (report.limit.value - 0.257726)
    assert paid == pytest.approx(gain, abs=1e-4)


def test_a_higher_restitution_than_the_law_knows_is_seen():
    """A planted fault: the simulated restitution is 0.7 instead of 0.577."""
    bouncy = make(THROW, parameters={"ball.restitution": 0.7})
    assert by_law(with_limit_of(bouncy, make(THROW)))[1].ratio > 1.1


def test_the_plate_is_no_faster_than_the_law_assumes(env):
    env.reset(seed=0)
    for _ in range(2):
        observation = env.step(np.ones(2))[0]
    first = env.OBSERVED.index("plate_velocity_x_m_per_s")
    assert observation[first : first + 2] == pytest.approx(SPEED_M_PER_S)


@pytest.mark.parametrize("aside_m", [0.08, 0.103])
def test_an_impact_at_an_edge_loses_the_ball(env, aside_m):
    """Return the law's policy with the ball at a distance from the middle of the plate."""

    def aside(_):
        env.task._from_plate_m -= aside_m
        action = env.law_action(1.0)
        env.task._from_plate_m += aside_m
        return action

    assert (play(env, aside).ending is Ending.LOST) is (aside_m > 0.09)


@pytest.mark.slow
def test_a_short_training_learns_to_throw(tmp_path):
    pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    script = ROOT / "examples" / "train_control.py"
    task = ("--task", THROW, "--seed", 0, "--steps", 40000)
    shown = printed(script, *task, "--out", tmp_path)
    with (tmp_path / f"{THROW}-0.csv").open(newline="") as file:
        first, *_, last = csv.DictReader(file)
    assert float(first["ratio"]) < 0.4
    assert float(last["success"]) == 1.0
    # A ball that is never struck upwards stays below 0.26 m, a ratio of 0.39.
    assert 0.85 < float(last["ratio"]) <= 1.0
    assert "the law:  10 of 10 succeed" in shown
    assert (tmp_path / f"{THROW}-0.zip").stat().st_size > 10_000
