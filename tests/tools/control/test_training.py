"""The training of the example improves from nothing to what chance cannot reach."""

import csv

import numpy as np
import pytest
from places import ROOT
from programs import printed

from gauge_envs.tools.control.play import play_paid
from gauge_envs.tools.control.throw import ThrowLimit

LEAST_RATIO = 0.85
"""Heights of 0.57 m: a ball that is never struck upwards stays below 0.26 m, a ratio of 0.39."""


@pytest.mark.slow
def test_a_short_training_learns_to_throw(tmp_path):
    pytest.importorskip("stable_baselines3", reason="extra 'rl' is not installed")
    script = ROOT / "examples" / "train_control.py"
    task = ("--task", "Throw-Limit-rubber", "--seed", 0, "--steps", 40000)
    shown = printed(script, *task, "--out", tmp_path)
    with (tmp_path / "Throw-Limit-rubber-0.csv").open(newline="") as file:
        first, *_, last = csv.DictReader(file)
    assert float(first["ratio"]) < 0.4
    assert float(last["success"]) == 1.0
    assert LEAST_RATIO < float(last["ratio"]) <= 1.0
    assert "the law:  10 of 10 succeed" in shown
    assert (tmp_path / "Throw-Limit-rubber-0.zip").stat().st_size > 10_000


def test_chance_stays_below_what_the_training_must_reach():
    env = ThrowLimit("rubber", settings={"timestep_s": 1 / 1080})
    random = np.random.default_rng(0)
    ratios = [
        play_paid(env, lambda _: random.uniform(-1.0, 1.0, 2))[1].ratio
        for _ in range(100)
    ]
    assert max(ratios) < LEAST_RATIO
    assert np.mean(ratios) < 0.2
